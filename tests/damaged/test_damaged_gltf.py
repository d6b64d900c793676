"""Damaged glTF, GLB and VRM files: a named error or a valid result, never another exception or a large array.

Containers that are cut short: tests/files/gltf/test_gltf_document.py.
"""

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.errors import FormatError
from cagemap.files.gltf.character import character_of, humanoid_bones
from cagemap.files.gltf.document import glb_bytes, read_document, write_document
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.read import contents_of
from cagemap.files.gltf.write import character_glb
from cagemap.mesh.checks import check_mesh
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import CheckRequest

from damage import cases, mutated_bytes, mutated_entries, outcome, refused_share
from fbx_scenes import Fbx, Node, fbx_arm
from gltf_scenes import arm
from refusals import refuses

SUFFIXES = (".glb", ".gltf", ".vrm")
FOREIGN = ("Fox.glb", "MorphStressTest.gltf", "saturday06_skinned_morph_vrm0.vrm", "mh_male_young_draco.glb")
# What a number of a file becomes, among others.
NUMBERS = (0, 1, -1, 2**31, 4_000_000_000, 2**53, 1e300, 0.5, -0.0)


def use(path: Path) -> None:
    """What `check` does, and a copy of the file as it is and as a character."""
    text, _ = run_check(CheckRequest((path,)), Stages())
    if "cannot be read" in text:
        raise FormatError(text)
    document = read_document(path)
    glb_bytes(document)
    character = character_of(document)
    assert all(np.isfinite(part.mesh.positions).all() for part in character.parts)
    glb_bytes(character_glb(character, document))


def with_number(entries: Any, rng: np.random.Generator) -> Any:
    """JSON with one of its numbers replaced."""
    copied = json.loads(json.dumps(entries))
    places: list[tuple[Any, Any]] = []
    nodes = [copied]
    while nodes:
        node = nodes.pop()
        for key in node if isinstance(node, dict) else range(len(node)):
            if isinstance(node[key], dict | list):
                nodes.append(node[key])
            elif isinstance(node[key], int | float) and not isinstance(node[key], bool):
                places.append((node, key))
    node, key = places[rng.integers(len(places))]
    node[key] = NUMBERS[rng.integers(len(NUMBERS))]
    return copied


def damaged(document: Document, content: bytes, suffix: str, rng: np.random.Generator) -> bytes:
    """A file with bytes or JSON changed; with the JSON, lengths of chunks are right."""
    kind = rng.integers(4)
    if kind < 2:
        return mutated_bytes(content, rng)
    if kind == 2 and len(document.buffers[0]) > 8:
        blob = bytearray(document.buffers[0])
        for at in rng.integers(0, len(blob), 4).tolist():
            blob[at] = int(rng.integers(256))
        top, blobs = document.json, bytes(blob)
    else:
        change = with_number if rng.random() < 0.7 else mutated_entries
        top, blobs = change(document.json, rng), document.buffers[0]
    return json.dumps(top).encode() if suffix == ".gltf" else container(top, blobs)


def container(top: Any, blobs: bytes) -> bytes:
    """A GLB file of any JSON."""
    text = json.dumps(top).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blobs), b"BIN\0") + blobs
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _vrm() -> Document:
    document = arm(above={"scale": [0.1, 0.1, 0.1]})
    bones = {"humanoid": {"humanBones": {"hips": {"node": 1}, "chest": {"node": 2}}}}
    image = b"\x89PNG" + bytes(60)
    json_ = document.json | {
        "extensionsUsed": ["VRMC_vrm"],
        "extensions": {"VRMC_vrm": bones, "VRM": {"humanoid": {"humanBones": [{"bone": "hips", "node": 1}]}}},
        "materials": [{"name": "skin", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": len(document.json["bufferViews"]), "mimeType": "image/png"}],
    }
    view = {"buffer": 0, "byteOffset": len(document.buffers[0]), "byteLength": len(image)}
    json_["bufferViews"] = [*document.json["bufferViews"], view]
    json_["buffers"] = [{"byteLength": len(document.buffers[0]) + len(image)}]
    json_["meshes"][0]["primitives"][0]["material"] = 0
    return replace(document, json=json_, buffers=(document.buffers[0] + image,))


def _mutate(path: Path, document: Document, count: int) -> float:
    """Read damaged copies of a file; which share was refused."""
    rng = np.random.default_rng([7, *path.name.encode()])
    content = path.read_bytes()
    beside = set(path.parent.iterdir())
    refused = refused_share(path, use, lambda: damaged(document, content, path.suffix, rng), count)
    assert set(path.parent.iterdir()) == beside
    return refused


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_copies_of_a_made_file(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"made{suffix}"
    write_document(path, _vrm())
    assert 0.25 < _mutate(path, read_document(path), 120) < 1


@pytest.mark.slow
@pytest.mark.parametrize("name", FOREIGN)
def test_damaged_copies_of_files_as_they_come(name: str, tmp_path: Path, shared_data: Path) -> None:
    if "draco" in name:
        pytest.importorskip("DracoPy")
    path = tmp_path / name
    path.write_bytes((shared_data / "characters" / "foreign" / name).read_bytes())
    raw = json.loads(path.read_bytes()) if path.suffix == ".gltf" else _json_of(path.read_bytes())
    blob = read_document(path).buffers[0]
    assert 0 < _mutate(path, Document(raw, (blob,), path), 3 if "draco" in name else 30) < 1


@pytest.mark.slow
@pytest.mark.usefixtures("fbx_server")
def test_damaged_copies_of_an_fbx_file(tmp_path: Path) -> None:
    """The library reads them in a process of its own, which may stop: this one goes on with a named error."""
    pytest.importorskip("ufbx")
    path, rng = tmp_path / "made.fbx", np.random.default_rng(7)

    def made() -> Fbx:
        return fbx_arm(image=b"\x89PNG" + bytes(60), leaf=True, posed=True)

    path.write_bytes(made().bytes())
    use(path)
    numbers, refused = cases(16), 0
    for number in numbers:
        changed = made()
        arrays = _arrays(changed.objects)
        for array in (arrays[place] for place in rng.permutation(len(arrays))[: number % 4]):
            wrong = (-1, 0, 7, 999_999) if array.dtype.kind == "i" else (np.nan, np.inf, 1e30, -1.0, 0.0)
            array[rng.integers(len(array))] = wrong[rng.integers(len(wrong))]
        path.write_bytes(changed.bytes() if number % 4 else mutated_bytes(changed.bytes(), rng))
        refused += not outcome(lambda: use(path))
    assert list(tmp_path.iterdir()) == [path]
    assert 0 < refused < len(numbers)


def _arrays(records: Sequence[Node]) -> list[np.ndarray]:
    """All arrays with numbers in FBX records."""
    own = [value for one in records for value in one.properties if isinstance(value, np.ndarray) and value.size]
    return own + [array for one in records for array in _arrays(one.inside)]


def _json_of(content: bytes) -> Any:
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length])


CHANGES: dict[str, Callable[[Any], Any]] = {
    "joint of another file": lambda top: top["skins"][0]["joints"].append(99),
    "joint twice": lambda top: top["skins"][0]["joints"].append(1),
    "animation of no node": lambda top: top["animations"][0]["channels"][0]["target"].update(node=77),
    "sampler of no animation": lambda top: top["animations"][0]["channels"][0].update(sampler=5),
    "texture that is not there": lambda top: top["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"].update(
        index=3
    ),
    "image that is none": lambda top: top["images"][0].update(bufferView=0),
    "bone of no node": lambda top: top["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]["hips"].update(node=-1),
    "attributes that are a list": lambda top: top["meshes"][0]["primitives"][0].update(attributes=[1]),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_refused_by_name(change: str, tmp_path: Path) -> None:
    document = _vrm()
    top = json.loads(json.dumps(document.json))
    CHANGES[change](top)
    path = tmp_path / "made.vrm"
    path.write_bytes(container(top, document.buffers[0]))
    refuses(FormatError, r"made\.vrm", _all_of, path)


def _all_of(path: Path) -> None:
    document = read_document(path)
    character = character_of(document)
    humanoid_bones(document)
    contents_of(read_scene(document))
    for image in range(len(document.json.get("images", ()))):
        image_bytes(document, image)
    check_mesh(character.parts[0].mesh)
