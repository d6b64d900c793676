"""Masks: weight of every vertex of two surfaces in a match and in transfers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, real_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.subdivision import Refinement
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import row_lengths

LEAST = 1e-4  # smallest mean of a mask, and smallest shared part of a surface's area
WHOLE_SHARE = 0.98  # shares of both areas from which two surfaces correspond as wholes


@dataclass(frozen=True, eq=False)
class Masks:
    """Weight of every vertex of two surfaces, from 0 (masked) to 1.

    The weight of a correspondence is the product of the weights at both ends. Area masked on either surface has no data
    term: it follows its surroundings, and nothing is transferred there.
    """

    target: FloatArray | None = None  #: (n1,) of the finest vertices; in a fit, of its level's. None: all are 1
    source: FloatArray | None = None  #: (n2,) the same of the source
    shared: Masks | None = field(default=None, kw_only=True)  #: of area with a counterpart, contained in these

    def __post_init__(self) -> None:
        for side, mask in (("target", self.target), ("source", self.source)):
            if mask is not None:
                object.__setattr__(self, side, np.array(real_numbers(mask, f"{side} mask")))

    def __repr__(self) -> str:
        sides = ("target", self.target), ("source", self.source)
        shown = [
            f"{name}: {np.count_nonzero(mask)} of {len(mask)} vertices" for name, mask in sides if mask is not None
        ]
        return f"Masks({', '.join(shown)})"

    @property
    def any(self) -> bool:
        """Whether anything is masked."""
        return self.target is not None or self.source is not None

    def reversed(self) -> Masks:
        """Masks with target and source exchanged."""
        return Masks(self.source, self.target)

    def at(self, target: IndexArray, source: IndexArray | slice = slice(None)) -> Masks:
        """Masks of the given vertices of target and source, in their order; default: all of the source."""
        target_mask, source_mask = self.target, self.source
        return Masks(
            None if target_mask is None else target_mask[target], None if source_mask is None else source_mask[source]
        )

    def of_target(self, n: int) -> FloatArray:
        """(n,) weights of all target vertices; 1 without a mask."""
        return np.ones(n) if self.target is None else self.target

    def of_source(self, n: int) -> FloatArray:
        """(n,) weights of all source vertices; 1 without a mask."""
        return np.ones(n) if self.source is None else self.source

    def at_source(self, points: SurfacePoints) -> FloatArray:
        """(m,) weights at points of the source."""
        if self.source is None:
            return np.ones(len(points))
        return np.minimum(points.interpolate(self.of_source(points.surface.n)), 1.0)

    def joint(self, point_map: PointMap) -> FloatArray:
        """(n1,) target's mask at every vertex times the source's mask at its image."""
        return self.of_target(point_map.target.n) * self.at_source(point_map.images)

    def shares(self, target: TriangleSurface, source: TriangleSurface) -> tuple[float, float]:
        """Shares of the area of both surfaces that count."""
        on_target, on_source = self.of_target(target.n), self.of_source(source.n)
        return float(target.vertex_areas @ on_target), float(source.vertex_areas @ on_source)

    def within(self, shared: Masks | None) -> Masks:
        """Masks of the unmasked area that has a counterpart; unchanged if ``shared`` is None, or none of it has one."""
        if shared is None or shared.target is None or shared.source is None:
            return self
        target = self.of_target(len(shared.target)) * shared.target
        source = self.of_source(len(shared.source)) * shared.source
        return Masks(target, source, shared=shared) if target.any() and source.any() else self

    def length_ratio(self, target: TriangleSurface, source: TriangleSurface) -> float:
        """Length on the source of a unit on the target, if shared area keeps its size; 1 for wholes, or if unknown."""
        if self.shared is None:
            return 1.0
        on_target, on_source = self.shared.shares(target, source)
        if min(on_target, on_source) >= WHOLE_SHARE or min(on_target, on_source) < LEAST:
            return 1.0
        return float(np.sqrt(on_source / on_target))

    def require_fit(self, n_target: int, n_source: int) -> None:
        """ParameterError for masks of the wrong length, values outside [0, 1], and masks that leave nothing."""
        remedy = "; `cagemap.vertex_mask` and its like make them from what a file has"
        for side, mask, n in (("target", self.target, n_target), ("source", self.source, n_source)):
            if mask is None:
                continue
            _checked(mask, n, "vertex of the finest level", f"{side} mask", remedy)
            if mask.mean() < LEAST:
                raise ParameterError(f"{side} mask: expected some of the surface to count, got 0 nearly everywhere")


WHOLE = Masks()  # nothing is masked


@kinds_checked
def vertex_mask(refinement: Refinement, values: FloatArray) -> FloatArray:
    """(n_f,) mask of the finest vertices, refined from values (n_0,) at control vertices (a vertex group).

    ParameterError if there is not one number from 0 to 1 for each control vertex.
    """
    given = _checked(values, refinement.control.n_vertices, "control vertex")
    return np.clip(refinement.prolong(given, 0, refinement.finest_level), 0.0, 1.0)


@kinds_checked
def face_mask(refinement: Refinement, values: FloatArray) -> FloatArray:
    """(n_f,) mask of the finest vertices from values (m_0,) at control faces (a face set).

    A vertex between faces takes the least of their values, so that nothing leaks out of a set. ParameterError if there
    is not one number from 0 to 1 for each control face.
    """
    given = _checked(values, refinement.control.n_faces, "control face")
    finest = refinement.finest
    if finest.faces is None:
        raise ParameterError("face mask: expected a mesh refined at least once, got its control mesh. Refine it once.")
    mask = np.ones(finest.n_vertices)
    for corner in finest.faces.T:
        np.minimum.at(mask, corner, given[finest.face_parents])
    return mask


@kinds_checked
def soft_edge(surface: TriangleSurface, mask: FloatArray, width: float) -> FloatArray:
    """(n,) mask that rises from 0 at its border to its full value at a distance inside.

    The ``width`` is this distance along the surface's edges, in units of sqrt(area); 0 changes nothing. ParameterError
    if it is negative or infinite, or the mask has not one number from 0 to 1 for each vertex.
    """
    if not 0.0 <= width < np.inf:
        raise ParameterError(f"mask edge: expected a finite width of 0 or more, of sqrt(area), got {width}")
    mask = _checked(mask, surface.n, "vertex of the surface")
    outside = np.flatnonzero(mask <= 0.0)
    if width == 0.0 or not len(outside):
        return mask
    inside, _ = distances_along_edges(surface, outside, width)
    return mask * np.minimum(inside / width, 1.0)


def _checked(values: FloatArray, count: int, place: str, what: str = "mask", remedy: str = "") -> FloatArray:
    """The values as numbers; ParameterError unless there are ``count`` from 0 to 1."""
    given = real_numbers(values, what)
    if given.shape != (count,) or not np.all((given >= 0) & (given <= 1)):
        extremes = f" from {given.min():g} to {given.max():g}" if given.size else ""
        raise ParameterError(
            f"{what}: expected {count} numbers from 0 to 1, one a {place}, got shape {given.shape}{extremes}{remedy}"
        )
    return given


def distances_along_edges(
    surface: TriangleSurface, seeds: IndexArray, limit: float = np.inf
) -> tuple[FloatArray, IndexArray]:
    """(n,) distances along edges from the nearest of several vertices, and that vertex; -9999 beyond the limit."""
    heads, tails = surface.triangles.ravel(), np.roll(surface.triangles, -1, axis=1).ravel()
    lengths = np.maximum(row_lengths(surface.positions[heads] - surface.positions[tails]), 1e-12)
    edges = sparse.csr_array((lengths, (heads, tails)), shape=(surface.n, surface.n))
    paths = dijkstra(edges, directed=False, indices=seeds, return_predecessors=True, min_only=True, limit=limit)
    return np.asarray(paths[0]), np.asarray(paths[2], dtype=np.int64)
