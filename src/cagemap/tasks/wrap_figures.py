"""Distances and folded faces of a wrap: as values, as lines for the terminal, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cagemap.mesh.mesh_report import place_text
from cagemap.numerics.arrays import FloatArray
from cagemap.wrap import Residual, Wrapped

# Least share of the target's area without a counterpart that is reported; less is single triangles.
_MIN_LEFT_OUT = 5e-4
# Largest ratio of lengths of bodies in one unit, of a child and a giant; between units it is 10 or more.
MAX_BODY_RATIO = 3.0


def wrap_figures(wrapped: Wrapped) -> dict[str, Any]:
    """Figures of a wrap: distances in units of sqrt(area), their places in the source's file, folded faces."""
    source = wrapped.closest.source
    return {
        "fit_level": wrapped.level,
        "residual": _figures(wrapped.residual, wrapped.surface) | {"without_counterpart": wrapped.left_out},
        "residual_with_counterpart": _figures(wrapped.followed, wrapped.surface),
        "residual_from_source": _figures(wrapped.from_source, source.positions / source.scale),
        "folded_faces": [int(face) for face in wrapped.folded],
    }


def _figures(residual: Residual, positions: FloatArray) -> dict[str, Any]:
    place = positions[residual.where].tolist()
    return {
        "mean": residual.mean,
        "p99": residual.p99,
        "max": residual.largest,
        "where": residual.where,
        "place": place,
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
