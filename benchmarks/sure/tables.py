"""What was said of the maps, and what was true."""

from __future__ import annotations

from benchmarks.sure.models import models

GROUPS = ("humans as they stand", "humans, posed", "animals of a kind", "different kinds")


def group(entry: dict) -> str:
    """What sort of pair a row is about."""
    kinds = {model.name: model.kind for model in models()}
    names = entry["target"], entry["source"]
    if kinds[names[0]] != kinds[names[1]]:
        return GROUPS[3]
    if kinds[names[0]] != "human":
        return GROUPS[2]
    return GROUPS[1] if any(name.endswith(("_sit", "_stride", "_crouch")) for name in names) else GROUPS[0]


def markdown(rows: list[dict]) -> str:
    """Counts by the sort of pair, then every pair that was said to be sure and is wrong."""
    total = len(models()) * (len(models()) - 1)
    lines = [
        f"{len(rows)} rows of {total} ordered pairs. Right: a mean error of at most 5 % of sqrt(area) for humans; for "
        "animals of a kind a median error of at most that at named places, and no limb at another's. Nothing is right "
        "between different kinds.",
        "",
        "| pairs | measured | right | sure | sure and wrong | sure of the right ones |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in (*GROUPS, "all"):
        some = [entry for entry in rows if name in (group(entry), "all")]
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
            "| target | source | error | exchanged | cost | gap | folded % | aspect | lies |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
    for entry in wrong:
        error = "" if entry["error"] is None else f"{entry['error']:.1f}"
        gap = "" if entry["gap"] is None else f"{entry['gap']:.2f}"
        lines.append(
            f"| {entry['target']} | {entry['source']} | {error} | {entry['exchanged']} | {entry['cost']:.2f} | {gap} "
            f"| {100 * entry['folded']:.2f} | {entry['aspect']:.2f} | {entry['names'][0]} |"
        )
    return "\n".join(lines) + "\n"
