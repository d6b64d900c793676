"""What `cagemap transfer` says beside what it writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cagemap.errors import FormatError, ParameterError
from cagemap.files import inner_texture
from cagemap.files.gltf.document import read_document
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import MANIFEST
from cagemap.files.usd.write import UsdResults, write_usd
from cagemap.maps.masks import Masks
from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Plain
from cagemap.spectral import BasisConfig, Surface
from cagemap.subdivision import refine
from cagemap.tasks import bake_tiles
from cagemap.tasks.carry_arrays import carry_values
from cagemap.tasks.match_summary import next_commands
from cagemap.tasks.progress import Stages
from cagemap.tasks.report import run_report
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.transfer.overlapping_uvs import overlapping_materials

from example_result import identity_result, textured_cube
from ply_text import write_text_ply


@pytest.mark.parametrize("shared", [0.6, 1.0])
def test_area_without_a_counterpart_is_said(tmp_path: Path, shared: float) -> None:
    result = identity_result()
    surfaces = result.target.finest_triangles, result.source.finest_triangles
    own = np.where(np.arange(surfaces[0].n) < shared * surfaces[0].n, 1.0, 0.0)
    area = Masks(own, np.ones(surfaces[1].n))
    write_result(tmp_path / "RESULT", replace(result, shared=area))
    values = tmp_path / "values.csv"
    np.savetxt(values, np.arange(8.0))
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.csv", attribute=values)
    _, warnings = run_transfer(request, Stages())
    said = [text for text in warnings if "has no counterpart on the source" in text]
    assert bool(said) == (shared < 1.0)
    masked = replace(request, output=tmp_path / "masked.csv", target_mask="red")
    assert not any("no counterpart" in text for text in run_transfer(masked, Stages())[1])


def write_textured_scene(folder: Path) -> dict[str, Any]:
    """Write box.gltf with a material of one colour image, without meshes; returns its document."""
    write_image(folder / "skin.png", np.full((8, 8, 3), [200, 30, 10], dtype=np.uint8))
    scene: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "materials": [{"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "skin.png"}],
    }
    (folder / "box.gltf").write_text(json.dumps(scene))
    return scene


def test_the_image_inside_a_gltf_file_is_baked(tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    scene = write_textured_scene(tmp_path)
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=tmp_path / "box.gltf")
    run_transfer(request, Stages())
    np.testing.assert_array_equal(read_image(tmp_path / "out.png").pixels[4, 4], [200, 30, 10])
    assert (tmp_path / "RESULT/box_texture.png").is_file()

    scene["materials"] = [{"name": "red"}]
    (tmp_path / "plain.gltf").write_text(json.dumps(scene))
    with pytest.raises(ParameterError, match=r"plain.gltf: expected a colour image .* --material-colors"):
        run_transfer(replace(request, texture=tmp_path / "plain.gltf"), Stages())


def test_each_material_of_a_gltf_file_is_baked_with_its_own_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two materials whose images lie over each other in the layout, and one with a colour alone."""
    scene = write_textured_scene(tmp_path)
    write_image(tmp_path / "head.png", np.full((4, 4, 4), [10, 200, 30, 255], dtype=np.uint8))
    scene["materials"].append({"name": "green", "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}})
    scene["materials"].append({"name": "blue", "pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 1.0, 1.0]}})
    scene["textures"], scene["images"] = [{"source": 0}, {"source": 1}], [{"uri": "skin.png"}, {"uri": "head.png"}]
    (tmp_path / "box.gltf").write_text(json.dumps(scene))
    result = identity_result()
    target = result.target.control
    assert target.uvs is not None
    assert target.uv_indices is not None
    middles = target.uvs[target.uv_indices.reshape(target.n_faces, -1)].mean(axis=1)
    materials = np.arange(target.n_faces) % 3
    source = replace(
        target,
        uvs=0.5 + 1.4 * (target.uvs - 0.5),  # repeated
        face_materials=materials,
        material_names=("red", "green", "blue"),
        material_colors=np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
    )
    write_result(tmp_path / "RESULT", replace(result, source=result.source.with_control(source)))
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=tmp_path / "box.gltf", size=64)
    _, warnings = run_transfer(request, Stages())
    assert not any("lie over each other" in text or "multiply" in text for text in warnings)
    pixels = read_image(tmp_path / "out.png").pixels
    rows, columns = (64 * (1.0 - middles[:, 1])).astype(int), (64 * middles[:, 0]).astype(int)
    meant = np.array([[200, 30, 10, 255], [10, 200, 30, 255], [0, 0, 255, 255]])[materials]
    np.testing.assert_array_equal(pixels[rows, columns], meant)

    shown: dict[str, Any] = {}
    monkeypatch.setattr("cagemap.tasks.report.write_report", lambda _, result, **given: shown.update(given, of=result))
    run_report(ReportRequest(tmp_path / "RESULT", tmp_path / "report.html"), Stages())
    np.testing.assert_array_equal(shown["baked"], pixels)
    assert set(map(tuple, meant)) <= set(map(tuple, shown["texture"].reshape(-1, 4)))
    assert not overlapping_materials(shown["of"].source.control, 0.0)
    for entry in scene["materials"]:
        entry["pbrMetallicRoughness"]["baseColorFactor"] = [1.0, 0.5 if entry["name"] == "green" else 1.0, 1.0, 1.0]
    (tmp_path / "box.gltf").write_text(json.dumps(scene))
    _, warnings = run_transfer(replace(request, output=tmp_path / "tinted.png"), Stages())
    assert any("that multiply the images of green (1, 0.5, 1) are not baked" in text for text in warnings)


def test_a_source_without_uvs_is_named_where_a_file_with_an_image_is_given(tmp_path: Path) -> None:
    result = identity_result()
    bare = replace(result.source.control, uvs=None, uv_indices=None)
    write_result(tmp_path / "RESULT", replace(result, source=result.source.with_control(bare)))
    write_textured_scene(tmp_path)
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=tmp_path / "box.gltf")
    with pytest.raises(ParameterError, match="expected texture coordinates of the source"):
        run_transfer(request, Stages())


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_the_image_inside_a_usd_file_is_baked(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import UsdUtils

    write_image(tmp_path / "skin.png", np.full((8, 8, 3), [200, 30, 10], dtype=np.uint8))
    control = identity_result().source.control
    write_usd(tmp_path / "box.usda", control, UsdResults(textures={"albedo": "./skin.png"}))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "box.usda"), str(tmp_path / "box.usdz"))
    file = tmp_path / f"box{suffix}"
    control = read_mesh(file)
    write_result(tmp_path / "RESULT", identity_result(controls=(control, control)))
    run_transfer(TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=file), Stages())
    np.testing.assert_array_equal(read_image(tmp_path / "out.png").pixels[4, 4], [200, 30, 10])


def test_an_image_inside_a_gltf_file_for_another_uv_set_is_refused(tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    scene = write_textured_scene(tmp_path)
    scene["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 1
    (tmp_path / "other.gltf").write_text(json.dumps(scene))
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=tmp_path / "other.gltf")
    with pytest.raises(ParameterError, match=r"other.gltf: expected a colour image .* UV set in use, found none"):
        run_transfer(request, Stages())


def baked_squares(folder: Path, control: ControlMesh, texture: Path, size: int = 64) -> NDArray[Any]:
    """An image baked for a box whose target layout is that of `identity_result`."""
    result = identity_result()
    write_result(folder / "RESULT", replace(result, source=result.source.with_control(control)))
    run_transfer(TransferRequest(folder / "RESULT", folder / "out.png", texture=texture, size=size), Stages())
    pixels = read_image(folder / "out.png").pixels.astype(int)
    (folder / "out.png").unlink()
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
def test_a_texture_transform_and_mirrored_repetition_of_a_gltf_file_are_baked(
    tmp_path: Path, changed: dict[str, Any], mirrored: bool, uvs: Callable[..., tuple[NDArray[Any], NDArray[Any]]]
) -> None:
    scene = write_textured_scene(tmp_path)
    y, x = np.mgrid[:64, :64]
    pixels = np.stack([4 * x, 4 * y, 2 * (x + y)], axis=2).astype(np.uint8)
    write_image(tmp_path / "skin.png", pixels, force=True)
    scene["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {"KHR_texture_transform": changed}
    if mirrored:
        pixels = np.concatenate([pixels, pixels[:, ::-1]], axis=1)
        scene |= {"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 33648, "wrapT": 33648}]}
    (tmp_path / "box.gltf").write_text(json.dumps(scene | {"extensionsUsed": ["KHR_texture_transform"]}))
    control = identity_result().source.control
    assert control.uvs is not None
    given = baked_squares(tmp_path, control, tmp_path / "box.gltf")
    write_image(tmp_path / "meant.png", pixels)
    moved = replace(control, uvs=np.column_stack(uvs(*control.uvs.T)))
    meant = baked_squares(tmp_path, moved, tmp_path / "meant.png")
    assert np.ptp(meant[..., :2], axis=(0, 1)).min() > 60
    assert np.abs(given - meant).max() <= 1  # rounding of texture coordinates


def test_every_file_of_several_maps_is_named_on_a_line_of_its_own(tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    write_image(tmp_path / "skin.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    maps = tuple((name, tmp_path / "skin.png") for name in ("albedo", "roughness"))
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "o.png", maps=maps, unwrap=True, target_mask="red")
    lines = run_transfer(request, Stages())[0].splitlines()
    files = ", ".join(str(tmp_path / name) for name in ("o_albedo.png", "o_roughness.png", "o_unwrapped.obj"))
    assert lines == [f"wrote 2 maps: {files}", "  alpha holds the weights of the masks"]


def test_booleans_are_labels_in_files_as_in_arrays(tmp_path: Path) -> None:
    """A mean of true and false is neither."""
    result = identity_result(2)
    write_result(tmp_path / "R", result)
    marked = np.arange(8) % 2 == 0
    np.savez(tmp_path / "v.npz", marked=marked)
    run_transfer(TransferRequest(tmp_path / "R", tmp_path / "o.npz", attribute=tmp_path / "v.npz"), Stages())
    carried = np.load(tmp_path / "o.npz")["marked"]
    assert carried.dtype.kind == "i"
    np.testing.assert_array_equal(carried, carry_values(result, marked))


def test_a_target_whose_texture_coordinates_are_one_point_is_refused_with_what_to_type(tmp_path: Path) -> None:
    result = identity_result()
    target = result.target.control
    flat = target.with_uvs(np.array([[0.0, 1.0]]), np.zeros(len(target.face_indices), dtype=np.int64))
    write_result(tmp_path / "RESULT", replace(result, target=result.target.with_control(flat)))
    write_image(tmp_path / "skin.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=tmp_path / "skin.png")
    with pytest.raises(ParameterError, match=r"all of them are in one point or on a line. Add --unwrap"):
        run_transfer(request, Stages())


def test_match_says_the_next_command_with_the_file_that_has_the_texture(tmp_path: Path) -> None:
    write_textured_scene(tmp_path)
    result = identity_result()
    request = MatchRequest(tmp_path / "a.obj", tmp_path / "my.obj", output=tmp_path / "RESULT")
    assert f"transfer {tmp_path}/RESULT --texture IMG -o OUT.png, or" in next_commands(result, request)
    bare = replace(result, target=result.target.with_control(result.target.control.with_uvs(None, None)))
    scene = (tmp_path / "box.gltf").rename(tmp_path / "{box}.gltf")
    text = next_commands(bare, replace(request, source=scene))
    assert f"--texture '{scene}' -o OUT.png --unwrap, or" in text


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


def test_the_image_that_a_ply_file_names_is_baked(tmp_path: Path) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    write_mesh(tmp_path / "scan.ply", textured_cube("scan.ply"))
    header, end, body = (tmp_path / "scan.ply").read_bytes().partition(b"element vertex")
    (tmp_path / "scan.ply").write_bytes(header + b"comment TextureFile my skin.png\n" + end + body)
    write_image(tmp_path / "my skin.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    run_transfer(TransferRequest(tmp_path / "RESULT", tmp_path / "o.png", texture=tmp_path / "scan.ply"), Stages())
    assert read_image(tmp_path / "o.png").pixels.max() == 90
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "my skin.png", texture=tmp_path / "scan.ply", force=True)
    with pytest.raises(FormatError, match="is an input too"):
        run_transfer(request, Stages())


@pytest.mark.parametrize(("second", "shades"), [(1, [40, 200]), (5, [40, 231]), (-1, [40, 231]), (None, [40])], ids=str)
def test_each_face_of_a_ply_file_of_several_images_has_its_own(
    second: int | None, shades: list[int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
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
        write_image(tmp_path / f"{name}.png", np.full((8, 8, 3), shade, dtype=np.uint8))
    source = read_mesh(tmp_path / "scan.ply")
    write_result(tmp_path / "RESULT", identity_result(2, (textured_cube("box.obj"), source)))
    run_transfer(TransferRequest(tmp_path / "RESULT", tmp_path / "o.png", texture=tmp_path / "scan.ply"), Stages())
    baked, counts = np.unique(read_image(tmp_path / "o.png").pixels, return_counts=True)
    assert baked[counts > 0.2 * counts.sum()].tolist() == shades
    assert ("names 2 images and no texnumber of its faces: all have dark.png" in caplog.text) is (second is None)
    assert (f"texture {second}: the file names 2 image(s): its faces have no image" in caplog.text) is (231 in shades)


def test_a_model_file_is_read_once_for_its_texture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    write_textured_scene(tmp_path)
    read = list[Path]()
    monkeypatch.setattr(inner_texture, "read_document", lambda path: (read.append(path), read_document(path))[1])
    run_transfer(TransferRequest(tmp_path / "RESULT", tmp_path / "o.png", texture=tmp_path / "box.gltf"), Stages())
    assert read == [tmp_path / "box.gltf"]


def test_a_report_shows_the_only_image_of_a_model_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_result(tmp_path / "RESULT", identity_result())
    write_textured_scene(tmp_path)
    run_transfer(
        TransferRequest(tmp_path / "RESULT", tmp_path / "out.png", texture=tmp_path / "box.gltf", size=8), Stages()
    )
    shown: dict[str, Any] = {}
    monkeypatch.setattr("cagemap.tasks.report.write_report", lambda *_, **given: shown.update(given))
    run_report(ReportRequest(tmp_path / "RESULT", tmp_path / "r.html", texture=tmp_path / "box.gltf"), Stages())
    np.testing.assert_array_equal(shown["texture"], read_image(tmp_path / "skin.png").pixels)
    np.testing.assert_array_equal(shown["baked"], read_image(tmp_path / "out.png").pixels)
    (tmp_path / "box.gltf").write_text('{"asset": {"version": "2.0"}, "materials": [{"name": "red"}]}')
    with pytest.raises(ParameterError, match=r"^--texture .*box\.gltf: expected a colour image on most of small\.obj"):
        run_report(ReportRequest(tmp_path / "RESULT", tmp_path / "r.html", texture=tmp_path / "box.gltf"), Stages())
    manifest = tmp_path / "RESULT" / MANIFEST
    manifest.write_text(manifest.read_text().replace("box_texture.png", "../box.gltf"))
    with pytest.raises(ParameterError, match=r"^(?!--texture).*box\.gltf: expected a colour image"):
        run_report(ReportRequest(tmp_path / "RESULT", tmp_path / "r.html"), Stages())


def test_a_report_writes_no_image_of_a_model_file(tmp_path: Path) -> None:
    result = tmp_path / "RESULT"
    write_result(result, identity_result())
    write_textured_scene(tmp_path)
    before = {file.name for file in result.iterdir()}
    run_report(ReportRequest(result, tmp_path / "r.html", texture=tmp_path / "box.gltf"), Stages())
    assert {file.name for file in result.iterdir()} - before <= {"job.toml"}


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ({"texture": Path("skin.png")}, 1),
        ({"material_colors": True}, 1),
        ({"maps": (("a", Path("skin.png")), ("b", Path("skin.png")))}, 2),
        ({"bake": ("normal", "ao"), "detail": Path("fine.obj")}, 2),
    ],
)
def test_a_bake_that_fails_leaves_the_unwrapped_mesh_and_all_images(
    options: dict[str, Any], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_image("skin.png", np.random.default_rng(1).integers(0, 255, (16, 16, 3)).astype(np.uint8))
    write_mesh("fine.obj", textured_cube("fine.obj"))
    write_result("RESULT", identity_result())
    request = TransferRequest(Path("RESULT"), Path("out.png"), unwrap=True, size=16, **options)
    run_transfer(request, Stages())
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
    write_result("RESULT", identity_result(controls=(larger, textured_cube("small.obj"))))
    with pytest.raises(FormatError, match="cannot write there"):
        run_transfer(replace(request, size=32), Stages())
    assert {path: path.read_bytes() for path in Path().glob("out*")} == before
