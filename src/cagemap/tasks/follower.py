"""MakeHuman's file of a mesh that follows a body, in the numbers of both files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files.meshes.mhclo import bind, write_mhclo
from cagemap.files.values.part_numbering import FileRows
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray


def require_whole(rows: FileRows | None) -> None:
    """Refuse a target with vertices that were not matched: each one needs a place on the source."""
    if rows is None:
        return
    left = rows.whole.n_vertices - len(np.unique([*rows.vertices, *rows.copies[:, 1]]))
    if left:
        raise ParameterError(
            f"{rows.part.name}: expected a target that was matched in whole to follow the source in MakeHuman, got "
            f"{left} vertices that were not matched. Match its part as a file of its own."
        )


def write_follower(
    path: Path,
    positions: FloatArray,
    triangles: IndexArray,
    result: MatchResult,
    rows: FileRows | None,
    obj: Path,
    *,
    force: bool,
) -> FloatArray:
    """Write how a mesh follows the source's file; returns the offsets (n, 3) from its surface.

    ``positions``: (n, 3), and ``triangles`` (n,), the source's finest triangle of each vertex.
    ``rows``: of the file ``obj``, whose numbering the rows have; None if that is the numbering of ``positions``.
    """
    require_whole(rows)
    finest, of_finest = result.source.refinement.finest, result.source.finest_triangles.triangles
    faces = finest.face_parents[triangles // (len(of_finest) // finest.n_faces)]
    binding = bind(positions, result.source.control, faces)
    offsets, file_vertices = binding.offsets, result.source.control.file_vertices
    if file_vertices is not None:
        binding = replace(
            binding, vertices=file_vertices[binding.vertices], scales=file_vertices[binding.scales].astype(np.int64)
        )
    if rows is not None:
        vertices, weights, apart = (rows.to_file(array) for array in (binding.vertices, binding.weights, offsets))
        binding = replace(binding, vertices=vertices, weights=weights, offsets=apart)
    write_mhclo(path, binding, obj, force=force)
    return offsets
