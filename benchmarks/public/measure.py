"""Match a pair of a public set and measure it as the literature does: geodesic distances at the template's points."""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.public.sets import Marks, PublicSet, more_landmarks
from benchmarks.verdicts import verdict
from cagemap.files.meshes.formats import read_mesh
from cagemap.maps.geodesic import BATCH, HeatDistances
from cagemap.maps.pair import locate
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import SCHEMES
from cagemap.pipeline import choose_level, match, prepare_surface
from cagemap.spectral import Surface
from cagemap.surface.triangle_surface import SurfacePoints

# Largest mean error of a right map, x100 of sqrt(area).
RIGHT = 5.0


@dataclass(frozen=True, eq=False)
class Shape:
    """A prepared shape and its known points, on the finest surface."""

    surface: Surface
    marks: Marks
    places: SurfacePoints
    mesh: ControlMesh  # of the file
    numbers: np.ndarray | None  # of its vertices on the surface's mesh, where that is another


@dataclass(frozen=True, eq=False)
class Receiver:
    """Distances from some known points of a source.

    Attributes
    ----------
    ids : (q,) int64
    distances : (n, q) float32
        At the vertices of the finest surface, of sqrt(area).
    largest : float
        Of all of them.
    """

    ids: np.ndarray
    distances: np.ndarray
    largest: float


class Shapes:
    """Shapes of a set, each prepared once while it is among the last few asked for."""

    def __init__(self, public: PublicSet, root: Path, scheme: str, vertices: int) -> None:
        self.public, self.root, self.scheme, self.vertices = public, root, scheme, vertices
        self.files, self.known = public.shapes(root), dict[str, Shape]()

    def __getitem__(self, name: str) -> Shape:
        if name not in self.known:
            if len(self.known) >= 40:
                self.known.pop(next(iter(self.known)))
            self.known[name] = self._prepared(name)
        return self.known[name]

    def pair(self, target: str, source: str) -> tuple[Shape, Shape]:
        """Both shapes, with the target's points that this pair knows."""
        receiving = self[target]
        marks = self.public.pair_marks(self.root, target, source, receiving.mesh)
        if marks is not None:
            marks = marks if receiving.numbers is None else marks.renumbered(receiving.numbers)
            receiving = replace(receiving, marks=marks, places=locate(receiving.surface.finest_triangles, marks.points))
        return receiving, self[source]

    def _prepared(self, name: str) -> Shape:
        given = control = replace(read_mesh(self.files[name]), name=name)
        marks, numbers = self.public.marks(self.root, name, control), None
        if self.scheme == "none":
            plain = plain_mesh(control)
            numbers, level, control = plain.vertex_of, 0, plain.mesh
            marks = marks.renumbered(numbers)
        else:
            control = replace(control, scheme=SCHEMES[self.scheme]())
            level = choose_level(control, self.vertices)
        surface = prepare_surface(control, level)
        return Shape(surface, marks, locate(surface.finest_triangles, marks.points), given, numbers)


def receiver(shape: Shape, points: int) -> Receiver:
    """Distances from about so many of a shape's known points, spread over their numbers."""
    count = len(shape.marks.ids)
    chosen = np.unique(np.linspace(0, count - 1, min(points, count)).astype(int))
    solver = HeatDistances(shape.places.surface)
    parts = [
        solver.from_points(shape.places.at(chosen[start : start + BATCH])) for start in range(0, len(chosen), BATCH)
    ]
    distances = np.hstack(parts).astype(np.float32)
    return Receiver(shape.marks.ids[chosen], distances, float(distances.max()))


def measured(public: PublicSet, target: Shape, source: Shape, at: Receiver, count: int) -> dict:
    """One row: errors x100 of sqrt(area), and of the largest distance, of a match with so many landmarks."""
    ids = more_landmarks(public, target.marks, source.marks, target.places.positions, count)
    landmarks = Landmarks.none()
    if ids:
        names = target.surface.control.name, source.surface.control.name
        landmarks = Landmarks.of_points(
            tuple(map(str, ids)), target.marks.of(ids), source.marks.of(ids), names[0], names[1]
        )
    wall, processor = time.perf_counter(), time.process_time()
    result = match(target.surface, source.surface, landmarks)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    errors = geodesic_errors(result.point_map.images, target, source, at)
    return {
        **verdict(result),
        "right": bool(100 * errors.mean() <= RIGHT),
        "mean": 100 * float(errors.mean()),
        "median": 100 * float(np.median(errors)),
        "p95": 100 * float(np.quantile(errors, 0.95)),
        "of_largest": 100 * float(errors.mean() / at.largest),
        "flipped": 100 * result.quality.flipped_area,
        "left_out": len(result.suspects),
        "seconds": processor,
        "wall_seconds": wall,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "sizes": [target.places.surface.n, source.places.surface.n],
    }


def geodesic_errors(images: SurfacePoints, target: Shape, source: Shape, at: Receiver) -> np.ndarray:
    """(s,) distances on the source between where a map and the truth take the target's points that the source knows."""
    shared = np.flatnonzero(np.isin(at.ids, target.marks.ids))
    mine = target.places.at(np.searchsorted(target.marks.ids, at.ids[shared]))
    true = source.places.at(np.searchsorted(source.marks.ids, at.ids[shared])).positions
    places = mine.interpolate(images.positions)
    found = SurfacePoints.nearest(source.places.surface, places)
    along = np.einsum("sk,sk->s", found.barycentric, at.distances[found.corners, shared[:, None]])
    # No way along the surface is shorter; near a point the heat method rounds.
    return np.maximum(along, np.linalg.norm(found.positions - true, axis=1))
