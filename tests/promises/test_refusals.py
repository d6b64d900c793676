"""Commands that cannot do what is asked say why, end with 2 and write nothing."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, torus

from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.npz import write_npz
from cagemap.files.result.folder import write_result

from example_result import identity_result, textured_cube
from textured_files import write_textured_scene

JOINT = {"name": "hip", "parent": None, "head": [0, 0, 0], "tail": [0, 1, 0]}
WRAP, SHAPES, MATCH = "wrap R -o n.obj", "transfer R -o o.npz --blend-shapes", "match -t box.obj -s box.obj -o Q"
DETAIL = "transfer R --bake texture --detail-texture t.png -o o.png"
REFUSED: dict[str | tuple[str, ...], str] = {
    f"{WRAP} --texture t.png": "expected both or neither, an image and the one to write",
    f"{WRAP} --scheme loop": "expected with --target only",
    f"{WRAP} --amount 2": "--amount",
    f"{WRAP} --amount 0.5 --displacement d.exr": "--amount 1",
    f"{WRAP} --weights five.npy": "8 control vertices of large.obj, the target, got 5",
    f"{WRAP} --fit-level 3": "level below",
    f"{WRAP} --target t.obj": "--target and --source",
    "wrap R R -o n.obj": "--blend-shapes",
    "wrap -o n.obj": "RESULT",
    "wrap -t t.obj -s s.obj --scheme none -o n.obj": "(--target-scheme): catmull-clark, loop",
    "wrap R -o n --blend-shapes --displacement d.exr": "no --blend-shapes",
    "wrap R -o n.stl": "n.stl",
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
    "transfer R -o o.png": "expected one of",
    **{
        f"transfer R --texture t.png --usd o.usda -o {name}": "a name without backslashes or control characters"
        for name in ("o\1.png", *(["a\\b.png"] if os.name == "posix" else []))
    },
    "transfer R --texture t.png --material-colors -o o.png": "expected one of",
    "transfer R --texture none.png -o o.png": "none.png: expected an image, there is no such file",
    "transfer R --texture t.png --bits 32 -o o.png": "choose 8 or 16 bits",
    "transfer R --texture t.png -o o.exr": "choose 16 or 32 bits",
    "transfer R --texture t.png -o o.png --bits 12": "8, 16 or 32",
    "transfer R --texture t.png -o .": "got a folder",
    "transfer R --texture t.png -o o": "got no suffix",
    f"transfer R --texture t.png -o {300 * 'o'}": "got no suffix",
    **{
        f"transfer R --displacement h.exr --{option} {value} -o o.exr": f"--{option}: expected a finite number"
        for option in ("scale", "midlevel")
        for value in ("nan", "inf", "-inf")
    },
    "transfer R --write-map -o m.txt": ".npz",
    "map five.npy -t box.obj -s box.obj --level 2 -o Q": "each vertex of the target",
    "transfer R --weights below.npy -o o.npz": "below.npy: ",
    "transfer R --weights short.csv -o o.npz": "one a vertex",
    "transfer R --weights legs.csv --joints one.json -o o.npz": "knee",
    "transfer R --weights legs.csv --texture t.png -o o.png": "Run the command once",
    "transfer R --joints orphan.json -o o.json": "root",
    f"{SHAPES} other.obj": "8 vertices",
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
    f"{WRAP} --detail box.obj": "expected an image to bake from it",
    f"{WRAP} --detail-texture t.png --baked b.png": "--detail-texture: expected --detail, and no --texture",
    f"{WRAP} --landmarks pairs.json": "expected RESULT folders, or --target and --source together",
    f"{WRAP} --mask-edge 0.1": "--mask-edge: expected with --target-mask or --source-mask only",
    f"{WRAP} --texture plain.gltf --baked b.png": "expected a colour image on most of",
    "wrap -t box.obj -s box.obj --map five.npy --landmarks pairs.json -o n.obj": "since nothing is matched",
    "transfer R --bake colors -o o.png": "expected colours at its vertices to bake",
    "transfer R --bake normal -o o.png": "expected --detail, a detailed mesh that lies on the source",
    "transfer R --bake texture -o o.png": "expected both or neither, got one of them",
    "transfer BARE --texture t.png -o o.png": "expected texture coordinates of the source",
    "transfer BARE --texture t.png --unwrap -o o.png": "bare.obj: expected texture coordinates of the source",
    "transfer BARE --texture box.gltf -o o.png": "expected texture coordinates of the source",
    "transfer R --texture other.gltf -o o.png": "other.gltf: expected a colour image on most of small.obj for its UV",
    "transfer R --texture plain.gltf -o o.png": "give an image made for these UVs, or bake --material-colors",
    "transfer FLAT --texture t.png -o o.png": "all of them are in one point or on a line. Add --unwrap",
    **{
        f"transfer R --{option} --base t.png -o o.obj": "--base: expected with"
        for option in ("source-uvs", "write-map")
    },
    "transfer R --blend-shapes empty --base t.png -o o.obj": "--base: expected with",
    "transfer BARE --texture scan.stl -o o.png": "mesh without UVs and colours has no look to transfer",
    "transfer BARE --material-colors -o o.png": "mesh without UVs and colours has no look to transfer",
    "transfer COLORED --texture t.png -o o.png": "`transfer --bake colors`",
    "transfer COLORED --material-colors -o o.png": "`transfer --bake colors`",
    "transfer R --attribute box.ply -o o.npz": "expected a file of values ending in .npy, .npz, .csv, .json, .usd",
    "transfer R --attribute box.gltf -o o.npz": "got .gltf. Give its weights and shapes to --weights and --blend",
    "transfer R --weights box.ply -o o.npz": "or in a glTF, FBX or USD file, got .ply. Export them",
    "transfer R --joints box.ply -o o.json": "expected joints as .json, or in a glTF, FBX or USD file, got .ply",
    "transfer R --normal-map box.ply -o o.png": "could not open it: it has another format. Export it again",
    "transfer R --texture box.ply -o o.png": "expected a colour image on most of small.obj",
    "transfer R --texture t.png --texture h.exr -o o.png": "with a name of its own each",
    "transfer R --texture a/b=t.png --texture c=t.png -o o.png": "expected names of letters, digits, - and _",
    "transfer R --weights legs.csv --only toe -o o.npz": "--only: expected names of joints (hip, knee), got toe",
    "transfer R --weights legs.csv --only hip -o o.npz": "expected the target's own weights of the other joints",
    "transfer R --weights legs.csv --only hip --base skin.npy -o o.npz": "--base skin.npy: expected",
    f"{MATCH} --target-mask t.png": "has no texture coordinates that t.png could be painted on",
    f"{MATCH} --target-points one.json": "expected both, and no --landmarks beside them",
    "refine box.obj -l 13 -o q.obj": "would have too many vertices, expected at most 20,000,000",
    f"{MATCH} --method hfm --answer 1": "expected the method elastic, which alone finds several",
    "refine gone.obj --level 1 -o q.obj": "gone.obj",
    "refine box.obj --level 1000 -o q.obj": "Use --level 10 or less",
    "refine box.obj --level 1 -o q.stl": "ending in .obj, .ply",
    "refine box.obj --level 1 -o nowhere/q.obj": "nowhere",
    "refine box.obj --level -1 -o q.obj": "--level",
    "match --target box.obj -o Q": "--source",
    f"{MATCH} --method hfm": "at least 3 pairs",
    f"{MATCH} --level 2 --vertices 5": "got both",
    f"{MATCH} --set schedule=10,x": "100,50,50,50",
    f"{MATCH} --landmarks gone.json": "gone.json",
    f"{MATCH} --method magic": "hfm",
    "transfer gone --texture t.png -o o.png": "cagemap match",
    "transfer box.obj --texture t.png -o o.png": "found a file",
    "report gone": "cagemap match",
    "report R -o r.pdf": "ending in .html or .htm, got .pdf",
    "match --target . --source box.obj -o Q": "got a folder",
    "wrap box.obj box.obj -o n.obj": "Meshes are given by --target and --source",
    "run .": "got a folder",
    "run box.obj/inside.toml": "there is no such file",
    "demo -o box.obj": "box.obj",
    "demo -o painted": "pony.png: exists",
    "demo -o .": "RESULT: the folder holds files but no map.npz and manifest.json",
    "suggest R -o t.png": "ending in .json",
    ("demo -o", ""): "-o: expected a value, got an empty one",
    f"{MATCH} --force --output=": "--output: expected a value",
    "demo -o -": "nothing is written to standard output",
    "demo --output=-": "--output: expected a name, got '-'",
    "dance": "dance",
    "studio --no-browser --folder none": "--folder none: expected a folder, found none. Check the name.",
    "studio --no-browser -t a.obj -s b.obj": "a.obj: expected a mesh file, found none. Check the name.",
    **{
        f"transfer R --write-map -o o.npz --{option}": f"--{option.split()[0]}"
        for option in (
            "usd a.usda",
            "space object",
            "green down",
            "as-color",
            "filter nearest",
            "detail box.obj",
            "detail-texture t.png",
            "rays 3",
            "influences 3",
            "only hip",
            "mirror",
            "size 8",
            "bits 16",
            "scale 2",
            "midlevel 0.5",
            "unwrap",
        )
    },
    "transfer R --texture t.png --mask-edge 0.1 -o o.png": "--mask-edge: expected with --target-mask",
    "transfer R --write-map --target-mask front -o o.npz": "--target-mask: expected with --texture or",
    "transfer R --normal-map t.png --space world -o o.png": "'tangent', 'object'",
    "transfer R --normal-map t.png --green left -o o.png": "'up', 'down'",
    "transfer R --normal-map t.png --space object --green down -o o.png": "--green: expected with --space tangent",
    "transfer R --weights legs.csv --only hip --base foot.csv -o o.npz": "expected values of hip, knee, as what",
    "transfer R --weights skin.npy --mirror -o o.npy": "named joints",
    "transfer R --attribute far.json -o o.json": "another mesh",
    "transfer R --attribute again.json -o o.json": "every vertex once",
    "transfer R --attribute weighed.json -o o.json": "a weight for each",
    "transfer R --attribute parts.json -o o.json": "groups",
    "functions box.obj --kinds heat -o f.npz": "--kinds: expected some of eigenfunctions",
    "functions box.obj -o f.obj": "--output: expected a name ending in .npz, .npy, .csv or .ply",
    "functions box.obj --kinds eigenfunctions,heat-signatures -o f.npy": "expected one kind for .npy, got 2",
    "functions box.obj --kinds heat-kernels -o f.npz": "--points: expected control vertices from 0 to 7",
    "functions box.obj --kinds wave-kernels --points 0,999 -o f.npz": "--points: expected control vertices",
    "functions box.obj --column 3 -o f.npz": "--column: expected a .ply",
    "functions box.obj --literal -o f.npz": "--literal: expected a --schedule",
    "functions box.obj --laplacian x -o f.npz": "--laplacian: expected mean",
    **{
        f"functions box.obj --{option} -o f.npz": f"--{option.split()[0]}: expected with --kinds"
        for option in ("heat 3", "wave 3", "points 0,7")
    },
    "face box.glb -o F.obj": "expected a name ending in .glb",
    "face box.glb -o box.glb": "box.glb",
    "face box.glb -o F.glb --only tongueOut": "tongueOut is not among the shapes",
    "face box.glb -o F.glb --only ,": "expected names of shapes",
    "face box.glb -o F.glb --part nose": "expected a part named 'nose'",
    "face box.glb -o F.glb --landmarks ear.json": "expected points of a face named",
    f"{MATCH} --set schedule": "--set: expected NAME=VALUE or a .toml file, got 'schedule'",
    f"{MATCH} --set scheduel=3": "--set scheduel: expected one of accuracy, laplacian, literal, schedule",
    f"{MATCH} --set target_k=3": "--set target_k: expected one of ",
    f"{MATCH} --set target.k=many": "--set target.k: expected a whole number, got 'many'",
    f"{MATCH} --set target.k=-3": "--set target.k: expected 3 or more, got '-3'",
    f"{MATCH} --set target.level=1.5": "--set target.level: expected a whole number, got '1.5'",
    f"{MATCH} --set accuracy=nan": "--set accuracy: expected a finite number, got 'nan'",
    f"{MATCH} --set target.vertices=0": "--set target.vertices: expected 1 or more, got '0'",
    f"{MATCH} --set literal=perhaps": "--set literal: expected true or false, got 'perhaps'",
    f"{MATCH} --set laplacian=cotan": "--set laplacian: expected mean, alexa-wardetzky",
    f"{MATCH} --set source.laplacian=alexa-wardetzky:x": "--set source.laplacian: expected mean",
    f"{MATCH} --set target.laplacian=alexa-wardetzky:0": "stabilisation: expected a finite number above 0",
    f"{MATCH} --set laplacian=mean:2": "the last two with :LAMBDA",
    f"{MATCH} --set literal=yes": "--set literal: expected a schedule of the target",
    f"{MATCH} --set literal=yes --set schedule=9,5 --set source.k=9": "literal: expected a schedule of the source",
    f"{MATCH} --set accuracy=0.1": "--set accuracy: expected a residual",
    f"{MATCH} --set source.accuracy=0.1": "--set source.accuracy: expected a residual",
    f"{MATCH} --set target.k=0": "--set target.k: expected 3 or more, got '0'",
    f"{MATCH} --set target.level=0": "--set target.level=0: expected 1 or more",
    f"{MATCH} --set source.level=13": "--set source.level=13",
    f"{MATCH} --level 13": "--level 13",
    f"{MATCH} --method hfm --set method.rounds=3": "for hfm, got 'rounds=3'",
    f"{MATCH} --method paper --set method.rounds=2.5": "rounds: expected a whole number, got '2.5'",
    f"{MATCH} --method paper --set method.decay=-1": "decay: expected a number of at least 0",
    f"{MATCH} --method paper --set method.factor=2": "for paper",
    f"{MATCH} --set method.laplacian=0.1": "for elastic",
    f"{MATCH} --set method.last=2": "no fewer at last",
    f"{MATCH} --set method.factor=x": "factor: expected a number, got 'x'",
    f"{MATCH} --method hfm --set method.factor=1": "a factor above 1",
    f"{MATCH} --method hfm --set method.normal_weight=-1": "normal_weight: expected a number of at least 0",
    f"{MATCH} --method hfm --set method.signature_weight=-1": "signature_weight: expected a number of at least 0",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """RESULT folders, one of meshes without UVs and symmetry, and values that do not fit."""
    folder = tmp_path_factory.mktemp("refusals")
    write_result(folder / "R", identity_result())
    uneven = replace(cube(), positions=cube().positions * np.linspace(1, 2, 8)[:, None], name="bare.obj")
    write_result(folder / "BARE", identity_result(2, (uneven, uneven)))
    flat = textured_cube("flat.obj").with_uvs(np.array([[0.0, 1.0]]), np.zeros(24, dtype=np.int64))
    write_result(folder / "FLAT", identity_result(2, (flat, textured_cube("small.obj"))))
    colored = replace(uneven, vertex_colors=np.ones((8, 3)))
    write_result(folder / "COLORED", identity_result(2, (colored, colored)))
    write_mesh(folder / "box.obj", cube())
    write_mesh(folder / "box.ply", cube())
    write_mesh(folder / "box.glb", cube())
    write_image(folder / "t.png", np.zeros((8, 8, 3), np.uint8))
    for name, joints in (
        ("one", [JOINT]),
        ("twice", [JOINT, JOINT]),
        ("nowhere", [JOINT | {"head": [0, float("nan"), 0]}]),
        ("number", 7),
        ("orphan", [JOINT | {"parent": "root"}]),
        ("pairs", {"source": "box.obj", "target": "box.obj", "pairs": [{"name": "a", "source": 0, "target": 0}]}),
        ("far", {"groups": [{"name": "a", "vertices": [99]}]}),
        ("again", {"groups": [{"name": "a", "vertices": [0, 0]}]}),
        ("weighed", {"groups": [{"name": "a", "vertices": [0], "weights": [1.0, 2.0]}]}),
        ("parts", {"parts": []}),
        ("ear", {"mesh": "box.glb", "points": [{"name": "ear", "vertex": 0}]}),
    ):
        (folder / f"{name}.json").write_text(json.dumps(joints))
    write_mesh(folder / "other.obj", torus(6, 5))
    write_image(folder / "h.exr", np.zeros((4, 4, 1), np.float32))
    for name, joints, rows in (
        ("legs", "hip,knee", ["0.5,0.5"] * 8),
        ("short", "hip", ["1.0"] * 7),
        ("foot", "foot", ["1"] * 8),
    ):
        (folder / f"{name}.csv").write_text("\n".join([joints, *rows]))
    np.save(folder / "five.npy", np.arange(5))
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
    scene = write_textured_scene(folder)
    texture = scene["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    for name, materials in (
        ("plain", [{"name": "red"}]),
        ("other", [{"name": "red", "pbrMetallicRoughness": {"baseColorTexture": texture | {"texCoord": 1}}}]),
    ):
        (folder / f"{name}.gltf").write_text(json.dumps(scene | {"materials": materials}))
    for foreign in ("RESULT/precious.blend", "painted/pony.png"):
        (folder / foreign).parent.mkdir()
        (folder / foreign).write_bytes(b"of somebody")
    (folder / "empty").mkdir()
    return folder


@pytest.mark.parametrize("words", REFUSED, ids=str)
def test_what_cannot_be_done_is_refused(run, place, words, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.setattr("cagemap.tasks.demo.TEXTURE_SIZE", 8)
    before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
    run.refused(*([words] if isinstance(words, str) else words), says=REFUSED[words])
    assert {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} == before
