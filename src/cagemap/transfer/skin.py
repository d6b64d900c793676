"""Carry skinning weights and joints to another cage.

Weights stay convex, are limited in number per vertex, and are harmonic where the map is not trusted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.deform.graph import ElasticGraph
from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations
from cagemap.numerics.sparse_algebra import factor

# Sums of weights within this distance of 1 are rounding: their rows do not change.
_SUM_ROUNDING = 1e-5
# Sums within this distance of 1 are normalised (MakeHuman: 0.954 to 1.063). Others are no weights, or lack joints.
_MAX_DEVIATION = 0.1


def carry_skin(
    weights: sparse.csr_array,
    skin: FloatArray,
    net: ElasticGraph,
    trusted: NDArray[np.bool_],
    *,
    influences: int | None = 4,
) -> FloatArray:
    """Skinning weights (c1, j) of the target's control vertices from the source's (c2, j), see `normalise_skin`.

    ``weights`` (c1, c2) are convex, see `cagemap.transfer.control_values.control_weights`. Where the map is not
    ``trusted`` (c1,), weights are harmonic on the net of the target's control mesh, so they stay convex.
    ``influences``: most joints per vertex, None for all; the smallest weights are left out. Rows sum to 1, unless the
    source rows that they come from are 0.
    """
    skin, _ = normalise_skin(skin)
    if len(skin) != weights.shape[1]:
        raise ParameterError(f"skinning weights: expected {weights.shape[1]} rows, one a vertex, got {len(skin)}")
    if influences is not None and influences < 1:
        raise ParameterError(
            f"influences: expected at least 1 joint a vertex, got {influences}. None, on the command line 0, keeps all."
        )
    carried = fill_unknown(np.asarray(weights @ skin), net, trusted)
    return normalise_rows(prune_rows(carried, influences), carried.sum(axis=1))


def normalise_skin(skin: FloatArray) -> tuple[FloatArray, str]:
    """Skinning weights (n, j) with rows that sum to 1 or 0, and a note if rows were scaled, else ''.

    Rows are not negative and sum to 0 (no joint) or to 1 within 0.1; those that sum to 1 or 0 are unchanged.
    """
    skin = np.asarray(skin, dtype=np.float64)
    sums = skin.sum(axis=1)
    off = np.where(sums == 0, 0.0, np.abs(sums - 1))
    wrong = np.flatnonzero(~((skin.min(axis=1) >= 0) & (off <= _MAX_DEVIATION)))  # so written, a NaN is wrong too
    if len(wrong):
        raise ParameterError(
            f"skinning weights: expected rows without negative weights that sum to 1 (0.9 to 1.1 is normalised), got "
            f"{len(wrong)} others, first {wrong[:5].tolist()} (sum {sums[wrong[0]]:.4g}); give the weights of all "
            "joints and nothing else, or normalise them in the rig"
        )
    scaled = np.flatnonzero(off > _SUM_ROUNDING)
    if not len(scaled):
        return skin, ""
    skin = skin / np.where(off > _SUM_ROUNDING, sums, 1.0)[:, None]
    lowest, highest = sums[scaled].min(), sums[scaled].max()
    return skin, (
        f"weights of {len(scaled)} of {len(skin)} vertices did not sum to 1 (sums from {lowest:.4g} to {highest:.4g}) "
        "and are normalised"
    )


def fill_unknown(values: FloatArray, net: ElasticGraph, known: NDArray[np.bool_]) -> FloatArray:
    """Values (n, q), kept where known and harmonic on the net elsewhere."""
    if known.all():
        return values
    if not known.any():
        raise ParameterError("expected a map that is to be trusted somewhere, got one that is trusted nowhere")
    laplacian = net.laplacian
    unknown = np.flatnonzero(~known)
    inner = laplacian[unknown][:, unknown]
    # A small multiple of the identity, for parts of the net without a known vertex; their weights become 0.
    inner = inner + 1e-12 * float(inner.diagonal().mean()) * sparse.eye_array(len(unknown))
    result = values.copy()
    right = -(laplacian[unknown][:, np.flatnonzero(known)] @ values[known])
    result[unknown] = np.maximum(factor(sparse.csc_array(inner)).solve(right), 0.0)
    return result


def prune_rows(skin: FloatArray, influences: int | None) -> FloatArray:
    """The largest ``influences`` weights of every row (n, j); among equal weights, the first joints."""
    if influences is None or influences >= skin.shape[1]:
        return skin
    order = np.argsort(-skin, axis=1, kind="stable")[:, :influences]
    kept = np.zeros_like(skin)
    np.put_along_axis(kept, order, np.take_along_axis(skin, order, axis=1), axis=1)
    return kept


def normalise_rows(skin: FloatArray, sums: FloatArray) -> FloatArray:
    """Rows scaled to sums (n,); rows that already have them, up to rounding, are unchanged."""
    present = skin.sum(axis=1)
    factors = np.divide(sums, present, out=np.ones_like(present), where=present > 0)
    return skin * np.where(np.abs(factors - 1) > 1e-12, factors, 1.0)[:, None]


def with_chosen_joints(carried: FloatArray, own: FloatArray, chosen: IndexArray) -> FloatArray:
    """Weights (n, j): carried ones of the chosen joints (q,), the mesh's own of other joints, scaled to sum 1.

    Rows of both tables sum to 1, or to 0 in ``own`` for vertices without weights. Rows whose own weights all belong to
    chosen joints take all carried weights.
    """
    if carried.shape != own.shape:
        raise ParameterError(f"skinning weights: expected two tables of one shape, got {carried.shape} and {own.shape}")
    wrong = [int(joint) for joint in chosen if not 0 <= joint < carried.shape[1]]
    if wrong:
        raise ParameterError(f"joints: expected 0 to {carried.shape[1] - 1}, got {wrong[:5]}")
    taken = np.zeros(carried.shape[1], dtype=bool)
    taken[chosen] = True
    kept = np.where(taken, 0.0, own)
    present = kept.sum(axis=1)
    left = 1.0 - carried[:, taken].sum(axis=1)
    factors = np.divide(left, present, out=np.zeros_like(left), where=present > 0)
    result = np.where(taken, carried, kept * factors[:, None])
    return np.where((present > 0)[:, None], result, carried)


def symmetrize_skin(skin: FloatArray, vertices: IndexArray, joints: IndexArray) -> FloatArray:
    """Mean of skinning weights (n, j) and of their mirror image.

    ``vertices`` (n,) are those at mirror images, see `cagemap.mesh.mirrors`; ``joints`` (j,) the ones on the other
    side, or the joint itself, see `cagemap.character.bones.mirrored_joints`.
    """
    return 0.5 * (skin + skin[vertices][:, joints])


# Power of the squared distance by which weights fall: a joint in a limb follows the ring of surface around it.
_POWER = 2
# Least distance in the weights, in units of sqrt(area).
_MIN_DISTANCE = 1e-3
# Vertices per block: their weights stay in the processor's cache.
_BLOCK = 1024


def carry_joints(point_map: PointMap, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Carry joints (j, 3), or other points in or near the source, to the target; both are in file units.

    Every joint is moved by the affine map from images on the source to vertices of the target that fits best around it
    (moving least squares, Schaefer et al. 2006). Affine deformations are reproduced exactly. Also returns the rotation
    (j, 3, 3) of each map: a source direction as a row vector times it is the target's direction.
    """
    source = point_map.images.positions
    target = point_map.target.positions
    count = len(source)
    # Moments about a common centre: one matrix product gives the moments of many joints.
    center = source.mean(axis=0), target.mean(axis=0)
    source, target = source - center[0], target - center[1]
    products = [np.einsum("na,nb->nab", source, side).reshape(count, 9) for side in (source, target)]
    table = np.concatenate([np.ones((count, 1)), source, target, *products], axis=1)
    squares = np.einsum("nd,nd->n", source, source)
    places = np.asarray(joints, dtype=np.float64) * point_map.source.scale - center[0]
    floors = np.einsum("jd,jd->j", places, places)[:, None] + _MIN_DISTANCE**2
    sums = np.zeros((len(places), table.shape[1]))
    for start in range(0, count, _BLOCK):
        block = slice(start, start + _BLOCK)
        squared = (-2 * places) @ source[block].T
        squared += squares[block]
        squared += floors
        np.maximum(squared, _MIN_DISTANCE**2, out=squared)
        sums += (point_map.target.vertex_areas[block] / squared**_POWER) @ table[block]
    sums /= sums[:, :1]
    before, after = sums[:, 1:4], sums[:, 4:7]
    moments = sums[:, 7:16].reshape(-1, 3, 3) - before[:, :, None] * before[:, None]
    mixed = sums[:, 16:].reshape(-1, 3, 3) - before[:, :, None] * after[:, None]
    # A flat neighbourhood does not determine the map along its normal: the trace makes the map a scaled rotation.
    moments += 1e-9 * np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    linear = np.linalg.solve(moments, mixed)
    carried = center[1] + after + np.einsum("ja,jab->jb", places - before, linear)
    return carried / point_map.target.scale, nearest_rotations(np.asarray(linear))
