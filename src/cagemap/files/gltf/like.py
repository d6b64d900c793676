"""A mesh in place of that of a glTF file, with everything else that the file holds."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.character.normals import move_vertices
from cagemap.errors import FormatError
from cagemap.files.gltf.build import character_glb
from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.write import write_glb
from cagemap.mesh import ControlMesh

_log = logging.getLogger(__name__)


def write_glb_like(path: str | Path, mesh: ControlMesh, like: str | Path, *, force: bool = False) -> None:
    """Write a mesh as ``.glb``, in place of the meshes of a glTF or FBX file where it has their vertices and faces.

    Materials, textures, skins, blend shapes, animations and extensions of the file are kept then. Another mesh is
    written alone, with a warning where the file has a skeleton, shapes or animations.

    Raises
    ------
    FormatError
        If the file cannot be written.
    """
    try:
        document = read_document(like)
    except FormatError:  # gone or changed since
        write_glb(path, mesh, force=force)
        return
    character = character_of(document)
    sizes = [part.mesh.n_vertices for part in character.parts]
    starts = np.cumsum([0, *sizes])
    faces = np.concatenate(
        [part.mesh.face_indices + start for part, start in zip(character.parts, starts[:-1], strict=True)]
    )
    if mesh.n_vertices != starts[-1] or not np.array_equal(mesh.face_indices, faces):
        if character.rig is not None or character.animations or any(part.shapes for part in character.parts):
            _log.warning(
                "%s: other vertices or faces than %s: its skeleton, shapes, animations are left out", path, like
            )
        write_glb(path, mesh, force=force)
        return
    places = np.split(mesh.positions, starts[1:-1])
    parts = tuple(move_vertices(part, own) for part, own in zip(character.parts, places, strict=True))
    write_document(path, character_glb(replace(character, parts=parts), document), force=force)
