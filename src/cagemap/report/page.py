"""The report as one self-contained HTML page."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from cagemap.errors import FormatError, use_option_names
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import assurance, landmark_messages
from cagemap.maps.hypotheses.confidence import SURE, TWO
from cagemap.maps.regions import RegionFigures, region_figures
from cagemap.maps.result import MatchResult
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import Image, distinct_colors
from cagemap.report.figures import Figure, Gallery
from cagemap.report.marks import Mark, name_marks
from cagemap.report.models import Models, pack_models
from cagemap.report.rig_panels import Panel
from cagemap.report.verdicts import Rating, overall_verdict, rate_figures, verdict_sentence

# Of one texture as JPEG: two textures and the models fit into a page of 5 MB.
MAX_TEXTURE_BYTES = 700_000

_STYLE, _SCRIPTS = "style.css", ("three/three.min.js", "arrays.js", "viewer.js")
JPEG_QUALITY, TEXTURE_JPEG_QUALITY = 90, 85
MIN_NOTED_ASPECT_RATIO = 1.5  # median of a region from which the page says that it is stretched


@dataclass(frozen=True, eq=False)
class Texture:
    """A texture of the models: HTML id, caption, JPEG bytes, width and height."""

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
        Pictures of carried data.
    models : Models, optional
        Models in three dimensions.
    textures : tuple of Texture
        Of the models.
    """
    manifest = result.manifest
    quality = manifest.get("quality") or {}
    marks = () if models is None else models.marks
    warnings = landmark_messages(manifest) + [str(text) for text in (quality.get("warnings") or [])]
    ratings = rate_figures(quality)
    verdict = overall_verdict(ratings, warnings)
    title = f"{_stem(result.source.control.name)} → {_stem(result.target.control.name)}"
    panel_sections = [_details(escape(panel.title), escape(panel.lead), _pictures(panel.pictures)) for panel in panels]
    sections = [
        _page_header(title, verdict_sentence(ratings, verdict, unsure=_unsure(result), marked=bool(marks)), verdict),
        "" if models is None else _viewer_section(result, models),
        _still_pictures(result, gallery),
        _mark_list(marks),
        _message_list(
            result,
            [name_marks(text, marks) for text in warnings],
            [*filter(None, [assurance(manifest)]), *map(str, manifest.get("notes") or [])],
        ),
        _answers_section(result, gallery),
        _texture_section(textures),
        *panel_sections,
        _details(
            "Numbers", "how good the map is, measured without knowing the true one", _figure_section(result, ratings)
        ),
        _details(
            "Landmarks",
            "how far each is missed, as a share of the model's size; how long the target is around it where the source "
            "has length 1, both models at equal area",
            _landmark_table(result),
        )
        if len(result.landmarks)
        else "",
        _details("Curves", "distance between a curve and its counterpart, both ways", _curve_table(result))
        if len(result.curves)
        else "",
        _details(
            "How it was made",
            _time_summary(manifest),
            _timing_table(manifest.get("timings") or {}) + _provenance_table(result),
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


def encode_texture(id: str, caption: str, pixels: FloatArray) -> Texture:
    """Encode a texture as JPEG, halved until it has at most `MAX_TEXTURE_BYTES`."""
    while True:
        image = np.round(255 * pixels).astype(np.uint8)
        content = _jpeg(image, TEXTURE_JPEG_QUALITY)
        if len(content) <= MAX_TEXTURE_BYTES or max(pixels.shape[:2]) <= 256:
            return Texture(id, caption, content, (image.shape[1], image.shape[0]))
        height, width = (length // 2 * 2 for length in pixels.shape[:2])
        pixels = pixels[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))


def _resource(name: str) -> str:
    return resources.files("cagemap.report").joinpath(name).read_text(encoding="utf-8")


def _unsure(result: MatchResult) -> bool:
    return result.confidence is not None and result.confidence.verdict != SURE


def _scripts(models: Models, result: MatchResult) -> str:
    description, arrays = pack_models(models, result)
    return (
        f'<script type="application/json" id="models">{description}</script>\n'
        f'<script type="text/plain" id="models-data">{arrays}</script>\n'
        + "".join(f"<script>\n{_resource(name)}</script>\n" for name in _SCRIPTS)
    )


def _viewer_section(result: MatchResult, models: Models) -> str:
    """The three-dimensional viewer and its controls."""
    source, target = (escape(_stem(side.control.name)) for side in (result.source, result.target))
    looks = "".join(
        f'<label><input type="radio" name="look" value="{k}"{" checked" if k == 0 else ""}>'
        f"<span>{escape(look.name)}</span></label>"
        for k, look in enumerate(models.looks)
    )
    names = "".join(
        f'<option value="{k}">{escape(shape.name)}</option>' for k, shape in enumerate(models.shapes, start=1)
    )
    shapes = f'<label>Shape <select><option value="0">at rest</option>{names}</select></label>' if names else ""
    landmark_box = '<label><input type="checkbox" name="landmarks"> Landmarks</label>' if len(result.landmarks) else ""
    views = "".join(
        f'<button type="button" data-view="{view}">{text}</button>'
        for view, text in (("front", "Front"), ("side", "Side"), ("back", "Back"), ("start", "Reset"))
    )
    return (
        '<section id="viewer" aria-label="Models">\n<div class="tools">'
        f'<fieldset class="looks"><legend class="unseen">Colour by</legend>{looks}</fieldset>{shapes}{landmark_box}'
        f'<div class="views">{views}</div></div>\n<div class="glass">'
        f'<canvas tabindex="0" role="img" aria-describedby="viewer-help" '
        f'aria-label="{source}, the source, and {target}, the target, which turn together"></canvas>'
        f'<div class="layer"></div><p class="name source">{source}<small>source</small></p>'
        f'<p class="name target">{target}<small>target</small></p></div>\n'
        '<div class="below"><p class="legend" aria-live="polite"></p>'
        '<p class="help" id="viewer-help">Drag: turn · right button: move · click, then wheel: zoom</p>'
        "</div>\n</section>"
    )


def _still_pictures(result: MatchResult, gallery: Gallery) -> str:
    """Still pictures, for browsers without WebGL and for print."""
    landmark_note = " Dots are landmarks: equal dots should sit on equal places." if len(result.landmarks) else ""
    curve_note = " Lines are curves: equal lines should lie on equal places." if len(result.curves) else ""
    sections = [
        _section(
            f"The {escape(gallery.appearance)}, transferred",
            "Left the source as it came, right the target with what it received, from the same directions. "
            f"Of the target, {escape(gallery.orientation)}.",
            "".join(_picture_pair(figure, result) for figure in gallery.looks),
        ),
        _section(
            "The map as colours",
            f"Points of equal colour correspond; the faint checker shows stretch.{landmark_note}{curve_note}",
            "".join(_picture_pair(figure, result) for figure in gallery.maps),
        ),
        _section(
            "Where to trust it",
            "The target. Grey: unfolded and stretched little. Red: folded or stretched strongly; look there first.",
            _pictures((figure.target, figure.view) for figure in gallery.trust),
        ),
    ]
    if gallery.masks:
        sections.append(
            _section(
                "What was matched",
                "Dark: masked, neither matched nor transferred. The target shows both masks, the source its own.",
                "".join(_picture_pair(figure, result) for figure in gallery.masks),
            )
        )
    return f'<div class="stills">\n{"".join(sections)}\n</div>'


def _mark_list(marks: tuple[Mark, ...]) -> str:
    """The list of marks, each number once."""
    first = {mark.number: (index, mark) for index, mark in reversed(list(enumerate(marks)))}
    items = "".join(
        f'<li><span class="number" aria-hidden="true">{number}</span><span>{escape(_capital(mark.text))}</span>'
        f'<button type="button" data-mark="{index}" aria-label="Show mark {number}">Show</button></li>'
        for number, (index, mark) in sorted(first.items())
    )
    return _section("Look here", "", f'<ul class="marks">{items}</ul>') if items else ""


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _texture_section(textures: tuple[Texture, ...]) -> str:
    figures = "".join(
        f'<figure><img id="{texture.id}" src="{_uri(texture.content)}" width="{texture.size[0]}" '
        f'height="{texture.size[1]}" alt="{escape(texture.caption)}">'
        f"<figcaption>{escape(texture.caption)}</figcaption></figure>"
        for texture in textures
    )
    return _details("Textures", "as they lie in the layouts", f'<div class="pair">{figures}</div>') if figures else ""


def _details(title: str, lead: str, body: str) -> str:
    return f"<details>\n<summary>{title}<small>{lead}</small></summary>\n{body}\n</details>"


def _figure_section(result: MatchResult, ratings: list[Rating]) -> str:
    chips = [
        f"{len(result.target.vertices):,} target vertices",
        f"{len(result.source.vertices):,} source vertices",
        count_noun(len(result.landmarks), "landmark"),
    ]
    items = "".join(f"<li>{chip.replace(',', ' ')}</li>" for chip in chips)
    return f'<ul class="chips">{items}</ul>{_rating_cards(ratings)}'


def data_uri(image: Image) -> str:
    """The picture as a JPEG data URI."""
    return _uri(_jpeg(image, JPEG_QUALITY))


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


def _page_header(title: str, text: str, verdict: str) -> str:
    return (
        f'<header>\n<p class="brand">cagemap</p>\n<h1>{escape(title)}</h1>\n'
        f'<p class="verdict {verdict}">{escape(text)}</p>\n</header>'
    )


def _message_list(result: MatchResult, warnings: list[str], notes: list[str]) -> str:
    files = result.target.control.name, result.source.control.name

    def item(tag: str, text: str) -> str:
        words = use_option_names(text)
        return f"{tag}{escape(words if words.startswith(files) else _capital(words))}</li>"

    items = [item('<li class="warning">', text) for text in warnings] + [item("<li>", text) for text in notes]
    return f'<ul class="notes">{"".join(items)}</ul>' if items else ""


def _picture(image: Image, caption: str) -> str:
    return (
        f'<figure><img src="{data_uri(image)}" width="{image.shape[1]}" height="{image.shape[0]}" '
        f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def _pictures(pictures: Iterable[tuple[Image, str]]) -> str:
    return '<div class="pair">' + "".join(_picture(image, caption) for image, caption in pictures) + "</div>"


def _picture_pair(figure: Figure, result: MatchResult) -> str:
    source, target = (_stem(side.control.name) for side in (result.source, result.target))
    left = [] if figure.source is None else [(figure.source, f"{source} (source), {figure.view}")]
    return _pictures([*left, (figure.target, f"{target} (target), {figure.view}")])


def _answers_section(result: MatchResult, gallery: Gallery) -> str:
    """The map and its runner-up side by side, if the map is not sure."""
    if result.confidence is None or not gallery.answers:
        return ""
    best, other = result.confidence.answers[:2]
    body = ""
    for best_figure, (runner_up, difference) in zip(gallery.maps, gallery.answers, strict=True):
        view = best_figure.view
        colors = [] if runner_up.source is None else [(runner_up.source, f"the source's own colours, {view}")]
        body += _pictures(
            [
                (best_figure.target, f"this map: {best.name}, {view}"),
                (runner_up.target, f"the other: {other.name}, {view}"),
                *colors,
                (difference.target, f"red: where the two differ, {view}"),
            ]
        )
    lead = (
        "Colours say where on the source a point goes, as above: the right map has the source's colours in the right "
        "places. A landmark where they differ decides; `answer=1` takes the other."
    )
    title = "Two answers" if result.confidence.verdict == TWO else "The next best answer"
    return _section(f"{title}: which is right?", use_option_names(lead), body)


def _rating_cards(ratings: list[Rating]) -> str:
    cards = [
        f'<div class="card {rating.verdict}"><p class="label">{escape(rating.label)}</p>'
        f'<p class="value">{escape(rating.value)}</p><p>{escape(rating.meaning)}</p></div>'
        for rating in ratings
    ]
    return f'<div class="cards">{"".join(cards)}</div>' if cards else "<p>No figures were stored with this result.</p>"


def _landmark_table(result: MatchResult) -> str:
    names = result.landmark_names
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


def _curve_table(result: MatchResult) -> str:
    rows = []
    for entry, color in zip(result.manifest.get("curves") or [], distinct_colors(len(result.curves)), strict=True):
        rows.append(
            f"<tr><td>{_dot(color)}{escape(entry['name'])}</td>"
            f"<td>{100 * entry['mean']:.2f} %</td><td>{100 * entry['worst']:.2f} %</td></tr>"
        )
    return f'<table class="columns"><tr><th>curve</th><th>mean miss</th><th>at most</th></tr>{"".join(rows)}</table>'


def _time_summary(manifest: dict[str, Any]) -> str:
    memory = manifest.get("peak_memory_bytes")
    peak = f", {memory / 2**30:.1f} GiB of memory at most" if isinstance(memory, int | float) else ""
    seconds = sum(value for value in (manifest.get("timings") or {}).values() if isinstance(value, int | float))
    return f"{seconds:.1f} seconds in all{peak}."


def _timing_table(timings: dict[str, Any]) -> str:
    stages = {name: float(value) for name, value in timings.items() if isinstance(value, int | float)}
    longest = max(stages.values(), default=0.0) or 1.0
    rows = [
        f'<tr><td>{escape(name)}</td><td class="bar"><span style="width:{100 * seconds / longest:.1f}%"></span></td>'
        f"<td>{seconds:.2f} s</td></tr>"
        for name, seconds in stages.items()
    ]
    return f'<table class="bars">{"".join(rows)}</table>'


def _provenance_table(result: MatchResult) -> str:
    manifest = result.manifest
    entries: dict[str, Any] = {}
    for side_name, side in (("source", result.source), ("target", result.target)):
        entries[side_name] = (
            f"{side.control.name}: {side.control.n_vertices} control vertices, {side.control.n_faces} faces, "
            f"{side.refinement.scheme} to level {side.refinement.n_levels}"
        )
    for group in ("parameters", "versions", "inputs"):
        entries |= flatten_entries(group, manifest.get(group) or {})
    rows = [
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in entries.items()
        if value is not None
    ]
    return f'<table class="facts">{"".join(rows)}</table>'


def flatten_entries(prefix: str, value: Any) -> dict[str, Any]:
    """Nested dicts as one dict; names are joined by dots."""
    if not isinstance(value, dict):
        return {prefix: value}
    entries: dict[str, Any] = {}
    for name, entry in value.items():
        entries |= flatten_entries(f"{prefix}.{name}" if prefix else name, entry)
    return entries
