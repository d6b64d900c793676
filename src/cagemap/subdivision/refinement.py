"""Subdivide a control mesh: the mesh of every level, and the matrices between levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import cage_triangles, faces_of_one_size, labels_of, split_into_fans
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import extract_faces
from cagemap.mesh.schemes import INFINITE_SHARPNESS, SCHEMES, Bilinear, CatmullClark, Loop, Plain, Scheme
from cagemap.mesh.structure_checks import require_structure
from cagemap.mesh.topology import BoolArray, mesh_topology
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys, places_of, whole_numbers
from cagemap.numerics.threads import kept
from cagemap.subdivision.face_varying import Layout, refined_layout
from cagemap.subdivision.matrices import subdivision_matrix
from cagemap.subdivision.topology import children, control_state, control_topology, next_state
from cagemap.surface.triangles import triangles as triangles

ENTRIES_PER_CORNER = 25  # nonzeros of the second S per control corner, about; each further S has 4 times as many


@dataclass(frozen=True, eq=False, repr=False)
class Level:
    """Mesh of one level."""

    positions: FloatArray  #: (n, 3) vertices, in the control mesh's length unit; not on the limit surface
    corners: NDArray[np.integer] | None  #: `faces` as stored: int32 after refinement
    face_parents: IndexArray  #: (m,) control face of every face
    lay: Callable[[], Layout] | None = None  #: gives UVs (p, 2) and the UV of every corner of ``faces``

    @property
    def faces(self) -> IndexArray | None:
        """(m, 4) or (m, 3); None at level 0 of other faces, see ``Refinement.control``."""
        return None if self.corners is None else self.corners.astype(np.int64, copy=False)

    @kept
    def layout(self) -> Layout | None:
        """UVs and the UV of every face corner; computed when first read."""
        return None if self.lay is None else self.lay()

    @property
    def uvs(self) -> FloatArray | None:
        """(p, 2) UVs of the level, None if the control mesh has none."""
        return None if self.layout is None else self.layout[0]

    @property
    def uv_indices(self) -> IndexArray | None:
        """UV of every face corner, in the shape of ``faces``, or None."""
        return None if self.layout is None else self.layout[1]

    def with_uvs(self, uvs: FloatArray, uv_indices: IndexArray) -> Level:
        """The same level with other UVs (p, 2) and UV indices in the shape of ``faces``."""
        picklable = partial(tuple, (uvs, uv_indices))  # unlike a lambda
        return replace(self, lay=picklable)  # type: ignore[arg-type]

    @property
    def n_vertices(self) -> int:
        """Number of vertices."""
        return len(self.positions)

    @property
    def n_faces(self) -> int:
        """Number of faces."""
        return len(self.face_parents)

    def __repr__(self) -> str:
        return f"Level({self.n_vertices} vertices, {self.n_faces} faces)"


@dataclass(frozen=True, eq=False, repr=False)
class Refinement:
    """A control mesh and its refined levels, ``X^{l+1} = S^l X^l`` (paper, section 2.2.1)."""

    control: ControlMesh
    scheme: Scheme
    #: ``matrices[l]`` is S^l (n_{l+1}, n_l); rows sum to 1. Vertex points come first, then edge points, then face
    #: points (Loop has none), so vertex i keeps its number on finer levels. Plain meshes: see ``coarse_vertices``.
    matrices: tuple[csr_array, ...]
    levels: tuple[Level, ...]  #: ``levels[0]`` is the control mesh, ``levels[-1]`` the finest
    #: (n_{L-1},) for a plain mesh with coarse levels (`cagemap.operators.coarse_levels`): the number in the finest
    #: level of every vertex of the next coarser level. None in a subdivision, where vertices keep numbers.
    coarse_vertices: IndexArray | None = None

    @property
    def finest(self) -> Level:
        """The finest level."""
        return self.levels[-1]

    @property
    def finest_level(self) -> int:
        """Number of refinement steps L; levels are numbered 0 to L."""
        return len(self.matrices)

    def coarsest_level(self, vertices: int) -> int:
        """Number of the coarsest level with at least ``vertices``; the finest one if none has."""
        enough = (number for number, level in enumerate(self.levels) if level.n_vertices >= vertices)
        return next(enough, self.finest_level)

    def up_to(self, level: int) -> Refinement:
        """The refinement with levels 0 to ``level`` only."""
        known = self.coarse_vertices if level == self.finest_level else None
        return replace(self, matrices=self.matrices[:level], levels=self.levels[: level + 1], coarse_vertices=known)

    def without_coarse_levels(self) -> Refinement:
        """The refinement without the coarse levels of a plain mesh."""
        if self.coarse_vertices is None:
            return self
        return replace(self, matrices=(), levels=self.levels[-1:], coarse_vertices=None)

    @property
    def is_plain(self) -> bool:
        """Whether the finest level is the control mesh itself."""
        return isinstance(self.scheme, Plain)

    def on_finest(self, level: int) -> IndexArray:
        """(n_level,) finest vertex of every vertex of a level."""
        return self.vertices_on(self.finest_level, level)

    def vertices_on(self, fine: int, coarse: int) -> IndexArray:
        """(n_coarse,) vertex of the fine level for every vertex of the coarse level."""
        self._check_order(fine, coarse)
        n = self.levels[coarse].n_vertices
        if self.coarse_vertices is None or fine < self.finest_level or coarse == self.finest_level:
            return np.arange(n)
        return self.coarse_vertices[:n]

    def on_level(self, level: int, vertices: IndexArray) -> IndexArray:
        """(m,) vertices of a level for given finest vertices; -1 if the level lacks them, or for -1."""
        if self.coarse_vertices is not None and level < self.finest_level:
            vertices = np.where(vertices < 0, -1, self._coarse_numbers[vertices])
        return np.where(vertices < self.levels[level].n_vertices, vertices, -1)

    @kept
    def _coarse_numbers(self) -> IndexArray:
        """(n,) vertex of the last coarse level for every finest vertex of a plain mesh, or -1."""
        assert self.coarse_vertices is not None
        return places_of(self.coarse_vertices, self.finest.n_vertices)

    def faces(self, level: int) -> IndexArray:
        """(m, 4) or (m, 3) faces of a level; mixed faces of a control mesh are split into fans."""
        faces = self.levels[level].faces
        return cage_triangles(self.control)[0] if faces is None else faces

    def holes(self, level: int) -> BoolArray:
        """(m_level,) whether a face of `faces` is a hole, see `control_holes`."""
        mixed, parents = self.levels[level].faces is None, self.levels[level].face_parents
        return control_holes(self.control, self.scheme)[cage_triangles(self.control)[1] if mixed else parents]

    def product(self, fine: int, coarse: int) -> csr_array:
        """Matrix ``S^{fine,coarse} = S^{fine-1} ... S^{coarse}`` (n_fine, n_coarse); the identity for equal levels."""
        return self.rows(slice(None), fine, coarse)

    def rows(self, vertices: IndexArray | slice, fine: int, coarse: int) -> csr_array:
        """Rows (m, n_coarse) of ``S^{fine,coarse}`` for vertices (m,), computed alone; ParameterError for others."""
        self._check_order(fine, coarse)
        n = self.levels[fine].n_vertices
        chosen = np.arange(n)[vertices] if isinstance(vertices, slice) else whole_numbers(vertices, "vertices")
        if len(chosen) and not 0 <= chosen.min() <= chosen.max() < n:
            raise ParameterError(
                f"vertices: expected 0 to {n - 1} of level {fine}, got {chosen.min()} to {chosen.max()}"
            )
        arrays = np.ones(len(chosen)), chosen.astype(np.int32), np.arange(len(chosen) + 1, dtype=np.int32)
        rows = csr_array(arrays, shape=(len(chosen), n))
        for matrix in reversed(self.matrices[coarse:fine]):
            rows = rows @ matrix
        rows.sort_indices()
        return rows

    def prolong(self, values: FloatArray, coarse: int, fine: int) -> FloatArray:
        """Refine functions (n_coarse,) or (n_coarse, q): ``S^{fine,coarse} values``, applied factor by factor."""
        self._check_order(fine, coarse)
        if np.shape(values)[:1] != (self.levels[coarse].n_vertices,):
            raise ParameterError(
                f"values: expected {self.levels[coarse].n_vertices} rows, one per vertex of level {coarse}, "
                f"got shape {np.shape(values)}"
            )
        for level in range(coarse, fine):
            values = self.matrices[level] @ values
        return values

    def _check_order(self, fine: int, coarse: int) -> None:
        if not 0 <= coarse <= fine <= self.finest_level:
            raise ParameterError(
                f"levels: expected 0 <= coarse <= fine <= {self.finest_level}, got coarse {coarse} and fine {fine}; "
                "level 0 is the control mesh, and the finest level is the number of refinement steps"
            )

    def __str__(self) -> str:
        head = f"{self.control.name}: {self.scheme}"
        lines = [head, f"{'level':>5} {'vertices':>10} {'faces':>10} {'nonzeros of S':>14}"]
        for number, level in enumerate(self.levels):
            nonzeros = str(self.matrices[number].nnz) if number < self.finest_level else "-"
            lines.append(f"{number:>5} {level.n_vertices:>10} {level.n_faces:>10} {nonzeros:>14}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        sizes = ", ".join(str(level.n_vertices) for level in self.levels)
        return f"Refinement({self.control.name!r}, {self.scheme}, vertices per level: {sizes})"


def default_scheme(control: ControlMesh) -> Scheme:
    """Scheme of the mesh's file; without one, Loop for triangle meshes and Catmull-Clark for others."""
    return usual_scheme(control) if control.scheme is None else control.scheme


def usual_scheme(control: ControlMesh) -> Scheme:
    """Loop for triangle meshes and Catmull-Clark for others."""
    return Loop() if control.is_triangle_mesh else CatmullClark()


def with_options(
    control: ControlMesh,
    scheme: str | None = None,
    boundary: str | None = None,
    uv_interpolation: str | None = None,
    creasing: str | None = None,
) -> ControlMesh:
    """The same mesh with another scheme of `SCHEMES` and other `SubdivisionOptions`; None leaves a value unchanged."""
    before = default_scheme(control)
    if scheme is not None and scheme not in SCHEMES:
        raise ParameterError(f"scheme: expected one of {', '.join(SCHEMES)}, got {scheme!r}")
    kind = type(before) if scheme is None else SCHEMES[scheme]
    asked = {"boundary": boundary, "uv_interpolation": uv_interpolation, "creasing": creasing}
    options = asdict(before) | {name: value for name, value in asked.items() if value is not None}
    return replace(control, scheme=kind(**options))


@arrays_accepted
def refine(control: MeshLike, levels: int, scheme: Scheme | None = None) -> Refinement:
    """Subdivide a control mesh ``levels`` times, in linear time and memory of the finest level.

    Each step multiplies the number of faces by about 4. From level 1 on UVs are numbered by pairs of a vertex and a UV.
    The scheme is `default_scheme` unless given. InvalidMeshError if the mesh is not an oriented manifold, or has faces
    other than triangles under Loop; ParameterError if ``levels`` is negative, or a matrix would have 2^31 entries.

    Examples
    --------
    >>> from cagemap import ControlMesh
    >>> corners = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
    >>> tetrahedron = ControlMesh.from_faces(corners, [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)])
    >>> [level.n_vertices for level in refine(tetrahedron, 2).levels]
    [4, 10, 34]
    """
    require_structure(control)
    scheme = default_scheme(control) if scheme is None else scheme
    if levels < 0:
        raise ParameterError(f"levels: expected 0 or more refinement steps, got {levels}")
    if isinstance(scheme, Plain) and levels:
        raise ParameterError(
            f"levels: {control.name} is a plain mesh (scheme none) and is never refined, expected 0, got {levels}; "
            "ask for bilinear to split its faces"
        )
    if isinstance(scheme, Loop) and not control.is_triangle_mesh:
        others = np.flatnonzero(control.face_sizes != 3)
        raise InvalidMeshError(
            f"{control.name}: Loop expects triangles only, got {len(others)} other faces: {first_few(others)}; "
            "use Catmull-Clark, which takes faces of any size"
        )
    state = control_state(control, scheme)
    entries = ENTRIES_PER_CORNER * state.topology.n_corners * 4 ** max(levels - 2, 0)
    if entries >= 2**31:
        raise ParameterError(
            f"levels: expected fewer than 2^31 matrix entries, got about {entries} with {levels} levels of "
            f"{control.n_faces} control faces; ask for fewer levels"
        )
    has_uvs = control.uvs is not None and control.uv_indices is not None
    matrices, result = list[csr_array](), [control_level(control)]
    for step in range(levels):
        state = next_state(state, scheme) if step else state
        matrices.append(subdivision_matrix(state, scheme))
        positions, parents = matrices[-1] @ result[-1].positions, result[-1].face_parents
        parents = np.repeat(parents, 4) if isinstance(scheme, Loop) else parents[state.topology.faces]
        lay = partial(refined_layout, control, step + 1, scheme) if has_uvs else None
        result.append(Level(positions, children(state.topology, scheme), parents, lay))
    return Refinement(control, scheme, tuple(matrices), tuple(result))


def control_holes(control: ControlMesh, scheme: Scheme) -> BoolArray:
    """(m,) whether a control face is a hole: in the file, or under ``none`` at a boundary that is not all sharp."""
    holes = np.zeros(control.n_faces, dtype=bool)
    if control.hole_faces is not None:
        holes[control.hole_faces] = True
    if scheme.boundary == "none" and not isinstance(scheme, Bilinear):
        topology, n = control_topology(control), control.n_vertices
        outer = topology.edge_ends[topology.outer_edges].astype(np.int64)
        if control.crease_edges is not None and control.crease_sharpness is not None:
            infinite = control.crease_edges[control.crease_sharpness >= INFINITE_SHARPNESS]
            outer = outer[~np.isin(pair_keys(outer, n), pair_keys(infinite, n))]
        not_sharp = np.zeros(n, dtype=bool)
        not_sharp[outer] = True
        holes[control.corner_faces[not_sharp[control.face_indices]]] = True
    return holes


def control_level(control: ControlMesh) -> Level:
    """Level 0 of a refinement of ``control``."""
    faces = faces_of_one_size(control)
    level = Level(control.positions, faces, np.arange(control.n_faces))
    if control.uvs is None or control.uv_indices is None or faces is None:
        return level
    return level.with_uvs(control.uvs, control.uv_indices.reshape(faces.shape))


def level_triangles(refinement: Refinement, level: int) -> IndexArray:
    """(t, 3) triangles of a level: quads split by `triangles`, n-gons into fans."""
    return triangles(refinement.faces(level))


def vertex_counts(control: ControlMesh, scheme: Scheme | None = None) -> Iterator[int]:
    """Yield the number of vertices of level 0, 1, 2, ... without end; default: `default_scheme`."""
    loop = isinstance(default_scheme(control) if scheme is None else scheme, Loop)
    vertices, faces, corners = control.n_vertices, control.n_faces, len(control.face_indices)
    edges = mesh_topology(control).n_edges
    while True:
        yield vertices
        vertices += edges + (0 if loop else faces)
        edges = 2 * edges + corners
        faces = 4 * faces if loop else corners
        corners = (3 if loop else 4) * faces


def finest_mesh(refinement: Refinement) -> ControlMesh:
    """Finest level as a mesh with all UV sets, colours and labels, without creases and holes.

    Level 0 is returned unchanged. InvalidMeshError if all faces are holes.
    """
    finest, control = refinement.finest, refinement.control
    if finest.faces is None or refinement.finest_level == 0:
        return control
    colors = control.vertex_colors
    if colors is not None:
        known = np.isfinite(colors).all()  # else some vertices have none
        colors = np.clip(refinement.prolong(colors, 0, refinement.finest_level), 0.0, 1.0) if known else None
    mesh = replace(
        control.without_sharpness(),
        positions=finest.positions,
        face_offsets=np.arange(0, finest.faces.size + 1, finest.faces.shape[1]),
        face_indices=finest.faces.ravel(),
        uvs=finest.uvs,
        uv_indices=None if finest.uv_indices is None else finest.uv_indices.ravel(),
        **labels_of(control, finest.face_parents),
        uv_sets=tuple(_refined_uvs(refinement, uv_set) for uv_set in control.uv_sets),
        vertex_colors=colors,
        hole_faces=None,
        file_vertices=None,
        file_faces=None,
        file_copies=None,
        scheme=None,
    )
    holes = refinement.holes(refinement.finest_level)
    if not holes.any():
        return mesh
    if holes.all():
        raise InvalidMeshError(f"{control.name}: expected a face that is no hole, got none. Change boundary or holes.")
    shown = extract_faces(mesh, np.flatnonzero(~holes))
    return replace(shown, file_vertices=None, file_faces=None, scheme=None, object_schemes=mesh.object_schemes)


def _refined_uvs(refinement: Refinement, uv_set: UvSet) -> UvSet:
    """Refine a UV set that is not in use."""
    alone = replace(refinement.control, uvs=uv_set.uvs, uv_indices=uv_set.uv_indices, uv_sets=())
    uvs, uv_indices = refined_layout(alone, refinement.finest_level, refinement.scheme)
    return UvSet(uv_set.name, uvs, uv_indices.ravel())


def truncate_refinement(refinement: Refinement, level: int) -> Refinement:
    """Levels 0 to ``level``; if only level 0 is left, its polygons are split into fans."""
    shortened, control = refinement.up_to(level), refinement.control
    if shortened.finest.faces is not None:
        return shortened
    fans = replace(control_level(split_into_fans(control)), face_parents=cage_triangles(control)[1])
    return replace(shortened, levels=(fans,))
