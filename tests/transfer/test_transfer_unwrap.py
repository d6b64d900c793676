"""Unwrapping: whole polygons, no overlap after refinement, one density; and how much of a layout lies over itself."""

import importlib
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import bipyramid, creature, cube, disk, icosahedron, pyramid, torus, triangulated
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh, Plain
from cagemap.subdivision import refine, triangles
from cagemap.surface.triangles import triangle_areas, triangle_neighbors
from cagemap.transfer.overlapping_uvs import overlapping_materials, overlapping_share
from cagemap.transfer.packing import pack_islands
from cagemap.transfer.unwrap import _is_convex, _outline, unwrap

from refusals import refuses
from transfer_scenes import check_distance, check_layout, islands_of

SHAPES = {
    "cube": cube(),
    "icosahedron": icosahedron(),
    "torus": torus(),
    "disk": disk(7),
    "pyramid": pyramid(),
    "bipyramid": bipyramid(9),
    "creature": creature(),
}
ANIMALS = ["spot", "cow", "red_fox"]

# The function of the same name hides the module.
layout = importlib.import_module("cagemap.transfer.unwrap")


@pytest.mark.parametrize("name", SHAPES)
def test_shapes(name: str) -> None:
    check_layout(unwrap(SHAPES[name]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ANIMALS)
def test_animals_with_bent_and_concave_polygons(shared_data: Path, name: str) -> None:
    control = unwrap(read_obj(shared_data / "animals" / f"{name}.obj"))
    check_layout(control)
    # Density: areas in the layout are those of the surface, up to what flattening costs a polygon.
    level = refine(control, 2).finest
    area = triangle_areas(level.positions, triangles(level.faces))
    solid = np.bincount(np.repeat(level.face_parents, 2), area)
    loops = control.uvs[control.uv_indices]
    cross = loops[:, 0] * loops[control.next_corners, 1] - loops[:, 1] * loops[control.next_corners, 0]
    flat = 0.5 * np.add.reduceat(cross, control.face_offsets[:-1])
    ratio = flat / solid * solid.sum() / flat.sum()
    assert np.quantile(ratio, 0.05) > 0.5
    assert np.quantile(ratio, 0.95) < 2.0
    assert flat.sum() > 0.3  # of the unit square


def test_concave_polygons_become_convex_ones() -> None:
    # A prism over a star: its caps are n-gons whose own outline would fold when refined.
    around = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rim = np.where(np.arange(10) % 2, 0.35, 1.0)[:, None] * np.column_stack([np.cos(around), np.sin(around)])
    positions = np.concatenate([np.column_stack([rim, np.full(10, height)]) for height in (0.0, 0.5)])
    sides = [[k, (k + 1) % 10, 10 + (k + 1) % 10, 10 + k] for k in range(10)]
    star = ControlMesh.from_faces(positions, [list(range(9, -1, -1)), list(range(10, 20)), *sides])
    check_layout(unwrap(star), 300)
    for face in range(star.n_faces):
        assert _is_convex(_outline(positions[star.face(face)]))


@pytest.mark.slow
def test_animals_come_in_few_islands(shared_data: Path) -> None:
    control = unwrap(read_obj(shared_data / "animals" / "spot.obj"))
    level = refine(control, 1).finest
    # 29 now, for 180 bent polygons; 59 and more without smoothing, or if mirrored charts are taken apart.
    assert len(np.unique(islands_of(triangle_neighbors(triangles(level.uv_indices))))) <= 35


def test_a_plain_mesh_is_laid_out_as_it_is() -> None:
    """Scans seldom have UVs."""
    control = unwrap(replace(triangulated(torus()), scheme=Plain()))
    assert isinstance(control.scheme, Plain)
    check_layout(replace(control, scheme=None))


def test_packing_keeps_the_padding_however_it_turns_out() -> None:
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    for count in (1, 2, 3, 5):
        islands = np.repeat(np.arange(count), 4)
        start = np.arange(4 * count)
        edges = np.column_stack([start, start // 4 * 4 + (start + 1) % 4])
        packed = pack_islands(np.tile(square, (count, 1)), edges, islands, 0.05).reshape(count, 4, 2)
        low, high = packed.min(axis=1), packed.max(axis=1)
        assert low.min() >= 0.025 - 1e-12
        assert high.max() <= 1 - 0.025 + 1e-12
        np.testing.assert_allclose(high - low, (high - low)[0, 0], rtol=1e-9)  # all of one scale
        for a in range(count):
            for b in range(a):
                assert np.maximum(low[a] - high[b], low[b] - high[a]).max() >= 0.05 - 1e-12


def test_islands_keep_their_distance() -> None:
    # The padding is 10 texels; islands grown by 4 must not meet, nor leave the square.
    check_distance(unwrap(torus(), padding=1 / 64), 640, 4.0)


@pytest.mark.slow
def test_the_same_mesh_gives_the_same_layout_whatever_its_place_and_size() -> None:
    control = torus()
    first, again = unwrap(control), unwrap(control)
    np.testing.assert_array_equal(first.uvs, again.uvs)
    np.testing.assert_array_equal(first.uv_indices, again.uv_indices)
    for factor in (1e-6, 2.0**20):
        check_layout(unwrap(control.with_positions(control.positions * factor + 3 * factor)), 300)


def apart(one: np.ndarray, other: np.ndarray) -> bool:
    """The slow twin: whether an edge of either of two convex polygons has the other one on its outer side."""
    return any(
        all((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0] <= 1e-9 for c in second)
        for first, second in ((one, other), (other, one))
        for a, b in zip(first, np.roll(first, -1, axis=0), strict=True)
    )


@pytest.mark.parametrize("seed", range(3))
def test_charts_that_run_over_themselves_are_found_as_one_by_one(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layout, "_PAIRS", 50)
    rng = np.random.default_rng(seed)
    count = 60
    sizes = rng.integers(3, 6, count)
    around = [np.sort(rng.uniform(0, 2 * np.pi, size)) for size in sizes]
    loops = [rng.uniform(0, 4, 2) + rng.uniform(0.1, 1) * np.column_stack([np.cos(a), np.sin(a)]) for a in around]
    uvs, corner_uvs = np.concatenate(loops), np.arange(sizes.sum())
    control = ControlMesh.from_faces(np.zeros((len(uvs), 3)), np.split(corner_uvs, np.cumsum(sizes)[:-1]))
    chart = rng.integers(-1, 3, count)
    found = layout._overlapping_pairs(control, uvs, corner_uvs, chart)
    expected = {
        (a, b)
        for a, b in itertools.combinations(range(count), 2)
        if chart[a] == chart[b] >= 0 and not apart(loops[a], loops[b])
    }
    assert len(expected) > 20
    assert {(min(pair), max(pair)) for pair in found.tolist()} == expected
    layout._loosen_overlaps(control, uvs, corner_uvs, chart)
    assert not len(layout._overlapping_pairs(control, uvs, corner_uvs, chart))


def test_degenerate_polygons_get_a_spot_of_their_own() -> None:
    shape = cube()
    positions = shape.positions.copy()
    positions[1] = positions[0]  # an edge without length, and with it triangles without area
    check_layout(unwrap(shape.with_positions(positions)), 300)


def test_nothing_to_unwrap_is_refused() -> None:
    refuses(InvalidMeshError, "to unwrap", unwrap, cube().with_positions(np.zeros((8, 3))))
    refuses(InvalidMeshError, "to unwrap", unwrap, ControlMesh.from_faces(np.zeros((0, 3)), []))


@pytest.mark.parametrize("padding", [-0.1, 0.5, 0.9, 2.0, np.nan])
def test_padding_without_room_for_the_islands_is_refused(padding: float) -> None:
    squares = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uvs = np.concatenate([squares + np.array([2.0 * island, 0.0]) for island in range(3)])
    edges = np.column_stack([np.arange(12), 4 * (np.arange(12) // 4) + (np.arange(12) + 1) % 4])
    with pytest.raises(ParameterError, match="3 islands fit into the square"):
        pack_islands(uvs, edges, np.repeat(np.arange(3), 4), padding)


UNIT = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


def squares(places: list[tuple[float, float]], side: float, materials: list[int] | None = None) -> ControlMesh:
    """Faces whose texture coordinates are squares of this side from these places on."""
    uvs = np.concatenate([np.array(place) + side * UNIT for place in places])
    offsets, indices = 4 * np.arange(len(places) + 1), np.arange(len(uvs))
    mesh = ControlMesh(np.zeros((len(uvs), 3)), offsets, indices, uvs, indices)
    if materials is None:
        return mesh
    return replace(mesh, face_materials=np.array(materials), material_names=("skin", "eyes"))


@settings(max_examples=30)
@given(shift=st.floats(0.0, 0.6), tile=st.tuples(st.integers(0, 9), st.integers(0, 3)))
def test_the_share_is_that_of_the_area(shift: float, tile: tuple[int, int]) -> None:
    """Two squares, one moved to the right: their common part of both, in any tile."""
    mesh = squares([tile, (tile[0] + shift, tile[1])], 0.39)
    common = max(0.0, 0.39 - shift) / 0.39
    # Turned squares of 200 texels a side have hardly a texel more or less than their area; 40 of 40 000 are allowed.
    assert overlapping_share(mesh) == pytest.approx(common / 2, abs=1e-3)


def test_what_only_touches_or_is_not_convex_is_not_doubled() -> None:
    assert overlapping_share(squares([(0, 0), (0.25, 0), (0, 0.25), (1.0, 0.0)], 0.25)) < 1e-3
    arrow = np.array([(0.1, 0.1), (0.9, 0.5), (0.1, 0.9), (0.5, 0.5)])
    assert overlapping_share(squares([(0.0, 0.0)], 1.0).with_uvs(arrow, np.arange(4))) < 1e-3
    assert overlapping_share(squares([(0.0, 0.0), (0.0, 0.0)], 40.0)) == 0.0  # a texture that is repeated
    assert overlapping_share(replace(squares([(0, 0)], 0.25), uvs=None, uv_indices=None)) == 0.0


@settings(max_examples=30)
@given(side=st.floats(0.05, 0.3), place=st.tuples(st.floats(0.0, 0.6), st.floats(0.0, 0.6)))
def test_squares_along_rows_of_texels_are_not_doubled(side: float, place: tuple[float, float]) -> None:
    """Counted along its sides, one of 77 texels would have 76 of them, and 3 % less area."""
    assert overlapping_share(squares([place], side)) < 0.02


def test_cards_thinner_than_a_texel_are_not_doubled() -> None:
    """All of the same width, as hair has them, and all missed or hit by centres in the same place."""
    places = [((i + 0.14) / 128, (j + 0.14) / 4) for i in range(128) for j in range(4)]
    cards = [np.array(place) + UNIT * [0.0015, 0.24] for place in places]
    mesh = squares(places, 1.0).with_uvs(np.concatenate(cards), np.arange(4 * len(cards)))
    assert overlapping_share(mesh) < 0.02


def test_materials_are_named_where_they_lie_over_each_other() -> None:
    places = [(0.0, 0.0), (0.0, 0.0), (0.5, 0.0), (1.0, 0.0)]
    assert overlapping_materials(squares(places, 0.4, [0, 1, 1, 1]), 0.02) == ("skin", "eyes")
    # Mirrored halves of one material read the same image.
    assert overlapping_materials(squares(places, 0.4, [0, 0, 1, 1]), 0.02) == ()
    assert overlapping_materials(squares([(0, 0), (1, 0)], 0.4, [0, 1]), 0.02) == ()
    assert overlapping_materials(squares(places, 0.4), 0.02) == ()
