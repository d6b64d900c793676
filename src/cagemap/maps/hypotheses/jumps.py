"""Whether a map jumps across a contact: a foot that lies on the other calf, a hand on the hip that it touches.

All costs of a fit are Euclidean, so that a jump between parts that touch costs nothing. Along the surfaces it is long.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import SURE_JUMPS
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray

# Two places of the target are this much farther apart along one of the surfaces, of sqrt(area), than twice along the
# other, where the map jumps.
JUMP = 0.2
# How the warning begins.
JUMPING = "the map jumps across a contact"
# Images are compared with this many others, within so many mean distances of vertices; normals that are opposite are
# twice as far apart.
NEIGHBORS, NEAR = 24, 1.4
# Length, of sqrt(area), by which opposite normals keep an image from the other side of a thin part.
FACING = 0.05


@dataclass(frozen=True)
class Jumps:
    """Where a map jumps.

    Attributes
    ----------
    share : float
        Of the target's area: places whose neighbours go to a part of the source that is far along its surface, and
        those at whose image another part of the target lies that is far along its own.
    vertex : int
        Of the target's level that is deformed, where it jumps farthest.
    """

    share: float = 0.0
    vertex: int = 0

    @classmethod
    def of(cls, prepared: PreparedPair, found: PointMap) -> Jumps:
        """Measure a map on the target's level that is deformed."""
        target, source = prepared.graphs
        images = found.images.at(prepared.vertices)
        places, normals = images.positions, images.normals
        once = target.heads < target.tails
        edges = np.column_stack([target.heads[once], target.tails[once]])
        tree = cKDTree(np.hstack([source.positions, FACING * source.normals]))
        at = tree.query(np.hstack([places, FACING * normals]))[1]
        pairs = np.concatenate([edges, image_pairs(places, normals)])
        pairs = pairs[(prepared.rest.masks.of_target(target.n) > 0)[pairs].all(axis=1)]
        on_target = distances_apart(target.station_distances, pairs)
        on_source = distances_apart(source.station_distances[:, at], pairs)
        beyond = np.maximum(on_target, on_source) - 2 * np.minimum(on_target, on_source)
        farthest = np.zeros(target.n)
        np.maximum.at(farthest, pairs, np.where(beyond > JUMP, beyond, 0.0)[:, None])
        return cls(float(target.areas[farthest > 0].sum()), int(farthest.argmax()))

    @property
    def many(self) -> bool:
        """Whether they are more than a right map has."""
        return self.share > SURE_JUMPS

    def warnings(self, prepared: PreparedPair) -> tuple[str, ...]:
        """A sentence for a user where a map jumps; none where it does not."""
        if not self.many:
            return ()
        mesh = prepared.mesh
        place = ", ".join(f"{x:.4g}" for x in mesh.positions[self.vertex] / mesh.scale)
        return (
            f"{JUMPING} at {100 * self.share:.1f} % of the target's area: neighbouring places go "
            "to parts of the source that only touch, or two parts of the target to one. Worst at "
            f"({place}) of the target's file; landmarks on these parts decide",
        )


def image_pairs(places: FloatArray, normals: FloatArray) -> IndexArray:
    """(m, 2) vertices whose images (n, 3) lie near each other and face the same way."""
    radius = NEAR / np.sqrt(len(places))
    facing = np.hstack([places, radius * normals])
    count = min(NEIGHBORS, len(places))
    distance, others = cKDTree(facing).query(facing, k=count, distance_upper_bound=radius)
    first = np.repeat(np.arange(len(places)), count)
    pairs = np.column_stack([first, np.ravel(others)])
    return pairs[np.isfinite(np.ravel(distance)) & (pairs[:, 0] != pairs[:, 1])]


def distances_apart(distances: FloatArray, pairs: IndexArray) -> FloatArray:
    """(m,) least distance along the surface that distances (s, n) from some places allow pairs (m, 2); 0 if unknown."""
    apart = np.zeros(len(pairs))
    for row in np.where(np.isfinite(distances), distances, np.nan):
        apart = np.fmax(apart, np.abs(row[pairs[:, 0]] - row[pairs[:, 1]]))
    return apart
