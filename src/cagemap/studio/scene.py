"""The open models with the current map: images of points, proposals and mirror images."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

import numpy as np

from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.studio.file_parts import NO_PARTS, PartChoices
from cagemap.studio.landmarks import LandmarkList, Place, Proposal, Side, SideNames, mirror, opposite_side
from cagemap.studio.places import cage_places, nearest_place
from cagemap.studio.shape import Hit, Shape
from cagemap.studio.skins import PreviewMap, align_facing
from cagemap.studio.state import Probe
from cagemap.surface.closest_points import build_tree, closest_points

# Distances, in units of the model's radius, below which a place is on the mirror plane, or two places are the same.
_MIRROR_PLANE_DISTANCE = 0.01
_SAME_PLACE_DISTANCE = 0.03


@dataclass(frozen=True, eq=False)
class Scene:
    """The open models, the map between them, and both as the page draws them."""

    target: Shape
    source: Shape
    mirrors: tuple[IndexArray | None, IndexArray | None]  # (n_control,) mirror images of control vertices
    skins: tuple[bytes, bytes]  # binary glTF files of target and source
    preview_map: PreviewMap | None = None
    part_choices: tuple[PartChoices, PartChoices] = (NO_PARTS, NO_PARTS)  # parts of both files
    dense: tuple[bool, bool] = (False, False)  # whether a model is subdivided although it looks like a scan
    has_colors: bool = False  # whether the source's materials have colours

    def shape(self, side: Side) -> Shape:
        """One of the models."""
        return self.target if side == "target" else self.source

    @property
    def aligned_source(self) -> Shape:
        """The source, rotated in the view to face as the target does."""
        return align_facing(self.source, self.target, self.preview_map)

    def turned(self, ups: SideNames) -> Scene:
        """The scene with other axes of the files up; see `cagemap.studio.state.Files`."""
        scene = replace(self, target=self.target.with_up(ups[0]), source=self.source.with_up(ups[1]))
        return replace(scene, source=scene.aligned_source)

    def warm_up(self) -> None:
        """Compile and compute what the first click needs, in a thread."""

        def work() -> None:
            for shape in (self.target, self.source):
                nearest_place(shape, shape.positions[0])

        threading.Thread(target=work, name="studio warm-up", daemon=True).start()


def map_point(scene: Scene, side: Side, position: FloatArray) -> Hit | None:
    """Image of a model's point, in file units, on the other; None without map.

    The image of a source point is the target point whose own image is nearest.
    """
    preview_map, target, source = scene.preview_map, scene.target, scene.source
    if preview_map is None:
        return None
    if side == "target":
        start = _nearest_point(target.positions, target.triangles, position)
        corners = target.triangles[start.triangle]
        triangle_positions = source.positions[source.triangles[preview_map.triangle[corners]]]
        image = start.barycentric @ np.einsum("kc,kcd->kd", preview_map.barycentric[corners], triangle_positions)
        return _nearest_point(source.positions, source.triangles, image)
    images = preview_map.pull_back(source.triangles, source.positions)
    nearest = _nearest_point(images, target.triangles, position)
    corners = target.triangles[nearest.triangle]
    return Hit(nearest.triangle, nearest.barycentric, nearest.barycentric @ target.positions[corners])


def map_place(scene: Scene, side: Side, place: Place) -> Place | None:
    """Image of a place on the other model; None without a map."""
    hit = map_point(scene, side, np.array(place.position))
    return None if hit is None else nearest_place(scene.shape(opposite_side(side)), hit.position)


def propose_place(scene: Scene | None, landmarks: LandmarkList) -> Proposal | None:
    """Place that the map proposes to complete the open landmark."""
    landmark = landmarks.open_landmark
    if landmark is None or scene is None:
        return None
    missing: Side = "source" if landmark.source is None else "target"
    given = landmark.place_on(opposite_side(missing))
    place = None if given is None else map_place(scene, opposite_side(missing), given)
    return None if place is None else Proposal(landmark.number, missing, place)


def probe_map(scene: Scene, side: Side, hit: Hit) -> Probe:
    """A clicked point, its image and the names of both parts."""
    image = map_point(scene, side, hit.position)
    names = [part_name(scene.shape(side), hit.triangle)]
    if image is not None:
        names.append(part_name(scene.shape(opposite_side(side)), image.triangle))
    text = " \u2192 ".join(name for name in names if name)
    point, image_point = _as_tuple(hit.position), None if image is None else _as_tuple(image.position)
    return Probe(point, image_point, text) if side == "target" else Probe(image_point, point, text)


def part_name(shape: Shape, triangle: int) -> str:
    """Names of a triangle's object, group and material, with commas; empty if it has none."""
    mesh, face = shape.control, int(shape.faces[triangle])
    partitions = (
        (mesh.face_objects, mesh.object_names),
        (mesh.face_groups, mesh.group_names),
        (mesh.face_materials, mesh.material_names),
    )
    part_names = [names[numbers[face]] for numbers, names in partitions if numbers is not None and numbers[face] >= 0]
    return ", ".join(dict.fromkeys(name for name in part_names if name))


def mirror_place(scene: Scene, side: Side, place: Place) -> Place | None:
    """Mirror image of a place; None on the mirror plane or without one."""
    shape = scene.shape(side)
    mirror = scene.mirrors[0 if side == "target" else 1]
    if mirror is None:
        return None
    image = cage_places(shape, CagePoints(mirror[np.array([place.corners])], np.array([place.weights])))[0]
    return None if _distance(image, place) < _MIRROR_PLANE_DISTANCE * shape.radius else image


def add_counterpart(scene: Scene, before: LandmarkList, after: LandmarkList) -> LandmarkList:
    """Add the mirror image of the landmark that an edit completed, unless one is there."""
    landmark = before.open_landmark
    if landmark is None or after.open_landmark is not None or len(after) != len(before):
        return after
    return add_mirror_image(scene, after, landmark.number)


def add_mirror_image(scene: Scene, landmarks: LandmarkList, number: int) -> LandmarkList:
    """Add the mirror image of a landmark, unless one is there."""

    def is_same_place(side: Side, first: Place, second: Place) -> bool:
        return _distance(first, second) < _SAME_PLACE_DISTANCE * scene.shape(side).radius

    return mirror(landmarks, number, lambda side, place: mirror_place(scene, side, place), is_same_place)


def _distance(first: Place, second: Place) -> float:
    return float(np.linalg.norm(np.array(first.position) - np.array(second.position)))


def _nearest_point(positions: FloatArray, triangles: IndexArray, position: FloatArray) -> Hit:
    """Point nearest to a position in the triangles around the nearest vertex."""
    vertex = int(np.argmin(np.linalg.norm(positions - position, axis=1)))
    around = np.flatnonzero((triangles == vertex).any(axis=1))
    tree = build_tree(positions, triangles[around])
    nearest, barycentric, _ = closest_points(tree, np.asarray(position, dtype=np.float64)[None])
    triangle = int(around[nearest[0]])
    return Hit(triangle, barycentric[0], barycentric[0] @ positions[triangles[triangle]])


def _as_tuple(point: FloatArray) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z
