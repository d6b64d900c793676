"""Carry values, skinning weights and blend shapes as arrays to the target's control mesh."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cagemap.deform.graph import mesh_graph
from cagemap.errors import ParameterError
from cagemap.maps.result import MatchResult
from cagemap.mesh.faces import cage_triangles, merged_corners, place_counts
from cagemap.numerics.arrays import FloatArray, array_of, real_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer import (
    combine,
    control_weights,
    corner_weights,
    pull_back_faces,
    transfer_of,
)
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes
from cagemap.transfer.skin import carry_skin, normalise_skin
from cagemap.wrap.net import counterpart_mask

logger = logging.getLogger(__name__)

# Least trust; control vertices below it take their weights from the vertices around them.
_LEAST_TRUST = 0.1


@kinds_checked
def carry_values(
    result: MatchResult, values: ArrayLike | Mapping[str, ArrayLike], at: str | None = None
) -> NDArray[Any] | dict[str, NDArray[Any]]:
    """Carry values of the source to places of the same kind on the target.

    Every value of the target is a convex combination of the source's. Integers and booleans are labels:
    the one with the largest share is taken. Masks are ignored.

    Parameters
    ----------
    result : MatchResult
    values : (m,) or (m, ...) array, or dict of name to such arrays
        One row for each place of the source.
    at : str, optional
        "vertices" (control vertices), "faces" (control faces), "corners" (of the control faces, face by face) or
        "refined" (vertices of the finest level). Default: the first kind with as many places as there are rows.

    Returns
    -------
    array, or dict of name to array
        Of the form of ``values``; one row for each such place of the target.

    Raises
    ------
    ParameterError
        If no kind has as many places as rows, or the values are no numbers.
    """
    sides = result.target.refinement, result.source.refinement
    source = sides[1].control
    counts = place_counts(source) | {"refined": len(result.source.vertices)}
    if at is not None and at not in counts:
        raise ParameterError(f"carry_values: at: expected one of {', '.join(counts)}, got {at!r}")
    transfer = transfer_of(result)
    at_vertices = control_weights(result.point_map, *sides)

    def carried(name: str, given: ArrayLike) -> NDArray[Any]:
        array = array_of(given)
        if array.ndim > 2 and len(array):  # a matrix for each place
            return carried(name, array.reshape(len(array), -1)).reshape(-1, *array.shape[1:])
        array = array if array.dtype.kind in "biuf" else real_numbers(given, name)
        rows = array.shape[0] if array.ndim else 0
        place = next((place for place, n in counts.items() if n == rows and at in (None, place)), "")
        if not place:
            raise ParameterError(
                f"{name} has {rows} rows; expected one for each of the source's {source.n_vertices} control vertices, "
                f"{source.n_faces} control faces, {counts['corners']} face corners, or {counts['refined']} vertices of "
                f"level {result.source.refinement.finest_level}{f', and at={at!r} was asked for' if at else ''}"
            )
        if place == "vertices":
            return combine(at_vertices, array)
        if place == "faces":
            return pull_back_faces(transfer, array, n_target_faces=sides[0].control.n_faces)
        if place == "corners":
            node_values, nodes = merged_corners(source.face_indices, array)
            return combine(corner_weights(transfer, *sides, nodes, len(node_values))[0], node_values)
        return combine(transfer.point_map.to_sparse(), array)

    if isinstance(values, Mapping):
        return {name: carried(name, array) for name, array in values.items()}
    return carried("values", values)


@kinds_checked
def carry_weights(result: MatchResult, weights: ArrayLike, *, influences: int | None = 4) -> FloatArray:
    """Carry skinning weights of the source's control vertices to the target's.

    Vertices where the map is not trusted take weights from the vertices around them.

    Parameters
    ----------
    result : MatchResult
    weights : (c2, j) array
        Weight of each joint, not negative. Rows sum to 0 or to 1; from 0.9 to 1.1 they are scaled, with a warning in
        the log.
    influences : int, optional
        Most joints per vertex; None for all.

    Returns
    -------
    (c1, j) float64
        Rows sum to 1, unless the source rows that they come from are 0.

    Raises
    ------
    ParameterError
        If weights are negative, rows do not sum to 1, there is not one row a control vertex, or no vertex of the map
        can be trusted.
    """
    given = real_numbers(weights, "skinning weights")
    if given.ndim != 2:
        raise ParameterError(f"skinning weights: expected an array (n, joints), got {given.shape}")
    given, scaled = normalise_skin(given)
    if scaled:
        logger.warning("skinning weights: %s", scaled)
    target, source = result.target.refinement, result.source.refinement
    at_vertices = control_weights(result.point_map, target, source)
    split = cage_triangles(target.control)[0]
    scale = result.point_map.target.scale
    net = mesh_graph(TriangleSurface(scale * target.control.positions, split, scale), split)
    return carry_skin(at_vertices, given, net, trusted_vertices(result), influences=influences)


def trusted_vertices(result: MatchResult) -> NDArray[np.bool_]:
    """(c1,) whether a target control vertex takes its skinning weights from its image."""
    count = result.target.control.n_vertices
    has_counterpart = counterpart_mask(result.point_map)[:count] >= 0.5
    return np.asarray((result.trust[:count] >= _LEAST_TRUST) & has_counterpart)


@kinds_checked
def carry_shapes(
    result: MatchResult, offsets: ArrayLike | Mapping[str, ArrayLike]
) -> FloatArray | dict[str, FloatArray]:
    """Carry blend shapes of the source's control mesh to the target's; outside masks they are zero.

    Parameters
    ----------
    result : MatchResult
    offsets : (c2, 3) array, or dict of name to such arrays
        Displacements of the source's control vertices, in its file's lengths. Several shapes in one call share their
        preparation.

    Returns
    -------
    (c1, 3) float64, or dict of name to such arrays
        Of the target's control vertices, in its file's lengths.

    Raises
    ------
    ParameterError
        If there is not one finite row a control vertex.
    """
    carrier = prepare_shapes(result.target.refinement, result.source.refinement, result.point_map)
    follows = result.masks.joint(result.point_map)[: result.target.control.n_vertices, None]
    if isinstance(offsets, Mapping):
        return {
            name: follows * carry_shape(carrier, real_numbers(shape, f"shape {name}"))
            for name, shape in offsets.items()
        }
    return follows * carry_shape(carrier, real_numbers(offsets, "shape"))
