"""Numbers of vertices of refined levels, without refining."""

from __future__ import annotations

from collections.abc import Iterator

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Loop, Scheme
from cagemap.mesh.topology import edge_table
from cagemap.subdivision.refinement import default_scheme


def vertex_counts(control: ControlMesh, scheme: Scheme | None = None) -> Iterator[int]:
    """Number of vertices of level 0, 1, 2, ... without end; by default under `default_scheme`.

    A step adds a vertex per edge and, but for Loop, per face; it splits every edge and adds one per corner.

    Examples
    --------
    >>> from itertools import islice
    >>> from cagemap import ControlMesh
    >>> corners = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
    >>> tetrahedron = ControlMesh.from_faces(corners, [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)])
    >>> list(islice(vertex_counts(tetrahedron), 4))
    [4, 10, 34, 130]
    """
    loop = isinstance(default_scheme(control) if scheme is None else scheme, Loop)
    vertices, faces, corners = control.n_vertices, control.n_faces, len(control.face_indices)
    edges = len(edge_table(control).vertices)
    while True:
        yield vertices
        vertices += edges + (0 if loop else faces)
        edges = 2 * edges + corners
        faces = 4 * faces if loop else corners
        corners = (3 if loop else 4) * faces
