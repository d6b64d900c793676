"""Real meshes and a built-in one, whole, cut, flipped, duplicated and scaled: each passes or is refused by name."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from examples.shapes import creature

from cagemap.errors import InvalidMeshError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh, require_valid
from cagemap.mesh.faces import keep_faces
from cagemap.mesh.mesh_report import MeshReport
from cagemap.numerics.arrays import IndexArray

# The table of the data's README: vertices, quads, triangles, n-gons, boundary loops, UV islands. All have genus 0.
ANIMALS = {
    "zebra": (679, 622, 80, 10, 0, None),
    "horse": (347, 287, 74, 14, 0, None),
    "cow": (400, 342, 68, 14, 0, None),
    "pig": (283, 256, 38, 4, 0, None),
    "wolf": (313, 268, 54, 10, 0, None),
    "red_fox": (247, 220, 25, 6, 0, None),
    "velociraptor": (626, 576, 84, 4, 0, None),
    "fish1": (274, 241, 50, 4, 0, None),
    "shark": (324, 284, 28, 16, 0, None),
    "spot": (188, 160, 4, 16, 0, 13),
    "blub": (112, 100, 8, 4, 0, 5),
}
HEADS = {"deer_head": (744, 742, 0, 0, 0, 7), "mh_head_male_young": (4236, 4212, 0, 0, 1, 5)}
CAGES = {
    "base": (13380, 13378, 0, 0, 0, 9),
    "soma18056": (18056, 18054, 0, 0, 0, 40),
    "female1605": (1555, 1540, 0, 3, 0, 6),
    "male1591": (1541, 1526, 0, 3, 0, 6),
    "proxy741": (741, 730, 0, 3, 0, 6),
    "anny10pc": (1229, 0, 2454, 0, 0, None),
    "anny5pc": (615, 0, 1226, 0, 0, None),
}
IDENTITIES = ("neutral", "male_young", "female_old_heavy")
FACTS = {
    **{f"animals/{name}": facts for name, facts in ANIMALS.items()},
    **{f"heads/{name}": facts for name, facts in HEADS.items()},
    **{f"humans/{cage}_{identity}": facts for cage, facts in CAGES.items() for identity in IDENTITIES},
}
# The whole matrix on one identity of every small cage; the others pass whole.
QUICK = {name for name in FACTS if not name.startswith("humans/") or ("neutral" in name and FACTS[name][0] < 5000)}
MESHES = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in FACTS]


@pytest.fixture(scope="module", params=MESHES)
def named(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, ControlMesh]:
    return request.param, read_mesh(shared_data / f"{request.param}.obj")


@pytest.fixture(scope="module", params=["creature", *sorted(QUICK)])
def mesh(request: pytest.FixtureRequest) -> ControlMesh:
    """A built-in shape, and one mesh of every connectivity of fewer than 5000 vertices."""
    if request.param == "creature":
        return creature()
    return read_mesh(request.getfixturevalue("shared_data") / f"{request.param}.obj")


@pytest.fixture(scope="module")
def unchanged(mesh: ControlMesh) -> MeshReport:
    return check_mesh(mesh)


def turned(mesh: ControlMesh, faces: IndexArray) -> ControlMesh:
    """Reverse the corners of some faces, in place and vectorised: corner i of a face becomes corner size - i."""
    corners = np.arange(len(mesh.face_indices))
    chosen = np.zeros(mesh.n_faces, dtype=bool)
    chosen[faces] = True
    first, last = mesh.face_offsets[:-1][mesh.corner_faces], mesh.face_offsets[1:][mesh.corner_faces] - 1
    order = np.where(chosen[mesh.corner_faces], first + last - corners, corners)
    uv_indices = None if mesh.uv_indices is None else mesh.uv_indices[order]
    return replace(mesh, face_indices=mesh.face_indices[order], uv_indices=uv_indices)


def together(mesh: ControlMesh, other: ControlMesh, *, shift: int) -> ControlMesh:
    """Faces of both over the vertices of both (shift = number of vertices) or over the same ones (shift = 0)."""
    return ControlMesh(
        np.concatenate([mesh.positions, other.positions]) if shift else mesh.positions,
        np.concatenate([mesh.face_offsets, mesh.face_offsets[-1] + other.face_offsets[1:]]),
        np.concatenate([mesh.face_indices, other.face_indices + shift]),
        name=mesh.name,
    )


def without_loose_vertices(mesh: ControlMesh) -> ControlMesh:
    used, indices = np.unique(mesh.face_indices, return_inverse=True)
    return replace(mesh, positions=mesh.positions[used], face_indices=indices)


def require_valid_as(report: MeshReport, mesh: ControlMesh) -> None:
    """`require_valid`, which asks for the report of the mesh once more: it is given."""
    with patch("cagemap.mesh.checks.check_mesh", return_value=report) as asked:
        try:
            require_valid(mesh)
        finally:
            assert asked.call_args.args[0] is mesh


def sole_problem(mesh: ControlMesh) -> tuple[str, tuple[object, ...]]:
    report = check_mesh(mesh)
    assert len(report.problems) == 1, str(report)
    with pytest.raises(InvalidMeshError, match=report.problems[0].kind):
        require_valid_as(report, mesh)
    return report.problems[0].kind, report.problems[0].elements


def some_faces(mesh: ControlMesh, part: float) -> IndexArray:
    rng = np.random.default_rng(20190707)
    return np.sort(rng.choice(mesh.n_faces, max(1, int(part * mesh.n_faces)), replace=False))


def test_whole_mesh_passes_with_the_counts_of_its_readme(named: tuple[str, ControlMesh]) -> None:
    name, mesh = named
    vertices, quads, triangles, ngons, loops, islands = FACTS[name]
    report = check_mesh(mesh)
    assert report.is_valid, str(report)
    sizes = dict(report.face_sizes)
    assert report.n_vertices == vertices
    assert (sizes.get(4, 0), sizes.get(3, 0)) == (quads, triangles)
    assert sum(n for size, n in sizes.items() if size > 4) == ngons
    assert report.genus == 0
    assert [len(loop) for loop in report.boundary_loops or ()] == [46] * loops
    assert report.uv_islands == islands
    assert report.component_sizes == (mesh.n_faces,)


@pytest.mark.slow
def test_smallest_faces_and_coincident_vertices_pass_at_any_scale(shared_data: Path) -> None:
    for name in ("soma18056_male_young", "base_female_old_heavy"):
        mesh = read_mesh(shared_data / "humans" / f"{name}.obj")
        for scale in (1e-6, 1e6):
            require_valid(mesh.with_positions(scale * mesh.positions))
    np.testing.assert_array_equal(mesh.positions[6392], mesh.positions[12989])  # the two are there to be met


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scaled_mesh_passes_alike(mesh: ControlMesh, unchanged: MeshReport, scale: float) -> None:
    assert check_mesh(mesh.with_positions(scale * mesh.positions)) == unchanged


def test_flipped_faces_are_exactly_those_named(mesh: ControlMesh) -> None:
    for part in (0.0, 0.1, 0.4):  # 0: a single face
        faces = some_faces(mesh, part)
        assert sole_problem(turned(mesh, faces)) == ("inconsistent orientation", tuple(faces.tolist()))
    assert sole_problem(turned(mesh, np.arange(mesh.n_faces))) == ("inside out", ())


def test_copied_faces_are_exactly_those_named(mesh: ControlMesh) -> None:
    for part in (0.0, 0.3, 1.0):
        again = keep_faces(mesh, some_faces(mesh, part))
        for copy in (again, turned(again, np.arange(again.n_faces))):
            copies = tuple(range(mesh.n_faces, mesh.n_faces + copy.n_faces))
            assert sole_problem(together(mesh, copy, shift=0)) == ("duplicate faces", copies)


def test_second_copy_of_the_mesh_is_named(mesh: ControlMesh) -> None:
    both = together(mesh, mesh, shift=mesh.n_vertices)
    assert sole_problem(both) == ("several components", (0, mesh.n_faces))
    assert "copy of another" in str(check_mesh(both))


def half(mesh: ControlMesh) -> IndexArray:
    """Faces whose first corner lies on the left of the middle, which cuts legs, ears and UV islands."""
    x = mesh.positions[mesh.face_indices[mesh.face_offsets[:-1]], 0]
    return np.flatnonzero(x > np.median(mesh.positions[:, 0]))


def ball(mesh: ControlMesh) -> IndexArray:
    """All but the faces at the vertices nearest to one of them."""
    distance = np.linalg.norm(mesh.positions - mesh.positions[mesh.n_vertices // 3], axis=1)
    near = distance < 0.1 * np.ptp(mesh.positions, axis=0).max()
    return np.flatnonzero(~np.logical_or.reduceat(near[mesh.face_indices], mesh.face_offsets[:-1]))


def scattered(mesh: ControlMesh) -> IndexArray:
    return np.setdiff1d(np.arange(mesh.n_faces), some_faces(mesh, 0.2))


def single(mesh: ControlMesh) -> IndexArray:
    return np.array([mesh.n_faces // 2])


CUTS: list[Callable[[ControlMesh], IndexArray]] = [half, ball, scattered, single]


@pytest.mark.parametrize("cut", CUTS, ids=lambda cut: cut.__name__)
def test_cut_mesh_passes_with_a_boundary_or_is_named(mesh: ControlMesh, cut: Callable[..., IndexArray]) -> None:
    loose = keep_faces(mesh, cut(mesh))
    if len(np.unique(loose.face_indices)) < loose.n_vertices:
        assert "isolated vertices" in [problem.kind for problem in check_mesh(loose).problems]
    whole = without_loose_vertices(loose)
    report = check_mesh(whole)
    assert {problem.kind for problem in report.problems} <= {"non-manifold vertices", "several components"}
    assert report.boundary_loops
    if report.is_valid:
        assert report.genus == 0
        require_valid_as(report, whole)
    elif report.problems[0].kind == "non-manifold vertices":
        assert pinched(whole) == set(report.problems[0].elements)


def pinched(mesh: ControlMesh) -> set[int]:
    """Vertices with more than two boundary edges, which is what a cut makes of a manifold mesh."""
    heads = mesh.face_indices[mesh.next_corners]
    steps = np.sort(np.column_stack([mesh.face_indices, heads]), axis=1)
    edges, counts = np.unique(steps, axis=0, return_counts=True)
    at_vertex = np.bincount(edges[counts == 1].ravel())
    return set(np.flatnonzero(at_vertex > 2).tolist())


def test_abuse_survives_the_way_through_files(mesh: ControlMesh, tmp_path: Path) -> None:
    abused = [
        turned(mesh, some_faces(mesh, 0.1)),
        together(mesh, mesh, shift=mesh.n_vertices),
        keep_faces(mesh, half(mesh)),
    ]
    for i, before in enumerate(abused):
        file = tmp_path / f"{i}{'.obj' if i % 2 else '.ply'}"
        write_mesh(file, before)
        after = check_mesh(read_mesh(file))
        assert after.problems == check_mesh(before).problems


def test_empty_creases_corners_and_holes_are_none(mesh: ControlMesh, unchanged: MeshReport) -> None:
    none = np.zeros(0, dtype=np.int64)
    creases = {"crease_edges": none.reshape(0, 2), "crease_sharpness": np.zeros(0)}
    corners = {"corner_vertices": none, "corner_sharpness": np.zeros(0)}
    assert check_mesh(replace(mesh, **creases, **corners, hole_faces=none)).problems == unchanged.problems
