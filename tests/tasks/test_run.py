"""Tasks from Python: a request of `cagemap.tasks` and `run`."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import voxels
from pydantic import TypeAdapter
from typer.main import get_command

from cagemap import tasks
from cagemap.cli.app import app
from cagemap.errors import CagemapError, FormatError, MissingFileError, ParameterError, values_of
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.manifest import read_manifest
from cagemap.files.usd.space import StageSpace
from cagemap.files.usd.write import write_usd
from cagemap.transfer.texels import LARGEST_SIDE

from plain_meshes import split_at_seams
from refusals import refuses


@pytest.fixture
def box(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "box.obj", voxels([(0, 0, 0), (1, 0, 0), (1, 1, 0)]))
    return tmp_path / "box.obj"


def test_a_match_and_a_transfer_by_texts_and_a_function(box: Path) -> None:
    result, said = box.parent / "R", list[str]()
    outcome = tasks.run(tasks.MatchRequest(str(box), str(box), str(result), level=1), said.append)
    assert said[0].startswith("read")
    assert outcome.succeeded
    assert result / "map.npz" in outcome.files
    assert "sure" in outcome.summary
    values = box.parent / "v.csv"
    np.savetxt(values, np.arange(16.0))
    carried = tasks.run(tasks.TransferRequest(result, box.parent / "w.csv", attribute=values))
    np.testing.assert_allclose(np.loadtxt(carried.files[0], skiprows=1), np.arange(16.0), atol=1e-9)


def test_what_check_finds_is_no_success(box: Path) -> None:
    assert tasks.run(tasks.CheckRequest((box,))).succeeded
    box.write_text(box.read_text() + "f 1 2 9\n")
    found = tasks.run(tasks.CheckRequest((box,)))
    assert not found.succeeded
    assert found.warnings == ()


def test_a_task_returns_the_numbers_of_its_summary(box: Path) -> None:
    folder = box.parent
    matched = tasks.run(tasks.MatchRequest(box, box, folder / "R", level=2))
    assert matched.figures["quality"]["coverage"] > 0.99
    assert f"{matched.figures['target_vertices']} target and" in matched.summary
    wrapped = tasks.run(tasks.WrapRequest((folder / "R",), folder / "w.obj"))
    for name in ("residual", "residual_from_source"):
        assert f"mean {100 * wrapped.figures[name]['mean']:.4f}, 99 % within" in wrapped.summary
    np.savetxt(folder / "legs.csv", np.full((16, 2), 0.5), delimiter=",", header="hip,knee", comments="")
    carried = tasks.run(tasks.TransferRequest(folder / "R", folder / "w.csv", weights=folder / "legs.csv"))
    assert carried.figures == {"vertices": 16, "joints": 2, "influences": 2, "untrusted_vertices": 0}
    output, images = folder / "i.png", ("ao", "normal")
    baked = tasks.run(tasks.TransferRequest(folder / "R", output, bake=images, detail=box, size=16, unwrap=True))
    assert baked.figures == {kind: {"size": 16, "tiles": [0]} for kind in images}
    worn = tasks.run(tasks.TransferRequest(folder / "R", folder / "p.obj", passenger=box))
    assert 0.0 < worn.figures.pop("distance") < 0.2  # of the cage from its refined surface
    assert worn.figures == {"vertices": 16, "unit_factor": 1.0}
    values = tasks.run(tasks.TransferRequest(folder / "R", folder / "v.csv", attribute=folder / "legs.csv"))
    assert values.figures == {"arrays": {"hip": [16], "knee": [16]}}
    made = tasks.run(tasks.FunctionsRequest(box, folder / "f.npz", k=5, level=2))
    assert made.figures["eigenvalues"] == np.load(folder / "f.npz")["eigenvalues"].tolist()
    assert f"{made.figures['functions']} functions (eigenfunctions) at {made.figures['vertices']}" in made.summary
    checked = tasks.run(tasks.CheckRequest((box,)))
    assert [(file["usable"], file["n_vertices"]) for file in checked.figures["files"]] == [(True, 16)]
    outcomes = matched, wrapped, carried, baked, worn, values, made, checked
    json.dumps([outcome.figures for outcome in outcomes], allow_nan=False)


def test_every_command_of_the_command_line_but_the_studio_has_a_request() -> None:
    assert len(tasks._TASKS) == len(get_command(app).commands) - 1  # type: ignore[attr-defined]
    for name in tasks._TASKS:
        assert callable(tasks.runner_of(object.__new__(getattr(tasks, name))))


@pytest.mark.parametrize("name", tasks._TASKS)
def test_every_field_has_its_help_text_in_python_and_in_the_json_schema(name: str) -> None:
    request = getattr(tasks, name)
    described = TypeAdapter(request).json_schema()["properties"]
    assert list(described) == [field.name for field in fields(request)]
    for field, entry in described.items():
        assert f"{field}\n    {entry['description']}\n" in f"{request.__init__.__doc__}\n"


def test_what_is_no_request_or_no_value_of_its_field_is_refused_before_any_work(box: Path) -> None:
    request = tasks.MatchRequest(box, box, box.parent / "R", level="two")
    refuses(ParameterError, "level: expected a whole number, got 'two'", tasks.run, request)
    with pytest.raises(ParameterError, match="level: expected 1 or more, got 0"):
        tasks.run(tasks.MatchRequest(box, box, box.parent / "R", level=0))
    for field, kind in (("level", "a whole number"), ("mask_edge", "a number")):
        with pytest.raises(ParameterError, match=f"{field}: expected {kind}, got True"):
            tasks.run(tasks.MatchRequest(box, box, box.parent / "R", **{field: True}))
    with pytest.raises(ParameterError, match="space: expected 'tangent' or 'object', got 'world'"):
        tasks.run(tasks.TransferRequest(box.parent, box.parent / "a.png", normal_map=box, space="world"))
    refuses(ParameterError, r"request: expected one of DemoRequest, .* got str", tasks.run, "match")
    refuses(ParameterError, "progress: expected a function of a text, got 3", tasks.run, tasks.CheckRequest((box,)), 3)
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        tasks.Nothing  # noqa: B018
    assert [file.name for file in box.parent.iterdir()] == ["box.obj"]


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.glb", "a.usda", "a.stl"])
def test_errors_have_a_code_for_programs(tmp_path: Path, name: str) -> None:
    with pytest.raises(MissingFileError) as found:
        tasks.run(tasks.MatchRequest(tmp_path / name, tmp_path / name, tmp_path / "R"))
    assert found.value.code == "missing-file"
    codes = [kind.code for kind in (CagemapError, *_below(CagemapError))]
    assert len(codes) == len(set(codes)) == 9
    assert issubclass(MissingFileError, FormatError)


@pytest.mark.parametrize(
    ("message", "place", "remedy"),
    [
        (
            "a b/v1.2: final.obj: expected an OBJ file, got none. Check the name.",
            "a b/v1.2: final.obj",
            "Check the name.",
        ),
        ("--rays: expected with --bake only, got --texture. Leave it out.", "--rays", "Leave it out."),
        ("--amount: expected 0 to 1, got 1.5", "--amount", ""),
        ("expected one RESULT, got 2: a. Give one. Or several with --blend-shapes.", "", None),
        ("a.png: only 3 % are directions. Give it as: --texture.", "a.png", "Give it as: --texture."),
        ("not enough memory. Use fewer workers: 2.", "", "Use fewer workers: 2."),
    ],
)
def test_errors_have_a_place_and_a_remedy(message: str, place: str, remedy: str | None) -> None:
    error = ParameterError(message)
    assert (error.place, error.remedy) == (place, message.partition(". ")[2] if remedy is None else remedy)


def test_a_place_is_added_before_the_messages_of_values() -> None:
    with pytest.raises(ParameterError, match=r"^w\.csv: weights: expected numbers") as found, values_of("w.csv"):
        raise ParameterError("weights: expected numbers, got texts")
    assert found.value.place == "w.csv: weights"


def test_the_notes_of_a_map_are_kept_in_its_result(tmp_path: Path) -> None:
    for name, metres in (("a.usda", 1.0), ("b.usda", 0.01)):
        write_usd(tmp_path / name, split_at_seams(voxels([(0, 0, 0), (1, 0, 0)])), space=StageSpace("Y", metres))
    np.save(tmp_path / "m.npy", np.arange(12))
    request = tasks.MapRequest(*(tmp_path / name for name in ("m.npy", "a.usda", "b.usda", "R")), weld="auto")
    notes = tasks.run(request).warnings
    assert "results are in the target's own" in notes[0]
    assert "a.usda" in notes[1]
    assert read_manifest(tmp_path / "R")["notes"] == list(notes[:3])


def _below(kind: type) -> list[type]:
    return [found for below in kind.__subclasses__() for found in (below, *_below(below))]


@pytest.mark.parametrize("name", ["TransferRequest", "WrapRequest", "RigRequest"])
def test_an_image_has_no_more_texels_a_side_than_a_bake_takes(name: str) -> None:
    size = TypeAdapter(getattr(tasks, name)).json_schema()["properties"]["size"]
    assert next(kind["maximum"] for kind in size["anyOf"] if "maximum" in kind) == LARGEST_SIDE
