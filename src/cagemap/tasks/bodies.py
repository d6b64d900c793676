"""The matched bodies of two characters, and blend shapes along their map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import sparse

from cagemap.character.body_frames import neighbor_means
from cagemap.character.bones import BODY_SIDES, humanoid_joints
from cagemap.character.own_parts import nearest_rows, rigid_groups
from cagemap.character.passenger_pieces import PIECES, PieceConfig
from cagemap.character.values import Part, Rig
from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import count_noun
from cagemap.mesh.parts import MIN_BODY_EXTENT
from cagemap.mesh.repairs import RepairedMesh
from cagemap.mesh.topology import used_vertices
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal
from cagemap.numerics.threads import kept
from cagemap.pipeline import MatchConfig, choose_level, match, other_answer, prepare_surfaces
from cagemap.spectral import Surface
from cagemap.subdivision.face_varying import interpolate_linearly
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import fan_triangles, row_lengths
from cagemap.tasks.carry_arrays import carry_shapes
from cagemap.tasks.match_parts import lost_landmark_notes, ready_mesh
from cagemap.tasks.progress import Stages
from cagemap.transfer import control_weights

# Least number of finest vertices of a body that is subdivided; plain meshes are not.
BODY_VERTICES = 100_000
# A part is refused as a body if the piece that is matched spans less than `MIN_BODY_EXTENT` of it, and the other pieces
# have more than this share of the area.
_MAX_OTHER_PIECES = 0.1
# Least share of equal triangles of two shapes of one mesh: programs split concave quads along the other diagonal.
_LEAST_EQUAL_FACES = 0.95
# Where the map tears at the corners of the mouth, edges of heads are up to 10 to 16 times as long in jawOpen.
_MAX_STRETCH, _SMOOTHING_ROUNDS = 5.0, 30
_SHORT_EDGE = 0.1  # of the mean length; shorter edges count as this long
_MIN_FACES = 4  # of a body: a tetrahedron
_MIN_LIMB_EXTENT = 0.15  # of the body's; an arm has more than 0.2, a pauldron or a bracelet less
_OTHER_PART = "Or choose another part (rig: --body-part, --like-part; face: --part)"


@dataclass(frozen=True, eq=False)
class Bodies:
    """Two bodies as given and as repaired for the match, and the map."""

    given: tuple[Part, Part]
    ready: tuple[RepairedMesh, RepairedMesh]
    result: MatchResult
    notes: tuple[str, ...] = ()  # on lost landmarks, or on vertices that are paired by number

    @kept
    def flat_map(self) -> PointMap:
        """The map, with the faces of the target's cage flat, as glTF shows them."""
        point_map, refinement = self.result.point_map, self.result.target.refinement
        if refinement.is_plain:
            return point_map
        control, triangles = refinement.control, point_map.target.triangles
        count, level = control.n_vertices, refinement.finest_level
        matrix, corners = interpolate_linearly(control, control.face_indices, count, level, refinement.scheme)
        positions = np.zeros_like(point_map.target.positions)
        positions[triangles] = (matrix @ control.positions)[corners]
        return PointMap(TriangleSurface.from_faces(positions, triangles), point_map.images)

    def rows(self, side: int) -> IndexArray:
        """For every vertex of a matched mesh (0: target, 1: source), a vertex of the given mesh at its place."""
        vertex_of, matched = self.ready[side].vertex_of, self.ready[side].mesh
        given = np.flatnonzero(vertex_of >= 0)[::-1]  # reversed, so that the first of several is kept
        rows = np.full(matched.n_vertices, -1, dtype=np.int64)
        rows[vertex_of[given]] = given
        copies = np.flatnonzero(rows < 0)  # made by the repair where parts only touch
        if len(copies):
            rows[copies] = nearest_rows(self.given[side].mesh.positions, matched.positions[copies])
        return rows

    def skin(self, weights: sparse.csr_array | None, shapes: Mapping[str, FloatArray]) -> Part:
        """The matched piece of the target's body, with values of all its vertices as given."""
        rows = self.rows(0)
        of_rows = {name: offsets[rows] for name, offsets in shapes.items()}
        return Part(self.given[0].name, self.ready[0].mesh, None if weights is None else weights[rows], of_rows)

    def on_target(self, values: FloatArray) -> FloatArray:
        """Values at the given target's vertices; vertices that were set aside copy the nearest matched vertex."""
        vertex_of, places = self.ready[0].vertex_of, self.given[0].mesh.positions
        known = vertex_of >= 0
        rows = np.where(known, vertex_of, 0)
        if not known.all():
            rows[~known] = vertex_of[known][nearest_rows(places[known], places[~known])]
        return np.asarray(values[rows])


def match_bodies(
    target: Part, source: Part, landmarks: Landmarks, stages: Stages, rig: Rig | None = None, answer: int = 0
) -> Bodies:
    """Match the meshes of two parts, after repairs if they need any.

    Without landmarks, two meshes with the same faces, such as two shapes of one base mesh, are paired vertex by vertex.
    ``rig``: of the source. ``answer``: of several that the match finds, 0 for the best.

    Raises
    ------
    ParameterError
        If the piece of a part that is matched is only a fragment of it, or has fewer than four faces; without
        landmarks, if other pieces are the arms or legs of the source; if there is no such answer.
    """
    ready = _ready_body(target), _ready_body(source)
    on_ready = landmarks.renumbered(*(mesh.vertex_of.__getitem__ for mesh in ready))
    stages("prepare")
    levels = choose_level(ready[0].mesh, BODY_VERTICES), choose_level(ready[1].mesh, BODY_VERTICES)
    surfaces = prepare_surfaces(ready[0].mesh, ready[1].mesh, levels)
    notes = lost_landmark_notes(landmarks, on_ready)
    has_landmarks = len(landmarks) > 0 or len(landmarks.curves) > 0
    result = None if has_landmarks else _map_of_equal_faces(*surfaces)
    if result is None:
        if rig is not None and not has_landmarks:
            _require_limbs(source, ready[1], rig)
        result = match(*surfaces, on_ready, MatchConfig(answer=answer), progress=stages)
    elif answer:
        result = other_answer(result, answer)
    else:
        pair = f"{target.mesh.name} has the same faces as {source.mesh.name}"
        notes = [f"{pair}: their vertices are paired by number; with --landmarks they are matched"]
    return Bodies((target, source), ready, result, tuple(notes))


def _map_of_equal_faces(target: Surface, source: Surface) -> MatchResult | None:
    """The map from each vertex to the vertex of its number; None if more than 5 % of the finest triangles differ."""
    places = target.finest_triangles, source.finest_triangles
    if places[0].n != places[1].n or places[0].triangles.shape != places[1].triangles.shape:
        return None
    if (places[0].triangles == places[1].triangles).all(axis=1).mean() < _LEAST_EQUAL_FACES:
        return None
    point_map = PointMap.from_vertices(*places, np.arange(places[0].n))
    return MatchResult(target, source, Landmarks.none(), point_map, measure_quality(point_map))


def _ready_body(part: Part) -> RepairedMesh:
    if part.mesh.n_faces < _MIN_FACES:
        raise ParameterError(
            f"{part.mesh.name}: expected a body, but {part.name} has only {count_noun(part.mesh.n_faces, 'face')}. "
            f"Export the whole body. {_OTHER_PART}."
        )
    ready = ready_mesh(part.mesh)
    with_faces = part.mesh.positions[used_vertices(part.mesh)]
    extents = [box_diagonal(points) for points in (ready.mesh.positions, with_faces)]
    if ready.repairs.pieces_share > _MAX_OTHER_PIECES and extents[0] < MIN_BODY_EXTENT * extents[1]:
        raise ParameterError(
            f"{part.mesh.name}: expected a surface in one piece, but {part.name} has {ready.repairs.pieces + 1} "
            f"pieces, and the one that is matched spans only {extents[0] / extents[1]:.0%} of it. If faces under the "
            f"clothes were deleted, export the whole body. {_OTHER_PART}."
        )
    return ready


def _require_limbs(part: Part, ready: RepairedMesh, rig: Rig) -> None:
    """Refuse a body whose arms or legs, by the joints that move them, are pieces that are not matched."""
    if part.weights is None or not ready.repairs.pieces:
        return
    bones, is_matched = humanoid_joints(rig), ready.vertex_of >= 0
    extent = box_diagonal(part.mesh.positions)
    moved = (part.weights > 0.5).tocsc()  # vertices that a joint moves more than all others together
    for side, limb in product(BODY_SIDES, ("Arm", "Leg")):
        joints = [bones[bone] for half in ("Upper", "Lower") if (bone := f"{side}{half}{limb}") in bones]
        vertices = moved[:, joints].indices
        limb_extent = box_diagonal(part.mesh.positions[vertices]) if len(vertices) else 0.0
        if limb_extent > _MIN_LIMB_EXTENT * extent and not is_matched[vertices].any():
            raise ParameterError(
                f"{part.mesh.name}: expected a body in one piece, but the {side} {limb.lower()} of {part.name} is not "
                "on the piece that is matched. If faces under the clothes were deleted, export the whole body, or give "
                f"--landmarks if the other body lacks them too. {_OTHER_PART}."
            )


def body_shapes(bodies: Bodies) -> dict[str, FloatArray]:
    """Blend shapes of the source as offsets of the given target's vertices, by name."""
    shapes = bodies.given[1].shapes
    if not shapes:
        return {}
    rows = bodies.rows(1)
    carried = carry_shapes(bodies.result, {name: offsets[rows] for name, offsets in shapes.items()})
    assert isinstance(carried, dict)
    target, source = (one.mesh for one in bodies.ready)
    weights = control_weights(bodies.result.point_map, bodies.result.target.refinement, bodies.result.source.refinement)
    for name, offsets in carried.items():
        of_source = largest_stretches(source, shapes[name][rows])
        # 0.1 % more, so that no rounding error changes a shape of the same body.
        allowed = 1.001 * np.maximum.reduceat(of_source[weights.indices], weights.indptr[:-1])  # no row is empty
        carried[name] = limit_stretch(target, offsets, np.maximum(allowed, _MAX_STRETCH))
    return {name: bodies.on_target(offsets) for name, offsets in carried.items()}


def largest_stretches(mesh: ControlMesh, offsets: FloatArray) -> FloatArray:
    """(n,) largest factor by which offsets (n, 3) stretch an edge of each vertex."""
    edges, stretches = _stretched_edges(mesh, offsets)
    largest = np.zeros(mesh.n_vertices)
    np.maximum.at(largest, edges, stretches[:, None])
    return largest


def limit_stretch(mesh: ControlMesh, offsets: FloatArray, allowed: FloatArray) -> FloatArray:
    """Offsets (n, 3), smoothed in rounds at edges that they stretch by more than is ``allowed`` (n,) at both ends."""
    means = neighbor_means(fan_triangles(mesh.face_offsets, mesh.face_indices)[0], mesh.n_vertices)
    for _ in range(_SMOOTHING_ROUNDS):
        edges, stretches = _stretched_edges(mesh, offsets)
        rows = np.unique(edges[stretches > allowed[edges].max(axis=1)])
        if not len(rows):
            break
        offsets = offsets.copy()
        offsets[rows] = 0.5 * (offsets[rows] + means[rows] @ offsets)
    return offsets


def _stretched_edges(mesh: ControlMesh, offsets: FloatArray) -> tuple[IndexArray, FloatArray]:
    """(e, 2) edges of triangles, and the factors (e,) by which offsets (n, 3) stretch them."""
    triangles = fan_triangles(mesh.face_offsets, mesh.face_indices)[0]
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    before, after = (row_lengths(np.diff(of[edges], axis=1)[:, 0]) for of in (mesh.positions, mesh.positions + offsets))
    return edges, after / np.maximum(before, _SHORT_EDGE * before.mean())


def rigid_pieces(bodies: Bodies, config: PieceConfig = PIECES) -> list[IndexArray]:
    """Vertices of each unmatched piece of the target's mesh that keeps its shape, such as an eyeball."""
    mesh, unmatched = bodies.given[0].mesh, bodies.ready[0].vertex_of < 0
    if not unmatched.any():
        return []
    groups = rigid_groups(mesh, bodies.result.point_map.target, config)
    return [vertices for vertices in groups if unmatched[vertices].all()]
