"""A cage on itself: the match is the identity to the last bit, unless landmarks want something else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cagemap import ControlMesh, Landmarks, Surface, match, prepare_surface, update_match
from cagemap.example import example_pair
from cagemap.files.result import read_result, write_result
from cagemap.maps.hypotheses.confidence import SURE
from cagemap.maps.masks import Masks
from cagemap.maps.result import MatchResult
from cagemap.maps.same import same_surface
from cagemap.pipeline import pair_of
from plain_meshes import animal

MARKS = np.array([3, 50, 120, 200, 260])


@pytest.fixture(scope="module")
def pony() -> ControlMesh:
    return example_pair().source


@pytest.fixture(scope="module")
def surface(pony: ControlMesh) -> Surface:
    return prepare_surface(pony, 2)


def marked(target: np.ndarray, source: np.ndarray) -> Landmarks:
    return Landmarks(tuple(f"mark {k}" for k in range(len(target))), target, source)


def is_identity(found: MatchResult) -> bool:
    images = found.point_map.images.positions
    return np.array_equal(images, found.point_map.source.positions)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_a_surface_on_itself_is_the_identity_with_and_without_landmarks(surface: Surface, count: int) -> None:
    found = match(surface, surface, marked(MARKS[:count], MARKS[:count]))
    assert is_identity(found)
    assert found.confidence is not None
    assert found.confidence.verdict == SURE
    assert found.quality.flipped_area == 0
    more = update_match(found, marked(MARKS, MARKS))
    assert is_identity(more)


def test_moved_in_its_file_and_rounded_it_is_the_same_surface(pony: ControlMesh, surface: Surface) -> None:
    rounded = np.round(pony.positions, 6) + np.array([5.0, 0.0, -2.0])
    found = match(prepare_surface(pony.with_positions(rounded), 2), surface)
    assert is_identity(found)


def test_a_plain_mesh_on_itself_is_the_identity(tmp_path: Path) -> None:
    """Its answer was given for all vertices, where those of the fitted level were expected: an error."""
    scan = prepare_surface(animal(3), 0)
    found = match(scan, scan)
    assert found.prepared is not None
    assert found.prepared.mesh.n < len(found.point_map.triangle)
    assert is_identity(found)
    assert found.confidence is not None
    np.testing.assert_allclose(
        found.confidence.readings[0].positions[:5], found.point_map.images.positions[:5], atol=0.05
    )
    write_result(tmp_path / "RESULT", found)
    assert is_identity(read_result(tmp_path / "RESULT"))


def test_another_shape_other_faces_or_contrary_landmarks_are_matched(pony: ControlMesh, surface: Surface) -> None:
    thicker = prepare_surface(pony.with_positions(pony.positions * [1.05, 1.0, 1.0]), 2)
    faces = np.split(pony.face_indices, pony.face_offsets[1:-1])[::-1]
    others = prepare_surface(ControlMesh.from_faces(pony.positions, [face.tolist() for face in faces]), 2)
    elsewhere = MARKS + np.array([1, 0, 0, 0, 0])
    same = marked(MARKS, MARKS)
    assert same_surface(pair_of(surface, surface, same))
    assert not same_surface(pair_of(thicker, surface, same))
    assert not same_surface(pair_of(others, surface, same))
    assert not same_surface(pair_of(surface, surface, marked(MARKS, elsewhere)))


def test_masks_that_keep_different_parts_are_no_identity(surface: Surface) -> None:
    """One side of one animal on the other side of another of the same cage: nothing of either would be matched."""
    pair = pair_of(surface, surface, marked(MARKS[:0], MARKS[:0]))
    left = (surface.refinement.finest.positions[:, 0] > 0).astype(float)
    assert same_surface(pair, Masks(left, left))
    assert same_surface(pair, Masks(left, None))
    assert not same_surface(pair, Masks(left, 1.0 - left))
