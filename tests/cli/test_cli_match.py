"""`cagemap match` on files: inputs, defaults, options of one side or method, output, messages and the manifest."""

import inspect
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import shapes
from examples.shapes import cube

from cagemap.errors import FormatError, ParameterError, use_option_names
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.landmarks.points import read_symmetry
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.files.result.manifest import file_hash
from cagemap.files.result.surface_store import load_or_prepare
from cagemap.mesh import Bilinear, CatmullClark
from cagemap.mesh.cage_points import NamedPoints
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.operators import build_operators, named_laplacian
from cagemap.pipeline import MAP_BASIS, MatchConfig, default_basis, prepare_surface, prepare_surfaces
from cagemap.spectral import BasisConfig, hierarchical_basis
from cagemap.tasks.functions import run_functions
from cagemap.tasks.match import MatchRequest, match_config, read_inputs, run_match
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.method import (
    basis_config,
    require_level_or_vertices,
    side_bases,
    side_levels,
    used_parameters,
    with_parameters,
)
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.functions import FunctionsRequest
from cagemap.tasks.requests.mesh_commands import RefineRequest
from cagemap.tasks.subdivision import SubdivisionRequest

from command_line import MATCH, Run
from refusals import refuses

COARSE = ["--level", 1, "-k", 20, "--set", "method.search_vertices=300"]


@pytest.mark.slow
def test_a_match_without_landmarks_says_how_sure_it_is(run: Run, tmp_path: Path, quick_fit: None) -> None:
    """Two boxes, of which every half turn is an answer."""
    for name, depth in (("deer.obj", 1.4), ("pony.obj", 1.9)):
        write_mesh(tmp_path / name, cube().with_positions(cube().positions * [1.0, 1.2, depth]))
    outcome = run.done("match", *MATCH[:4], "--vertices", 300, "-k", 20, "-o", "R")
    assert "no landmarks" in outcome.out
    result = read_result(tmp_path / "R")
    said = result.manifest["confidence"]
    assert said["verdict"] in ("sure", "look at it", "two answers")
    told = use_option_names(said["message"])
    assert told in (outcome.out if said["verdict"] == "sure" else outcome.err)
    assert len(result.runner_up_images) == len(said["readings"]) - 1 > 0
    assert run("report R").code == 0


@pytest.mark.slow
def test_landmarks_come_from_one_file_for_each_mesh(run: Run, pair_files: Path, one_start: None) -> None:
    landmarks = read_landmarks(pair_files / "landmarks.json", "deer.obj", "pony.obj")[0]
    for side, vertices in (("deer", landmarks.target), ("pony", landmarks.source)):
        mesh = read_mesh(pair_files / f"{side}.obj")
        names = (*landmarks.names, f"only {side}")
        points = NamedPoints(names, np.append(vertices, 0), np.full((len(names), 3), np.nan))
        write_points(pair_files / f"{side}.pp", points, mesh)
    files = ["--target-points", "deer.pp", "--source-points", "pony.pp"]
    outcome = run.done("match", *MATCH[:4], *files, *COARSE, "-o", "R")
    assert "only deer" in outcome.err
    found = read_result(pair_files / "R")
    assert found.landmarks.names == landmarks.names
    np.testing.assert_array_equal(found.landmarks.target, landmarks.target)
    for words in ((*MATCH, *files), (*MATCH[:4], *files[:2])):
        run.refused("match", *words, "-o", "S", says="expected both, and no --landmarks beside them")


def test_match_from_files_to_a_result(run: Run, pair_files: Path, one_start: None) -> None:
    outcome = run.done("match", *MATCH, *COARSE, "-o", "R")
    assert "deer.obj" in outcome.out
    result = read_result(pair_files / "R")
    assert (result.target.finest_level, result.functional_map.shape) == (1, (20, 20))
    assert (result.barycentric >= -1e-12).all()
    np.testing.assert_allclose(result.barycentric.sum(1), 1.0, atol=1e-12)
    manifest = result.manifest
    assert manifest["parameters"]["target_k"] == manifest["parameters"]["source_k"] == 20
    assert manifest["inputs"]["target"]["sha256"] == file_hash(pair_files / "deer.obj")
    assert manifest["timings"]["first alignment"] > 0
    assert manifest["peak_memory_bytes"] > 2**20
    assert manifest["notes"] == []


@pytest.mark.slow
def test_a_wrong_landmark_is_left_out_with_a_warning_unless_trusted(run, pair_files, built_in_pair, quick_fit):
    pair = built_in_pair
    names = pair.landmarks.names
    source = pair.landmarks.source.copy()
    wrong = names.index("hoof_hind_L")
    away = np.linalg.norm(pair.source.positions - pair.source.positions[source[wrong]], axis=1)
    away[source] = 0.0
    source[wrong] = np.argmax(away)
    write_landmarks(pair_files / "landmarks.json", replace(pair.landmarks, source=source))
    outcome = run.done("match", *MATCH, *COARSE, "-o", "R")
    said = " ".join(outcome.err.split())
    assert "landmark 'hoof_hind_L' looks wrong and was left out" in said
    assert "--trust-landmarks" in said
    met = re.search(r"(\d+) landmarks missed by 0.00 % .*; 1 left out, which the map misses by (\d+) %", outcome.out)
    assert int(met[1]) == len(names) - 1
    assert int(met[2]) > 5  # across the body
    result = read_result(pair_files / "R")
    assert [suspect["name"] for suspect in result.manifest["landmark_check"]["suspects"]] == ["hoof_hind_L"]
    assert result.landmark_errors[wrong] > 0.3
    assert np.delete(result.landmark_errors, wrong).max() < 1e-9
    outcome = run("match", *MATCH, *COARSE, "-o", "R", "--trust-landmarks")
    assert "looks wrong" not in outcome.err
    assert read_result(pair_files / "R").landmark_errors.max() < 1e-9


def test_exchanged_meshes_are_refused_and_other_names_noted(run: Run, pair_files: Path) -> None:
    run.refused(
        "match --target pony.obj --source deer.obj", *MATCH[4:], "--level", 1, "-o", "R", says="other way round"
    )
    assert not (pair_files / "R").exists()
    (pair_files / "deer.obj").rename(pair_files / "stag.obj")
    request = MatchRequest(*(pair_files / name for name in ("stag.obj", "pony.obj", "R", "landmarks.json")))
    (note,) = read_inputs(request).notes
    assert "stag.obj" in note


def test_command_line_and_library_have_the_same_defaults() -> None:
    asked = MatchRequest(*[Path("x")] * 4)
    assert basis_config(asked) == MAP_BASIS
    assert match_config(asked) == MatchConfig()
    for prepare in (prepare_surface, prepare_surfaces, load_or_prepare):
        assert inspect.signature(prepare).parameters["config"].default == MAP_BASIS


def test_options_reach_the_library() -> None:
    paths = [Path("x")] * 4
    asked = MatchRequest(*paths, k=77, accuracy=1e-7, symmetry=False)
    assert basis_config(asked) == replace(MAP_BASIS, count=77, accuracy=1e-7)
    assert not match_config(asked).use_symmetry
    assert match_config(asked).check_landmarks
    assert not match_config(MatchRequest(*paths, trust_landmarks=True)).check_landmarks
    assert basis_config(MatchRequest(*paths, schedule="100,50,50")).schedule == (100, 50, 50)


def test_a_broken_mesh_is_refused_before_any_work(run: Run, pair_files: Path) -> None:
    lines = (pair_files / "deer.obj").read_text().splitlines()
    faces = [number for number, line in enumerate(lines) if line.startswith("f ")]
    lines[faces[3]] = "f " + " ".join(reversed(lines[faces[3]].split()[1:]))
    (pair_files / "deer.obj").write_text("\n".join(lines) + "\n")
    refused = run.refused("match", *MATCH, "--level", 1, "-o", "R", says="inconsistent orientation")
    assert "3" in refused.err


def files_of(folder):
    """The creature mapped to itself: meshes, landmarks and its symmetry as files."""
    mesh = shapes.creature()
    for side in ("target", "source"):
        write_mesh(folder / f"{side}.obj", mesh)
    chosen = [int(vertex) for vertex in np.linspace(0, mesh.n_vertices - 1, 8).astype(int)]
    pairs = [{"name": f"p{v}", "source": v, "target": v} for v in chosen]
    (folder / "l.json").write_text(json.dumps({"source": "source.obj", "target": "target.obj", "pairs": pairs}))
    image = mirror_symmetries(mesh)[0].image
    (folder / "s.json").write_text(json.dumps(image.tolist()))
    (folder / "s.txt").write_text("\n".join(map(str, image)))
    np.save(folder / "s.npy", image)
    return [folder / name for name in ("target.obj", "source.obj", "l.json")], image


def test_other_search_levels_and_exact_bases_get_the_operators_of_the_finest_level(tmp_path):
    words = {"target": tmp_path, "source": tmp_path, "landmarks": tmp_path, "output": tmp_path, "method": "hfm"}
    assert side_bases(MatchRequest(**words)) == (default_basis("hfm"), default_basis("hfm"))
    assert default_basis("hfm").vertices == MAP_BASIS.vertices
    for more in ({"parameter": ("search_vertices=50000",)}, {"schedule": "100,50"}):
        assert [basis.vertices for basis in side_bases(MatchRequest(**words, **more))] == [None, None]


@pytest.mark.slow
def test_each_side_has_its_own_level_and_schedule(tmp_path):
    """The paper's Table 1, and the manifest says what was used."""
    paths, _ = files_of(tmp_path)
    request = MatchRequest(
        *paths[:2], tmp_path / "R", paths[2], method="paper", target_level=2, source_level=1, target_schedule="12,6,4",
        source_schedule="10,8", parameter=("rounds=0", "laplacian=0.01", "heat=4"),
        target_symmetry=(tmp_path / "s.json",), source_symmetry=(tmp_path / "s.npy",),
    )  # fmt: skip
    run_match(request, Stages())
    result = read_result(tmp_path / "R")
    assert result.functional_map.shape == (22, 18)
    used = result.manifest["parameters"]
    assert (used["target_level"], used["source_level"]) == (2, 1)
    assert (used["target_schedule"], used["source_schedule"]) == ([12, 6, 4], [10, 8])
    assert (used["spectral"]["laplacian"], used["spectral"]["heat"], used["spectral"]["rounds"]) == (0.01, 4, 0)


def test_the_paper_s_schedule_has_as_many_levels_as_the_surface(tmp_path):
    """Where none is given; a number of functions replaces it."""
    words = {"target": tmp_path, "source": tmp_path, "landmarks": tmp_path, "output": tmp_path, "method": "paper"}
    target, source = side_bases(MatchRequest(**words), (1, 3))
    assert (target.schedule, source.schedule) == ((50, 100), (50, 100))
    assert side_bases(MatchRequest(**words, k=40), (1, 3))[0] == BasisConfig(count=40)
    assert side_bases(MatchRequest(**words, schedule="9,5"), (1, 3))[1].schedule == (9, 5)


def test_one_side_alone_leaves_the_other_as_it_is(tmp_path):
    request = MatchRequest(tmp_path, tmp_path, tmp_path, tmp_path, schedule="9,5", source_k=40)
    target, source = side_bases(request)
    assert target.schedule == (9, 5)
    assert (source.schedule, source.count) == (None, 40)


def test_each_side_has_its_own_number_of_vertices(tmp_path):
    """`--target-vertices` goes before `--level` and `--vertices`, which are the other side's then."""
    controls = [shapes.creature()] * 2
    request = MatchRequest(tmp_path, tmp_path, tmp_path, tmp_path, target_vertices=2400, vertices=600)
    assert side_levels(request, controls) == (2, 1)
    request = MatchRequest(tmp_path, tmp_path, tmp_path, tmp_path, source_vertices=2400, level=1)
    assert side_levels(request, controls) == (1, 2)
    for words in ({"level": 1, "vertices": 5}, {"target_level": 1, "target_vertices": 5}):
        with pytest.raises(ParameterError, match=r"level and --.*vertices: expected one of them, got both"):
            require_level_or_vertices(MatchRequest(tmp_path, tmp_path, tmp_path, tmp_path, **words))


@pytest.mark.slow
def test_each_side_has_its_own_laplacian_accuracy_and_definition(tmp_path):
    """What is computed follows, and the manifest says it: eigenvalues differ from those of the usual Laplacian."""
    paths, _ = files_of(tmp_path)
    request = MatchRequest(
        *paths[:2], tmp_path / "R", paths[2], method="paper", level=1, schedule="12,6", laplacian="alexa-wardetzky:2",
        source_laplacian="mean", accuracy=1e-8, target_accuracy=1e-10, source_literal=True, symmetry=False,
        parameter=("rounds=0",),
    )  # fmt: skip
    run_match(request, Stages())
    result = read_result(tmp_path / "R")
    used = result.manifest["parameters"]
    assert (used["target_laplacian"], used["target_stabilisation"], used["source_laplacian"]) == (
        "alexa-wardetzky", 2.0, "mean",
    )  # fmt: skip
    assert (used["target_accuracy"], used["source_accuracy"]) == (1e-10, 1e-8)
    assert (used["target_literal"], used["source_literal"]) == (False, True)
    asked = BasisConfig(schedule=(12, 6), accuracy=1e-10, laplacian="alexa-wardetzky", stabilisation=2.0)
    assert result.target.config == asked
    operators = build_operators(result.target.refinement, named_laplacian("alexa-wardetzky", 2.0))
    basis = hierarchical_basis(result.target.refinement, operators, asked)
    np.testing.assert_allclose(result.spectral.target_eigenvalues, basis.eigenvalues, rtol=1e-9, atol=1e-9)
    assert abs(result.spectral.target_eigenvalues[5] / result.spectral.source_eigenvalues[5] - 1) > 1e-3
    # What was read is prepared again with the same Laplacian.
    np.testing.assert_allclose(result.target.basis.eigenvalues, basis.eigenvalues, rtol=1e-9, atol=1e-9)


def test_options_of_landmarks_and_symmetries_that_nothing_reads_are_named(tmp_path):
    (target, *_), _ = files_of(tmp_path)
    words = {"exchange_landmarks": True, "trust_landmarks": True, "symmetry": False}
    notes = read_inputs(MatchRequest(target, target, tmp_path / "R", **words)).notes
    assert [note.partition(" is not used")[0] for note in notes] == [
        "--exchange-landmarks",
        "--trust-landmarks",
        "--no-symmetry",
    ]


@pytest.mark.parametrize(("scheme", "unused"), [("none", True), ("bilinear", True), ("catmull-clark", False)])
def test_subdivision_options_of_schemes_without_them_are_named(tmp_path, scheme: str, unused: bool):
    (target, *_), _ = files_of(tmp_path)
    words = {"boundary": "edge-only", "uv_interpolation": "none", "creasing": "chaikin"}
    notes = read_inputs(MatchRequest(target, target, tmp_path / "R", scheme=scheme, **words)).notes
    named = [note.partition(" is not used")[0] for note in notes if "is not used" in note]
    assert named == (["--boundary", "--uv-interpolation", "--creasing"] if unused else [])
    one = MatchRequest(target, target, tmp_path / "R", target_scheme=scheme, source_scheme="catmull-clark", **words)
    assert not any("is not used" in note for note in read_inputs(one).notes)


def test_parameters_reach_the_method_they_belong_to():
    paper = MatchConfig(method="paper")
    assert used_parameters(with_parameters(paper, ["rounds=3"]))["rounds"] == 3
    for word, value in {"yes": True, "no": False, "True": True, "False": False}.items():
        assert with_parameters(paper, [f"orthonormal={word}"]).paper.orthonormal is value
    refuses(ParameterError, "expected yes or no, got '2'", with_parameters, paper, ["orthonormal=2"])
    hfm = with_parameters(MatchConfig(method="hfm"), ["last=80", "signature_weight=0", "wave=4"]).hfm
    assert (hfm.zoomout.last, hfm.signature_weight, hfm.wave) == (80, 0.0, 4)
    used = used_parameters(MatchConfig(method="hfm", hfm=hfm))
    assert (used["last"], used["wave"], used["factor"]) == (80, 4, hfm.zoomout.factor)
    assert with_parameters(MatchConfig(), ["first=12"]).start.zoomout.first == 12
    assert with_parameters(MatchConfig(), ["trusted_functions=6,12,24"]).start.trusted_functions == (6, 12, 24)
    assert with_parameters(MatchConfig(), []) == MatchConfig()


def test_a_tuple_among_parameters_has_commas_between_its_numbers():
    with pytest.raises(ParameterError, match="expected a whole number, or several with commas between them, got '8,x'"):
        with_parameters(MatchConfig(), ["trusted_functions=8,x"])


def test_symmetry_files(tmp_path):
    _, image = files_of(tmp_path)
    for name in ("s.json", "s.npy"):
        (tmp_path / name.upper()).write_bytes((tmp_path / name).read_bytes())
    for name in ("s.json", "s.txt", "s.npy", "S.JSON", "S.NPY"):
        np.testing.assert_array_equal(read_symmetry(tmp_path / name), image)
    for name, content in (("a.json", '{"a": 1}'), ("b.txt", "1 2 x"), ("c.json", "[1.5]"), ("d.json", "[]")):
        (tmp_path / name).write_text(content)
        refuses(FormatError, "one vertex number for every control vertex", read_symmetry, tmp_path / name)
    with pytest.raises(ParameterError, match="as many files for one side as for the other, got 1 and 0"):
        match_config(MatchRequest(tmp_path, tmp_path, tmp_path, tmp_path, target_symmetry=(tmp_path / "s.npy",)))


def test_symmetries_that_the_method_does_not_use_are_refused(tmp_path):
    files_of(tmp_path)
    files = {f"{side}_symmetry": (tmp_path / "s.npy",) for side in ("target", "source")}
    with pytest.raises(ParameterError, match="symmetries: expected the method paper or hfm"):
        match_config(MatchRequest(tmp_path, tmp_path, tmp_path, tmp_path, **files))


@pytest.mark.parametrize(("scheme", "unused"), [("none", True), ("bilinear", True), ("catmull-clark", False)])
def test_refine_and_functions_name_subdivision_options_without_use(tmp_path, scheme: str, unused: bool):
    (target, *_), _ = files_of(tmp_path)
    words = {"scheme": scheme, "boundary": "edge-only", "creasing": "chaikin"}
    level = 0 if scheme == "none" else 1
    text, _ = run_refine(RefineRequest(target, level, tmp_path / "fine.obj", **words), Stages())
    _, notes = run_functions(FunctionsRequest(target, tmp_path / "f.npz", k=4, **words), Stages())
    for option in ("--boundary", "--creasing"):
        assert (f"{option} is not used" in text) == unused
        assert any(f"{option} is not used" in note for note in notes) == unused
    assert "--uv-interpolation" not in text


def test_subdivision_options_without_use_are_those_of_the_parts():
    named = [
        replace(mesh, face_objects=np.zeros(mesh.n_faces, dtype=np.int64), object_names=(name,), scheme=scheme)
        for mesh, name, scheme in ((shapes.creature(), "a", Bilinear()), (shapes.cube(), "b", CatmullClark()))
    ]
    whole = replace(join_meshes(named), object_schemes=(Bilinear(), CatmullClark()), scheme=None)
    parts = [extract_faces(whole, np.flatnonzero(whole.face_objects == i)) for i in range(2)]
    options = SubdivisionRequest(boundary="edge-only")
    assert [len(options.unused_notes([part])) for part in parts] == [1, 0]
