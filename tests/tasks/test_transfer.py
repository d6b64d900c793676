"""What `cagemap transfer` says beside what it writes, values that stay at faces, and pieces that are not matched."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import torus
from numpy.typing import NDArray

from cagemap.character.values import Part
from cagemap.deform.placement import Placement
from cagemap.errors import FormatError, ParameterError
from cagemap.files import inner_texture
from cagemap.files.gltf.document import read_document
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import MANIFEST, stated_inputs
from cagemap.maps.hypotheses.confidence import LOOK, SURE, Confidence
from cagemap.maps.masks import Masks
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.control_mesh import NO_UV
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.spectral import BasisConfig, Surface
from cagemap.subdivision import refine
from cagemap.tasks import bake_tiles
from cagemap.tasks.bodies import Bodies, match_bodies
from cagemap.tasks.carry_arrays import carry_values
from cagemap.tasks.match_summary import next_commands
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.report import run_report
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.mesh_commands import RefineRequest
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.set_aside import lay_set_aside
from cagemap.transfer.overlapping_uvs import overlapping_materials

from example_once import example_pair
from example_result import identity_result, textured_cube
from ply_text import write_text_ply
from refusals import refuses
from textured_files import SKIN, write_skin, write_textured_scene, write_textured_usd
from transfer_command import transfer


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a result of two cubes in R."""
    monkeypatch.chdir(tmp_path)
    write_result("R", identity_result())
    return tmp_path


def write_source(mesh: ControlMesh) -> None:
    """Write R of a cube and a source with its vertices."""
    result = identity_result()
    write_result("R", replace(result, source=result.source.with_control(mesh)))


@pytest.mark.parametrize("shared", [0.6, 1.0])
def test_area_without_a_counterpart_is_said(place: Path, shared: float) -> None:
    result = identity_result()
    surfaces = result.target.finest_triangles, result.source.finest_triangles
    own = np.where(np.arange(surfaces[0].n) < shared * surfaces[0].n, 1.0, 0.0)
    area = Masks(own, np.ones(surfaces[1].n))
    write_result("R", replace(result, shared=area))
    np.savetxt("values.csv", np.arange(8.0))
    given = {"attribute": Path("values.csv")}
    said = [text for text in transfer("out.csv", **given)[1] if "has no counterpart on the source" in text]
    assert bool(said) == (shared < 1.0)
    assert not any("no counterpart" in text for text in transfer("masked.csv", **given, target_mask="red")[1])


def write_textured_ply(folder: Path) -> Path:
    """Write box.ply, which names one image."""
    file = folder / "box.ply"
    write_mesh(file, textured_cube("box.ply"))
    header, end, body = file.read_bytes().partition(b"element vertex")
    file.write_bytes(header + b"comment TextureFile my skin.png\n" + end + body)
    write_skin(folder, name="my skin.png")
    return file


def test_the_image_that_a_refined_ply_loses_is_said(tmp_path: Path) -> None:
    file = write_textured_ply(tmp_path)
    for name in ("out.ply", "out.glb"):
        said = run_refine(RefineRequest(file, 1, tmp_path / name), Stages())[1]
        assert said == [f"{name}: left out of box.ply: my skin.png"]


@pytest.mark.parametrize("name", ["box.gltf", "box.ply", "box.usda", "box.usdz"])
def test_the_image_that_a_model_file_names_is_baked(place: Path, name: str) -> None:
    if name == "box.gltf":
        write_textured_scene(place)
    elif name == "box.ply":
        write_textured_ply(place)
    else:
        usd_utils = pytest.importorskip("pxr.UsdUtils", reason="usd-core is not installed")
        layer = write_textured_usd(place, identity_result().source.control)
        assert usd_utils.CreateNewUsdzPackage(str(layer), "box.usdz")
        write_result("R", identity_result(controls=(read_mesh(name), read_mesh(name))))
    transfer("out.png", texture=Path(name))
    np.testing.assert_array_equal(read_image("out.png").pixels[4, 4], SKIN)
    assert Path("R/box_texture.png").is_file() == (name != "box.ply")
    if name == "box.ply":
        refuses(FormatError, "is an input too", transfer, "my skin.png", texture=Path(name), force=True)


def test_each_material_of_a_gltf_file_is_baked_with_its_own_image(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two materials whose images lie over each other in the layout, and one with a colour alone."""
    scene = write_textured_scene(place)
    write_skin(place, (10, 200, 30, 255), "head.png")
    scene["materials"].append({"name": "green", "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}})
    scene["materials"].append({"name": "blue", "pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 1.0, 1.0]}})
    scene["textures"], scene["images"] = [{"source": 0}, {"source": 1}], [{"uri": "skin.png"}, {"uri": "head.png"}]
    Path("box.gltf").write_text(json.dumps(scene))
    target = textured_cube("large.obj", 2.0)
    middles = target.uvs[target.uv_indices.reshape(target.n_faces, -1)].mean(axis=1)
    materials = np.arange(target.n_faces) % 3
    source = replace(
        target,
        uvs=0.5 + 1.4 * (target.uvs - 0.5),  # repeated
        face_materials=materials,
        material_names=("red", "green", "blue"),
        material_colors=np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
    )
    write_source(source)
    _, warnings = transfer("out.png", texture=Path("box.gltf"), size=64)
    assert not any("lie over each other" in text or "multiply" in text for text in warnings)
    pixels = read_image("out.png").pixels
    rows, columns = (64 * (1.0 - middles[:, 1])).astype(int), (64 * middles[:, 0]).astype(int)
    meant = np.array([[200, 30, 10, 255], [10, 200, 30, 255], [0, 0, 255, 255]])[materials]
    np.testing.assert_array_equal(pixels[rows, columns], meant)

    shown: dict[str, Any] = {}
    monkeypatch.setattr("cagemap.tasks.report.write_report", lambda _, result, **given: shown.update(given, of=result))
    run_report(ReportRequest(Path("R"), Path("report.html")), Stages())
    np.testing.assert_array_equal(shown["baked"], pixels)
    assert set(map(tuple, meant)) <= set(map(tuple, shown["texture"].reshape(-1, 4)))
    assert not overlapping_materials(shown["of"].source.control, 0.0)
    for entry in scene["materials"]:
        entry["pbrMetallicRoughness"]["baseColorFactor"] = [1.0, 0.5 if entry["name"] == "green" else 1.0, 1.0, 1.0]
    Path("box.gltf").write_text(json.dumps(scene))
    _, warnings = transfer("tinted.png", texture=Path("box.gltf"), size=64)
    assert any("that multiply the images of green (1, 0.5, 1) are not baked" in text for text in warnings)


def baked_squares(control: ControlMesh, texture: str) -> NDArray[Any]:
    """An image baked for a box whose target layout is that of `identity_result`."""
    write_source(control)
    transfer("out.png", texture=Path(texture), size=64)
    pixels = read_image("out.png").pixels.astype(int)
    Path("out.png").unlink()
    return pixels


@pytest.mark.parametrize(
    ("changed", "mirrored", "uvs"),
    [
        ({"offset": [0.5, 0.25], "scale": [0.5, 0.75]}, False, lambda u, v: (0.5 + 0.5 * u, 0.75 * v)),
        ({"rotation": np.pi / 2}, False, lambda u, v: (1.0 - v, 1.0 + u)),
        ({"scale": [2, 1]}, True, lambda u, v: (u, v)),
    ],
    ids=["shifted", "turned", "mirrored"],
)
def test_a_texture_transform_and_mirrored_repetition_of_a_gltf_file_are_baked(place, changed, mirrored, uvs):
    scene = write_textured_scene(place)
    y, x = np.mgrid[:64, :64]
    pixels = np.stack([4 * x, 4 * y, 2 * (x + y)], axis=2).astype(np.uint8)
    write_image("skin.png", pixels, force=True)
    scene["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {"KHR_texture_transform": changed}
    if mirrored:
        pixels = np.concatenate([pixels, pixels[:, ::-1]], axis=1)
        scene |= {"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 33648, "wrapT": 33648}]}
    Path("box.gltf").write_text(json.dumps(scene | {"extensionsUsed": ["KHR_texture_transform"]}))
    control = identity_result().source.control
    given = baked_squares(control, "box.gltf")
    write_image("meant.png", pixels)
    meant = baked_squares(replace(control, uvs=np.column_stack(uvs(*control.uvs.T))), "meant.png")
    assert np.ptp(meant[..., :2], axis=(0, 1)).min() > 60
    assert np.abs(given - meant).max() <= 1  # rounding of texture coordinates


def test_every_file_of_several_maps_is_named_on_a_line_of_its_own(place: Path) -> None:
    maps = tuple((name, write_skin(place)) for name in ("albedo", "roughness"))
    lines = transfer("o.png", maps=maps, unwrap=True, target_mask="red")[0].splitlines()
    files = "o_albedo.png, o_roughness.png, o_unwrapped.obj"
    assert lines == [f"wrote 2 maps: {files}", "  alpha holds the weights of the masks"]


def test_booleans_are_labels_in_files_as_in_arrays(place: Path) -> None:
    """A mean of true and false is neither."""
    marked = np.arange(8) % 2 == 0
    np.savez("v.npz", marked=marked)
    transfer("o.npz", attribute=Path("v.npz"))
    carried = np.load("o.npz")["marked"]
    assert carried.dtype.kind == "i"
    np.testing.assert_array_equal(carried, carry_values(identity_result(), marked))


def test_match_says_the_next_command_with_the_file_that_has_the_texture(tmp_path: Path) -> None:
    write_textured_scene(tmp_path)
    result = identity_result()
    request = MatchRequest(tmp_path / "a.obj", tmp_path / "my.obj", output=tmp_path / "RESULT")
    assert f"transfer {tmp_path}/RESULT --texture IMG -o OUT.png, or" in next_commands(result, request)
    bare = replace(result, target=result.target.with_control(result.target.control.with_uvs(None, None)))
    scene = (tmp_path / "box.gltf").rename(tmp_path / "{box}.gltf")
    text = next_commands(bare, replace(request, source=scene))
    assert f"--texture '{scene}' -o OUT.png --unwrap, or" in text


def test_match_says_how_to_mend_a_doubtful_or_poor_map(tmp_path: Path) -> None:
    result, request = identity_result(), MatchRequest(tmp_path / "a.obj", tmp_path / "b.obj", tmp_path / "RESULT")
    answers = (Placement(result.point_map.images.positions, 1e-4, name="as the files stand"),)
    doubtful = replace(result, confidence=Confidence(LOOK, answers, {"jumps": 0.1}))
    poor = replace(result, quality=replace(result.quality, flipped_area=0.2))
    folder = request.output
    for one in (doubtful, poor):
        said = f"next: cagemap report {folder}, or cagemap suggest {folder} -o landmarks.json to add landmarks"
        assert next_commands(one, request) == said
    sure = replace(doubtful, confidence=Confidence(SURE, answers))
    assert "cagemap transfer" in next_commands(sure, request)


def test_match_says_what_a_source_without_uvs_can_give(tmp_path: Path) -> None:
    result, request = identity_result(), MatchRequest(tmp_path / "a.obj", tmp_path / "b.stl", tmp_path / "RESULT")
    bare = result.source.control.with_uvs(None, None)
    for colors, said in (
        ({"vertex_colors": np.ones((8, 3))}, "transfer {} --bake colors -o OUT.png, or"),
        ({}, "transfer {} --material-colors -o OUT.png, or"),
        ({"face_materials": None, "material_names": (), "material_colors": None}, "wrap {} -o OUT.obj, or"),
    ):
        source = result.source.with_control(replace(bare, **colors))
        assert said.format(request.output) in next_commands(replace(result, source=source), request)
    plain = Surface(
        refine(replace(result.target.control, scheme=Plain()), 0), BasisConfig(count=5)
    )  # which `wrap` refuses
    text = next_commands(replace(result, target=plain, source=source), request)
    assert text == f"next: cagemap report {request.output}"


@pytest.mark.parametrize(("second", "shades"), [(1, [40, 200]), (5, [40, 231]), (-1, [40, 231]), (None, [40])], ids=str)
def test_each_face_of_a_ply_file_of_several_images_has_its_own(second, shades, tmp_path, caplog):
    """``texnumber`` counts the images in the order of the header, others are grey; without it all have the first."""
    write_text_ply(tmp_path / "scan.ply", textured_cube("scan.ply"))
    head, end, body = (tmp_path / "scan.ply").read_text().partition("end_header\n")
    images = "".join(f"comment TextureFile {name}.png\n" for name in ("dark", "light"))
    lines = body.splitlines()
    if second is not None:
        head += "property int texnumber\n"
        lines[-6:] = [f"{line} {0 if face < 3 else second}" for face, line in enumerate(lines[-6:])]
    (tmp_path / "scan.ply").write_text(
        head.replace("element vertex", f"{images}element vertex") + end + "\n".join(lines)
    )
    for name, shade in (("dark", 40), ("light", 200)):
        write_skin(tmp_path, (shade,) * 3, f"{name}.png")
    source = read_mesh(tmp_path / "scan.ply")
    write_result(tmp_path / "R", identity_result(2, (textured_cube("box.obj"), source)))
    transfer(tmp_path / "o.png", texture=tmp_path / "scan.ply")
    baked, counts = np.unique(read_image(tmp_path / "o.png").pixels, return_counts=True)
    assert baked[counts > 0.2 * counts.sum()].tolist() == shades
    assert ("names 2 images and no texnumber of its faces: all have dark.png" in caplog.text) is (second is None)
    assert (f"texture {second}: the file names 2 image(s): its faces have no image" in caplog.text) is (231 in shades)


def test_a_model_file_is_read_once_for_its_texture(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_textured_scene(place)
    read = list[Path]()
    monkeypatch.setattr(inner_texture, "read_document", lambda path: (read.append(path), read_document(path))[1])
    transfer("o.png", texture=Path("box.gltf"))
    assert read == [Path("box.gltf")]


def report(texture: Path | None = Path("box.gltf")) -> None:
    run_report(ReportRequest(Path("R"), Path("r.html"), texture=texture), Stages())


def test_a_report_shows_the_only_image_of_a_model_file(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_textured_scene(place)
    transfer("out.png", texture=Path("box.gltf"), size=8)
    shown: dict[str, Any] = {}
    monkeypatch.setattr("cagemap.tasks.report.write_report", lambda *_, **given: shown.update(given))
    report()
    np.testing.assert_array_equal(shown["texture"], read_image("skin.png").pixels)
    np.testing.assert_array_equal(shown["baked"], read_image("out.png").pixels)
    Path("box.gltf").write_text('{"asset": {"version": "2.0"}, "materials": [{"name": "red"}]}')
    refuses(ParameterError, r"^--texture .*box\.gltf: expected a colour image on most of small\.obj", report)
    manifest = Path("R") / MANIFEST
    manifest.write_text(manifest.read_text().replace("box_texture.png", "../box.gltf"))
    refuses(ParameterError, r"^(?!--texture).*box\.gltf: expected a colour image", report, None)


def test_a_report_writes_no_image_of_a_model_file(place: Path) -> None:
    write_textured_scene(place)
    before = {file.name for file in Path("R").iterdir()}
    report()
    assert {file.name for file in Path("R").iterdir()} - before <= {"job.toml"}


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ({"texture": Path("skin.png")}, 1),
        ({"material_colors": True}, 1),
        ({"maps": (("a", Path("skin.png")), ("b", Path("skin.png")))}, 2),
        ({"bake": ("normal", "ao"), "detail": Path("fine.obj")}, 2),
    ],
)
def test_a_bake_that_fails_leaves_the_unwrapped_mesh_and_all_images(options, count, place, monkeypatch):
    write_image("skin.png", np.random.default_rng(1).integers(0, 255, (16, 16, 3)).astype(np.uint8))
    write_mesh("fine.obj", textured_cube("fine.obj"))
    transfer("out.png", unwrap=True, size=16, **options)
    before = {path: path.read_bytes() for path in Path().glob("out*")}
    assert len(before) == count + 2

    def fail(path: Path, *given: Any, **named: Any) -> None:
        if len(written) == count - 1:
            raise FormatError(f"{path}: cannot write there")
        written.append(path)
        write_image(path, *given, **named)

    written: list[Path] = []
    monkeypatch.setattr(bake_tiles, "write_image", fail)
    larger = replace(textured_cube("large.obj", 2.0), positions=textured_cube("").positions * [2.0, 3.0, 4.0])
    write_result("R", identity_result(controls=(larger, textured_cube("small.obj"))))
    refuses(FormatError, "cannot write there", transfer, "out.png", unwrap=True, size=32, **options)
    assert {path: path.read_bytes() for path in Path().glob("out*")} == before


@pytest.mark.parametrize("name", ["", "st"])
@pytest.mark.parametrize("material", [0, 1])
def test_faces_in_the_middle_of_an_image_have_uvs_unless_they_are_all_of_a_material(name: str, material: int) -> None:
    """A palette has colours there. Readers report faces without UVs of files whose UV set has no name."""
    mesh = textured_cube("mesh")
    rows = np.where(mesh.corner_faces < 3, mesh.uv_indices, len(mesh.uvs))
    materials = np.where(np.arange(6) < 3, 0, material)
    mesh = replace(mesh.with_uvs(np.vstack([mesh.uvs, [NO_UV]]), rows), uv_name=name, face_materials=materials)
    warnings = bake_tiles.missing_uv_warnings(mesh, "all of them get one texel of the image")
    assert len(warnings) == (name == "st" and material == 1)
    assert all("3 faces of mesh have" in text and "so that all of them get one texel" in text for text in warnings)


RING = replace(torus(6, 5), name="ring.obj")
COUNT = RING.n_faces


def split_ring() -> ControlMesh:
    """The ring of quads as triangles, with more faces than vertices."""
    triangles = cage_triangles(RING)[0]
    return ControlMesh(RING.positions, np.arange(0, triangles.size + 1, 3), triangles.ravel(), name="split.obj")


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    """Labels of the source's faces, which are those of the target's quads; the result is in R."""
    assert RING.n_vertices == COUNT
    write_result(tmp_path / "R", identity_result(0, (RING, split_ring())))
    np.savez(tmp_path / "labels.npz", label=np.arange(2 * COUNT) // 2)
    return tmp_path / "labels.npz"


def test_usd_gets_them_for_faces(labels: Path, tmp_path: Path) -> None:
    transfer(tmp_path / "out.npz", attribute=labels, usd=tmp_path / "out.usda", force=True)
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["label"], np.arange(COUNT))
    text = (tmp_path / "out.usda").read_text()
    assert 'interpolation = "uniform"' in text.partition("primvars:label")[2].partition(")")[0]


def test_the_base_is_mixed_by_the_weights_of_faces(labels: Path, tmp_path: Path) -> None:
    mask = np.zeros(COUNT)
    mask[RING.face_indices[:4]] = 1.0  # the vertices of the first face
    np.savetxt(tmp_path / "mask.csv", mask)
    np.savez(tmp_path / "base.npz", label=np.full(COUNT, 99))
    bases = (("", tmp_path / "base.npz"),)
    transfer(tmp_path / "out.npz", attribute=labels, target_mask=str(tmp_path / "mask.csv"), bases=bases)
    shares = mask[RING.face_indices].reshape(COUNT, 4).mean(axis=1)
    expected = np.where(shares >= 0.5, np.arange(COUNT), 99)
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["label"], expected)


def test_a_file_gets_those_of_a_part_at_its_faces(tmp_path: Path) -> None:
    scene = replace(join_meshes([replace(RING, name="a"), split_ring()]), name="scene.obj")
    scene = replace(scene, face_materials=None, material_names=())
    write_mesh(tmp_path / "scene.obj", scene)
    part = extract_faces(scene, np.arange(COUNT))
    assert part.n_vertices == part.n_faces
    result = identity_result(0, (part, split_ring()))
    inputs = stated_inputs({"target": tmp_path / "scene.obj"}, tmp_path / "R")
    write_result(tmp_path / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    np.savez(tmp_path / "labels.npz", label=1 + np.arange(2 * COUNT) // 2)
    transfer(tmp_path / "o.npz", attribute=tmp_path / "labels.npz")
    found = np.load(tmp_path / "o.npz")["label"]
    np.testing.assert_array_equal(found, np.append(1 + np.arange(COUNT), np.zeros(2 * COUNT)))


def test_a_file_that_does_not_say_the_place_of_its_values_is_warned_of_once(tmp_path: Path) -> None:
    write_result(tmp_path / "R", identity_result(0, (RING, RING)))
    np.savez(tmp_path / "v.npz", one=np.arange(COUNT), two=np.arange(COUNT))
    (warning,) = transfer(tmp_path / "o.npz", attribute=tmp_path / "v.npz")[1]
    assert warning.startswith("one, two: as many rows as control vertices and as control faces")
    (tmp_path / "g.json").write_text('{"groups": [{"name": "lips", "vertices": [0, 5]}]}')
    assert transfer(tmp_path / "o.json", attribute=tmp_path / "g.json")[1] == []  # groups are of vertices


SCALE, SHIFT = 2.5, np.array([3.0, -1.0, 2.0])


def with_eyes(body: ControlMesh) -> ControlMesh:
    """A mesh with two small copies of itself beside it."""
    eyes = [body.positions] + [0.05 * body.positions + side * body.positions.max(axis=0) for side in (-1.0, 1.0)]
    count, offsets = body.n_vertices, body.face_offsets
    return ControlMesh(
        np.concatenate(eyes),
        np.concatenate([offsets, *(offsets[-1] * piece + offsets[1:] for piece in (1, 2))]),
        np.concatenate([body.face_indices + count * piece for piece in range(3)]),
        scheme=Plain(),
        name="body",
    )


def matched(source: ControlMesh) -> Bodies:
    target = replace(source, positions=SCALE * source.positions + SHIFT)
    return match_bodies(Part("target", target), Part("source", source), Landmarks.none(), Stages())


@pytest.mark.slow
def test_pieces_go_with_the_surface_around_them() -> None:
    source = with_eyes(example_pair(64).target)
    bodies = matched(source)
    found = lay_set_aside(bodies)
    count = source.n_vertices // 3
    np.testing.assert_array_equal(found.vertices, np.arange(count, 3 * count))
    for own, other in (
        (found.vertices, found.source_vertices),
        (found.corners, found.source_corners),
        (found.faces, found.source_faces),
    ):
        np.testing.assert_array_equal(own, other)
    assert len(found.faces) == 2 * source.n_faces // 3
    np.testing.assert_allclose(found.places, source.positions[count:], atol=1e-9)
    offsets = np.random.default_rng(1).random((2 * count, 3))
    np.testing.assert_allclose(np.einsum("nd,nde->ne", offsets, found.turns), SCALE * offsets, atol=1e-9)


@pytest.mark.slow
def test_nothing_is_set_aside_of_one_piece() -> None:
    found = lay_set_aside(matched(replace(example_pair(64).target, scheme=Plain())))
    assert all(len(array) == 0 for array in vars(found).values())
