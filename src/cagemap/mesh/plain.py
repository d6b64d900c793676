"""Repair plain meshes, such as scans and generated meshes, so that they can be matched without subdivision.

Matching needs a connected, oriented manifold. Faults are repaired where the repair is unambiguous; other faces and
vertices are removed. `Repairs` counts the changes.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh.checks import extra_faces, inside_out_problem, zero_area_problem
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import (
    degenerate_faces,
    duplicate_faces,
    face_areas,
    keep_faces,
    reversed_corners,
    with_corners_of,
)
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.mesh_report import count_noun
from cagemap.mesh.parts import extract_faces
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import require_structure
from cagemap.mesh.topology import (
    boundary_loops,
    corner_fans,
    face_components,
    mesh_topology,
    turned_faces,
    used_vertices,
)
from cagemap.mesh.weld import coincident_vertices, file_copies, weld_tolerance
from cagemap.numerics.arrays import IndexArray
from cagemap.numerics.kinds import Brief
from cagemap.surface.triangles import fan_triangles

# Most rounds of removing faces at edges of more than two faces; scans need two.
MAX_FIN_ROUNDS = 20


@dataclass(frozen=True, repr=False)
class Repairs(Brief):
    """Number of repairs of each kind that `plain_mesh` made."""

    #: vertices merged with another at the same position: on borders (files that repeat vertices face by face) or on
    #: edges of length zero
    joined_vertices: int = 0
    split_faces: int = 0  #: faces of another size than most, because of which all faces were split into triangles
    dropped_faces: int = 0  #: removed faces: with a repeated vertex, copies of other faces, and holes of the file
    fins: int = 0  #: faces removed at edges of more than two faces
    cut_vertices: int = 0  #: vertices copied for every part, where parts touched only in an edge or a point
    turned_faces: int = 0  #: faces reversed to agree with their neighbours, or to look outwards
    pieces: int = 0  #: removed smaller pieces: nothing is matched or transferred there
    pieces_share: float = 0.0  #: their share of the area
    pieces_vertices: int = 0  #: their vertices
    pieces_weld: float = 0.0  #: tolerance of `cagemap.mesh.weld.weld_mesh` that joins pieces; 0 if none does
    loose_vertices: int = 0  #: removed vertices without faces
    slivers: int = 0  #: faces without area; they are kept
    openings: int = 0  #: boundary loops; they stay open

    def sentences(self) -> tuple[str, ...]:
        """One sentence for the user about every kind of repair made."""
        remedy = "`find_part` each matches every piece with its counterpart"
        if self.pieces_weld:
            remedy = f"`weld_mesh` {self.pieces_weld:g} joins pieces that lie against each other"
        count_of = {
            f"{count_noun(self.joined_vertices, 'vertex')} joined with others at the same place": self.joined_vertices,
            "faces of different sizes are split into triangles": self.split_faces,
            f"{count_noun(self.dropped_faces, 'face')} left out: copies, holes, or with a repeated vertex": (
                self.dropped_faces
            ),
            f"{count_noun(self.fins, 'face')} left out at edges of more than two faces": self.fins,
            f"{count_noun(self.cut_vertices, 'vertex')} split where parts only touch": self.cut_vertices,
            f"{count_noun(self.turned_faces, 'face')} turned round": self.turned_faces,
            f"{count_noun(self.pieces, 'smaller piece')} set aside ({count_noun(self.pieces_vertices, 'vertex')}, "
            f"{100 * self.pieces_share:.1f} % of the area): nothing is matched or transferred there. "
            f"{remedy}": self.pieces,
            f"{count_noun(self.loose_vertices, 'vertex')} of no face set aside": self.loose_vertices,
            f"{count_noun(self.slivers, 'face')} without area kept": self.slivers,
            f"{count_noun(self.openings, 'opening')} left open": self.openings,
        }
        return tuple(sentence for sentence, count in count_of.items() if count)

    def sentences_of_body(self) -> tuple[str, ...]:
        """`sentences` for `cagemap rig`, which moves smaller pieces along with the body."""
        if not self.pieces:
            return self.sentences()
        pieces = f"{count_noun(self.pieces, 'smaller piece')} ({count_noun(self.pieces_vertices, 'vertex')})"
        return (f"{pieces} not matched: `cagemap rig` carries them along", *replace(self, pieces=0).sentences())

    def summary(self) -> dict[str, float]:
        """Numbers other than zero by name, for a manifest."""
        return {name: value for name, value in asdict(self).items() if value}


@dataclass(frozen=True, eq=False)
class PlainMesh:
    """A connected manifold mesh that is matched without subdivision.

    Attributes
    ----------
    mesh : ControlMesh
        With the scheme `Plain`. Vertices and faces keep their order; if some were removed, ``file_vertices`` and
        ``file_faces`` are the numbers of the remaining ones.
    vertex_of : (n_given,) int64
        Vertex of ``mesh`` for every vertex of the mesh given, -1 for removed ones.
    repairs : Repairs
    """

    mesh: ControlMesh
    vertex_of: IndexArray = field(repr=False)
    repairs: Repairs

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about the repairs, each with the mesh's name."""
        return tuple(f"{self.mesh.name}: {sentence}" for sentence in self.repairs.sentences())


@arrays_accepted
def plain_mesh(mesh: MeshLike) -> PlainMesh:
    """Repair a mesh so that it can be matched without subdivision (scheme none).

    Joins repeated vertices, removes degenerate and duplicate faces, separates parts that only touch, orients faces
    consistently and removes smaller pieces. A mesh without these faults keeps its vertex and face numbers.
    InvalidMeshError if the arrays are no mesh, or the mesh is one-sided or has no area.
    """
    require_structure(mesh)
    work = replace(
        mesh.without_sharpness(),
        scheme=Plain(),
        file_vertices=np.arange(mesh.n_vertices),  # numbers on the mesh given; replaced by those in the file below
        file_faces=np.arange(mesh.n_faces),
        file_copies=None,
    )
    representative = coincident_vertices(work, collapse=True)
    joined = np.flatnonzero(representative != np.arange(mesh.n_vertices))
    if len(joined):
        work = replace(work, face_indices=representative[work.face_indices])
    holes = np.zeros(0, dtype=np.int64) if mesh.hole_faces is None else mesh.hole_faces
    work = keep_faces(work, np.delete(np.arange(mesh.n_faces), holes)) if len(holes) else work
    work = replace(work, hole_faces=None)
    if not np.any(work.face_sizes >= 3):
        raise InvalidMeshError(f"{mesh.name}: expected faces of three corners or more that are no holes, got none")
    work, split = _of_one_face_size(work)
    bad = np.union1d(degenerate_faces(work), duplicate_faces(work))
    if len(bad) == work.n_faces:
        raise InvalidMeshError(f"{mesh.name}: expected faces, got {work.n_faces} that visit a vertex twice")
    work = keep_faces(work, np.delete(np.arange(work.n_faces), bad)) if len(bad) else work
    work, fins, cut = _manifold(work)
    faces = turned_faces(mesh_topology(work))
    if faces is None:
        raise InvalidMeshError(
            f"{mesh.name}: expected a surface with an inside and an outside, got one where no choice of face "
            "directions agrees along all edges (as on a Moebius strip). Cut it where its two sides are joined."
        )
    work, turned = turn_faces(work, faces), int(faces.sum())
    work, aside = _largest_piece(work)
    if not face_areas(work).sum() > 0.0:
        raise InvalidMeshError(
            f"{mesh.name}: expected a surface with an area, got {work.n_faces} faces without. "
            "Repair it in a modelling program."
        )
    problem = inside_out_problem(work, _loops(work))
    inwards = problem is not None and problem.kind == "inside out"
    work = turn_faces(work, np.ones(work.n_faces, dtype=bool)) if inwards else work
    repairs = replace(
        aside,
        joined_vertices=len(joined),
        split_faces=split,
        dropped_faces=len(bad) + len(holes),
        fins=fins,
        cut_vertices=cut,
        turned_faces=work.n_faces - turned if inwards else turned,
        pieces_weld=(weld_tolerance(mesh) or 0.0) if aside.pieces else 0.0,
        loose_vertices=int(mesh.n_vertices - used_vertices(mesh).sum()),
    )
    changed = bool(repairs.summary())
    ready = extract_faces(work, np.arange(work.n_faces)) if changed else work
    sliver = zero_area_problem(ready, np.arange(ready.n_faces))
    repairs = replace(repairs, slivers=0 if sliver is None else len(sliver.elements), openings=len(_loops(ready)))
    vertices, own_faces = ready.file_vertices, ready.file_faces
    assert vertices is not None
    assert own_faces is not None
    vertex_of = np.full(mesh.n_vertices, -1, dtype=np.int64)
    vertex_of[vertices[::-1]] = np.arange(len(vertices))[::-1]  # the first copy of a split vertex
    vertex_of = vertex_of[representative]

    def in_file(numbers: IndexArray | None, kept: IndexArray) -> IndexArray | None:
        return numbers if not changed else kept if numbers is None else numbers[kept]

    ready = replace(
        ready,
        file_vertices=in_file(mesh.file_vertices, vertices),
        file_faces=in_file(mesh.file_faces, own_faces),
        file_copies=file_copies(mesh, joined, vertex_of),
    )
    return PlainMesh(ready, vertex_of, repairs)


def _of_one_face_size(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Split faces into triangles unless all are triangles, or valid quads; also the number of other faces."""
    sizes = mesh.face_sizes
    size = int(np.bincount(sizes).argmax())
    odd = sizes != size
    odd[degenerate_faces(mesh)] |= size == 4
    if size == 3 and not np.any(sizes > 3):
        return mesh, 0  # faces of fewer corners are removed later
    if size == 4 and not odd.any():
        return mesh, 0
    corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    return with_corners_of(mesh, faces, 3 * np.arange(len(faces) + 1), corners.ravel()), max(int(odd.sum()), 1)


def _manifold(mesh: ControlMesh) -> tuple[ControlMesh, int, int]:
    """Remove fins and separate sheets that only touch; also counts of removed faces and cut vertices."""
    n_faces, cut, topology = mesh.n_faces, 0, mesh_topology(mesh)
    surplus = extra_faces(topology)
    for _ in range(MAX_FIN_ROUNDS):
        if surplus.all():
            break
        mesh = keep_faces(mesh, np.flatnonzero(~surplus)) if surplus.any() else mesh
        mesh, newly_cut = _one_fan_per_vertex(mesh)
        cut, topology = cut + newly_cut, mesh_topology(mesh)
        bad = topology.face_counts > 2
        if not bad.any():
            return mesh, n_faces - mesh.n_faces, cut
        # Faces joined around the split vertices: it is ambiguous which of them belong together.
        surplus = np.logical_or.reduceat(bad[topology.edges], mesh.face_offsets[:-1])
    raise InvalidMeshError(
        f"{mesh.name}: expected a surface, got faces that meet in more than two at nearly all edges. "
        "Repair it in a modelling program."
    )


def _one_fan_per_vertex(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Give every fan of faces its own vertex, copies last; also the number of vertices copied."""
    topology = mesh_topology(mesh)
    many = (topology.face_counts > 2)[topology.edges]  # such edges join no faces
    edges = topology.edges.copy()
    edges[many] = topology.n_edges + np.arange(many.sum())
    fans = corner_fans(replace(topology, edges=edges))
    _, first = np.unique(fans, return_index=True)
    vertices = mesh.face_indices[first]
    order = np.argsort(vertices, kind="stable")
    repeated = np.zeros(len(vertices), dtype=bool)
    repeated[order[1:]] = vertices[order[1:]] == vertices[order[:-1]]
    if not repeated.any():
        return mesh, 0
    number = vertices.copy()
    number[repeated] = mesh.n_vertices + np.arange(repeated.sum())
    copied = vertices[repeated]
    source = np.concatenate([np.arange(mesh.n_vertices), copied])
    assert mesh.file_vertices is not None
    return replace(
        mesh,
        positions=mesh.positions[source],
        face_indices=number[fans],
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[source],
        file_vertices=mesh.file_vertices[source],
    ), len(np.unique(copied))


def turn_faces(mesh: ControlMesh, faces: NDArray[np.bool_]) -> ControlMesh:
    """Reverse faces (m,) of a mesh, keeping first corners and quads' diagonals."""
    if not faces.any():
        return mesh
    corners = np.arange(len(mesh.face_indices))
    corners = np.where(faces[mesh.corner_faces], reversed_corners(mesh.face_offsets), corners)
    return with_corners_of(mesh, np.arange(mesh.n_faces), mesh.face_offsets, corners)


def _largest_piece(mesh: ControlMesh) -> tuple[ControlMesh, Repairs]:
    """Keep the connected piece of largest area; also counts of removed pieces."""
    labels = face_components(mesh)
    count = int(labels.max()) + 1
    if count == 1:
        return mesh, Repairs()
    areas = np.bincount(labels, face_areas(mesh), minlength=count)
    kept = labels == areas.argmax()
    share = 1.0 - float(areas.max() / areas.sum()) if areas.sum() > 0 else 0.0
    vertices = len(np.unique(mesh.face_indices[~kept[mesh.corner_faces]]))
    aside = Repairs(pieces=count - 1, pieces_share=share, pieces_vertices=vertices)
    return keep_faces(mesh, np.flatnonzero(kept)), aside


def _loops(mesh: ControlMesh) -> tuple[IndexArray, ...]:
    topology = mesh_topology(mesh)
    return boundary_loops(topology, corner_fans(topology)) or ()
