"""One page and one table of all pairs of a job, worst first."""

from __future__ import annotations

import base64
import csv
import hashlib
import importlib.util
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

from cagemap.files.atomic import require_replaceable, write_whole
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import file_hash
from cagemap.files.result.verdicts import overall_verdict, rate_figures
from cagemap.files.text import flatten_entries
from cagemap.jobs.plan import PICTURE_FILE, RESULT_FOLDER, STATE_FOLDER, Plan, Task, pair_folder
from cagemap.jobs.run import TaskOutcome
from cagemap.report.page import html_page, page_header

VERDICT_RANK = {"failed": 0, "poor": 1, "fair": 2, "good": 3}
VERDICT_WORDS = {"failed": "failed", "poor": "do not use", "fair": "look at it", "good": "sound"}
# Columns of the page: heading, quality figure, factor, format.
_COLUMNS = (
    ("folded %", "flipped_area", 100.0, "{:.2f}"),
    ("covered %", "coverage", 100.0, "{:.1f}"),
    ("landmarks missed %", "landmark_error_mean", 100.0, "{:.2f}"),
    ("stretch", "dirichlet", 1.0, "{:.2f}"),
    ("trusted %", "trusted_area", 100.0, "{:.1f}"),
)


@dataclass(frozen=True)
class PairRow:
    """One pair on the page."""

    source: str
    target: str
    verdict: str  # "good", "fair", "poor" or "failed"
    messages: tuple[str, ...]  # failures, warnings and notes
    seconds: float  # of the pair's own tasks
    quality: dict[str, Any] = field(default_factory=dict, repr=False)  # figures of the manifest
    cycle_error: float | None = None  # error of the map by cycle consistency, of sqrt(area)
    files: tuple[str, ...] = ()  # written files, relative to the page
    picture: bytes = field(default=b"", repr=False)  # JPEG, empty if there is none
    failure: dict[str, str] = field(default_factory=dict)  # code, place and remedy of the first failure, if any


def pair_rows(
    plan: Plan, outcomes: dict[str, TaskOutcome], cycle_errors: dict[tuple[str, str], float] | None = None
) -> list[PairRow]:
    """Rows of all pairs of a plan, worst first."""
    rows = []
    of_pair: dict[Any, list[tuple[Task, TaskOutcome | None]]] = {}
    for task in plan.tasks:
        of_pair.setdefault(task.pair, []).append((task, outcomes.get(task.name)))
    for pair in plan.pairs:
        tasks_of_pair = of_pair.get(pair, [])
        # "compose" first: a detour replaces the direct map.
        maps = [outcome for kind in ("compose", "match") for task, outcome in tasks_of_pair if task.kind == kind]
        match = next((outcome for outcome in maps if outcome is not None), None)
        figures = match.figures if match is not None else {}
        failed = [outcome for _, outcome in tasks_of_pair if outcome is not None and not outcome.usable]
        failures = [str(outcome) for outcome in failed]
        causes = [outcomes[name] for task, _ in tasks_of_pair for name in task.needs if name in outcomes]
        warnings = [str(text) for text in figures.get("warnings", [])]
        quality = dict(figures.get("quality") or {})
        verdict = "failed" if failures or match is None else overall_verdict(rate_figures(quality), warnings)
        outputs = [(task, outcome) for task, outcome in tasks_of_pair if task.kind not in ("compose", "match")]
        remarks = [text for task, outcome in outputs if outcome is not None for text in remarks_of(outcome, task.name)]
        usable = [outcome for _, outcome in tasks_of_pair if outcome is not None and outcome.usable]
        files = [name for outcome in usable for name in _linked_files(outcome.files)]
        picture = plan.root / pair_folder(pair) / PICTURE_FILE
        is_drawn = any(task.kind == "picture" and outcome is not None and outcome.usable for task, outcome in outputs)
        rows.append(
            PairRow(
                pair[0],
                pair[1],
                verdict,
                (*failures, *dict.fromkeys([*([] if match is None else remarks_of(match)), *remarks])),
                sum(o.seconds for _, o in tasks_of_pair if o is not None),
                quality,
                None if cycle_errors is None else cycle_errors.get((pair[1], pair[0])),
                tuple(name for name in dict.fromkeys(files) if not name.endswith(PICTURE_FILE)),
                picture.read_bytes() if is_drawn and picture.is_file() else b"",
                next((outcome.failure for outcome in (*failed, *causes) if outcome.code), {}),
            )
        )
    return sorted(rows, key=_sort_key)


def remarks_of(outcome: TaskOutcome, name: str = "") -> list[str]:
    """Warnings and notes of a task, after its ``name``, and logged warnings, which name a file."""
    texts = [str(text) for entry in ("warnings", "notes") for text in outcome.figures.get(entry, [])]
    logged = map(str, outcome.figures.get("logged", []))
    return list(dict.fromkeys([*(f"{name}: {text}" if name else text for text in texts), *logged]))


def build_library_page(title: str, rows: Sequence[PairRow], notes: Sequence[str] = ()) -> str:
    """HTML text of the page; its only script sorts the table."""
    style, script = (
        resources.files("cagemap.jobs").joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "sort.js")
    )
    counts = {verdict: sum(row.verdict == verdict for row in rows) for verdict in VERDICT_RANK}
    chips = [f'<li class="{v}">{count} {VERDICT_WORDS[v]}</li>' for v, count in counts.items() if count]
    with_cycles = any(row.cycle_error is not None for row in rows)
    heads = ["map", "source → target", "verdict", *(name for name, *_ in _COLUMNS)]
    heads += ["disagrees by %"] if with_cycles else []
    heads += ["seconds"]
    note_items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    heading = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "\n".join(_row(row, with_cycles) for row in rows)
    sections = (
        page_header(title, f'<ul class="chips">{"".join(chips)}</ul>'),
        f"<ul class=notes>{note_items}</ul>" if note_items else "",
        '<section>\n<p class="lead">Equal colours correspond: the source on the left, the target on the right. Worst '
        "pairs first; click a heading to sort.</p>\n"
        f'<table class="library" style="--figures: {len(heads) - 3}"><thead><tr>{heading}</tr></thead>\n<tbody>\n'
        f"{body}\n</tbody></table>\n</section>",
    )
    return html_page(title, sections, style=style, scripts=f"<script>\n{script}</script>\n")


def build_table(rows: Sequence[PairRow]) -> list[dict[str, Any]]:
    """All figures of all pairs: one row a pair, one column a figure."""
    return [
        {
            "source": row.source,
            "target": row.target,
            "verdict": row.verdict,
            "seconds": row.seconds,
            "cycle_error": row.cycle_error,
            **flatten_entries("", {name: value for name, value in row.quality.items() if name != "warnings"}),
            "messages": " | ".join(row.messages),
            **{name: row.failure.get(name, "") for name in ("code", "place", "remedy")},
        }
        for row in rows
    ]


def write_library(folder: Path, title: str, rows: Sequence[PairRow], notes: Sequence[str] = ()) -> tuple[Path, ...]:
    """Write index.html and figures.csv, and figures.parquet where pyarrow is installed."""
    page, table, data = folder / "index.html", folder / "figures.csv", folder / "figures.parquet"
    flat = build_table(rows)
    columns = list(dict.fromkeys(name for row in flat for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    html = build_library_page(title, rows, notes)
    _write_if_changed(page, html.encode())
    _write_table(table, text.getvalue(), folder / STATE_FOLDER / f"{table.name}.sha256")
    if importlib.util.find_spec("pyarrow") is None:
        return page, table
    import pyarrow
    import pyarrow.parquet

    arrays = {name: [row.get(name) for row in flat] for name in columns}
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(arrays, metadata={"generator": mark()}), stream)
    _write_if_changed(data, stream.getvalue())
    return page, table, data


def _linked_files(files: Sequence[str]) -> list[str]:
    """Files of a task to link; a folder inside the pair's folder is one link."""
    return list(dict.fromkeys("/".join(name.split("/")[:2]) if RESULT_FOLDER not in name else name for name in files))


def _write_if_changed(path: Path, content: bytes) -> None:
    """Write a file with a `mark`, unless it exists with the same content."""
    blank = rb"checksum " + 64 * b"0"
    if path.is_file() and re.sub(rb"checksum [0-9a-f]{64}", blank, path.read_bytes(), count=1) == content:
        return
    write_whole(path, content)


def _write_table(path: Path, text: str, note: Path) -> None:
    """Write a table and a note with its hash, which marks it as cagemap's.

    The note is written first with the hashes of the old and the new table, since a run may end between both writes.
    """
    content = text.encode()
    known_hashes = note.read_bytes().split() if note.is_file() else []

    def owned(existing: Path) -> bool:
        return file_hash(existing).encode() in known_hashes

    if path.is_file() and path.read_bytes() == content:
        return
    require_replaceable(path, owned=owned)
    old_hash = [file_hash(path).encode()] if path.is_file() else []
    note.parent.mkdir(parents=True, exist_ok=True)
    write_whole(note, b"\n".join([*old_hash, hashlib.sha256(content).hexdigest().encode(), b""]), force=True)
    write_whole(path, content, owned=owned)


def _sort_key(row: PairRow) -> tuple[float, ...]:
    quality = row.quality
    return (
        VERDICT_RANK[row.verdict],
        -(row.cycle_error or 0.0),
        -float(quality.get("flipped_area") or 0.0),
        float(quality.get("trusted_area") or 0.0),
    )


def _row(row: PairRow, with_cycles: bool) -> str:
    encoded = base64.b64encode(row.picture).decode("ascii")
    name = f"{row.source} → {row.target}"
    image = (
        f'<img loading="lazy" decoding="async" src="data:image/jpeg;base64,{encoded}" alt="{escape(name)}">'
        if encoded
        else ""
    )
    links = " ".join(f'<a href="{quote(file)}">{escape(Path(file).name)}</a>' for file in row.files)
    messages = "".join(f"<li>{escape(text)}</li>" for text in row.messages)
    cells = [
        f"<td>{image}</td>",
        f'<td data-value="{escape(name)}"><b>{escape(name)}</b><br>{links}<ul>{messages}</ul></td>',
        f'<td data-value="{VERDICT_RANK[row.verdict]}"><span class="verdict {row.verdict}">'
        f"{VERDICT_WORDS[row.verdict]}</span></td>",
    ]
    figures = [(row.quality.get(entry), factor, template) for _, entry, factor, template in _COLUMNS]
    figures += [(row.cycle_error, 100.0, "{:.2f}")] if with_cycles else []
    figures += [(row.seconds, 1.0, "{:.1f}")]
    for value, factor, template in figures:
        if isinstance(value, int | float):
            cells.append(f'<td data-value="{factor * value:.6g}">{template.format(factor * value)}</td>')
        else:
            cells.append('<td data-value=""></td>')
    return f"<tr>{''.join(cells)}</tr>"
