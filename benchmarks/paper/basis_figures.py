"""Figs. 3 to 8: operators and basis."""

from __future__ import annotations

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper.data import SCHEDULE, color_scale, human, picture, prepared, verdict
from cagemap.operators import build_operators
from cagemap.paper.constraints import heat_filters, heat_times, signatures
from cagemap.pictures import BALANCE_SCALE, scalar_colors
from cagemap.spectral import exact_basis
from cagemap.spectral.basis import HierarchicalBasis
from cagemap.subdivision import level_triangles, refine

Drawn = tuple[Figure, str]
# Ratio of two levels' eigenvalues below which they are called different, as in the paper's Fig. 6 (its axis ends at 0.94).
SIMILAR = 0.94
CAGE = "female1605_neutral"
FUNCTIONS = 1000


def figure_3() -> Drawn:
    """The levels' meshes above the sparsity of their operators."""
    surface = prepared(CAGE, 2)
    figure, axes = plt.subplots(2, 3, figsize=(9, 7))
    sizes = []
    for level in range(3):
        mesh, stiffness = surface.refinement.levels[level], surface.operators.stiffness[level]
        triangles = level_triangles(surface.refinement, level)
        axes[0, level].imshow(picture(mesh.positions, triangles, np.full((mesh.n_vertices, 3), 0.75)))
        axes[0, level].set_title(f"level {level}: {mesh.n_vertices:,} vertices")
        axes[0, level].axis("off")
        axes[1, level].spy(stiffness, markersize=0.05, rasterized=True)  # a dot an entry: no vectors
        sizes.append(stiffness.nnz / stiffness.shape[0])
        axes[1, level].set(
            xticks=[], yticks=[], ylabel="vertex", xlabel=f"vertex; $W^{level}$: {sizes[-1]:.0f} entries a row"
        )
    entries = ", ".join(f"{size:.0f}" for size in sizes)
    return figure, f"Entries a row of $W^l$, from level 0: {entries}. The finest level's geometry reaches every level."


def figure_4() -> Drawn:
    """Representation error of random functions in Im(S), exact and prolonged eigenvectors."""
    refinement = refine(human("anny10pc_neutral"), 1)
    operators = build_operators(refinement)
    coarse, fine = exact_basis(operators, 0, 200), exact_basis(operators, 1, 200)
    rng = np.random.default_rng(2019)
    functions = refinement.matrices[0] @ rng.standard_normal((refinement.levels[0].n_vertices, FUNCTIONS))
    mass = operators.mass[1]
    total = np.sum(functions * (mass @ functions), axis=0)
    curves = {}
    for name, vectors in (
        ("exact $\\Phi^{l+1}$", fine.vectors),
        ("prolonged $S\\Phi^l$", refinement.matrices[0] @ coarse.vectors),
    ):
        inside = np.cumsum((vectors.T @ (mass @ functions)) ** 2, axis=0)
        curves[name] = np.mean(1.0 - inside / total, axis=1)
    figure, axis = plt.subplots(figsize=(5, 3.5))
    for name, curve in curves.items():
        axis.plot(np.arange(1, 201), curve, label=name)
    axis.set(xlabel="number of eigenvectors k", ylabel="mean error / norm of the function", ylim=(0.4, 1.0))
    axis.legend()
    exact, prolonged = curves.values()
    gap = exact - prolonged
    return figure, (
        f"At k = 50, 100, 150, 200: exact {exact[49]:.3f}, {exact[99]:.3f}, {exact[149]:.3f}, {exact[199]:.3f}; prolonged "
        f"{prolonged[49]:.3f}, {prolonged[99]:.3f}, {prolonged[149]:.3f}, {prolonged[199]:.3f}. Up to k = 100 they differ by "
        f"{100 * abs(gap[:100]).max():.1f} points at most. "
        f"{verdict(bool(np.mean(gap[100:]) < 0), 'exact slightly better after 100')}: for functions in Im(S) the prolonged "
        f"ones are better there by {100 * gap[100:].max():.1f} points at most, and anywhere worse by "
        f"{max(0.0, -100 * gap.min()):.2f} at most."
    )


def figure_5() -> Drawn:
    """Eigenvectors of level 1 above those prolonged from level 0."""
    refinement = refine(human(CAGE), 1)
    operators = build_operators(refinement)
    coarse, fine = exact_basis(operators, 0, 24), exact_basis(operators, 1, 24)
    gaps = np.diff(fine.values) / np.maximum(fine.values[1:], 1e-9)
    alone = [j for j in range(1, 22) if min(gaps[j - 1], gaps[j]) > 0.01]
    prolonged = refinement.matrices[0] @ coarse.vectors
    products = np.sum(fine.vectors * (operators.mass[1] @ prolonged), axis=0)
    shown = alone[:5]
    triangles = level_triangles(refinement, 1)
    figure, axes = plt.subplots(2, len(shown), figsize=(2.2 * len(shown) + 1, 6))
    for column, j in enumerate(shown):
        for row, values in enumerate((fine.vectors[:, j], np.sign(products[j]) * prolonged[:, j])):
            reach = np.abs(values).max()
            colors = scalar_colors(values, -reach, reach, BALANCE_SCALE)
            axes[row, column].imshow(picture(refinement.finest.positions, triangles, colors, size=(600, 1000)))
            axes[row, column].axis("off")
        axes[0, column].set_title(f"{j}: {abs(products[j]):.4f}")
    for axis, name in zip(axes[:, -1], ("exact", "prolonged"), strict=True):
        color_scale(axis, BALANCE_SCALE, -1.0, 1.0, f"{name} eigenvector / largest value")
    worst = min(alone, key=lambda j: abs(products[j]))
    return figure, (
        f"Above exact, below prolonged, with their inner product. Over {len(alone)} separated eigenvectors of the first 21 "
        f"the smallest is {abs(products[worst]):.3f} (number {worst})."
    )


def figure_6() -> Drawn:
    """Eigenvalues of every level, and their ratios."""
    refinement = refine(human(CAGE), 2)
    operators = build_operators(refinement)
    values = [exact_basis(operators, level, 300).values for level in range(3)]
    figure, axes = plt.subplots(1, 4, figsize=(13, 3))
    for level, spectrum in enumerate(values):
        axes[0].plot(np.arange(50, 251), spectrum[50:251], label=f"level {level}")
        axes[1].plot(np.arange(260, 300), spectrum[260:300])
    ratios = [fine[1:] / coarse[1:] for coarse, fine in pairwise(values)]
    for level, ratio in enumerate(ratios):
        axes[2].plot(np.arange(50, 251), ratio[49:250], label=f"{level + 1} / {level}")
        axes[3].plot(np.arange(260, 300), ratio[259:299])
    axes[0].legend()
    axes[2].legend()
    for axis, title in zip(axes, ("eigenvalues", "their end", "ratios", "their end"), strict=True):
        axis.set(title=title, xlabel="number of the eigenvalue")
    for axis in axes[:2]:
        axis.set_ylabel("eigenvalue of unit area")
    for axis in axes[2:]:
        axis.set_ylabel("eigenvalue, finer / coarser level")
    said = "; ".join(
        f"level {level + 1} / {level}: {ratio[99]:.3f}, {ratio[199]:.3f}, {ratio[298]:.3f}"
        for level, ratio in enumerate(ratios)
    )
    largest = max(float(ratio.max()) for ratio in ratios)
    breaks = [int(np.argmax(np.append(ratio, 0.0) < SIMILAR)) + 1 for ratio in ratios]  # beyond the last one: never
    later = all(coarse < fine for coarse, fine in pairwise(breaks))
    where = ", ".join(f"from j = {j} on" if j <= len(ratios[0]) else f"nowhere up to {j - 1}" for j in breaks)
    return figure, (
        f"Ratios at j = 100, 200, 299: {said}. The largest is {largest:.6f}"
        f"{'; none can be above 1, for the spaces are nested' if largest <= 1.0 + 1e-9 else ', above 1: a mistake'}. They are "
        f"below {SIMILAR}: {where}. "
        f"{verdict(later, 'the similarity breaks later for higher levels')}."
    )


def figure_7() -> Drawn:
    """The schedule as blocks."""
    surface = prepared(CAGE, 3)
    basis: HierarchicalBasis = surface.basis
    figure, axis = plt.subplots(figsize=(7, 3.5))
    for level in range(4):
        left = 0
        for band, count in enumerate(basis.schedule[: level + 1]):
            color = plt.cm.viridis(0.2 + 0.2 * band)
            axis.barh(level, count, left=left, color=color, edgecolor="white", hatch="" if band == level else "//")
            axis.text(left + count / 2, level, str(count), ha="center", va="center", color="white")
            left += count
    axis.set(xlabel="basis functions", ylabel="level", yticks=range(4))
    axis.invert_yaxis()
    bands = np.split(basis.eigenvalues, np.cumsum(basis.schedule)[:-1])
    spans = ", ".join(f"{band.min():.0f} to {band.max():.0f}" for band in bands)
    return figure, (
        f"Hatched: prolonged from the level above in the picture. Eigenvalues of the bands of {SCHEDULE}: {spans}. Bands "
        f"start by index, not after the largest eigenvalue so far (see the paper map); condition of the Gram matrix {basis.condition:.1f}."
    )


def figure_8() -> Drawn:
    """Hierarchical over exact heat kernel signatures."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), sharey=True)
    said, beyond, first, last = [], [], [], []
    for axis, (name, level, schedule) in zip(
        axes, (("base_neutral", 1, (100, 200)), (CAGE, 2, (100, 50, 50))), strict=True
    ):
        surface = prepared(name, level, schedule)
        exact = exact_basis(surface.operators, level, sum(schedule))
        times = heat_times(exact.values, 20)
        rows = surface.basis.at(level)
        ours = signatures(rows, heat_filters(surface.basis.eigenvalues, times))
        theirs = signatures(exact.vectors, heat_filters(exact.values, times))
        ratio = ours / theirs
        for quantile, style in ((0.0, ":"), (0.05, "--"), (0.5, "-"), (0.95, "--"), (1.0, ":")):
            axis.semilogx(times, np.quantile(ratio, quantile, axis=0), style, color="C0")
        axis.set(title=f"{name}, {schedule}", xlabel="time t of unit area", ylim=(0.9, 1.1))
        axis.axhspan(0.98, 1.02, color="0.9")
        axes[0].set_ylabel("heat kernel signature, ours / exact")
        away = abs(ratio - 1)
        beyond.append(100 * float(np.mean(away[:, 0] > 0.02)))
        first.append(float(away[:, 0].max()))
        last.append(float(away[:, -1].max()))
        said.append(
            f"{name} with {schedule}: at the smallest t {ratio[:, 0].min():.3f} to {ratio[:, 0].max():.3f}, {beyond[-1]:.1f} % "
            f"of the vertices beyond 2 %, mean error {100 * np.mean(away[:, 0]):.2f} %; at the largest {100 * last[-1]:.1e} %"
        )
    return figure, (
        "Quantiles 0, 5, 50, 95, 100 % over all vertices (the paper shows a few). " + ". ".join(said) + ". "
        f"{verdict(all(a > b for a, b in zip(first, last, strict=True)), 'as t increases the error decreases')}. "
        f"{verdict(max(beyond) == 0.0, 'less than 2 percent even for small t', 'true of every vertex of')}"
        f"{'' if max(beyond) == 0.0 else f' {beyond.count(0.0)} of these {len(beyond)} cages'}."
    )
