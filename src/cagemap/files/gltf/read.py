"""Control meshes of glTF files: all meshes of the scene, welded at the seams that the format splits."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.parts import ReadPart, Scene, read_scene
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import join_meshes

_log = logging.getLogger(__name__)


def read_gltf(path: str | Path) -> ControlMesh:
    """Read the meshes of a ``.glb``, ``.gltf``, ``.vrm`` or ``.fbx`` file as one, in world space, in the bind pose.

    Mesh nodes become objects. Vertices that the file splits at seams are joined; they are numbered as
    `cagemap.files.gltf.character.read_character` numbers its parts, one part after the other. The scheme is
    none: triangles of a glTF are the surface itself.

    Raises
    ------
    FormatError
        As `cagemap.files.gltf.document.read_document`; also if the scene has no triangles.
    """
    scene = read_scene(read_document(path))
    for one in scene.parts:
        for note in one.notes:
            _log.info("%s: %s", path, note)
    return scene_mesh(scene)


def scene_mesh(scene: Scene) -> ControlMesh:
    """All meshes of a scene as one."""
    parts = scene.parts
    joined = join_meshes([_object(one) for one in parts]) if len(parts) > 1 else parts[0].part.mesh
    return replace(joined, name=scene.document.file.name, file_vertices=None, file_faces=None, file_copies=None)


def _object(one: ReadPart) -> ControlMesh:
    mesh = one.part.mesh
    return replace(mesh, face_objects=np.zeros(mesh.n_faces, dtype=np.int64), object_names=(one.part.name,))
