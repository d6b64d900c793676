"""Plain meshes from files to results: every method, wrap, the studio and the store of prepared surfaces."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.files.images.image import read_image, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.files.result.surface_store import load_or_prepare
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import join_meshes
from cagemap.pipeline import update_match
from cagemap.studio.compute import FindMap, OpenModels, PairFiles, _suggested_vertex, run_task
from cagemap.studio.landmarks import LandmarkList
from cagemap.subdivision import refine
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.wrap import run_wrap

from plain_meshes import animal, ball, far_apart, marks_at, soup


def _scan_files(folder: Path) -> list[str]:
    """Options of a match of two plain files with eight landmarks: a creature, and the same one taller."""
    mesh = animal(2)
    taller = mesh.with_positions(mesh.positions * (1.0, 1.2, 1.0))
    names = ("scan.ply", "taller.ply")
    for name, one in zip(names, (mesh, taller), strict=True):
        write_mesh(folder / name, one)
    marks = far_apart(creature().positions, 8)
    write_landmarks(folder / "marks.json", marks_at(marks, *names))
    given = (*zip(("--target", "--source"), names, strict=True), ("--landmarks", "marks.json"))
    return ["--scheme", "none", *(str(word) for option, name in given for word in (option, folder / name))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "worst"),
    [((), 0.01), (("--method", "hfm"), 0.03), (("--method", "paper", "--set", "schedule=60,40"), 0.08)],
)
def test_every_method_matches_plain_files(options: tuple[str, ...], worst: float, tmp_path: Path) -> None:
    outcome = CliRunner().invoke(app, ["match", *_scan_files(tmp_path), *options, "-o", str(tmp_path / "RESULT")])
    assert outcome.exit_code == 0, outcome.output
    result = read_result(tmp_path / "RESULT")
    assert result.target.refinement.finest_level == 0
    wanted = result.target.vertices * (1.0, 1.2, 1.0)
    assert np.linalg.norm(result.image() - wanted, axis=1).mean() < worst * np.ptp(wanted, axis=0).max()


@pytest.mark.slow
def test_the_studio_maps_plain_files_and_goes_on_from_another_answer(tmp_path, monkeypatch, quick_fit):
    asked = []
    monkeypatch.setattr(
        "cagemap.studio.compute.suggested_vertices", lambda *given: asked.append(given) or np.array([0])
    )
    places = [tmp_path / "scan.usda", tmp_path / "taller.usda"]
    mesh = animal(2)
    for place, height in zip(places, (1.0, 1.2), strict=True):
        write_mesh(place, mesh.with_positions(mesh.positions * (1.0, height, 1.0)))
    opening = PairFiles(*places, None, 5000, tmp_path)
    cache, opened = run_task(None, OpenModels(opening), lambda stage: None)
    assert len(opened.scene.target.positions) == mesh.n_vertices
    cache, found = run_task(cache, FindMap(opening, LandmarkList()), lambda stage: None)
    wanted = mesh.positions * (1.0, 1.2, 1.0)
    assert np.linalg.norm(cache.result.image() - wanted, axis=1).mean() < 0.02 * np.ptp(wanted, axis=0).max()
    # The next landmark is asked for where other answers differ, in the mesh's own numbers: were another one chosen, the
    # first would be such an answer.
    _suggested_vertex(replace(cache, chosen_answer=1), cache.result)
    images, runners_up = asked[-1][1:3]
    assert len(runners_up) == max(1, len(found.map_state.answers) - 1)
    assert np.linalg.norm(runners_up[0] - images, axis=1).mean() < 0.02 * np.ptp(images, axis=0).max()
    for other in range(1, len(found.map_state.answers)):
        cache, chosen = run_task(cache, FindMap(opening, LandmarkList(), answer=other), lambda stage: None)
        assert chosen.map_state.chosen_answer == other


@pytest.mark.slow
def test_files_to_result_and_back(tmp_path: Path) -> None:
    scan = join_meshes([animal(2), replace(ball(0), positions=ball(0).positions * 1e-3 + 5.0)])
    write_mesh(tmp_path / "scan.ply", soup(scan))
    write_mesh(tmp_path / "cage.obj", creature())
    request = MatchRequest(
        target=tmp_path / "cage.obj",
        source=tmp_path / "scan.ply",
        output=tmp_path / "RESULT",
        vertices=2000,
        source_scheme="none",
        cache=tmp_path / "cache",
    )
    _, warnings = run_match(request, Stages())
    assert any("1 other piece set aside" in text for text in warnings)
    result = read_result(tmp_path / "RESULT")
    assert result.source.refinement.finest_level == 0
    assert result.target.refinement.finest_level > 0
    assert result.manifest["repairs"]["source"]["pieces"] == 1
    places = np.linalg.norm(result.image() - result.target.vertices, axis=1)
    assert places.mean() < 0.01 * np.ptp(scan.positions, axis=0).max()
    again = update_match(result, result.landmarks)
    assert np.linalg.norm(again.image() - result.image(), axis=1).max() < 0.01 * np.ptp(scan.positions, axis=0).max()
    assert result.functional_map.shape == (100, 100)


@pytest.mark.slow
def test_a_cage_is_wrapped_onto_a_scan_with_its_colours_and_texture(tmp_path: Path, quick_fit: None) -> None:
    """Colours and texture of the scan are its places, which the wrapped cage's own places must repeat."""
    scan = animal(1)
    low, size = scan.positions.min(axis=0), np.ptp(scan.positions, axis=0)
    rng = np.random.default_rng(5)
    noisy = scan.positions + rng.normal(scale=1e-3 * size.max(), size=scan.positions.shape)
    kept = np.linalg.norm(scan.positions[scan.face_indices.reshape(-1, 3)[:, 0]] - scan.positions[40], axis=1) > 0.4
    faces = scan.face_indices.reshape(-1, 3)[kept]
    colors = np.clip((scan.positions - low) / size, 0.0, 1.0)
    open_scan = ControlMesh(noisy, np.arange(0, faces.size + 1, 3), faces.ravel(), vertex_colors=colors)
    open_scan = open_scan.with_uvs(colors[:, :2] * 0.98 + 0.01, faces.ravel())
    stray = replace(ball(0), positions=ball(0).positions * 0.05 + low - 2.0, vertex_colors=np.ones((12, 3)))
    write_mesh(tmp_path / "scan.obj", join_meshes([open_scan, stray]))
    cage = creature()
    corners = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (cage.n_faces, 1))
    side = int(np.ceil(np.sqrt(cage.n_faces)))
    cells = np.repeat(np.column_stack(np.divmod(np.arange(cage.n_faces), side)), 4, axis=0)
    write_mesh(tmp_path / "cage.obj", cage.with_uvs((0.1 + 0.8 * corners + cells) / side, np.arange(4 * cage.n_faces)))
    ramp = np.linspace(0.0, 1.0, 256)
    across, up = np.meshgrid(ramp, ramp[::-1])
    write_image(tmp_path / "scan.png", np.rint(255 * np.stack([across, up, 0 * up], axis=2)).astype(np.uint8))
    request = WrapRequest(
        (),
        tmp_path / "wrapped.obj",
        tmp_path / "cage.obj",
        tmp_path / "scan.obj",
        source_scheme="none",
        colors=tmp_path / "colors.png",
        texture=tmp_path / "scan.png",
        baked=tmp_path / "baked.png",
        size=64,
    )
    _, warnings = run_wrap(request, Stages())
    assert any("set aside" in text for text in warnings)
    wrapped = read_mesh(tmp_path / "wrapped.obj")
    assert np.array_equal(wrapped.face_indices, cage.face_indices)
    found = refine(wrapped, 2).finest.positions
    _, _, distance = closest_points(build_tree(scan.positions, faces), found)
    assert np.sqrt(np.mean(distance**2)) < 0.02 * size.max()
    painted, carried = (read_image(tmp_path / name).pixels[..., :2] / 255.0 for name in ("colors.png", "baked.png"))
    inside = painted.sum(axis=2) > 0
    # Two ways to the same places: interpolated colours, and a ramp of 256 levels.
    assert np.abs(painted - (carried - 0.01) / 0.98)[inside].mean() < 0.02


@pytest.mark.slow
def test_a_stored_plain_surface_is_the_prepared_one(tmp_path: Path) -> None:
    mesh = animal(2)
    first, second = (load_or_prepare(tmp_path, mesh, 0) for _ in range(2))
    assert len(list(tmp_path.iterdir())) == 1
    assert np.array_equal(first.basis.eigenvalues, second.basis.eigenvalues)
    assert np.array_equal(first.hierarchy.coarse_vertices, second.hierarchy.coarse_vertices)
