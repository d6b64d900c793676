"""Plain meshes, matched as they are: scans and generated meshes, made ready and said how.

Subdivision wants an oriented manifold of one piece, and so does the method. What scans have instead is mended where
that is certain, and set aside where it is not; `Repairs` counts what was done.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from cagemap.errors import InvalidMeshError
from cagemap.mesh import mend
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.geometry_checks import zero_area_problem
from cagemap.mesh.parts import extract
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import structure_problems
from cagemap.mesh.topology import used_vertices
from cagemap.numerics.arrays import IndexArray
from cagemap.numerics.kinds import kinds_checked


@dataclass(frozen=True)
class Repairs:
    """What was done to a mesh before it was matched as it is; zero where nothing was.

    Attributes
    ----------
    joined_vertices : int
        Vertices at the very place of another, on borders (files that repeat vertices face by face) or on edges of
        length zero, which became one with it.
    split_faces : int
        Faces of other sizes than the rest, split into triangles with all others.
    dropped_faces : int
        Faces that visit a vertex twice, copies of other faces, and holes of the file.
    fins : int
        Faces taken out at edges of more than two faces.
    cut_vertices : int
        Vertices where parts only touched, in an edge or a point, each with a copy for every part.
    turned_faces : int
        Faces turned round to agree with the others; all of them where the mesh looked inwards.
    pieces : int
        Smaller pieces set aside: nothing is matched or transferred there.
    pieces_share : float
        Their share of the area.
    pieces_vertices : int
        Their vertices.
    loose_vertices : int
        Vertices of no face, set aside.
    slivers : int
        Faces without area, which stay.
    openings : int
        Boundary loops, which stay open.
    """

    joined_vertices: int = 0
    split_faces: int = 0
    dropped_faces: int = 0
    fins: int = 0
    cut_vertices: int = 0
    turned_faces: int = 0
    pieces: int = 0
    pieces_share: float = 0.0
    pieces_vertices: int = 0
    loose_vertices: int = 0
    slivers: int = 0
    openings: int = 0

    def sentences(self) -> tuple[str, ...]:
        """What a user is to know."""
        said = {
            f"{self.joined_vertices} vertices at the place of another are joined with it": self.joined_vertices,
            "faces of different sizes are split into triangles": self.split_faces,
            f"{self.dropped_faces} faces are left out: copies, holes, or with a repeated vertex": self.dropped_faces,
            f"{self.fins} faces at edges of more than two faces are left out": self.fins,
            f"{self.cut_vertices} vertices where parts only touch are split": self.cut_vertices,
            f"{self.turned_faces} faces are turned round": self.turned_faces,
            f"{self.pieces} smaller pieces ({self.pieces_vertices} vertices, {100 * self.pieces_share:.1f} % of the "
            "area) are set aside: nothing is matched or transferred there": self.pieces,
            f"{self.loose_vertices} vertices of no face are set aside": self.loose_vertices,
            f"{self.slivers} faces without area stay": self.slivers,
            f"{self.openings} openings stay open": self.openings,
        }
        return tuple(sentence for sentence, count in said.items() if count)

    def summary(self) -> dict[str, float]:
        """Numbers for a manifest, those that are not zero."""
        return {name: value for name, value in asdict(self).items() if value}


@dataclass(frozen=True, eq=False)
class PlainMesh:
    """A mesh that is matched as it is, of one piece and manifold.

    Attributes
    ----------
    mesh : ControlMesh
        With the scheme `Plain`. Vertices and faces keep their order; where some are gone, ``file_vertices`` and
        ``file_faces`` say which these were.
    vertex_of : (n_given,) int64
        Vertex of ``mesh`` that every vertex of the mesh given became, -1 where it was set aside.
    repairs : Repairs
    """

    mesh: ControlMesh
    vertex_of: IndexArray
    repairs: Repairs

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, in sentences that name the mesh."""
        return tuple(f"{self.mesh.name}: {sentence}" for sentence in self.repairs.sentences())

    def renumber(self, vertices: IndexArray) -> IndexArray:
        """Vertices of the mesh given in the numbers of this one, -1 where they are set aside."""
        return self.vertex_of[vertices]


@kinds_checked
def plain_mesh(mesh: ControlMesh) -> PlainMesh:
    """Make a triangle or quad mesh ready to be matched as it is (scheme none), and say what was done to it.

    Joins vertices that a file repeats, takes out faces that are none, separates parts that only touch, turns faces to
    agree, and sets smaller pieces aside. A mesh that needs none of it keeps its numbers.

    Raises
    ------
    InvalidMeshError
        If its arrays are no mesh, it is one-sided, or has no area.
    """
    broken = structure_problems(mesh)
    if broken:
        listed = "".join(f"\n  - {problem}" for problem in broken)
        raise InvalidMeshError(f"{mesh.name}: expected a mesh, got {len(broken)} problem(s):{listed}")
    work = replace(
        mesh,
        scheme=Plain(),
        file_vertices=np.arange(mesh.n_vertices),
        file_faces=np.arange(mesh.n_faces),
        crease_edges=None,
        crease_sharpness=None,
        corner_vertices=None,
        corner_sharpness=None,
    )
    representative = mend.representatives(work)
    joined = int(np.sum(representative != np.arange(mesh.n_vertices)))
    if joined:
        work = replace(work, face_indices=representative[work.face_indices])
    work, holes = mend.without_holes(work)
    work, split = mend.uniform(work)
    work, dropped = mend.without_copies(work)
    work, fins, cut = mend.manifold(work)
    work, turned = mend.oriented(work)
    work, pieces, share, vertices = mend.largest_piece(work)
    work, inwards = mend.outwards(work)
    repairs = Repairs(
        joined_vertices=joined,
        split_faces=split,
        dropped_faces=dropped + holes,
        fins=fins,
        cut_vertices=cut,
        turned_faces=work.n_faces - turned if inwards else turned,
        pieces=pieces,
        pieces_share=share,
        pieces_vertices=vertices,
        loose_vertices=int(mesh.n_vertices - used_vertices(mesh).sum()),
    )
    changed = bool(repairs.summary())
    ready = extract(work, np.arange(work.n_faces)) if changed else replace(work, file_vertices=None, file_faces=None)
    sliver = zero_area_problem(ready, np.arange(ready.n_faces))
    repairs = replace(
        repairs, slivers=0 if sliver is None else len(sliver.elements), openings=len(mend.openings(ready))
    )
    own = np.arange(mesh.n_vertices) if ready.file_vertices is None else ready.file_vertices
    vertex_of = np.full(mesh.n_vertices, -1, dtype=np.int64)
    vertex_of[own[::-1]] = np.arange(len(own))[::-1]  # of a vertex that was split, its first copy
    return PlainMesh(_in_file_numbers(ready, mesh), vertex_of[representative], repairs)


def _in_file_numbers(ready: ControlMesh, given: ControlMesh) -> ControlMesh:
    """Numbers of vertices and faces in the file, where the mesh given was a part of one."""
    vertices, faces = ready.file_vertices, ready.file_faces
    if vertices is None or faces is None:
        return replace(ready, file_vertices=given.file_vertices, file_faces=given.file_faces)
    return replace(
        ready,
        file_vertices=vertices if given.file_vertices is None else given.file_vertices[vertices],
        file_faces=faces if given.file_faces is None else given.file_faces[faces],
    )
