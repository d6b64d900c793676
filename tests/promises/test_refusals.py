"""Commands that cannot do what is asked say why, end with 2 and write nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.npz import write_npz
from cagemap.files.result.folder import write_result

from command_line import Run
from example_result import identity_result

JOINT = {"name": "hip", "parent": None, "head": [0, 0, 0], "tail": [0, 1, 0]}
WRAP, SHAPES, MATCH = "wrap R -o n.obj", "transfer R -o o.npz --blend-shapes", "match -t box.obj -s box.obj -o Q"
DETAIL = "transfer R --bake texture --detail-texture t.png -o o.png"
REFUSED = {
    f"{WRAP} --texture t.png": "expected an image and the one to write, got one of them",
    f"{WRAP} --scheme loop": "a RESULT has its schemes",
    f"{WRAP} --weights two.npz": "expected one column of weights from 0 to 1, got a, b",
    f"{WRAP} --symmetric --fit-level 1": "expected --fit-level 0",
    "wrap BARE -o n.obj --symmetric": "found no symmetry",
    "wrap BARE -o n.obj --normal-map n.png": "expected texture coordinates to bake into",
    "wrap R BARE --blend-shapes -o new": "expected results of one target",
    "wrap R R --blend-shapes -o new": "expected different names, got large, small, small",
    "wrap R --blend-shapes -o t.png": "writes a folder of OBJ files, got a file",
    DETAIL: "expected --detail, the mesh that the image belongs to",
    f"{DETAIL} --detail box.obj": "box.obj: expected texture coordinates for --detail-texture",
    "transfer BARE --source-uvs -o o.obj": "expected a source with texture coordinates to carry",
    "transfer R --vector-displacement t.png --scale 0 -o o.png": "scale: expected a number other than 0",
    "transfer R --weights below.npy -o o.npz": "below.npy: ",
    "transfer R --weights skin.npy --joints one.json -o o.npz": "expected weights of 1 joints",
    "transfer R --joints twice.json -o o.json": "expected joints of different names",
    "transfer R --joints nowhere.json -o o.json": "expected finite positions of heads and tails",
    "transfer R --joints number.json -o o.json": "expected a list of joints",
    f"{SHAPES} nan.npz": "expected finite displacements in 'smile', found others at 1 vertices",
    f"{SHAPES} smile.npz --blend-shapes smile.npz": "a shape named smile was read before",
    f"{SHAPES} empty": "found none (.obj, .ply or .npz)",
    "transfer R --blend-shapes large.npz -o faces": "like the cage itself",
    "transfer R --blend-shapes slash.npz -o faces": "must not hold slashes",
    "transfer R --blend-shapes smile.npz -o t.png": "expected a folder or an .npz to write shapes to",
    f"{MATCH} --target-mask two.npz": "expected one array of values, got a, b",
    f"{MATCH} --curves pairs.json": "expected curves alone, got landmarks",
    f"{MATCH} --method hfm --answer 1": "expected the method elastic, which alone finds several",
}


@pytest.fixture
def place(result_folder: Path) -> Path:
    """RESULT folders, one of meshes without UVs and symmetry, and values that do not fit."""
    folder = result_folder.parent
    uneven = replace(cube(), positions=cube().positions * np.linspace(1, 2, 8)[:, None], name="bare.obj")
    write_result(folder / "BARE", identity_result(2, (uneven, uneven)))
    write_mesh(folder / "box.obj", cube())
    write_image(folder / "t.png", np.zeros((8, 8, 3), np.uint8))
    for name, joints in (
        ("one", [JOINT]),
        ("twice", [JOINT, JOINT]),
        ("nowhere", [JOINT | {"head": [0, float("nan"), 0]}]),
        ("number", 7),
        ("pairs", {"source": "box.obj", "target": "box.obj", "pairs": [{"name": "a", "source": 0, "target": 0}]}),
    ):
        (folder / f"{name}.json").write_text(json.dumps(joints))
    np.save(folder / "skin.npy", np.full((8, 3), 1 / 3))
    np.save(folder / "below.npy", np.full((8, 3), -1.0))
    offsets = np.ones((8, 3))
    for name, arrays in (
        ("two", {"a": np.ones(8), "b": np.ones(8)}),
        ("smile", {"smile": offsets}),
        ("nan", {"smile": np.where(np.arange(8)[:, None] == 3, np.nan, offsets)}),
        ("large", {"large": offsets}),
        ("slash", {"a/b": offsets}),
    ):
        write_npz(folder / f"{name}.npz", arrays)
    (folder / "empty").mkdir()
    return folder


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_done_is_refused(run: Run, place: Path, words: str) -> None:
    before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
    run.refused(*words.split(), says=REFUSED[words])
    assert {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} == before
