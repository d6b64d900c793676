"""What a command did can be done again by the job file that it leaves in the RESULT folder."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from cagemap.errors import FormatError, ParameterError
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.jobs.job import read_job
from cagemap.jobs.plan import Task, plan_job
from cagemap.jobs.tree import spanning_tree
from cagemap.tasks.import_map import run_map
from cagemap.tasks.job_file import JOB, note_match, note_output
from cagemap.tasks.match import MatchRequest
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.run_job import run_task
from cagemap.tasks.wrap import run_wrap

from example_result import identity_result, textured_cube


@pytest.fixture
def folder(pair_files: Path) -> Path:
    (pair_files / "RESULT").mkdir()
    for name, scale in (("large.obj", 2.0), ("small.obj", 1.0)):
        write_mesh(pair_files / name, textured_cube(name, scale))
    return pair_files


def requests(folder: Path) -> tuple[MatchRequest, TransferRequest]:
    result = folder / "RESULT"
    match = MatchRequest(
        folder / "deer.obj", folder / "pony.obj", result, folder / "landmarks.json", vertices=700, k=40
    )
    return match, TransferRequest(result, folder / "deer.png", texture=folder / "pony.png", size=32)


def noted_tasks(result: Path) -> list[Task]:
    """What the job file of a RESULT plans."""
    return list(plan_job(read_job(result / JOB, COMMANDS, WRITTEN), "1", spanning_tree).tasks)


def test_the_job_file_asks_for_just_what_was_asked_for(folder: Path) -> None:
    match, transfer = requests(folder)
    note_match(match)
    for _ in range(2):  # the same output replaces
        note_output("transfer", transfer.result, transfer)
    tasks = noted_tasks(folder / "RESULT")
    asked = {task.kind: task.request for task in tasks}
    assert [task.kind for task in tasks] == ["prepare", "prepare", "match", "picture", "transfer"]
    assert {name: asked["match"][name] for name in ("vertices", "k")} == {"vertices": 700, "k": 40}
    for name, path in (("target", match.target), ("source", match.source), ("landmarks", match.landmarks)):
        assert Path(asked["match"][name]).resolve() == Path(str(path)).resolve()
    assert Path(asked["transfer"]["texture"]).resolve() == (folder / "pony.png").resolve()
    assert asked["transfer"]["size"] == 32


def test_an_edited_job_file_is_left_alone(folder: Path) -> None:
    match, transfer = requests(folder)
    note_match(match)
    place = folder / "RESULT" / JOB
    edited = place.read_text() + "# mine\n"
    place.write_text(edited)
    note_output("transfer", transfer.result, transfer)
    assert place.read_text() == edited


def test_no_file_is_written_twice_by_it_but_a_layer_to_which_each_adds(folder: Path) -> None:
    result = folder / "RESULT"
    write_result(result, identity_result())
    match, transfer = requests(folder)
    note_match(match)
    for output in ("deer.png", "other.png", "deer.png"):
        note_output("transfer", result, replace(transfer, output=folder / output, usd=folder / "deer.usda"))
    wrap = WrapRequest((result,), folder / "w.obj", texture=folder / "pony.png", baked=folder / "b.png", size=16)
    run_wrap(wrap, Stages())
    note_output("transfer", result, replace(transfer, output=folder / "b.png"))
    tasks = noted_tasks(result)
    assert [task.outputs for task in tasks[4:]] == [
        ("pony__deer/other.png", "pony__deer/deer.usda"),
        ("pony__deer/deer.png", "pony__deer/deer.usda"),
        ("pony__deer/w.obj",),
        ("pony__deer/b.png",),
    ]
    assert [task.predecessors for task in tasks[4:6]] == [(), (tasks[4].name,)]
    assert {task.request["usd"] for task in tasks[4:6]} == {str(result / "again" / "pony__deer" / "deer.usda")}


def test_a_binary_layer_to_which_several_add_is_repeated_as_text(folder: Path) -> None:
    match, transfer = requests(folder)
    note_match(match)
    for output in ("deer.png", "other.png", "third.png"):
        note_output("transfer", match.output, replace(transfer, output=folder / output, usd=folder / "look.usdc"))
    assert [task.layer for task in noted_tasks(match.output)[4:]] == 3 * ["pony__deer/look.usda"]


def test_outputs_of_one_name_in_several_folders_are_all_repeated(folder: Path) -> None:
    match, transfer = requests(folder)
    note_match(match)
    result = folder / "RESULT"
    for place in (folder / "lod0", folder / "lod1", folder, result, folder.parent, folder.parent / "lod0"):
        place.mkdir(exist_ok=True)
        for _ in range(2):  # the same output replaces
            note_output("transfer", result, replace(transfer, output=place / "skin.png"))
    for place in (folder / "lod0", folder / "lod1"):
        note_output("wrap", result, WrapRequest((result,), place / "w.obj", normal_map=place / "n.png", size=16))
    assert [task.outputs for task in noted_tasks(result)[4:]] == [
        ("pony__deer/lod0/skin.png",),
        ("pony__deer/lod1/skin.png",),
        ("pony__deer/skin.png",),
        ("pony__deer/inside/skin.png",),
        ("pony__deer/above1/skin.png",),
        ("pony__deer/above1/lod0/skin.png",),
        ("pony__deer/lod0/w.obj", "pony__deer/lod0/n.png"),
        ("pony__deer/lod1/w.obj", "pony__deer/lod1/n.png"),
    ]


def test_blend_shapes_of_several_results_are_noted_in_each(folder: Path) -> None:
    results = (folder / "RESULT", folder / "OTHER")
    for place, name in zip(results, ("small.obj", "other.obj"), strict=True):
        place.mkdir(exist_ok=True)
        result = identity_result()
        source = result.source
        control = replace(source.control, name=name)
        source = replace(source, refinement=replace(source.refinement, control=control))
        write_result(place, replace(result, source=source))
        note_match(replace(requests(folder)[0], output=place))
    run_wrap(WrapRequest(results, folder / "shapes", blend_shapes=True), Stages())
    for place in results:
        tasks = noted_tasks(place)
        assert [(task.outputs, task.request["blend_shapes"]) for task in tasks[4:]] == [(("pony__deer/shapes",), True)]


@pytest.mark.parametrize("text", ["mask.npy", "./mask.npy", "not:.//mask.npy", "not:sub/../mask.npy"])
def test_masks_are_found_however_their_paths_are_typed(folder, text, monkeypatch):
    (folder / "sub").mkdir()
    np.save(folder / "mask.npy", np.ones(3))
    monkeypatch.chdir(folder)
    match, _ = requests(folder)
    note_match(replace(match, target_mask=text))
    job = read_job(folder / "RESULT" / JOB, COMMANDS)
    mask = job.pairs[0].options["target_mask"]
    assert mask.startswith("not:") == text.startswith("not:")
    assert Path(mask.removeprefix("not:")).resolve() == (folder / "mask.npy").resolve()


@pytest.mark.slow
def test_a_map_that_is_given_is_taken_again(folder: Path) -> None:
    np.save(folder / "own.npy", np.random.default_rng(1).integers(0, 98, 98))
    request = MapRequest(folder / "own.npy", folder / "large.obj", folder / "small.obj", folder / "RESULT", level=2)
    with pytest.raises(ParameterError, match=r"--level 13: small.obj would have too many|--level 13: large.obj would"):
        run_map(replace(request, level=13), Stages())  # not MemoryError, nor the whole machine's memory
    run_map(request, Stages())
    job = folder / "RESULT" / JOB
    match, picture = noted_tasks(folder / "RESULT")
    (folder / "RESULT" / "again" / "small__large").mkdir(parents=True)
    assert run_task(match)["quality"]["coverage"] <= 1.0
    images = [read_result(place).point_map.images for place in (request.output, Path(match.request["output"]))]
    np.testing.assert_array_equal(images[0].positions, images[1].positions)
    assert picture.needs == (match.name,)
    np.save(folder / "own.npy", np.arange(98))
    assert noted_tasks(folder / "RESULT")[0].key != match.key
    data = tomllib.loads(job.read_text())
    data["pairs"][0]["landmarks"] = "../landmarks.json"
    job.write_text(tomli_w.dumps(data))
    with pytest.raises(FormatError, match=r"pairs\.0\.map: a map that is given takes level, weld.* only"):
        read_job(job, COMMANDS, WRITTEN)


def test_welds_and_masks_of_a_given_map_are_repeated(folder: Path) -> None:
    np.save(folder / "own.npy", np.arange(98))
    np.save(folder / "mask.npy", np.arange(8) / 8)
    files = (folder / name for name in ("own.npy", "large.obj", "small.obj", "RESULT"))
    request = MapRequest(*files, level=2, weld="auto", source_weld="0.001", target_mask=str(folder / "mask.npy"))
    run_map(request, Stages())
    task, _ = noted_tasks(folder / "RESULT")
    assert [task.request.get(name) for name in ("level", "weld", "source_weld")] == [2, "auto", "0.001"]
    (folder / "RESULT" / "again" / "small__large").mkdir(parents=True)
    run_task(task)
    masks = [read_result(place).masks.target for place in (request.output, Path(task.request["output"]))]
    assert masks[0] is not None
    assert masks[1] is not None
    np.testing.assert_array_equal(masks[0], masks[1])


def test_models_whose_names_differ_only_in_capitals_get_different_names(folder: Path) -> None:
    (folder / "new").mkdir()
    for name in ("horse.obj", "new/Horse.obj"):
        write_mesh(folder / name, textured_cube(name))
    note_match(MatchRequest(folder / "horse.obj", folder / "new" / "Horse.obj", folder / "RESULT"))
    assert [task.pair for task in noted_tasks(folder / "RESULT") if task.pair] == 2 * [("Horse-source", "horse-target")]
