"""What the computation has given so far: the models and the map between them, for clicks, probes and proposals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.studio.landmarks import Place, Side
from cagemap.studio.shape import Hit, Shape, nearest_vertex, vertex_place
from cagemap.studio.skins import Images
from cagemap.studio.state import Probe

# A mirror image this close to the place itself, of the model's radius, is the same place.
_ON_PLANE = 0.01
# What a place counts that the map has no doubt about, beside one that it has every doubt about.
_SOME_DOUBT = 0.3


@dataclass(frozen=True, eq=False)
class Scene:
    """Models, their skins and the map.

    Attributes
    ----------
    target, source : Shape
    mirrors : two (n_control,) arrays or None
        Control vertex across the mirror plane, per side.
    images : Images or None
        The map.
    skins : two bytes
        Binary glTF files of target and source.
    """

    target: Shape
    source: Shape
    mirrors: tuple[IndexArray | None, IndexArray | None]
    skins: tuple[bytes, bytes]
    images: Images | None = None

    def shape(self, side: Side) -> Shape:
        """One of the models."""
        return self.target if side == "target" else self.source


def carried(scene: Scene, side: Side, position: FloatArray) -> FloatArray | None:
    """Where the map takes a point of one model on the other, in file units; None without a map.

    From the source the map is followed backwards: to the target vertex whose image is nearest.
    """
    if scene.images is None:
        return None
    if side == "target":
        hit = _nearest_hit(scene.target, position)
        corners = scene.target.triangles[hit.triangle]
        images = scene.images
        places = np.einsum(
            "kc,kcd->kd", images.barycentric[corners], _corner_positions(scene.source, images.triangle[corners])
        )
        return np.asarray(hit.barycentric @ places)
    places = scene.images.on(scene.source.triangles, scene.source.positions)
    return np.asarray(scene.target.positions[np.argmin(np.linalg.norm(places - position, axis=1))])


def carried_place(scene: Scene, side: Side, place: Place) -> Place | None:
    """Place on the other model that the map proposes for a place."""
    position = carried(scene, side, np.array(place.position))
    if position is None:
        return None
    other = scene.source if side == "target" else scene.target
    x, y, z = other.positions[nearest_vertex(other, position)].tolist() if side == "target" else position.tolist()
    return Place((x, y, z))


def next_place(scene: Scene, taken: tuple[Place, ...]) -> Place | None:
    """Place on the target where one more landmark tells most: far from all others, rather where the map is in doubt.

    Parameters
    ----------
    taken : tuple of Place
        Landmarks on the target.
    """
    if scene.images is None:
        return None
    shape = scene.target
    points = shape.positions[: shape.n_control]
    doubt = 1.0 - scene.images.trust[: shape.n_control]
    away = np.full(len(points), shape.radius)
    for place in taken:
        away = np.minimum(away, np.linalg.norm(points - np.array(place.position), axis=1))
    best = int(np.argmax(away * (_SOME_DOUBT + doubt)))
    return None if away[best] == 0 else vertex_place(shape, best)


def probed(scene: Scene, side: Side, hit: Hit) -> Probe:
    """Where the map takes a hit on one model, and the names of the parts at both ends."""
    there = carried(scene, side, hit.position)
    here = _tuple(hit.position)
    other = scene.source if side == "target" else scene.target
    names = [part_name(scene.shape(side), hit.triangle)]
    if there is not None:
        names.append(part_name(other, int(np.flatnonzero((other.triangles == nearest_vertex(other, there)).any(1))[0])))
    text = " \u2192 ".join(name for name in names if name)
    across = None if there is None else _tuple(there)
    return Probe(here, across, text) if side == "target" else Probe(across, here, text)


def part_name(shape: Shape, triangle: int) -> str:
    """Name of the part that a triangle belongs to; empty where parts have no names."""
    if shape.face_parts is None or not shape.parts:
        return ""
    part = int(shape.face_parts[shape.faces[triangle]])
    return shape.parts[part] if 0 <= part < len(shape.parts) else ""


def _tuple(point: FloatArray) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z


def mirrored(scene: Scene, side: Side, place: Place) -> Place | None:
    """Mirror image of a place on its model; None on the mirror plane, or where the model has none."""
    shape = scene.shape(side)
    mirror = scene.mirrors[0 if side == "target" else 1]
    if mirror is None:
        return None
    if place.vertex is not None:
        across = int(mirror[place.vertex])
        return None if across == place.vertex else vertex_place(shape, across)
    points = shape.positions[: shape.n_control]
    apart = np.linalg.norm(points - points[mirror], axis=1)
    far = int(np.argmax(apart))
    normal = (points[far] - points[mirror[far]]) / apart[far]
    middle = 0.5 * (points[far] + points[mirror[far]])
    position = np.array(place.position)
    image = position - 2 * float((position - middle) @ normal) * normal
    if np.linalg.norm(image - position) < _ON_PLANE * shape.radius:
        return None
    x, y, z = shape.positions[nearest_vertex(shape, image)].tolist()
    return Place((x, y, z))


def _corner_positions(shape: Shape, triangles: IndexArray) -> FloatArray:
    return np.asarray(shape.positions[shape.triangles[triangles]])


def _nearest_hit(shape: Shape, position: FloatArray) -> Hit:
    """Point of a shape nearest to a position, in the triangles around the nearest vertex."""
    vertex = nearest_vertex(shape, position)
    around = np.flatnonzero((shape.triangles == vertex).any(axis=1))
    weights = np.array([_clamped_barycentric(shape.positions[shape.triangles[t]], position) for t in around])
    points = np.einsum("tk,tkd->td", weights, shape.positions[shape.triangles[around]])
    best = int(np.argmin(np.linalg.norm(points - position, axis=1)))
    return Hit(int(around[best]), weights[best], points[best])


def _clamped_barycentric(corners: FloatArray, position: FloatArray) -> FloatArray:
    """Barycentric coordinates of a point in a triangle, pushed inside."""
    a, b, c = corners
    solution, *_ = np.linalg.lstsq(np.column_stack([b - a, c - a]), position - a, rcond=None)
    weights = np.clip(np.array([1 - solution.sum(), *solution]), 0.0, 1.0)
    return np.asarray(weights / weights.sum())
