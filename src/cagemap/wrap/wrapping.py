"""Wrap a target's cage onto a source by a map; the remaining distance is detail to bake."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.alignment import fit_similarity
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.baking import Transfer
from cagemap.transfer.detail import Detail, detail_over, own_transfer
from cagemap.wrap.fit import NOTHING_FOLLOWS, fit_net, keep_positions, mend
from cagemap.wrap.net import Samples, WrapConfig, control_net, counterpart_mask, face_aspects, folded_faces

# Message for a target without a cage.
NO_CAGE = (
    "expected a cage to wrap, got a plain mesh (scheme none), which has no control points. Match it with a scheme "
    "(`ControlMesh.scheme`): catmull-clark, loop for triangles, or bilinear, which leaves its form. The source may be "
    "plain."
)

Closest = tuple[IndexArray, FloatArray, FloatArray]  # triangles, barycentric coordinates, distances

_RENDERED = 4  # least level of both surfaces for baking: most programs render a subdivision surface at it
_MOST_BAKED_VERTICES = 1_500_000  # largest number of vertices for baking, whatever the level


@dataclass(frozen=True, eq=False)
class Wrapped:
    """Result of a wrap: the target's net in the source's shape."""

    mesh: ControlMesh  #: level ``level`` of the target, its positions fitted, in the source's units; all else unchanged
    level: int
    surface: FloatArray  #: (n_f, 3) finest vertices of the net's refined surface
    closest: PointMap  #: closest points of the source to these vertices
    distance: FloatArray  #: (n_f,) their distances, as parts of sqrt(source area)
    source_distance: FloatArray  #: (n_2,) distances of the source's vertices to the wrapped surface, likewise
    follow: FloatArray  #: (n_f,) weight with which each vertex followed the source, from 0 to 1
    has_counterpart: NDArray[np.bool_]  #: (n_f,) whether a vertex has a counterpart on the source
    left_out: float  #: share of the target's area that has no counterpart
    folded: IndexArray  #: (k,) faces of the net that are folded against their refined surface, and were not at rest
    aspect: float  #: 99th percentile of faces' longest by shortest edge, divided by that at rest


def require_fit_level(level: int, finest: int, name: str = "fit level") -> None:
    """Refuse a net that is as fine as the map; ``name`` is used in the message."""
    if level >= finest:
        raise ParameterError(
            f"{name}: expected a level below the map's own, 0 to {finest - 1}, got {level}. Match at a higher level to "
            "fit a finer net."
        )


def wrap(
    target: Refinement,
    point_map: PointMap,
    config: WrapConfig = WrapConfig(),
    *,
    follow: FloatArray | None = None,
    symmetry: IndexArray | None = None,
) -> Wrapped:
    """Put the target's cage into the source's shape.

    ``target`` is refined up to the level of the map, the point map is of the finest level. ``follow`` (n_0,) or (n_f,)
    is the weight with which every control vertex, or finest vertex, follows the source, from 0 to 1; with weight 0 it
    moves with its surroundings. Parts without a counterpart are detected in any case. ``symmetry`` (n_l,) is the mirror
    image of every point of the net; it keeps the net symmetric. ParameterError if the map does not fit the levels, the
    net is as fine as the surface, or ``follow`` has another length.
    """
    finest = target.finest_level
    if target.is_plain:
        raise ParameterError(f"{target.control.name}: {NO_CAGE}")
    require_fit_level(config.level, finest)
    if point_map.target.n != target.finest.n_vertices:
        raise ParameterError(
            f"expected a map of the target's {target.finest.n_vertices} vertices of level {finest}, got one of "
            f"{point_map.target.n}: are target and source exchanged, or of other levels?"
        )
    with ThreadPool(1) as pool:
        mask_task = pool.submit(counterpart_mask, point_map, config)
        net = control_net(target, config.level, point_map.target.scale, config)
        weights = mask_task.result() * finest_follow(target, follow)
    samples = Samples.choose(net, point_map.images, weights, point_map.target.boundary_vertices, config)
    adjust = keep_positions if symmetry is None else partial(symmetrize, symmetry)
    has_counterpart = weights >= config.min_follow
    if not has_counterpart.any():
        raise ParameterError(NOTHING_FOLLOWS)
    source = point_map.source

    def fitted(config: WrapConfig) -> tuple[FloatArray, Closest]:
        positions = mend(net, samples, config, fit_net(net, samples, config, adjust), adjust)
        return positions, closest_points(source.tree, net.surface(positions), guess=point_map.triangle)

    positions, (triangle, barycentric, distance) = fitted(config)
    if np.percentile(distance[has_counterpart], 99) > config.max_distance and config.anchor > 0:
        anchored, closest = fitted(replace(config, anchor=config.stronger_anchor * config.anchor))
        if closest[2][has_counterpart].mean() < distance[has_counterpart].mean():
            positions, (triangle, barycentric, distance) = anchored, closest
    surface = net.surface(positions)
    triangles = point_map.target.triangles
    _, _, source_distance = closest_points(TriangleSurface(surface, triangles).tree, source.positions)
    at_rest = net.graph.positions
    folded = folded_faces(net, positions) & ~folded_faces(net, at_rest)
    aspects = [np.percentile(face_aspects(net.mesh, x), 99) for x in (positions, at_rest)]
    return Wrapped(
        mesh=net.mesh.with_positions(positions / source.scale),
        level=config.level,
        surface=surface / source.scale,
        closest=PointMap.from_arrays(point_map.target, source, triangle, barycentric),
        distance=distance,
        source_distance=source_distance,
        follow=weights,
        has_counterpart=has_counterpart,
        left_out=float(point_map.target.areas @ (~has_counterpart)[triangles].mean(axis=1)),
        folded=np.flatnonzero(folded),
        aspect=float(aspects[0] / aspects[1]),
    )


def symmetrize(symmetry: IndexArray, positions: FloatArray) -> FloatArray:
    """(n, 3) symmetric net: mean of the net and its mirror image about the best-fitting plane."""
    # The best rigid motion of the image, with one axis turned over, is the reflection about that plane.
    flip = np.array([-1.0, 1.0, 1.0])
    image = positions[symmetry] * flip
    rotation, _, _ = fit_similarity(image, positions)
    centred = image - image.mean(axis=0)
    return 0.5 * (positions + centred @ rotation.T + positions.mean(axis=0))


def finest_follow(target: Refinement, follow: FloatArray | None) -> FloatArray:
    """(n_f,) follow weights of the finest vertices, from weights at these or at control vertices; None: all 1."""
    n, count = target.control.n_vertices, target.finest.n_vertices
    if follow is None:
        return np.ones(count)
    values = np.asarray(follow, dtype=np.float64)
    if values.shape not in ((n,), (count,)) or not np.all((values >= 0) & (values <= 1)):
        raise ParameterError(
            f"weight map: expected {n} numbers from 0 to 1, one a control vertex of the target (or {count}, one a "
            f"vertex of its finest level), got shape {values.shape} from {values.min():g} to {values.max():g}"
        )
    return values if len(values) == count else np.clip(target.prolong(values, 0, target.finest_level), 0.0, 1.0)


def missing_detail(wrapped: Wrapped, target: Refinement, source: Refinement) -> tuple[Transfer, Detail, Refinement]:
    """Wrapped surface to bake into, the source as its detail (weights `Wrapped.follow`), and the refined source."""
    transfer, follow = wrapped_transfer(wrapped, target)
    refined_source = _refined(source, max(source.finest_level, _RENDERED))
    triangles = level_triangles(refined_source, refined_source.finest_level)
    detail = detail_over(transfer.point_map.source, refined_source.finest.positions, triangles)
    return transfer, replace(detail, follow=follow), refined_source


def wrapped_transfer(wrapped: Wrapped, target: Refinement) -> tuple[Transfer, FloatArray]:
    """Wrapped surface at render level, to bake into its UV layout, and its follow weights (n,)."""
    fine = _refined(target, max(target.finest_level, _RENDERED))
    # `refine` works on the control mesh; positions of the net are refined from their own level.
    positions = fine.prolong(wrapped.mesh.positions, wrapped.level, fine.finest_level)
    follow = np.clip(fine.prolong(wrapped.follow, target.finest_level, fine.finest_level), 0.0, 1.0)
    return own_transfer(replace(fine.finest, positions=positions), fine.holes(fine.finest_level)), follow


def _refined(refinement: Refinement, level: int) -> Refinement:
    """The refinement up to a level, or up to the last level of allowed size."""
    size = refinement.finest.n_vertices
    while level > refinement.finest_level and size * 4 ** (level - refinement.finest_level) > _MOST_BAKED_VERTICES:
        level -= 1
    if level == refinement.finest_level or refinement.is_plain:
        return refinement
    return refine(refinement.control, level, refinement.scheme)
