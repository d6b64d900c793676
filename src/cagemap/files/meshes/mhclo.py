"""MakeHuman's ``.mhclo``: each vertex follows three vertices of a base mesh, by weights and an offset."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.files.text import require_suffix
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import triangle_frames

FOLLOWER_SUFFIXES = (".mhclo", ".proxy")
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Binding:
    """The binding of a mesh to a base mesh."""

    vertices: IndexArray  # (n, 3) base vertices that each vertex follows
    weights: FloatArray  # (n, 3) rows sum to 1; may be negative
    offsets: FloatArray  # (n, 3) added to the weighted positions, scaled along each axis
    scales: IndexArray  # (3, 2) two base vertices for each axis; their distance along it scales the offsets
    lengths: FloatArray  # (3,) these distances in the base mesh at rest

    def positions(self, base: FloatArray) -> FloatArray:
        """(n, 3) positions for base positions (n2, 3), as MakeHuman and MPFB compute them from the file."""
        ends = base[self.scales, np.arange(3)[:, None]]
        factors = np.abs(ends[:, 0] - ends[:, 1]) / self.lengths
        return np.einsum("nk,nkd->nd", self.weights, base[self.vertices]) + self.offsets * factors


def bind(positions: FloatArray, base: ControlMesh, faces: IndexArray) -> Binding:
    """Bind a mesh to the control vertices of a base mesh near its surface.

    ``positions``: (n, 3), of the mesh, in the base's units.
    ``faces``: (n,), base face of each vertex; the nearest triangle of its corners is used.
    """
    corners, sizes = base.face_indices, base.face_sizes[faces]
    begin = base.face_offsets[faces]
    best = np.full(len(positions), np.inf)
    vertices, weights = np.zeros((len(positions), 3), dtype=np.int64), np.zeros((len(positions), 3))
    # All triples of consecutive corners of a face are tried, so that no diagonal is preferred.
    for first in range(int(sizes.max())):
        rows = np.flatnonzero(sizes > first)
        triple = np.stack([corners[begin[rows] + (first + k) % sizes[rows]] for k in range(3)], axis=1)
        frames = triangle_frames(base.positions, triple)
        across = np.einsum("nkd,nd->nk", frames[:, 1:], positions[rows] - frames[:, 0])
        inside = np.column_stack([1 - across.sum(axis=1), across])
        outside = np.maximum(-inside.min(axis=1), 0.0)
        closer = outside < best[rows] - 1e-12
        better = rows[closer]
        best[better], vertices[better], weights[better] = outside[closer], triple[closer], inside[closer]
    offsets = positions - np.einsum("nk,nkd->nd", weights, base.positions[vertices])
    scales = np.stack([(base.positions[:, axis].argmin(), base.positions[:, axis].argmax()) for axis in range(3)])
    ends = base.positions[scales, np.arange(3)[:, None]]
    return Binding(vertices, weights, offsets, scales.astype(np.int64), np.abs(ends[:, 0] - ends[:, 1]))


def write_mhclo(path: str | Path, binding: Binding, obj: Path, *, force: bool = False) -> None:
    """Write a ``.mhclo`` (clothes) or ``.proxy`` (the body) file for the mesh in ``obj``."""
    file = Path(path)
    require_suffix(file, FOLLOWER_SUFFIXES)
    name = file.stem
    lines = [
        f"# {mark()}",
        "basemesh hm08",
        f"name {name}",
        f"uuid {uuid.uuid5(uuid.NAMESPACE_URL, name)}",
        *(f"{axis}_scale {a} {b} {length!r}" for axis, (a, b), length in zip(
            _AXES, binding.scales.tolist(), binding.lengths.tolist(), strict=True
        )),
        f"obj_file {obj.name}",
        "verts 0",
    ]  # fmt: skip
    rows = zip(binding.vertices.tolist(), binding.weights.tolist(), binding.offsets.tolist(), strict=True)
    lines += [f"{a} {b} {c} {u!r} {v!r} {w!r} {x!r} {y!r} {z!r}" for (a, b, c), (u, v, w), (x, y, z) in rows]
    write_whole(file, "\n".join(lines) + "\n", force=force)
