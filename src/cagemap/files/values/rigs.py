"""Skeletons (JSON) and blend shapes (OBJ, PLY, or ``.npz`` of offsets), read and written."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.character.joints import Skeleton
from cagemap.errors import FormatError
from cagemap.files import VALUE_SUFFIXES
from cagemap.files.atomic import atomic_path, check_outputs, require_writable_folder, write_whole
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.gltf.read import gltf_shapes, gltf_skeleton
from cagemap.files.meshes.formats import MESH_SUFFIXES, mesh_files, read_mesh, write_mesh
from cagemap.files.npz import read_npz, write_npz
from cagemap.files.ownership import mark
from cagemap.files.text import read_text
from cagemap.files.usd.prims import BLEND_SHAPE
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.space import between_spaces, states_units
from cagemap.files.usd.stages import is_usd
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows, to_part
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray


def read_skeleton(path: str | Path, control: ControlMesh | None = None) -> Skeleton:
    """Read joints from JSON: ``[{"name": ..., "parent": ... or null, "head": [x, y, z], "tail": [x, y, z]}, ...]``.

    A joint may have ``"axes"``, three directions. A USD file has the skeleton of its mesh, a glTF file the joints of
    all its skins.

    ``control``: the mesh of the skeleton; needed if a USD file has several.
    """
    file = Path(path)
    if states_units(file):
        skeleton = scene_skeleton(file, control)
        if skeleton is None:
            raise FormatError(
                f"{file}: expected a mesh bound to a skeleton, it is bound to none. Export it with its rig."
            )
        return skeleton
    if file.suffix.lower() in MESH_SUFFIXES:
        raise FormatError(
            f"{file}: expected joints as .json, or in a glTF, FBX or USD file, got {file.suffix}, which holds none. "
            "Export the character as GLB."
        )
    text = read_text(file, "a skeleton")
    try:
        stated = json.loads(text)
        joints = stated["joints"] if isinstance(stated, dict) else stated
        names = tuple(str(joint["name"]) for joint in joints)
        parents = tuple(str(joint.get("parent") or "") for joint in joints)
        heads, tails = (
            np.array([joint[end] for joint in joints], dtype=np.float64).reshape(len(names), 3)
            for end in ("head", "tail")
        )
        turned = [joint["axes"] for joint in joints if "axes" in joint]
        axes = np.array(turned, dtype=np.float64).reshape(-1, 3, 3) if turned else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(
            f'{file}: expected a list of joints such as {{"name": "spine", "parent": null, "head": [0, 1, 0], '
            f'"tail": [0, 2, 0]}}, found something else ({error}).'
        ) from error
    if len(set(names)) != len(names):
        raise FormatError(f"{file}: expected joints of different names, got some twice. Rename them.")
    missing = sorted(set(parents) - set(names) - {""})
    if missing:
        raise FormatError(f"{file}: parents {', '.join(missing)} are no joints of the file. Export the whole skeleton.")
    if not (np.isfinite(heads).all() and np.isfinite(tails).all()):
        raise FormatError(f"{file}: expected finite positions of heads and tails.")
    if axes is not None and (len(axes) != len(names) or not np.isfinite(axes).all()):
        raise FormatError(f"{file}: expected finite axes of all joints or of none, got {len(axes)} of {len(names)}.")
    return Skeleton(names, parents, heads, tails, axes)


def scene_skeleton(file: Path, control: ControlMesh | None) -> Skeleton | None:
    """Joints of a glTF, FBX or USD file; None for other files, and for a mesh in USD without a skeleton."""
    if is_usd(file):
        return read_usd_skeleton(file, control)
    return gltf_skeleton(file) if file.suffix.lower() in SCENE_SUFFIXES else None


def write_skeleton(path: str | Path, skeleton: Skeleton, *, force: bool = False) -> None:
    """Write joints in the JSON form of `read_skeleton`, with cagemap's mark."""
    joints = [
        {"name": name, "parent": parent or None, "head": head, "tail": tail}
        for name, parent, head, tail in zip(
            skeleton.names, skeleton.parents, skeleton.heads.tolist(), skeleton.tails.tolist(), strict=True
        )
    ]
    if skeleton.axes is not None:
        joints = [{**joint, "axes": axes} for joint, axes in zip(joints, skeleton.axes.tolist(), strict=True)]
    write_whole(path, json.dumps({"written_by": mark(), "joints": joints}, indent=1) + "\n", force=force)


def read_shapes(
    paths: Sequence[Path], rest: ControlMesh, rows: FileRows | None = None, like: Path | None = None
) -> dict[str, FloatArray]:
    """Read blend shapes of a cage as displacements (n, 3) by name.

    ``paths``: OBJ or PLY files with the cage's faces, ``.npz`` files of named displacements, USD and glTF files, or
        folders of OBJ, PLY and ``.npz`` files. In a folder, the cage itself as `write_shapes` writes it is no shape.
    ``rows``: for a cage that is a part of a file: shapes of the whole file are taken at the part.
    ``like``: file whose units and axes the shapes get, where both files state theirs.
    """
    files: list[Path] = []
    for path in paths:
        known = (".obj", ".ply", ".npz")
        files += sorted(file for file in path.iterdir() if file.suffix.lower() in known) if path.is_dir() else [path]
    shapes: dict[str, FloatArray] = {}
    for file in files:
        shapes_of_file = _shapes_of(file, rest, rows)
        if file.parent in paths and file.stem == Path(rest.name).stem and not np.any(shapes_of_file.get(file.stem, 1)):
            continue
        twice = sorted(set(shapes_of_file) & set(shapes))
        if twice:
            raise FormatError(f"{file}: a shape named {twice[0]} was read before. Rename one of them.")
        linear = between_spaces(like, file)[:3, :3]
        shapes |= {name: offsets @ linear for name, offsets in shapes_of_file.items()}
    if not shapes:
        raise FormatError(f"expected shapes in {', '.join(map(str, paths))}, found none (.obj, .ply or .npz)")
    return shapes


def _shapes_of(file: Path, rest: ControlMesh, rows: FileRows | None) -> dict[str, FloatArray]:
    arrays = None
    if file.suffix.lower() == ".npz":
        arrays = read_npz(file, "Write it again, with one array (vertices, 3) for each shape.")
    elif file.suffix.lower() in SCENE_SUFFIXES:
        arrays = dict(gltf_shapes(file))
    if arrays is not None:
        return {name: _checked_offsets(file, name, array, rest) for name, array in to_part(arrays, rows).items()}
    if not is_usd(file):
        mesh = read_mesh(file)
        if rows is not None and mesh.n_vertices == rows.whole.n_vertices:
            return {file.stem: np.asarray(_read_offset(file, mesh, rows.whole)[rows.vertices])}
        return {file.stem: _read_offset(file, mesh, rest)}
    shapes = {n: values for n, values in read_attributes(file, rest).items() if n.startswith(BLEND_SHAPE)}
    if any(values.shape != (rest.n_vertices, 3) for values in shapes.values()):
        raise FormatError(
            f"{file}: expected blend shapes of {rest.n_vertices} vertices, as {rest.name} has. "
            "Give the shapes of this mesh."
        )
    return {name.removeprefix(BLEND_SHAPE): np.asarray(values, dtype=np.float64) for name, values in shapes.items()}


def _read_offset(file: Path, mesh: ControlMesh, rest: ControlMesh) -> FloatArray:
    if mesh.n_vertices != rest.n_vertices or not np.array_equal(mesh.face_indices, rest.face_indices):
        raise FormatError(
            f"{file}: expected a shape with the {rest.n_vertices} vertices and the faces of {rest.name}, found "
            f"{mesh.n_vertices} vertices{'' if mesh.n_vertices != rest.n_vertices else ' and other faces'}. "
            "Export it from the same cage, with vertices in their order."
        )
    return mesh.positions - rest.positions


def _checked_offsets(file: Path, name: str, array: NDArray[Any], rest: ControlMesh) -> FloatArray:
    if array.shape != (rest.n_vertices, 3) or array.dtype.kind not in "iuf":
        raise FormatError(
            f"{file}: expected displacements of shape ({rest.n_vertices}, 3) in '{name}', one a vertex of "
            f"{rest.name}, found {array.dtype} of shape {array.shape}"
        )
    unknown = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(unknown):
        raise FormatError(
            f"{file}: expected finite displacements in '{name}', found others at {len(unknown)} vertices of "
            f"{rest.name}, such as {unknown[:5].tolist()} (0-based). Write it again, with 0 where nothing moves."
        )
    return array.astype(np.float64)


def check_shapes_path(output: Path) -> None:
    """Refuse the name of a file of another format, since shapes are written as an ``.npz`` or a folder."""
    if output.suffix.lower() in {*VALUE_SUFFIXES, *MESH_SUFFIXES} - {".npz"}:
        raise FormatError(f"{output}: expected a folder or a name ending in .npz for shapes, got {output.suffix}")


def check_shapes(
    output: Path, names: Collection[str], rest: ControlMesh, inputs: Sequence[Path], *, force: bool = False
) -> list[Path]:
    """The files that `write_shapes` writes for shapes of these names; refuses what it would refuse."""
    if output.suffix.lower() == ".npz":
        check_outputs([output], inputs, force=force)
        return [output]
    base = Path(rest.name).stem
    if base in names:
        raise FormatError(f"{output}: a shape is named {base}, like the cage itself. Rename it.")
    if output.exists() and not output.is_dir():
        raise FormatError(f"{output}: expected a folder or an .npz to write shapes to, got a file.")
    files = [output / f"{name}.obj" for name in (base, *names)]
    if any(file.parent != output for file in files):
        raise FormatError(f"{output}: names of shapes must not hold slashes, got {', '.join(names)}")
    if output.is_dir():
        bare = _without_materials(rest)
        check_outputs([path for file in files for path in mesh_files(file, bare)], inputs, force=force)
    else:
        require_writable_folder(output)
    return files


def _without_materials(mesh: ControlMesh) -> ControlMesh:
    return replace(mesh, face_materials=None, material_names=(), material_colors=None)


def write_shapes(
    output: Path, shapes: Mapping[str, FloatArray], rest: ControlMesh, inputs: Sequence[Path], *, force: bool = False
) -> list[Path]:
    """Write displacements as an ``.npz``, or as a folder of OBJ files with the cage at rest; returns the files."""
    files = check_shapes(output, shapes, rest, inputs, force=force)
    if output.suffix.lower() == ".npz":
        with atomic_path(output, force=force) as temporary:
            write_npz(temporary, dict(shapes), compressed=True)
        return files
    output.mkdir(exist_ok=True)
    bare = _without_materials(rest)
    meshes = bare, *(bare.with_positions(rest.positions + offset) for offset in shapes.values())
    for file, mesh in zip(files, meshes, strict=True):
        write_mesh(file, mesh, force=force)
    return files
