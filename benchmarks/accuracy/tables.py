"""Markdown of the accuracy figures."""

from __future__ import annotations

from benchmarks.accuracy.data import BARS


def markdown(figures: dict[str, list[dict]]) -> str:
    """The tables that the documentation includes."""
    parts = []
    if figures.get("humans"):
        parts += [
            "Errors x100 of sqrt(area), Euclidean, over vertices; an arrow reads source -> target. Truth: closest",
            "points of the neutral surfaces, which coincide. `elastic` is the default, `hfm` the functional map grown",
            "with the point map, `pyfm` pyFM 1.3.1 with its defaults and ZoomOut to 150 on the same landmarks, on",
            "triangles of the size given, at least those of the control mesh. Seconds are left out where other work",
            "ran beside.",
            "",
            "| pair | vertices | landmarks | method | mean | median | p95 | max | worst landmark | flipped % (truth) "
            "| Dirichlet ratio | coverage % | round trip | s | bar |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        parts += [_human(row) for row in sorted(figures["humans"], key=_order)]
    if figures.get("animals"):
        parts += [
            "",
            "No truth here: a landmark left out, and how far off it maps (mean, worst); stretch by area.",
            "",
            "| pair | vertices | method | left out mean / max (n) | worst landmark | flipped % | coverage % "
            "| Dirichlet | area ratio 5-95 % | aspect 50, 95 % |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        parts += [_animal(row) for row in figures["animals"]]
    return "\n".join(parts) + "\n"


def _order(row: dict) -> tuple:
    return row["pair"], row["source"], row["vertices"][0], row["landmarks"], row["method"]


def _human(row: dict) -> str:
    bar = ""
    if row["pair"] in BARS and row["method"] == "elastic":
        factor = 1.0 if row["landmarks"] <= 14 else 0.75
        mean, p95 = (factor * value for value in BARS[row["pair"]])
        bar = f"{mean:.2f} / {p95:.2f} {'met' if row['mean'] <= mean and row['p95'] <= p95 else 'MISSED'}"
    cells = [
        f"{row['source']} -> {row['target']}", f"{row['vertices'][1]} -> {row['vertices'][0]}", row["landmarks"],
        row["method"], f"{row['mean']:.2f}", f"{row['median']:.2f}", f"{row['p95']:.2f}", f"{row['max']:.1f}",
        f"{row['worst_landmark']:.2f}", f"{row['flipped']:.2f} ({row['true_flipped']:.2f})",
        f"{row['dirichlet_ratio']:.3f}", f"{row['coverage']:.1f}", f"{row['round_trip']:.2f}",
        "" if row["seconds"] is None else f"{row['seconds']:.1f}", bar,
    ]  # fmt: skip
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _animal(row: dict) -> str:
    cells = [
        f"{row['source']} -> {row['target']}", f"{row['vertices'][1]} -> {row['vertices'][0]}", row["method"],
        f"{row['left_out_mean']:.2f} / {row['left_out_max']:.2f} ({row['left_out']})", f"{row['worst_landmark']:.2f}",
        f"{row['flipped']:.2f}", f"{row['coverage']:.1f}", f"{row['dirichlet']:.2f}",
        f"{row['area_ratio_5']:.2f} - {row['area_ratio_95']:.2f}",
        f"{row['aspect_median']:.2f}, {row['aspect_95']:.2f}",
    ]  # fmt: skip
    return "| " + " | ".join(str(cell) for cell in cells) + " |"
