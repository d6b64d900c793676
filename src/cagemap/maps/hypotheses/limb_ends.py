"""Ends of limbs that a placement has turned the wrong way, such as a hand whose palm lies on the back of the hand.

A limb that is rotated about its axis costs little, and no step of a fit turns it back. So the end of each limb is
aligned with the source as a rigid shape, from several rotations about the limb's axis (iterated closest points, Besl
and McKay 1992). Where it fits much better than from its place in the placement, the mesh is fitted from there.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.deform.fit import evaluate_placement, fine_fit
from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.maps.hypotheses.starts import LEAST_LENGTH, find_tips
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.spectral.zoomout import evenly_spaced_vertices
from cagemap.surface.alignment import fit_similarity
from cagemap.surface.triangle_surface import SurfacePoints

Similarity = tuple[FloatArray, float, FloatArray]  # rotation R, scale s and shift t of s R p + t


def refit_turned_ends(problem: Problem, placed: Placement) -> Placement:
    """A placement of the mesh, fitted again with ends of limbs turned about their axes where that costs less."""
    prepared, config = problem.prepared, problem.prepared.elastic.search
    tips = find_tips(problem, config.limb_height)[0][: config.max_limbs]
    for distances in prepared.energy.graph.distances(tips):
        end = np.flatnonzero(distances < config.end_length)
        root = np.flatnonzero((distances >= config.end_length) & (distances < config.end_root * config.end_length))
        if len(end) < config.fewest_end_vertices or not len(root):
            continue
        images = _aligned_images(prepared, placed.positions, end, root)
        if images is not None:
            start = placed.positions.copy()
            start[end] = images
            fitted = evaluate_placement(prepared, fine_fit(problem, start)).with_start_of(placed)
            placed = fitted if fitted.cost < placed.cost else placed
    return placed


def _aligned_images(
    prepared: PreparedPair, positions: FloatArray, end: IndexArray, root: IndexArray
) -> FloatArray | None:
    """Images (k, 3) of an end's vertices (k,) as a rigid shape on the source; None if they have these images already.

    Of alignments from the end's images and from rotations about the axis from its root, the one with the least cost.
    """
    config, graph = prepared.elastic.search, prepared.energy.graph
    sample = end[evenly_spaced_vertices(len(end), config.end_samples)]
    centres = graph.positions[root].mean(axis=0), positions[root].mean(axis=0)
    axis, image_axis = graph.positions[sample].mean(axis=0) - centres[0], positions[sample].mean(axis=0) - centres[1]
    lengths = np.linalg.norm([axis, image_axis], axis=1)
    if lengths.min() < LEAST_LENGTH:  # a collapsed end has no axis
        return None
    scale, onto_axis = float(lengths[1] / lengths[0]), Rotation.align_vectors(image_axis[None], axis[None])[0]
    starts = [fit_similarity(graph.positions[sample], positions[sample])]
    for angle in np.linspace(0.0, 2.0 * np.pi, config.end_rotations, endpoint=False):
        rotation = (Rotation.from_rotvec(angle * image_axis / lengths[1]) * onto_axis).as_matrix()
        starts.append((rotation, scale, centres[1] - scale * rotation @ centres[0]))
    (rotation, scale, shift), _ = min((_aligned(prepared, sample, start) for start in starts), key=lambda fit: fit[1])
    images = scale * graph.positions[end] @ rotation.T + shift
    apart = np.linalg.norm(images - positions[end], axis=1).mean()
    return np.asarray(images) if apart > config.part_distance else None


def _aligned(prepared: PreparedPair, vertices: IndexArray, similarity: Similarity) -> tuple[Similarity, float]:
    """A similarity that brings vertices (k,) of the rest shape onto the source, from a first one; and its mean cost.

    The cost is that of `vertex_costs` without the energy.
    """
    graph, source, weight = prepared.energy.graph, prepared.source_surface, prepared.elastic.normal_weight
    points, normals = graph.positions[vertices], graph.normals[vertices]
    nearest: SurfacePoints | None = None
    for _ in range(prepared.elastic.search.end_steps):
        if nearest is not None:
            similarity = fit_similarity(points, nearest.positions)
        rotation, scale, shift = similarity
        moved, turned = scale * points @ rotation.T + shift, normals @ rotation.T
        guess = None if nearest is None else nearest.triangle
        nearest = SurfacePoints.nearest(source, moved, turned, normal_weight=weight, guess=guess)
    assert nearest is not None
    squared = ((nearest.positions - moved) ** 2).sum(axis=1)
    apart = 2.0 - 2.0 * np.einsum("nd,nd->n", nearest.normals, turned)
    return similarity, float((squared + weight**2 * apart).mean())
