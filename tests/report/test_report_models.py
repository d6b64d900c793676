"""What turns on a page: the arrays come back, marks are where the trouble is, and the page stays small."""

import base64
import json
import re
import zlib
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from examples.shapes import icosahedron

from cagemap.deform.placement import Placement
from cagemap.files.result.verdicts import map_verdict
from cagemap.maps.hypotheses.confidence import TWO, Confidence
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import FileVertex
from cagemap.mesh.schemes import Plain
from cagemap.operators.coarse_levels import build_coarse_levels
from cagemap.pictures import Z_UP
from cagemap.report import (
    CarriedData,
    CarriedItem,
    Weights,
    build_page,
    draw_carried,
    draw_gallery,
    report_models,
    write_report,
)
from cagemap.report.looks import _index_uvs
from cagemap.report.marks import SOURCE, TARGET, find_marks, name_marks
from cagemap.report.models import pack_models
from cagemap.report.page import MAX_TEXTURE_BYTES, encode_texture
from cagemap.report.shown import display_surface, display_surfaces, reached_vertices
from cagemap.report.viewpoints import choose_viewpoints
from cagemap.spectral import BasisConfig, Surface
from cagemap.subdivision import refine

from example_result import identity_result


@pytest.fixture(scope="module")
def result() -> MatchResult:
    return identity_result()


def unpacked(described: dict[str, Any], content: bytes) -> np.ndarray:
    """What `viewer.js` reads."""
    kind, count, columns = described["kind"], described["count"], described["columns"]
    size = np.dtype(kind).itemsize
    planes = np.frombuffer(content, np.uint8, count * size, described["at"]).reshape(size, count)
    values = np.ascontiguousarray(planes.T).view(np.dtype(kind).newbyteorder("<")).reshape(-1, columns)
    if kind == "uint8":
        return values / 255
    whole = np.cumsum(values.astype(np.int64), axis=0)
    return whole if "step" not in described else ((whole + 32768) % 65536 - 32768) * described["step"]


def opened(models: Any, result: MatchResult) -> tuple[dict[str, Any], bytes]:
    described, arrays = pack_models(models, result)
    assert "<" not in described
    return json.loads(described), zlib.decompress(base64.b64decode(arrays))


def test_arrays_come_back_to_the_last_of_16_bits(result: MatchResult) -> None:
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 255, (64, 64, 3), np.uint8)
    models = report_models(result, choose_viewpoints(result), texture=texture, baked=texture)
    described, content = opened(models, result)
    for name, shown in ((SOURCE, models.source), (TARGET, models.target)):
        said = described["sides"][name]
        positions = unpacked(said["positions"], content)
        np.testing.assert_allclose(positions, shown.positions, atol=1 / 65000)
        assert np.linalg.norm(positions, axis=1).max() < 1.0001
        copies, drawn = unpacked(said["copies"], content)[:, 0], unpacked(said["triangles"], content).reshape(-1, 3)
        vertices = np.r_[np.arange(len(positions)), copies]
        np.testing.assert_array_equal(vertices[drawn], shown.triangles)
        np.testing.assert_allclose(unpacked(said["uvs"], content)[drawn], shown.corner_uvs, atol=1 / 30000)
    # Every vertex maps to itself: its place on the source is that of the source's vertex.
    source = described["sides"][SOURCE]
    linear = np.array(source["places_of_positions"])
    places = unpacked(source["positions"], content) @ linear[:9].reshape(3, 3).T + linear[9:]
    np.testing.assert_allclose(places, unpacked(described["sides"][TARGET]["places"], content), atol=2e-4)
    assert places.min() > -1e-3
    assert places.max() < 1.001


def test_places_of_a_flat_part_keep_their_precision(result: MatchResult) -> None:
    """A ring of vertices: the rest of the target is far outside its extent along the normal."""
    vertices = result.source.vertices
    ring = np.abs(vertices[:, 1] - vertices[:, 1].mean()) < 1e-6
    assert 3 < ring.sum() < len(ring)
    of_part = replace(result, masks=Masks(None, ring.astype(np.float64)))
    models = report_models(of_part, choose_viewpoints(of_part))
    described, content = opened(models, of_part)
    found = unpacked(described["sides"][TARGET]["places"], content)[:, [0, 2]]
    inside = vertices[ring][:, [0, 2]]
    expected = (result.image()[models.target.vertices][:, [0, 2]] - inside.min(0)) / np.ptp(inside, axis=0)
    np.testing.assert_allclose(found, expected, atol=1 / 255)


def test_first_look_is_the_texture_else_materials_else_the_checker(result: MatchResult) -> None:
    models = report_models(result, choose_viewpoints(result))
    assert [look.name for look in models.looks] == ["Materials", "Checker", "Places", "Problems", "Sizes"]
    described, content = opened(models, result)
    colors = unpacked(described["sides"][SOURCE]["key_colors"], content)
    assert len(np.unique(colors.round(2), axis=0)) == 2  # red and grey, and nothing between them
    control = result.source.control
    textured = replace(control, material_colors=np.full_like(control.material_colors, np.nan))  # by images alone
    for bare in (replace(control, face_materials=None, material_colors=None), textured):
        plain = replace(result, source=result.source.with_control(bare))
        assert report_models(plain, choose_viewpoints(plain)).looks[0].name == "Checker"


def test_masks_weights_and_shapes_are_there_where_they_are_known(result: MatchResult) -> None:
    control, source = result.target.control, result.source.control
    ones = [np.ones((mesh.n_vertices, 1)) for mesh in (source, control)]
    moved = [np.tile([0.0, size, 0.0], (8, 1)) for size in (0.5, 1.0)]
    carried = CarriedData(
        wrapped=control.with_positions(source.positions),
        weights=Weights(*ones),
        shapes=(CarriedItem("smile", *moved),),
        poses=(CarriedItem("sit", source.positions + moved[0], control.positions + moved[1]),),
    )
    n = len(result.target.vertices)
    masked = replace(result, masks=Masks(np.linspace(0, 1, n), None))
    models = report_models(masked, choose_viewpoints(masked), carried=carried)
    assert [look.name for look in models.looks][-2:] == ["Masks", "Weights"]
    wrapped, smile, sit = models.shapes
    assert wrapped.source is None
    np.testing.assert_allclose(wrapped.target, models.source.positions, atol=1e-6)  # one cage, so one surface
    for shape in (smile, sit):  # the same move on both, of which one is twice as large
        np.testing.assert_allclose(shape.target - models.target.positions, shape.source - models.source.positions)
    described, _ = opened(models, masked)
    assert [shape["name"] for shape in described["shapes"]] == ["Wrapped", "smile", "sit"]


def test_colours_and_checkers_span_the_part_that_is_matched(result: MatchResult) -> None:
    """A head on a body would have one colour and three squares."""
    places = result.source.vertices
    part = places[:, 1] > np.quantile(places[:, 1], 0.9)
    weights = part.astype(np.float64)
    low, high = places[part].min(axis=0), places[part].max(axis=0)
    expected, whole = (places - low) / (high - low), draw_gallery(result, size=(60, 40))
    for of_part in (replace(result, shared=Masks(weights, weights)), replace(result, masks=Masks(None, weights))):
        models = report_models(of_part, choose_viewpoints(of_part))
        scene, content = opened(models, of_part)
        shown = unpacked(scene["sides"]["target"]["places"], content)
        np.testing.assert_allclose(shown, expected[models.target.vertices], atol=1e-3 * np.abs(expected).max())
        assert max(scene["cells"]) == pytest.approx(24)
        assert not np.array_equal(draw_gallery(of_part, size=(60, 40)).maps[0].target, whole.maps[0].target)


def test_large_surfaces_are_shown_by_vertices_of_their_own(result: MatchResult) -> None:
    shown = display_surface(result.target, np.eye(3), max_vertices=30)
    assert len(shown.vertices) == 26  # level 1 of a cube
    assert shown.corner_uvs is not None
    finest = np.asarray(result.target.refinement.finest.positions)
    np.testing.assert_allclose(shown.positions * shown.radius + shown.centre, finest[shown.vertices])
    scan = identity_plain(4)
    few = display_surface(scan.target, np.eye(3), max_vertices=600)
    assert 300 <= len(few.vertices) <= 750
    assert few.corner_uvs is None
    assert report_models(scan, choose_viewpoints(scan), max_vertices=600).looks[0].name == "Checker"


def identity_plain(level: int) -> MatchResult:
    """A dense mesh onto itself, taken as it is."""
    dense = refine(icosahedron(), level).finest
    mesh = ControlMesh.from_faces(dense.positions, dense.faces, name="scan.obj")
    surfaces = [Surface(build_coarse_levels(refine(mesh, 0, Plain())), BasisConfig(count=5)) for _ in range(2)]
    base = identity_result(level)
    places = [surface.finest_triangles for surface in surfaces]
    point_map = PointMap.from_vertices(*places, np.arange(places[0].n))
    quality = replace(base.quality, trust=np.ones(places[0].n))
    return replace(base, target=surfaces[0], source=surfaces[1], point_map=point_map, quality=quality)


def test_troubles_are_marked_where_they_are(result: MatchResult) -> None:
    views = choose_viewpoints(result)
    target, source = display_surfaces(result, views)
    everything = reached_vertices(result, source)
    assert everything.all()
    assert find_marks(result, target, source, everything) == ()
    # A corner that is not trusted, and the opposite one of the source that nothing comes to.
    positions = np.asarray(result.target.refinement.finest.positions)
    away = [np.linalg.norm(positions - positions[vertex], axis=1) for vertex in (0, 6)]
    torn = replace(result, quality=replace(result.quality, trust=np.where(away[0] < 0.7, 0.0, 1.0)))
    first, second = find_marks(torn, target, source, away[1] > 0.7)
    assert (first.side, second.side) == (TARGET, SOURCE)
    assert "stretched strongly" in first.text
    assert "nothing from here arrives" in second.text
    assert away[0][first.vertex] < 0.7
    assert away[1][second.vertex] < 0.7
    assert (first.number, second.number) == (1, 2)
    # What is said of a place is what most of it is, not what its middle is.
    triangles = result.point_map.target.triangles
    for folded, words in (((triangles == first.vertex).any(axis=1), "stretched strongly"), (True, "folded over")):
        with patch("cagemap.report.marks.flipped_triangles", return_value=np.broadcast_to(folded, len(triangles))):
            assert words in find_marks(torn, target, source, everything)[0].text


@pytest.mark.parametrize(("shift", "moved"), [(0.0, False), (1.0, False), (1000.0, True), (-300.0, True)])
def test_texture_coordinates_far_outside_the_square_stay_fine(shift: float, moved: bool) -> None:
    corners = shift + np.random.default_rng(0).uniform(0.0, 0.9, (50, 3, 2))
    keys, values = _index_uvs(corners)
    apart = values[keys] - corners
    np.testing.assert_allclose(apart, np.round(apart), atol=1e-9)
    assert np.abs(values).max() <= 1.0 if moved else np.array_equal(values[keys], corners), values.max()


@pytest.mark.slow
def test_landmarks_that_were_left_out_and_what_decides_are_marked(result: MatchResult) -> None:
    check = LandmarkCheck(
        (LandmarkSuspect("d", 2, 0.2, FileVertex(7, (1.0, 2.0, 3.0)), FileVertex(5), "distances"),), ()
    )
    places = result.point_map.images.positions[:8]
    answers = (Placement(places, 1e-4, name="one"), Placement(-places, 1.1e-4, name="another"))
    unsure = replace(result, landmark_check=check, confidence=Confidence(TWO, answers, deciding=5))
    unsure = replace(unsure, quality=replace(result.quality, landmark_errors=np.zeros(3)))
    models = report_models(unsure, choose_viewpoints(unsure))
    marks = [(1, TARGET, 5), (2, TARGET, 5), (2, SOURCE, 5)]
    assert [(mark.number, mark.side, mark.vertex) for mark in models.marks] == marks
    assert models.looks[-1].name == "Other answer"
    page = build_page(unsure, draw_gallery(unsure, size=(30, 20)), (), models)
    assert "at mark 1 decides" in page
    assert "away from its mark" in page
    shown = page.split("<script")[0]
    assert "vertex" not in shown.split("Look here")[1].split("</ul>")[0]
    for word in ("worst", "most"):
        text = f"1 % is folded over, {word} at (1, -2.5, 3) of the target's file"
        assert name_marks(text, ()) == "1 % is folded over"
    for vertex in (FileVertex(12), FileVertex(12, (1.0, -2.5, 3.0))):
        assert name_marks(f"A landmark at target vertex {vertex} decides", ()) == "A landmark there decides"


def test_the_verdict_is_one_sentence_that_names_the_worst_figure() -> None:
    poor = {"quality": {"flipped_area": 0.12, "coverage": 0.9}}
    assert map_verdict(poor) == ("poor", "Do not use this map as it is: 12.00 % of the target is folded over.")
    fair = {"quality": {"flipped_area": 0.001, "coverage": 0.85}}
    said = "The map is usable; 15.00 % of the source arrives nowhere: look at the marked places."
    assert map_verdict(fair, marked=True) == ("fair", said)
    # Both are fair: the folds are further from good, the landmarks only just fair.
    several = {"quality": {"landmark_error_mean": 0.006, "flipped_area": 0.07, "dirichlet": 2.1}}
    assert map_verdict(several)[1] == "The map is usable; 7.00 % of the target is folded over: read the remarks below."
    stretched = {"quality": {"dirichlet": 2.5}}
    said = "The map is usable; its stretch is 2.50 (1 keeps all lengths): read the remarks below."
    assert map_verdict(stretched) == ("fair", said)
    undefined = {"quality": {"dirichlet": float("nan"), "coverage": 0.99}}
    said = "Do not use this map as it is: its stretch is unknown (1 keeps all lengths)."
    assert map_verdict(undefined) == ("poor", said)
    warned = {"quality": {"warnings": ["few landmarks"]}}
    assert map_verdict(warned) == ("fair", "The map is usable; read the remarks below.")


def test_models_with_z_up_stand_upright(result: MatchResult) -> None:
    lying = result.target.control.with_positions(result.target.control.positions @ np.diag([1.0, 1.0, 3.0]))
    tall = identity_result(controls=(lying, lying))
    shown, _ = display_surfaces(tall, choose_viewpoints(tall, Z_UP, "as asked"))
    extent = np.ptp(shown.positions, axis=0)
    assert extent[1] > 2 * max(extent[0], extent[2])


@pytest.mark.slow
def test_textures_become_small_enough_for_a_page() -> None:
    noise = np.random.default_rng(0).random((2048, 2048, 3))
    texture = encode_texture("t", "noise", noise)
    assert len(texture.content) <= MAX_TEXTURE_BYTES
    assert texture.size[0] < 2048
    assert encode_texture("t", "grey", np.full((512, 300, 3), 0.5)).size == (300, 512)


@pytest.mark.slow
def test_passengers_and_poses_are_sections_of_the_page(result: MatchResult) -> None:
    control, source = result.target.control, result.source.control
    hats = [mesh.with_positions(mesh.positions * 0.3 + [0, 1.0, 0]) for mesh in (source, control)]
    carried = CarriedData(
        passengers=(CarriedItem("hat", *hats),), poses=(CarriedItem("stand", source.positions, control.positions),)
    )
    panels = draw_carried(result, carried, (40, 30))
    assert [(panel.title, len(panel.pictures)) for panel in panels] == [("Passengers", 4), ("Poses", 2)]
    page = build_page(result, draw_gallery(result, size=(30, 20)), panels)
    assert "<summary>Passengers" in page
    assert "on the target: hat" in page
    # The hat has a colour of its own.
    assert np.ptp(panels[0].pictures[0][0].reshape(-1, 3).astype(int), axis=1).max() > 60


@pytest.mark.slow
def test_a_page_with_models_asks_nothing_of_other_machines(result: MatchResult, tmp_path: Any) -> None:
    write_report(tmp_path / "r.html", result, texture=np.zeros((8, 8, 3), np.uint8), size=(40, 30))
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert page.endswith("</html>\n")
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"]
    assert len(page.encode()) < 1_000_000
    assert 'id="source-texture"' in page
    assert not re.search(r'(?:src|href)="(?!data:)', page)
    assert not re.search(r"@import|fetch\(|XMLHttpRequest\(\)\.open", page.split('id="models-data"')[0])
