"""Coarse levels below a plain mesh, so that the method finds the hierarchy that subdivision gives a cage.

A dense mesh is simplified step by step (quadric error metrics, Garland and Heckbert 1997, by `fast_simplification`).
Each coarser vertex stands at a vertex of the finer mesh, and each finer vertex is a point of a coarser triangle near
it: its barycentric coordinates are a row of S^l, which carries functions to the finer level as a subdivision matrix
does. All levels take their geometry from the mesh itself, as in the paper's section 2.2.2.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

import fast_simplification
import numpy as np
from scipy import sparse

from cagemap.errors import InvalidMeshError
from cagemap.geometry.closest import closest_among
from cagemap.geometry.flips import delaunay
from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Plain, Scheme
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads, parts
from cagemap.operators.laplacian import stiffness
from cagemap.refinement import Level, Refinement, default_scheme, level_triangles, refine

# Vertices of the levels below the mesh, as the method's stages want them: basis, deformation, a sheet to lie on.
SIZES = (1500, 6000, 24_000)
# A level counts where it has at most this share of the vertices of the next.
WORTH = 0.7
# How fast the library's threshold grows from one pass of collapses to the next; slower makes better triangles.
CAUTION = 3
# Of the Jacobi step that smooths prolonged functions.
DAMPING = 2 / 3
# A level of fewer vertices is none: the collapses went too far.
FEWEST = 100
# Vertices whose place on the coarser mesh is sought at once.
BLOCK = 65_536
# The library keeps its mesh in globals: two threads would simplify each other's.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True, eq=False)
class _Simplified:
    """A coarser mesh on some of a finer mesh's vertices.

    Attributes
    ----------
    kept : (k,) int64
        Finer vertex of every coarser one.
    cluster : (n,) int64
        Coarser vertex that every finer one was drawn to.
    triangles : (t, 3) int64
        Of coarser vertices.
    """

    kept: IndexArray
    cluster: IndexArray
    triangles: IndexArray


def refined(control: ControlMesh, level: int, scheme: Scheme | None = None) -> Refinement:
    """The levels of a mesh that a map is found on: those of its subdivision, or those below a plain mesh.

    Parameters
    ----------
    control : ControlMesh
    level : int
        Number of subdivision steps; 0 of a plain mesh.
    scheme : Scheme, optional
        Default: `default_scheme`.
    """
    scheme = default_scheme(control) if scheme is None else scheme
    return coarsened(refine(control, level, scheme)) if isinstance(scheme, Plain) else refine(control, level, scheme)


def coarsened(plain: Refinement) -> Refinement:
    """A plain mesh with coarse levels below it; the mesh itself is the finest of them.

    Vertices of the finest level stand in another order than in the mesh, those of the coarsest first, so that vertex i
    of a level is vertex i of every finer one; ``places`` says which is which. Faces keep their order.

    Parameters
    ----------
    plain : Refinement
        Of no steps.

    Notes
    -----
    Time and memory are linear in the mesh's size: about 3 s for 400 000 triangles.
    """
    control, dense = plain.control, plain.finest
    if dense.faces is None:
        raise InvalidMeshError(
            f"{control.name}: expected a plain mesh of triangles or of quads alone, got faces of different sizes; "
            "cagemap.plain_mesh splits them"
        )
    surfaces, steps = [(control.positions, level_triangles(plain, 0))], list[_Simplified]()
    for size in reversed([size for size in SIZES if size <= WORTH * control.n_vertices]):
        step = simplified(*surfaces[-1], size)
        if not FEWEST <= len(step.kept) <= WORTH * len(step.cluster):
            break
        steps.append(step)
        surfaces.append((surfaces[-1][0][step.kept], step.triangles))
    # From the coarsest level up: `order` holds a level's vertices, in the numbers of its step, as they will stand.
    positions, faces = surfaces[-1]
    order, levels, matrices = np.arange(len(positions)), [Level(positions, faces, np.arange(len(faces)))], []
    for step, (positions, faces) in zip(reversed(steps), reversed(surfaces[:-1]), strict=True):
        coarse, others = order, np.delete(np.arange(len(positions)), step.kept)
        order = np.concatenate([step.kept[coarse], others])
        matrix = sparse.csr_array(prolongation(positions, faces, step)[order][:, coarse])
        matrix.sort_indices()
        matrices.append(matrix)
        levels.append(Level(positions[order], np.argsort(order)[faces], np.arange(len(faces))))
    places = np.argsort(order)
    levels[-1] = replace(dense, positions=control.positions[order], faces=places[dense.faces])
    return Refinement(control, plain.scheme, tuple(matrices), tuple(levels), places)


def uncoarsened(refinement: Refinement) -> Refinement:
    """Undo `coarsened`: the plain mesh alone, with its own numbers."""
    if refinement.places is None:
        return refinement
    finest, order = refinement.finest, np.argsort(refinement.places)
    assert finest.faces is not None
    mesh = replace(finest, positions=refinement.control.positions, faces=order[finest.faces])
    return Refinement(refinement.control, refinement.scheme, (), (mesh,))


def simplified(positions: FloatArray, triangles: IndexArray, count: int) -> _Simplified:
    """A mesh of about ``count`` of a mesh's vertices, by edge collapses of least quadric error.

    Edges are then flipped to make better triangles (`delaunay`): those that the collapses leave are long and thin, and
    an elastic energy on them made maps a quarter worse.

    A coarse vertex stands at the vertex nearest to the place that the collapses gave it, among those that they drew
    there: it is then a vertex of all finer levels.
    """
    low = positions.min(axis=0)
    unit = (positions - low) / np.max(positions.max(axis=0) - low)  # the library's thresholds are absolute
    faces = triangles.astype(np.int32)
    with _ONE_AT_A_TIME:
        _, _, collapses = fast_simplification.simplify(
            unit, faces, target_count=2 * count, agg=CAUTION, return_collapses=True
        )
        places, coarse, cluster = fast_simplification.replay_simplification(unit, faces, collapses)
    distance = np.linalg.norm(unit - places[cluster], axis=1)
    by_cluster = np.lexsort((distance, cluster))
    found, first = np.unique(cluster[by_cluster], return_index=True)
    # Only vertices that triangles use stay: what the collapses left alone is a point of its cluster's neighbours.
    kept = by_cluster[first]
    flipped = delaunay(positions[kept], np.searchsorted(found, coarse))
    return _Simplified(kept, np.searchsorted(found, cluster), flipped)


def prolongation(positions: FloatArray, triangles: IndexArray, step: _Simplified) -> sparse.csr_array:
    """(n, k) smoothed barycentric coordinates of every vertex of a mesh on the coarser one, rows sum to 1.

    A vertex lies at the closest point of the triangles around the coarse vertex that it was drawn to: never on another
    part of the surface that merely touches this one.

    Parameters
    ----------
    positions : (n, 3) float64
    triangles : (t, 3) int64
    step : _Simplified
    """
    around = np.argsort(step.triangles.ravel(), kind="stable") // 3  # triangles by coarse vertex
    counts = np.bincount(step.triangles.ravel(), minlength=len(step.kept))
    starts = np.cumsum(counts) - counts
    corners = positions[step.kept][step.triangles]
    # A coarse vertex without triangles has none near it; any will do.
    ranges = np.column_stack([starts, starts + counts])
    ranges[counts == 0] = [0, 1]
    vertices, weights = np.empty((len(positions), 3), dtype=np.int64), np.empty((len(positions), 3))

    def locate(part: slice) -> None:
        found, weights[part] = closest_among(corners, ranges[step.cluster[part]], around, positions[part])
        vertices[part] = step.triangles[found]

    in_threads(locate, parts(len(positions), BLOCK))
    # A kept vertex is a vertex of both, to the last bit.
    vertices[step.kept], weights[step.kept] = np.arange(len(step.kept))[:, None], [1.0, 0.0, 0.0]
    rows = 3 * np.arange(len(positions) + 1)
    matrix = sparse.csr_array((weights.ravel(), vertices.ravel(), rows), shape=(len(positions), len(step.kept)))
    matrix.sum_duplicates()
    return sparse.csr_array(smoothing(positions, triangles) @ matrix)


def smoothing(positions: FloatArray, triangles: IndexArray) -> sparse.csr_array:
    """(n, n) means of every vertex and its neighbours by cotangent weights, which round the edges of linear functions.

    A damped Jacobi step ``1 - omega D^-1 W`` without negative weights, so that no entry of a prolongation is negative.
    Prolonged functions have less energy after it (smoothed aggregation, Vanek et al. 1996): eigenvalues of
    the coarse levels come several times closer to those of the mesh.
    """
    upper = sparse.triu(stiffness(positions, triangles), 1).tocoo()
    rows, columns = (upper.coords[i].astype(np.int64) for i in (0, 1))
    weights = sparse.coo_array((np.maximum(-upper.data, 0.0), (rows, columns)), shape=upper.shape)
    neighbours = sparse.csr_array(weights + weights.T)
    total = np.asarray(neighbours.sum(axis=1)).ravel()
    share = np.divide(DAMPING, total, out=np.zeros_like(total), where=total > 0)
    return sparse.csr_array(sparse.diags_array(np.where(total > 0, 1.0 - DAMPING, 1.0)) + share[:, None] * neighbours)
