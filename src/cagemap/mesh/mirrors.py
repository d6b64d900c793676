"""Mirror planes of control meshes, found from their positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

# In fractions of the bounding box diagonal: what most vertices' mirror images may be off by, and what all may.
MOST_WITHIN, ALL_WITHIN = 1e-3, 2e-2
MOST = 0.95
# Vertices that the search for a plane looks at, and how often it moves the plane.
SAMPLES, STEPS = 1000, 10
# A move that leaves this share of the mirror images' median distance leads nowhere, unless most of them lie near
# vertices already: within so many tolerances.
NO_NEARER, ALREADY = 0.9, 10.0
# Share of these vertices' mirror images that lie on vertices from which all vertices are asked.
PROMISING = 0.8
# Planes whose normals are closer than this (cosine) are one.
SAME_PLANE = 0.99


@dataclass(frozen=True, eq=False)
class Mirror:
    """A mirror plane that a control mesh has, exactly or nearly."""

    image: IndexArray  #: (n,) the vertex nearest to every vertex's mirror image
    normal: FloatArray  #: (3,) unit vector; the plane is ``normal @ x == offset``
    offset: float
    exact: bool  #: whether the image is a permutation that sends faces to faces and creases to creases as sharp

    def reflect(self, points: FloatArray) -> FloatArray:
        """Mirror images of points, (q, 3)."""
        return points - 2.0 * np.outer(points @ self.normal - self.offset, self.normal)


def mirror_symmetries(control: ControlMesh) -> tuple[Mirror, ...]:
    """Find the mirror planes of a control mesh, exact ones first.

    A plane starts through the centroid, across a coordinate axis or a principal one, and moves to where the vertices'
    mirror images lie on vertices. It counts if 95 % of them do, within `MOST_WITHIN`, and none is far off; faces need
    not mirror, for cages are often triangulated without regard to it.

    Parameters
    ----------
    control : ControlMesh
    """
    positions = control.positions
    diagonal = float(np.linalg.norm(np.ptp(positions, axis=0)))
    centre = positions.mean(axis=0)
    _, principal = np.linalg.eigh((positions - centre).T @ (positions - centre))
    tree = cKDTree(positions)
    sample = positions[:: max(1, len(positions) // SAMPLES)]
    found: list[Mirror] = []
    for start in (*np.eye(3), *principal.T):
        settled = _settled_plane(sample, tree, start, float(start @ centre), diagonal)
        if settled is None:
            continue
        normal, offset = settled
        if any(abs(mirror.normal @ normal) > SAME_PLANE for mirror in found):
            continue
        plane = Mirror(np.zeros(0, np.int64), normal, offset, False)
        if np.mean(_query(tree, plane.reflect(sample))[0] <= MOST_WITHIN * diagonal) < PROMISING:
            continue
        distances, nearest = _query(tree, plane.reflect(positions))
        image, own = nearest, np.arange(len(positions))
        near = np.mean(distances <= MOST_WITHIN * diagonal) >= MOST and distances.max() <= ALL_WITHIN * diagonal
        # A flat mesh mirrored onto itself says nothing.
        if near and np.mean(image[image] == own) >= MOST and not np.array_equal(image, own):
            exact = sends_faces_to_faces(control, image) and sends_creases_to_creases(control, image)
            found.append(Mirror(image, normal, offset, exact))
    return tuple(sorted(found, key=lambda mirror: not mirror.exact))


def _settled_plane(
    sample: FloatArray, tree: cKDTree, normal: FloatArray, offset: float, diagonal: float
) -> tuple[FloatArray, float] | None:
    """Fit a plane to the pairs that it makes, repeatedly; None if half of the images are near no vertex."""
    before = np.inf
    for _ in range(STEPS):
        mirrored = sample - 2.0 * np.outer(sample @ normal - offset, normal)
        distances, nearest = _query(tree, mirrored)
        median = float(np.median(distances))
        if median > 0.1 * diagonal or median > max(NO_NEARER * before, ALREADY * MOST_WITHIN * diagonal):
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


def _query(tree: cKDTree, points: FloatArray) -> tuple[FloatArray, IndexArray]:
    distances, nearest = tree.query(points)
    return np.asarray(distances), np.asarray(nearest, dtype=np.int64)


def sends_faces_to_faces(control: ControlMesh, symmetry: IndexArray) -> bool:
    """Whether a self-map is a permutation under which the faces are the same sets of vertices."""
    if not np.array_equal(np.sort(symmetry), np.arange(control.n_vertices)):
        return False
    renamed = symmetry[control.face_indices]
    for size in np.unique(control.face_sizes):
        corners = control.face_offsets[:-1][control.face_sizes == size, None] + np.arange(size)
        if not np.array_equal(_ordered_rows(renamed[corners]), _ordered_rows(control.face_indices[corners])):
            return False
    return True


def sends_creases_to_creases(control: ControlMesh, image: IndexArray) -> bool:
    """Whether edges and vertices are as sharp as their images."""
    if control.crease_edges is not None and control.crease_sharpness is not None:
        edges, sharpness = control.crease_edges, control.crease_sharpness
        before, after = (_with_values(np.sort(pairs, axis=1), sharpness) for pairs in (edges, image[edges]))
        if not np.array_equal(before, after):
            return False
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        corners, sharpness = control.corner_vertices[:, None], control.corner_sharpness
        before, after = (_with_values(vertices, sharpness) for vertices in (corners, image[corners]))
        return np.array_equal(before, after)
    return True


def _with_values(elements: IndexArray, values: FloatArray) -> FloatArray:
    """Elements and their values side by side, those of value 0 left out, in lexicographic order."""
    table = np.column_stack([elements, values])[values > 0]
    return np.asarray(table[np.lexsort(table.T[::-1])])


def _ordered_rows(rows: IndexArray) -> IndexArray:
    """Every row ascending, rows in lexicographic order."""
    ascending = np.sort(rows, axis=1)
    return np.asarray(ascending[np.lexsort(ascending.T[::-1])])
