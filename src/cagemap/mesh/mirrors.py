"""Find mirror planes of control meshes from vertex positions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal

MOST_WITHIN, ALL_WITHIN = 1e-3, 2e-2  # of the box diagonal: distances of most, and of all, mirror images
MIN_SHARE = 0.95  # least share of mirror images within the first tolerance
PLANE_SAMPLES, STEPS = 1000, 10  # vertices sampled in the search for a plane, and most iterations of it
# The search stops if an iteration leaves more than this share of the mirror images' median distance, unless the median
# is already below so many tolerances.
MAX_RATIO, NEAR_TOLERANCES = 0.9, 10.0
MIN_SAMPLE_SHARE = 0.8  # least share of sampled mirror images on vertices for which all vertices are tested
SAME_PLANE = 0.99  # planes whose normals have a larger cosine count as the same plane


@dataclass(frozen=True, eq=False)
class Mirror:
    """An exact or approximate mirror plane of a control mesh."""

    image: IndexArray = field(repr=False)  #: (n,) nearest vertex of every vertex's mirror image
    normal: FloatArray  #: (3,) unit vector; the plane is ``normal @ x == offset``
    offset: float
    exact: bool  #: whether the image is a symmetry of the mesh, see `is_symmetry`


def mirror_symmetries(control: ControlMesh) -> tuple[Mirror, ...]:
    """Find the mirror planes of a control mesh, exact ones first.

    Planes through the centroid, normal to a coordinate axis or a principal axis, are fitted to pairs of vertices and
    nearest mirror images. A plane is accepted if 95 % of the images are within `MOST_WITHIN` of vertices, and all
    within `ALL_WITHIN`. Faces need not be symmetric, as cages are often triangulated asymmetrically.
    """
    positions = control.positions
    diagonal = box_diagonal(positions)
    centre = positions.mean(axis=0)
    _, principal = np.linalg.eigh((positions - centre).T @ (positions - centre))
    tree = cKDTree(positions)
    sample = positions[:: max(1, len(positions) // PLANE_SAMPLES)]
    mirrors: list[Mirror] = []
    for start in (*np.eye(3), *principal.T):
        settled = _settled_plane(sample, tree, start, float(start @ centre), diagonal)
        if settled is None:
            continue
        normal, offset = settled
        if any(abs(mirror.normal @ normal) > SAME_PLANE for mirror in mirrors):
            continue
        sampled, _ = _query(tree, reflect(sample, normal, offset))
        if np.mean(sampled <= MOST_WITHIN * diagonal) < MIN_SAMPLE_SHARE:
            continue
        distances, image = _query(tree, reflect(positions, normal, offset))
        numbers = np.arange(len(positions))
        near = np.mean(distances <= MOST_WITHIN * diagonal) >= MIN_SHARE and distances.max() <= ALL_WITHIN * diagonal
        # Reject the plane of a flat mesh: it maps every vertex to itself.
        if near and np.mean(image[image] == numbers) >= MIN_SHARE and not np.array_equal(image, numbers):
            mirrors.append(Mirror(image, normal, offset, is_symmetry(control, image)))
    return tuple(sorted(mirrors, key=lambda mirror: not mirror.exact))


def _settled_plane(
    sample: FloatArray, tree: cKDTree, normal: FloatArray, offset: float, diagonal: float
) -> tuple[FloatArray, float] | None:
    """Fit a plane to vertices and their nearest mirror images, repeatedly; None if it does not converge."""
    before = np.inf
    for _ in range(STEPS):
        distances, nearest = _query(tree, reflect(sample, normal, offset))
        median = float(np.median(distances))
        if median > 0.1 * diagonal or median > max(MAX_RATIO * before, NEAR_TOLERANCES * MOST_WITHIN * diagonal):
            return None
        before = median
        partner = tree.data[nearest]
        good = distances <= 3.0 * median + 1e-6 * diagonal
        across = (sample - partner)[good]
        _, axes = np.linalg.eigh(across.T @ across)
        moved = axes[:, -1] * np.sign(axes[:, -1] @ normal)
        place = float(np.median(0.5 * (sample + partner)[good] @ moved))
        settled = abs(place - offset) < 1e-9 * diagonal and moved @ normal > 1.0 - 1e-14
        normal, offset = moved, place
        if settled:
            break
    return normal, offset


def reflect(points: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """(q, 3) mirror images of points at the plane ``normal @ x == offset``."""
    return points - 2.0 * np.outer(points @ normal - offset, normal)


def _query(tree: cKDTree, points: FloatArray) -> tuple[FloatArray, IndexArray]:
    distances, nearest = tree.query(points)
    return np.asarray(distances), np.asarray(nearest, dtype=np.int64)


def is_symmetry(control: ControlMesh, image: IndexArray) -> bool:
    """Whether a vertex permutation maps faces to faces, holes to holes, creases and corners to equally sharp ones."""
    if not np.array_equal(np.sort(image), np.arange(control.n_vertices)):
        return False
    elements = []
    kinds = np.ones(control.n_faces)
    if control.hole_faces is not None:
        kinds[control.hole_faces] = 2.0
    for size in np.unique(control.face_sizes):
        corners = control.face_offsets[:-1][control.face_sizes == size, None] + np.arange(size)
        elements.append((control.face_indices[corners], kinds[control.face_sizes == size]))
    if control.crease_edges is not None and control.crease_sharpness is not None:
        elements.append((control.crease_edges, control.crease_sharpness))
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        elements.append((control.corner_vertices[:, None], control.corner_sharpness))

    def ordered(vertices: IndexArray, values: FloatArray) -> FloatArray:
        """Elements of positive value, vertices ascending in each, in lexicographic order."""
        table = np.column_stack([np.sort(vertices, axis=1), values])[values > 0]
        return np.asarray(table[np.lexsort(table.T[::-1])])

    return all(
        np.array_equal(ordered(corner_rows, values), ordered(image[corner_rows], values))
        for corner_rows, values in elements
    )
