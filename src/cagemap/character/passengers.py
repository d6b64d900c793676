"""Transfer of passengers along a map: clothes, shoes, eyes, teeth, hair and props."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, pairwise

import numpy as np
from scipy.spatial import cKDTree

from cagemap.character.body_frames import BodyFrames, SignedDistances, with_split_triangles
from cagemap.character.contact import Contact, push_out
from cagemap.character.normals import move_vertices
from cagemap.character.passenger_pieces import PASSENGER_KINDS, PassengerKind, find_pieces, fit_similarities
from cagemap.character.values import Part
from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.alignment import fit_similarity
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import fan_triangles, row_lengths

_log = logging.getLogger(__name__)

# A small mesh with more strain is torn: eyes, teeth and tongues have 0.6 to 1.3 on faces of few vertices or with a
# closed mouth, at most 0.4 on others (docs/lab/passengers.md).
_MAX_SMALL_STRAIN = 0.5
# In sqrt(area); half of the vertices of lashes are nearer than 0.003 to the eyes, of brows none than 0.006.
_MAX_TORN_DISTANCE = 0.0042
_MAX_SMALL_RADIUS = 0.1  # in sqrt(area)
_LEAST_SAMPLES = 64  # of the body around a mesh
# On a body of fewer vertices the samples around a shoe reach the knee. Its triangles are then split for meshes whose
# strain is that many times smaller with split triangles: 1.9 for torn meshes, 1.5 for others (docs/lab/passengers.md).
_MIN_BODY_VERTICES = 4000
_MIN_STRAIN_RATIO = 1.6
_MIN_EDGE_LENGTH = 1e-9


@dataclass(frozen=True, eq=False)
class CarriedPassenger:
    """A passenger on the target's body.

    Attributes
    ----------
    positions : (n, 3) float64
        In the target's file units.
    matrices : (n, 3, 3) float64
        Rotation times scale that takes an offset of a vertex, as a row, to the target; one for a small mesh.
    distance : float
        Mean distance of the vertices from the source's body, in units of sqrt(area).
    """

    positions: FloatArray
    matrices: FloatArray
    distance: float

    def carry_offsets(self, offsets: FloatArray) -> FloatArray:
        """Offsets (n, 3) of a shape key of the passenger, rotated and scaled for the target."""
        if np.shape(offsets) != self.positions.shape:
            raise ParameterError(f"expected offsets {self.positions.shape}, one a vertex, got {np.shape(offsets)}")
        return np.asarray(np.einsum("nd,nde->ne", offsets, self.matrices))

    def placed(self, part: Part) -> Part:
        """The part, whose mesh was carried, with its shapes on the target's body."""
        shapes = {name: self.carry_offsets(offsets) for name, offsets in part.shapes.items()}
        return move_vertices(part, self.positions, shapes)


def carry_passenger(
    result: PointMap | MatchResult, mesh: ControlMesh, *, kind: PassengerKind | None = None
) -> CarriedPassenger:
    """Carry one mesh on the source's body to the target's body; see `carry_passengers`."""
    return carry_passengers(result, [mesh], kinds=None if kind is None else {mesh.name: kind})[0]


def carry_passengers(
    result: PointMap | MatchResult, meshes: Sequence[ControlMesh], *, kinds: Mapping[str, PassengerKind] | None = None
) -> list[CarriedPassenger]:
    """Carry meshes on the source's body to the target's body.

    Cloth follows the surface below it at its old distance. Small compact pieces (eyeballs with their irises, buttons,
    teeth) and pieces far from the body keep their shape, as 'similarity' does; `find_pieces` decides which. Cloth
    outside the source's body stays outside the target's.

    Parameters
    ----------
    result : PointMap or MatchResult
        The map from the target to the source.
    meshes : sequence of ControlMesh
        In the file units of the source.
    kinds : mapping of str to {'cloth', 'rigid', 'similarity'}, optional
        By the name of a mesh. 'cloth': all of it follows the surface. 'rigid': every connected piece keeps its shape
        and changes its size as the whole body does. 'similarity': the same, with the size of its surroundings.

    Returns
    -------
    list of CarriedPassenger
        One for each mesh.

    Raises
    ------
    ParameterError
        If a mesh has no faces or a position that is not finite, or a kind is unknown.
    """
    point_map = result.point_map if isinstance(result, MatchResult) else result
    kinds = dict(kinds or {})
    for mesh in meshes:
        if mesh.n_faces == 0 or mesh.n_vertices == 0:
            raise ParameterError(f"{mesh.name}: expected a passenger with faces, got none. Leave it out.")
        bad = np.flatnonzero(~np.isfinite(mesh.positions).all(axis=1))
        if len(bad):
            raise ParameterError(f"{mesh.name}: expected finite positions, got others at vertices {bad[:5]}")
    for name, kind in kinds.items():
        if kind not in PASSENGER_KINDS:
            raise ParameterError(f"{name}: expected cloth, rigid or similarity, got {kind!r}")
        if name not in {mesh.name for mesh in meshes}:
            raise ParameterError(f"{name}: expected one of the passengers, {', '.join(mesh.name for mesh in meshes)}")
    if not meshes:
        return []
    source, target = point_map.source, point_map.target
    starts = np.cumsum([0, *(mesh.n_vertices for mesh in meshes)])
    points = np.concatenate([mesh.positions for mesh in meshes]) * source.scale
    triangles = [
        fan_triangles(mesh.face_offsets, mesh.face_indices)[0] + start
        for mesh, start in zip(meshes, starts[:-1], strict=True)
    ]
    distances = SignedDistances.of(source, points)
    frames = BodyFrames(point_map)
    places, matrices = _place(frames, points, triangles, distances)
    large = [not _is_small(points[start:end]) for start, end in pairwise(starts.tolist())]
    if target.n < _MIN_BODY_VERTICES and any(large):
        split = _place(BodyFrames(with_split_triangles(point_map, _MIN_BODY_VERTICES)), points, triangles, distances)
        for own, start, end in compress(zip(triangles, starts[:-1], starts[1:], strict=True), large):
            if _strain(points, places, own) > _MIN_STRAIN_RATIO * _strain(points, split[0], own):
                places[start:end], matrices[start:end] = (of[start:end] for of in split)
    of_small = list[tuple[slice, FloatArray]]()  # rows and matrices of small meshes
    parts = [slice(start, end) for start, end in pairwise(starts.tolist())]
    torn = _torn_meshes(points, places, triangles, parts)
    for mesh, part, is_large, is_torn in zip(meshes, parts, large, torn, strict=True):
        if kinds.get(mesh.name) == "rigid" or is_large:
            continue
        rotation, scale, shift = _similarity_around(frames, points[part])
        of_small.append((part, source.scale / target.scale * scale * rotation.T))
        if mesh.name not in kinds and is_torn:
            _log.info(
                "%s: keeps its shape, since the map around it is too uneven, as at closed mouths and eyes", mesh.name
            )
            places[part], matrices[part] = scale * points[part] @ rotation.T + shift, scale * rotation.T
    kind_of = [kinds.get(mesh.name) for mesh in meshes]
    positions, linear_maps = np.empty_like(places), np.empty_like(matrices)
    for of_group in dict.fromkeys(kind_of):  # meshes of one kind together: an iris joins the eyeball of another mesh
        is_taken = [one == of_group for one in kind_of]
        rows = np.flatnonzero(np.repeat(is_taken, np.diff(starts)))
        of_kind = np.searchsorted(rows, np.concatenate(list(compress(triangles, is_taken))))
        pieces = find_pieces(of_kind, points[rows], distances.heights[rows], of_group)
        positions[rows], turns, scales = fit_similarities(pieces, points[rows], places[rows], matrices[rows])
        linear_maps[rows] = source.scale / target.scale * scales[:, None, None] * turns
    for part, matrix in of_small:  # frames at closed lips and lids differ much, and teeth would move apart
        linear_maps[part] = matrix
    return [
        CarriedPassenger(
            positions[rows] / target.scale, linear_maps[rows], float(np.abs(distances.heights[rows]).mean())
        )
        for rows in parts
    ]


def _place(
    frames: BodyFrames, points: FloatArray, triangles: Sequence[IndexArray], distances: SignedDistances
) -> tuple[FloatArray, FloatArray]:
    """Positions (n, 3) of points on the target, outside its body, and their frames (n, 3, 3)."""
    places, matrices = frames.carry(points, distances)
    contact = Contact.find(frames, points, triangles, distances.normals, matrices)
    return push_out(frames.point_map.target, contact, places, np.concatenate(triangles)), matrices


def _strain(points: FloatArray, places: FloatArray, triangles: IndexArray) -> float:
    """Standard deviation of the logarithms of the edges' stretches, weighted by length."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    before, after = (
        np.maximum(row_lengths(np.diff(of[edges], axis=1)[:, 0]), _MIN_EDGE_LENGTH) for of in (points, places)
    )
    stretches, weights = np.log(after / before), before / before.sum()
    return float(np.sqrt(weights @ (stretches - weights @ stretches) ** 2))


def _is_small(points: FloatArray) -> bool:
    return len(points) >= 3 and bool(np.linalg.norm(points - points.mean(axis=0), axis=1).max() <= _MAX_SMALL_RADIUS)


def _torn_meshes(
    points: FloatArray, places: FloatArray, triangles: Sequence[IndexArray], parts: Sequence[slice]
) -> list[bool]:
    """Whether meshes are small and torn, or lie at such a mesh, as lashes at eyes do; ``parts``: their rows."""
    small = [_is_small(points[part]) for part in parts]
    strains = [_strain(points, places, own) for own in triangles]
    trees = [
        cKDTree(points[part])
        for part, strain, is_small in zip(parts, strains, small, strict=True)
        if is_small and strain > _MAX_SMALL_STRAIN
    ]
    return [
        is_small and any(np.median(tree.query(points[part])[0]) < _MAX_TORN_DISTANCE for tree in trees)
        for part, is_small in zip(parts, small, strict=True)
    ]


def _similarity_around(frames: BodyFrames, points: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Rotation, scale and shift, see `fit_similarity`, of the body around a mesh."""
    centre = points.mean(axis=0)
    reach = np.asarray(frames.tree.query(centre, k=[_LEAST_SAMPLES])[0])
    radius = max(np.linalg.norm(points - centre, axis=1).max(), reach[0])
    near = frames.samples[frames.tree.query_ball_point(centre, radius)]
    return fit_similarity(frames.point_map.images.positions[near], frames.point_map.target.positions[near])


# Mean distance of a passenger from the body, in sqrt(body area), above which its units or place are doubtful.
MAX_BODY_DISTANCE = 0.5


def far_passenger(name: str, body: str, distance: float, factor: float) -> str:
    """Warning about a passenger far from the body, or with a `unit_factor` other than 1; '' if it needs none."""
    if distance <= MAX_BODY_DISTANCE and factor == 1.0:
        return ""
    scaled = f" ({factor:g} times as large it would lie on it)" if factor != 1.0 else ""
    return f"{name} is {distance:.1f} body sizes away from {body} on average{scaled}"


# Increase of the share of vertices inside the body, from source to target, above which a passenger is hidden.
_MAX_HIDDEN_SHARE = 0.5


def hidden_passenger(point_map: PointMap, mesh: ControlMesh, carried: FloatArray) -> list[str]:
    """A note on a rigid passenger that is inside the target's body, but not in the source's.

    ``carried``: (n, 3) its positions on the target.
    """
    sides = (point_map.source, mesh.positions), (point_map.target, carried)
    before, share = ((SignedDistances.of(body, body.scale * at).heights < 0.0).mean() for body, at in sides)
    if share <= before + _MAX_HIDDEN_SHARE:
        return []
    return [f"{mesh.name}: {share:.0%} of it is inside the body; if it is not kept rigid, it stays outside"]


# Ratios of usual units, both ways; the first one is that of equal units.
_UNIT_RATIOS = np.array([2.54, 10.0, 30.48, 1 / 0.0254, 100.0, 1000.0])
_UNIT_FACTORS = np.concatenate([[1.0], np.column_stack([_UNIT_RATIOS, 1.0 / _UNIT_RATIOS]).ravel()])
# Another unit is taken for the passenger's if it multiplies the distance from the body, divided by the extent, by less.
_MAX_DISTANCE_RATIO = 0.25
_UNIT_SAMPLES = 500  # vertices


def unit_factor(body: TriangleSurface, positions: FloatArray) -> float:
    """Factor of a passenger's lengths, a ratio of units such as 100, that brings it onto a body; 1 if none does.

    ``positions``: (n, 3), in the body's file units.
    """
    points = positions * body.scale
    samples = points[:: -(-len(points) // _UNIT_SAMPLES)]
    scaled = _UNIT_FACTORS[:, None, None] * samples
    distances = np.abs(SignedDistances.of(body, scaled.reshape(-1, 3)).heights)
    relative = distances.reshape(len(scaled), -1).mean(axis=1) / _UNIT_FACTORS
    best = int(np.argmin(relative))
    return float(_UNIT_FACTORS[best]) if relative[best] < _MAX_DISTANCE_RATIO * relative[0] else 1.0
