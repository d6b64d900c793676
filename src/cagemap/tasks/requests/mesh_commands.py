"""Requests of `cagemap check` and `cagemap refine`: their fields are the commands' options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    INPUT,
    OUTPUT,
    Argument,
    BoundaryOption,
    CreasingOption,
    Force,
    MeshFile,
    Option,
    SchemeOption,
    UvOption,
    WeldOption,
)


@dataclass(frozen=True)
class CheckRequest:
    """Check control meshes, and say what to repair.

    A mesh must be manifold, consistently oriented and in one piece; boundaries are allowed. With scheme none, of the
    file or by --scheme, it lists what a match repairs and leaves out. Exit code 1 if any mesh has a problem.
    """

    meshes: Annotated[
        tuple[Path, ...], Argument("Control meshes, .obj, .ply, .off, .stl, glTF, VRM, FBX or USD.", metavar="MESH")
    ]
    for_scripts: Annotated[bool, Option("Print JSON, for scripts.", OUTPUT, ("--json",))] = False
    scheme: SchemeOption = None
    weld: WeldOption = None


@dataclass(frozen=True)
class RefineRequest:
    """Subdivide a control mesh.

    Loop for triangle meshes, Catmull-Clark for all others, unless its file says otherwise. Creases and corners shape
    it, holes are left out. Level 0 is written unchanged, with creases and holes. Vertex i of the mesh stays vertex i
    (but for holes and welded vertices). UVs, materials, objects and groups come along. The mesh may have several
    pieces.
    """

    mesh: MeshFile
    level: Annotated[int, Option("Subdivision steps; each has about 4 times the faces.", INPUT, ("-l",), min=0)]
    output: Annotated[Path, Option("Mesh to write, .obj, .ply, .off, .glb or USD.", OUTPUT, ("-o",))]
    scheme: SchemeOption = None
    boundary: BoundaryOption = None
    uv_interpolation: UvOption = None
    creasing: CreasingOption = None
    weld: WeldOption = None
    quads: Annotated[bool, Option("Join triangles to the quads that an exporter split.", INPUT)] = False
    force: Force = False
