"""What an independent reader and the Khronos validator say of written glTF."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import RefineRequest

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
