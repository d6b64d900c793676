"""Distances and folded faces of a wrap: as values, as lines for the terminal, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cagemap.mesh.mesh_report import place_text
from cagemap.numerics.arrays import FloatArray
from cagemap.wrap import Residual, Wrapped

# Least share of the target's area without a counterpart that is reported; less is single triangles.
_MIN_LEFT_OUT = 5e-4


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


def distances_text(figures: Mapping[str, Any]) -> str:
    """Lines about the distances of `wrap_figures`, for the terminal."""
    left_out = figures["residual"]["without_counterpart"]
    lines = [
        "  distances in % of sqrt(area), over all vertices:",
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
