"""What was said of the maps, and what was true."""

from __future__ import annotations

from benchmarks.sure.models import SORTS, models, sort_of


def markdown(rows: list[dict]) -> str:
    """Counts by the sort of pair, then every pair that was said to be sure and is wrong."""
    named = {model.name: model for model in models()}
    total = len(named) * (len(named) - 1)
    lines = [
        f"{len(rows)} rows of {total} ordered pairs. Right: a mean error of at most 5 % of sqrt(area) for humans; for "
        "animals of a kind a median error of at most that at named places, and no limb at another's. Nothing is right "
        "between different kinds.",
        "",
        "| pairs | measured | right | sure | sure and wrong | sure of the right ones |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in (*SORTS, "all"):
        some = [row for row in rows if name in (sort_of(named[row["target"]], named[row["source"]]), "all")]
        right = [entry for entry in some if entry["right"]]
        sure = [entry for entry in some if entry["said"] == "sure"]
        both = [entry for entry in sure if entry["right"]]
        share = f"{100 * len(both) / len(right):.0f} %" if right else ""
        lines.append(f"| {name} | {len(some)} | {len(right)} | {len(sure)} | {len(sure) - len(both)} | {share} |")
    wrong = [entry for entry in rows if entry["said"] == "sure" and not entry["right"]]
    if wrong:
        lines += [
            "",
            "Sure and wrong:",
            "",
            "| target | source | error | exchanged | cost | gap | folded % | aspect | unreached % | lies |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
    for entry in wrong:
        error = "" if entry["error"] is None else f"{entry['error']:.1f}"
        gap = "" if entry["gap"] is None else f"{entry['gap']:.2f}"
        lines.append(
            f"| {entry['target']} | {entry['source']} | {error} | {entry['exchanged']} | {entry['cost']:.2f} | {gap} "
            f"| {100 * entry['folded']:.2f} | {entry['aspect']:.2f} | {100 * entry['unreached']:.1f} "
            f"| {entry['names'][0]} |"
        )
    return "\n".join(lines) + "\n"
