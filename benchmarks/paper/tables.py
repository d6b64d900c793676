"""Tables 1 and 3, and our own table of methods by level and landmarks."""

from __future__ import annotations

import time
from collections.abc import Callable

from benchmarks.accuracy.data import DATA, HUMANS
from benchmarks.paper.data import SCHEDULE, Judged, animal, human
from cagemap.basis import BasisConfig, exact_basis, hierarchical_basis
from cagemap.files.landmarks import read_landmarks
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.threads import thread_limit
from cagemap.operators import build_operators
from cagemap.pipeline import MatchConfig, match, prepare_surface
from cagemap.refinement import refine

# Cage, finest level, schedule; the paper's own pairs are not published.
ROWS = (
    ("anny10pc_neutral", 3, SCHEDULE),
    ("female1605_neutral", 3, SCHEDULE),
    ("male1591_neutral", 3, SCHEDULE),
    ("horse", 4, (100, 50, 50, 50, 50)),
    ("base_neutral", 2, (100, 100, 50)),
)
COUNTS = (14, 30)


def processor_seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def table_1() -> str:
    """Exact against hierarchical basis, both with this package's solvers, in processor seconds of one thread."""
    lines = [
        "| shape | n_0 | f | n_f | schedule | exact s | hierarchical s | ratio | by tolerance s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, level, schedule in ROWS:
        mesh = human(name) if (DATA / "humans" / f"{name}.obj").is_file() else animal(name)
        refinement = refine(mesh, level)
        operators = build_operators(refinement)
        with thread_limit(1):
            seconds = [
                processor_seconds(lambda: exact_basis(operators, level, sum(schedule))),  # noqa: B023
                processor_seconds(lambda: hierarchical_basis(refinement, operators, BasisConfig(schedule=schedule))),  # noqa: B023
                processor_seconds(lambda: hierarchical_basis(refinement, operators, BasisConfig(count=sum(schedule)))),  # noqa: B023
            ]
        fine = refinement.finest.n_vertices
        lines.append(
            f"| {name} | {mesh.n_vertices} | {level} | {fine // 1000}k | {','.join(map(str, schedule))} | {seconds[0]:.1f} | "
            f"{seconds[1]:.1f} | {seconds[0] / seconds[1]:.2f} | {seconds[2]:.1f} |"
        )
        print(lines[-1], flush=True)
    return "\n".join(lines)


def table_3() -> str:
    """Seconds of the stages of whole matches, each side with its own level and schedule as in Table 1."""
    lines = [
        "| target | source | n_f | schedules | prepare s | map s | quality s | landmarks missed | folded |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    pairs = (("zebra", 3, (100, 100, 50, 50), "horse", 4, (100, 50, 50, 50, 50), "zebra__horse"),
             ("cow", 3, (100, 50, 50, 50), "spot", 4, (100, 50, 50, 50, 50), "spot__cow"))  # fmt: skip
    for target_name, l1, k1, source_name, l2, k2, key in pairs:
        place = DATA / "animals" / "landmarks" / f"{key}.json"
        first, second = key.split("__")
        landmarks: Landmarks = read_landmarks(place, f"{second}.obj", f"{first}.obj")[0]
        landmarks = landmarks if target_name == second else landmarks.reversed()
        start = time.perf_counter()
        target = prepare_surface(animal(target_name), l1, BasisConfig(schedule=k1))
        source = prepare_surface(animal(source_name), l2, BasisConfig(schedule=k2))
        ready = time.perf_counter() - start
        found = match(target, source, landmarks, MatchConfig(method="paper"))
        sizes = f"{target.refinement.finest.n_vertices // 1000}k + {source.refinement.finest.n_vertices // 1000}k"
        lines.append(
            f"| {target_name} | {source_name} | {sizes} | {','.join(map(str, k1))} / {','.join(map(str, k2))} | {ready:.1f} | "
            f"{found.timings['map']:.1f} | {found.timings['quality']:.1f} | "
            f"{100 * found.quality.landmark_errors.mean():.1f} % | {100 * found.quality.flipped_area:.1f} % |"
        )
        print(lines[-1], flush=True)
    return "\n".join(lines)


def table_of_methods(keys: tuple[str, ...] = ("female1605__male1591", "anny10pc__anny5pc")) -> str:
    """Mean errors of the methods with 14 and 30 landmarks, on every level where they have one."""
    lines = [
        "| source -> target | landmarks | method | by level | finest, refined |",
        "| --- | --- | --- | --- | --- |",
    ]
    for key in keys:
        pair = HUMANS[key]
        schedules = {"paper": BasisConfig(schedule=(100, 50, 50)), "hfm": BasisConfig(), "elastic": BasisConfig()}
        surfaces = {
            config: [prepare_surface(mesh, 2, config) for mesh in pair.meshes()] for config in set(schedules.values())
        }
        for count in COUNTS:
            for method, config in schedules.items():
                source, target = surfaces[config]
                known = Judged.of(pair, target, source)
                found = match(target, source, pair.landmarks(count), MatchConfig(method=method))
                levels = ", ".join(f"{known.error(known.places[one.match]):.2f}" for one in found.level_maps)
                lines.append(
                    f"| {pair.first} -> {pair.second} | {count} | {method} | {levels} | {known.error(found.point_map.images.positions):.2f} |"
                )
                print(lines[-1], flush=True)
    return "\n".join(lines)
