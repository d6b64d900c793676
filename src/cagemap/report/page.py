"""The report as one HTML page that needs nothing beside it: pictures are data URIs, no scripts, no addresses."""

from __future__ import annotations

import base64
import tempfile
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from cagemap.errors import FormatError, in_options
from cagemap.files.ownership import mark
from cagemap.files.result.folder import assurance, landmark_messages
from cagemap.maps.hypotheses.confidence import SURE, TWO
from cagemap.maps.result import MatchResult
from cagemap.pictures import Image, distinct_colors
from cagemap.report.figures import Figure, Gallery
from cagemap.report.rig_panels import Panel
from cagemap.report.verdicts import explain, overall

_VERDICTS = {
    "good": "The map looks sound.",
    "fair": "The map is usable; look at the places named below.",
    "poor": "Do not use this map as it is.",
}
# In place of "usable", where a map with few landmarks or none is not sure.
_UNSURE = "Look at this map first: it may not be the right one."
_STYLE = "style.css"


def build_page(result: MatchResult, gallery: Gallery, panels: tuple[Panel, ...] = ()) -> str:
    """HTML text of the report; panels show what was made with the map."""
    manifest = result.manifest
    quality = manifest.get("quality") or {}
    warnings = landmark_messages(manifest) + [str(text) for text in (quality.get("warnings") or [])]
    merits = explain(quality)
    verdict = overall(merits, warnings)
    title = f"{_stem(result.source.control.name)} → {_stem(result.target.control.name)}"
    style = resources.files("cagemap.report").joinpath(_STYLE).read_text(encoding="utf-8")
    sections = [
        _header(result, title, verdict),
        _warnings(warnings, [*filter(None, [assurance(manifest)]), *map(str, manifest.get("notes") or [])]),
        _section(
            f"The {escape(gallery.appearance)}, transferred",
            "Left the source as it came, right the target with what it received, from the same directions. "
            f"Of the target, {escape(gallery.orientation)}.",
            "".join(_pair(figure, result) for figure in gallery.looks),
        ),
        _section(
            "The map as colours",
            "Points of equal colour correspond; the faint checker shows stretch."
            + (" Dots are landmarks: equal dots should sit on equal places." if len(result.landmarks) else "")
            + (" Lines are curves: equal lines should lie on equal places." if len(result.curves) else ""),
            "".join(_pair(figure, result) for figure in gallery.maps),
        ),
        _answers(result, gallery),
        _section(
            "Where to trust it",
            "The target. Grey: unfolded and stretched little. Red: folded or stretched strongly; look there first.",
            '<div class="pair">' + "".join(_picture(f.target, f.view) for f in gallery.trust) + "</div>",
        ),
        _section(
            "What was matched",
            "Dark: masked, neither matched nor transferred. The target shows both masks, the source its own.",
            "".join(_pair(figure, result) for figure in gallery.masks),
        )
        if gallery.masks
        else "",
        *(_section(escape(panel.title), escape(panel.lead), _panel(panel)) for panel in panels),
        _section("Quality", "Measured on this map, without knowing the true one.", _merits(merits)),
        _section("Landmarks", "Miss as a share of the model's size.", _landmarks(result))
        if len(result.landmarks)
        else "",
        _section("Curves", "Distance between a curve and its counterpart, both ways.", _curves(result))
        if len(result.curves)
        else "",
        _section("Time", _time_summary(manifest), _timings(manifest.get("timings") or {})),
        _section("How it was made", "", _provenance(result)),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="generator" content="{mark()}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)} · cagemap</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + "\n</main>\n</body>\n</html>\n"
    )


def data_uri(image: Image) -> str:
    """The picture as a JPEG data URI."""
    height, width = image.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, oiio.UINT8)
    spec.attribute("compression", "jpeg:90")
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(0, width, 0, height, 0, 1, 0, 3), np.ascontiguousarray(image))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.jpg"
        if not buffer.write(str(path)):
            raise FormatError(f"report: a picture could not be encoded ({buffer.geterror()}). Is the disk full?")
        encoded = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:image/jpeg;base64,{encoded}"


def _stem(name: str) -> str:
    return Path(name).stem or name


def _section(title: str, lead: str, body: str) -> str:
    lead_html = f'<p class="lead">{lead}</p>' if lead else ""
    return f"<section>\n<h2>{title}</h2>\n{lead_html}\n{body}\n</section>"


def _header(result: MatchResult, title: str, verdict: str) -> str:
    manifest = result.manifest
    chips = [
        f"{len(result.target.vertices):,} target vertices",
        f"{len(result.source.vertices):,} source vertices",
        f"{len(result.landmarks)} landmark{'' if len(result.landmarks) == 1 else 's'}",
    ]
    unsure = result.confidence is not None and result.confidence.verdict != SURE
    said = _UNSURE if unsure and verdict == "fair" else _VERDICTS[verdict]
    seconds = _total(manifest.get("timings") or {})
    chips += [f"{seconds:.1f} s"] if seconds else []
    return (
        f'<header>\n<p class="brand">cagemap</p>\n<h1>{escape(title)}</h1>\n'
        f'<p class="verdict {verdict}">{said}</p>\n'
        '<ul class="chips">' + "".join(f"<li>{chip.replace(',', ' ')}</li>" for chip in chips) + "</ul>\n</header>"
    )


def _warnings(warnings: list[str], notes: list[str]) -> str:
    items = [f'<li class="warning">{escape(in_options(text))}</li>' for text in warnings]
    items += [f"<li>{escape(text)}</li>" for text in notes]
    return f'<ul class="notes">{"".join(items)}</ul>' if items else ""


def _picture(image: Image, caption: str) -> str:
    return (
        f'<figure><img src="{data_uri(image)}" width="{image.shape[1]}" height="{image.shape[0]}" '
        f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def _panel(panel: Panel) -> str:
    return '<div class="pair">' + "".join(_picture(image, caption) for image, caption in panel.pictures) + "</div>"


def _pair(figure: Figure, result: MatchResult) -> str:
    source = _stem(result.source.control.name)
    target = _stem(result.target.control.name)
    left = "" if figure.source is None else _picture(figure.source, f"{source} (source), {figure.view}")
    return f'<div class="pair">{left}{_picture(figure.target, f"{target} (target), {figure.view}")}</div>'


def _answers(result: MatchResult, gallery: Gallery) -> str:
    """The map and its runner-up side by side, where it is not sure which is right."""
    if result.confidence is None or not gallery.answers:
        return ""
    best, other = result.confidence.readings[:2]
    body = "".join(
        '<div class="pair">'
        + _picture(found.target, f"this map: {best.name}, {found.view}")
        + _picture(runner.target, f"the other: {other.name}, {found.view}")
        + ("" if runner.source is None else _picture(runner.source, f"the source's own colours, {found.view}"))
        + _picture(apart.target, f"red: where the two differ, {found.view}")
        + "</div>"
        for found, (runner, apart) in zip(gallery.maps, gallery.answers, strict=True)
    )
    lead = (
        "Colours say where on the source a point goes, as above: the right map has the source's colours in the right "
        "places. A landmark where they differ decides; `answer=1` takes the other."
    )
    title = "Two answers" if result.confidence.verdict == TWO else "The next best answer"
    return _section(f"{title}: which is right?", in_options(lead), body)


def _merits(merits: list[Any]) -> str:
    cards = [
        f'<div class="card {m.verdict}"><p class="label">{escape(m.label)}</p><p class="value">{escape(m.value)}</p>'
        f"<p>{escape(m.meaning)}</p></div>"
        for m in merits
    ]
    return f'<div class="cards">{"".join(cards)}</div>' if cards else "<p>No figures were stored with this result.</p>"


def _landmarks(result: MatchResult) -> str:
    count, names = len(result.landmarks), result.landmark_names
    left_out = {suspect.pair for suspect in result.suspects}
    vertices = [points.nearest_vertices for points in (result.landmarks.source_points, result.landmarks.target_points)]
    rows = []
    for number, color in enumerate(distinct_colors(count)):
        red, green, blue = np.round(color * 255).astype(int)
        error = 100 * float(result.landmark_errors[number])
        rows.append(
            f'<tr><td><span class="dot" style="background:rgb({red},{green},{blue})"></span>'
            f"{escape(names[number])}</td><td>{vertices[0][number]}</td><td>{vertices[1][number]}</td>"
            f"<td>{error:.2f} %{', left out' if number in left_out else ''}</td></tr>"
        )
    head = "<tr><th>landmark</th><th>source vertex</th><th>target vertex</th><th>miss</th></tr>"
    return f'<table class="columns">{head}{"".join(rows)}</table>'


def _curves(result: MatchResult) -> str:
    rows = []
    for entry, color in zip(result.manifest.get("curves") or [], distinct_colors(len(result.curves)), strict=True):
        red, green, blue = np.round(color * 255).astype(int)
        dot = f'<span class="dot" style="background:rgb({red},{green},{blue})"></span>'
        rows.append(
            f"<tr><td>{dot}{escape(entry['name'])}</td>"
            f"<td>{100 * entry['mean']:.2f} %</td><td>{100 * entry['worst']:.2f} %</td></tr>"
        )
    return f'<table class="columns"><tr><th>curve</th><th>mean miss</th><th>at most</th></tr>{"".join(rows)}</table>'


def _total(timings: dict[str, Any]) -> float:
    return sum(float(value) for value in timings.values() if isinstance(value, int | float))


def _time_summary(manifest: dict[str, Any]) -> str:
    memory = manifest.get("peak_memory_bytes")
    peak = f", {memory / 2**30:.1f} GiB of memory at most" if isinstance(memory, int | float) else ""
    return f"{_total(manifest.get('timings') or {}):.1f} seconds in all{peak}."


def _timings(timings: dict[str, Any]) -> str:
    stages = {name: float(value) for name, value in timings.items() if isinstance(value, int | float)}
    longest = max(stages.values(), default=0.0) or 1.0
    rows = [
        f'<tr><td>{escape(name)}</td><td class="bar"><span style="width:{100 * seconds / longest:.1f}%"></span></td>'
        f"<td>{seconds:.2f} s</td></tr>"
        for name, seconds in stages.items()
    ]
    return f'<table class="bars">{"".join(rows)}</table>'


def _provenance(result: MatchResult) -> str:
    manifest = result.manifest
    entries: dict[str, Any] = {}
    for side_name, side in (("source", result.source), ("target", result.target)):
        entries[side_name] = (
            f"{side.control.name}: {side.control.n_vertices} control vertices, {side.control.n_faces} faces, "
            f"{side.refinement.scheme} to level {side.refinement.n_levels}"
        )
    for group in ("parameters", "versions", "inputs"):
        entries |= flattened(group, manifest.get(group) or {})
    rows = [
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in entries.items()
        if value is not None
    ]
    return f'<table class="facts">{"".join(rows)}</table>'


def flattened(prefix: str, value: Any) -> dict[str, Any]:
    """Nested dicts as one, names joined by dots."""
    if not isinstance(value, dict):
        return {prefix: value}
    entries: dict[str, Any] = {}
    for name, entry in value.items():
        entries |= flattened(f"{prefix}.{name}" if prefix else name, entry)
    return entries
