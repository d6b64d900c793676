"""What every stage of both spectral methods is worth: each left out, set to zero or replaced by noise, in 28 runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.accuracy.data import HUMANS, HumanPair
from benchmarks.truth import Truth, compare_with_truth, true_map
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import LevelMap
from cagemap.paper import hfm, method
from cagemap.paper.constraints import ConstraintConfig, gather_constraints
from cagemap.paper.hfm import HfmConfig, hfm_map
from cagemap.paper.method import PaperConfig, finer_level_pairs, paper_map, recover_points, search_level
from cagemap.pipeline import MatchConfig, choose_level, default_basis, pair_of, prepare_surface
from cagemap.spectral import Surface
from cagemap.spectral.zoomout import ZoomOutSchedule
from cagemap.surface.triangle_surface import TriangleSurface

VERTICES = 25_000
COUNTS = (14, 30)
# Parameters were chosen on these directions (source, target); the others judge them.
CHOSEN_ON = {
    ("female1605", "male1591"), ("male1591", "female1605"), ("anny10pc", "anny5pc"), ("anny5pc", "anny10pc"),
    ("base", "male1591"), ("male1591", "base"), ("base", "anny10pc"),
}  # fmt: skip
Config = HfmConfig | PaperConfig


@dataclass(frozen=True)
class Run:
    """One direction of a pair with a number of landmarks."""

    pair: Pair
    truth: Truth
    landmarks: int
    chosen_on: bool


@dataclass(frozen=True)
class Variant:
    """A method with a stage changed: another configuration, or other functions in its module."""

    stage: str
    change: str
    config: Config
    patches: dict[str, Callable[..., Any]] = field(default_factory=dict)


def noise(values: np.ndarray) -> np.ndarray:
    """Random numbers of the same Frobenius norm."""
    random = np.random.default_rng(20190707).standard_normal(values.shape)
    return random * np.linalg.norm(values) / max(float(np.linalg.norm(random)), np.finfo(float).tiny)


def zero(values: np.ndarray) -> np.ndarray:
    return np.zeros_like(values)


def solved(other: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
    """Eq. 13 with another matrix as its solution."""
    solve = method.solve_functional_map
    return lambda *given: other(solve(*given))


def extended(other: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
    """Eqs. 14-16 with other blocks, each of the solution's norm or zero."""
    extend = method.extend_functional_map

    def changed(coarse: np.ndarray, *given: Any) -> np.ndarray:
        found = extend(coarse, *given).copy()
        low, high = [slice(count) for count in coarse.shape], [slice(count, None) for count in coarse.shape]
        for block in ((low[0], high[1]), (high[0], low[1]), (high[0], high[1])):
            found[block] = other(found[block])
        return found

    return changed


def displaced(other: Callable[[np.ndarray], np.ndarray]) -> Callable[..., hfm.Displacement]:
    """The displacement with other coefficients: noise, or the rotation alone and a shift."""
    fit = hfm.fit_displacement

    def changed(*given: Any) -> hfm.Displacement:
        rotation, coefficients = fit(*given)
        return rotation, np.vstack([coefficients[:1], other(coefficients[1:])])

    return changed


def target_alone(areas: tuple[np.ndarray, np.ndarray], matches: tuple[np.ndarray, np.ndarray]) -> Any:
    """Matches of the target's samples only."""
    return np.arange(len(matches[0])), matches[0], areas[0]


def variants_of_hfm() -> list[Variant]:
    """`hfm` and what it is without each improvement."""
    on = HfmConfig()
    unplaced = replace(on, position_weight=0.0, normal_weight=0.0)
    return [
        Variant("all", "on", on),
        Variant("matches of both directions", "off", on, {"both_directions": target_alone}),
        Variant("displaced target in the search", "off", replace(on, position_weight=0.0)),
        Variant("normals in the search", "off", replace(on, normal_weight=0.0)),
        Variant("displaced target and normals in the search", "off", unplaced),
        Variant("closest points", "off", on, {"closest_map": closest_map_off}),
        Variant("ZoomOut", "off", replace(on, zoomout=ZoomOutSchedule(on.zoomout.last, on.zoomout.last))),
        Variant("displacement", "noise", on, {"fit_displacement": displaced(noise)}),
        Variant("displacement", "zero", on, {"fit_displacement": displaced(zero)}),
        Variant("eq. 13", "noise", on, {"solve_functional_map": solved(noise)}),
        Variant("eq. 13", "zero", on, {"solve_functional_map": solved(zero)}),
    ]


def variants_of_paper() -> list[Variant]:
    """`paper` and what it is without each stage."""
    on = PaperConfig()
    return [
        Variant("all", "on", on),
        Variant("eq. 13", "noise", on, {"solve_functional_map": solved(noise)}),
        Variant("eq. 13", "zero", on, {"solve_functional_map": solved(zero)}),
        Variant("eqs. 14-16", "noise", on, {"extend_functional_map": extended(noise)}),
        Variant("eqs. 14-16", "zero", on, {"extend_functional_map": extended(zero)}),
        Variant("rounds of 2.1.4", "off", replace(on, rounds=0)),
        Variant("rounds of 2.1.4", "orthonormal", replace(on, orthonormal=True)),
        Variant("rounds of 2.1.4", "one, orthonormal", replace(on, rounds=1, orthonormal=True)),
        Variant("decay", "off", replace(on, decay=0.0)),
        Variant("Laplacian", "off", replace(on, laplacian=0.0)),
        Variant("symmetry", "off", replace(on, operators=0.0)),
        Variant("signatures", "off", replace(on, signature_weight=0.0)),
        Variant("heat kernels", "off", replace(on, heat=0)),
        Variant("wave kernels", "off", replace(on, wave=0)),
    ]


def closest_map_off(pair: Pair, levels: tuple[int, int], functional_map: np.ndarray, _: Any) -> LevelMap:
    """C alone: full search on the first level, Fig. 9 and vertex to point below (5.4), as `paper` does it."""
    first = hfm.search_levels(pair.target, pair.source, HfmConfig().search_vertices)
    found = LevelMap(first, functional_map, search_level(pair, functional_map, first))
    if levels != (pair.target.finest_level, pair.source.finest_level):
        return found  # only the last level is judged
    for finer in finer_level_pairs(pair, first):
        found = LevelMap(finer, functional_map, search_level(pair, functional_map, finer, found))
    return replace(found, points=recover_points(pair, found))


@cache
def surface(name: str, identity: str, vertices: int, of: str) -> Surface:
    """One identity of a cage, prepared for a method."""
    control = HumanPair(name, name, (identity, identity)).meshes()[0]
    level = choose_level(control, vertices)
    return prepare_surface(control, level, default_basis(of, level))


def runs(of: str, vertices: int) -> Iterator[Run]:
    """14 directions, each with 14 and 30 landmarks."""
    for human in HUMANS.values():
        names = (human.first, human.second)
        sides = [surface(name, identity, vertices, of) for name, identity in zip(names, human.identities, strict=True)]
        neutrals = [
            TriangleSurface.from_faces(
                side.hierarchy.prolong(neutral, 0, side.finest_level), side.finest_triangles.triangles
            )
            for side, neutral in zip(sides, human.neutrals(), strict=True)
        ]
        for source, target in ((0, 1), (1, 0)):
            truth = true_map(neutrals[target], neutrals[source])
            for count in COUNTS:
                landmarks = human.landmarks(count) if target else human.landmarks(count).reversed()
                pair = pair_of(sides[target], sides[source], landmarks, MatchConfig(method=of))
                yield Run(pair, truth, count, (names[source], names[target]) in CHOSEN_ON)


def figures(variant: Variant, all_runs: list[Run], constraints: Callable[[Pair, ConstraintConfig], Any]) -> np.ndarray:
    """(runs, 2) mean error x100 of sqrt(area) and folded area in percent."""
    module, find = (hfm, hfm_map) if isinstance(variant.config, HfmConfig) else (method, paper_map)
    rows, c = [], variant.config
    descriptors = ConstraintConfig(heat=c.heat, wave=c.wave, signature_weight=c.signature_weight)  # one cached value
    with ExitStack() as stack:
        for name, function in variant.patches.items():
            stack.enter_context(patch.object(module, name, function))
        for run in all_runs:
            given = constraints(run.pair, descriptors)
            found: PointMap = find(run.pair, variant.config, constraints=given)[1]  # type: ignore[operator]
            judged = compare_with_truth(found, run.truth)
            rows.append((100.0 * judged.mean, 100.0 * judged.flipped_area))
    return np.array(rows)


def table_of_stages(of: str, vertices: int = VERTICES) -> str:
    """Errors of a method and of its variants: 14 and 30 landmarks, and what the change costs on either half."""
    lines = [
        "| stage | change | 14 landmarks | 30 landmarks | folded % | cost, all | cost, chosen on | cost, judged on | runs 20 % worse |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    all_runs = list(runs(of, vertices))
    many, chosen = (
        np.array([test(run) for run in all_runs]) for test in (lambda r: r.landmarks == 30, lambda r: r.chosen_on)
    )
    constraints, usual = cache(gather_constraints), np.zeros(0)
    for variant in variants_of_hfm() if of == "hfm" else variants_of_paper():
        found = figures(variant, all_runs, constraints)
        errors, folded = found.T
        usual = usual if len(usual) else errors
        costs = [100.0 * (errors[half].mean() / usual[half].mean() - 1.0) for half in (chosen | True, chosen, ~chosen)]
        lines.append(
            f"| {variant.stage} | {variant.change} | {errors[~many].mean():.2f} | {errors[many].mean():.2f} | "
            f"{folded.mean():.1f} | "
            + " | ".join(f"{cost:+.0f} %" for cost in costs)
            + f" | {np.sum(errors > 1.2 * usual)} |"
        )
        print(lines[-1], flush=True)
    return "\n".join(lines)
