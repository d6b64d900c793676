"""A tiny box modeller: tubes of quads, limbs extruded from holes in them, and caps, all mirrored in x.

The model is +Y up and faces +Z, so its own left is at +x. A *ring* is a closed list of vertex numbers; a *loop* is a
ring in the order in which a face that closes the hole would list it (counter-clockwise seen from outside).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

CHANNELS = ("spine", "girth", "leg", "tail", "ear", "cup")
"""Scalars that every vertex carries, so that paint can follow the anatomy.

``spine``: arc length from rump to muzzle; ``girth``: 1 along the back, -1 along the belly; ``leg``, ``tail``, ``ear``:
0 on the body, 1 at the end of the limb; ``cup``: 1 inside an ear, -1 on its back.
"""


@dataclass(frozen=True)
class Creature:
    """A modelled animal, with all that its construction knows.

    Attributes
    ----------
    mesh : ControlMesh
        Closed, of genus 0, symmetric in x.
    parts : tuple of str, one per face
        What the face belongs to, for example ``torso`` or ``leg_front_L``.
    channels : (n, 6) float64
        Per vertex, in the order of `CHANNELS`; unitless but ``spine`` (length).
    landmarks : dict
        Landmark name to control vertex.
    seams : (s, 2) int64
        Edges, as vertex pairs, along which a tailor would cut the skin open (under the belly, along the inner legs).
    """

    mesh: ControlMesh
    parts: tuple[str, ...]
    channels: FloatArray
    landmarks: dict[str, int]
    seams: IndexArray


class Modeller:
    """Collects vertices and faces; `finish` drops what no face uses and numbers the rest."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float, float]] = []
        self._channels: list[tuple[float, ...]] = []
        self._faces: list[list[int]] = []
        self._parts: list[str] = []
        self._by_position: dict[tuple[float, float, float], int] = {}
        self._seams: list[tuple[int, int]] = []

    def vertex(self, point: Sequence[float] | FloatArray, channels: Sequence[float] | FloatArray) -> int:
        """Add one vertex and return its number."""
        key = (float(point[0]) + 0.0, float(point[1]), float(point[2]))
        self._points.append(key)
        self._channels.append(tuple(float(value) for value in channels))
        self._by_position[key] = len(self._points) - 1
        return len(self._points) - 1

    def face(self, loop: Sequence[int], part: str) -> None:
        """Add one face, counter-clockwise seen from outside."""
        self._faces.append([int(vertex) for vertex in loop])
        self._parts.append(part)

    def rename(self, count: int, part: str) -> None:
        """Give the last ``count`` faces to another part."""
        self._parts[-count:] = [part] * count

    def seam(self, path: Sequence[int]) -> None:
        """Mark the edges along a path of vertices as seams."""
        self._seams += itertools.pairwise(path)

    def mirrored(self, loop: Sequence[int]) -> list[int]:
        """Return the loop on the other side of x = 0 (its order reversed, so that it stays a loop)."""
        others = []
        for vertex in reversed(loop):
            x, y, z = self._points[vertex]
            others.append(self._by_position[(-x + 0.0, y, z)])
        return others

    def channel(self, loop: Sequence[int], name: str) -> float:
        """Return the mean of one channel over a loop."""
        return float(np.mean([self._channels[vertex][CHANNELS.index(name)] for vertex in loop]))

    def bridge(self, first: Sequence[int], second: Sequence[int], part: str, skip: Collection[int] = ()) -> None:
        """Join two loops of equal length by quads, leaving out those whose number is in ``skip``."""
        n = len(first)
        for i in range(n):
            if i not in skip:
                j = (i + 1) % n
                self.face((first[i], first[j], second[j], second[i]), part)

    def limb(self, loop: Sequence[int], rings: FloatArray, channels: FloatArray, part: str) -> list[list[int]]:
        """Extrude a loop through rings of given positions; return the new loops, nearest first.

        ``rings`` is (r, n, 3), ``channels`` (r, n, 6).
        """
        loops, last = [], list(loop)
        for points, values in zip(rings, channels, strict=True):
            following = [self.vertex(point, value) for point, value in zip(points, values, strict=True)]
            self.bridge(last, following, part)
            loops.append(following)
            last = following
        return loops

    def fan(
        self, loop: Sequence[int], apex: Sequence[float] | FloatArray, channels: Sequence[float] | FloatArray, part: str
    ) -> int:
        """Close a loop by triangles to a new vertex; return that vertex."""
        tip = self.vertex(apex, channels)
        for i in range(len(loop)):
            self.face((loop[i], loop[(i + 1) % len(loop)], tip), part)
        return tip

    def grid_cap(
        self, loop: Sequence[int], middle: FloatArray, channels: FloatArray, part: str, skip: int = 0
    ) -> list[int]:
        """Close a symmetric loop of n vertices, the first on top, by quads through n/2 - 1 new vertices on x = 0.

        ``middle`` is (n/2 - 1, 3), top to bottom. The topmost ``skip`` rows are left open. Returns the middle vertices.
        """
        half, n = len(loop) // 2, len(loop)
        inner = [self.vertex(point, value) for point, value in zip(middle, channels, strict=True)]
        if skip == 0:
            self.face((loop[0], loop[1], inner[0], loop[-1]), part)
        for i in range(max(skip, 1), half - 1):
            self.face((loop[i], loop[i + 1], inner[i], inner[i - 1]), part)
            self.face((inner[i - 1], inner[i], loop[n - i - 1], loop[n - i]), part)
        self.face((inner[-1], loop[half - 1], loop[half], loop[half + 1]), part)
        return inner

    def finish(self, name: str, landmarks: dict[str, int]) -> Creature:
        """Return the creature, without the vertices that no face uses."""
        used = np.unique(np.concatenate([np.array(face) for face in self._faces]))
        number = np.full(len(self._points), -1, dtype=np.int64)
        number[used] = np.arange(len(used))
        faces = [number[face] for face in self._faces]
        mesh = ControlMesh.from_faces(np.array(self._points)[used], faces, name=name)
        return Creature(
            mesh,
            tuple(self._parts),
            np.array(self._channels)[used],
            {key: int(number[vertex]) for key, vertex in landmarks.items()},
            number[np.array(self._seams, dtype=np.int64).reshape(-1, 2)],
        )


def mirror_vertices(mesh: ControlMesh) -> IndexArray:
    """Return for every vertex the one at the mirrored place (x negated).

    Raises
    ------
    KeyError
        If some vertex has no partner.
    """
    place = {tuple(point): i for i, point in enumerate((mesh.positions + 0.0).tolist())}
    return np.array([place[(-x + 0.0, y, z)] for x, y, z in mesh.positions.tolist()], dtype=np.int64)
