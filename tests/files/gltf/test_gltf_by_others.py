"""What independent readers and the Khronos validator say of written glTF, and mirrored nodes."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube, icosahedron
from scipy.spatial import cKDTree

from cagemap.character.values import Character, Part
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.write import character_glb, write_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.ownership import is_own
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import NO_UV, UvSet
from cagemap.subdivision import finest_mesh, refine
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import RefineRequest
from cagemap.transfer import unwrap

from example_result import textured_cube
from gltf_scenes import arm

READ = ("Fox.glb", "MorphStressTest.gltf", "saturday06_skinned_morph_vrm0.vrm", "mh_male_young_draco.glb")


def _inside(path: Path) -> dict[str, Any]:
    """What an independent reader finds."""
    pygltflib = pytest.importorskip("pygltflib")
    binary = path.read_bytes()[:4] == b"glTF"
    gltf = pygltflib.GLTF2().load_binary(str(path)) if binary else pygltflib.GLTF2().load_json(str(path))
    ends = []
    for animation in gltf.animations:
        inputs = [gltf.accessors[sampler.input] for sampler in animation.samplers]
        ends.append(round(max(entry.max[0] for entry in inputs), 5))
    places = [[gltf.accessors[primitive.attributes.POSITION] for primitive in mesh.primitives] for mesh in gltf.meshes]
    targets = [len(mesh.primitives[0].targets or []) for mesh in gltf.meshes]
    names = [(mesh.extras or {}).get("targetNames") for mesh in gltf.meshes]
    return {
        "nodes": [node.name for node in gltf.nodes],
        "low": [np.min([entry.min for entry in mesh], axis=0) for mesh in places],
        "high": [np.max([entry.max for entry in mesh], axis=0) for mesh in places],
        "morphs": (targets, names),
        "skins": [[gltf.nodes[joint].name for joint in skin.joints] for skin in gltf.skins],
        "animations": [animation.name for animation in gltf.animations],
        "ends": ends,
        "materials": [material.name for material in gltf.materials],
        "images": len(gltf.images),
        "extensions": sorted(gltf.extensions or {}),
    }


def _box(found: dict[str, Any]) -> tuple[list[Any], list[Any]]:
    return found.pop("low"), found.pop("high")


@pytest.mark.slow
@pytest.mark.parametrize("name", READ)
def test_round_trips_by_an_independent_reader(name: str, tmp_path: Path, shared_data: Path) -> None:
    """`refine --level 0` and a plain copy: bounding boxes, skins, morphs, lengths of animations."""
    given = shared_data / "characters" / "foreign" / name
    if "draco" in name:
        pytest.importorskip("DracoPy")
    before = _inside(given)
    low, high = _box(before)
    run_refine(RefineRequest(given, 0, tmp_path / "refined.glb"), Stages())
    write_document(tmp_path / "copied.glb", read_document(given))
    for path in (tmp_path / "refined.glb", tmp_path / "copied.glb"):
        after = _inside(path)
        size = np.max(np.ptp([low, high], axis=0))
        # Draco rounds, and the file states the bounds before.
        np.testing.assert_allclose(_box(after), (low, high), atol=(1e-4 if "draco" in name else 1e-6) * size)
        assert after == before


VALIDATE = """
const fs = require('fs'), validator = require(process.argv[1]);
(async () => {
  for (const file of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {maxIssues: 0});
    const errors = report.issues.messages.filter(one => one.severity === 0);
    console.log(JSON.stringify({file, errors: errors.slice(0, 5), count: report.issues.numErrors}));
  }
})();
"""


def _validator() -> str:
    """Folder of the Khronos validator; the test skips where it is not installed."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed, which runs the Khronos validator")
    found = subprocess.run(
        ["node", "-p", "require.resolve('gltf-validator')"], capture_output=True, text=True, check=False
    )
    if found.returncode:
        pytest.skip("the npm package gltf-validator is not installed (npm install gltf-validator; NODE_PATH)")
    return found.stdout.strip()


@pytest.mark.slow
@pytest.mark.usefixtures("fbx_server")
def test_the_khronos_validator_finds_no_errors(tmp_path: Path, shared_data: Path) -> None:
    validator = _validator()
    pytest.importorskip("DracoPy")
    pytest.importorskip("ufbx")
    place = shared_data / "characters"
    files = [*(place / "foreign" / name for name in (*READ, "mh_male_young.vrm")), place / "rigs" / "character_A.glb"]
    files += [place / "rigs" / "target_B_body.glb", *sorted((place / "foreign").glob("*.fbx"))]
    written = []
    for file in files:
        document = read_document(file)
        made = {"copied": document}
        if "draco" not in file.name:  # decoded, it is character_A
            character = character_of(document)
            made |= {"built": character_glb(character, document), "alone": character_glb(character)}
            written.append(tmp_path / f"{file.stem}_mesh.glb")
            write_mesh(written[-1], read_mesh(file))
        for kind, one in made.items():
            written.append(tmp_path / f"{file.stem}_{kind}.glb")
            write_document(written[-1], one)
    write_document(tmp_path / "made.glb", character_glb(character_of(arm()), arm()))
    reports = subprocess.run(
        ["node", "-e", VALIDATE, validator, *map(str, written), str(tmp_path / "made.glb")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert len(reports.splitlines()) == len(written) + 1
    assert [line for line in reports.splitlines() if json.loads(line)["count"]] == []


def test_a_refined_mesh_with_uvs_and_materials(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    mesh = finest_mesh(refine(textured_cube("box.obj"), 2))
    path = tmp_path / "box.glb"
    write_mesh(path, mesh)
    assert is_own(path)
    pieces = list(trimesh.load(path, process=False).geometry.values())
    assert [piece.visual.material.name for piece in pieces] == ["red", "unknown"]
    np.testing.assert_array_equal(pieces[0].visual.material.baseColorFactor, [204, 13, 13, 255])
    found = np.concatenate([np.column_stack([one.vertices, one.visual.uv])[one.faces.ravel()] for one in pieces])
    assert len(found) == 3 * 2 * mesh.n_faces
    # Every corner of every quad is there with its own UV.
    expected = np.column_stack([mesh.positions[mesh.face_indices], mesh.uvs[mesh.uv_indices]])
    for one, other in ((found, expected), (expected, found)):
        assert cKDTree(one).query(other)[0].max() < 1e-6
    normals = pieces[0].vertex_normals
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert np.einsum("nx,nx->n", normals, pieces[0].vertices).min() > 0  # a cube about the origin: outwards


def test_polygons_below_a_mirrored_node_are_reversed_with_their_uvs(tmp_path: Path) -> None:
    """A pentagon and a triangle: eight corners, which are not two quads."""
    positions = np.array([(0, 0, 0), (1, 0, 0), (1.5, 0.5, 0), (1, 1, 0), (0, 1, 0), (2, 2, 0)])
    mesh = ControlMesh.from_faces(positions, [[0, 1, 2, 3, 4], [2, 5, 3]]).with_uvs(
        positions[:, :2], [0, 1, 2, 3, 4, 2, 5, 3]
    )
    write_glb(tmp_path / "mirrored.glb", mesh, to_metres=np.diag([-1.0, 1.0, 1.0, 1.0]))
    again = read_mesh(tmp_path / "mirrored.glb")
    expected = [positions[face] * [-1, 1, 1] for face in ([0, 4, 3, 2, 1], [2, 3, 5])]
    np.testing.assert_array_equal(again.positions[again.face_indices], np.concatenate(expected))
    np.testing.assert_array_equal(again.uvs[again.uv_indices] * [-1, 1], np.concatenate(expected)[:, :2])


def test_new_uvs_are_written_into_a_document(tmp_path: Path) -> None:
    box, ball = unwrap(cube()), icosahedron()
    sets = (UvSet("TEXCOORD_1", box.uvs / 4, box.uv_indices),)
    parts = (Part("box", replace(box, uv_name="TEXCOORD_0", uv_sets=sets)), Part("ball", ball))
    write_document(tmp_path / "pair.glb", character_glb(Character(parts)))
    mesh = read_mesh(tmp_path / "pair.glb")
    corners = len(box.face_indices)
    changed = np.where(np.arange(len(mesh.uv_indices))[:, None] < corners, 0.5 * mesh.uvs[mesh.uv_indices], NO_UV)
    laid_out = mesh.with_uvs(changed, np.arange(len(changed)))
    write_mesh(tmp_path / "new.glb", laid_out, like=tmp_path / "pair.glb")
    box_again, ball_again = (part.mesh for part in read_character(tmp_path / "new.glb").parts)
    assert ball_again.uvs is None
    np.testing.assert_allclose(box_again.uvs[box_again.uv_indices], changed[:corners], atol=1e-7)
    (other,) = box_again.uv_sets
    np.testing.assert_allclose(other.uvs[other.uv_indices], (box.uvs / 4)[box.uv_indices], atol=1e-7)
