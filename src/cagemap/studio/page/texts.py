"""Blocks of the panels, as HTML: the list of landmarks, what runs, what is known of the map, what was written."""

from __future__ import annotations

import html
import re
from urllib.parse import quote

from cagemap.studio.downloads import ALL, archive_name
from cagemap.studio.page.colors import css, landmark_color
from cagemap.studio.scene import Scene
from cagemap.studio.state import Output, Studio

# Rows of the list before it scrolls, in pixels.
LIST_HEIGHT = 180
# How the package says to ask for another answer, which is a button here.
_KEYWORD = re.compile(r" \(`answer=\d+`\)")


def landmark_table(state: Studio) -> str:
    """The list: colour, number, name and strain of every landmark; first what contradicts, then the newest."""
    rows = []
    listed = sorted(state.history.present.items[::-1], key=lambda item: item.name not in state.map.contradictions)
    for item in listed:
        strain = state.map.strain.get(item.name)
        wrong = state.map.contradictions.get(item.name)
        shown = "…" if not item.complete else "" if strain is None else f"{100 * strain:.1f} %"
        style = "background:#5a1d1d;" if wrong else ""
        style += "outline:1px solid #fff;" if item.number == state.selected else ""
        swatch = f'<span style="color:{css(landmark_color(item.number))}">&#9679;</span>'
        rows.append(
            f'<tr style="{style}" title="{html.escape(wrong or "")}"><td>{swatch} {item.number}</td>'
            f"<td>{html.escape(item.name)}{' &#9888;' if wrong else ''}</td>"
            f'<td style="text-align:right">{shown}</td></tr>'
        )
    curves = state.history.present.curves
    count = len(state.history.present.complete)
    head = f"{count} landmark{'' if count == 1 else 's'}" + ("" if curves is None else f", {len(curves)} curves")
    head += "" if state.saved else " · not saved yet"
    return (
        f'<div id="list" style="font-size:12px;padding:0 8px"><div>{head}</div>'
        f'<div style="max-height:{LIST_HEIGHT}px;overflow-y:auto"><table style="width:100%;border-spacing:2px">'
        f"{''.join(rows)}</table></div></div>"
    )


def status_text(state: Studio) -> str:
    """What runs, and the last messages."""
    job = state.finish_job or state.preview_job
    lines = []
    if job is not None:
        lines.append(f"<b>{html.escape(job.title)}</b> {html.escape(job.stage)}")
    elif state.files is None:
        lines.append("Choose a target and a source on the left, then Open.")
    elif state.probe is not None and state.probe.text:
        lines.append(html.escape(state.probe.text))
    elif state.history.present.open is not None:
        lines.append("Click the same place on the other model, or accept the proposal.")
    else:
        lines.append("Click a model where the map is wrong, then the same place on the other one.")
    for message in reversed(state.messages):
        color = "#ff8a80" if message.kind == "error" else "#b0bec5"
        lines.append(f'<span style="color:{color}">{html.escape(message.text)}</span>')
    return f'<div id="status" style="font-size:12px;padding:4px 8px">{"<br>".join(lines)}</div>'


def map_text(state: Studio) -> str:
    """What is known about the map."""
    known = state.map
    if known.revision == 0:
        return '<div id="map" style="font-size:12px;padding:0 8px">no map yet</div>'
    lines = [f"map {known.revision}, {known.seconds:.1f} s"]
    lines += [_KEYWORD.sub("", known.confidence)] if known.confidence else []
    lines += list(known.contradictions.values()) + list(known.notes)
    shown = "<br>".join(html.escape(line) for line in lines)
    return f'<div id="map" style="font-size:12px;padding:0 8px">{shown}</div>'


def outputs_text(state: Studio) -> str:
    """What was written, to look at or to keep."""
    lines = [_link(output) for output in state.outputs]
    if state.outputs and state.finish_job is None:
        lines.append(f'<a href="/files/{ALL}" style="color:#9ecbff">all as one zip</a>')
    return f'<div id="outputs" style="font-size:12px;padding:0 8px">{"<br>".join(lines)}</div>'


def _link(output: Output) -> str:
    file = archive_name(output.path) if output.path.is_dir() else output.path.name
    what, name = html.escape(output.what), html.escape(file)
    tab = ' target="_blank" rel="noopener"' if output.path.suffix.lower() == ".html" else ""
    return f'{what}: <a href="/files/{quote(file, safe="")}"{tab} style="color:#9ecbff">{name}</a>'


def parts_text(scene: Scene | None) -> str:
    """Names of both models' parts."""
    if scene is None:
        return ""
    lines = []
    for shape, offer in zip((scene.target, scene.source), scene.offers, strict=True):
        part = "" if offer.opened is None else f", {offer.opened.partition(':')[2]}"
        names = f": {', '.join(shape.parts)}" if shape.parts else ""
        said = html.escape(f"{part}, {len(shape.positions):,} vertices{names}")
        lines.append(f"<p><b>{html.escape(shape.name)}</b>{said}</p>")
    return f'<div id="names" style="font-size:12px;padding:0 8px">{"".join(lines)}</div>'
