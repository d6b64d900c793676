"""How much of a layout lies over itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.mesh import ControlMesh
from cagemap.transfer.overlapping_uvs import overlapping_materials, overlapping_share

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
