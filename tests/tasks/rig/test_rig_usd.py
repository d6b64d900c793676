"""`cagemap rig` from and to USD: units, axes and images as in glTF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.character.poses import pose_at
from cagemap.character.values import Character, Part, skinned_positions
from cagemap.errors import FormatError
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.space import StageSpace
from cagemap.files.usd.stages import open_stage
from cagemap.files.usd.write import write_usd
from cagemap.mesh import ControlMesh
from cagemap.subdivision import refine, with_options
from cagemap.tasks.rig_character import read_body

from command_line import Run
from rigged import image_error, part_named, rig_done, same_order, write_outermost


@pytest.mark.slow
def test_a_usd_character_gives_the_same_as_its_glb(run: Run, files: Character) -> None:
    """In centimetres; also with landmarks, which name vertices of the USD file."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    document = read_document("C.glb")
    write_usd_character("C.usdc", character_of(document), read_scene(document), space=StageSpace("Y", 0.01))
    first = rig_done(run)
    (points,) = (part.mesh.positions for part in character_of(document).parts if part.name == "body")
    write_outermost(read_mesh("B.glb").positions, points)
    for words in ((), ("--landmarks", "L.json")):
        run.done("rig B.glb --like C.usdc -o OUT.glb", *words)
        made = read_character("OUT.glb")
        assert {part.name for part in made.parts} == {part.name for part in first.parts}
        np.testing.assert_allclose(made.rig.bind, first.rig.bind, atol=2e-3)
        poses = [pose_at(of.rig, of.animations[0], 0.7) for of in (first, made)]
        for given in first.parts:
            found = part_named(made, given.name)
            rows = same_order(found, given, 2e-3)
            expected = skinned_positions(given, first.rig, poses[0])
            np.testing.assert_allclose(skinned_positions(found, made.rig, poses[1])[rows], expected, atol=5e-3)
        assert image_error() < 0.03


def test_clothes_are_on_the_limit_surface_where_usd_keeps_the_scheme_of_the_body(run: Run, tmp_path, monkeypatch):
    """Not outside the flat faces of the cage, as in glTF."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    monkeypatch.chdir(tmp_path)
    cage = refine(cube(), 3)
    body, shirt = (
        with_options(ControlMesh.from_faces(size * cage.finest.positions, cage.finest.faces), "none")
        for size in (1.0, 1.02)
    )
    write_document("C.glb", character_glb(Character((Part("body", body), Part("shirt", shirt)))))
    half = np.abs(cage.control.positions).max()
    write_usd("B.usda", with_options(cage.control, "catmull-clark"))
    heights = []
    for name in ("OUT.usda", "OUT.glb"):
        run.done("rig B.usda --like C.glb -o", name)
        cloth = part_named(read_body(Path(name))[1], "shirt").mesh
        heights.append(np.abs(cloth.positions).max(axis=1))
    assert heights[0].max() < 1.03 * np.abs(cage.finest.positions).max()
    assert heights[1].min() > half


@pytest.mark.slow
def test_images_of_the_character_are_not_replaced(run: Run, files: Character) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    document = read_document("C.glb")
    write_usd_character("C.usda", character_of(document), read_scene(document))
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    assert "C_body_baseColor.png" in before
    for _ in range(2):
        run.done("rig B.glb --like C.usda -o C.usdc --force")
        assert {path.name for path in Path().iterdir()} == {*before, "C.usdc", "C_body_baseColor1.png"}
        assert {name: Path(name).read_bytes() for name in before} == before


@pytest.mark.slow
def test_a_usd_body_keeps_its_units_and_axes(run: Run, files: Character, body: ControlMesh) -> None:
    usd_geom = pytest.importorskip("pxr.UsdGeom", reason="usd-core is not installed")
    to_world = np.eye(4)
    to_world[3, :3] = [5.0, 0.0, 0.0]
    space = StageSpace("Z", 0.01, to_world)
    upright = 100 * np.column_stack([body.positions[:, 0], -body.positions[:, 2], body.positions[:, 1]])
    write_usd("B.usda", body.with_positions(upright), space=space)
    for _ in range(2):  # its own file is replaced without force
        outcome = run.done("rig B.usda --like C.glb -o OUT.usda")
        assert outcome.out.startswith("wrote OUT.usda: B.usda like C.glb\n  2 joints, 1 animation\n")
    assert read_usd_meshes("OUT.usda")[0].to_world[3, 0] == 5.0
    stage = usd_geom.GetStageMetersPerUnit, usd_geom.GetStageUpAxis
    opened = open_stage("OUT.usda")
    assert [of(opened) for of in stage] == [0.01, "Z"]


@pytest.mark.slow
def test_a_usd_body_gives_the_same_glb_as_its_glb(run: Run, files: Character, body: ControlMesh) -> None:
    """In centimetres with Z up, moved by its prim: glTF is in metres with Y up. Landmarks name vertices of the file."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    first = rig_done(run)
    to_world = np.eye(4)
    to_world[3, :3] = [500.0, 0.0, 0.0]
    upright = 100 * np.column_stack([body.positions[:, 0], -body.positions[:, 2], body.positions[:, 1]])
    write_usd("B.usda", body.with_positions(upright - to_world[3, :3]), space=StageSpace("Z", 0.01, to_world))
    (points,) = (part.mesh.positions for part in files.parts if part.name == "body")
    write_outermost(body.positions, points)
    for words in ((), ("--landmarks", "L.json")):
        run.done("rig B.usda --like C.glb -o OUT.glb", *words)
        made = read_character("OUT.glb")
        np.testing.assert_allclose(made.rig.bind, first.rig.bind, atol=2e-3)
        for given in first.parts:
            same_order(part_named(made, given.name), given, 2e-3)


def test_usd_and_its_images_are_written_together(run: Run, files: Character, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of others at the layer's name, or an error after the layer: no image is left either."""
    Path("OUT.usdc").write_bytes(b"mine")
    run.refused("rig B.glb --like C.glb -o OUT.usdc --report R.html", says="OUT.usdc: exists, and was not written")

    def fails(*_: object, **__: object) -> None:
        raise FormatError("no report")

    monkeypatch.setattr("cagemap.tasks.rig_character._write_report", fails)
    run.refused("rig B.glb --like C.glb -o OUT.usda --report R.html", says="no report")
    assert sorted(path.name for path in Path().iterdir()) == ["B.glb", "C.glb", "OUT.usdc"]
