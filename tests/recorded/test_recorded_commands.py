"""What commands print and write is what it was when it was recorded."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.character.joints import Skeleton
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.npz import write_npz
from cagemap.files.result.folder import write_result
from cagemap.files.values.rigs import write_skeleton
from cagemap.subdivision import refine
from recorded import check

from command_line import Run
from example_result import identity_result, textured_cube

COMMANDS = {
    "texture": "transfer R --texture skin.png -o o.png --size 40",
    "textures": "transfer R --texture color=skin.png --texture height=grey.png -o o.tif --size 24 --bits 16",
    "normals": "transfer R --normal-map skin.png -o o.png --size 24 --green down",
    "heights": "transfer R --displacement grey.png -o o.exr --size 24 --scale 0.5 --bits 32",
    "vectors": "transfer R --vector-displacement skin.png -o o.exr --size 24 --bits 16",
    "colors": "transfer R --material-colors -o o.png --size 32",
    "bakes": "transfer R --bake normal,displacement,ao --detail fine.obj --rays 9 -o o.png --size 24",
    "values": "transfer R --attribute values.npz -o o.npz",
    "table": "transfer R --attribute weights.npz -o o.csv",
    "weights": "transfer R --weights weights.npz -o o.npz --influences 2 --mirror",
    "joints": "transfer R --joints rig.json -o o.json",
    "clothes": "transfer R --passenger hat.obj -o o.obj",
    "layout": "transfer R --source-uvs -o o.obj",
    "map": "transfer R --write-map -o o.npz --level 1",
    "masked": "transfer R --texture skin.png -o o.png --size 24 --target-mask grey.png --base under.png",
    "wrap": "wrap R -o o.obj",
    "wrap images": "wrap R -o o.obj --displacement d.exr --normal-map n.png --occlusion a.png --size 16 --rays 9",
    "wrap finer": "wrap R -o o.ply --fit-level 1 --amount 0.5 --fairness 0.01 --symmetric",
    "shapes": "wrap R R2 --blend-shapes -o shapes",
    "check": "check small.obj open.obj --json",
    "check words": "check small.obj open.obj",
    "refine": "refine small.obj --level 2 -o o.ply",
    "suggest": "suggest R -o o.json",
    "import": "map t.npz -t large.obj -s small.obj -o NEW --level 2",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two cubes, one twice as large, mapped onto each other in R, and what their files may bring."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(5)
    write_result("R", identity_result(2))
    write_result("R2", identity_result(2, (textured_cube("large.obj", 2.0), textured_cube("other.obj", 1.5))))
    for name, scale in (("small", 1.0), ("large", 2.0), ("hat", 1.1)):
        write_mesh(f"{name}.obj", textured_cube(f"{name}.obj", scale))
    fine = refine(cube(), 3).finest
    fine_mesh = cube().from_faces(fine.positions + 0.02 * np.sin(9.0 * fine.positions[:, [1, 2, 0]]), fine.faces)
    write_mesh("fine.obj", fine_mesh)
    Path("open.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 5 5\nf 1 2 3 4\nf 4 3 2 1\n")
    write_image("skin.png", rng.integers(0, 256, (24, 36, 3), dtype=np.uint8))
    write_image("under.png", rng.integers(0, 256, (24, 24, 3), dtype=np.uint8))
    write_image("grey.png", np.linspace(0, 65535, 24 * 24).reshape(24, 24, 1).astype(np.uint16))
    write_npz(Path("values.npz"), {"fur": rng.random(8), "wind": rng.random((8, 3)), "group": np.arange(6)})
    weights = rng.dirichlet(np.ones(3), 8)
    write_npz(Path("weights.npz"), {name: weights[:, k] for k, name in enumerate(("hip", "arm_L", "arm_R"))})
    heads = np.array([[0.0, 0, 0], [0.4, 0.1, 0], [-0.4, 0.1, 0]])
    write_skeleton(Path("rig.json"), Skeleton(("hip", "arm_L", "arm_R"), ("", "hip", "hip"), heads, heads + 0.2))
    write_npz(Path("t.npz"), {"vertices": np.arange(98)})
    return tmp_path


def content(file: Path) -> Any:
    """Values of a file, without what depends on the machine."""
    if file.suffix in (".png", ".exr", ".tif"):
        return read_image(file).pixels
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            return {name: arrays[name] for name in sorted(arrays.files) if arrays[name].dtype.kind in "biuf"}
    if file.suffix == ".ply":
        return read_mesh(file)
    if file.name == "manifest.json":
        machine = ("versions", "timings", "peak_memory_bytes", "checksum", "cagemap", "arrays")
        return {name: value for name, value in json.loads(file.read_text()).items() if name not in machine}
    return [line for line in file.read_text(encoding="utf-8").splitlines() if "checksum" not in line]


@pytest.mark.parametrize("name", COMMANDS)
def test_commands(run: Run, folder: Path, name: str) -> None:
    before = {*folder.rglob("*")}
    outcome = run(COMMANDS[name])
    files = sorted(file for file in folder.rglob("*") if file not in before and file.is_file())
    written = {file.relative_to(folder).as_posix(): content(file) for file in files}
    lines = [line for line in (outcome.out + outcome.err).splitlines() if " s" not in line[-9:]]
    check(f"command_{name.replace(' ', '_')}", [outcome.code, lines, written], 1e-4, folder)
