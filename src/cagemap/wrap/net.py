"""Configuration of a wrap; and the control net that is fitted: rest shape, samples, terms for `deform.energy`.

With S the refinement from the net's level to the finest and P the images of the finest vertices by the map, the terms
are distances of surface samples from the source:

    sum_i w_i ( (n_i . (S X - q)_i)^2 + anchor |(S X - P)_i|^2 )

with closest points q and normals n of the source. For pinned samples, such as those of boundaries, the term is
``w_i |(S X - P)_i|^2`` alone. The system couples the three coordinates through the tangent planes. It is solved by
conjugate gradients from the current positions; the system without planes, ``S^T w S + fairness L``, is the
preconditioner, the same for all coordinates and all rounds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg
from scipy.spatial import cKDTree

from cagemap.deform.config import GraphConfig, Stage
from cagemap.deform.energy import ElasticEnergy, Solve, bounded_energy
from cagemap.deform.graph import ElasticGraph, mesh_graph
from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.relax import label_patches
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import Config
from cagemap.numerics.sparse_algebra import Factorization, factor
from cagemap.operators.laplacian import vertex_areas
from cagemap.subdivision import Refinement, finest_mesh, level_triangles
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import corner_sums, triangle_areas, triangle_normals


@dataclass(frozen=True)
class MendConfig(Config):
    """Mending of faces that fold or grow thin. A face is small if all of its corners are small (`small`)."""

    rounds: int = 20  #: most rounds of mending
    small_rounds: int = 6  #: most rounds for small faces
    stiffening: float = 10.0  #: factor on the stiffness at corners of bad faces in each round
    small: float = 0.0005  #: share of the area below which a point's ring is small; in a coarse cage it is a limb
    thin: float = 1.5  #: a face is thin above this times its aspect (longest by shortest edge) at rest
    small_thin: float = 1.35  #: the same for small faces, which are many
    max_thin: float = 99.0  #: stiffness from which thin faces stay thin: more costs distance to the source
    small_max_thin: float = 999.0  #: the same for small faces, which cost less distance
    max_small_fold: float = 1e3  #: stiffness above which small faces that still fold are released
    max_fold: float = 1e8  #: largest stiffness; other faces that still fold are kept
    share: float = 0.05  #: samples that depend on released points by more than this have no weight
    release_rounds: int = 5  #: rounds around released points, which move further
    release_rings: int = 1  #: rings around folded corners that are released
    rings: int = 2  #: rings around bad faces that move
    many_rings: int = 1  #: the same for nets of many points
    many: int = 10_000  #: points of such a net: its bad faces are small, and their surroundings shape them
    flattenings: int = 8  #: most rounds of flattening faces that still fold at the end
    max_flat: float = 0.01  #: largest share of the area that is flattened


@dataclass(frozen=True)
class WrapConfig(Config):
    """How closely the net follows the source (docs/lab/elastic.md); areas are shares, lengths of sqrt(area)."""

    level: int = 0  #: level whose points are fitted; 0 is the control mesh
    fairness: float = 1e-4  #: weight of the net's energy against squared distances to the source
    anchor: float = 0.003  #: weight of distances to the map's images, against distances to the surface
    rounds: int = 3  #: rounds of closest-point searches
    max_distance: float = 0.01  #: 99th percentile of distances above which a second fit with a stronger anchor is tried
    stronger_anchor: float = 3.0  #: factor on ``anchor`` of the second fit; the closer fit is kept
    weight_power: float = 0.5  #: exponent of an edge's squared length in its weight: 0 alike, 1 as squared distances
    smoothing: float = 0.01  #: epsilon of the energy, see `cagemap.deform.config.Stage`
    levels_below: int = 2  #: samples are vertices this many levels finer: about 16 for each point of the net
    max_samples: int = 60_000  #: most samples, unless the net's next level has more
    max_slide: float = 2.0  #: distance from the image, in edges of the net, from which a point is on another part
    normal_weight: float = 0.03  #: weight of normals in closest points, of sqrt(area)
    accuracy: float = 3e-2  #: relative residual of a round's solution; the terms change more between rounds
    max_steps: int = 200  #: most conjugate gradient steps of a round
    min_weight: float = 1e-6  #: a point with a smaller share of its largest possible sample weight is free
    carrying_rounds: int = 30  #: rounds of the energy alone that place free points before the first fit
    energy_rings: int = 3  #: rings around the points of a local fit that are part of its energy
    nearest_points: int = 30  #: nearest points whose motion a detached piece follows: some rings of a coarse cage
    #: area ratio (source to target; of an open target relative to the typical one) below which a part has no
    #: counterpart; measured up to 0.01
    squeezed: float = 0.03
    whole: float = 0.1  #: the same ratio above which a part has a counterpart; measured 0.2 or more
    #: distance, in roots of the typical ratio, within which images of the area behind such a part are on the others
    overlap_distance: float = 0.01
    min_area: float = 0.002  #: share of the target's area below which such a part is ignored
    min_follow: float = 0.5  #: weight below which a vertex has no counterpart, and its distance is no error
    graph: GraphConfig = GraphConfig()
    mending: MendConfig = MendConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.fairness:
            raise ParameterError("fairness: expected a number above 0, got 0; the default is 1e-4")


@dataclass(frozen=True, eq=False)
class ControlNet:
    """One level of a surface as a net of control points, with its rest shape."""

    refinement: Refinement
    level: int  # of the net; below the finest
    mesh: ControlMesh  # the net, at rest
    # Rest shape at unit area of the surface. Weights are cotangents times edge lengths (times their mean), so that
    # the energy has a similar weight against squared distances for small and large faces
    graph: ElasticGraph
    energy: ElasticEnergy
    first_triangles: IndexArray  # (m,) where every face's triangles begin among those of the finest level

    def surface(self, positions: FloatArray) -> FloatArray:
        """(n_f, 3) finest vertices of the surface over a net (n_l, 3)."""
        return self.refinement.prolong(positions, self.level, self.refinement.finest_level)


def level_mesh(refinement: Refinement, level: int) -> ControlMesh:
    """A level as a mesh with UVs, materials and groups; ParameterError for hole faces on levels above 0."""
    if level and refinement.holes(level).any():
        raise ParameterError(
            f"{refinement.control.name}: has hole faces, so that only level 0 can be a net. Give level 0."
        )
    return finest_mesh(refinement.up_to(level))


def control_net(refinement: Refinement, level: int, scale: float, config: WrapConfig = WrapConfig()) -> ControlNet:
    """Prepare a level of the target for fitting."""
    mesh = level_mesh(refinement, level)
    net = TriangleSurface(scale * mesh.positions, level_triangles(refinement, level), scale)
    graph = mesh_graph(net, refinement.faces(level), config.graph)
    lengths2 = np.einsum("ed,ed->e", graph.edges, graph.edges)
    graph = replace(
        graph, weights=graph.weights * (lengths2 / lengths2.mean()) ** config.weight_power * lengths2.mean()
    )
    energy = bounded_energy(graph, config.smoothing, config.graph)
    finest = refinement.finest
    steps = refinement.finest_level - level
    face = finest.face_parents if level == 0 else np.arange(finest.n_faces) // 4**steps
    per_face = len(level_triangles(refinement, refinement.finest_level)) // finest.n_faces
    first = per_face * np.searchsorted(face, np.arange(mesh.n_faces))
    return ControlNet(refinement, level, mesh, graph, energy, first)


def folded_faces(net: ControlNet, positions: FloatArray) -> NDArray[np.bool_]:
    """(m,) faces of the net whose mean normal is turned against the refined surface that they control."""
    refinement, corner = net.refinement, positions[net.mesh.face_indices]
    fine = triangle_normals(net.surface(positions), level_triangles(refinement, refinement.finest_level))
    sums = np.add.reduceat(fine, net.first_triangles, axis=0)
    normals = np.add.reduceat(np.cross(corner, corner[net.mesh.next_corners]), net.mesh.face_offsets[:-1], axis=0)
    return np.asarray(np.einsum("md,md->m", normals, sums) <= 0)


def face_aspects(mesh: ControlMesh, positions: FloatArray) -> FloatArray:
    """(m,) longest edge of every face divided by its shortest."""
    corner = positions[mesh.face_indices]
    lengths = np.linalg.norm(corner[mesh.next_corners] - corner, axis=1)
    begin = mesh.face_offsets[:-1]
    return np.asarray(np.maximum.reduceat(lengths, begin) / np.maximum(np.minimum.reduceat(lengths, begin), 1e-300))


@dataclass(frozen=True, eq=False)
class Samples:
    """Vertices of the refined surface and their images by the map, at unit area of the source."""

    rows: sparse.csr_array  # (s, n_l) of S: the samples from the net's points
    images: SurfacePoints  # images by the map
    max_slide: FloatArray  # (s,): how far from its image a sample may slide; those farther are pinned there
    weights: FloatArray  # (s,): areas times follow weights
    pinned: NDArray[np.bool_]  # (s,): samples that stay at their image (boundaries), instead of sliding on the surface

    @classmethod
    def choose(
        cls, net: ControlNet, images: SurfacePoints, follow: FloatArray, pinned: NDArray[np.bool_], config: WrapConfig
    ) -> Samples:
        """Sample vertices of a level finer than the net; images, follow and pinned (n_f,) are of finest vertices."""
        refinement, graph = net.refinement, net.graph
        level = min(net.level + 1, refinement.finest_level)
        while level < min(net.level + config.levels_below, refinement.finest_level):
            if refinement.levels[level + 1].n_vertices > config.max_samples:
                break
            level += 1
        sampled = refinement.levels[level]
        count = sampled.n_vertices
        rows = refinement.rows(slice(count), refinement.finest_level, net.level)
        areas = vertex_areas(sampled.positions, refinement.faces(level))
        around = np.bincount(graph.heads, graph.lengths, graph.n) / np.maximum(
            np.bincount(graph.heads, minlength=graph.n), 1
        )
        weights = follow[:count] * areas / areas.sum()
        return cls(rows, images.at(slice(count)), config.max_slide * (rows @ around), weights, pinned[:count])

    def of_part(self, seen: IndexArray, part: IndexArray) -> Samples:
        """The samples ``seen``, as functions of the points ``part`` only."""
        rows = self.rows[seen][:, part]
        return Samples(rows, self.images.at(seen), self.max_slide[seen], self.weights[seen], self.pinned[seen])


@dataclass(frozen=True, eq=False)
class NetTerms:
    """Terms of a net, or of a part of it, with moving points (m,): distances to images; `at` adds tangent planes."""

    samples: Samples
    config: WrapConfig
    moving: IndexArray  # (m,)
    transposed: sparse.csr_array  # (n, s): the transpose of the samples' rows
    laplacian: sparse.csr_array  # (n, n) of the net at rest
    factors: Factorization  # of the preconditioner, in the moving points
    closest: SurfacePoints  # points of the source with the tangent planes (s,)
    plane_weights: FloatArray  # (s,) of distances to tangent planes
    image_weights: FloatArray  # (s,) of distances to images
    right: FloatArray  # (n, 3) right side of the system

    @classmethod
    def build(
        cls, graph: ElasticGraph, samples: Samples, config: WrapConfig, moving: IndexArray | None = None
    ) -> NetTerms:
        """Distances to images alone, with the preconditioner of all rounds; by default all points move."""
        transposed, weights = sparse.csr_array(samples.rows.T), samples.weights
        matrix = sparse.csr_array(
            transposed @ sparse.diags_array(weights) @ samples.rows + config.fairness * graph.laplacian
        )
        if moving is None:
            moving = np.arange(graph.n)
        else:
            matrix = matrix[moving][:, moving]
        factors, right = factor(sparse.csc_array(matrix)), transposed @ (weights[:, None] * samples.images.positions)
        return cls(
            samples,
            config,
            moving,
            transposed,
            graph.laplacian,
            factors,
            closest=samples.images,
            plane_weights=np.zeros(len(weights)),
            image_weights=weights,
            right=right,
        )

    def start(self, energy: ElasticEnergy) -> FloatArray:
        """(n, 3) net that minimises ``||S X - P||^2`` with a little energy; fixed points stay at rest."""
        positions = energy.graph.positions.copy()
        positions[self.moving] = self.factors.solve(self.right[self.moving])
        elastic = self.config.fairness * energy.graph.divergence(energy.differentials(positions)[0])
        positions[self.moving] = self.factors.solve((self.right + elastic)[self.moving])
        return positions

    def at(self, positions: FloatArray, found: object, alpha: float, before: NetTerms | None) -> NetTerms:
        """Terms with the source's closest points to positions (n, 3); other arguments are those of `minimise`."""
        samples, images = self.samples, self.samples.images
        guess = (self if before is None else before).closest.triangle
        weight = self.config.normal_weight
        places = samples.rows @ positions
        closest = SurfacePoints.nearest(images.surface, places, images.normals, normal_weight=weight, guess=guess)
        pinned = samples.pinned | (np.linalg.norm(closest.positions - images.positions, axis=1) > samples.max_slide)
        plane_weights = np.where(pinned, 0.0, samples.weights)
        image_weights = np.where(pinned, 1.0, self.config.anchor) * samples.weights
        heights = np.einsum("sd,sd->s", closest.normals, closest.positions)
        wanted = (plane_weights * heights)[:, None] * closest.normals + image_weights[:, None] * images.positions
        right = self.transposed @ wanted
        return replace(self, closest=closest, plane_weights=plane_weights, image_weights=image_weights, right=right)

    def solver(self, alpha: float, stage: Stage, factors: object) -> tuple[None, Solve]:
        """The terms' own `solve`: the stiffness is the fairness in all rounds."""
        return None, self.solve

    def solve(self, right: FloatArray, positions: FloatArray) -> FloatArray:
        """(n, 3) solution for a right side (n, 3) in the moving points, from positions (n, 3)."""
        moving, shape = self.moving, positions.shape

        def times(flat: FloatArray) -> FloatArray:
            spread = np.zeros(shape)
            spread[moving] = flat.reshape(-1, 3)
            return self.times(spread)[moving].ravel()

        operator = partial(linalg.LinearOperator, (3 * len(moving), 3 * len(moving)), dtype=np.float64)
        step, _ = linalg.cg(
            operator(matvec=times),
            (right - self.times(positions))[moving].ravel(),
            rtol=self.config.accuracy,
            maxiter=self.config.max_steps,
            M=operator(matvec=lambda flat: self.factors.solve(flat.reshape(-1, 3)).ravel()),
        )
        moved = positions.copy()
        moved[moving] += step.reshape(-1, 3)
        return moved

    def times(self, positions: FloatArray) -> FloatArray:
        """(n, 3) the system's matrix times positions (n, 3)."""
        normals, places = self.closest.normals, self.samples.rows @ positions
        heights = np.einsum("sd,sd->s", normals, places)
        wanted = (self.plane_weights * heights)[:, None] * normals + self.image_weights[:, None] * places
        return np.asarray(self.transposed @ wanted + self.config.fairness * (self.laplacian @ positions))


def counterpart_mask(point_map: PointMap, config: WrapConfig = WrapConfig()) -> FloatArray:
    """(n1,) 1 where the source has a counterpart, 0 where the map overlaps, or squeezes more than typical."""
    target = point_map.target
    image = triangle_areas(point_map.images.positions, target.triangles)
    sums = corner_sums(target.triangles, np.column_stack([target.areas, image]), target.n)
    # Typical area ratio, at most 1, weighted by images: at least 1 onto a whole source (Cauchy and Schwarz).
    own, on_source = sums[sums[:, 0] > 0].T
    typical = np.clip((on_source**2 / own).sum() / max(on_source.sum(), 1e-12), 1e-12, 1.0)
    size = float(typical) if target.is_open else 1.0
    # A vertex in a squeezed part has squeezed neighbours as well; single slivers do not count.
    for _ in range(2):
        sums = corner_sums(target.triangles, sums[target.triangles].mean(axis=1), target.n)
    ratio = np.divide(sums[:, 1], sums[:, 0], out=np.ones(target.n), where=sums[:, 0] > 0)
    mask = np.clip((ratio / size - config.squeezed) / (config.whole - config.squeezed), 0.0, 1.0)
    mask[_hollow_parts(point_map, mask >= 0.5, config, np.sqrt(size))] = 0.0
    return mask


def _hollow_parts(point_map: PointMap, whole: NDArray[np.bool_], config: WrapConfig, unit: float) -> NDArray[np.bool_]:
    """(n1,) squeezed parts and parts cut off by them, if their images overlap the rest, by distances in ``unit``."""
    target, images = point_map.target, point_map.images.positions
    nowhere = np.zeros(target.n, dtype=np.bool_)
    if whole.all():
        return nowhere
    part, piece = (label_patches(target.triangles, mask) for mask in (whole, np.ones(target.n, dtype=np.bool_)))
    areas = np.bincount(part, np.where(whole, target.vertex_areas, 0.0))
    largest = np.zeros(int(piece.max()) + 1)
    np.maximum.at(largest, piece, areas[part])
    behind = whole & (areas[part] < largest[piece])
    if target.vertex_areas[behind].sum() < config.min_area:
        return nowhere
    distance, _ = cKDTree(images[whole & ~behind]).query(images[behind])
    near = np.bincount(part[behind], distance <= unit * config.overlap_distance, len(areas)) > 0.5 * np.bincount(
        part, minlength=len(areas)
    )
    laid_over = behind & near[part]
    hollow = label_patches(target.triangles, ~whole | laid_over)
    share = np.bincount(hollow, np.where(laid_over, target.vertex_areas, 0.0))
    return np.asarray(share[hollow] >= config.min_area)
