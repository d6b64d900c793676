"""A mesh made from another one by repairs or welding, and the number of repairs."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import IndexArray
from cagemap.numerics.kinds import Brief


@dataclass(frozen=True, repr=False)
class Repairs(Brief):
    """Number of repairs of each kind that `plain_mesh` made."""

    joined_vertices: int = 0  #: merged with others at the same position, on borders or zero-length edges
    averaged_colors: int = 0  #: joined vertices whose colours differ from their mean, which they take
    split_faces: int = 0  #: faces of another size than most, because of which all faces were split into triangles
    dropped_faces: int = 0  #: removed faces: with a repeated vertex, copies of other faces, and holes of the file
    fins: int = 0  #: faces removed at edges of more than two faces
    cut_vertices: int = 0  #: vertices copied for every part, where parts touched only in an edge or a point
    turned_faces: int = 0  #: faces reversed to agree with their neighbours, or to look outwards
    pieces: int = 0  #: removed pieces: nothing is matched or transferred there
    pieces_share: float = 0.0  #: their share of the area
    pieces_vertices: int = 0  #: their vertices
    pieces_weld: float = 0.0  #: tolerance of `cagemap.mesh.weld.weld_mesh` that joins pieces; 0 if none does
    loose_vertices: int = 0  #: removed vertices without faces
    slivers: int = 0  #: faces without area; they are kept
    openings: int = 0  #: boundary loops; they stay open

    def sentences(self) -> tuple[str, ...]:
        """One sentence for the user about every kind of repair made."""
        joined = f"`weld_mesh(mesh, {self.pieces_weld:g})` joins pieces that lie against each other"
        count_of = {
            f"{count_noun(self.joined_vertices, 'vertex')} joined with others at the same place": self.joined_vertices,
            f"colours of {self.averaged_colors} joined vertices differ and are averaged": self.averaged_colors,
            "faces of different sizes are split into triangles": self.split_faces,
            f"{count_noun(self.dropped_faces, 'face')} left out: copies, holes, or with a repeated vertex": (
                self.dropped_faces
            ),
            f"{count_noun(self.fins, 'face')} left out at edges of more than two faces": self.fins,
            f"{count_noun(self.cut_vertices, 'vertex')} split where parts only touch": self.cut_vertices,
            f"{count_noun(self.turned_faces, 'face')} turned round": self.turned_faces,
            f"{count_noun(self.pieces, 'other piece')} set aside ({count_noun(self.pieces_vertices, 'vertex')}, "
            f"{100 * self.pieces_share:.1f} % of the area): nothing is matched or transferred there. "
            f"{joined if self.pieces_weld else '`find_part` selects another'}": self.pieces,
            f"{count_noun(self.loose_vertices, 'vertex')} of no face set aside": self.loose_vertices,
            f"{count_noun(self.slivers, 'face')} without area kept": self.slivers,
            f"{count_noun(self.openings, 'opening')} left open": self.openings,
        }
        return tuple(sentence for sentence, count in count_of.items() if count)

    def sentences_of_body(self) -> tuple[str, ...]:
        """`sentences` for `cagemap rig`, which keeps the file's mesh and moves other pieces along with the body."""
        share = f"{100 * self.pieces_share:.1f} % of the area"
        pieces = f"{count_noun(self.pieces, 'other piece')} ({count_noun(self.pieces_vertices, 'vertex')}, {share})"
        changes = replace(self, pieces=0, slivers=0, openings=0).sentences()
        others = [f"for the match alone: {sentence}" for sentence in changes]
        return *[f"{pieces} not matched, but moved along with the body"][: self.pieces], *others

    def summary(self) -> dict[str, float]:
        """Numbers other than zero by name, for a manifest."""
        return {name: value for name, value in asdict(self).items() if value}


@dataclass(frozen=True, eq=False)
class RepairedMesh:
    """A mesh made from another one."""

    #: the repaired mesh. If vertices or faces were joined or removed, its ``file_vertices``, ``file_faces`` and
    #: ``file_copies`` have the numbers of the given mesh. The order stays, and corners keep their UVs.
    mesh: ControlMesh
    vertex_of: IndexArray = field(repr=False)  #: (n_given,) vertex of ``mesh`` for every one given; -1: removed
    notes: tuple[str, ...] = ()  #: one sentence for each kind of change, such as joined vertices or removed faces
    repairs: Repairs = Repairs()  #: those of `plain_mesh`


def unrepaired(mesh: ControlMesh) -> RepairedMesh:
    """The mesh as it is, as a `RepairedMesh`."""
    return RepairedMesh(mesh, np.arange(mesh.n_vertices))
