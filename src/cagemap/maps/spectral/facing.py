"""Which way a functional map turns the surface: the normals of the target placed on the source, and the source's own.

C places the target in space, at Phi1 C Phi2^+ X2. Where a map turns a hand inside out (its palm on the back of the
other's, thumb on thumb), the hand placed so has its normals inside; beside the basis functions they lead the next
search to the other side. They are compared in the source's own pose, so that poses do not matter
[after Smooth Shells: Eisenberger et al. 2020].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.basis import Surface
from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.spectral.samples import Samples, spread
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import kept

# Vertices of a level that are searched in full, where there are more, and how many of them stand for each other vertex.
FEW = 3000
NEAR = 4


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """The mesh of a level, all of whose vertices are samples."""

    surface: Surface
    level: int

    @property
    def triangles(self) -> IndexArray:
        """(t, 3) vertices."""
        return self.surface.triangles(self.level).triangles

    @kept
    def few(self) -> IndexArray:
        """Vertices that are searched for among all others' few before the rest are."""
        return spread(len(self.surface.triangles(self.level).positions), FEW)

    @kept
    def near(self) -> sparse.csr_array:
        """(n, few) the nearest of the few of every vertex, in space."""
        places = self.surface.triangles(self.level).positions
        count = min(NEAR, len(self.few))
        _, nearest = cKDTree(places[self.few]).query(places, k=count, workers=1)
        starts = np.arange(0, count * len(places) + 1, count, dtype=np.int32)
        columns = np.asarray(nearest, dtype=np.int32).ravel()
        return sparse.csr_array((np.ones(len(columns)), columns, starts), shape=(len(places), len(self.few)))

    def coefficients(self, count: int) -> FloatArray:
        """(count, 3) positions in the leading basis functions."""
        level = max(self.level, self.surface.basis.last_level)
        return self.surface.basis.project(self.surface.triangles(level).positions, level, count=count)


def with_normals(
    sides: tuple[Samples, Samples], meshes: tuple[LevelMesh, LevelMesh], functional_map: FloatArray, weight: float
) -> tuple[Samples, Samples]:
    """Samples of target and source with weighted normals as further coordinates.

    Parameters
    ----------
    sides, meshes : pairs of Samples and LevelMesh
        Of target and source.
    functional_map : (k1, k2) array
        C12, which places the target on the source; the source is smoothed to the same functions.
    weight : float
    """
    coefficients = meshes[1].coefficients(functional_map.shape[1])
    placed = functional_map @ coefficients, coefficients
    found = []
    for side, mesh, shape in zip(sides, meshes, placed, strict=True):
        normals = vertex_normals(side.rows[:, : len(shape)] @ shape, mesh.triangles)
        found.append(replace(side, coordinates=np.hstack([side.coordinates, weight * normals])))
    return found[0], found[1]
