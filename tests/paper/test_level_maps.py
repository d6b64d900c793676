"""The maps of all levels in a RESULT folder: written, read, taken as results of their own, baked and drawn."""

import json
import shutil

import numpy as np
import pytest
from examples.shapes import creature

import cagemap
from cagemap import BasisConfig, PointMap, refine, research
from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import read_image, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import ARRAYS, read_result
from cagemap.files.result.manifest import MANIFEST, note_transfer
from cagemap.files.result.maps import read_images
from cagemap.maps.functional_maps import LevelMap
from cagemap.maps.pair import Pair
from cagemap.paper.method import recover_points
from cagemap.pipeline import MatchConfig, pair_of
from cagemap.tasks.import_map import run_map
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.report import ReportRequest, run_report
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_once import example_pair
from example_result import change_result, edit_manifest, identity_result
from refusals import refuses


@pytest.fixture(scope="module")
def matched(tmp_path_factory):
    """The built-in pair by the paper's method, the sides with levels and schedules of their own."""
    folder = tmp_path_factory.mktemp("levels")
    example = example_pair(64)
    paths = [folder / name for name in ("deer.obj", "pony.obj", "l.json")]
    write_mesh(paths[0], example.target)
    write_mesh(paths[1], example.source)
    write_landmarks(paths[2], example.landmarks)
    write_image(folder / "pony.png", example.texture)
    request = MatchRequest(
        *paths[:2], folder / "R", paths[2], method="paper", target_level=1, source_level=2, target_schedule="40,20",
        source_schedule="40,20,10",
    )  # fmt: skip
    run_match(request, Stages())
    return folder


@pytest.fixture(scope="module")
def plain_pair() -> Pair:
    """A plain mesh with coarse levels and itself."""
    fine = refine(creature(), 2).finest
    mesh = cagemap.plain_mesh((fine.positions, fine.faces)).mesh
    surface = research.prepare(mesh, 0, BasisConfig(count=30))
    vertices = np.arange(0, mesh.n_vertices, 100)
    return research.make_pair(surface, surface, np.column_stack([vertices, vertices]))


def test_a_level_map_is_a_map_for_every_step(plain_pair: Pair) -> None:
    """Coarse levels of plain meshes have numbers of their own; arrays have those of the finest level."""
    surface = plain_pair.target
    numbers, n = surface.hierarchy.on_finest(0), surface.hierarchy.levels[0].n_vertices
    identity = LevelMap((0, 0), np.eye(30), np.arange(n))
    expected = research.functional_map_of(plain_pair, numbers)
    np.testing.assert_array_equal(research.functional_map_of(plain_pair, identity), expected)
    np.testing.assert_allclose(expected, np.eye(30), atol=1e-6)
    finest = np.arange(len(surface.vertices))
    whole = PointMap.from_vertices(*2 * (surface.finest_triangles,), finest)
    for levels in (plain_pair.levels(), list(plain_pair.levels())):
        assert research.point_map(plain_pair, LevelMap(levels, np.eye(30), finest, whole)) is whole  # type: ignore[arg-type]


def test_a_level_map_onto_low_numbers_is_a_map_for_every_step(plain_pair: Pair) -> None:
    """A part may be mapped to finest vertices below the number of coarse ones: as a level's map, and as an array."""
    numbers, n = plain_pair.source.hierarchy.on_finest(0), plain_pair.source.hierarchy.levels[0].n_vertices
    low = np.flatnonzero(numbers < n)
    match = low[np.arange(n) % len(low)]
    level_map = LevelMap((0, 0), np.eye(30), match)
    expected = research.functional_map_of(plain_pair, level_map)
    np.testing.assert_array_equal(research.functional_map_of(plain_pair, numbers[match]), expected)
    assert research.point_map(plain_pair, level_map).target.n == len(plain_pair.target.vertices)
    schedule = research.ZoomOutSchedule(first=10, last=20)
    np.testing.assert_array_equal(
        research.zoomout(plain_pair, level_map, schedule), research.zoomout(plain_pair, numbers[match], schedule)
    )


@pytest.mark.parametrize(
    ("levels", "entries", "first", "message"),
    [
        ((0, 9), 0, 0, "levels: expected"),
        ((0, 0), 1, 0, "map: expected a vertex of level 0 of the source"),
        ((1, 0), 0, 0, "map: expected a vertex of level 0 of the source"),
        (None, 0, 0, "map: expected a vertex of level"),
        ((0, 0), 0, 1, "map: expected a vertex of level 0 of the source"),
        ((0, 0), 0, -1, "map: expected a vertex of level 0 of the source"),
    ],
)
def test_a_level_map_of_other_levels_is_refused(
    plain_pair: Pair, levels: tuple[int, int], entries: int, first: int, message: str
) -> None:
    """Too many entries or entries of another level, and vertices that the source's level does not have."""
    counts = [level.n_vertices for level in plain_pair.target.hierarchy.levels]
    match = np.arange(first, counts[0] + first) if entries == 0 else np.arange(counts[1]) % counts[0]
    refuses(ParameterError, message, research.functional_map_of, plain_pair, LevelMap(levels, np.eye(30), match))


@pytest.mark.slow
def test_maps_of_all_levels_are_stored(matched):
    """C12, vertices and points of each, as the surfaces that are prepared anew give them."""
    result = read_result(matched / "R")
    assert [found.levels for found in result.level_maps] == [(0, 0), (1, 1), (1, 2)]
    assert [found.functional_map.shape for found in result.level_maps] == [(40, 40), (60, 60), (60, 70)]
    assert json.loads((matched / "R" / MANIFEST).read_text())["level_maps"][2] == {"target": 1, "source": 2}
    np.testing.assert_array_equal(result.functional_map, result.level_maps[-1].functional_map)
    assert result.level_maps[-1].points is result.point_map
    pair = pair_of(result.target, result.source, result.landmarks, MatchConfig())
    for found in result.level_maps:
        again = recover_points(pair, LevelMap(found.levels, found.functional_map, found.match))
        np.testing.assert_array_equal(again.triangle, found.points.triangle)
        np.testing.assert_allclose(again.barycentric, found.points.barycentric, atol=1e-5)  # rows are float32


def test_a_level_is_a_result_of_its_own(matched):
    """Of its surfaces, its landmarks missed by what this level misses, and with the leading eigenvalues."""
    result = read_result(matched / "R")
    coarse = result.at_level(0)
    assert (len(coarse.target.vertices), len(coarse.source.vertices)) == (
        result.target.control.n_vertices, result.source.control.n_vertices,
    )  # fmt: skip
    assert len(coarse.triangle) == result.target.control.n_vertices
    np.testing.assert_array_equal(coarse.spectral.source_eigenvalues, result.spectral.source_eigenvalues[:40])
    assert len(coarse.landmark_errors) == len(result.landmarks)
    assert np.abs(coarse.landmark_errors - result.landmark_errors).max() > 1e-3
    assert result.at_level(1) is result
    refuses(ParameterError, "level 2: expected one of the target's levels with a map, 0, 1", result.at_level, 2)
    refuses(ParameterError, "level 1: expected one of the target's levels with a map, 3", identity_result().at_level, 1)


@pytest.mark.slow
def test_a_level_is_baked_written_and_drawn(matched, small_pages):
    """Another picture than that of the finest level, a map of as many vertices, and a page."""
    images = []
    for level in (None, 0):
        output = matched / f"deer_{level}.png"
        request = TransferRequest(matched / "R", output, texture=matched / "pony.png", level=level, size=64)
        run_transfer(request, Stages())
        images.append(read_image(output).pixels[..., :3].astype(int))
    assert (np.abs(images[0] - images[1]).max(axis=2) > 20).mean() > 0.05
    result = read_result(matched / "R")
    with Stages() as stages:
        run_transfer(TransferRequest(matched / "R", matched / "m.npz", write_map=True, level=0), stages)
        run_report(ReportRequest(matched / "R", matched / "r.html", level=0), stages)
    places = read_images(matched / "m.npz", result.source.triangles(0))
    np.testing.assert_array_equal(places.triangle, result.level_maps[0].points.triangle)
    page = (matched / "r.html").read_text()
    assert f"{result.target.control.n_vertices:,}" in page
    with Stages() as stages, pytest.raises(FormatError, match="those of the file are of one with"):
        run_map(MapRequest(matched / "m.npz", matched / "deer.obj", matched / "pony.obj", matched / "M"), stages)


@pytest.mark.slow
def test_a_report_shows_what_its_level_baked(matched, monkeypatch):
    """The image of the level that is shown, not the last one; and no wrapped net that this level has not."""
    shown = {}
    monkeypatch.setattr("cagemap.tasks.report.write_report", lambda output, *_, **given: shown.update({output: given}))
    with Stages() as stages:
        for level in (None, 0):
            output = matched / f"shown_{level}.png"
            given = TransferRequest(matched / "R", output, texture=matched / "pony.png", level=level, size=64)
            run_transfer(given, stages)
        write_mesh(matched / "net.obj", example_pair(64).target)
        note_transfer(matched / "R", {"kind": "wrap", "output": "../net.obj", "fit_level": 1})
        for level in (None, 0, 1):
            run_report(ReportRequest(matched / "R", matched / f"{level}.html", level=level), stages)
    for level, baked in ((None, None), (0, 0), (1, None)):
        expected = read_image(matched / f"shown_{baked}.png").pixels
        np.testing.assert_array_equal(shown[matched / f"{level}.html"]["baked"], expected)


@pytest.fixture
def copied(matched, tmp_path):
    """A copy of the result whose files may be changed."""
    for name in (MANIFEST, ARRAYS):
        shutil.copy(matched / "R" / name, tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["level_0_match", "level_1_triangle", "level_0_functional_map"])
def test_damaged_levels_are_refused(copied, name):
    """An array that is gone or counts past its surface."""
    wrong = np.full((3, 3, 3), 0.5) if name.endswith("map") else np.full_like(np.load(copied / ARRAYS)[name], 10**7)
    change_result(copied, **{name: None})
    refuses(FormatError, f"lacks '{name}'", read_result, copied)
    change_result(copied, **{name: wrong})
    refuses(FormatError, name, read_result, copied)


def test_points_of_levels_lie_in_their_triangles_but_for_rounding(copied):
    places = np.load(copied / ARRAYS)["level_0_barycentric"]
    places[0] = -1e-17, 0.4, 0.6
    change_result(copied, level_0_barycentric=places)
    assert read_result(copied).level_maps[0].points.barycentric[0, 0] == -1e-17
    places[0] = -0.5, 0.5, 1.0
    change_result(copied, level_0_barycentric=places)
    refuses(FormatError, "level_0_barycentric lie outside", read_result, copied)


@pytest.mark.parametrize("levels", [[(0, 0), (1, 1)], [(0, 0), (2, 1), (1, 2)], [(0, 0), (1, 1), (1, 1)]])
def test_levels_that_do_not_end_at_the_finest_are_refused(copied, levels):
    edit_manifest(copied, files={}, level_maps=[{"target": one, "source": other} for one, other in levels])
    refuses(FormatError, r"end at \(1, 2\)", read_result, copied)
