"""`benchmarks.public` on miniatures of our own in the layout of the public sets."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, grid, triangulated
from scipy.io import savemat

from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.pipeline import match

from locations import ROOT
from quick_match import QUICK, remembered

sys.path.insert(0, str(ROOT))
from benchmarks.public import measure, partial, sets
from benchmarks.public.__main__ import main
from benchmarks.public.sets import SETS, more_landmarks

from plain_meshes import renumbered

IDS = (0, 11, 17, 40, 60, 77)


def bodies() -> dict[str, ControlMesh]:
    """A creature, the same one bent, and the same one with its vertices in another order."""
    mesh = triangulated(creature())
    x, y, z = mesh.positions.T
    bent = replace(mesh, positions=np.column_stack([x + 0.05 * z**2, y, 1.2 * z]))
    return {"one": mesh, "two": renumbered(bent, 5)[0]}


def numbers(name: str, mesh: ControlMesh) -> np.ndarray:
    """Vertex of every template point of a shape."""
    return np.arange(mesh.n_vertices) if name == "one" else renumbered(mesh, 5)[1]


@pytest.fixture
def faust_r(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = tmp_path / "FAUST_r"
    for folder in ("corres", "vtx_5k"):
        (root / folder).mkdir(parents=True)
    for name, mesh in zip(("tr_reg_080", "tr_reg_091"), bodies().items(), strict=True):
        write_mesh(root / "vtx_5k" / f"{name}.off", mesh[1])
        np.savetxt(root / "corres" / f"{name}.vts", numbers(*mesh) + 1, fmt="%d")
    write_mesh(root / "vtx_5k" / "tr_reg_000.off", bodies()["one"])  # a training shape: not tested
    monkeypatch.setitem(sets.SETS, "faust_r", replace(SETS["faust_r"], landmarks={6: IDS}))
    return root


@pytest.fixture
def shrec(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = tmp_path / "SHREC20"
    for folder in ("models", "test-sets", "FULL_gts"):
        (root / folder).mkdir(parents=True)
    for name, mesh in bodies().items():
        write_mesh(root / "models" / f"{name}.obj", mesh)
        vertices = numbers(name, mesh)[: 60 if name == "one" else 80]
        faces = np.array([np.flatnonzero(mesh.face_indices == vertex)[0] // 3 for vertex in vertices])
        weights = (mesh.face_indices.reshape(-1, 3)[faces] == vertices[:, None]).astype(float)
        points = np.arange(len(vertices))[::-1] + 1
        tables = {"points": points[:, None], "verts": vertices[::-1][:, None] + 1}
        savemat(root / "FULL_gts" / f"{name}.mat", tables | {"baryc": np.column_stack([faces + 1, weights])[::-1]})
    (root / "test-sets" / "test-set0.txt").write_text("one.obj, two.obj\n\n")
    monkeypatch.setitem(sets.SETS, "shrec20", replace(SETS["shrec20"], landmarks={6: (1, 12, 18, 41, 50, 58)}))
    return root


@pytest.fixture(scope="module")
def quick() -> Iterator[None]:
    """Quick matches, each computed once for all tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "match", remembered(lambda *given: match(*given, QUICK)))
        yield


def run(name: str, root: Path, output: Path, *more: str) -> list[dict]:
    main([name, str(root), "--scheme", "loop", "--vertices", "600", "--points", "60", "--output", str(output), *more])
    return json.loads((output / "public.json").read_text())


def test_only_the_shapes_of_the_test_are_paired(faust_r: Path) -> None:
    public = sets.SETS["faust_r"]
    assert public.pairs(faust_r, None) == [("tr_reg_080", "tr_reg_091"), ("tr_reg_091", "tr_reg_080")]
    assert len(public.pairs(faust_r, 1)) == 1
    with pytest.raises(sets.SetError, match="found none"):
        public.pairs(faust_r / "corres", None)


def test_points_of_shrec_are_barycentric_and_pairs_go_both_ways(shrec: Path) -> None:
    public = sets.SETS["shrec20"]
    assert public.pairs(shrec, None) == [("one", "two"), ("two", "one")]
    for name, mesh in bodies().items():
        marks = public.marks(shrec, name, mesh)
        vertices = numbers(name, mesh)[: len(marks.ids)]
        assert marks.ids.tolist() == list(range(1, len(vertices) + 1))
        # Point 1 of the miniature is the last of the table.
        np.testing.assert_allclose(marks.points.of(mesh.positions), mesh.positions[vertices], atol=1e-12)
    one, two = (public.marks(shrec, name, mesh) for name, mesh in bodies().items())
    positions = two.points.of(bodies()["two"].positions)
    ids = more_landmarks(public, two, one, positions, 20)
    assert ids[:6] == [1, 12, 18, 41, 50, 58]
    assert len(set(ids)) == 20
    assert max(ids) <= 60


def test_smal_r_is_three_families_whose_points_share_vertices(tmp_path: Path) -> None:
    public = sets.SETS["smal_r"]
    vertices = np.arange(3889) // 30  # many points of the template are one vertex of a remeshed shape
    for name in ("cougar_01", "hippo_02", "horse_03", "dog_04"):
        for folder in ("shapes_a", "corres"):
            (tmp_path / folder).mkdir(exist_ok=True)
        write_mesh(tmp_path / "shapes_a" / f"{name}.off", bodies()["one"])
        np.savetxt(tmp_path / "corres" / f"{name}.vts", vertices + 1, fmt="%d")
    assert sorted({name for pair in public.pairs(tmp_path, None) for name in pair}) == [
        "cougar_01", "hippo_02", "horse_03",
    ]  # fmt: skip
    assert len(public.pairs(tmp_path, None)) == 6
    marks = public.marks(tmp_path, "hippo_02", bodies()["one"])
    assert marks.ids.tolist() == list(range(3889))
    assert marks.of(public.landmarks[6]).corners[:, 0].tolist() == [105, 64, 124, 46, 37, 33]


def test_faust_is_known_by_the_order_of_its_vertices(tmp_path: Path) -> None:
    public = sets.SETS["faust"]
    write_mesh(tmp_path / "tr_reg_080.off", grid(84, 84))
    write_mesh(tmp_path / "tr_reg_099.ply", grid(90, 90))
    write_mesh(tmp_path / "tr_scan_080.ply", grid(2, 2))
    assert public.pairs(tmp_path, None) == [("tr_reg_080", "tr_reg_099"), ("tr_reg_099", "tr_reg_080")]
    marks = public.marks(tmp_path, "tr_reg_099", grid(90, 90))
    assert marks.ids.tolist() == marks.points.corners[:, 0].tolist() == list(range(6890))
    with pytest.raises(sets.SetError, match="expected 6890 vertices or more, got 9"):
        public.marks(tmp_path, "tr_reg_099", grid(2, 2))


@pytest.fixture
def shrec19(tmp_path: Path) -> Path:
    """Body 1 and body 2 in another order; the map says where the vertices of 1 are on 2. 40 is left out."""
    root = tmp_path / "SHREC19"
    for folder in ("off", "corres"):
        (root / folder).mkdir(parents=True)
    for number, mesh in zip(("1", "2"), bodies().values(), strict=True):
        write_mesh(root / "off" / f"{number}.off", mesh)
    write_mesh(root / "off" / "40.off", bodies()["one"])
    np.savetxt(root / "corres" / "1_2.map", numbers("two", bodies()["two"]) + 1, fmt="%d")
    np.savetxt(root / "corres" / "1_40.map", np.arange(3), fmt="%d")
    return root


def test_maps_of_shrec19_are_directed(shrec19: Path) -> None:
    """Every vertex of 1 has one of 2: 2 receives, since its known points are sought on 1."""
    public = sets.SETS["shrec19"]
    assert public.pairs(shrec19, None) == [("2", "1")]
    one, two = bodies().values()
    assert public.pair_marks(shrec19, "2", "1", two).points.corners[:, 0].tolist() == numbers("two", two).tolist()
    assert public.marks(shrec19, "1", one).ids.tolist() == list(range(one.n_vertices))
    np.savetxt(shrec19 / "corres" / "1_2.map", [one.n_vertices + 1], fmt="%d")
    with pytest.raises(sets.SetError, match="expected a vertex from 1 to"):
        public.pair_marks(shrec19, "2", "1", two)
    (shrec19 / "corres" / "1_2.map").unlink()
    (shrec19 / "corres" / "1_40.map").unlink()
    with pytest.raises(sets.SetError, match="expected maps such as"):
        public.pairs(shrec19, None)


def test_pairs_of_tosca_are_those_of_its_list(tmp_path: Path) -> None:
    public = sets.SETS["tosca"]
    for folder in ("vtx_5k", "vtx_5k/corres"):
        (tmp_path / folder).mkdir()
    for name in ("8_gorilla_01", "8_man_02", "8_woman_03"):
        write_mesh(tmp_path / "vtx_5k" / f"{name}.off", bodies()["one"])
        for ending in ("vts", "sym.vts"):
            np.savetxt(tmp_path / "vtx_5k" / "corres" / f"{name}.{ending}", [1, 2, 3], fmt="%d")
    (tmp_path / "test_pairs.txt").write_text("8_gorilla_01\t8_man_02\n")
    assert public.pairs(tmp_path, None) == [("8_gorilla_01", "8_man_02"), ("8_man_02", "8_gorilla_01")]
    marks = public.marks(tmp_path, "8_man_02", bodies()["one"])
    assert marks.points.corners[:, 0].tolist() == [0, 1, 2]


@pytest.fixture
def pfaust(faust_r: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(sets.SETS, "pfaust", replace(SETS["pfaust"], landmarks={6: IDS}))
    monkeypatch.setattr(partial, "RADIUS", 0.15)
    partial.main([str(faust_r), str(tmp_path / "PFAUST"), "--holes", "1"])
    return tmp_path / "PFAUST"


def test_parts_are_one_piece_and_keep_their_points(pfaust: Path) -> None:
    public = sets.SETS["pfaust"]
    assert set(public.pairs(pfaust, None)) == {
        (f"part of tr_reg_{part}", f"tr_reg_{whole}") for part in ("080", "091") for whole in ("080", "091")
    }
    for shape, mesh in zip(("tr_reg_080", "tr_reg_091"), bodies().values(), strict=True):
        part = read_mesh(public.shapes(pfaust)[f"part of {shape}"])
        assert 0.5 < part.n_vertices / mesh.n_vertices < 0.98
        marks, every = public.marks(pfaust, f"part of {shape}", part), public.marks(pfaust, shape, mesh)
        np.testing.assert_allclose(marks.points.of(part.positions), every.of(marks.ids).of(mesh.positions), atol=1e-6)
    (pfaust / "masks" / "tr_reg_080.vts").write_text("1\n")
    with pytest.raises(sets.SetError, match="as many points in"):
        public.marks(pfaust, "part of tr_reg_080", read_mesh(public.shapes(pfaust)["part of tr_reg_080"]))


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_maps_and_parts_are_measured(shrec19: Path, pfaust: Path, tmp_path: Path) -> None:
    (row,) = run("shrec19", shrec19, tmp_path / "out", "--landmarks", "6", "--scheme", "none")
    assert row["mean"] < 11.0
    assert row["peak_mb"] > 10.0
    rows = run("pfaust", pfaust, tmp_path / "parts", "--scheme", "none")
    assert len(rows) == 4
    assert max(row["mean"] for row in rows) < 15.0
    assert "| peak MB |" in (tmp_path / "parts" / "public.md").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_rows_are_measured_once_and_one_table_is_written(
    faust_r: Path, shrec: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    rows = run("faust_r", faust_r, tmp_path / "out")
    assert len(rows) == 2
    assert max(row["mean"] for row in rows) < 4.0  # the body is bent by half its width
    assert all(0 < row["of_largest"] < row["mean"] for row in rows)
    capsys.readouterr()
    assert run("faust_r", faust_r, tmp_path / "out") == rows
    assert " landmarks: " not in capsys.readouterr().out.split("|")[0]
    plain = run("faust_r", faust_r, tmp_path / "plain", "--scheme", "none", "--pairs", "1")
    # 154 vertices a side: 3.9 and 6.4 by a functional map with descriptors, 7.9 and 9.6 by landmark coordinates.
    assert max(row["mean"] for row in plain) < 11.0
    both = run("shrec20", shrec, tmp_path / "out", "--landmarks", "6", "10", "--pairs", "1")
    assert len(both) == 4
    table = (tmp_path / "out" / "public.md").read_text()
    assert sum(line.startswith(("| FAUST", "| SHREC")) for line in table.splitlines()) == 3
    assert "SHREC'20" in table


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_broken_shape_costs_its_own_pairs_and_is_tried_again(faust_r: Path, tmp_path: Path) -> None:
    good = (faust_r / "corres" / "tr_reg_080.vts").read_bytes()
    for name in ("tr_reg_080", "tr_reg_082", "tr_reg_083"):
        write_mesh(faust_r / "vtx_5k" / f"{name}.off", bodies()["one"], force=True)
        (faust_r / "corres" / f"{name}.vts").write_bytes(good)
    (faust_r / "vtx_5k" / "tr_reg_082.off").write_text("OFF\n3 1 0\n0 0 0\n")
    (faust_r / "corres" / "tr_reg_083.vts").write_text("12\nnought\n")
    whole = (faust_r / "corres" / "tr_reg_091.vts").rename(tmp_path / "tr_reg_091.vts")
    with pytest.raises(SystemExit) as ended:
        run("faust_r", faust_r, tmp_path / "out")
    assert ended.value.code == 1
    table = (tmp_path / "out" / "public.md").read_text()
    for said in ("tr_reg_091.vts somewhere in it", "tr_reg_083.vts: expected a vertex number a line", "tr_reg_082.off"):
        assert said in table
    whole.rename(faust_r / "corres" / "tr_reg_091.vts")
    for name in ("tr_reg_082", "tr_reg_083"):
        (faust_r / "vtx_5k" / f"{name}.off").unlink()
    rows = run("faust_r", faust_r, tmp_path / "out")
    assert len(rows) == 2
    assert "Not measured" not in (tmp_path / "out" / "public.md").read_text()
