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

from cagemap.files.atomic import require_replaceable, write_whole
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import file_hash
from cagemap.jobs.plan import PICTURE, RESULT, STATE, Plan, Task
from cagemap.jobs.run import Outcome
from cagemap.report.page import flattened
from cagemap.report.verdicts import explain, overall

_RANK = {"failed": 0, "poor": 1, "fair": 2, "good": 3}
_SAYS = {"failed": "failed", "poor": "do not use", "fair": "look at it", "good": "sound"}
# Heading, entry of the quality figures, factor, format: columns of the page.
_COLUMNS = (
    ("folded %", "flipped_area", 100.0, "{:.2f}"),
    ("covered %", "coverage", 100.0, "{:.1f}"),
    ("landmarks missed %", "landmark_error_mean", 100.0, "{:.2f}"),
    ("stretch", "dirichlet", 1.0, "{:.2f}"),
    ("trusted %", "trusted_area", 100.0, "{:.1f}"),
)


@dataclass(frozen=True)
class PairRow:
    """What the page says of one pair.

    Attributes
    ----------
    source, target : str
    verdict : str
        "good", "fair", "poor" or "failed".
    messages : tuple of str
        Failures and warnings.
    seconds : float
        Of the pair's own tasks.
    quality : dict
        Figures of the manifest.
    cycle_error : float or None
        Error that the other maps of the collection give this one, of sqrt(area).
    files : tuple of str
        What was written, relative to the page.
    picture : bytes
        JPEG, empty if there is none.
    """

    source: str
    target: str
    verdict: str
    messages: tuple[str, ...]
    seconds: float
    quality: dict[str, Any] = field(default_factory=dict, repr=False)
    cycle_error: float | None = None
    files: tuple[str, ...] = ()
    picture: bytes = field(default=b"", repr=False)


def pair_rows(
    plan: Plan, outcomes: dict[str, Outcome], cycle_errors: dict[tuple[str, str], float] | None = None
) -> list[PairRow]:
    """Rows of all pairs of a plan, worst first."""
    rows = []
    of_pair: dict[Any, list[tuple[Task, Outcome | None]]] = {}
    for task in plan.tasks:
        of_pair.setdefault(task.pair, []).append((task, outcomes.get(task.name)))
    for pair in plan.pairs:
        own = of_pair.get(pair, [])
        # A detour replaces the direct map.
        maps = [outcome for kind in ("compose", "match") for task, outcome in own if task.kind == kind]
        match = next((outcome for outcome in maps if outcome is not None), None)
        figures = match.figures if match is not None else {}
        failures = [f"{o.name}: {o.message}" for _, o in own if o is not None and not o.usable]
        warnings = [str(text) for text in figures.get("warnings", [])]
        quality = dict(figures.get("quality") or {})
        verdict = "failed" if failures or match is None else overall(explain(quality), warnings)
        files = [name for _, outcome in own if outcome is not None and outcome.usable for name in _shown(outcome.files)]
        picture = plan.root / f"{pair[0]}__{pair[1]}" / PICTURE
        rows.append(
            PairRow(
                pair[0],
                pair[1],
                verdict,
                (*failures, *warnings),
                sum(o.seconds for _, o in own if o is not None),
                quality,
                None if cycle_errors is None else cycle_errors.get((pair[1], pair[0])),
                tuple(name for name in files if not name.endswith(PICTURE)),
                picture.read_bytes() if picture.is_file() else b"",
            )
        )
    return sorted(rows, key=_badness)


def build_library_page(title: str, rows: Sequence[PairRow], notes: Sequence[str] = ()) -> str:
    """HTML text of the page; its only script sorts the table."""
    style = resources.files("cagemap.report").joinpath("style.css").read_text(encoding="utf-8")
    own = resources.files("cagemap.jobs").joinpath("page.css").read_text(encoding="utf-8")
    script = resources.files("cagemap.jobs").joinpath("sort.js").read_text(encoding="utf-8")
    counts = {verdict: sum(row.verdict == verdict for row in rows) for verdict in _RANK}
    chips = [f'<li class="{v}">{count} {_SAYS[v]}</li>' for v, count in counts.items() if count]
    with_cycles = any(row.cycle_error is not None for row in rows)
    heads = ["map", "source → target", "verdict", *(name for name, *_ in _COLUMNS)]
    heads += ["disagrees by %"] if with_cycles else []
    heads += ["seconds"]
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="{mark()}">\n'
        f"<title>{escape(title)} · cagemap</title>\n<style>\n{style}{own}</style>\n</head>\n<body>\n<main>\n"
        f'<header>\n<p class="brand">cagemap</p>\n<h1>{escape(title)}</h1>\n<ul class="chips">{"".join(chips)}</ul>\n'
        f'</header>\n{f"<ul class=notes>{listed}</ul>" if listed else ""}\n<section>\n<p class="lead">Equal colours '
        "correspond: the source on the left, the target on the right. Worst pairs first; click a heading to sort."
        f'</p>\n<table class="library" style="--figures: {len(heads) - 3}"><thead><tr>'
        + "".join(f"<th>{escape(head)}</th>" for head in heads)
        + "</tr></thead>\n<tbody>\n"
        + "\n".join(_row(row, with_cycles) for row in rows)
        + f"\n</tbody></table>\n</section>\n</main>\n<script>\n{script}</script>\n</body>\n</html>\n"
    )


def build_table(rows: Sequence[PairRow]) -> list[dict[str, Any]]:
    """All figures of all pairs as flat rows, one column each."""
    return [
        {
            "source": row.source,
            "target": row.target,
            "verdict": row.verdict,
            "seconds": row.seconds,
            "cycle_error": row.cycle_error,
            **flattened("", {name: value for name, value in row.quality.items() if name != "warnings"}),
            "messages": " | ".join(row.messages),
        }
        for row in rows
    ]


def write_library(folder: Path, title: str, rows: Sequence[PairRow], notes: Sequence[str] = ()) -> tuple[Path, ...]:
    """Write index.html and figures.csv, and figures.parquet where pyarrow is installed.

    Raises
    ------
    FormatError
        If a file cannot be written.
    """
    page, table, data = folder / "index.html", folder / "figures.csv", folder / "figures.parquet"
    flat = build_table(rows)
    columns = list(dict.fromkeys(name for row in flat for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    html = build_library_page(title, rows, notes)
    _write_marked(page, html.encode())
    _write_table(table, text.getvalue(), folder / STATE / f"{table.name}.sha256")
    if importlib.util.find_spec("pyarrow") is None:
        return page, table
    import pyarrow
    import pyarrow.parquet

    arrays = {name: [row.get(name) for row in flat] for name in columns}
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(arrays, metadata={"generator": mark()}), stream)
    _write_marked(data, stream.getvalue())
    return page, table, data


def _shown(files: Sequence[str]) -> list[str]:
    """Files of a task as links: those of a folder inside the pair's own, such as shapes, are one."""
    return list(dict.fromkeys("/".join(name.split("/")[:2]) if RESULT not in name else name for name in files))


def _write_marked(path: Path, content: bytes) -> None:
    """Write a file that holds a `mark`, unless just this is there already."""
    blank = rb"checksum " + 64 * b"0"
    if path.is_file() and re.sub(rb"checksum [0-9a-f]{64}", blank, path.read_bytes(), count=1) == content:
        return
    write_whole(path, content)


def _write_table(path: Path, text: str, note: Path) -> None:
    """Write a table, whose format has no place for a mark: a note beside it says that it is ours.

    The note comes first, and names the table of before as well: between the two a disk may fill up, or a run end.
    """
    content = text.encode()
    known = note.read_bytes().split() if note.is_file() else []

    def owned(existing: Path) -> bool:
        return file_hash(existing).encode() in known

    if path.is_file() and path.read_bytes() == content:
        return
    require_replaceable(path, owned=owned)
    before = [file_hash(path).encode()] if path.is_file() else []
    note.parent.mkdir(parents=True, exist_ok=True)
    write_whole(note, b"\n".join([*before, hashlib.sha256(content).hexdigest().encode(), b""]), force=True)
    write_whole(path, content, owned=owned)


def _badness(row: PairRow) -> tuple[float, ...]:
    quality = row.quality
    return (
        _RANK[row.verdict],
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
    links = " ".join(f'<a href="{escape(file)}">{escape(Path(file).name)}</a>' for file in row.files)
    said = "".join(f"<li>{escape(text)}</li>" for text in row.messages)
    cells = [
        f"<td>{image}</td>",
        f'<td data-value="{escape(name)}"><b>{escape(name)}</b><br>{links}<ul>{said}</ul></td>',
        f'<td data-value="{_RANK[row.verdict]}"><span class="verdict {row.verdict}">{_SAYS[row.verdict]}</span></td>',
    ]
    shown = [(row.quality.get(entry), factor, form) for _, entry, factor, form in _COLUMNS]
    shown += [(row.cycle_error, 100.0, "{:.2f}")] if with_cycles else []
    shown += [(row.seconds, 1.0, "{:.1f}")]
    for value, factor, form in shown:
        if isinstance(value, int | float):
            cells.append(f'<td data-value="{factor * value:.6g}">{form.format(factor * value)}</td>')
        else:
            cells.append('<td data-value=""></td>')
    return f"<tr>{''.join(cells)}</tr>"
