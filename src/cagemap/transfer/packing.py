"""Pack UV islands into the unit square by a skyline heuristic.

The horizon is the height reached so far in every column of the square. An island is placed where its lower outline
wastes the least area above the horizon (Levy, Petitjean, Ray, Maillot, *Least squares conformal maps for automatic
texture atlas generation*, 2002, section 4).
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, members_of

_COLUMNS = 512
_ANGLES = np.deg2rad(np.arange(0.0, 90.0, 2.0))
_QUARTER_TURNS = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]], dtype=float)
# Packings that are tried, and most of them until one fits; each takes its side from the previous one.
_ROUNDS, _MAX_ROUNDS = 4, 12
# Largest ratio of a packing's height to its width; the padding allows for it.
_PACKING_SLACK = 1.1
# Cost of growing the packing taller, as a share of a whole row of the square.
_HEIGHT_SHARE = 0.25


# Points (q, 2) of an island, and its edges as pairs of points.
_Island = tuple[FloatArray, IndexArray]


def pack_islands(uvs: FloatArray, edges: IndexArray, islands: IndexArray, padding: float) -> FloatArray:
    """Rotate, move and scale islands, all by one factor, into the unit square.

    ``edges`` (e, 2) of the islands' polygons are pairs of UVs (p, 2), ``islands`` (p,) the island of each. ``padding``
    is the least distance between islands, as a part of the square's side. Half of it is left at the border.
    ParameterError if it is negative, or leaves no room.
    """
    members = members_of(islands)
    too_wide = ParameterError(
        f"padding: expected 0 or more, and so little that {len(members)} islands fit into the square, got {padding:g}"
    )
    if not (padding >= 0 and padding**2 * len(members) < 1):
        raise too_wide
    local = np.empty(len(uvs), dtype=np.int64)
    for rows in members:
        local[rows] = np.arange(len(rows))
    shapes = [
        (_rotate_upright(uvs[rows]), local[edges[edge_rows]])
        for rows, edge_rows in zip(members, members_of(islands[edges[:, 0]]), strict=True)
    ]
    boxes = np.array([np.ptp(points, axis=0) for points, _ in shapes])
    side = max(1.2 * float(np.sqrt(boxes.prod(axis=1).sum())), float(boxes.max()))
    best, rounds = np.inf, 0
    packed = np.empty_like(uvs)
    while rounds < _ROUNDS or not np.isfinite(best):
        rounds += 1
        placed, height = _place_islands(shapes, boxes, side, padding * _PACKING_SLACK * side)
        if rounds > _MAX_ROUNDS or not np.isfinite(height):
            raise too_wide
        extent = max(side, height)
        if extent < best and extent <= _PACKING_SLACK * side:
            best = extent
            for rows, points in zip(members, placed, strict=True):
                packed[rows] = points / extent
        side = max(float(np.sqrt(side * height)), float(boxes.max()) * (1 + 4 * padding))
    return packed


def _rotate_upright(points: FloatArray) -> FloatArray:
    """Points of an island rotated so that their bounding box is smallest."""
    c, s = np.cos(_ANGLES), np.sin(_ANGLES)
    x, y = points.T
    turned = np.stack([np.outer(c, x) - np.outer(s, y), np.outer(s, x) + np.outer(c, y)], axis=2)
    area = np.ptp(turned, axis=1).prod(axis=1)
    return np.asarray(turned[np.flatnonzero(area <= area.min() * (1 + 1e-9))[0]])


def _place_islands(
    shapes: list[_Island], boxes: FloatArray, side: float, margin: float
) -> tuple[list[FloatArray], float]:
    """Points of all islands placed in a strip of width ``side``, the longest first, and its height.

    The height is infinite if an island with its margin is wider than the strip.
    """
    column = side / _COLUMNS
    horizon = np.zeros(_COLUMNS)
    placed = [points for points, _ in shapes]
    for island in np.lexsort((-boxes.prod(axis=1), -boxes.max(axis=1))):
        best = np.inf
        chosen: tuple[FloatArray, FloatArray, int, float] | None = None
        for turn in _QUARTER_TURNS:
            points = shapes[island][0] @ turn.T
            lower, upper, origin = _profile(points, shapes[island][1], column, margin)
            if len(lower) > _COLUMNS:
                continue
            windows = sliding_window_view(horizon, len(lower))
            floors = (windows - lower).max(axis=1)
            # Area wasted beneath, plus a share of the cost of growing taller.
            beneath = (len(lower) * floors + lower.sum() - windows.sum(axis=1)) * column
            cost = beneath + (floors + upper.max()) * side * _HEIGHT_SHARE
            at = int(cost.argmin())
            if cost[at] < best * (1 - 1e-9):
                best, chosen = float(cost[at]), (points - origin, upper, at, float(floors[at]))
        if chosen is None:
            return placed, np.inf
        points, upper, at, floor = chosen
        placed[island] = points + np.array([at * column, floor])
        horizon[at : at + len(upper)] = floor + upper
    return placed, float(horizon.max())


def _profile(points: FloatArray, edges: IndexArray, column: float, margin: float) -> tuple[FloatArray, ...]:
    """Lower and upper outline of an island with a margin, per column above its lowest corner; and the corner."""
    low = points.min(axis=0)
    reach = 0.5 * margin  # each of two neighbours adds half
    a, b = points[edges[:, 0]] - low, points[edges[:, 1]] - low
    steps = np.maximum(np.ceil(2 * np.abs(b - a)[:, 0] / column).astype(np.int64), 1) + 1
    edge = np.repeat(np.arange(len(edges)), steps)
    first = np.cumsum(steps) - steps
    t = (np.arange(len(edge)) - first[edge]) / (steps[edge] - 1)
    along = a[edge] + t[:, None] * (b - a)[edge]
    # Columns within the margin, and one for points between two samples.
    cover = int(np.ceil(reach / column)) + 1
    cells = (along[:, 0] / column).astype(np.int64) + cover
    width = int(cells.max()) + cover + 1
    lower, upper = np.full(width, np.inf), np.full(width, -np.inf)
    np.minimum.at(lower, cells, along[:, 1])
    np.maximum.at(upper, cells, along[:, 1])
    lower = sliding_window_view(np.pad(lower, cover, constant_values=np.inf), 2 * cover + 1).min(axis=1)
    upper = sliding_window_view(np.pad(upper, cover, constant_values=-np.inf), 2 * cover + 1).max(axis=1)
    shift = np.array([cover * column, reach])
    return lower, upper + 2 * reach, low - shift
