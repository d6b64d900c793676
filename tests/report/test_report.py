"""The report: self-contained, truthful, and drawn with the right colours."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from cagemap.deform.placement import Placement
from cagemap.files.images.image import write_image
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.verdicts import overall_verdict, rate_figures
from cagemap.maps.hypotheses.confidence import LOOK, SURE, TWO, Confidence
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.quality import QualityFigures
from cagemap.maps.result import MatchResult
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import FileVertex
from cagemap.report import CarriedData, CarriedItem, Gallery, Weights, build_page, draw_carried, draw_gallery
from cagemap.report.figures import BACKGROUND, _checker, display_image
from cagemap.report.rig_panels import MAX_PANEL_POSES, cage_edges, control_edges
from cagemap.subdivision.refinement import finest_mesh
from cagemap.tasks.match_summary import match_figures, summary, warnings
from cagemap.tasks.report import _baked_image

from example_result import identity_result

SIZE = (90, 70)


@pytest.fixture(scope="module")
def result() -> MatchResult:
    return identity_result()


@pytest.fixture(scope="module")
def gallery(result: MatchResult) -> Gallery:
    texture = np.zeros((60, 90, 3), np.uint8)
    texture[:, :, 2] = 255
    return draw_gallery(result, texture=texture, baked=texture, size=SIZE)


@pytest.fixture(scope="module")
def page(result: MatchResult, gallery: Gallery) -> str:
    return build_page(result, gallery)


class Outline(HTMLParser):
    """Open tags, and whether every tag is closed."""

    VOID = frozenset({"meta", "img", "br", "link"})

    def __init__(self) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.stack.pop() == tag


def outline(page: str) -> Outline:
    parsed = Outline()
    parsed.feed(page)
    assert parsed.stack == []
    return parsed


def test_page_is_well_formed_and_needs_nothing_beside_it(page: str) -> None:
    tags = outline(page).tags
    assert not {"script", "link", "iframe"} & {tag for tag, _ in tags}
    sources = [attributes["src"] or "" for tag, attributes in tags if tag == "img"]
    assert len(sources) == 12
    assert all(source.startswith("data:image/jpeg;base64,") for source in sources)
    assert not re.search(r"https?://|url\(|@import", page)


def test_pictures_are_jpegs_of_the_size_asked(page: str, gallery: Gallery) -> None:
    image = next(attributes for tag, attributes in outline(page).tags if tag == "img")
    assert (image["width"], image["height"]) == ("90", "70")
    assert base64.b64decode((image["src"] or "").split(",")[1])[:3] == b"\xff\xd8\xff"
    assert all(figure.target.shape == (70, 90, 3) for figure in (*gallery.looks, *gallery.maps, *gallery.trust))


def test_names_are_escaped_and_figures_of_the_manifest_are_on_the_page(page: str) -> None:
    shown = ("small → large", "a &lt;b&gt;", "Made for other poses", "1.8 seconds in all, 1.5 GiB", "parameters.k")
    assert [text for text in (*shown, "0.10 %", "0" * 64) if text not in page] == []  # folded share, hashes
    assert "<b>" not in page


def test_identity_draws_source_and_target_alike(gallery: Gallery) -> None:
    for figure in (*gallery.looks, *gallery.maps):
        # Twice the size, seen from twice as far: only rounding differs, at an edge here or there.
        assert np.mean(np.abs(figure.source.astype(int) - figure.target)) < 0.5


@pytest.mark.slow
def test_texture_is_shown_where_it_is_given(result: MatchResult, gallery: Gallery) -> None:
    def tint(picture: np.ndarray) -> np.ndarray:
        return np.diff(picture[25:45, 35:55].reshape(-1, 3).mean(0))

    assert gallery.appearance == "texture"
    assert tint(gallery.looks[0].target)[1] > 60
    texture = np.zeros((6, 9, 3), np.float32)
    texture[..., 1] = 1.0
    pulled = draw_gallery(result, texture=texture, size=SIZE)  # not baked: vertex by vertex
    assert tint(pulled.looks[0].target)[0] > 60
    assert tint(pulled.looks[0].target)[1] < -60


@pytest.mark.slow
def test_without_a_texture_material_colours_are_shown_and_without_those_a_checker(result: MatchResult) -> None:
    assert draw_gallery(result, size=SIZE).appearance == "material colours"
    bare = replace(result.source.control, face_materials=None, material_colors=None)
    plain = result.source.with_control(bare)
    assert draw_gallery(replace(result, source=plain), size=SIZE).appearance == "checker"
    # Materials with images alone, as those of most GLB files, have no colours.
    textured = replace(
        result.source.control, material_colors=np.full_like(result.source.control.material_colors, np.nan)
    )
    assert draw_gallery(replace(result, source=result.source.with_control(textured)), size=SIZE).appearance == "checker"
    # One colour all over shows nothing.
    white = replace(result.source.control, material_colors=np.ones_like(result.source.control.material_colors))
    assert draw_gallery(replace(result, source=result.source.with_control(white)), size=SIZE).appearance == "checker"


@pytest.mark.slow
def test_progress_names_every_picture(result: MatchResult) -> None:
    said: list[str] = []
    draw_gallery(result, size=(30, 20), progress=said.append)
    assert said == [f"picture {i} of 12" for i in range(1, 13)]


@pytest.mark.parametrize(
    ("dtype", "white"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1.0), (np.float16, 1.0)]
)
def test_any_pixels_are_shown_and_floats_as_linear(dtype: type, white: float) -> None:
    for channels in (1, 4):
        np.testing.assert_allclose(display_image(np.full((4, 4, channels), white, dtype)), np.ones((4, 4, 3)))
    np.testing.assert_allclose(display_image(np.full((4, 4, 3), 0.21404, np.float32)), 0.5, atol=1e-4)


def test_large_textures_are_averaged_down() -> None:
    tall = np.zeros((4096, 8, 3), np.uint8)
    tall[::2] = 255
    shown = display_image(tall)
    assert shown.shape == (2048, 4, 3)
    np.testing.assert_allclose(shown, 0.5, atol=1e-6)


def test_verdicts_follow_the_figures() -> None:
    good = rate_figures({"flipped_area": 0.001, "coverage": 0.999})
    assert [rating.verdict for rating in good] == ["good", "good"]
    assert overall_verdict(good, []) == "good"
    assert overall_verdict(good, ["look at the ears"]) == "fair"
    assert overall_verdict(rate_figures({"flipped_area": 0.01}), []) == "fair"
    assert overall_verdict(rate_figures({"flipped_area": 0.09, "coverage": 0.999}), []) == "poor"
    # A cow whose udder the target lacks: a remark that names the share, not a verdict on the map.
    missing = rate_figures({"flipped_area": 0.001, "coverage": 0.847})
    assert overall_verdict(missing, []) == "fair"
    assert missing[1].value == "15.30 %"
    assert overall_verdict(rate_figures({"flipped_area": 0.001, "coverage": 0.4}), []) == "poor"
    assert rate_figures({"flipped_area": None, "coverage": "many"}) == []


def test_report_without_figures_is_still_a_page(result: MatchResult, gallery: Gallery) -> None:
    bare = replace(result, quality=QualityFigures.of_summary({}, np.zeros(4), result.trust), timings={}, provenance={})
    outline(build_page(bare, gallery))


def test_pairs_that_were_left_out_are_named(result: MatchResult, gallery: Gallery) -> None:
    check = LandmarkCheck(
        (LandmarkSuspect("d", 2, 0.2, FileVertex(7, (1.0, 2.0, 3.0)), FileVertex(5), "distances"),),
        ("five pairs are few",),
    )
    quality = replace(result.quality, landmark_errors=np.zeros(3))
    page = build_page(replace(result, landmark_check=check, quality=quality), gallery)
    assert "Landmark &#x27;d&#x27; looks wrong" in page
    assert "Five pairs are few" in page
    assert page.count("left out</td>") == 1
    assert "left out</td>" not in build_page(result, gallery)


@pytest.mark.slow
def test_two_answers_stand_side_by_side(result: MatchResult) -> None:
    count = result.target.control.n_vertices
    places = result.point_map.images.positions[:count]
    exchanged = places * [-1.0, 1.0, 1.0]
    answers = (Placement(places, 1e-4, name="as the files stand"), Placement(exchanged, 1.1e-4, name="mirrored & all"))
    unsure = replace(result, confidence=Confidence(TWO, answers, deciding=0))
    gallery = draw_gallery(unsure, size=SIZE)
    page = build_page(unsure, gallery)
    assert len([tag for tag, _ in outline(page).tags if tag == "img"]) == 12 + 8
    assert "Two answers" in page
    assert page.count("the other: mirrored &amp; all, ") == 4  # alt text and caption of two views

    def drawn(picture: np.ndarray) -> np.ndarray:
        return picture[np.abs(picture / 255.0 - BACKGROUND).max(axis=2) > 0.02].astype(float)

    # The same answer again differs nowhere, so all of it is clay; the mirrored one differs away from the plane x = 0.
    same = replace(unsure, confidence=Confidence(LOOK, (answers[0], answers[0]), deciding=0))
    redness = [np.ptp(drawn(draw_gallery(one, size=SIZE).answers[0][1].target), axis=1).max() for one in (same, unsure)]
    assert redness[0] < 20 < 60 < redness[1]
    for sure in (result, replace(unsure, confidence=Confidence(SURE, answers, deciding=0))):
        assert not draw_gallery(sure, size=(30, 20)).answers


def test_how_sure_a_map_is_reads_alike_on_terminal_in_manifest_and_report(result, gallery, tmp_path):
    places, none = result.point_map.images.positions, np.zeros(0, dtype=np.int64)
    answers = (Placement(places, 1e-4, name="one"), Placement(places, 1.1e-4, name="another"))
    free = replace(
        result,
        landmarks=Landmarks((), none, none),
        landmark_check=LandmarkCheck(),
        quality=replace(result.quality, landmark_errors=np.zeros(0), warnings=()),
    )
    for verdict in (LOOK, TWO):
        unsure = replace(free, confidence=Confidence(verdict, answers, deciding=0))
        write_result(tmp_path / verdict, unsure)
        unsure = read_result(tmp_path / verdict)
        assert unsure.manifest["confidence"]["verdict"] == verdict
        doubtful = build_page(unsure, gallery)
        (told,) = (text for text in warnings(unsure) if "aligned" in text)
        assert told.startswith(f"{verdict}: the target is aligned with the source one")
        assert f'<p class="verdict fair">{verdict.capitalize()}: the target is aligned with the source one' in doubtful
        assert doubtful.count("aligned with the source one") == 1
    certain = replace(free, confidence=Confidence(SURE, answers[:1], deciding=0))
    assert f"{SURE}: the target is aligned with the source one" in summary(
        certain, tmp_path, match_figures(certain, 1.0)
    )
    sure = build_page(certain, gallery)
    assert "The map looks sound." in sure
    assert f"<li>{SURE.capitalize()}: the target is aligned with the source one" in sure
    assert "no other alignment fits nearly as well" in sure
    assert 'class="warning"' not in sure
    for empty in ("<summary>Landmarks", "Dots are landmarks", "Lines are curves", "<td>None</td>"):
        assert empty not in sure
    folded = replace(free.quality, flipped_area=0.2)
    poor = replace(free, quality=folded, confidence=Confidence(LOOK, answers, deciding=0))
    assert "Do not use" in warnings(poor)[-1]
    assert f"{warnings(poor)[-1]} Look at it: " in build_page(poor, gallery)
    assert warnings(poor)[-1] in build_page(replace(poor, confidence=None), gallery)
    # A page speaks the words of the command line, and leaves names of files as they are.
    noted = {"notes": [f"{result.target.control.name}: `find_part` each matches every piece"]}
    two = build_page(replace(free, confidence=Confidence(TWO, answers, deciding=0), provenance=noted), gallery)
    assert "(--answer 1)" in two
    assert "answer=1" not in two
    assert f"<li>{result.target.control.name}: --part each matches every piece</li>" in two


@pytest.mark.slow
def test_what_was_wrapped_and_what_rides_on_the_map_is_shown(result: MatchResult, gallery: Gallery) -> None:
    control, source = result.target.control, result.source.control
    rng = np.random.default_rng(1)
    skins = [rng.dirichlet(np.ones(3), size=mesh.n_vertices) for mesh in (source, control)]
    moves = [np.zeros((mesh.n_vertices, 3)) for mesh in (source, control)]
    for move in moves:
        move[:5] = 0.2
    carried = CarriedData(
        wrapped=control.with_positions(source.positions),
        weights=Weights(*skins),
        shapes=tuple(CarriedItem(name, *moves) for name in ("smile", "blink")),
    )
    panels = draw_carried(result, carried, SIZE)
    assert [len(panel.pictures) for panel in panels] == [8, 4, 4]
    page = build_page(result, gallery, panels)
    assert len([tag for tag, _ in outline(page).tags if tag == "img"]) == 12 + 16
    assert all(title in page for title in ("Wrapped", "Skinning weights", "Blend shapes", "smile, target"))
    # The identity: the wrapped surface and the source are one, so their pictures differ by the net alone.
    (bare, _), (netted, _) = panels[0].pictures[:2]
    assert 0.01 < np.mean(np.abs(bare.astype(int) - netted.astype(int)).max(axis=2) > 60) < 0.6


def test_a_net_is_the_edges_between_control_faces() -> None:
    result = identity_result()
    refinement = result.target.refinement
    segments = control_edges(refinement)
    edges = cage_edges(refinement.control)
    assert len(segments) == len(edges) * 2**refinement.finest_level
    assert draw_carried(result, CarriedData(), SIZE) == ()


@pytest.mark.slow
@pytest.mark.parametrize("more", [0, 1])
def test_the_first_of_many_poses_are_shown_and_counted(more: int) -> None:
    result = identity_result(1)
    places = result.source.control.positions, result.target.control.positions
    count = MAX_PANEL_POSES + more
    (panel,) = draw_carried(
        result, CarriedData(poses=tuple(CarriedItem(f"{i}", *places) for i in range(count))), (8, 6)
    )
    assert len(panel.pictures) == 2 * MAX_PANEL_POSES
    assert (f"The first {MAX_PANEL_POSES} of {count}." in panel.lead) == bool(more)


def test_the_table_of_landmarks_says_how_large_the_target_is_around_them(result: MatchResult, gallery: Gallery) -> None:
    table = build_page(result, gallery).split("<th>size around it</th>")[1].split("</table>")[0]
    # The same surface at another scale: of equal size everywhere.
    assert table.count("<td>1.00</td>") == len(result.landmarks)
    outwards = result.target.control.positions * [1.0, 1.0, 3.0]
    wide = identity_result(controls=(result.target.control.with_positions(outwards), result.source.control))
    assert "stretched" in build_page(wide, gallery).split("<th>size around it</th>")[1].split("</table>")[0]


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        ("bake-colors", [0.0, 0.5, 1.0]),
        ("bake-ao", [0.0, 0.5, 1.0]),
        ("normal-map", [0.0, 0.21404, 1.0]),
        ("displacement", [0.0, 0.21404, 1.0]),
    ],
)
def test_floats_are_encoded_once_if_they_are_colours(tmp_path: Path, kind: str, shown: list[float]) -> None:
    values = np.array([0.0, 0.21404, 1.0], np.float32)
    write_image(tmp_path / "a.exr", np.tile(values[:, None], (2, 1, 3)))
    entry = {"kind": kind, "output": "a.exr", "tiles": [0]}
    (pixels,) = _baked_image(tmp_path, identity_result(1), entry).tiles.values()
    np.testing.assert_allclose(pixels[0, :, 0], shown, atol=1e-4)


@pytest.mark.parametrize("names", ["skin.{}.png", "skin_{}_v2.png", "1001_{}.png"])
def test_tiles_are_found_wherever_their_number_stands(tmp_path: Path, names: str) -> None:
    tiles = [1001, 1002]
    for tile in tiles:
        write_image(tmp_path / names.format(tile), np.full((4, 4, 3), tile - 1000, dtype=np.uint8))
    entry = {"kind": "texture", "output": names.format(1001), "tiles": tiles}
    image = _baked_image(tmp_path, identity_result(1), entry)
    assert image.name.endswith(names.format("<UDIM>"))
    assert {tile: round(float(pixels.max() * 255)) for tile, pixels in image.tiles.items()} == {1001: 1, 1002: 2}


def test_a_wrap_of_the_finest_level_is_drawn(result: MatchResult) -> None:
    wrapped = finest_mesh(result.target.refinement)
    (panel,) = draw_carried(result, CarriedData(wrapped=wrapped), SIZE)
    assert len(panel.pictures) == 8


def test_a_checker_of_one_vertex() -> None:
    """Of an extent of 0, it has cells of one 28th of a unit."""
    point, steps = np.array([[1.0, 2.0, 3.0]]), np.array([[0.5, 0, 0], [1.5, 0, 0], [1.5, 1.5, 0]])
    light, dark = [0.93, 0.90, 0.84], [0.20, 0.45, 0.55]
    np.testing.assert_array_equal(_checker(point + steps / 28, point), [light, dark, light])
