"""What the computation has given so far: the models and the map between them, for clicks, probes and proposals."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from cagemap.mesh.landmarks import CagePoints
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.studio.file_parts import NOTHING, Offer
from cagemap.studio.landmarks import LandmarkList, Place, Proposal, Side, mirror, other
from cagemap.studio.places import place_at, places_of
from cagemap.studio.shape import Hit, Shape
from cagemap.studio.skins import Images, faced
from cagemap.studio.state import Probe
from cagemap.surface.closest_points import build_tree, closest_points

# A mirror image this close to the place itself, of the model's radius, is the same place.
_ON_PLANE = 0.01
# A landmark so close, of the model's radius, has the place of a counterpart.
_TAKEN = 0.03


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
    offers : two Offer
        Parts of their files.
    dense : two bool
        Whether a model is subdivided although it looks like a scan.
    colored : bool
        Whether the source's materials have colours.
    """

    target: Shape
    source: Shape
    mirrors: tuple[IndexArray | None, IndexArray | None]
    skins: tuple[bytes, bytes]
    images: Images | None = None
    offers: tuple[Offer, Offer] = (NOTHING, NOTHING)
    dense: tuple[bool, bool] = (False, False)
    colored: bool = False

    def shape(self, side: Side) -> Shape:
        """One of the models."""
        return self.target if side == "target" else self.source

    @property
    def faced(self) -> Shape:
        """The source as it is drawn beside the target: turned to face as that does."""
        return faced(self.source, self.target, self.images)

    @property
    def symmetric(self) -> bool:
        """Whether both models have a mirror plane."""
        return all(mirror is not None for mirror in self.mirrors)

    @property
    def leaves_any(self) -> bool:
        """Whether a file has parts that are not open."""
        return any(shape.leaves_any for shape in (self.target, self.source))

    def warm(self) -> None:
        """Work out ahead, in a thread of its own, what the first click asks for."""

        def work() -> None:
            for shape in (self.target, self.source):
                place_at(shape, shape.positions[0])

        threading.Thread(target=work, name="studio warm-up", daemon=True).start()


def carried(scene: Scene, side: Side, position: FloatArray) -> Hit | None:
    """Where the map takes a point of one model, in file units, on the other; None without a map.

    From the source the map is followed backwards: to the target's point whose image is nearest.
    """
    images = scene.images
    if images is None:
        return None
    if side == "target":
        held = _nearest(scene.target.positions, scene.target.triangles, position)
        corners = scene.target.triangles[held.triangle]
        places = scene.source.positions[scene.source.triangles[images.triangle[corners]]]
        image = held.barycentric @ np.einsum("kc,kcd->kd", images.barycentric[corners], places)
        return _nearest(scene.source.positions, scene.source.triangles, image)
    places = images.on(scene.source.triangles, scene.source.positions)
    held = _nearest(places, scene.target.triangles, position)
    corners = scene.target.triangles[held.triangle]
    return Hit(held.triangle, held.barycentric, held.barycentric @ scene.target.positions[corners])


def carried_place(scene: Scene, side: Side, place: Place) -> Place | None:
    """Place on the other model that the map proposes for a place."""
    hit = carried(scene, side, np.array(place.position))
    return None if hit is None else place_at(scene.shape(other(side)), hit.position)


def proposed(scene: Scene | None, landmarks: LandmarkList) -> Proposal | None:
    """What the map proposes for the landmark that waits for its other place."""
    waiting = landmarks.open
    if waiting is None or scene is None:
        return None
    missing: Side = "source" if waiting.source is None else "target"
    given = waiting.on(other(missing))
    place = None if given is None else carried_place(scene, other(missing), given)
    return None if place is None else Proposal(waiting.number, missing, place)


def probed(scene: Scene, side: Side, hit: Hit) -> Probe:
    """Where the map takes a hit on one model, and the names of the parts at both ends."""
    there = carried(scene, side, hit.position)
    here = _tuple(hit.position)
    names = [part_name(scene.shape(side), hit.triangle)]
    if there is not None:
        names.append(part_name(scene.shape(other(side)), there.triangle))
    text = " \u2192 ".join(name for name in names if name)
    across = None if there is None else _tuple(there.position)
    return Probe(here, across, text) if side == "target" else Probe(across, here, text)


def part_name(shape: Shape, triangle: int) -> str:
    """Name of the part that a triangle belongs to, object, group and material; empty where parts have no names."""
    mesh, face = shape.control, int(shape.faces[triangle])
    partitions = (
        (mesh.face_objects, mesh.object_names),
        (mesh.face_groups, mesh.group_names),
        (mesh.face_materials, mesh.material_names),
    )
    found = [names[numbers[face]] for numbers, names in partitions if numbers is not None and numbers[face] >= 0]
    return ", ".join(dict.fromkeys(name for name in found if name))


def mirrored(scene: Scene, side: Side, place: Place) -> Place | None:
    """Mirror image of a place on its model; None on the mirror plane, or where the model has none."""
    shape = scene.shape(side)
    mirror = scene.mirrors[0 if side == "target" else 1]
    if mirror is None:
        return None
    image = places_of(shape, CagePoints(mirror[np.array([place.corners])], np.array([place.weights])))[0]
    apart = np.linalg.norm(np.array(image.position) - np.array(place.position))
    return None if apart < _ON_PLANE * shape.radius else image


def with_counterpart(scene: Scene, before: LandmarkList, after: LandmarkList) -> LandmarkList:
    """Landmarks, with the mirror image of the one that was just completed, unless another one is there."""

    def taken(side: Side, one: Place, other: Place) -> bool:
        apart = np.linalg.norm(np.array(one.position) - np.array(other.position))
        return bool(apart < _TAKEN * scene.shape(side).radius)

    placed = before.open
    if placed is None or after.open is not None or len(after) != len(before):
        return after
    return mirror(after, placed.number, lambda side, place: mirrored(scene, side, place), taken)


def _nearest(positions: FloatArray, triangles: IndexArray, position: FloatArray) -> Hit:
    """Point of a surface nearest to a position, in the triangles around the nearest vertex."""
    vertex = int(np.argmin(np.linalg.norm(positions - position, axis=1)))
    around = np.flatnonzero((triangles == vertex).any(axis=1))
    tree = build_tree(positions, triangles[around])
    held, barycentric, _ = closest_points(tree, np.asarray(position, dtype=np.float64)[None])
    triangle = int(around[held[0]])
    return Hit(triangle, barycentric[0], barycentric[0] @ positions[triangles[triangle]])


def _tuple(point: FloatArray) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z
