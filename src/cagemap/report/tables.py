"""Tables of a report: figures, landmarks, curves, times and settings."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from cagemap.files.result.verdicts import Rating
from cagemap.files.text import flatten_entries
from cagemap.maps.regions import RegionFigures, region_figures
from cagemap.maps.result import MatchResult
from cagemap.mesh.schemes import Plain, scheme_name
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import distinct_colors
from cagemap.subdivision import Refinement

MIN_NOTED_ASPECT_RATIO = 1.5  # least median of a region that is called stretched


def rating_cards(ratings: list[Rating]) -> str:
    """One card for each figure, with value and meaning."""
    cards = [
        f'<div class="card {rating.verdict}"><p class="label">{escape(rating.label)}</p>'
        f'<p class="value">{escape(rating.value)}</p><p>{escape(rating.meaning)}</p></div>'
        for rating in ratings
    ]
    return f'<div class="cards">{"".join(cards)}</div>' if cards else "<p>No figures were stored with this result.</p>"


def landmark_table(result: MatchResult) -> str:
    """Miss of every landmark, and size of the target around it."""
    names = result.landmarks.names
    left_out = {suspect.pair for suspect in result.suspects}
    regions = {region.landmark: region for region in region_figures(result)} if len(result.trusted) else {}
    rows = []
    for number, color in enumerate(distinct_colors(len(names))):
        error, name = 100 * float(result.landmark_errors[number]), escape(names[number])
        rows.append(
            f"<tr><td>{_dot(color)}{name}</td>"
            f"<td>{error:.2f} %{', left out' if number in left_out else ''}</td>"
            f"<td>{_size_text(regions.get(names[number]))}</td>"
            f'<td><button type="button" data-landmark="{number}" aria-label="Show {name}">Show</button>'
            "</td></tr>"
        )
    head = "<tr><th>landmark</th><th>miss</th><th>size around it</th><td></td></tr>"
    return f'<table class="columns">{head}{"".join(rows)}</table>'


def _dot(color: FloatArray) -> str:
    red, green, blue = np.round(color * 255).astype(int)
    return f'<span class="dot" style="background:rgb({red},{green},{blue})"></span>'


def _size_text(region: RegionFigures | None) -> str:
    """Size, stretch and folds of the target around a landmark."""
    if region is None:
        return ""
    text = f"{region.size:.2f}"
    if region.aspect_ratio > MIN_NOTED_ASPECT_RATIO:
        text += f", stretched {region.aspect_ratio:.1f} : 1"
    if region.folded >= 0.001:
        text += f", {100 * region.folded:.1f} % folded"
    return text


def curve_table(result: MatchResult) -> str:
    """Mean and largest miss of every curve."""
    rows = []
    for entry, color in zip(
        result.manifest.get("curves") or [], distinct_colors(len(result.landmarks.curves)), strict=True
    ):
        rows.append(
            f"<tr><td>{_dot(color)}{escape(entry['name'])}</td>"
            f"<td>{100 * entry['mean']:.2f} %</td><td>{100 * entry['worst']:.2f} %</td></tr>"
        )
    return (
        f'<table class="columns"><tr><th>curve</th><th>mean miss</th><th>largest miss</th></tr>{"".join(rows)}</table>'
    )


def time_summary(manifest: dict[str, Any]) -> str:
    """Total time and memory of the match, as a sentence."""
    memory = manifest.get("peak_memory_bytes")
    peak = f", {memory / 2**30:.1f} GiB peak memory" if isinstance(memory, int | float) else ""
    seconds = sum(value for value in (manifest.get("timings") or {}).values() if isinstance(value, int | float))
    return f"{seconds:.1f} seconds in all{peak}."


def timing_table(timings: dict[str, Any]) -> str:
    """Seconds of every stage, as bars."""
    stages = {name: float(value) for name, value in timings.items() if isinstance(value, int | float)}
    longest = max(stages.values(), default=0.0) or 1.0
    rows = [
        f'<tr><td>{escape(name)}</td><td class="bar"><span style="width:{100 * seconds / longest:.1f}%"></span></td>'
        f"<td>{seconds:.2f} s</td></tr>"
        for name, seconds in stages.items()
    ]
    return f'<table class="bars">{"".join(rows)}</table>'


def provenance_table(result: MatchResult) -> str:
    """Models, parameters, versions and inputs."""
    manifest = result.manifest
    entries: dict[str, Any] = {}
    for side_name, side in (("source", result.source), ("target", result.target)):
        entries[side_name] = (
            f"{side.control.name}: {side.control.n_vertices} control vertices, {side.control.n_faces} faces, "
            f"{_subdivision(side.refinement)}"
        )
    for group in ("parameters", "versions", "inputs"):
        entries |= flatten_entries(group, manifest.get(group) or {})
    rows = [
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in entries.items()
        if value is not None
    ]
    return f'<table class="facts">{"".join(rows)}</table>'


def _subdivision(refinement: Refinement) -> str:
    """How a surface is subdivided, for users."""
    scheme, level = refinement.scheme, refinement.finest_level
    return "not subdivided" if isinstance(scheme, Plain) else f"{scheme_name(scheme)} to level {level}"
