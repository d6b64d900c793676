"""Pictures of the wrapped cage and of carried skinning weights, blend shapes, passengers and poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
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
    render,
    scalar_colors,
)
from cagemap.report.figures import PAPER
from cagemap.report.viewpoints import Seen, seen
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.closest_points import closest_points

_CLAY = np.array([0.86, 0.84, 0.80])
_WIRE = np.array([0.13, 0.28, 0.36])
# Shapes that a page shows; the largest ones.
_MOST_SHAPES = 4
_MOST_POSES = 4
# The colours of distances, and of offsets, end here: the rest of the surface is further, or moves more.
_SHOWN, _MOVED = 0.95, 0.995


@dataclass(frozen=True, eq=False)
class Weights:
    """Skinning weights at the control vertices of both, (n2, joints) and (n1, joints), rows summing to 1 or less."""

    source: FloatArray
    target: FloatArray


@dataclass(frozen=True, eq=False)
class CarriedShape:
    """Displacements of the control vertices of both, (n2, 3) and (n1, 3), in their own units."""

    name: str
    source: FloatArray
    target: FloatArray


@dataclass(frozen=True, eq=False)
class Passenger:
    """Clothes, hair or a prop: as it sits on the source, and as carried to the target, in their files' lengths."""

    name: str
    source: ControlMesh
    target: ControlMesh


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose: positions of the control vertices of both, (n2, 3) and (n1, 3), in their own units."""

    name: str
    source: FloatArray
    target: FloatArray


@dataclass(frozen=True, eq=False)
class CarriedData:
    """What a report shows beside the map.

    Attributes
    ----------
    wrapped : ControlMesh or None
        The target's cage, or the net of a finer level, in the source's shape.
    weights : Weights or None
    shapes : tuple of CarriedShape
    passengers : tuple of Passenger
    poses : tuple of Pose
    """

    wrapped: ControlMesh | None = None
    weights: Weights | None = None
    shapes: tuple[CarriedShape, ...] = field(default=())
    passengers: tuple[Passenger, ...] = field(default=())
    poses: tuple[Pose, ...] = field(default=())


NOTHING = CarriedData()


@dataclass(frozen=True)
class Panel:
    """A part of the page: pictures with captions, two in a row."""

    title: str
    lead: str
    pictures: tuple[tuple[Image, str], ...]


def draw_carried(
    result: MatchResult, carried: CarriedData, size: tuple[int, int], views: Seen | None = None
) -> tuple[Panel, ...]:
    """Draw the data that a map carried.

    Parameters
    ----------
    result : MatchResult
    carried : CarriedData
    size : (int, int)
        Of every picture.
    views : Seen, optional
        From where; by default as the target's shape shows.
    """
    panels, views = list[Panel](), views or seen(result)
    if carried.wrapped is not None:
        panels.append(_wrapped(result, carried.wrapped, views, size))
    if carried.weights is not None:
        panels.append(_weights(result, carried.weights, views, size))
    if carried.shapes:
        panels.append(_shapes(result, carried.shapes, views, size))
    if carried.passengers:
        panels.append(draw_passengers(result, carried.passengers, views, size))
    if carried.poses:
        panels.append(draw_poses(result, carried.poses, views, size))
    return tuple(panels)


def _wrapped(result: MatchResult, cage: ControlMesh, views: Seen, size: tuple[int, int]) -> Panel:
    """Source and wrapped surface with its net, how far apart they are, and the cages."""
    target, source = result.target.refinement, result.source.refinement
    fine = refined_wrap(target, cage)
    surface = result.point_map.source
    places = fine.finest.positions
    _, _, distance = closest_points(surface.tree, surface.scale * places)
    most = float(np.quantile(distance, _SHOWN))
    here, there = views.target.turn, views.source_turn
    own, other, before = _model(fine, there), _model(source, there), _model(target, here)
    colors = Skin(vertex_colors=scalar_colors(distance, 0.0, most))
    net, rest = control_edges(fine) @ there, control_edges(target) @ here
    flat = [
        Model(mesh.positions @ turn, cage_triangles(mesh)[0]) for mesh, turn in ((target.control, here), (cage, there))
    ]
    wires = [_edges(mesh) @ turn for mesh, turn in ((target.control, here), (cage, there))]
    jobs = []
    for view in (FRONT, BACK):
        jobs += [
            (other, Skin(), view, None, f"{source.control.name} (source), {view.name}"),
            (own, _clay(own), view, net, f"wrapped surface, the edges of the cage on it, {view.name}"),
        ]
    jobs += [
        (own, colors, FRONT, None, f"distance to the source: dark 0, yellow {100 * most:.2g} % of sqrt(area)"),
        (before, _clay(before), FRONT, rest, f"{target.control.name} (target) as it was"),
        (flat[1], _clay(flat[1]), FRONT, wires[1], "wrapped cage, not smoothed"),
        (flat[0], _clay(flat[0]), FRONT, wires[0], "target's cage, not smoothed"),
    ]
    lead = (
        "The target's cage in the source's shape. Edge loops should run as they did; the distance says where the cage "
        "has no room for what the source has."
    )
    return Panel("Wrapped", lead, tuple(_drawn(jobs, size)))


def _weights(result: MatchResult, weights: Weights, views: Seen, size: tuple[int, int]) -> Panel:
    """Every joint in a colour of its own; mixed where several hold a vertex."""
    target, source = result.target.refinement, result.source.refinement
    palette = distinct_colors(weights.source.shape[1])
    jobs = []
    for view in (FRONT, BACK):
        for refinement, values, turn, role in (
            (source, weights.source, views.source_turn, "source"),
            (target, weights.target, views.target.turn, "target"),
        ):
            mixed = values @ palette + (1.0 - values.sum(axis=1, keepdims=True)).clip(0.0) * _CLAY
            colors = refinement.prolong(mixed, 0, refinement.n_levels).clip(0.0, 1.0)
            caption = f"{refinement.control.name} ({role}), {view.name}"
            jobs.append((_model(refinement, turn), Skin(vertex_colors=colors), view, None, caption))
    lead = "A colour for every joint, mixed where several joints hold a vertex. Borders should lie at equal places."
    return Panel("Skinning weights", lead, tuple(_drawn(jobs, size)))


def _shapes(result: MatchResult, shapes: tuple[CarriedShape, ...], views: Seen, size: tuple[int, int]) -> Panel:
    """The largest shapes, on source and target."""
    target, source = result.target.refinement, result.source.refinement
    largest = sorted(shapes, key=lambda shape: -float(np.linalg.norm(shape.source, axis=1).max(initial=0.0)))
    jobs = []
    for shape in sorted(largest[:_MOST_SHAPES], key=lambda shape: shape.name):
        for refinement, offsets, turn, role in (
            (source, shape.source, views.source_turn, "source"),
            (target, shape.target, views.target.turn, "target"),
        ):
            moved = refinement.prolong(offsets, 0, refinement.n_levels)
            length = np.linalg.norm(moved, axis=1)
            moved_to = (refinement.finest.positions + moved) @ turn
            model = Model(moved_to, level_triangles(refinement, refinement.n_levels))
            share = (length / (float(np.quantile(length, _MOVED)) or 1.0)).clip(0.0, 1.0)[:, None]
            colors = (1.0 - share) * _CLAY + share * np.array([0.80, 0.36, 0.22])
            jobs.append((model, Skin(vertex_colors=colors), FRONT, None, f"{shape.name}, {role}"))
    lead = "The same shape on both, redder where it moves more."
    if len(shapes) > _MOST_SHAPES:
        lead += f" The largest {_MOST_SHAPES} of {len(shapes)}."
    return Panel("Blend shapes", lead, tuple(_drawn(jobs, size)))


def draw_passengers(result: MatchResult, passengers: Sequence[Passenger], views: Seen, size: tuple[int, int]) -> Panel:
    """Both bodies with what they wear, a colour for each passenger."""
    palette = distinct_colors(len(passengers))
    sides = (
        (result.source.refinement, [one.source for one in passengers], views.source_turn, "source"),
        (result.target.refinement, [one.target for one in passengers], views.target.turn, "target"),
    )
    jobs = []
    for view in (FRONT, BACK):
        for refinement, worn, turn, role in sides:
            whole = _model(refinement, turn)
            parts = [Model(mesh.positions @ turn, cage_triangles(mesh)[0]) for mesh in worn]
            colors = [np.broadcast_to(_CLAY, whole.positions.shape)]
            colors += [np.tile(color, (len(part.positions), 1)) for color, part in zip(palette, parts, strict=True)]
            skin = Skin(vertex_colors=np.concatenate(colors))
            jobs.append(
                (_joined([whole, *parts]), skin, view, None, f"{refinement.control.name} ({role}), {view.name}")
            )
    names = ", ".join(one.name for one in passengers)
    return Panel("Passengers", f"What the source wears, on the target: {names}.", tuple(_drawn(jobs, size)))


def draw_poses(result: MatchResult, poses: Sequence[Pose], views: Seen, size: tuple[int, int]) -> Panel:
    """Both models in every pose."""
    jobs = []
    for pose in poses[:_MOST_POSES]:
        for refinement, positions, turn, role in (
            (result.source.refinement, pose.source, views.source_turn, "source"),
            (result.target.refinement, pose.target, views.target.turn, "target"),
        ):
            moved = refinement.prolong(positions - refinement.control.positions, 0, refinement.n_levels)
            model = Model(
                (refinement.finest.positions + moved) @ turn, level_triangles(refinement, refinement.n_levels)
            )
            jobs.append((model, _clay(model), FRONT, None, f"{pose.name}, {role}"))
    lead = "The same poses on both. Joints should bend at equal places, without dents."
    if len(poses) > _MOST_POSES:
        lead += f" The first {_MOST_POSES} of {len(poses)}."
    return Panel("Poses", lead, tuple(_drawn(jobs, size)))


def _joined(models: Sequence[Model]) -> Model:
    """Several models as one."""
    first = np.cumsum([0, *(len(model.positions) for model in models[:-1])])
    triangles = [model.triangles + start for model, start in zip(models, first, strict=True)]
    return Model(np.concatenate([model.positions for model in models]), np.concatenate(triangles))


_Job = tuple[Model, Skin, View, FloatArray | None, str]


def _drawn(jobs: Sequence[_Job], size: tuple[int, int]) -> Iterator[tuple[Image, str]]:
    with ThreadPool(2) as pool:
        yield from zip(pool.map(partial(_draw, size=size), jobs), (job[4] for job in jobs), strict=True)


def _draw(job: _Job, size: tuple[int, int]) -> Image:
    model, skin, view, segments, _ = job
    camera = frame(model.positions, view, aspect=size[0] / size[1])
    image = render(model, skin, camera, width=size[0], height=size[1], background=PAPER)
    return image if segments is None else draw_segments(image, model, camera, segments, _WIRE)


def _clay(model: Model) -> Skin:
    return Skin(vertex_colors=np.broadcast_to(_CLAY, model.positions.shape))


def _model(refinement: Refinement, turn: FloatArray) -> Model:
    return Model(refinement.finest.positions @ turn, level_triangles(refinement, refinement.n_levels))


def refined_wrap(target: Refinement, cage: ControlMesh) -> Refinement:
    """The surface over a wrapped cage, as fine as the target's."""
    level = next(level for level in range(target.n_levels) if target.levels[level].n_vertices == cage.n_vertices)
    return refine(cage, target.n_levels - level, target.scheme)


def control_edges(refinement: Refinement) -> FloatArray:
    """(e, 2, 3) pieces of the control mesh's edges on the refined surface: finest edges between control faces."""
    level = refinement.finest
    faces = np.asarray(level.faces)
    edges, sides = _sides(faces)
    parents = np.where(sides >= 0, level.face_parents[np.maximum(sides, 0)], -1)
    return np.asarray(level.positions[edges[parents[:, 0] != parents[:, 1]]])


def _sides(faces: IndexArray) -> tuple[IndexArray, IndexArray]:
    """(e, 2) edges of triangles or quads, and (e, 2) faces on both sides, -1 where there is none."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(len(faces)), faces.shape[1])
    edges, which = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    sides = np.full((len(edges), 2), -1, dtype=np.int64)
    sides[which, 0] = owner
    sides[which[::-1], 1] = owner[::-1]
    sides[sides[:, 0] == sides[:, 1], 1] = -1
    return edges, sides


def _edges(mesh: ControlMesh) -> FloatArray:
    """(e, 2, 3) edges of a control mesh."""
    ends = np.stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]], axis=1)
    return np.asarray(mesh.positions[np.unique(np.sort(ends, axis=1), axis=0)])
