"""`cagemap check` and `cagemap refine`."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from cagemap.errors import CagemapError, InvalidMeshError, ParameterError
from cagemap.files.atomic import check_outputs
from cagemap.files.gltf.document import SCENE_SUFFIXES, read_document
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.read import Contents, contents_of, scene_mesh
from cagemap.files.meshes.formats import check_mesh_path, mesh_files, read_mesh, write_mesh
from cagemap.files.usd.read import UsdMesh, join_usd_meshes, read_usd_meshes
from cagemap.files.usd.stages import is_usd, open_each_once
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import UNREFINED, check_mesh, is_repaired_as_plain, require_valid
from cagemap.mesh.mesh_report import MeshProblem, MeshReport, count_noun
from cagemap.mesh.parts import Part, list_parts
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.quads import join_quads
from cagemap.mesh.repairs import unrepaired
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import structure_problems
from cagemap.mesh.weld import coincident_vertices, count_pieces, weld_tolerance
from cagemap.subdivision import finest_mesh
from cagemap.subdivision import refine as refine_mesh
from cagemap.subdivision.refinement import vertex_counts
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.mesh_commands import CheckRequest, RefineRequest
from cagemap.tasks.subdivision import SubdivisionRequest, weld_asked
from cagemap.tasks.usd_output import left_out_warnings

_log = logging.getLogger(__name__)

MOST_REFINED = 20_000_000
MOST_PARTS = 40


def run_check(request: CheckRequest, stages: Stages) -> tuple[str, bool]:
    """Report on all files, as text or JSON; and whether all of them are usable. An unreadable file is not usable.

    The JSON list has the fields of a `MeshReport` and the parts of each file, or the error of reading it.
    """
    texts, values, sound = list[str](), list[dict[str, Any]](), True
    for path in request.meshes:
        try:
            mesh, report, holds = _check_file(path, SubdivisionRequest(request.scheme), request.weld)
        except CagemapError as error:
            fields = {name: getattr(error, name) for name in ("code", "place", "remedy")}
            values.append({"file": str(path), "usable": False, "error": str(error), **fields})
            texts.append(f"{path}\n  cannot be read: {error}")
            sound = False
            continue
        sound &= report.is_valid
        parts = _parts(mesh)
        if not request.for_scripts:
            components = sum(part.kind == "component" for part in parts)  # which may be UV islands of a file with seams
            split = not structure_problems(mesh) and count_pieces(mesh, coincident_vertices(mesh)) < components
            listed = _part_lines(parts, pieces=holds is None and not split)
            texts.append("\n".join(filter(None, [str(report), "" if holds is None else str(holds)])) + listed)
        sizes = [{"name": part.title, "faces": len(part.faces)} for part in parts]
        held = {} if holds is None else {"contents": asdict(holds)}
        values.append({"file": str(path), "usable": report.is_valid, **asdict(report), "parts": sizes, **held})
    plain = json.loads(json.dumps(values, default=int))
    stages.record({"files": plain})
    text = json.dumps(plain, indent=1) if request.for_scripts else "\n\n".join(texts)
    return text, sound


def _check_file(
    path: Path, subdivision: SubdivisionRequest, weld: str | None
) -> tuple[ControlMesh, MeshReport, Contents | None]:
    """A file's mesh, its report for `cagemap match`, and the contents of a glTF, FBX or rigged USD file.

    The report of a character describes its body mesh only.
    """
    scene: Scene | None = None
    meshes: tuple[UsdMesh, ...] = ()
    if is_usd(path):
        with open_each_once():
            meshes = read_usd_meshes(path)
            mesh, scene = join_usd_meshes(path, meshes, mixed=True), _rigged_scene(path, meshes)
    elif path.suffix.lower() in SCENE_SUFFIXES:
        scene = read_scene(read_document(path))
        mesh = scene_mesh(scene)
    else:
        mesh = read_mesh(path)
    if scene is None:
        return mesh, _report(mesh, subdivision, weld), None
    holds = contents_of(scene)
    if not holds.is_character:
        return mesh, _report(mesh, subdivision, weld), holds
    controls = [one.part.mesh for one in scene.parts]
    if meshes:  # vertices of USD are not split, and its subdivision schemes have no place in a glTF scene
        controls = [one.control for one in meshes]
        holds = replace(holds, stored=holds.vertices, welded=())
    body = controls[[one.part.name for one in scene.parts].index(holds.body)]
    name = f"{mesh.name}: {holds.body}" if holds.passengers else mesh.name
    named = replace(body, name=name, file_vertices=None, file_faces=None, file_copies=None)
    return mesh, _report(named, subdivision, weld, pieces=False), holds


def _rigged_scene(path: Path, meshes: Sequence[UsdMesh]) -> Scene | None:
    """Scene of a USD file with a skeleton, from its meshes; None without one, and with a warning if it is refused."""
    from cagemap.files.usd.convert import usd_document

    try:
        scene = read_scene(usd_document(path, meshes))
    except CagemapError as error:
        _log.warning("no character for `cagemap rig`: %s", error)
        return None
    return None if scene.joints is None else scene


def _report(read: ControlMesh, subdivision: SubdivisionRequest, weld: str | None, *, pieces: bool = True) -> MeshReport:
    """Report of a mesh for a match, after repairs; without ``pieces``, notes about a character's body."""
    if structure_problems(read):
        return check_mesh(read)
    welded = weld_asked(read, weld)
    mesh = subdivision.apply(welded.mesh)
    repairs: tuple[str, ...] = ()
    try:
        ready = plain_mesh(mesh) if isinstance(mesh.scheme, Plain) else unrepaired(mesh)
        report = check_mesh(ready.mesh)
        repairs = ready.repairs.sentences() if pieces else ready.repairs.sentences_of_body()
    except InvalidMeshError as error:
        report = check_mesh(mesh)
        problem = MeshProblem("scheme none", str(error).removeprefix(f"{mesh.name}: "), "")
        report = replace(report, problems=(*report.problems, problem))
    offer = "--scheme none repairs the mesh and takes it without subdivision."
    notes = [*([offer] if is_repaired_as_plain(mesh, report.problems) else []), *report.notes]
    notes += [note.removeprefix(f"{mesh.name}: ") for note in welded.notes]
    notes += [f"taken as it is (scheme none): {sentence}" for sentence in repairs]
    return replace(report, notes=tuple(notes))


def _parts(mesh: ControlMesh) -> tuple[Part, ...]:
    try:
        return list_parts(mesh)
    except (IndexError, ValueError):
        return ()  # the report has the problem of the mesh


def _part_lines(parts: tuple[Part, ...], *, pieces: bool) -> str:
    """Lines with objects, groups, materials and components and their sizes, if there are several.

    Without ``pieces``, components are left out, and of parts with equal faces one is listed.
    """
    if not pieces:
        different = {part.faces.tobytes(): part for part in reversed(parts) if part.kind != "component"}
        parts = tuple(reversed(different.values()))
    if len(parts) < 2:
        return ""
    width = max(len(part.title) for part in parts[:MOST_PARTS])
    lines = [f"    {part.title:<{width}}  {count_noun(len(part.faces), 'face')}" for part in parts[:MOST_PARTS]]
    if len(parts) > MOST_PARTS:
        lines.append(f"    and {len(parts) - MOST_PARTS} more")
    return "\n".join(["\n  parts, for --part:", *lines])


def run_refine(request: RefineRequest, stages: Stages) -> SummaryAndWarnings:
    """Refine a mesh file into another; returns the table of levels, and notes about welds and quads."""
    path, output, level = request.mesh, request.output, request.level
    check_mesh_path(output)
    check_outputs([output], [path], force=request.force)
    welded = weld_asked(read_mesh(path), request.weld)
    mesh, notes = _with_quads(welded.mesh, welded.notes) if request.quads else (welded.mesh, welded.notes)
    options = SubdivisionRequest(request.scheme, request.boundary, request.uv_interpolation, request.creasing)
    control = options.apply(mesh)
    notes = (*notes, *options.unused_notes([control]))
    check_outputs(mesh_files(output, control, path), [path], force=request.force)
    if level == 0 and isinstance(control.scheme, Plain) and not structure_problems(control):
        write_mesh(output, control, like=path, force=request.force)
        return "\n".join([*notes, f"wrote {output}"]), left_out_warnings(path, mesh.name, output)
    require_valid(control, allowed=UNREFINED, plain=False)
    require_size(control, level)
    refinement = refine_mesh(control, level)
    finest = finest_mesh(refinement)
    if control.vertex_colors is not None and finest.vertex_colors is None:
        notes = (*notes, f"note: {control.name}: its vertex colours are left out, since some vertices have none")
    write_mesh(output, finest, like=path, force=request.force)
    tolerance = weld_tolerance(control)
    seams = "" if tolerance is None else f"note: {control.name} is split at seams, --weld {tolerance:g} joins them"
    text = "\n".join(filter(None, [*notes, str(refinement), seams, f"wrote {output}"]))
    return text, left_out_warnings(path, mesh.name, output)


def _with_quads(mesh: ControlMesh, notes: tuple[str, ...]) -> tuple[ControlMesh, tuple[str, ...]]:
    """The mesh with triangles joined to quads, and notes; a plain scheme, as of glTF, is dropped."""
    joined, count = join_quads(mesh)
    left = int((joined.face_sizes == 3).sum())
    scheme = None if isinstance(joined.scheme, Plain) else joined.scheme
    note = f"{mesh.name}: {count} pairs of triangles are joined to quads, {left} triangles stay"
    return replace(joined, scheme=scheme), (*notes, note)


def require_size(control: ControlMesh, level: int, option: str = "--level ") -> None:
    """Refuse levels with more than `MOST_REFINED` vertices, before memory runs out."""
    fits = sum(1 for _ in takewhile(lambda count: count <= MOST_REFINED, vertex_counts(control))) - 1
    if level > fits:
        raise ParameterError(
            f"{option}{level}: {control.name} would have too many vertices, expected at most {MOST_REFINED:,}. "
            f"Use {option}{fits} or less."
        )
