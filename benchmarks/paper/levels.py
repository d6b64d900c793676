"""Whether more levels make a map worse: errors of both spectral methods over schedules and finest levels."""

from __future__ import annotations

from itertools import pairwise

from benchmarks.accuracy.data import HUMANS
from benchmarks.paper.data import Judged, verdict
from cagemap.pipeline import MatchConfig, default_basis, match, prepare_surface
from cagemap.spectral import BasisConfig

PAIRS = ("female1605__male1591", "anny10pc__anny5pc")
COUNTS = (14, 30)
# The paper's schedule cut after each level, and the default one, each at finest levels 1, 2 and 3.
BASES = {
    "(100,50), (100,50,50), (100,50,50,50)": [BasisConfig(schedule=(100, *[50] * level)) for level in (1, 2, 3)],
    "one level": [default_basis("hfm")] * 3,
}
# A map counts as worse than that of one level less from here on.
WORSE = 1.05


def table_of_levels() -> str:
    """Mean errors, x100 of sqrt(area), with the finest level 1, 2 and 3; and the largest step up."""
    lines = [
        "| source -> target | landmarks | method | basis | level 1, 2, 3 | largest step |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    largest = {"hfm": 0.0, "paper": 0.0}
    for key in PAIRS:
        pair = HUMANS[key]
        for said, configs in BASES.items():
            methods = ("hfm",) if configs[0].schedule is None else ("hfm", "paper")
            errors: dict[tuple[str, int], list[float]] = {(m, count): [] for m in methods for count in COUNTS}
            for level, config in enumerate(configs, 1):
                source, target = (prepare_surface(mesh, level, config) for mesh in pair.meshes())
                known = Judged.of(pair, target, source)
                for (method, count), found in errors.items():
                    result = match(target, source, pair.landmarks(count), MatchConfig(method=method))
                    found.append(known.error(result.point_map.images.positions))
            for (method, count), found in errors.items():
                step = max(after / before for before, after in pairwise(found))
                largest[method] = max(largest[method], step)
                shown = ", ".join(f"{error:.2f}" for error in found)
                lines.append(
                    f"| {pair.first} -> {pair.second} | {count} | {method} | {said} | {shown} | {100 * (step - 1):+.0f} % |"
                )
                print(lines[-1], flush=True)
    said = verdict(largest["hfm"] <= WORSE, "hfm is never worse with a level more by more than 5 %")
    return "\n".join(lines) + (
        f"\n\n{said}: its largest step is {100 * (largest['hfm'] - 1):+.0f} %, that of `paper` "
        f"{100 * (largest['paper'] - 1):+.0f} %. Within one match errors fall from level to level; between matches the start "
        "differs a little, and with it which way a hand settles."
    )
