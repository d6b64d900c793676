"""Markdown of measured figures; no number in the docs is typed by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from benchmarks.speed.measure import Figures


def markdown(figures: Figures) -> str:
    """All parts that were measured, each with its machine."""
    lines: list[str] = []
    for name, (title, body) in SECTIONS.items():
        if name not in figures:
            continue
        part = figures[name]
        lines += [f"### {title}", ""]
        lines += [f"Not measured: {part['skipped']}."] if "skipped" in part else body(part)
        lines += ["", _footnote(part["machine"]), ""]
    return "\n".join(lines)


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """Lines of a Markdown table; the first column is text."""
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    return lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]


def _footnote(on: Figures) -> str:
    load = on.get("load_before")
    shared = f"; load average before: {load:.1f}" if load is not None else ""
    libraries = ", ".join(f"{name} {on[name]}" for name in ("numpy", "scipy", "numba", "rslab"))
    return (
        f"*{on['cores']} cores of {on['processor']}, Python {on['python']}, {libraries}; commit {on['commit']}, "
        f"{on['date']}{shared}.*"
    )


def seconds(value: float) -> str:
    """Three digits, as many as are worth something."""
    return f"{value:.0f} s" if value >= 100 else f"{value:.1f} s" if value >= 10 else f"{value:.2f} s"


def gigabytes(value: float) -> str:
    """Bytes in GB."""
    return f"{value / 1e9:.2f} GB"


def thousands(value: float) -> str:
    """A count of vertices."""
    return f"{value / 1000:.0f}k"


def _sides(vertices: Sequence[float]) -> str:
    return " + ".join(thousands(n) for n in vertices)


def _pair(measured: Figures) -> tuple[str, str]:
    return seconds(measured["wall"]), seconds(measured["cpu"])


def _stages(part: Figures) -> list[str]:
    rates = part["rates"]
    rows = []
    for name, row in part["rows"].items():
        amount = f"{row['amount'] / 1e6:.0f} MB" if row["unit"] == "bytes" else f"{row['amount'] / 1e9:.1f} Gflop"
        distance = f"{row['cpu'] / row['limit']:.0f}x"
        rows.append((name, seconds(row["cpu"]), amount, f"{row['limit'] * 1000:.0f} ms", distance, row["work"]))
    lines = [
        f"One surface of {thousands(part['vertices'])} vertices, one core: it copies {rates['bytes'] / 1e9:.1f} GB/s "
        f"and multiplies matrices at {rates['flops'] / 1e9:.0f} Gflop/s.",
        "",
    ]
    lines += table(["stage", "processor", "least work", "limit", "distance", "what the least work is"], rows)
    lines += ["", "Within `match`, wall:", ""]
    return lines + table(["stage", "wall"], [(name, seconds(value)) for name, value in part["map"].items()])


def _start(part: Figures) -> list[str]:
    rows = [
        ("`cagemap --help`", *_pair(part["help"])),
        ("a small match and bake, first run", *_pair(part["first"])),
        ("the same again", *_pair(part["second"])),
        ("difference: compilation", *_pair(part["compilation"])),
    ]
    lines = table(["", "wall", "processor"], rows)
    if "kernels" not in part:
        return lines
    kernels = list(part["kernels"].items())
    return [*lines, "", *table(["kernel compiled", "wall"], [(name, seconds(value)) for name, value in kernels])]


def _basis(part: Figures) -> list[str]:
    exact = {
        f"SciPy `eigsh`, exact, at {thousands(part['vertices'])} vertices": "eigsh",
        "the same with cagemap's factorisation": "eigsh, our factorisation",
        "cagemap, exact (block Lanczos there)": "ours exact",
    }
    exact = {label: name for label, name in exact.items() if name in part}
    against = [part[name] for name in exact.values()]
    rows = [(label, *_pair(part[name]), *[""] * (1 + len(exact))) for label, name in exact.items()]

    def row(label: str, name: str, error: str) -> tuple[str, ...]:
        return label, *_pair(part[name]), error, *(f"{other['cpu'] / part[name]['cpu']:.1f}x" for other in against)

    if "error" in part:
        rows.append(row(f"cagemap, all at level {part['level']}", "ours", f"{part['error']:.1e}"))
    if "fixed" in part:
        rows.append(row(f"cagemap, fixed schedule {part['fixed schedule']}", "fixed", ""))
    ratios = ["against eigsh", "against eigsh with our factorisation", "against our exact"][: len(exact)]
    head = ["wall", "processor", "largest eigenvalue error", *ratios]
    return table([f"{part['count']} eigenpairs", *head], rows)


def _match(part: Figures) -> list[str]:
    prepared = part["prepared"]
    sizes = _sides(part["vertices"])
    rows = [
        (f"two OBJ files to RESULT, {sizes}", *_pair(part), gigabytes(part["peak"])),
        ("both surfaces prepared", *_pair(prepared["total"]), gigabytes(prepared["process"]["peak"])),
        ("- of it reading them", *_pair(prepared["load"]), ""),
        ("- of it the match", *_pair(prepared["match"]), ""),
    ]
    lines = table(["", "wall", "processor", "peak memory"], rows)
    lines += ["", f"Mean error against the true map: {part['accuracy']:.2f} (x100 of sqrt(area)). Stages (wall):", ""]
    return lines + table(["stage", "wall"], [(name, seconds(value)) for name, value in part["stages"].items()])


def _growth(part: Figures) -> list[str]:
    rows = [(_sides(row["vertices"]), *_pair(row), gigabytes(row["peak"])) for row in part["rows"]]
    slopes = part["slopes"]
    rows.append(("log-log slope", f"{slopes['wall']:.2f}", f"{slopes['cpu']:.2f}", f"{slopes['peak']:.2f}"))
    return table(["vertices", "wall", "processor", "peak memory"], rows)


def _bake(part: Figures) -> list[str]:
    rows = [("put the map into bakeable form", *_pair(part["prepare"]))]
    rows += [
        (f"{name.removeprefix('bake ')} x {name.removeprefix('bake ')}", *_pair(part[name]))
        for name in part
        if name.startswith("bake ")
    ]
    return table(["", "wall", "processor"], rows)


def _landmark(part: Figures) -> list[str]:
    row = (f"one landmark added, {_sides(part['vertices'])}", *_pair(part["preview"]), f"{part['mean error']:.2f}")
    return table(["", "wall", "processor", "mean error x100"], [row])


def _peers(part: Figures) -> list[str]:
    rows = []
    for row in part["rows"]:
        theirs, ours = row["pyFM"], row["ours"]
        steps, wanted = theirs["steps"]
        note = "" if steps == wanted else f" ({steps} of {wanted} ZoomOut steps run, the rest extrapolated)"
        rows.append(
            (
                _sides(theirs["vertices"]) + note,
                seconds(theirs["total"]),
                seconds(ours["wall"]),
                f"{row['ratio']:.0f}x",
                f"{theirs['mean error']:.2f}",
                f"{row['ours error']:.2f}",
            )
        )
    return table(["vertices", "pyFM", "cagemap", "ratio (wall)", "pyFM error x100", "cagemap error x100"], rows)


SECTIONS: dict[str, tuple[str, Callable[[Figures], list[str]]]] = {
    "start": ("Start and first run", _start),
    "stages": ("Stages and their physical limits", _stages),
    "basis": ("Basis against SciPy", _basis),
    "match": ("A whole match", _match),
    "growth": ("Growth", _growth),
    "bake": ("Bake", _bake),
    "landmark": ("One landmark added", _landmark),
    "peers": ("Against pyFM", _peers),
}
