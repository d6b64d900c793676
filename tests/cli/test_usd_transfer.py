"""`transfer` with several maps, and with a USD layer over the target."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.character.joints import Skeleton
from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import Image, read_image, write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.manifest import stated_inputs
from cagemap.jobs.job import read_job
from cagemap.jobs.plan import plan_job
from cagemap.jobs.run import execute
from cagemap.jobs.tree import spanning_tree
from cagemap.tasks.job_file import JOB, note_match
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.transfer import texture_and_maps
from cagemap.tasks.run_job import run_task

from example_result import identity_result, textured_cube

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Usd, UsdShade

from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.results import MATERIAL
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.write import UsdResults, write_usd, write_usd_over

from refusals import refuses
from transfer_command import transfer
from usd_scenes import complaints


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A result about a USD target, and two source maps."""
    monkeypatch.chdir(tmp_path)
    target = replace(textured_cube("large.usda", 2.0), uv_name="map1")
    write_usd(tmp_path / "large.usda", target)
    result = identity_result()
    inputs = stated_inputs({"target": tmp_path / "large.usda"}, tmp_path / "R")
    provenance = {**result.provenance, "inputs": inputs}
    result = replace(result, target=result.target.with_control(target), provenance=provenance)
    write_result(tmp_path / "R", result)
    rng = np.random.default_rng(1)
    write_image(tmp_path / "skin.png", (rng.random((64, 64, 4)) * 255).astype(np.uint8))
    write_image(tmp_path / "rough.exr", rng.random((32, 32, 1)).astype(np.float32))
    return tmp_path


def bound_shaders(layer: Path) -> dict[str, Any]:
    """Shaders of the material that a layer binds, by name."""
    stage = Usd.Stage.Open(str(layer))
    material = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/Asset/mesh")).ComputeBoundMaterial()[0]
    return {prim.GetName(): UsdShade.Shader(prim) for prim in Usd.PrimRange(material.GetPrim())} | {"stage": stage}


def test_maps_of_a_material_in_one_run_and_bound_in_usd(folder: Path) -> None:
    maps = texture_and_maps(["albedo=skin.png", "roughness=rough.exr"])[1]
    with pytest.raises(Exception, match=r"\.png"):  # floats do not fit, and nothing was written
        transfer(folder / "out.png", maps=maps)
    assert not list(folder.glob("out*"))
    write_image(folder / "rough.png", (read_image(folder / "rough.exr").pixels * 65535).astype(np.uint16))
    maps = texture_and_maps(["albedo=skin.png", "roughness=rough.png"])[1]
    summary, _ = transfer(folder / "out.png", maps=maps, usd=folder / "look.usda")
    assert "2 maps" in summary
    assert "a layer over large.usda" in summary
    albedo, roughness = read_image(folder / "out_albedo.png").pixels, read_image(folder / "out_roughness.png").pixels
    assert (albedo.shape, albedo.dtype) == ((64, 64, 4), np.uint8)
    assert (roughness.shape, roughness.dtype) == ((32, 32, 1), np.uint16)
    assert complaints(folder / "look.usda") == []
    shaders = bound_shaders(folder / "look.usda")
    assert shaders["diffuseColor_texture"].GetInput("file").Get().path == "./out_albedo.png"
    assert shaders["uv_map1"].GetInput("varname").Get() == "map1"


def test_usual_names_of_maps_are_bound_and_what_is_left_out_is_said(folder: Path) -> None:
    gray = np.full((8, 8, 1), 90, dtype=np.uint8)
    expected = {
        "Base_Color": "diffuseColor",
        "metalness": "metallic",
        "AO": "occlusion",
        "emissive": "emissiveColor",
        "alpha": "opacity",
        "height": "displacement",
    }
    for name in [*expected, "gloss", "opacity"]:
        write_image(folder / f"in_{name}.png", gray)
    maps = texture_and_maps([f"{name}=in_{name}.png" for name in [*expected, "gloss", "opacity"]])[1]
    _, warnings = transfer(folder / "out.png", maps=maps, usd=folder / "look.usda")
    left = [line for line in warnings if "not bound" in line]
    assert [line.partition(":")[0] for line in left] == ["gloss", "opacity"]  # alpha has the input already
    shaders = bound_shaders(folder / "look.usda")
    for name, value in expected.items():
        assert shaders[f"{value}_texture"].GetInput("file").Get().path == f"./out_{name}.png"
        assert shaders["surface"].GetInput(value).HasConnectedSource()


def test_the_colour_space_of_an_image_is_noted(folder: Path) -> None:
    words = []
    for name, dtype, space in (("a.png", np.uint8, "sRGB"), ("b.exr", np.float32, "lin_rec709_scene")):
        write_image(folder / name, Image(np.full((8, 8, 3), 90, dtype=dtype), color_space=space))
        transfer(folder / f"out_{name}", texture=folder / name)
        words.append(read_result(folder / "R").manifest["transfers"][-1]["color_space"])
        assert words[-1] == read_image(folder / name).color_space == read_image(folder / f"out_{name}").color_space
    assert "srgb" in words[0].lower()  # spelt as the library does
    assert words[1] != words[0]


def test_the_job_file_repeats_each_transfer_into_one_layer(folder: Path) -> None:
    write_mesh(folder / "small.obj", textured_cube("small.obj"))
    result = Path("R")
    note_match(MatchRequest(folder / "large.usda", folder / "small.obj", result))
    names = ("fur", "dirt")
    for name in names:
        np.savez(folder / f"{name}.npz", **{name: np.linspace(0, 1, 8)})
        transfer(folder / f"{name}_out.npz", attribute=folder / f"{name}.npz", usd=folder / "rig.usda")
    job = read_job(result / JOB, COMMANDS, WRITTEN)
    tasks = [task for task in plan_job(job, "1", spanning_tree).tasks if task.kind == "transfer"]
    place = Path(tasks[0].request["result"])
    place.parent.mkdir(parents=True)
    write_result(place, read_result(result))
    for states in (["done", "done"], ["done", "kept"]):  # a task alone knows the layer's size before the second one
        assert [execute(task, job.output, run_task).state for task in tasks] == states
    carried = read_usd_meshes(place.parent / "rig.usda")[0].attributes
    assert set(names) <= set(carried)


def test_a_target_that_is_gone_takes_its_units_along_and_that_is_said(folder: Path) -> None:
    def carried(output: str) -> str:
        return " ".join(transfer(folder / output, source_uvs=True)[1])

    assert "units" not in carried("there.usda")
    (folder / "large.usda").unlink()
    assert "metres with Y up are written" in carried("gone.usda")
    assert "units" not in carried("gone.obj")


def test_a_target_that_is_no_usd_is_written_with_its_textures(folder: Path) -> None:
    (folder / "large.usda").unlink()
    transfer(folder / "out.png", texture=folder / "skin.png", usd=folder / "asset.usda")
    (mesh,) = read_usd_meshes(folder / "asset.usda")
    assert mesh.control.n_faces == 6
    assert complaints(folder / "asset.usda") == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target"),
    [("look.usda", "there"), ("look.usdc", "there"), ("look.usd", "there"), ("look.usda", "gone")],
)
def test_several_transfers_share_a_layer(folder: Path, name: str, target: str) -> None:
    """Weights, values, shapes and textures in one file; the same commands make the same file again."""
    rng, layer = np.random.default_rng(2), folder / name
    force = name.endswith(".usdc")  # which has no checksum
    if target == "gone":  # a file of its own instead of a layer
        (folder / "large.usda").unlink()
    skin = rng.random((8, 3))
    skin /= skin.sum(axis=1, keepdims=True)
    frown, smile, wink = (np.eye(8, 3, k) for k in (0, 1, 2))
    files: dict[str, dict[str, np.ndarray]] = {
        "skin": {"skel:jointWeights": skin},
        "wide": {"fur length": rng.random((8, 5)), "age": rng.random(8)},
        "narrow": {"fur length": rng.random(8)},
        "frown": {"blendShape:frown": smile, "blendShape:wink": wink},
        "smile": {"blendShape:smile": smile, "blendShape:frown": frown},
    }

    def carry() -> str:
        for file, values in files.items():
            np.savez(folder / f"{file}.npz", **values)
            said, _ = transfer(folder / f"{file}_out.npz", attribute=folder / f"{file}.npz", usd=layer, force=force)
        transfer(folder / "a.png", maps=(("albedo", folder / "skin.png"),), usd=layer, force=force)
        transfer(folder / "b.png", maps=(("roughness", folder / "skin.png"),), usd=layer, unwrap=True, force=force)
        return said

    assert "and what earlier commands wrote there" in carry()
    carried = read_usd_meshes(layer)[0].attributes
    expected = files["skin"] | {"age": files["wide"]["age"], "fur_length": files["narrow"]["fur length"]}
    expected |= files["frown"] | files["smile"]
    assert set(carried) - {"displayColor"} == set(expected)
    for key, array in expected.items():
        np.testing.assert_allclose(carried[key], array, atol=1e-5, err_msg=key)
    assert complaints(layer) == []
    stage = Usd.Stage.Open(str(layer))
    read = {}
    for use in ("diffuseColor", "roughness"):  # each in the layout that it was baked into
        surface = UsdShade.Shader(stage.GetPrimAtPath(f"/Asset/{MATERIAL}/surface"))
        texture = UsdShade.Shader(surface.GetInput(use).GetConnectedSources()[0][0].source.GetPrim())
        reader = UsdShade.Shader(texture.GetInput("st").GetConnectedSources()[0][0].source.GetPrim())
        read[use] = reader.GetInput("varname").Get()
    assert read == {"diffuseColor": "map1", "roughness": "cagemap_st"}
    del stage, surface, texture, reader
    before = layer.read_bytes()
    carry()
    assert force or layer.read_bytes() == before


def test_a_layer_about_another_mesh_is_refused(folder: Path) -> None:
    np.savez(folder / "values.npz", fur=np.arange(8.0))
    (folder / "other.usda").write_bytes((folder / "large.usda").read_bytes())
    other = read_usd_meshes(folder / "other.usda")[0].control
    layer = folder / "look.usda"
    fur = UsdResults(attributes={"age": np.ones(8)})
    write_usd_over(layer, folder / "other.usda", ["/Asset/mesh"], other, fur)
    before = layer.read_bytes()
    with pytest.raises(FormatError, match=r"look\.usda: holds results about another mesh"):
        transfer(folder / "carried.npz", attribute=folder / "values.npz", usd=layer)
    with pytest.raises(FormatError, match=r"look\.usda: holds results about another mesh"):
        transfer(folder / "out.png", texture=folder / "skin.png", usd=layer)
    assert layer.read_bytes() == before
    assert not (folder / "carried.npz").exists()
    assert not (folder / "out.png").exists()
    transfer(folder / "carried.npz", attribute=folder / "values.npz", usd=layer, force=True)
    assert set(read_usd_meshes(layer)[0].attributes) == {"fur"}


def test_weights_without_joints_do_not_keep_those_of_earlier_ones(folder: Path) -> None:
    """Their columns are numbers of other joints."""
    layer, skeleton = folder / "rig.usda", Skeleton(("a", "b"), ("", "a"), np.zeros((2, 3)), np.ones((2, 3)))
    mesh = read_usd_meshes(folder / "large.usda")[0].control
    weights = {"skel:jointWeights": np.eye(2)[np.arange(8) % 2]}
    write_usd_over(
        layer, folder / "large.usda", ["/Asset/mesh"], mesh, UsdResults(attributes=weights, skeleton=skeleton)
    )
    assert read_usd_skeleton(layer) is not None
    wider = np.eye(3)[np.arange(8) % 3]
    np.savez(folder / "values.npz", **{"skel:jointWeights": wider})
    transfer(folder / "carried.npz", attribute=folder / "values.npz", usd=layer)
    assert read_usd_skeleton(layer) is None
    np.testing.assert_allclose(read_usd_meshes(layer)[0].attributes["skel:jointWeights"], wider, atol=1e-6)


@pytest.mark.parametrize(
    "words",
    [["a.png", "b.png"], ["a=x.png", "a=y.png"], ["a=x.png", "y.png"], ["a/b=x.png", "c=y"], ["A=x.png", "a=y.png"]],
)
def test_maps_without_names_of_their_own_are_refused(words: list[str]) -> None:
    refuses(ParameterError, "--texture", texture_and_maps, words)


def test_a_single_image_needs_no_name() -> None:
    assert texture_and_maps(["skin.png"]) == (Path("skin.png"), ())
    assert texture_and_maps([]) == (None, ())
    assert texture_and_maps(["a=b.png"]) == (None, (("a", Path("b.png")),))
