"""The finish: the commands that it runs, and what it gives to download."""

from __future__ import annotations

import io
import queue
import zipfile
from pathlib import Path

import typer
from hypothesis import given
from hypothesis import strategies as st

from cagemap.cli import app
from cagemap.studio.downloads import ALL, content
from cagemap.studio.finish import FinishOptions, WrapOptions, commands
from cagemap.studio.opening import default_files
from cagemap.studio.runner import Runner, stage_of
from cagemap.studio.state import Output
from test_obj import QUICK


def test_a_finish_is_the_commands_that_one_would_type(tmp_path: Path) -> None:
    files = default_files(tmp_path, tmp_path / "cow.obj", tmp_path / "spot.obj", tmp_path / "spot.png")
    todo = commands(files, FinishOptions(vertices=5000, size=256, unwrap=True), landmarks=True)
    assert [command.title for command in todo] == ["match", "texture", "report"]
    assert "--landmarks" in todo[0].arguments
    assert "--landmarks" not in commands(files, FinishOptions(), landmarks=False)[0].arguments
    assert str(todo[1]).startswith(
        f"cagemap transfer {files.result} --texture {tmp_path / 'spot.png'} --size 256 --unwrap"
    )


OPTIONS = st.builds(
    FinishOptions,
    vertices=st.integers(1000, 10**6),
    size=st.none() | st.just(512),
    bits=st.none() | st.sampled_from([8, 16, 32]),
    texture=st.booleans(),
    as_color=st.booleans(),
    displacement=st.none() | st.just(Path("height.exr")),
    scale=st.floats(-2, 2),
    midlevel=st.none() | st.floats(-1, 1),
    normal_map=st.none() | st.just(Path("normals.png")),
    vector_displacement=st.none() | st.just(Path("vectors.exr")),
    space=st.sampled_from(["tangent", "object"]),
    green=st.sampled_from(["up", "down"]),
    attribute=st.none() | st.just(Path("age.csv")),
    material_colors=st.booleans(),
    source_uvs=st.booleans(),
    weights=st.none() | st.just(Path("weights.npz")),
    influences=st.integers(0, 8),
    joints=st.none() | st.just(Path("joints.json")),
    blend_shapes=st.none() | st.just(Path("smile.obj")),
    write_map=st.sampled_from(["", ".npy", ".mhclo"]),
    wrap=st.none() | st.builds(WrapOptions, st.integers(0, 3), st.floats(0, 1), st.just(1e-4), st.booleans()),
    unwrap=st.booleans(),
    report=st.booleans(),
)


@QUICK
@given(options=OPTIONS)
def test_the_command_line_understands_every_finish(options: FinishOptions) -> None:
    files = default_files(Path("/w"), Path("/w/cow.obj"), Path("/w/spot.obj"), Path("/w/spot.png"))
    todo = commands(files, options, landmarks=True)
    known = typer.main.get_command(app).commands
    for command in todo:
        name, *words = command.arguments
        known[name].make_context(name, words)  # raises where an option is unknown or a value is none
    written = [output.path for command in todo for output in command.outputs]
    # No two commands write the same file, and none writes what another reads.
    assert len(set(written)) == len(written)
    assert not set(written) & {files.target, files.source, files.texture, *options.paths}
    # Every option that is asked for is in some command.
    words = {word for command in todo for word in command.arguments}
    assert {str(path) for path in options.paths} <= words


def test_downloads_are_the_outputs_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "RESULT").mkdir()
    (tmp_path / "RESULT" / "map.npz").write_bytes(b"map")
    (tmp_path / "RESULT" / "link").symlink_to("/etc/passwd")
    (tmp_path / "cow.png").write_bytes(b"png")
    (tmp_path / "secret.png").write_bytes(b"secret")
    outputs = (Output(tmp_path / "RESULT", "the map"), Output(tmp_path / "cow.png", "texture"))
    assert content(outputs, "cow.png") == (b"png", "image/png")
    for name in ("secret.png", "../cow.png", "RESULT", "RESULT/map.npz", "", "/etc/passwd", str(tmp_path / "cow.png")):
        assert content(outputs, name) is None
    packed, kind = content(outputs, ALL) or (b"", "")
    assert kind == "application/zip"
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == {
            "RESULT/map.npz": b"map",
            "cow.png": b"png",
        }
    assert content((), ALL) is None


def test_a_failing_command_gives_its_own_words(tmp_path: Path) -> None:
    files = default_files(tmp_path, tmp_path / "cow.obj", tmp_path / "spot.obj", None)
    ended: queue.Queue[str | None] = queue.Queue()
    Runner(lambda _: None, lambda _: None, ended.put).start(commands(files, FinishOptions(), landmarks=True))
    words = ended.get(timeout=60)
    assert words is not None
    assert words.startswith("match:")
    assert "error" in words


def test_stages_are_read_from_verbose_commands() -> None:
    assert stage_of("cagemap: stage: functional map\n") == "functional map"
    assert stage_of("wrote stage: nothing") is None
