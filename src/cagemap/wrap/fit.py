"""My topology, that shape: control points whose *refined* surface lies on the source.

The map says where every point of the target's refined surface belongs. With S the refinement from the net's level to
the finest and P the images of the finest vertices, the net starts at the minimum of ``||S X - P||^2`` and is then drawn
onto the source's tangent planes at the closest points, which lets it slide along the surface:

    sum_i w_i ( (n_i . (S X - q)_i)^2 + anchor |(S X - P)_i|^2 ) + fairness E(X)

E is the elastic fit's as-affine-as-possible energy of the net against its rest shape (`maps.elastic.graph`): it keeps
the flow of edge loops, stops faces from crossing, and carries what has no counterpart (w = 0) along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.geometry.points import SurfacePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.operators.laplacian import vertex_areas
from cagemap.refinement import level_triangles
from cagemap.wrap.net import ControlNet

# Levels below the net whose vertices the fit looks at: about 16 for every point of the net.
_SAMPLED_BELOW = 2
# ... but no level that has more vertices than this, where the next one has 4 for every point.
_MOST_SAMPLES = 60_000
# A closest point further from the map's image than so many edges of the net belongs to another part.
_REACH = 2.0


@dataclass(frozen=True)
class WrapConfig:
    """How closely a net follows.

    Attributes
    ----------
    level : int
        Level whose points are fitted; 0 is the control mesh.
    fairness : float
        Weight of the net's energy against squared distances to the source.
    anchor : float
        Weight of the map's own images along the surface, against the distance from it.
    rounds : int
        Times that closest points are looked for.
    """

    level: int = 0
    fairness: float = 1e-4
    anchor: float = 0.003
    rounds: int = 3

    def __post_init__(self) -> None:
        if self.level < 0 or self.rounds < 0:
            raise ParameterError(f"level and rounds: expected 0 or more, got {self.level} and {self.rounds}")
        if not 0 < self.fairness < np.inf:
            raise ParameterError(f"fairness: expected a number above 0, got {self.fairness}; the default is 1e-4")
        if not 0 <= self.anchor < np.inf:
            raise ParameterError(f"anchor: expected 0 or more, got {self.anchor}; the default is 0.003")


@dataclass(frozen=True, eq=False)
class FitData:
    """What a net is fitted to, at unit area of the source.

    Attributes
    ----------
    samples : (s, n_l) csr_array
        Rows of S: vertices of the refined surface from the net's points.
    images : SurfacePoints
        Where the map takes them.
    reach : (s,) float64
        How far from its image a sample may slide: the length of the net's edges there.
    weights : (s,) float64
        Their areas times how far they may follow.
    held : (s,) bool
        Samples that stay at their image (boundaries), instead of sliding along the surface.
    """

    samples: sparse.csr_array
    images: SurfacePoints
    reach: FloatArray
    weights: FloatArray
    held: NDArray[np.bool_]


def fit_data(net: ControlNet, images: SurfacePoints, follow: FloatArray, held: NDArray[np.bool_]) -> FitData:
    """Choose the vertices that the fit looks at, and weigh them.

    Parameters
    ----------
    net : ControlNet
    images : SurfacePoints
        Where the map takes the target's finest vertices.
    follow : (n_f,) float64
        1 where a vertex is to follow, 0 where it has no counterpart.
    held : (n_f,) bool
    """
    refinement, graph = net.refinement, net.graph
    seen = min(net.level + 1, refinement.n_levels)
    while seen < min(net.level + _SAMPLED_BELOW, refinement.n_levels):
        if refinement.levels[seen + 1].n_vertices > _MOST_SAMPLES:
            break
        seen += 1
    level = refinement.levels[seen]
    count = level.n_vertices
    rows = sparse.csr_array(refinement.product(refinement.n_levels, net.level)[:count])
    areas = vertex_areas(level.positions, level_triangles(refinement, seen) if level.faces is None else level.faces)
    lengths = np.linalg.norm(graph.edges, axis=1)
    around = np.bincount(graph.heads, lengths, graph.n) / np.maximum(np.bincount(graph.heads, minlength=graph.n), 1)
    return FitData(
        rows, images.at(slice(count)), _REACH * (rows @ around), follow[:count] * areas / areas.sum(), held[:count]
    )
