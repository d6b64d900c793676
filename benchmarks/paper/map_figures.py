"""Figs. 2, 9 and 10: the pipeline, the candidates, the map of every level."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper.data import PAIR, Judged, picture, prepared, verdict, with_landmarks
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import flipped_triangles
from cagemap.maps.result import LevelMap
from cagemap.paper.descriptors import choose_filters, landmark_descriptors
from cagemap.paper.method import paper_map
from cagemap.pictures import BALANCE_SCALE, position_colors, scalar_colors
from cagemap.subdivision import level_triangles

Drawn = tuple[Figure, str]
LANDMARKS = 30


@cache
def paper_maps() -> tuple[Pair, Judged, tuple[LevelMap, ...], PointMap]:
    """The paper's method on the pair of the bars, (100, 50, 50, 50)."""
    target, source = prepared("male1591_female_old_heavy", 3), prepared("female1605_male_young", 3)
    pair = with_landmarks(target, source, LANDMARKS)
    maps, points = paper_map(pair)
    return pair, Judged.of(PAIR, target, source), maps, points


def figure_2() -> Drawn:
    """From basis to map: one function, one descriptor, C and the map."""
    pair, _, maps, points = paper_maps()
    figure, axes = plt.subplots(1, 5, figsize=(15, 4.2))
    rows = pair.target.basis.at(2)
    triangles = level_triangles(pair.target.refinement, 2)
    positions = pair.target.refinement.levels[2].positions
    filters = choose_filters(pair.target.basis.eigenvalues, pair.source.basis.eigenvalues, 10, 20)
    spectrum = pair.target.basis.eigenvalues[: rows.shape[1]]
    kernel = rows @ landmark_descriptors(rows[pair.target_landmarks[:1]], filters.at(spectrum))[:, 3]
    for axis, values, title in ((axes[0], rows[:, 9], "(a) basis"), (axes[1], kernel, "(b) descriptors")):
        reach = np.abs(values).max()
        axis.imshow(picture(positions, triangles, scalar_colors(values, -reach, reach, BALANCE_SCALE)))
        axis.set_title(title)
    c = maps[-1].functional_map
    axes[2].imshow(c, cmap="RdBu", vmin=-1, vmax=1)
    axes[2].set_title("(c) functional map")
    for edge in np.cumsum(pair.target.basis.schedule)[:-1]:
        axes[2].axhline(edge, color="0.6", lw=0.5)
        axes[2].axvline(edge, color="0.6", lw=0.5)
    source, target = pair.source.refinement.finest, pair.target.refinement.finest
    colors = position_colors(source.positions, source.positions)
    top = level_triangles(pair.source.refinement, pair.source.finest)
    axes[3].imshow(picture(source.positions, top, colors))
    axes[3].set_title("source")
    top = level_triangles(pair.target.refinement, pair.target.finest)
    axes[4].imshow(picture(target.positions, top, points.pull_back(colors)))
    axes[4].set_title("(d) pulled back to the target")
    for axis in axes:
        axis.axis("off")
    return figure, f"male1591 receives from female1605 with {LANDMARKS} landmarks, schedule (100, 50, 50, 50)."


def figure_9() -> Drawn:
    """One match of level 0, and the only candidates that its children have on level 1."""
    pair, _, maps, _ = paper_maps()
    first = maps[0]
    x, height, depth = pair.target.control.positions.T
    vertex = int(np.argmax(depth - abs(height - np.median(height)) - abs(x)))  # on the belly, where the camera sees it
    match = int(first.match[vertex])
    column = pair.source.refinement.matrices[0][:, [match]].tocsc()
    candidates = column.indices
    figure, axes = plt.subplots(1, 3, figsize=(9, 4.4))
    panels = ((pair.target, 0, [vertex], "target, level 0"), (pair.source, 0, [match], "its match, level 0"),
              (pair.source, 1, candidates, f"{len(candidates)} candidates, level 1"))  # fmt: skip
    for axis, (surface, level, marked, title) in zip(axes, panels, strict=True):
        mesh = surface.refinement.levels[level]
        colors = np.full((mesh.n_vertices, 3), 0.8)
        colors[marked] = (0.85, 0.1, 0.1)
        axis.imshow(picture(mesh.positions, level_triangles(surface.refinement, level), colors))
        axis.set_title(title)
        axis.axis("off")
    counts = np.diff(pair.source.refinement.matrices[0].tocsc().indptr)
    return figure, (
        f"Non-zeros of a column of $S_2^0$: {counts.min()} to {counts.max()}, {counts.mean():.0f} on average. Ours takes those "
        "of every parent with at least half the largest weight in the row of $S_1^l$, a superset of the paper's."
    )


def figure_10() -> Drawn:
    """The map on every level, as colours of the source, with its error."""
    pair, known, maps, points = paper_maps()
    figure, axes = plt.subplots(1, len(maps) + 2, figsize=(2.6 * (len(maps) + 2), 4.2))
    source = pair.source.refinement.finest.positions
    colors = position_colors(source, source)
    axes[0].imshow(picture(source, level_triangles(pair.source.refinement, pair.source.finest), colors))
    axes[0].set_title("source")
    errors, flips = [], []
    for axis, found in zip(axes[1:], maps, strict=False):
        level = found.levels[0]
        mesh = pair.target.refinement.levels[level]
        shown = colors[found.match]
        axis.imshow(picture(mesh.positions, level_triangles(pair.target.refinement, level), shown))
        errors.append(known.error(known.places[found.match]))
        axis.set_title(f"l = {level}: {errors[-1]:.2f}")
    finest = pair.target.refinement.finest
    triangles = level_triangles(pair.target.refinement, pair.target.finest)
    axes[-1].imshow(picture(finest.positions, triangles, points.pull_back(colors)))
    errors.append(known.error(points.images.positions))
    axes[-1].set_title(f"refined: {errors[-1]:.2f}")
    for axis in axes:
        axis.axis("off")
    vertices = PointMap.from_vertices(points.target, points.source, maps[-1].match)
    for one in (vertices, points):
        flipped = flipped_triangles(one.images, one.target.triangles)
        flips.append(100 * float(one.target.areas[flipped].sum()))
    said = ", ".join(f"{error:.2f}" for error in errors)
    names = [f"level {found.levels[0]}" for found in maps] + ["refined"]
    worse = [name for name, (before, after) in zip(names[1:], pairwise(errors), strict=True) if after > before]
    but = f"it gets worse at: {', '.join(worse)}"
    return figure, (
        f"Mean error (x100 of sqrt(area)) on the levels and refined: {said}; {LANDMARKS} landmarks. Folded area of the finest "
        f"level: {flips[0]:.1f} % by vertices, {flips[1]:.1f} % refined. "
        f"{verdict(not worse, 'The map improves as the resolution increases', but)}."
    )
