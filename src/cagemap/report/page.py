"""The report as one self-contained HTML page."""

from __future__ import annotations

import base64
import tempfile
from dataclasses import dataclass
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
from cagemap.maps.regions import RegionFigures, region_figures
from cagemap.maps.result import MatchResult
from cagemap.mesh.mesh_report import counted
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import Image, distinct_colors
from cagemap.report.figures import Figure, Gallery
from cagemap.report.marks import Mark, with_marks
from cagemap.report.models import Models, pack
from cagemap.report.rig_panels import Panel
from cagemap.report.verdicts import explain, overall, sentence

# Of one texture, as JPEG: two of them leave room for the models in a page of 5 MB.
MAX_TEXTURE_BYTES = 700_000

_STYLE, _SCRIPTS = "style.css", ("three/three.min.js", "arrays.js", "viewer.js")
_QUALITY = 90  # of JPEG pictures
NOTABLE_ASPECT = 1.5  # from this median ratio on, a region is said to be stretched


@dataclass(frozen=True, eq=False)
class Texture:
    """A texture of the page, which its models wear: the id that they know it by, a caption, and a JPEG's bytes."""

    id: str
    caption: str
    content: bytes
    size: tuple[int, int]


def build_page(
    result: MatchResult,
    gallery: Gallery,
    panels: tuple[Panel, ...] = (),
    models: Models | None = None,
    textures: tuple[Texture, ...] = (),
) -> str:
    """HTML text of the report.

    Parameters
    ----------
    result : MatchResult
    gallery : Gallery
        Still pictures, for browsers without WebGL and for print.
    panels : tuple of Panel
        What was made with the map.
    models : Models, optional
        What turns.
    textures : tuple of Texture
        What the models wear.
    """
    manifest = result.manifest
    quality = manifest.get("quality") or {}
    marks = () if models is None else models.marks
    warnings = landmark_messages(manifest) + [str(text) for text in (quality.get("warnings") or [])]
    ratings = explain(quality)
    verdict = overall(ratings, warnings)
    title = f"{_stem(result.source.control.name)} → {_stem(result.target.control.name)}"
    made = [_fold(escape(panel.title), escape(panel.lead), _panel(panel)) for panel in panels]
    sections = [
        _header(title, sentence(ratings, verdict, unsure=_unsure(result), marked=bool(marks)), verdict),
        "" if models is None else _viewer(result, models),
        _stills(result, gallery),
        _marks(marks),
        _warnings(
            result,
            [with_marks(text, marks) for text in warnings],
            [*filter(None, [assurance(manifest)]), *map(str, manifest.get("notes") or [])],
        ),
        _answers(result, gallery),
        _textures(textures),
        *made,
        _fold("Numbers", "how good the map is, measured without knowing the true one", _numbers(result, ratings)),
        _fold(
            "Landmarks",
            "how far each is missed, as a share of the model's size; how long the target is around it where the source "
            "has length 1, both models at equal area",
            _landmarks(result),
        )
        if len(result.landmarks)
        else "",
        _fold("Curves", "distance between a curve and its counterpart, both ways", _curves(result))
        if len(result.curves)
        else "",
        _fold(
            "How it was made", _time_summary(manifest), _timings(manifest.get("timings") or {}) + _provenance(result)
        ),
    ]
    scripts = "" if models is None else _scripts(models, result)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="generator" content="{mark()}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)} · cagemap</title>\n<style>\n{_resource(_STYLE)}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + f"\n</main>\n{scripts}</body>\n</html>\n"
    )


def encoded_texture(id: str, caption: str, pixels: FloatArray) -> Texture:
    """A texture for the page: as large as `MAX_TEXTURE_BYTES` allow."""
    while True:
        image = np.round(255 * pixels).astype(np.uint8)
        content = _jpeg(image, 85)
        if len(content) <= MAX_TEXTURE_BYTES or max(pixels.shape[:2]) <= 256:
            return Texture(id, caption, content, (image.shape[1], image.shape[0]))
        height, width = (length // 2 * 2 for length in pixels.shape[:2])
        pixels = pixels[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))


def _resource(name: str) -> str:
    return resources.files("cagemap.report").joinpath(name).read_text(encoding="utf-8")


def _unsure(result: MatchResult) -> bool:
    return result.confidence is not None and result.confidence.verdict != SURE


def _scripts(models: Models, result: MatchResult) -> str:
    described, arrays = pack(models, result)
    return (
        f'<script type="application/json" id="models">{described}</script>\n'
        f'<script type="text/plain" id="models-data">{arrays}</script>\n'
        + "".join(f"<script>\n{_resource(name)}</script>\n" for name in _SCRIPTS)
    )


def _viewer(result: MatchResult, models: Models) -> str:
    """The models that turn, and what they are coloured by; shown where the browser can."""
    source, target = (escape(_stem(side.control.name)) for side in (result.source, result.target))
    looks = "".join(
        f'<label><input type="radio" name="look" value="{k}"{" checked" if k == 0 else ""}>'
        f"<span>{escape(look.name)}</span></label>"
        for k, look in enumerate(models.looks)
    )
    names = "".join(f'<option value="{k}">{escape(one.name)}</option>' for k, one in enumerate(models.shapes, start=1))
    shapes = f'<label>Shape <select><option value="0">at rest</option>{names}</select></label>' if names else ""
    dots = '<label><input type="checkbox" name="landmarks"> Landmarks</label>' if len(result.landmarks) else ""
    views = "".join(
        f'<button type="button" data-view="{view}">{said}</button>'
        for view, said in (("front", "Front"), ("side", "Side"), ("back", "Back"), ("start", "Reset"))
    )
    return (
        '<section id="viewer" aria-label="Models">\n<div class="tools">'
        f'<fieldset class="looks"><legend class="unseen">Colour by</legend>{looks}</fieldset>{shapes}{dots}'
        f'<div class="views">{views}</div></div>\n<div class="glass">'
        f'<canvas tabindex="0" role="img" aria-describedby="viewer-help" '
        f'aria-label="{source}, the source, and {target}, the target, which turn together"></canvas>'
        f'<div class="layer"></div><p class="name source">{source}<small>source</small></p>'
        f'<p class="name target">{target}<small>target</small></p></div>\n'
        '<div class="below"><p class="legend" aria-live="polite"></p>'
        '<p class="help" id="viewer-help">Drag: turn · right button: move · click, then wheel: zoom</p>'
        "</div>\n</section>"
    )


def _stills(result: MatchResult, gallery: Gallery) -> str:
    """The same as pictures."""
    dots = " Dots are landmarks: equal dots should sit on equal places." if len(result.landmarks) else ""
    lines = " Lines are curves: equal lines should lie on equal places." if len(result.curves) else ""
    parts = [
        _section(
            f"The {escape(gallery.appearance)}, transferred",
            "Left the source as it came, right the target with what it received, from the same directions. "
            f"Of the target, {escape(gallery.orientation)}.",
            "".join(_pair(figure, result) for figure in gallery.looks),
        ),
        _section(
            "The map as colours",
            f"Points of equal colour correspond; the faint checker shows stretch.{dots}{lines}",
            "".join(_pair(figure, result) for figure in gallery.maps),
        ),
        _section(
            "Where to trust it",
            "The target. Grey: unfolded and stretched little. Red: folded or stretched strongly; look there first.",
            '<div class="pair">' + "".join(_picture(f.target, f.view) for f in gallery.trust) + "</div>",
        ),
    ]
    if gallery.masks:
        parts.append(
            _section(
                "What was matched",
                "Dark: masked, neither matched nor transferred. The target shows both masks, the source its own.",
                "".join(_pair(figure, result) for figure in gallery.masks),
            )
        )
    return f'<div class="stills">\n{"".join(parts)}\n</div>'


def _marks(marks: tuple[Mark, ...]) -> str:
    """The list of marked places, each once."""
    first = {mark.number: (place, mark) for place, mark in reversed(list(enumerate(marks)))}
    items = "".join(
        f'<li><span class="number" aria-hidden="true">{number}</span><span>{escape(_capital(mark.text))}</span>'
        f'<button type="button" data-mark="{place}" aria-label="Show mark {number}">Show</button></li>'
        for number, (place, mark) in sorted(first.items())
    )
    return _section("Look here", "", f'<ul class="marks">{items}</ul>') if items else ""


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _textures(textures: tuple[Texture, ...]) -> str:
    figures = "".join(
        f'<figure><img id="{one.id}" src="{_uri(one.content)}" width="{one.size[0]}" height="{one.size[1]}" '
        f'alt="{escape(one.caption)}"><figcaption>{escape(one.caption)}</figcaption></figure>'
        for one in textures
    )
    return _fold("Textures", "as they lie in the layouts", f'<div class="pair">{figures}</div>') if figures else ""


def _fold(title: str, lead: str, body: str) -> str:
    return f"<details>\n<summary>{title}<small>{lead}</small></summary>\n{body}\n</details>"


def _numbers(result: MatchResult, ratings: list[Any]) -> str:
    chips = [
        f"{len(result.target.vertices):,} target vertices",
        f"{len(result.source.vertices):,} source vertices",
        counted(len(result.landmarks), "landmark"),
    ]
    listed = "".join(f"<li>{chip.replace(',', ' ')}</li>" for chip in chips)
    return f'<ul class="chips">{listed}</ul>{_ratings(ratings)}'


def data_uri(image: Image) -> str:
    """The picture as a JPEG data URI."""
    return _uri(_jpeg(image, _QUALITY))


def _uri(content: bytes) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(content).decode('ascii')}"


def _jpeg(image: Image, quality: int) -> bytes:
    height, width = image.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, oiio.UINT8)
    spec.attribute("compression", f"jpeg:{quality}")
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(0, width, 0, height, 0, 1, 0, 3), np.ascontiguousarray(image))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.jpg"
        if not buffer.write(str(path)):
            raise FormatError(f"report: a picture could not be encoded ({buffer.geterror()}). Is the disk full?")
        return path.read_bytes()


def _stem(name: str) -> str:
    return Path(name).stem or name


def _section(title: str, lead: str, body: str) -> str:
    lead_html = f'<p class="lead">{lead}</p>' if lead else ""
    return f"<section>\n<h2>{title}</h2>\n{lead_html}\n{body}\n</section>"


def _header(title: str, said: str, verdict: str) -> str:
    return (
        f'<header>\n<p class="brand">cagemap</p>\n<h1>{escape(title)}</h1>\n'
        f'<p class="verdict {verdict}">{escape(said)}</p>\n</header>'
    )


def _warnings(result: MatchResult, warnings: list[str], notes: list[str]) -> str:
    files = result.target.control.name, result.source.control.name

    def item(tag: str, text: str) -> str:
        words = in_options(text)
        return f"{tag}{escape(words if words.startswith(files) else _capital(words))}</li>"

    items = [item('<li class="warning">', text) for text in warnings] + [item("<li>", text) for text in notes]
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


def _ratings(ratings: list[Any]) -> str:
    cards = [
        f'<div class="card {m.verdict}"><p class="label">{escape(m.label)}</p><p class="value">{escape(m.value)}</p>'
        f"<p>{escape(m.meaning)}</p></div>"
        for m in ratings
    ]
    return f'<div class="cards">{"".join(cards)}</div>' if cards else "<p>No figures were stored with this result.</p>"


def _landmarks(result: MatchResult) -> str:
    names = result.landmark_names
    left_out = {suspect.pair for suspect in result.suspects}
    regions = {region.landmark: region for region in region_figures(result)} if len(result.trusted) else {}
    rows = []
    for number, color in enumerate(distinct_colors(len(names))):
        red, green, blue = np.round(color * 255).astype(int)
        error, name = 100 * float(result.landmark_errors[number]), escape(names[number])
        rows.append(
            f'<tr><td><span class="dot" style="background:rgb({red},{green},{blue})"></span>{name}</td>'
            f"<td>{error:.2f} %{', left out' if number in left_out else ''}</td>"
            f"<td>{_size(regions.get(names[number]))}</td>"
            f'<td><button type="button" data-landmark="{number}" aria-label="Show {name}">Show</button>'
            "</td></tr>"
        )
    head = "<tr><th>landmark</th><th>miss</th><th>size around it</th><td></td></tr>"
    return f'<table class="columns">{head}{"".join(rows)}</table>'


def _size(region: RegionFigures | None) -> str:
    """How the target differs from the source around a landmark."""
    if region is None:
        return ""
    said = f"{region.size:.2f}"
    if region.aspect_ratio > NOTABLE_ASPECT:
        said += f", stretched {region.aspect_ratio:.1f} : 1"
    if region.folded >= 0.001:
        said += f", {100 * region.folded:.1f} % folded"
    return said


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
