"""What `cagemap transfer` refuses at its door: outputs that would be half of what was asked for, and idle options."""

import os
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.tasks.requests.transfer import READ_BY, TransferRequest
from cagemap.tasks.transfer import check_transfer

from example_result import identity_result
from refusals import refuses
from transfer_command import transfer


@pytest.fixture
def place(tmp_path: Path) -> Path:
    write_result(tmp_path / "R", identity_result())
    np.save(tmp_path / "v.npy", np.arange(8.0))
    write_image(tmp_path / "t.png", np.full((8, 8, 3), 90, np.uint8))
    return tmp_path


def refused(place: Path, output: str, **options: Any) -> str:
    before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
    with pytest.raises((FormatError, ParameterError)) as refusal:
        transfer(place / output, **options)
    assert {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} == before
    return str(refusal.value)


def test_a_layer_that_cannot_be_is_refused_before_its_values_are_written(place: Path) -> None:
    (place / "mine.usda").write_text("#usda 1.0\n")
    values = {"attribute": place / "v.npy"}
    assert ".usda" in refused(place, "o.npz", usd=place / "o.npz", **values)
    assert "not written by cagemap" in refused(place, "o.npz", usd=place / "mine.usda", **values)
    assert "not written by cagemap" in refused(place, "w.npz", usd=place / "mine.usda", weights=place / "v.npy")
    assert "does not exist" in refused(place, "o.npz", usd=place / "none" / "o.usda", **values)


def test_a_base_that_nothing_reads_is_refused_or_reported(place: Path) -> None:
    own, image = (("", place / "t.png"),), place / "t.png"
    named = (("albedo", image),)
    assert "--base: expected one file without a name, got albedo" in refused(place, "o.png", texture=image, bases=named)
    maps = {"maps": (("color", image),), "target_mask": "red"}
    assert "names of what is carried (color), got albedo" in refused(place, "o.png", bases=named, **maps)
    for mask in (None, "red"):
        _, warnings = transfer(place / "o.png", texture=image, bases=own, target_mask=mask)
        assert any("--base is not used" in text for text in warnings) == (mask is None)


@pytest.mark.parametrize("words", [("attribute", "o.csv"), ("weights", "o.csv"), ("blend_shapes", "shapes")])
def test_values_and_the_layer_beside_them_are_written_both_or_neither(place, words, monkeypatch):
    """A .csv that is left alone, without a mark, would refuse the next run."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    carried, output = words
    np.save(place / "v.npy", np.ones(8))
    np.savez(place / "s.npz", smile=np.ones((8, 3)))
    given = (place / "s.npz",) if carried == "blend_shapes" else place / "v.npy"
    options = {carried: given, "usd": place / "o.usda"}
    with monkeypatch.context() as full:
        full.setattr("cagemap.files.usd.write.mark", fail)
        assert "cannot write there" in refused(place, output, **options)
    transfer(place / output, **options)
    assert (place / "o.usda").is_file()
    assert (place / output).exists()
    assert not [path for path in place.rglob("*.part*")]


def fail() -> str:
    raise FormatError("o.usda: cannot write there")


def test_options_that_would_do_nothing_are_those_of_the_request() -> None:
    assert set(READ_BY) <= {field.name for field in fields(TransferRequest)}


def test_a_result_that_may_only_be_read_is_used_with_a_word(place, monkeypatch, caplog):
    """Somebody else's, or on a disk that is for reading."""
    result = place / "R"
    (result / "job.toml").write_text('output = "again"\n')
    before = {path: path.read_bytes() for path in result.iterdir()}
    honest = os.access
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != result and honest(path, mode))
    monkeypatch.setattr("cagemap.tasks.job_file.is_own", lambda path: True)
    said, _ = transfer(place / "o.npz", attribute=place / "v.npy")
    assert "wrote" in said
    assert (place / "o.npz").is_file()
    assert {path: path.read_bytes() for path in result.iterdir()} == before
    for file in ("manifest.json", "job.toml"):
        assert f"{file}: cannot write to the folder" in caplog.text
    assert "not noted there" in caplog.text


FOREIGN = {
    "source_uvs": ("o.obj", {"source_uvs": True}, "was not written by cagemap"),
    "source_uvs in a format without": ("o.txt", {"source_uvs": True}, "expected a mesh file ending in"),
    "blend_shapes": ("shapes", {"blend_shapes": ("v.obj",)}, "was not written by cagemap"),
    "blend_shapes in an npz": ("o.npz", {"blend_shapes": ("v.obj",)}, "was not written by cagemap"),
    "weights": ("o.txt", {"weights": "v.npy"}, "expected a name ending in"),
    "joints": ("o.txt", {"joints": "j.json"}, "expected a name ending in .json"),
    "write_map": ("o.xyz", {"write_map": True}, "expected a name ending in .npy, .npz, .mtx, .vts, .mhclo or .proxy"),
    "blend_shapes in a format without": ("o.csv", {"blend_shapes": ("v.obj",)}, "expected a folder or a name ending"),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_what_cannot_be_written_is_refused_before_the_work(place, monkeypatch, name):
    output, options, says = FOREIGN[name]
    for work in ("transfer.transfer_of", "rig.carry_shapes", "rig.carry_weights", "rig.carry_joints"):
        monkeypatch.setattr(f"cagemap.tasks.{work}", lambda *given, **more: pytest.fail("it was carried"))
    source = read_result(place / "R").source.control
    write_mesh(place / "v.obj", source.with_positions(1.1 * source.positions))
    (place / "j.json").write_text('[{"name": "hip", "parent": null, "head": [0, 0, 0], "tail": [0, 0.2, 0]}]')
    (place / "shapes").mkdir()
    for foreign in ("o.obj", "o.npz", "shapes/v.obj"):
        (place / foreign).write_bytes(b"of somebody")
    given = {
        option: tuple(place / file for file in value) if isinstance(value, tuple) else value
        for option, value in options.items()
    }
    given |= {option: place / value for option, value in given.items() if isinstance(value, str)}
    assert says in refused(place, output, **given)


@pytest.mark.parametrize("name", [name for name, (_, _, says) in FOREIGN.items() if "expected" in says])
def test_a_job_refuses_names_of_outputs_before_its_tasks(name: str) -> None:
    output, options, says = FOREIGN[name]
    given = {option: (Path(*value),) if isinstance(value, tuple) else value for option, value in options.items()}
    given |= {option: Path(value) for option, value in given.items() if isinstance(value, str)}
    refuses(FormatError, re.escape(says), check_transfer, TransferRequest(Path("R"), Path(output), **given))
