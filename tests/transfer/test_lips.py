"""A face with a mouth: lips that close on the source close on the target, and do not go through each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import match, prepare_surfaces
from cagemap.subdivision import Refinement, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.blend_shapes import ShapeCarrier, carry_shape, prepare_shapes

from quick_match import QUICK

MOUTH = (0.30, 0.11)


def ring(u: float, width: float, height: float, depth: float) -> tuple[float, float, float]:
    """Place along the axis and half axes of a ring: the head from behind (0), the lips (0.6 to 0.75), the mouth (1)."""
    if u <= 0.6:
        angle, share = np.pi * (0.08 + u / 0.75), (u / 0.6) ** 3
        size = np.sin(angle) * (1 - share)
        return -np.cos(angle), size + 1.35 * share * width, size + 2.1 * share * height
    if u <= 0.75:
        s = (u - 0.6) / 0.15
        inward = np.sin(np.pi / 2 * s)
        forward = 0.86 + 0.17 * np.sin(0.9 * np.pi * s) - 0.05 * s
        return forward, width * (1.35 - 0.35 * inward), height * (2.1 - 1.1 * inward)
    s = (u - 0.75) / 0.25
    wide, narrow = np.sin(np.pi * min(s, 0.85)), max(0.0, s - 0.8) / 0.2
    return (
        0.81 - depth * s,
        width * (1 + 0.5 * wide) * (1 - 0.5 * narrow),
        height * (1 + 1.5 * wide) * (1 - 0.3 * narrow),
    )


def head(rings: list[float], around: int, width: float, height: float, size: tuple[float, ...], depth: float):
    """A head with an open mouth and the cavity behind it, and the ring (n,) that every vertex is on."""
    angle = 2 * np.pi * np.arange(around) / around
    parts = [(z, x * np.cos(angle), y * np.sin(angle)) for z, x, y in (ring(u, width, height, depth) for u in rings)]
    places = np.concatenate([np.column_stack([x, y, np.full(around, z)]) for z, x, y in parts]) * size
    first = around * np.arange(len(rings) - 1)[:, None] + np.arange(around)
    second = around * np.arange(len(rings) - 1)[:, None] + (np.arange(around) + 1) % around
    quads = np.stack([first, second, second + around, first + around], axis=2).reshape(-1, 4)
    caps = [list(range(around))[::-1], [around * (len(rings) - 1) + i for i in range(around)]]
    return ControlMesh.from_faces(places, [*quads.tolist(), *caps]), np.repeat(rings, around)


SOURCE = (
    [0, 0.08, 0.16, 0.24, 0.32, 0.4, 0.47, 0.53, 0.58, 0.62, 0.66, 0.70, 0.74, 0.78, 0.84, 0.9, 0.96, 1.0],
    20, *MOUTH, (1.0, 1.15, 1.0), 0.55,
)  # fmt: skip
TARGET = (
    [0, 0.1, 0.2, 0.3, 0.38, 0.45, 0.51, 0.56, 0.605, 0.64, 0.675, 0.71, 0.745, 0.79, 0.86, 0.93, 1.0],
    28, 0.36, 0.13, (1.1, 1.0, 0.95), 0.6,
)  # fmt: skip


def closing(control: ControlMesh, rings: np.ndarray, gap: float = 0.008) -> np.ndarray:
    """Displacement that closes the lips to a gap."""
    share = np.interp(rings, [0.35, 0.6, 0.66, 0.76, 0.9, 1.0], [0, 0.55, 1.0, 1.0, 0.35, 0.0])
    y = control.positions[:, 1]
    up = np.where(np.abs(y) < 1e-9, 0.0, np.sign(y))
    return np.column_stack([0 * y, -share * (y - 0.5 * gap * up), 0 * y])


@pytest.fixture(scope="module")
def heads() -> tuple[Refinement, Refinement, PointMap, np.ndarray, np.ndarray]:
    """Target, source, the map between them, and the rings of both cages."""
    (source, source_rings), (target, target_rings) = head(*SOURCE), head(*TARGET)

    def vertices(control: ControlMesh, rings: np.ndarray, us: tuple[float, ...]) -> np.ndarray:
        found = []
        for u in us:
            own = np.flatnonzero(rings == u)
            found += [own[len(own) * quarter // 4] for quarter in range(4)]
        return np.array(found)

    landmarks = Landmarks(
        names=tuple(f"{k}" for k in range(16)),
        target=vertices(target, target_rings, (0.675, 0.38, 0.86, 0.0)),
        source=vertices(source, source_rings, (0.66, 0.4, 0.84, 0.0)),
    )
    sides = prepare_surfaces(replace(target, name="target"), replace(source, name="source"), (2, 2))
    found = match(*sides, landmarks, QUICK)
    return sides[0].refinement, sides[1].refinement, found.point_map, target_rings, source_rings


def lip_gaps(refinement: Refinement, moved: np.ndarray, rings: np.ndarray) -> np.ndarray:
    """Height between upper and lower lip, from one corner of the mouth to the other; below zero they overlap."""
    rest = refinement.finest.positions
    lip = refinement.prolong(rings[:, None], 0, refinement.finest_level)[:, 0]
    x, upper = rest[:, 0], rest[:, 1] > 0
    lip = (lip > 0.63) & (lip < 0.75)
    half = 0.75 * np.abs(x[lip]).min(initial=np.inf, where=np.abs(rest[lip, 1]) < 1e-3)
    gaps = []
    for place in np.linspace(-half, half, 15):
        near = lip & (np.abs(x - place) < 0.03)
        gaps.append(moved[near & upper, 1].min() - moved[near & ~upper, 1].max())
    return np.array(gaps)


def carried(carrier: ShapeCarrier, target: Refinement, shape: np.ndarray) -> np.ndarray:
    return target.prolong(target.control.positions + carry_shape(carrier, shape), 0, target.finest_level)


@pytest.mark.slow
def test_closed_lips_are_closed_on_the_other_head_and_do_not_overlap(heads) -> None:
    target, source, point_map, target_rings, source_rings = heads
    shape = closing(source.control, source_rings)
    carrier = prepare_shapes(target, source, point_map)
    given = lip_gaps(source, source.finest.positions + source.prolong(shape, 0, source.finest_level), source_rings)
    np.testing.assert_allclose(given, 0.008, atol=1e-3)
    gaps = lip_gaps(target, carried(carrier, target, shape), target_rings)
    rest = lip_gaps(target, target.finest.positions, target_rings)
    assert rest.max() > 0.2
    assert gaps.min() > 0.0
    assert gaps.max() < 0.02


@pytest.mark.slow
def test_lips_that_are_closed_at_rest_do_not_move_the_other_head(heads) -> None:
    target, source, point_map, _, source_rings = heads
    # The source's own lips are closed; the target's are open and stay so where nothing moves.
    closed = source.control.positions + closing(source.control, source_rings)
    finest = source.prolong(closed, 0, source.finest_level)
    given = replace(point_map.source, positions=point_map.source.scale * finest)
    images = replace(point_map.images, surface=given)
    shut = replace(
        source, levels=tuple(replace(level, positions=finest[: level.n_vertices]) for level in source.levels)
    )
    carrier = prepare_shapes(target, shut, PointMap(point_map.target, images))
    np.testing.assert_allclose(carry_shape(carrier, np.zeros_like(closed)), 0.0, atol=1e-9)


@pytest.mark.slow
def test_contacts_do_not_depend_on_the_numbers_of_vertices(heads) -> None:
    target, source, point_map, _, source_rings = heads
    shape, control = closing(source.control, source_rings), target.control
    last = control.n_vertices - 1
    renumbered = refine(
        ControlMesh(control.positions[::-1], control.face_offsets, last - control.face_indices, scheme=target.scheme), 2
    )
    same = cKDTree(target.finest.positions).query(renumbered.finest.positions)[1]
    surface = TriangleSurface.from_faces(point_map.target.positions[same], renumbered.finest.faces)
    found = PointMap.from_arrays(surface, point_map.source, point_map.triangle[same], point_map.barycentric[same])
    surface = replace(found.target, scale=point_map.target.scale)
    carrier = prepare_shapes(renumbered, source, replace(found, target=surface))
    expected = carry_shape(prepare_shapes(target, source, point_map), shape)
    np.testing.assert_allclose(carry_shape(carrier, shape)[::-1], expected, rtol=0, atol=1e-9)
