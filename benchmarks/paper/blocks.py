"""What eqs. 14-16 carry: their blocks against those of the true map, by schedule, landmarks and descriptors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from unittest.mock import patch

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from benchmarks.accuracy.data import HUMANS
from benchmarks.paper.data import Judged
from benchmarks.paper.stages import extended, noise, zero
from cagemap.maps.pair import Pair
from cagemap.mesh.landmarks import Landmarks
from cagemap.paper import method
from cagemap.paper.constraints import (
    ConstraintConfig,
    Constraints,
    SpectralData,
    gather_constraints,
    landmark_descriptors,
    normalise_columns,
)
from cagemap.paper.method import PaperConfig, paper_map
from cagemap.pipeline import MatchConfig, pair_of, prepare_surface
from cagemap.spectral import BasisConfig, Surface
from cagemap.spectral.zoomout import fit_functional_map

KEYS = ("female1605__male1591", "anny10pc__anny5pc")
FUNCTIONS = 150
FIRST = (20, 40, 60, 100)
COUNTS = (5, 14, 30, 60)
# Control vertices whose true images are this near a source control vertex may be landmarks; of sqrt(area).
EXACT = 0.01
REGION = 0.06  # radius of a landmark's region


@dataclass(frozen=True)
class Case:
    """Two surfaces with two levels, their true functional map and where every vertex belongs."""

    target: Surface
    source: Surface
    judged: Judged
    truth: np.ndarray
    key: str

    def pair(self, count: int) -> Pair:
        """With farthest point landmarks; others than 14 and 30 of them are drawn here."""
        human = HUMANS[self.key]
        if count in (14, 30):
            return pair_of(self.target, self.source, human.landmarks(count), MatchConfig(method="paper"))
        near = np.linalg.norm(self.judged.images[: self.target.control.n_vertices, None] - self.places[None], axis=2)
        free = near.min(axis=1) < EXACT
        free &= self.judged.known[: len(free)]
        chosen, away = [int(np.flatnonzero(free)[0])], np.where(free, np.inf, -1.0)
        positions = self.target.triangles(0).positions
        while len(chosen) < count:
            away = np.minimum(away, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
            chosen.append(int(np.argmax(np.where(free, away, -1.0))))
        names = tuple(map(str, chosen))
        controls = self.target.control.name, self.source.control.name
        landmarks = Landmarks(names, np.array(chosen), near[chosen].argmin(axis=1), *controls)
        return pair_of(self.target, self.source, landmarks, MatchConfig(method="paper"))

    @property
    def places(self) -> np.ndarray:
        return self.source.triangles(0).positions


@cache
def case(key: str, first: int) -> Case:
    """A pair forward, ``first`` functions on level 0 and the rest of 150 on level 1."""
    config = BasisConfig(schedule=(first, FUNCTIONS - first))
    source, target = (prepare_surface(mesh, 1, config) for mesh in HUMANS[key].meshes())
    judged = Judged.of(HUMANS[key], target, source)
    rows, known = target.basis.at(1), judged.known
    match = cKDTree(judged.places).query(judged.images[known])[1]
    areas = target.operators.areas(1)[known]
    truth = fit_functional_map(rows[known][:, :FUNCTIONS], areas, source.basis.at(1)[match])
    return Case(target, source, judged, truth, key)


def of_truth(truth: np.ndarray) -> Callable[..., np.ndarray]:
    """Eqs. 14-16 replaced by the true map's blocks."""

    def changed(coarse: np.ndarray, *_: object) -> np.ndarray:
        found = truth.copy()
        found[: coarse.shape[0], : coarse.shape[1]] = coarse
        return found

    return changed


def measured(at: Case, pair: Pair, constraints: Constraints, first: int) -> dict[str, float]:
    """Norm and cosine of C_h, rank of its system, and errors with the solution, noise, zeros and the truth in it."""
    seen: list[np.ndarray] = []
    extend = method.extend_functional_map

    def watched(*given: object) -> np.ndarray:
        seen.append(extend(*given))
        return seen[-1]

    results = {}
    for name, function in (
        ("on", watched), ("noise", extended(noise)), ("zero", extended(zero)), ("truth", of_truth(at.truth)),
    ):  # fmt: skip
        with patch.object(method, "extend_functional_map", function):
            points = paper_map(pair, PaperConfig(), constraints=constraints)[1]
        results[name] = at.judged.error(points.images.positions)
    high, true = seen[0][first:, first:], at.truth[first:, first:]
    gram = constraints.source.descriptors[first:] @ constraints.source.descriptors[first:].T
    determined = float(np.mean(np.linalg.eigvalsh(gram) > PaperConfig().decay))
    norms = float(np.linalg.norm(high)), float(np.linalg.norm(true))
    cosine = float(np.sum(high * true) / (norms[0] * norms[1]))
    return {"norm": norms[0] / norms[1], "cosine": cosine, "rank": determined, **results}


def of_both(pair: Pair, made: Callable[[Surface, np.ndarray], np.ndarray]) -> Constraints:
    """Descriptors (k, q) of both surfaces from their landmarks, beside the usual signatures and symmetries."""
    usual = gather_constraints(pair, ConstraintConfig())
    filters = usual.target.descriptors.shape[1] - ConstraintConfig().heat - ConstraintConfig().wave
    sides = []
    for surface, landmarks, data in (
        (pair.target, pair.target_landmarks, usual.target), (pair.source, pair.source_landmarks, usual.source),
    ):  # fmt: skip
        columns = np.hstack([normalise_columns(made(surface, landmarks)), data.descriptors[:, filters:]])
        sides.append(SpectralData(data.eigenvalues, columns, data.operators))
    return Constraints(*sides)


def landmark_rows(surface: Surface, landmarks: np.ndarray) -> np.ndarray:
    level = surface.basis.last_level
    return surface.basis.rows(level, surface.hierarchy.on_level(level, landmarks))


def bands(count: int) -> Callable[[Surface, np.ndarray], np.ndarray]:
    """Kernels at equal steps of the eigenvalue, as wide as a step: 150 of them are as narrow as the spacing."""

    def made(surface: Surface, landmarks: np.ndarray) -> np.ndarray:
        order = np.argsort(np.argsort(surface.basis.eigenvalues))  # places in the spectrum, which both sides share
        centres = (np.arange(count) + 0.5) * surface.basis.count / count
        width = surface.basis.count / count
        filters = np.exp(-0.5 * ((order[:, None] - centres) / width) ** 2)
        return landmark_descriptors(landmark_rows(surface, landmarks), filters)

    return made


def of_regions(surface: Surface, landmarks: np.ndarray) -> np.ndarray:
    """Means of the kernels over a disc around every landmark."""
    level = surface.basis.last_level
    positions, rows = surface.triangles(level).positions, surface.basis.at(level)
    areas = surface.operators.areas(level)
    centres = positions[surface.hierarchy.on_level(level, landmarks)]
    inside = np.linalg.norm(positions[None] - centres[:, None], axis=2) < REGION
    weights = inside * areas
    order = np.argsort(np.argsort(surface.basis.eigenvalues))
    filters = np.exp(-0.5 * ((order[:, None] - (np.arange(30) + 0.5) * 5) / 5) ** 2)
    return landmark_descriptors((weights / weights.sum(axis=1, keepdims=True)) @ rows, filters)


def per_level(constraints: Constraints, first: int) -> Constraints:
    """Every descriptor twice: its part in each level's functions, of unit norm there."""
    sides = []
    for data in (constraints.target, constraints.source):
        low, high = data.descriptors.copy(), data.descriptors.copy()
        low[first:], high[:first] = 0.0, 0.0
        sides.append(replace(data, descriptors=np.hstack([normalise_columns(low), normalise_columns(high)])))
    return Constraints(*sides)


def with_products(pair: Pair, constraints: Constraints, count: int = 8) -> Constraints:
    """Multiplications with some descriptors as operators [NO17]."""
    steps = np.linspace(0, constraints.target.descriptors.shape[1], count, endpoint=False).astype(int)
    for step in steps:
        operators = []
        for surface, data in ((pair.target, constraints.target), (pair.source, constraints.source)):
            level = surface.basis.last_level
            rows = surface.basis.at(level)
            values = rows @ data.descriptors[:, step]
            operators.append(3.0 * surface.basis.project(rows * (values / np.abs(values).max())[:, None], level))
        constraints = constraints.with_operators(*operators)
    return constraints


def mean_row(label: str, rows: list[dict[str, float]]) -> str:
    """One line of a table from both pairs' figures."""
    mean = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    print(label, mean, flush=True)
    return (
        f"| {label} | {mean['norm']:.2f} | {mean['cosine']:.2f} | {100 * mean['rank']:.0f} % | {mean['on']:.2f} | "
        f"{mean['noise']:.2f} ({100 * (mean['noise'] / mean['on'] - 1):+.0f} %) | {mean['zero']:.2f} | {mean['truth']:.2f} |"
    )


HEAD = (
    "| {} | norm | cosine | determined | error | with noise | with zeros | with the true blocks |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- |"
)


def figure_of_blocks() -> tuple[Figure, str]:
    """Cosine and cost of noise by schedule and by landmarks; tables of both and of descriptors."""
    schedules: dict[tuple[int, int], list[dict[str, float]]] = {}
    lines = [HEAD.format("functions on level 0, landmarks")]
    for first in FIRST:
        for count in (14, 30):
            rows = []
            for key in KEYS:
                pair = case(key, first).pair(count)
                rows.append(measured(case(key, first), pair, gather_constraints(pair), first))
            schedules[first, count] = rows
            lines.append(mean_row(f"{first}, {count}", rows))
    landmarks: dict[int, list[dict[str, float]]] = {}
    lines += ["", HEAD.format("landmarks (40 functions on level 0)")]
    for count in COUNTS:
        rows = schedules.get((40, count), [])
        for key in KEYS[len(rows) :]:
            pair = case(key, 40).pair(count)
            rows = [*rows, measured(case(key, 40), pair, gather_constraints(pair), 40)]
        landmarks[count] = rows
        lines.append(mean_row(str(count), rows))
    lines += ["", HEAD.format("descriptors (30 landmarks, 40 functions on level 0)")]
    kinds: dict[str, Callable[[Pair], Constraints]] = {
        "10 heat and 20 wave kernels": gather_constraints,
        "60 wave kernels": lambda pair: gather_constraints(pair, ConstraintConfig(heat=0, wave=60)),
        "150 wave kernels": lambda pair: gather_constraints(pair, ConstraintConfig(heat=0, wave=150)),
        "kernels 5 functions wide": lambda pair: of_both(pair, bands(30)),
        "kernels 1 function wide": lambda pair: of_both(pair, bands(150)),
        "normalised on each level": lambda pair: per_level(gather_constraints(pair), 40),
        "regions, 5 functions wide": lambda pair: of_both(pair, of_regions),
        "8 products as operators": lambda pair: with_products(pair, gather_constraints(pair)),
    }
    for kind, made in kinds.items():
        rows = []
        for key in KEYS:
            pair = case(key, 40).pair(30)
            rows.append(measured(case(key, 40), pair, made(pair), 40))
        lines.append(mean_row(kind, rows))
    return drawn(schedules, landmarks), "\n".join(lines)


def drawn(
    schedules: dict[tuple[int, int], list[dict[str, float]]], landmarks: dict[int, list[dict[str, float]]]
) -> Figure:
    """Two panels."""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.4))

    def mean(rows: list[dict[str, float]], name: str) -> float:
        return float(np.mean([row[name] for row in rows]))

    for name, style in (("on", "o-"), ("noise", "s--"), ("zero", "^:"), ("truth", "d-.")):
        said = {"on": "eqs. 14-16", "noise": "noise", "zero": "zeros", "truth": "true blocks"}[name]
        axes[0].plot(FIRST, [mean(schedules[first, 30], name) for first in FIRST], style, label=said)
        axes[1].plot(COUNTS, [mean(landmarks[count], name) for count in COUNTS], style, label=said)
    axes[0].set_xlabel("functions on level 0, of 150 (30 landmarks)")
    axes[1].set_xlabel("landmarks (40 functions on level 0)")
    for axis in axes:
        axis.set_ylabel("mean error, % of sqrt(area)")
        axis.legend(frameon=False)
    return figure
