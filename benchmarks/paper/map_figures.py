"""Figs. 1, 2, 9 and 10: a texture, the pipeline, the candidates, the map of every level."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper.data import PAIR, Judged, color_scale, picture, prepared, verdict, with_landmarks
from cagemap.example import example_pair
from cagemap.files.images.image import Pixels
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import flipped_triangles
from cagemap.maps.result import LevelMap
from cagemap.paper.constraints import choose_filters, landmark_descriptors
from cagemap.paper.method import paper_map
from cagemap.pictures import (
    AMOUNT_SCALE,
    BALANCE_SCALE,
    FRONT,
    Camera,
    Image,
    Model,
    Skin,
    distinct_colors,
    draw_dots,
    draw_segments,
    frame,
    position_colors,
    render,
    scalar_colors,
)
from cagemap.pipeline import MatchConfig, default_basis, match, prepare_surface
from cagemap.report.figures import display_image
from cagemap.report.rig_panels import control_edges
from cagemap.spectral import Surface
from cagemap.subdivision import level_triangles
from cagemap.transfer import bake
from cagemap.transfer.textured_surface import TexturedSurface

Drawn = tuple[Figure, str]
LANDMARKS = 30
# Error that has the last colour of Fig. 10, % of sqrt(area).
LARGEST_ERROR = 6.0
FIG_1_LEVEL = 3
# Side of a panel of Fig. 1, pixels: 300 to an inch.
FIG_1_PANEL = 780


@cache
def paper_maps() -> tuple[Pair, Judged, tuple[LevelMap, ...], PointMap]:
    """The paper's method on the pair of the bars, (100, 50, 50, 50)."""
    target, source = prepared("male1591_female_old_heavy", 3), prepared("female1605_male_young", 3)
    pair = with_landmarks(target, source, LANDMARKS)
    maps, points = paper_map(pair)
    return pair, Judged.of(PAIR, target, source), maps, points


def figure_1() -> Drawn:
    """Control meshes with landmarks, and a texture that two methods carry from one surface to the other."""
    example = example_pair()
    meshes = example.target, example.source
    sides = {
        method: [prepare_surface(mesh, FIG_1_LEVEL, default_basis(method, FIG_1_LEVEL)) for mesh in meshes]
        for method in ("paper", "hfm")
    }
    figure, axes = plt.subplots(1, 5, figsize=(13, 3.2))
    target, source = sides["paper"]
    colors = distinct_colors(len(example.landmarks.names))
    for axis, side, vertices, name in (
        (axes[0], source, example.landmarks.source, "source, landmarks"),
        (axes[1], target, example.landmarks.target, "target, landmarks"),
    ):
        model, camera = textured_model(side)
        image = render(model, Skin(), camera, width=FIG_1_PANEL, height=FIG_1_PANEL)
        image = draw_segments(image, model, camera, control_edges(side.refinement), np.full(3, 0.45))
        places = side.refinement.finest.positions[vertices]
        axis.imshow(draw_dots(image, model, camera, places, colors, radius=9))
        axis.set_title(name)
    axes[2].imshow(textured_picture(source, example.texture))
    axes[2].set_title("source, texture")
    said = []
    for axis, (method, (target, source)) in zip(axes[3:], sides.items(), strict=True):
        found = match(target, source, example.landmarks, MatchConfig(method=method))
        axis.imshow(textured_picture(target, bake(found, example.texture, size=len(example.texture))))
        axis.set_title(f"target, {method}")
        missed = 100.0 * found.quality.landmark_errors
        said.append(
            f"`{method}` folds {100.0 * found.quality.flipped_area:.1f} % of the area and misses landmarks by "
            f"{missed.mean():.1f} on average, {missed.max():.1f} at most"
        )
    for axis in axes:
        axis.axis("off")
    sizes = [side.refinement.finest.n_vertices // 1000 for side in sides["paper"]]
    return figure, (
        f"The built-in pair: the deer ({sizes[0]}k vertices at level {FIG_1_LEVEL}) receives from the pony ({sizes[1]}k), "
        f"{len(colors)} landmarks, default bases. {'; '.join(said)} (x100 of sqrt(area)). The paper's tiger and cat are not "
        "published."
    )


def textured_model(side: Surface) -> tuple[Model, Camera]:
    """Finest surface of a side in the lengths of its file, and a camera for a square panel."""
    surface = TexturedSurface.from_level(side.refinement.finest)
    return Model(surface.positions, surface.triangles), frame(surface.positions, FRONT, aspect=1.0)


def textured_picture(side: Surface, texture: Pixels) -> Image:
    """The finest surface of a side with an image over its UVs."""
    model, camera = textured_model(side)
    corners = TexturedSurface.from_level(side.refinement.finest).corner_uvs()
    skin = Skin(texture=display_image(texture), corner_uvs=corners)
    return render(model, skin, camera, width=FIG_1_PANEL, height=FIG_1_PANEL, samples=3)


def figure_2() -> Drawn:
    """From basis to map: one function, one descriptor, C and the map."""
    pair, _, maps, points = paper_maps()
    figure, axes = plt.subplots(1, 5, figsize=(17, 4.2))
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
        color_scale(axis, BALANCE_SCALE, -1.0, 1.0, "value / largest one")
    c = maps[-1].functional_map
    entries = axes[2].imshow(c, cmap="RdBu", vmin=-1, vmax=1)
    axes[2].set(title="(c) functional map", xlabel="source function", ylabel="target function")
    figure.colorbar(entries, ax=axes[2], shrink=0.6, label="entry of C")
    for edge in np.cumsum(pair.target.basis.schedule)[:-1]:
        axes[2].axhline(edge, color="0.6", lw=0.5)
        axes[2].axvline(edge, color="0.6", lw=0.5)
    source, target = pair.source.refinement.finest, pair.target.refinement.finest
    colors = position_colors(source.positions, source.positions)
    top = level_triangles(pair.source.refinement, pair.source.finest_level)
    axes[3].imshow(picture(source.positions, top, colors))
    axes[3].set_title("source")
    top = level_triangles(pair.target.refinement, pair.target.finest_level)
    axes[4].imshow(picture(target.positions, top, points.pull_back(colors)))
    axes[4].set_title("(d) pulled back to the target")
    for axis in axes[[0, 1, 3, 4]]:
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
    """The map on every level as colours of the source, above its error."""
    pair, known, maps, points = paper_maps()
    figure, axes = plt.subplots(2, len(maps) + 2, figsize=(2.4 * (len(maps) + 2), 7.4))
    source = pair.source.refinement.finest.positions
    colors = position_colors(source, source)
    axes[0, 0].imshow(picture(source, level_triangles(pair.source.refinement, pair.source.finest_level), colors))
    axes[0, 0].set_title("source")
    shown = [
        (f"l = {found.levels[0]}", found.levels[0], colors[found.match], known.places[found.match]) for found in maps
    ]
    shown.append(("refined", pair.target.finest_level, points.pull_back(colors), points.images.positions))
    means = []
    for (above, below), (name, level, carried, images) in zip(axes[:, 1:].T, shown, strict=True):
        mesh, triangles = pair.target.refinement.levels[level], level_triangles(pair.target.refinement, level)
        means.append(known.error(images))
        above.imshow(picture(mesh.positions, triangles, carried))
        above.set_title(f"{name}: {means[-1]:.2f}")
        below.imshow(picture(mesh.positions, triangles, scalar_colors(known.errors(images), 0.0, LARGEST_ERROR)))
    for axis in axes.ravel():
        axis.axis("off")
    color_scale(axes[1, 0], AMOUNT_SCALE, 0.0, LARGEST_ERROR, "error, % of sqrt(area)")
    vertices = PointMap.from_vertices(points.target, points.source, maps[-1].match)
    flips = [folded(one) for one in (vertices, points)]
    said = ", ".join(f"{mean:.2f}" for mean in means)
    names = [f"level {found.levels[0]}" for found in maps] + ["refined"]
    worse = [name for name, (before, after) in zip(names[1:], pairwise(means), strict=True) if after > before]
    but = f"it gets worse at: {', '.join(worse)}"
    return figure, (
        f"Mean error (x100 of sqrt(area)) on the levels and refined: {said}; {LANDMARKS} landmarks. Below, the error of every "
        f"vertex; grey where the truth is not known. Folded area of the finest level: {flips[0]:.1f} % by vertices, "
        f"{flips[1]:.1f} % refined. {verdict(not worse, 'The map improves as the resolution increases', but)}."
    )


def folded(found: PointMap) -> float:
    """Folded area of a map, percent."""
    return 100.0 * float(found.target.areas[flipped_triangles(found.images, found.target.triangles)].sum())
