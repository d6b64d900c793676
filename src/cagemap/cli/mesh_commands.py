"""`cagemap check` and `cagemap refine`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import takewhile
from pathlib import Path
from typing import Any

from cagemap.cli.subdivision import SubdivisionRequest
from cagemap.errors import CagemapError, ParameterError
from cagemap.files.atomic import check_outputs
from cagemap.files.meshes import check_mesh_path, mesh_files, read_mesh, read_whole, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh, require_valid
from cagemap.mesh.parts import Part, list_parts
from cagemap.refinement import finest_mesh
from cagemap.refinement import refine as refine_mesh
from cagemap.refinement.counts import vertex_counts

MOST_VERTICES = 20_000_000
MOST_PARTS = 40


def check_files(paths: Sequence[Path]) -> tuple[str, bool]:
    """Text of a report per file, and whether all are sound; a file that cannot be read is a problem like others."""
    parts, sound = [], True
    for path in paths:
        try:
            mesh = read_whole(path)
            report = check_mesh(mesh)
        except CagemapError as error:
            parts.append(f"{path}\n  cannot be read: {error}")
            sound = False
            continue
        parts.append(str(report) + _part_lines(mesh))
        sound &= not report.problems
    return "\n\n".join(parts), sound


def check_values(paths: Sequence[Path]) -> tuple[str, bool]:
    """The same as JSON: a list with the fields of a `MeshReport` and the parts of each file, or why it is not read."""
    found: list[dict[str, Any]] = []
    for path in paths:
        try:
            mesh = read_whole(path)
            report = check_mesh(mesh)
        except CagemapError as error:
            found.append({"file": str(path), "usable": False, "error": str(error)})
            continue
        parts = [{"name": part.title, "faces": len(part.faces)} for part in _parts(mesh)]
        found.append({"file": str(path), "usable": report.is_valid, **asdict(report), "parts": parts})
    return json.dumps(found, indent=1, default=int), all(one["usable"] for one in found)


def _parts(mesh: ControlMesh) -> tuple[Part, ...]:
    try:
        return list_parts(mesh)
    except (IndexError, ValueError):
        return ()  # what keeps the mesh from having parts is among its problems


def _part_lines(mesh: ControlMesh) -> str:
    """Objects, groups, materials and components with their sizes, where there is anything to choose from."""
    found = _parts(mesh)
    if len(found) < 2:
        return ""
    width = max(len(part.title) for part in found[:MOST_PARTS])
    lines = [f"    {part.title:<{width}}  {len(part.faces)} faces" for part in found[:MOST_PARTS]]
    if len(found) > MOST_PARTS:
        lines.append(f"    and {len(found) - MOST_PARTS} more")
    return "\n".join(["\n  parts, for --part:", *lines])


def refine_file(
    path: Path, level: int, output: Path, *, subdivision: SubdivisionRequest = SubdivisionRequest(), force: bool = False
) -> str:
    """Refine a mesh file into another; returns the table of levels."""
    check_mesh_path(output)
    check_outputs([output], [path], force=force)
    control = subdivision.applied(read_mesh(path))
    check_outputs(mesh_files(output, control), [path], force=force)
    require_valid(control)
    require_size(control, level)
    refinement = refine_mesh(control, level)
    write_mesh(output, finest_mesh(refinement), like=path, force=force)
    return f"{refinement}\nwrote {output}"


def require_size(control: ControlMesh, level: int) -> None:
    """Refuse levels that no machine holds, before memory runs out.

    Raises
    ------
    ParameterError
        If the finest level would have more than 20 million vertices.
    """
    fits = sum(1 for _ in takewhile(lambda count: count <= MOST_VERTICES, vertex_counts(control))) - 1
    if level > fits:
        raise ParameterError(
            f"--level {level}: {control.name} would have too many vertices, expected at most {MOST_VERTICES:,}. "
            f"Use --level {fits} or less."
        )
