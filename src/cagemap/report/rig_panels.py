"""Pictures of baked images, the wrapped cage, and carried skinning weights, blend shapes, passengers and poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any, Generic, TypeVar

import numpy as np

from cagemap.maps.pair import refined_edges
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.topology import mesh_topology
from cagemap.mesh.udim import udim_origin
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool
from cagemap.pictures import (
    BACK,
    FRONT,
    Image,
    Model,
    Skin,
    View,
    distinct_colors,
    draw_segments,
    frame,
    render_skins,
    scalar_colors,
)
from cagemap.report.figures import BACKGROUND
from cagemap.report.viewpoints import Viewpoints, choose_viewpoints
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.closest_points import closest_points
from cagemap.transfer.textured_surface import TexturedSurface

CLAY = np.array([0.86, 0.84, 0.80])
WIRE_COLOR = np.array([0.13, 0.28, 0.36])
# Blend shapes (the largest) and poses (the first) with pictures.
MAX_PANEL_SHAPES = 4
MAX_PANEL_POSES = 4
MAX_LAYOUT_PIXELS = 512  # longest side of a baked image on the page
# Quantiles of distances and of offset lengths that get the last colour of the scale.
DISTANCE_QUANTILE, OFFSET_QUANTILE = 0.95, 0.995


_Value = TypeVar("_Value")


@dataclass(frozen=True, eq=False)
class Weights:
    """Skinning weights of the control vertices, (n2, joints) and (n1, joints); rows sum to at most 1."""

    source: FloatArray
    target: FloatArray


@dataclass(frozen=True, eq=False)
class CarriedItem(Generic[_Value]):
    """A blend shape, passenger or pose: on the source, and carried, in file units.

    Of shapes offsets (n, 3), of poses positions (n, 3) of the control vertices; of passengers meshes.
    """

    name: str
    source: _Value
    target: _Value


@dataclass(frozen=True, eq=False)
class BakedImage:
    """An image in a layout of the target."""

    name: str
    tiles: dict[int, FloatArray]  # (H, W, 3) sRGB in [0, 1] by UDIM number; 0 for a layout in the unit square
    control: ControlMesh  # the target's cage with the layout


@dataclass(frozen=True, eq=False)
class CarriedData:
    """Data carried by the map that a report shows."""

    images: tuple[BakedImage, ...] = ()
    wrapped: ControlMesh | None = None  # the target's cage, or the mesh of a finer level, in the source's shape
    weights: Weights | None = None
    shapes: tuple[CarriedItem[FloatArray], ...] = ()
    passengers: tuple[CarriedItem[ControlMesh], ...] = ()
    poses: tuple[CarriedItem[FloatArray], ...] = ()


NO_DATA = CarriedData()

# Model, skin, view, segments to draw on it, caption.
_PictureJob = tuple[Model, Skin, View, FloatArray | None, str]


@dataclass(frozen=True)
class Panel:
    """A section of the page: pictures with captions, two in a row."""

    title: str
    lead: str
    pictures: tuple[tuple[Image, str], ...]


def draw_carried(
    result: MatchResult, carried: CarriedData, size: tuple[int, int], viewpoints: Viewpoints | None = None
) -> tuple[Panel, ...]:
    """Draw the data that a map carried, one panel for each kind."""
    viewpoints = viewpoints or choose_viewpoints(result)
    kinds: tuple[tuple[Any, Callable[..., Panel]], ...] = (
        (carried.images, _images_panel),
        (carried.wrapped, _wrap_panel),
        (carried.weights, _weights_panel),
        (carried.shapes, _shapes_panel),
        (carried.passengers, _passengers_panel),
        (carried.poses, _poses_panel),
    )
    return tuple(draw(result, data, viewpoints, size) for data, draw in kinds if data not in (None, ()))


def _images_panel(
    result: MatchResult, images: tuple[BakedImage, ...], viewpoints: Viewpoints, size: tuple[int, int]
) -> Panel:
    """Every image in its layout, and on the target from the front."""
    model = _finest_model(result.target.refinement, viewpoints.target.turn)
    joined = [join_tiles(image.tiles) for image in images]
    jobs: list[_PictureJob] = []
    for image, (pixels, cells) in zip(images, joined, strict=True):
        finest = result.target.with_control(image.control).refinement.finest
        cage = finest.faces is None  # level 0 of a mesh of mixed polygons
        textured = TexturedSurface.of_mesh(image.control) if cage else TexturedSurface.from_level(finest)
        skin = Skin(texture=pixels, corner_uvs=textured.corner_uvs() / cells)
        jobs.append((model, skin, FRONT, None, f"{image.name}, on the target"))
    pictures = list[tuple[Image, str]]()
    for image, (pixels, _), on_target in zip(images, joined, _draw_all(jobs, size), strict=True):
        pictures += [(np.round(255 * pixels).astype(np.uint8), image.name), on_target]
    lead = "Every image in the target's layout and on it."
    if any("displacement" in image.name for image in images):
        lead += " Heights and offsets: darkest lowest, brightest highest."
    return Panel("Baked images", lead, tuple(pictures))


def join_tiles(tiles: dict[int, FloatArray]) -> tuple[FloatArray, IndexArray]:
    """One picture of all tiles, at most `MAX_LAYOUT_PIXELS` a side, and its (columns, rows) of tiles."""
    cells = {number: np.array(udim_origin(number), dtype=np.int64) for number in tiles}
    columns, rows = counts = np.max(list(cells.values()), axis=0) + 1
    height, width = np.max([pixels.shape[:2] for pixels in tiles.values()], axis=0)
    share = min(1.0, MAX_LAYOUT_PIXELS / max(columns * width, rows * height))
    height, width = max(1, int(height * share)), max(1, int(width * share))
    joined = np.ones((rows * height, columns * width, 3))
    for number, (column, row) in cells.items():
        top, left = (rows - 1 - row) * height, column * width
        joined[top : top + height, left : left + width] = shrink(tiles[number], height, width)
    return joined, counts


def shrink(pixels: FloatArray, height: int, width: int) -> FloatArray:
    """Image of another size: the mean of the texels of each pixel, or the nearest texel."""
    rows, columns = (
        np.arange(count) * side // count for count, side in zip((height, width), pixels.shape[:2], strict=True)
    )
    sums = np.add.reduceat(np.add.reduceat(pixels, rows, axis=0), columns, axis=1)
    heights = np.maximum(np.diff(rows, append=pixels.shape[0]), 1)
    widths = np.maximum(np.diff(columns, append=pixels.shape[1]), 1)
    return np.asarray(sums / (heights[:, None, None] * widths[:, None]))


def _wrap_panel(result: MatchResult, cage: ControlMesh, viewpoints: Viewpoints, size: tuple[int, int]) -> Panel:
    """Source, wrapped surface with the cage's edges, distance between both, and the cages."""
    target, source = result.target.refinement, result.source.refinement
    wrapped = refined_wrap(target, cage)
    surface = result.point_map.source
    _, _, distance = closest_points(surface.tree, surface.scale * wrapped.finest.positions)
    max_distance = float(np.quantile(distance, DISTANCE_QUANTILE))
    target_turn, source_turn = viewpoints.target.turn, viewpoints.source_turn
    wrapped_model, source_model = _finest_model(wrapped, source_turn), _finest_model(source, source_turn)
    target_model = _finest_model(target, target_turn)
    distance_skin = Skin(vertex_colors=scalar_colors(distance, 0.0, max_distance))
    wrapped_edges, target_edges = control_edges(wrapped) @ source_turn, control_edges(target) @ target_turn
    clay, caption = _clay_skin(wrapped_model), "wrapped surface, the edges of the cage on it"
    jobs: list[_PictureJob] = []
    for view in (FRONT, BACK):
        jobs.append((source_model, Skin(), view, None, f"{source.control.name} (source), {view.name}"))
        jobs.append((wrapped_model, clay, view, wrapped_edges, f"{caption}, {view.name}"))
    scale = f"distance to the source: dark 0, yellow {100 * max_distance:.2g} % of the model's size"
    jobs += [
        (wrapped_model, distance_skin, FRONT, None, scale),
        (target_model, _clay_skin(target_model), FRONT, target_edges, f"{target.control.name} (target) as it was"),
    ]
    for mesh, turn, caption in (
        (cage, source_turn, "wrapped cage, not smoothed"),
        (target.control, target_turn, "target's cage, not smoothed"),
    ):
        model = Model(mesh.positions @ turn, cage_triangles(mesh)[0])
        jobs.append((model, _clay_skin(model), FRONT, cage_edges(mesh) @ turn, caption))
    lead = (
        "The target's cage in the source's shape. Edge loops should run as they did; the distance says where the cage "
        "has no room for what the source has."
    )
    return Panel("Wrapped", lead, tuple(_draw_all(jobs, size)))


def _weights_panel(result: MatchResult, weights: Weights, viewpoints: Viewpoints, size: tuple[int, int]) -> Panel:
    """Skinning weights as colours, from the front and from behind."""
    jobs: list[_PictureJob] = []
    for view in (FRONT, BACK):
        for refinement, values, turn, side in _both_sides(result, viewpoints, weights.source, weights.target):
            colors = refinement.prolong(joint_colors(values), 0, refinement.finest_level).clip(0.0, 1.0)
            caption = f"{refinement.control.name} ({side}), {view.name}"
            jobs.append((_finest_model(refinement, turn), Skin(vertex_colors=colors), view, None, caption))
    lead = "A colour for every joint, mixed where several joints hold a vertex. Borders should lie at equal places."
    return Panel("Skinning weights", lead, tuple(_draw_all(jobs, size)))


def _shapes_panel(
    result: MatchResult, shapes: tuple[CarriedItem[FloatArray], ...], viewpoints: Viewpoints, size: tuple[int, int]
) -> Panel:
    """The largest shapes on both models, coloured by the length of the offsets."""
    largest = sorted(shapes, key=lambda shape: -float(np.linalg.norm(shape.source, axis=1).max(initial=0.0)))
    jobs: list[_PictureJob] = []
    for shape in sorted(largest[:MAX_PANEL_SHAPES], key=lambda shape: shape.name):
        for refinement, offsets, turn, side in _both_sides(result, viewpoints, shape.source, shape.target):
            finest_offsets = refinement.prolong(offsets, 0, refinement.finest_level)
            length = np.linalg.norm(finest_offsets, axis=1)
            share = (length / (float(np.quantile(length, OFFSET_QUANTILE)) or 1.0)).clip(0.0, 1.0)[:, None]
            colors = (1.0 - share) * CLAY + share * np.array([0.80, 0.36, 0.22])
            model = _finest_model(refinement, turn, finest_offsets)
            jobs.append((model, Skin(vertex_colors=colors), FRONT, None, f"{shape.name}, {side}"))
    lead = "The same shape on both, redder where it moves more."
    if len(shapes) > MAX_PANEL_SHAPES:
        lead += f" The largest {MAX_PANEL_SHAPES} of {len(shapes)}."
    return Panel("Blend shapes", lead, tuple(_draw_all(jobs, size)))


def _passengers_panel(
    result: MatchResult, passengers: Sequence[CarriedItem[ControlMesh]], viewpoints: Viewpoints, size: tuple[int, int]
) -> Panel:
    """Both bodies with their passengers, a colour for each."""
    palette = distinct_colors(len(passengers))
    meshes = [passenger.source for passenger in passengers], [passenger.target for passenger in passengers]
    jobs: list[_PictureJob] = []
    for view in (FRONT, BACK):
        for refinement, worn, turn, side in _both_sides(result, viewpoints, *meshes):
            body = _finest_model(refinement, turn)
            parts = [Model(mesh.positions @ turn, cage_triangles(mesh)[0]) for mesh in worn]
            colors = [np.broadcast_to(CLAY, body.positions.shape)]
            colors += [np.tile(color, (len(part.positions), 1)) for color, part in zip(palette, parts, strict=True)]
            skin = Skin(vertex_colors=np.concatenate(colors))
            caption = f"{refinement.control.name} ({side}), {view.name}"
            jobs.append((_join_models([body, *parts]), skin, view, None, caption))
    names = ", ".join(passenger.name for passenger in passengers)
    return Panel("Passengers", f"What the source wears, on the target: {names}.", tuple(_draw_all(jobs, size)))


def _poses_panel(
    result: MatchResult, poses: Sequence[CarriedItem[FloatArray]], viewpoints: Viewpoints, size: tuple[int, int]
) -> Panel:
    """Both models in the first poses."""
    jobs: list[_PictureJob] = []
    for pose in poses[:MAX_PANEL_POSES]:
        for refinement, positions, turn, side in _both_sides(result, viewpoints, pose.source, pose.target):
            offsets = refinement.prolong(positions - refinement.control.positions, 0, refinement.finest_level)
            model = _finest_model(refinement, turn, offsets)
            jobs.append((model, _clay_skin(model), FRONT, None, f"{pose.name}, {side}"))
    lead = "The same poses on both. Joints should bend at equal places, without dents."
    if len(poses) > MAX_PANEL_POSES:
        lead += f" The first {MAX_PANEL_POSES} of {len(poses)}."
    return Panel("Poses", lead, tuple(_draw_all(jobs, size)))


def _both_sides(
    result: MatchResult, viewpoints: Viewpoints, source: _Value, target: _Value
) -> Iterator[tuple[Refinement, _Value, FloatArray, str]]:
    """Refinement, value, rotation and name of the source, then of the target."""
    yield result.source.refinement, source, viewpoints.source_turn, "source"
    yield result.target.refinement, target, viewpoints.target.turn, "target"


def joint_colors(weights: FloatArray) -> FloatArray:
    """(n, 3) joint colours mixed by skinning weights (n, joints); clay fills sums below 1."""
    palette = distinct_colors(weights.shape[1])
    return np.asarray(weights @ palette + (1.0 - weights.sum(axis=1, keepdims=True)).clip(0.0) * CLAY)


def _join_models(models: Sequence[Model]) -> Model:
    """One model of several."""
    first = np.cumsum([0, *(len(model.positions) for model in models[:-1])])
    triangles = [model.triangles + start for model, start in zip(models, first, strict=True)]
    return Model(np.concatenate([model.positions for model in models]), np.concatenate(triangles))


def _draw_all(jobs: Sequence[_PictureJob], size: tuple[int, int]) -> Iterator[tuple[Image, str]]:
    """Draw pictures with their captions; consecutive ones of one model in one view together."""
    groups = [list(group) for _, group in groupby(jobs, key=lambda job: (id(job[0]), job[2]))]
    with ThreadPool(2) as pool:
        for group, images in zip(groups, pool.map(partial(_draw, size=size), groups), strict=True):
            yield from zip(images, (job[4] for job in group), strict=True)


def _draw(group: Sequence[_PictureJob], size: tuple[int, int]) -> list[Image]:
    model, _, view, *_ = group[0]
    camera = frame(model.positions, view, aspect=size[0] / size[1])
    images = render_skins(model, [job[1] for job in group], camera, size, background=BACKGROUND)
    return [
        image if segments is None else draw_segments(image, model, camera, segments, WIRE_COLOR)
        for image, (_, _, _, segments, _) in zip(images, group, strict=True)
    ]


def _clay_skin(model: Model) -> Skin:
    return Skin(vertex_colors=np.broadcast_to(CLAY, model.positions.shape))


def _finest_model(refinement: Refinement, turn: FloatArray, offsets: FloatArray | float = 0.0) -> Model:
    """The finest level, with offsets of its vertices, rotated."""
    positions = (refinement.finest.positions + offsets) @ turn
    return Model(positions, level_triangles(refinement, refinement.finest_level))


def refined_wrap(target: Refinement, cage: ControlMesh) -> Refinement:
    """The wrapped cage refined to the target's finest level."""
    level = [level.n_vertices for level in target.levels].index(cage.n_vertices)
    return refine(cage, target.finest_level - level, target.scheme)


def control_edges(refinement: Refinement) -> FloatArray:
    """(e, 2, 3) edges of the finest level that lie on edges of the control mesh."""
    chains = refined_edges(refinement, mesh_topology(refinement.control).edge_vertices, refinement.finest_level)
    ends = np.stack([chains[:, :-1], chains[:, 1:]], axis=2).reshape(-1, 2)
    return np.asarray(refinement.finest.positions[ends])


def cage_edges(mesh: ControlMesh) -> FloatArray:
    """(e, 2, 3) edges of a control mesh."""
    return np.asarray(mesh.positions[mesh_topology(mesh).edge_vertices])
