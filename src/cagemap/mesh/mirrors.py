"""Mirror planes of control meshes, found from their positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

# In fractions of the bounding box diagonal: what most vertices' mirror images may be off by, and what all may.
MOST_WITHIN, ALL_WITHIN = 1e-3, 2e-2
MIN_SHARE = 0.95
# Vertices that the search for a plane looks at, and how often it moves the plane.
PLANE_SAMPLES, STEPS = 1000, 10
# A move that leaves this share of the mirror images' median distance leads nowhere, unless most of them lie near
# vertices already: within so many tolerances.
MAX_RATIO, NEAR_TOLERANCES = 0.9, 10.0
# Share of these vertices' mirror images that lie on vertices from which all vertices are asked.
MIN_SAMPLE_SHARE = 0.8
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
    """
    positions = control.positions
    diagonal = float(np.linalg.norm(np.ptp(positions, axis=0)))
    centre = positions.mean(axis=0)
    _, principal = np.linalg.eigh((positions - centre).T @ (positions - centre))
    tree = cKDTree(positions)
    sample = positions[:: max(1, len(positions) // PLANE_SAMPLES)]
    found: list[Mirror] = []
    for start in (*np.eye(3), *principal.T):
        settled = _settled_plane(sample, tree, start, float(start @ centre), diagonal)
        if settled is None:
            continue
        normal, offset = settled
        if any(abs(mirror.normal @ normal) > SAME_PLANE for mirror in found):
            continue
        plane = Mirror(np.zeros(0, np.int64), normal, offset, False)
        if np.mean(_query(tree, plane.reflect(sample))[0] <= MOST_WITHIN * diagonal) < MIN_SAMPLE_SHARE:
            continue
        distances, nearest = _query(tree, plane.reflect(positions))
        image, own = nearest, np.arange(len(positions))
        near = np.mean(distances <= MOST_WITHIN * diagonal) >= MIN_SHARE and distances.max() <= ALL_WITHIN * diagonal
        # A flat mesh mirrored onto itself says nothing.
        if near and np.mean(image[image] == own) >= MIN_SHARE and not np.array_equal(image, own):
            found.append(Mirror(image, normal, offset, is_symmetry(control, image)))
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


def _query(tree: cKDTree, points: FloatArray) -> tuple[FloatArray, IndexArray]:
    distances, nearest = tree.query(points)
    return np.asarray(distances), np.asarray(nearest, dtype=np.int64)


def is_symmetry(control: ControlMesh, image: IndexArray) -> bool:
    """Whether a permutation of the vertices sends faces to faces, and creases and corners to ones as sharp."""
    if not np.array_equal(np.sort(image), np.arange(control.n_vertices)):
        return False
    elements = []
    for size in np.unique(control.face_sizes):
        corners = control.face_offsets[:-1][control.face_sizes == size, None] + np.arange(size)
        elements.append((control.face_indices[corners], np.ones(len(corners))))
    if control.crease_edges is not None and control.crease_sharpness is not None:
        elements.append((control.crease_edges, control.crease_sharpness))
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        elements.append((control.corner_vertices[:, None], control.corner_sharpness))

    def ordered(vertices: IndexArray, values: FloatArray) -> FloatArray:
        """Elements above 0, their vertices ascending, with their values in lexicographic order."""
        table = np.column_stack([np.sort(vertices, axis=1), values])[values > 0]
        return np.asarray(table[np.lexsort(table.T[::-1])])

    return all(np.array_equal(ordered(one, values), ordered(image[one], values)) for one, values in elements)
