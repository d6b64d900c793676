"""`--usd`: write results as a layer over the target's USD file, or as a separate USD file."""

from __future__ import annotations

import os
import shlex
from dataclasses import replace
from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.files.gltf.document import SCENE_SUFFIXES, read_document
from cagemap.files.gltf.read import left_out_of_gltf
from cagemap.files.images.image import with_udim_mark
from cagemap.files.meshes.ply import ply_images
from cagemap.files.result.manifest import input_file
from cagemap.files.usd.read import left_out_of_usd, objects_of, read_usd_meshes
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd
from cagemap.files.usd.write import UsdResults, write_usd, write_usd_over
from cagemap.files.values.part_numbering import FileRows, file_rows, to_file
from cagemap.maps.result import MatchResult
from cagemap.mesh.mesh_report import first_few

# Message if the target's file is missing.
NO_UNITS = (
    "the file is no longer where the match read it, or has changed: units, up axis and transform are not known, "
    "and metres with Y up are written"
)
NO_GROUPS = (
    "the file is no longer where the match read it, or has changed; what cagemap does not keep of it (such as group "
    "names, and parts that were not matched) is not in the new mesh"
)
_KEPT = ", and what earlier commands wrote there"


def left_out_warnings(original: Path | None, name: str, output: Path) -> list[str]:
    """Warnings of what a written mesh lacks of its file, which holds more than cagemap keeps, or is gone."""
    if original is not None:
        # A .glb of a glTF or FBX file keeps all of it, or its writer warns.
        kept = output.suffix.lower() == ".glb" and original.suffix.lower() in SCENE_SUFFIXES
        lost = [] if kept else _contents_beside_mesh(original)
        return [f"{output.name}: left out of {original.name}: {first_few(lost)}"] if lost else []
    suffix = output.suffix.lower()
    if {suffix, Path(name).suffix.lower()} <= set(USD_SUFFIXES):
        return [f"{name}: {NO_UNITS}"]
    return [f"{name}: {NO_GROUPS}"] if suffix == ".obj" else []


def _contents_beside_mesh(file: Path) -> list[str]:
    """What a USD, glTF, FBX or PLY file has beyond its mesh."""
    if is_usd(file):
        return left_out_of_usd(file)
    if file.suffix.lower() == ".ply":
        return [image.name for image in ply_images(file)]
    return left_out_of_gltf(read_document(file)) if file.suffix.lower() in SCENE_SUFFIXES else []


def old_rig_warnings(original: Path, output: Path) -> list[str]:
    """A warning if a wrapped mesh, written into its file's scene, keeps the rig of the shape before."""
    kept = ", ".join(name for name in _contents_beside_mesh(original) if name in ("blend shapes", "skeleton"))
    text = f"{output.name}: kept of {original.name}, in its old shape: {kept}. To adapt them, wrap to an .obj and type"
    return [f"{text} `cagemap rig NEW.obj --like {shlex.quote(os.path.normpath(original))}`"] if kept else []


def write_usd_results(layer: Path, folder: Path, result: MatchResult, results: UsdResults, *, force: bool) -> str:
    """Write results for the target of a RESULT folder; returns a line for the terminal."""
    control = result.target.control
    original = input_file(folder, result.manifest, "target")
    if original is None or not is_usd(original):
        kept = write_usd(layer, control, results, force=force, add=True)
        lost = original is None and is_usd(Path(control.name))
        return f"wrote {layer}, with {control.name} itself{_KEPT * kept}" + (f"; {NO_UNITS}" if lost else "")
    meshes = [mesh.path for mesh in read_usd_meshes(original)]
    paths = meshes if len(meshes) == 1 else [path for path in objects_of(control) if path in meshes]
    if not paths or (len(paths) > 1 and (results.attributes or results.points is not None or results.uvs is not None)):
        raise ParameterError(
            f"--usd: expected a result about one mesh of {original.name}, got {len(paths)} of {', '.join(meshes)}. "
            "Match one of them with --target-part; textures alone may be of several."
        )
    rows = file_rows(folder, result, "target") if len(paths) == 1 else None
    if rows is not None:
        control, results = replace(rows.whole, uv_name=control.uv_name), _to_whole_prim(results, rows)
    kept = write_usd_over(layer, original, paths, control, results, world=len(meshes) > 1, force=force)
    return f"wrote {layer}, a layer over {original.name}{_KEPT * kept}"


def _to_whole_prim(results: UsdResults, rows: FileRows) -> UsdResults:
    """Results of a part as results of its whole mesh prim; outside, 0 and old positions."""
    points = None if results.points is None else rows.placed(results.points)
    uvs = results.uvs
    if uvs is not None:  # faces outside the part have all UVs at one point
        laid_out = replace(rows, whole=rows.whole.with_uvs(None, None)).laid_out(*uvs[1:])
        assert laid_out.uvs is not None
        assert laid_out.uv_indices is not None
        uvs = uvs[0], laid_out.uvs, laid_out.uv_indices
    return replace(results, attributes=to_file(results.attributes, rows, places=results.places), points=points, uvs=uvs)


def texture_reference(image: Path, layer: Path) -> str:
    """Path of an image relative to a layer, with ``<UDIM>`` for the tile number."""
    relative = Path(os.path.relpath(with_udim_mark(image).resolve(), layer.resolve().parent)).as_posix()
    if "\\" in relative or any(character < " " or character == "\x7f" for character in relative):
        raise ParameterError(f"{image}: expected a name without backslashes or control characters, for USD. Rename it.")
    return relative if relative.startswith(".") else f"./{relative}"
