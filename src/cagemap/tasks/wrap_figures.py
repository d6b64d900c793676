"""Distances and folded faces of a wrap: as values, as lines for the terminal, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cagemap.mesh.mesh_report import place_text
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.wrap import Wrapped

# Least share of the target's area without a counterpart that is reported; less is single triangles.
_MIN_LEFT_OUT = 5e-4
# Largest ratio of lengths of bodies in one unit, of a child and a giant; between units it is 10 or more.
MAX_BODY_RATIO = 3.0


def wrap_figures(wrapped: Wrapped) -> dict[str, Any]:
    """Figures of a wrap: distances in units of sqrt(area), their places in the source's file, folded faces."""
    source, counterparts = wrapped.closest.source, np.flatnonzero(wrapped.has_counterpart)
    on_wrap, on_source = (wrapped.distance, wrapped.surface), (wrapped.source_distance, source.positions / source.scale)
    return {
        "fit_level": wrapped.level,
        "residual": _figures(*on_wrap, np.arange(len(wrapped.distance))) | {"without_counterpart": wrapped.left_out},
        "residual_with_counterpart": _figures(*on_wrap, counterparts),
        "residual_from_source": _figures(*on_source, np.arange(source.n)),
        "folded_faces": [int(face) for face in wrapped.folded],
    }


def _figures(distance: FloatArray, positions: FloatArray, vertices: IndexArray) -> dict[str, Any]:
    """Figures of the distances of some vertices (k,), and the one with the largest."""
    among = distance[vertices]
    where = int(vertices[among.argmax()])
    return {
        "mean": float(among.mean()),
        "p99": float(np.percentile(among, 99)),
        "max": float(among.max()),
        "where": where,
        "place": positions[where].tolist(),
    }


def distances_text(figures: Mapping[str, Any], amount: float) -> str:
    """Lines about the distances of `wrap_figures`, for the terminal."""
    left_out = figures["residual"]["without_counterpart"]
    lines = [
        f"  distances{' of --amount 1' * (amount < 1.0)} in % of sqrt(area), over all vertices:",
        f"  of the wrap to the source: {_distance_text(figures['residual'])}",
        f"  of the source to the wrap: {_distance_text(figures['residual_from_source'])}",
    ]
    if left_out > _MIN_LEFT_OUT:
        lines += [
            f"  {100 * left_out:.1f} % of the target has no counterpart and follows its surroundings",
            f"  of the rest to the source: {_distance_text(figures['residual_with_counterpart'])}",
        ]
    return "\n".join(lines)


def _distance_text(residual: Mapping[str, Any]) -> str:
    return (
        f"mean {100 * residual['mean']:.4f}, 99 % within {100 * residual['p99']:.3f}, largest "
        f"{100 * residual['max']:.3f} at {place_text(residual['place'])}"
    )


def size_warnings(rest: FloatArray, wrapped: FloatArray) -> list[str]:
    """A warning of positions (n, 3) of very different extents, which no blend shape is meant to have."""
    ratio = float(np.ptp(wrapped, axis=0).max() / np.ptp(rest, axis=0).max())
    if 1.0 / MAX_BODY_RATIO <= ratio <= MAX_BODY_RATIO:
        return []
    return [f"the source is {ratio:.3g} times as large as the target, and so are the shapes: scale one of them first"]


def fold_warnings(figures: Mapping[str, Any]) -> list[str]:
    """A warning of folded faces, if there are any."""
    folded = figures["folded_faces"]
    if not folded:
        return []
    shown = ", ".join(map(str, folded[:10]))
    return [
        f"{len(folded)} faces turn against the surface: {shown}{' ...' if len(folded) > 10 else ''} "
        "(numbers from 0). A larger --fairness keeps the net smoother."
    ]
