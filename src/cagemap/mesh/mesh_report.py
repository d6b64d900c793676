"""Report of a control mesh's check: counts, problems and notes, as printable text."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from cagemap.numerics.arrays import IndexArray

LISTED = 8
VERTEX = r"vertex \d+(?: at \([^)]*\))?"  # pattern of a `FileVertex` in messages
# Regular expression of the part of a message that states a position in the target's file.
PLACE = r", (?:worst|most) at \([^)]*\) of the target's file"
# Kinds of problems that `cagemap.mesh.plain.plain_mesh` repairs.
REPAIRED = frozenset(
    (
        "degenerate faces",
        "duplicate faces",
        "isolated vertices",
        "non-manifold edges",
        "non-manifold vertices",
        "inconsistent orientation",
        "inside out",
    )
)


def first_few(values: Iterable[object]) -> str:
    """List the first values, and the number of the remaining ones."""
    items = [str(value) for value in values]
    more = f", ... ({len(items) - LISTED} more)" if len(items) > LISTED else ""
    return ", ".join(items[:LISTED]) + more


def count_noun(count: int, what: str) -> str:
    """Text of a count and its noun, given in the singular: "1 face", "2 sharp vertices"."""
    plural = f"{what[:-2]}ices" if what.endswith("vertex") else f"{what}s"
    return f"{count} {what if count == 1 else plural}"


def place_text(place: Iterable[float]) -> str:
    """Three coordinates in brackets: "(1, 0.5, -2)"; far from the origin with more digits."""
    known = [float(x) for x in place]
    rounding = 1e-9 * max((abs(x) for x in known if math.isfinite(x)), default=0.0)  # smaller coordinates are 0
    shown = [0.0 if abs(x) <= rounding else x for x in known]
    return f"({', '.join(f'{x:.4g}' if abs(x) < 1e3 else f'{x:.8g}' for x in shown)})"


@dataclass(frozen=True)
class FileVertex:
    """A vertex of a file: programs may number it otherwise, so its place is given too."""

    number: int
    place: tuple[float, float, float] | None = None  # None in results of older versions

    def __str__(self) -> str:
        return f"{self.number}" if self.place is None else f"{self.number} at {place_text(self.place)}"


@dataclass(frozen=True)
class MeshProblem:
    """One kind of fault in a control mesh."""

    kind: str  #: short name, such as ``non-manifold edges``
    found: str  #: the expected and the actual state, in a sentence without the list of elements
    remedy: str  #: how to repair it
    elements: tuple[int, ...] | tuple[tuple[int, int], ...] = ()  #: by the file's numbers, from 0; edges: pairs
    places: tuple[str, ...] = ()  #: of the first `LISTED` elements: programs may number them otherwise
    of_vertices: bool = False  #: whether the elements are vertices; otherwise faces or edges

    def __str__(self) -> str:
        listed = [f"{element} at {place}" for element, place in zip(self.elements, self.places, strict=False)]
        where = f": {first_few((*listed, *self.elements[len(listed) :]))}" if self.elements else ""
        return f"{self.kind}: {self.found}{where}. {self.remedy}"


def problem_at(
    kind: str, found: str, elements: IndexArray, remedy: str, *, of_vertices: bool = False
) -> MeshProblem | None:
    """A problem at faces or vertices (k,), or at edges (k, 2) of two vertices each; None without any."""
    listed = [tuple(row) for row in elements.tolist()] if elements.ndim == 2 else elements.tolist()
    return MeshProblem(kind, found, remedy, tuple(listed), of_vertices=of_vertices) if len(elements) else None


def list_problems(problems: Iterable[object]) -> str:
    """Text of problems, one per line."""
    return "".join(f"\n  - {problem}" for problem in problems)


@dataclass(frozen=True)
class MeshReport:
    """Counts and problems of a control mesh, for ``print``. None: not determined, because of a problem."""

    name: str
    n_vertices: int
    n_edges: int | None
    n_faces: int
    face_sizes: tuple[tuple[int, int], ...] = ()  #: (corners, number of faces with that many), ascending
    euler_characteristic: int | None = None  #: vertices - edges + faces
    genus: int | None = None  #: number of handles, boundary loops counted as closed; summed over components
    boundary_edges: int | None = None  #: edges of one face
    boundary_loops: tuple[tuple[int, ...], ...] | None = None  #: vertices of every loop, by the file's numbers
    component_sizes: tuple[int, ...] = ()  #: number of faces of every connected component, in file order
    valence_range: tuple[int, int] | None = None  #: fewest and most edges at a vertex that has faces
    uv_islands: int | None = None  #: None without texture coordinates
    sharp: tuple[int, int, int] = (0, 0, 0)  #: numbers of creased edges, sharp vertices and hole faces
    problems: tuple[MeshProblem, ...] = ()
    notes: tuple[str, ...] = ()  #: allowed features that are probably not intended

    @property
    def is_valid(self) -> bool:
        """Whether the mesh can be matched."""
        return not self.problems

    def __str__(self) -> str:
        genus = "" if self.genus is None else f"  (genus {self.genus})"
        sizes, words = self.component_sizes, ("creased edge", "sharp vertex", "hole")
        sharp = [count_noun(count, word) for count, word in zip(self.sharp, words, strict=True) if count]
        rows = {
            "vertices": self.n_vertices,
            "edges": "-" if self.n_edges is None else self.n_edges,
            "faces": f"{self.n_faces}{self._faces_by_size()}",
            "Euler characteristic": f"{'-' if self.euler_characteristic is None else self.euler_characteristic}{genus}",
            "boundary loops": self._loops(),
            "components": f"{len(sizes)}  (of {first_few(sizes)} faces)" if len(sizes) > 1 else len(sizes) or "-",
            "valence": "-" if self.valence_range is None else "{} to {}".format(*self.valence_range),
            "UV islands": "no UVs" if self.uv_islands is None else self.uv_islands,
            **({"sharp": ", ".join(sharp)} if sharp else {}),
            "problems": len(self.problems) or "none",
        }
        lines = [self.name, *(f"  {label:<22}{value}" for label, value in rows.items())]
        lines += [f"  {i}. {problem}" for i, problem in enumerate(self.problems, start=1)]
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)

    def _faces_by_size(self) -> str:
        parts = [
            count_noun(count, {3: "triangle", 4: "quad"}[size]) for size, count in self.face_sizes if size in (3, 4)
        ]
        large = [(size, count) for size, count in self.face_sizes if size > 4]
        small = sum(count for size, count in self.face_sizes if size < 3)
        if large:
            parts.append(f"{count_noun(sum(count for _, count in large), 'n-gon')} of up to {large[-1][0]} corners")
        if small:
            parts.append(f"{small} of fewer than 3 corners")
        return f"  ({', '.join(parts)})" if parts else ""

    def _loops(self) -> str:
        if self.boundary_loops is None:
            return "-" if self.boundary_edges is None else f"-  ({count_noun(self.boundary_edges, 'boundary edge')})"
        lengths = sorted((len(loop) for loop in self.boundary_loops), reverse=True)
        return f"{len(lengths)}  (of {first_few(lengths)} edges)" if lengths else "0  (closed)"
