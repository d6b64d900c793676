"""What a wrap writes beside the cage: notes in its RESULTs, blend shapes all or none, a texture of a model file."""

import json
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import FormatError
from cagemap.files.images.image import read_image, write_image
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.manifest import MANIFEST
from cagemap.tasks import WrapRequest, run
from cagemap.tasks import wrap as task
from cagemap.tasks.report import carried_data

from command_line import Run
from example_result import identity_result, textured_cube


@pytest.fixture
def frames(tmp_path: Path) -> tuple[Path, ...]:
    """Results of one target and three sources."""
    made = tuple(tmp_path / name for name in ("r_child", "r_man", "r_woman"))
    for folder in made:
        source = textured_cube(f"{folder.name[2:]}.obj")
        write_result(folder, identity_result(1, (textured_cube("large.obj"), source)))
    return made


def test_a_report_shows_each_cage_of_blend_shapes(frames: tuple[Path, ...], tmp_path: Path) -> None:
    run(WrapRequest(frames, tmp_path / "shapes", blend_shapes=True))
    for folder in frames:
        (entry,) = json.loads((folder / MANIFEST).read_text())["transfers"]
        assert (folder / entry["output"]).resolve() == tmp_path / "shapes" / f"{folder.name[2:]}.obj"
        assert carried_data(folder, read_result(folder)).wrapped is not None


@pytest.mark.parametrize("exists", [False, True])
def test_of_blend_shapes_that_fail_none_is_written(
    frames: tuple[Path, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exists: bool
) -> None:
    shapes, wraps = tmp_path / "shapes", task._wrap
    if exists:
        shapes.mkdir()
        (shapes / "notes.txt").write_text("mine")

    def full(request: WrapRequest, result: object, *given: object) -> object:
        if result.source.control.name == "woman.obj":
            raise FormatError("no space left")
        return wraps(request, result, *given)

    monkeypatch.setattr(task, "_wrap", full)
    with pytest.raises(FormatError, match="no space left"):
        run(WrapRequest(frames, shapes, blend_shapes=True))
    assert shapes.exists() == exists
    assert not exists or [path.name for path in shapes.iterdir()] == ["notes.txt"]
    assert not any(json.loads((folder / MANIFEST).read_text()).get("transfers") for folder in frames)


def test_the_image_inside_a_model_file_is_baked(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    write_image(place / "skin.png", np.full((8, 8, 3), [200, 30, 10], dtype=np.uint8))
    scene = {
        "asset": {"version": "2.0"},
        "materials": [{"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "skin.png"}],
    }
    (place / "box.gltf").write_text(json.dumps(scene))
    run.done("wrap R -o new.obj --texture box.gltf --baked baked.png")
    baked = read_image(place / "baked.png").pixels
    assert baked.shape == (8, 8, 3)  # the size of the model's own image
    np.testing.assert_array_equal(baked[4, 4], [200, 30, 10])
    run.refused("wrap R -o other.obj --texture box.gltf --baked baked.txt", says="expected an image name ending in")
    assert not (place / "other.obj").exists()


def test_shapes_of_a_source_in_another_unit_are_warned_about(tmp_path: Path) -> None:
    """A cage in centimetres and a generated body of size 1: what is between them has no use as a shape."""
    for size, is_warned in ((1.5, False), (0.01, True)):
        write_result(tmp_path / "R", identity_result(1, (textured_cube("large.obj"), textured_cube("s.obj", size))))
        for request in (
            WrapRequest((tmp_path / "R",), tmp_path / "half.obj", amount=0.5),
            WrapRequest((tmp_path / "R",), tmp_path / "shapes", blend_shapes=True),
        ):
            outcome = run(request)
            assert any("times as large as the target" in text for text in outcome.warnings) == is_warned
            assert ("distances of --amount 1 in %" in outcome.summary) == (request.amount == 0.5)
