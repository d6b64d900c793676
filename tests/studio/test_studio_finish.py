"""The finish: the commands that it runs, what it gives to download, and whether its map is the one shown."""

import io
import os
import queue
import zipfile
from collections.abc import Callable
from dataclasses import field, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any
from unittest.mock import patch

import numpy as np
import pytest
from ending_processes import die, hang_up, leave
from examples.shapes import cube
from hypothesis import given
from hypothesis import strategies as st
from test_obj import QUICK
from typed_request import run_typed, typed

from cagemap.errors import OPTION_NAMES, ParameterError, use_option_names
from cagemap.files import MASK_SUFFIXES
from cagemap.files.result.folder import write_result
from cagemap.maps.result import MatchResult
from cagemap.mesh.repairs import Repairs
from cagemap.studio.downloads import ARCHIVE_NAME, output_content
from cagemap.studio.finish import (
    MAP_TITLE,
    SHARED_OPTIONS,
    TRANSFERS,
    Command,
    FinishOptions,
    finish_commands,
    plan_commands,
)
from cagemap.studio.finish_layout import (
    ADVANCED,
    OMITTED_OPTIONS,
    SECTIONS,
    SIZE_KEY,
    VERTICES_KEY,
    explain_flags,
    in_page_words,
    sections,
)
from cagemap.studio.finish_map import map_difference_notes
from cagemap.studio.opening import default_files
from cagemap.studio.runner import Runner, command_outputs
from cagemap.studio.scene import Scene
from cagemap.studio.shape import refined_shape
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import Message, Output, RunningJob, add_message
from cagemap.studio.workspace import Workspace
from cagemap.tasks.bake_tiles import colors_remedy, target_overlap_warnings
from cagemap.tasks.detail_bakes import KINDS
from cagemap.tasks.masks import mask_file
from cagemap.tasks.requests.catalogue import COMMANDS, CommandOption, Key, Value, all_options
from cagemap.tasks.requests.options import CARRIED, Option, option_fields
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.requests.transfer import TransferRequest, require_map_names
from cagemap.tasks.transfer import check_transfer

from example_result import identity_result
from refusals import refuses

OPTIONS = all_options()
SHOWN = (*(field.key for fold in SECTIONS for field in fold.fields), VERTICES_KEY, SIZE_KEY)


def test_a_finish_is_the_commands_that_one_would_type(tmp_path: Path) -> None:
    files = default_files(tmp_path / "cow.obj", tmp_path / "spot.obj", tmp_path / "spot.png")
    asked = FinishOptions(option_values={VERTICES_KEY: 5000, SIZE_KEY: 256, ("transfer", "unwrap"): True})
    todo = finish_commands(OPTIONS, files, asked, use_landmarks=True)
    assert [command.title for command in todo] == ["match", "texture", "report"]
    assert "--landmarks" in typed(todo[0].request)
    assert "--landmarks" not in typed(finish_commands(OPTIONS, files, FinishOptions(), use_landmarks=False)[0].request)
    assert todo[1].request == TransferRequest(
        files.result, tmp_path / "cow_from_spot.png", tmp_path / "spot.png", size=256, unwrap=True
    )
    asked = FinishOptions(wrap=True, option_values={("wrap", "mhclo"): True, ("transfer", "rays"): 8})
    words = [typed(command.request) for command in finish_commands(OPTIONS, files, asked, use_landmarks=True)]
    assert ["--mhclo" in line for line in words].count(True) == 1
    assert not any("--rays" in line for line in words)  # of an image that is not asked for


def test_every_option_is_on_the_page_or_left_out_for_a_reason() -> None:
    assert {*SHOWN, *OMITTED_OPTIONS, *SHARED_OPTIONS} <= {*OPTIONS}
    assert len({*SHOWN}) == len(SHOWN)
    assert not {*SHOWN} & {*OMITTED_OPTIONS}
    assert {key[0] for key in OPTIONS} == {*COMMANDS}
    assert OPTIONS["transfer", "bake"].choices == KINDS
    assert all(mask_file(f"not:a{suffix}") is not None for suffix in MASK_SUFFIXES)


def test_an_option_that_is_new_to_a_request_is_on_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    grain = ("grain", Annotated[float, Option(min=0.5, max=4, help="How coarse.")], field(default=1.0))
    more = make_dataclass("More", [grain], bases=(TransferRequest,), frozen=True)
    monkeypatch.setitem(COMMANDS, "transfer", more)
    options = all_options()
    assert sections(options)[-1].title == ADVANCED
    key = ("transfer", "grain")
    assert [field.key for fold in sections(options)[len(SECTIONS) :] for field in fold.fields] == [key]
    files = default_files(Path("/w/cow.obj"), Path("/w/spot.obj"), Path("/w/spot.png"))
    todo = finish_commands(options, files, FinishOptions(option_values={key: 2.0}), use_landmarks=False)
    assert todo[1].request.grain == 2.0
    for outside in (0.0, 5.0):
        with pytest.raises(ParameterError, match="grain: expected"):
            finish_commands(options, files, FinishOptions(option_values={key: outside}), use_landmarks=False)


def values(option: CommandOption) -> st.SearchStrategy[Value]:
    """What the page may say for an option."""
    suffixes = {"joints": ".json", "attribute": ".csv", "weights": ".csv"}
    file = Path(f"/w/{option.name}{suffixes.get(option.name, '.obj')}")
    made: dict[str, st.SearchStrategy[Value]] = {
        "flag": st.booleans(),
        "output": st.booleans(),
        "choice": st.sampled_from(option.choices or ("none",)),
        "several": st.sets(st.sampled_from(option.choices or ("none",))).map(lambda some: tuple(sorted(some))),
        "whole": st.integers(int(option.least or 0), 8) if (option.least or 0) <= 8 else st.just(option.least),
        "number": st.floats(0, 1),
        "text": st.just("body"),
        "name or file": st.sampled_from(["body", "not:body", "/w/mask.png"]),
        "file": st.just(file),
        "files": st.just((file, file.with_suffix(".npz"))),
        "named files": st.just((("", file), ("normal map", file))),
    }
    return made[option.kind]


GIVEN: Any = st.fixed_dictionaries({}, optional={key: values(OPTIONS[key]) for key in SHOWN})
ASKED = st.builds(
    FinishOptions,
    texture=st.booleans(),
    maps=st.sampled_from([(), (("roughness", Path("/w/rough.png")),)]),
    map_form=st.sampled_from(["", ".npy", ".mhclo"]),
    image_form=st.sampled_from(["", ".exr"]),
    wrap=st.booleans(),
    report=st.booleans(),
    name=st.sampled_from(["", "hero"]),
    option_values=GIVEN,
)


def require_accepted(request: TransferRequest) -> None:
    """Fail if `cagemap transfer` refuses the options, other than --green with --space object."""
    check_transfer(replace(request, green="up"))


def test_every_kind_of_data_of_a_transfer_has_its_own_command() -> None:
    """With every option of the form set, each command has one kind of data and the options that belong to it."""
    scene = Path("/w/hat.glb")
    values_by_kind: dict[str, Value] = {"flag": True, "output": True, "whole": 8, "number": 2.0, "text": "hand"}
    given: dict[Key, Value] = {}
    for key in (key for key in SHOWN if key[0] == "transfer"):
        option = OPTIONS[key]
        given[key] = option.choices[-1] if option.kind == "choice" else values_by_kind.get(option.kind, scene)
    given |= given_values(bake=("ao", "texture"), bases=(("", Path("/w/own.png")),), blend_shapes=(scene,))
    del given["transfer", "green"]  # not in object space
    files = default_files(Path("/w/cow.obj"), Path("/w/spot.obj"), Path("/w/spot.png"))
    asked = FinishOptions(map_form=".npy", option_values=given)
    todo = finish_commands(OPTIONS, files, asked, use_landmarks=False)
    requests = [command.request for command in todo if isinstance(command.request, TransferRequest)]
    for request in requests:
        require_accepted(request)
    data_fields = [field.name for field, _, option in option_fields(TransferRequest) if option.group == CARRIED]
    carried = [[name for name in data_fields if getattr(request, name)] for request in requests]
    # The joints also name the columns of the weights.
    assert carried == [["weights", "joints"] if of == "weights" else [of] for of in TRANSFERS]
    assert {name for names in carried for name in names} == {*data_fields}
    for _, name in given:
        default = OPTIONS["transfer", name].default
        assert any(getattr(request, name) != default for request in requests), name


def test_a_passenger_is_a_mesh_and_its_option_belongs_to_no_other_transfer(tmp_path: Path) -> None:
    files = default_files(tmp_path / "cow.obj", tmp_path / "spot.obj", tmp_path / "spot.png")
    for name, written in (("hat.obj", "hat.obj"), ("hat.glb", "hat.obj"), ("hat.usdz", "hat.usda")):
        given = given_values(passenger=tmp_path / name, kind="rigid")
        asked = FinishOptions(report=False, option_values=given)
        _, texture, passenger = finish_commands(OPTIONS, files, asked, use_landmarks=False)
        assert texture.request == TransferRequest(files.result, tmp_path / "cow_from_spot.png", files.texture)
        output = tmp_path / f"cow_from_spot_{written}"
        assert passenger.request == TransferRequest(files.result, output, passenger=tmp_path / name, kind="rigid")
    alone = FinishOptions(report=False, option_values=given_values(kind="rigid"))
    assert finish_commands(OPTIONS, files, alone, use_landmarks=False)[1].request == texture.request


@pytest.mark.slow
@QUICK
@given(asked=ASKED)
def test_the_command_line_understands_every_finish(asked: FinishOptions) -> None:
    files = default_files(Path("/w/cow.obj"), Path("/w/spot.obj"), Path("/w/spot.png"))
    todo = finish_commands(OPTIONS, files, asked, use_landmarks=True)
    said: list[object] = []
    for command in todo:
        name = typed(command.request)[0]
        with patch(f"cagemap.tasks.{name}.run_{name}", lambda request, _: (said.append(request), ("", []))[1]):
            run_typed(command.request)  # raises where an option is unknown or a value is none
        if isinstance(command.request, TransferRequest):
            require_accepted(command.request)
    assert said == [command.request for command in todo]
    written = [command.output for command in todo]
    # No two commands write the same file, and none writes what another reads.
    assert len(set(written)) == len(written)
    assert not set(written) & {files.target, files.source, files.texture}
    # Every option that is asked for is in some command, unless what it belongs to is not.
    match, *others = [command.request for command in todo]
    for name, value in ((name, value) for (command, name), value in asked.option_values.items() if command == "match"):
        assert str(getattr(match, name)) == str(value)
    for name in ("normal_map", "displacement", "weights", "attribute", "blend_shapes", "passenger"):
        carried = [getattr(request, name) for request in others if isinstance(request, TransferRequest)]
        assert any(carried) == (("transfer", name) in asked.option_values)


def given_values(**given: Value) -> dict[Key, Value]:
    return {("transfer", name): value for name, value in given.items()}


def test_own_images_lie_under_what_they_are_named_after() -> None:
    files = default_files(Path("/w/cow.obj"), Path("/w/spot.obj"), Path("/w/spot.png"))
    own = (("", Path("/w/c.png")), ("Normal Map", Path("/w/n.png")), ("ao", Path("/w/ao.png")))
    asked = FinishOptions(option_values=given_values(bases=own, normal_map=Path("/w/bumps.png"), bake=("ao",)))
    texture, normals, baked = finish_commands(OPTIONS, files, asked, use_landmarks=False)[1:4]
    assert texture.request.bases == (("", Path("/w/c.png")),)
    assert normals.request.bases == (("", Path("/w/n.png")),)
    assert baked.request.bases == (("ao", Path("/w/ao.png")),)
    with_maps = FinishOptions(maps=(("roughness", Path("/w/r.png")),), option_values=given_values(bases=own))
    (color, *_) = finish_commands(OPTIONS, files, with_maps, use_landmarks=False)[1].request.bases
    assert color == ("color", Path("/w/c.png"))


def test_green_and_sharpness_are_those_of_all_images_that_read_them() -> None:
    """As of the command line: a map that looks like a normal map is turned with --green, labels are not mixed."""
    files = default_files(Path("/w/cow.obj"), Path("/w/spot.obj"), None)
    given = given_values(green="down", filter="nearest", material_colors=True)
    asked = FinishOptions(maps=(("normal", Path("/w/n.png")),), option_values=given)
    maps, colors = (command.request for command in finish_commands(OPTIONS, files, asked, use_landmarks=False)[1:3])
    assert (maps.green, maps.filter) == ("down", "nearest")
    assert (colors.green, colors.filter) == ("up", "nearest")


def test_links_that_lead_out_of_the_folders_are_neither_read_nor_written(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    for folder in (inside, outside, inside / "shapes"):
        folder.mkdir()
    for name in ("secret.obj", "secret.png"):
        (outside / name).write_text("secret")
    workspace = Workspace.of(inside)
    (inside / "link.obj").symlink_to(outside / "secret.obj")
    for path in ("../out/secret.obj", str(outside / "secret.obj"), "link.obj"):
        refuses(ParameterError, "outside", workspace.resolve, path)
    files = default_files(inside / "cow.obj", inside / "spot.obj", inside / "spot.png")

    def refused(asked: FinishOptions) -> None:
        refuses(ParameterError, "outside", plan_commands, OPTIONS, workspace, files, asked, use_landmarks=False)

    shapes = FinishOptions(option_values=given_values(blend_shapes=(Path("shapes"),)))
    plan_commands(OPTIONS, workspace, files, shapes, use_landmarks=False)
    (inside / "shapes" / "smile.obj").symlink_to(outside / "secret.obj")
    refused(shapes)
    (inside / "skin.1001.png").touch()
    (inside / "skin.1002.png").symlink_to(outside / "secret.png")
    refused(FinishOptions(option_values=given_values(normal_map=Path("skin.<UDIM>.png"))))
    refused(FinishOptions(option_values={("match", "target_mask"): "not:../out/secret.png"}))
    with pytest.raises(ParameterError, match="outside"):  # the open texture as well
        workspace.resolve_paths(default_files(files.target, files.source, inside / "skin.<UDIM>.png"))
    (inside / "cow_from_spot.1002.png").symlink_to(outside / "secret.png")
    refused(FinishOptions())
    with pytest.raises(ParameterError, match="Name"):
        plan_commands(OPTIONS, workspace, files, FinishOptions(name="../hero"), use_landmarks=False)


def test_tiles_are_listed_as_one_image_and_folders_where_they_may_be_chosen(tmp_path: Path) -> None:
    for name in ("skin.1001.png", "skin.1002.png", "single.1001.png", "photo_1024.png", "faces/smile.obj"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert Workspace.of(tmp_path).list_files((".png",)) == ("photo_1024.png", "single.1001.png", "skin.<UDIM>.png")
    assert Workspace.of(tmp_path).list_files((".obj", "/")) == ("faces", "faces/smile.obj")
    assert Workspace.of(tmp_path).resolve("faces/smile.obj") == (tmp_path / "faces/smile.obj").resolve()


def test_a_name_that_is_no_text_is_not_listed_and_refused_in_words_that_are(tmp_path: Path) -> None:
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.obj"))
    for path in (odd, tmp_path / "caf\u00e9.obj"):
        path.touch()
    workspace = Workspace.of(tmp_path)
    assert workspace.list_files((".obj",)) == ("caf\u00e9.obj",)
    refuses(ParameterError, "expected the name of a file", workspace.resolve, odd)
    (message,) = add_message((), "error", f"{odd}: not found")
    assert message.text.encode()


def test_a_message_says_where_on_the_page_its_remedy_is() -> None:
    text = explain_flags(OPTIONS, "x.png: exists. Give another name, or allow it with force (--force).")
    assert text.endswith("(On this page --force: Overwrite, under Files.)")
    assert explain_flags(OPTIONS, "too many landmarks") == "too many landmarks"


# The page welds by itself, and its landmarks always have the direction of the match.
NOT_ON_THE_PAGE = ("--weld", "--exchange-landmarks")


def test_messages_name_what_to_press_on_the_page_not_options_of_the_command_line() -> None:
    repairs = Repairs(pieces=2, pieces_share=0.1, pieces_vertices=16)
    (note,) = repairs.sentences()
    assert in_page_words(note).endswith("there. To open another piece, press Open… and choose it under Part")
    assert "--" not in in_page_words(use_option_names(note))
    with pytest.raises(ParameterError) as refused:
        require_map_names([("color", Path("a.png")), ("", Path("b.png"))])
    assert in_page_words(str(refused.value)).startswith("Bake, More images, Maps: expected one image")
    corners = np.array([(0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9)])
    (overlap,) = target_overlap_warnings(cube().with_uvs(corners, np.tile(np.arange(4), 6)))
    assert in_page_words(overlap).endswith("one by one with Open…, Part, or give it a layout without overlaps")
    halves = {"face_materials": np.zeros(6, dtype=np.int64), "material_names": ("skin",)}
    for colors, label in (
        ({"vertex_colors": np.ones((8, 3))}, "Bake, Detailed mesh, Bake, colors"),
        (halves | {"material_colors": np.ones((1, 3))}, "Bake, More images, Material colours"),
    ):
        assert in_page_words(colors_remedy(replace(cube(), **colors))).endswith(f": {label}.")
    for python, option in OPTION_NAMES.items():
        words = in_page_words(f"a ({python} x)")
        assert python not in words
        assert option not in words or option in NOT_ON_THE_PAGE, words


def test_downloads_are_the_outputs_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "RESULT").mkdir()
    (tmp_path / "RESULT" / "map.npz").write_bytes(b"map")
    (tmp_path / "RESULT" / "link").symlink_to("/etc/passwd")
    (tmp_path / "cow.png").write_bytes(b"png")
    (tmp_path / "secret.png").write_bytes(b"secret")
    outputs = (Output(tmp_path / "RESULT", "the map"), Output(tmp_path / "cow.png", "texture"))
    assert output_content(outputs, "cow.png") == (b"png", "image/png")
    for name in ("secret.png", "../cow.png", "RESULT", "RESULT/map.npz", "", "/etc/passwd", str(tmp_path / "cow.png")):
        assert output_content(outputs, name) is None
    packed, kind = output_content(outputs, ARCHIVE_NAME) or (b"", "")
    assert kind == "application/zip"
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        found = {name: archive.read(name) for name in archive.namelist()}
    assert found == {"RESULT/map.npz": b"map", "cow.png": b"png"}
    folder, kind = output_content(outputs, "RESULT.zip") or (b"", "")
    with zipfile.ZipFile(io.BytesIO(folder)) as archive:
        assert archive.namelist() == ["RESULT/map.npz"]
    assert output_content((), ARCHIVE_NAME) is None


@pytest.mark.parametrize("line", ["mtllib ../scans/body.mtl", "mtllib own.mtl\nmtllib ../scans/body.mtl"])
def test_a_mesh_in_the_zip_names_material_files_of_the_zip_only(tmp_path: Path, line: str) -> None:
    """The colours come along; images of other folders do not."""
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "body.mtl").write_text("newmtl skin\nKd 1 0.5 0\nmap_Kd ../../secret.png\n")
    studio = tmp_path / "studio"
    studio.mkdir()
    (studio / "own.mtl").write_text("newmtl hair\nKd 0 0 1\n")
    faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl skin\nf 1 2 3\n"
    (studio / "wrapped.obj").write_text(f"{line}\n{faces}")
    (studio / "named.obj").write_text(f"mtllib own.mtl\n{faces}")
    (studio / "bare.obj").write_text(faces)
    names = ("wrapped.obj", "named.obj", "bare.obj", "own.mtl")
    packed, _ = output_content([Output(studio / name, "wrap") for name in names], ARCHIVE_NAME) or (b"", "")
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        found = {name: archive.read(name).decode() for name in archive.namelist()}
    assert set(found) == {*names, "wrapped_materials.mtl"}
    assert found["wrapped.obj"] == f"mtllib wrapped_materials.mtl\n{faces}"
    assert "newmtl skin\nKd 1 0.5 0\n" in found["wrapped_materials.mtl"]
    assert "secret" not in found["wrapped_materials.mtl"]
    for name in names[1:]:
        assert found[name] == (studio / name).read_text()


def runner_of(on_job: Callable[[Any], object] = lambda _: None) -> tuple[Runner, list[Message], queue.Queue[Message]]:
    """A runner, what it says and the message with which it ends."""
    told, ended = list[Message](), queue.Queue[Message]()
    return Runner(on_job, lambda _: None, told.append, lambda message, _: ended.put(message)), told, ended


@pytest.mark.slow
def test_a_failing_command_gives_its_own_words_and_the_others_go_on(tmp_path: Path) -> None:
    files = default_files(tmp_path / "cow.obj", tmp_path / "spot.obj", None)
    runner, told, ended = runner_of()
    todo = finish_commands(OPTIONS, files, FinishOptions(), use_landmarks=True)
    runner.start(todo)
    assert ended.get(timeout=60).kind == "error"
    # Nothing can be done without a map.
    assert [message.text.partition(":")[0] for message in told] == ["match"]
    assert "cow.obj" in told[0].text
    told.clear()
    check = Command("check", ReportRequest(tmp_path / "none", tmp_path / "page.html"))
    runner.start((check, todo[1], check))
    assert ended.get(timeout=60).text.endswith(": check, report, check")
    assert [message.kind for message in told] == ["error"] * 3


def runs(tmp_path: Path) -> tuple[Command, ...]:
    return tuple(Command(title, ReportRequest(tmp_path, tmp_path / title)) for title in ("normals", "heights"))


@pytest.mark.slow
def test_a_command_that_takes_its_process_along_leaves_the_others_theirs(tmp_path, monkeypatch):
    monkeypatch.setattr("cagemap.studio.runner.serve", die)
    runner, told, ended = runner_of()
    runner.start(runs(tmp_path))
    assert ended.get(timeout=60).text.endswith(": normals, heights")
    assert [message.text for message in told] == [
        f"{title}: the computation's process ended (exit code 9)" for title in ("normals", "heights")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("serve", [leave, hang_up])
def test_a_process_that_ends_after_its_command_leaves_the_next_one_another(tmp_path, monkeypatch, serve):
    monkeypatch.setattr("cagemap.studio.runner.serve", serve)

    def wait(_: object) -> None:
        """Time to end between two commands."""
        process = runner._worker._process
        if process is not None:
            process.join(1 if serve is hang_up else 30)

    runner, _, ended = runner_of(wait)
    runner.start(runs(tmp_path))
    assert ended.get(timeout=60).text == "Bake: done"


def test_a_cancelled_run_says_so_whatever_begins_after_it(tmp_path: Path) -> None:
    def on_job(job: RunningJob | None) -> None:
        if job is None:  # the next one begins
            runner._cancelled = False

    runner, _, ended = runner_of(on_job)
    runner._cancelled = True
    runner._run_commands(())
    assert ended.get(timeout=10).text == "Bake: cancelled"


def test_what_a_command_wrote_in_folders_is_told_as_the_folder(tmp_path: Path) -> None:
    files = default_files(tmp_path / "cow.obj", tmp_path / "spot.obj", None)
    (match, *_) = finish_commands(OPTIONS, files, FinishOptions(), use_landmarks=False)
    inside = (files.result / "map.npz", files.result / "manifest.json", tmp_path / "a.png", tmp_path.parent / "b.png")
    assert [output.path.name for output in command_outputs(match, inside)] == [files.result.name, "a.png"]


def scene_of(shown: MatchResult) -> Scene:
    found = shown.point_map
    images = PreviewMap(found.triangle, found.barycentric, shown.quality.trust)
    shapes = refined_shape(shown.target.refinement), refined_shape(shown.source.refinement)
    return Scene(*shapes, (None, None), (b"", b""), images)


def test_the_map_of_a_finish_is_the_one_that_is_shown_or_it_is_said(tmp_path: Path) -> None:
    outputs = (Output(tmp_path / "RESULT", MAP_TITLE),)
    write_result(tmp_path / "RESULT", identity_result(level=3))
    scene = scene_of(identity_result(level=2))
    assert map_difference_notes(scene, outputs) == ()
    # Every other vertex of the cube leads across it.
    turned = replace(scene, preview_map=replace(scene.preview_map, triangle=np.roll(scene.preview_map.triangle, 4)))
    (said,) = map_difference_notes(turned, outputs)
    assert "Match again" in said
    assert map_difference_notes(None, outputs) == map_difference_notes(turned, ()) == ()
    assert map_difference_notes(turned, (Output(tmp_path / "gone", MAP_TITLE),)) == ()


def test_images_of_two_sources_have_names_of_their_own(tmp_path: Path) -> None:
    names = []
    for source, image in (("cow", "cow.png"), ("cow", "cow_color.png"), ("cow", "skin.png"), ("bull", "skin.png")):
        files = default_files(tmp_path / "deer.obj", tmp_path / f"{source}.obj", tmp_path / image)
        names.append(finish_commands(OPTIONS, files, FinishOptions(), use_landmarks=False)[1].output.name)
    assert names == [
        "deer_from_cow.png",
        "deer_from_cow_color.png",
        "deer_from_cow_skin.png",
        "deer_from_bull_skin.png",
    ]
