"""What is said of maps against what is true, with confidence intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from cagemap.maps.hypotheses.confidence import JUMPING, LOOK, SIGN_BOUNDS, SURE
from cagemap.maps.result import MatchResult

# Normal quantile of a two-sided interval of 95 %.
QUANTILE = 1.96


def verdict(result: MatchResult) -> dict:
    """Verdict and signs of a map; "" where landmarks decide it and nothing doubts it."""
    said = result.confidence
    if said is None:
        jumps = any(warning.startswith(JUMPING) for warning in result.quality.warnings)
        return {"said": LOOK if jumps else "", "signs": {}, "names": []}
    names = [reading.name for reading in said.answers]
    return {"said": said.verdict, "signs": dict(said.signs), "names": names}


def wilson(count: int, total: int) -> tuple[float, float]:
    """Interval of 95 % of a share (Wilson 1927)."""
    if not total:
        return 0.0, 1.0
    share, width = count / total, QUANTILE**2 / total
    middle = share + width / 2
    half = QUANTILE * np.sqrt(share * (1 - share) / total + width / (4 * total))
    return float((middle - half) / (1 + width)), float((middle + half) / (1 + width))


def table(groups: Mapping[str, list[dict]]) -> list[str]:
    """Markdown lines: counts of each group, then which signs doubt right maps, then maps that are sure and wrong.

    Rows have `verdict`'s keys, "right", "target", "source" and "error".
    """
    lines = [
        "| pairs | measured | right | sure, right | sure, wrong | doubted, right | doubted, wrong "
        "| sure of the right ones | doubts of the right ones |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, rows in groups.items():
        counts = Counter((row["said"] if row["said"] in ("", SURE) else LOOK, row["right"]) for row in rows)
        right = sum(row["right"] for row in rows)
        cells = [counts[said, true] for said in (SURE, LOOK) for true in (True, False)]
        shares = [_share(counts[said, True], right) for said in (SURE, LOOK)]
        lines.append("| " + " | ".join(map(str, [name, len(rows), right, *cells, *shares])) + " |")
    every = [row for rows in groups.values() for row in rows]
    doubted = [beyond(row) for row in every if row["right"] and row["said"] not in ("", SURE)]
    lines += ["", "| sign | right maps doubted | by it alone | wrong maps doubted | by it alone |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    wrong = [beyond(row) for row in every if not row["right"]]
    for sign in SIGN_BOUNDS:
        cells = [n for some in (doubted, wrong) for n in (sum(sign in one for one in some), some.count([sign]))]
        lines.append(f"| {sign} | {' | '.join(map(str, cells))} |")
    lines += ["", "Sure and wrong:"]
    lines += [
        f"- {row['target']} <- {row['source']}: {row['error'] or np.nan:.1f}, {row['signs']}"
        for row in every
        if row["said"] == SURE and not row["right"]
    ]
    return lines


def beyond(row: dict) -> list[str]:
    """Names of the signs that are beyond their bounds."""
    return [name for name, bound in SIGN_BOUNDS.items() if row["signs"].get(name, 0.0) > bound]


def _share(count: int, total: int) -> str:
    low, high = wilson(count, total)
    return f"{100 * count / total:.0f} % ({100 * low:.0f} - {100 * high:.0f})" if total else ""
