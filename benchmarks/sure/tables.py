"""What was said of the maps, and what was true."""

from __future__ import annotations

from itertools import product

from benchmarks.sure.models import SORTS, models, sort_of


def markdown(rows: list[dict]) -> str:
    """Counts by the sort of pair, then every pair that was said to be sure and is wrong."""
    named = {model.name: model for model in models()}
    free = sum(not entry.get("landmarks") for entry in rows)
    lines = [
        f"{free} of {len(named) * (len(named) - 1)} pairs without landmarks, {len(rows) - free} with one or two. "
        "Right: a mean error of at most 5 % of sqrt(area) for humans; for animals of a kind a median error of at most "
        "that at named places, and no limb at another's. Nothing is right between different kinds.",
        "",
        "| landmarks | pairs | measured | right | sure | sure and wrong | sure of the right ones |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for count, name in product(("0", "1 or 2"), (*SORTS, "all")):
        given = [entry for entry in rows if bool(entry.get("landmarks")) == (count != "0")]
        some = [row for row in given if name in (sort_of(named[row["target"]], named[row["source"]]), "all")]
        right = [entry for entry in some if entry["right"]]
        sure = [entry for entry in some if entry["said"] == "sure"]
        both = [entry for entry in sure if entry["right"]]
        share = f"{100 * len(both) / len(right):.0f} %" if right else ""
        counts = f"{len(some)} | {len(right)} | {len(sure)} | {len(sure) - len(both)} | {share}"
        lines.append(f"| {count} | {name} | {counts} |")
    wrong = [entry for entry in rows if entry["said"] == "sure" and not entry["right"]]
    if wrong:
        lines += [
            "",
            "Sure and wrong:",
            "",
            "| landmarks | target | source | error | exchanged | cost | gap | folded % | aspect | unreached % | lies |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
    for entry in wrong:
        error = "" if entry["error"] is None else f"{entry['error']:.1f}"
        gap = "" if entry["gap"] is None else f"{entry['gap']:.2f}"
        lines.append(
            f"| {entry.get('landmarks', 0)} | {entry['target']} | {entry['source']} | {error} | {entry['exchanged']} "
            f"| {entry['cost']:.2f} | {gap} | {100 * entry['folded']:.2f} | {entry['aspect']:.2f} "
            f"| {100 * entry['unreached']:.1f} | {entry['names'][0]} |"
        )
    return "\n".join(lines) + "\n"
