"""The control mesh ("cage"): polygons of any size, face-varying UVs, materials, creases, and how to subdivide it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from cagemap.errors import ParameterError
from cagemap.mesh.mesh_report import FileVertex
from cagemap.mesh.schemes import Scheme
from cagemap.numerics.arrays import FloatArray, IndexArray, array_of, offsets_of, real_numbers, whole_numbers
from cagemap.surface.triangles import fan_triangles, triangle_areas

NO_UV = (0.5, 0.5)  # UV of all corners of faces that have none, where other faces of the mesh have some
UNKNOWN_COLOR = 0.8  # linear grey of faces whose material has no colour; the default of most programs
MIN_UV_AREA = 1e-12  # triangles of a layout with less are degenerate; texels of a 16k image have 6e-5


@dataclass(frozen=True, eq=False)
class UvSet:
    """Additional face-varying texture coordinates of a mesh, not in use."""

    name: str
    uvs: FloatArray  #: (p, 2)
    uv_indices: IndexArray  #: (c,)


@dataclass(frozen=True, eq=False)
class ControlMesh:
    """Polygon control mesh of a subdivision surface.

    Faces are stored concatenated: face ``f`` has the vertices
    ``face_indices[face_offsets[f]:face_offsets[f + 1]]``, counter-clockwise seen from outside.
    """

    positions: FloatArray  #: (n, 3) vertex positions in the file's own length unit
    face_offsets: IndexArray  #: (m + 1,) start of each face in ``face_indices``; the first entry is 0, the last is c
    face_indices: IndexArray  #: (c,) vertex of every face corner
    uvs: FloatArray | None = None  #: (p, 2) face-varying texture coordinates, v up (v = 0 is the bottom image row)
    uv_indices: IndexArray | None = None  #: (c,) UV of every corner. An edge is a seam unless its faces share both
    uv_name: str = ""  #: name of these coordinates in the file, '' without one
    uv_sets: tuple[UvSet, ...] = ()  #: other UV sets of the file; `with_uv_set` selects one of them
    face_materials: IndexArray | None = None  #: (m,) index into ``material_names`` for every face
    material_names: tuple[str, ...] = ()
    material_colors: FloatArray | None = None  #: (q, 3) linear RGB diffuse colour of every material, NaN where unknown
    vertex_colors: FloatArray | None = None  #: (n, 3) sRGB colours, NaN for vertices without one
    face_objects: IndexArray | None = None  #: (m,) index into ``object_names`` for every face
    object_names: tuple[str, ...] = ()  #: faces before the first name in a file have the name ''
    object_schemes: tuple[Scheme, ...] = ()  #: of each object, where they differ; the whole cannot be subdivided
    face_groups: IndexArray | None = None  #: (m,) index into ``group_names`` for every face
    group_names: tuple[str, ...] = ()  #: faces before the first name in a file have the name ''
    crease_edges: IndexArray | None = None  #: (k, 2) vertices of every crease edge
    crease_sharpness: FloatArray | None = None  #: (k,) its sharpness; from 10 on it is infinite
    corner_vertices: IndexArray | None = None  #: (k,) sharp vertices
    corner_sharpness: FloatArray | None = None  #: (k,) their sharpness; from 10 on it is infinite
    hole_faces: IndexArray | None = None  #: (h,) faces that influence the surface but are no part of it
    file_vertices: IndexArray | None = None  #: (n,) numbers in the file, if the mesh is a part of a file's mesh
    file_faces: IndexArray | None = None  #: (m,) the same of the faces
    file_copies: IndexArray | None = None  #: (k, 2) vertex, and a further one of the file that was welded into it
    upright: FloatArray | None = None  #: (3, 3) rotation for rows to +Y up, by the file or its format; None: unknown
    scheme: Scheme | None = None  #: subdivision scheme in the file; None without one
    name: str = "mesh"  #: name of the mesh in messages; usually its file name

    def __repr__(self) -> str:
        return f"ControlMesh({self.name!r}, {self.n_vertices} vertices, {self.n_faces} faces)"

    def file_vertex(self, vertex: int) -> FileVertex:
        """A vertex by its number in the file, with its place."""
        x, y, z = self.positions[vertex].tolist()
        return FileVertex(int(self.file_numbers[0][vertex]), (x, y, z))

    @classmethod
    def from_faces(cls, positions: object, faces: object, *, name: str = "mesh") -> ControlMesh:
        """Build from a sequence of faces, each a sequence of vertex numbers (0-based).

        ``faces`` may also be an (m, d) integer array. ParameterError if the positions are not (n, 3), or a vertex
        number is no whole number.
        """
        vertices = np.array(real_numbers(positions, f"{name}: positions"))  # type: ignore[arg-type]
        if vertices.size and (vertices.ndim != 2 or vertices.shape[1] != 3):
            raise ParameterError(f"{name}: expected positions (n, 3), got an array {vertices.shape}. Give x, y and z.")
        if isinstance(faces, str) or not isinstance(faces, Iterable):
            raise ParameterError(f"{name}: expected faces as lists of vertex numbers, got {faces!r}")
        if hasattr(faces, "__array__"):
            faces = array_of(faces)
        if isinstance(faces, np.ndarray) and faces.ndim == 2:
            sizes, given = np.full(len(faces), faces.shape[1]), faces.ravel()
        else:  # of any sizes
            lists = [np.atleast_1d(np.asarray(face)) for face in faces]
            sizes = np.array([len(face) for face in lists], dtype=np.int64)
            given = np.concatenate(lists) if lists else np.zeros(0, dtype=np.int64)
        offsets = offsets_of(sizes)
        return cls(vertices.reshape(-1, 3), offsets, np.array(whole_numbers(given, f"{name}: faces")), name=name)

    @property
    def n_vertices(self) -> int:
        """Number of control vertices."""
        return len(self.positions)

    @property
    def n_faces(self) -> int:
        """Number of control faces."""
        return len(self.face_offsets) - 1

    @property
    def file_numbers(self) -> tuple[IndexArray, IndexArray]:
        """Numbers in the file of the vertices (n,) and of the faces (m,)."""
        vertices, faces = self.file_vertices, self.file_faces
        return (
            np.arange(self.n_vertices) if vertices is None else vertices,
            np.arange(self.n_faces) if faces is None else faces,
        )

    @property
    def face_sizes(self) -> IndexArray:
        """(m,) number of corners of every face."""
        return np.diff(self.face_offsets)

    @property
    def corner_faces(self) -> IndexArray:
        """(c,) face of every corner."""
        return np.repeat(np.arange(self.n_faces), self.face_sizes)

    @property
    def next_corners(self) -> IndexArray:
        """(c,) next corner of the same face."""
        following = np.arange(1, len(self.face_indices) + 1)
        following[self.face_offsets[1:] - 1] = self.face_offsets[:-1]
        return following

    @property
    def all_uv_sets(self) -> tuple[UvSet, ...]:
        """All sets of texture coordinates, the one in use first."""
        if self.uvs is None or self.uv_indices is None:
            return self.uv_sets
        return (UvSet(self.uv_name, self.uvs, self.uv_indices), *self.uv_sets)

    @property
    def has_layout(self) -> bool:
        """Whether texture coordinates span an area: some exporters write one for all corners."""
        if self.uvs is None or self.uv_indices is None:
            return False
        triangles, _ = fan_triangles(self.face_offsets, self.uv_indices)
        return bool((triangle_areas(self.uvs, triangles) > MIN_UV_AREA).any())

    def uv_corners(self) -> tuple[FloatArray, IndexArray]:
        """(t, 3, 2) texture coordinates of the corners of all triangles, and the (t,) face of each; no UVs: none."""
        if self.uvs is None or self.uv_indices is None:
            return np.zeros((0, 3, 2)), np.zeros(0, dtype=np.int64)
        triangles, faces = fan_triangles(self.face_offsets, self.uv_indices)
        return self.uvs[triangles], faces

    @property
    def partitions(self) -> tuple[tuple[str, IndexArray | None, tuple[str, ...]], ...]:
        """For objects, groups and materials: the kind, the index (m,) of every face or None, all names."""
        return (
            ("object", self.face_objects, self.object_names),
            ("group", self.face_groups, self.group_names),
            ("material", self.face_materials, self.material_names),
        )

    @property
    def face_colors(self) -> FloatArray | None:
        """(m, 3) linear RGB colour of every face by its material, NaN where there is none; None if no face has one."""
        if self.face_materials is None or self.material_colors is None or not len(self.material_colors):
            return None
        colors = np.where(self.face_materials[:, None] < 0, np.nan, self.material_colors[self.face_materials])
        return colors if np.isfinite(colors).any() else None

    @property
    def is_triangle_mesh(self) -> bool:
        """Whether every face is a triangle, as Loop subdivision requires."""
        return bool(np.all(self.face_sizes == 3))

    def face(self, index: int) -> IndexArray:
        """Vertex numbers of one face."""
        return self.face_indices[self.face_offsets[index] : self.face_offsets[index + 1]]

    def with_positions(self, positions: FloatArray) -> ControlMesh:
        """Return the same connectivity with other positions, one for every vertex; else ParameterError."""
        given = real_numbers(positions, f"{self.name}: positions")
        if given.shape != self.positions.shape:
            raise ParameterError(f"{self.name}: expected positions {self.positions.shape}, got an array {given.shape}")
        return replace(self, positions=given)

    def with_uv_set(self, name: str) -> ControlMesh:
        """Return the same mesh using the named UV set; ParameterError if there is none."""
        if name == self.uv_name and self.uvs is not None:
            return self
        chosen = next((uv_set for uv_set in self.uv_sets if uv_set.name == name), None)
        if chosen is None:
            known = ", ".join(repr(uv_set.name) for uv_set in self.all_uv_sets)
            raise ParameterError(
                f"{self.name}: expected a UV set named {name!r}, got {known or 'none at all'}; name one of those"
            )
        return self.with_uv_sets((chosen, *(uv_set for uv_set in self.all_uv_sets if uv_set is not chosen)))

    def with_uv_sets(self, sets: Sequence[UvSet]) -> ControlMesh:
        """Return the same mesh with other UV sets, the first of them in use."""
        if not sets:
            return replace(self, uvs=None, uv_indices=None, uv_name="", uv_sets=())
        first, *others = sets
        return replace(self.with_uvs(first.uvs, first.uv_indices), uv_name=first.name, uv_sets=tuple(others))

    def with_creases(self, edges: ArrayLike, sharpness: ArrayLike) -> ControlMesh:
        """Return the same mesh with other creases: (k, 2) vertices of edges and (k,) or one sharpness."""
        pairs = np.array(whole_numbers(edges, f"{self.name}: crease edges"))
        if pairs.size % 2:
            raise ParameterError(f"{self.name}: expected crease edges (k, 2), got an array {pairs.shape}")
        pairs = pairs.reshape(-1, 2)
        return replace(self, crease_edges=pairs, crease_sharpness=self._sharpness(sharpness, len(pairs)))

    def without_sharpness(self) -> ControlMesh:
        """Return the same mesh without creases and sharp corners."""
        return replace(self, crease_edges=None, crease_sharpness=None, corner_vertices=None, corner_sharpness=None)

    def with_corners(self, vertices: ArrayLike, sharpness: ArrayLike) -> ControlMesh:
        """Return the same mesh with other sharp corners: (k,) vertices and (k,) or one sharpness."""
        corners = np.array(whole_numbers(vertices, f"{self.name}: corner vertices")).ravel()
        return replace(self, corner_vertices=corners, corner_sharpness=self._sharpness(sharpness, len(corners)))

    def _sharpness(self, given: ArrayLike, count: int) -> FloatArray:
        """(count,) sharpness values, from an array of this length or one number for all."""
        values = real_numbers(given, f"{self.name}: sharpness")
        if values.shape not in ((), (1,), (count,)):
            raise ParameterError(f"{self.name}: expected one sharpness, or {count}, got an array {values.shape}")
        return np.array(np.broadcast_to(values, count))

    def with_uvs(self, uvs: FloatArray | None, uv_indices: IndexArray | None) -> ControlMesh:
        """Return the same mesh with other UVs (p, 2) and their index for every corner, or none; else ParameterError."""
        if uvs is None or uv_indices is None:
            return replace(self, uvs=None, uv_indices=None)
        places, indices = real_numbers(uvs, f"{self.name}: uvs"), whole_numbers(uv_indices, f"{self.name}: uv_indices")
        if places.ndim != 2 or places.shape[1] != 2 or indices.shape != self.face_indices.shape:
            raise ParameterError(
                f"{self.name}: expected uvs (p, 2) and uv_indices {self.face_indices.shape}, one for every corner of "
                f"the faces, got {places.shape} and {indices.shape}"
            )
        return replace(self, uvs=places, uv_indices=indices)
