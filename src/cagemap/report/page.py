"""The report as one self-contained HTML page."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from cagemap.errors import FormatError, use_option_names
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import doubt_message, landmark_messages, sure_message
from cagemap.files.result.verdicts import Rating, map_verdict, rate_figures
from cagemap.maps.hypotheses.confidence import TWO
from cagemap.maps.result import MatchResult
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import Image
from cagemap.report.figures import Figure, Gallery
from cagemap.report.marks import Mark, name_marks
from cagemap.report.models import Models, pack_models
from cagemap.report.rig_panels import Panel
from cagemap.report.tables import (
    curve_table,
    landmark_table,
    provenance_table,
    rating_cards,
    time_summary,
    timing_table,
)

# Of one texture as JPEG: two textures and the models fit into a page of 5 MB.
MAX_TEXTURE_BYTES = 700_000

_STYLE, _SCRIPTS = "style.css", ("three/three.min.js", "arrays.js", "viewer.js")
JPEG_QUALITY, TEXTURE_JPEG_QUALITY = 90, 85


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
    """HTML text of the report; still pictures (``gallery``) are for browsers without WebGL and for print."""
    manifest = result.manifest
    quality = manifest.get("quality") or {}
    marks = () if models is None else models.marks
    warnings = landmark_messages(manifest) + [str(text) for text in (quality.get("warnings") or [])]
    warnings = [text for text in warnings if text != doubt_message(manifest)]  # the page begins with it
    ratings = rate_figures(quality)
    verdict, sentence = map_verdict(manifest, marked=bool(marks))
    title = f"{_stem(result.source.control.name)} → {_stem(result.target.control.name)}"
    panel_sections = [_details(escape(panel.title), escape(panel.lead), _pictures(panel.pictures)) for panel in panels]
    sentence = use_option_names(name_marks(sentence, marks))
    sections = [
        page_header(title, f'<p class="verdict {verdict}">{escape(sentence)}</p>'),
        "" if models is None else _viewer_section(result, models),
        _still_pictures(result, gallery),
        _mark_list(marks),
        _message_list(
            result,
            [name_marks(text, marks) for text in warnings],
            [*filter(None, [sure_message(manifest)]), *map(str, manifest.get("notes") or [])],
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
            "has length 1, with what both models have at equal area",
            landmark_table(result),
        )
        if len(result.landmarks)
        else "",
        _details("Curves", "distance between a curve and its counterpart, both ways", curve_table(result))
        if len(result.landmarks.curves)
        else "",
        _details(
            "How it was made",
            time_summary(manifest),
            timing_table(manifest.get("timings") or {}) + provenance_table(result),
        ),
    ]
    scripts = "" if models is None else _scripts(models, result)
    return html_page(title, [section for section in sections if section], scripts=scripts)


def html_page(title: str, sections: Iterable[str], *, style: str = "", scripts: str = "") -> str:
    """Text of a page of sections; ``style``: CSS added to that of reports."""
    body = "\n".join(sections)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="generator" content="{mark()}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)} · cagemap</title>\n<style>\n{_resource(_STYLE)}{style}</style>\n</head>\n<body>\n"
        f"<main>\n{body}\n</main>\n{scripts}</body>\n</html>\n"
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
    curve_note = " Lines are curves: equal lines should lie on equal places." if len(result.landmarks.curves) else ""
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
    return f'<ul class="chips">{items}</ul>{rating_cards(ratings)}'


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


def page_header(title: str, subtitle_html: str) -> str:
    """Header of a page; ``subtitle_html``: HTML under its title."""
    return f'<header>\n<p class="brand">cagemap</p>\n<h1>{escape(title)}</h1>\n{subtitle_html}\n</header>'


def _message_list(result: MatchResult, warnings: list[str], notes: list[str]) -> str:
    files = result.target.control.name, result.source.control.name

    def item(tag: str, text: str) -> str:
        words = use_option_names(text)
        return f"{tag}{escape(words if words.startswith(files) else _capital(words))}</li>"

    items = [item('<li class="warning">', text) for text in warnings] + [item("<li>", text) for text in notes]
    return f'<ul class="notes">{"".join(items)}</ul>' if items else ""


def _pictures(pictures: Iterable[tuple[Image, str]]) -> str:
    figures = (
        f'<figure><img src="{_uri(_jpeg(image, JPEG_QUALITY))}" width="{image.shape[1]}" height="{image.shape[0]}" '
        f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
        for image, caption in pictures
    )
    return f'<div class="pair">{"".join(figures)}</div>'


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
