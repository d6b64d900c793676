"""The command line as a guest of a shell: signals, pipes, words on demand; and caches that know the code."""

import gc
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.cli import main
from cagemap.cli.console import escape_unprintable_output, say, set_verbosity, warn
from cagemap.errors import FormatError, explain_error
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.surface_store import surface_key
from cagemap.mesh.control_mesh import UvSet
from cagemap.spectral import BasisConfig
from cagemap.tasks.job_file import note_match
from cagemap.tasks.requests.match import MatchRequest

from example_result import identity_result
from refusals import refuses

COMMAND = [sys.executable, "-c", "from cagemap.cli import main; main()"]
MATCH = ["match", "--target", "deer.obj", "--source", "pony.obj", "--landmarks", "landmarks.json", "-o", "R"]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_cleanly(pair_files: Path, number: signal.Signals, code: int) -> None:
    before = sorted(path.name for path in pair_files.iterdir())
    words = [*COMMAND, "-v", *MATCH, "--vertices", "20000"]
    with subprocess.Popen(words, cwd=pair_files, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if line.startswith("cagemap: stage: prepare"):
                break
        process.send_signal(number)
        said = process.stderr.read()
    assert process.returncode == code, said
    assert "stopped" in said
    assert "Traceback" not in said
    assert sorted(path.name for path in pair_files.iterdir()) == before


def test_ctrl_c_while_commands_are_loaded_is_no_traceback(tmp_path: Path) -> None:
    late = "import sys, signal; from cagemap.cli import main\nclass Pressed:\n"
    late += "    def find_spec(self, name, *_):\n        if name == 'typer': signal.raise_signal(signal.SIGINT)\n"
    late += "sys.meta_path.insert(0, Pressed()); sys.argv = ['cagemap', 'check', 'a.obj']; main()"
    ended = subprocess.run([sys.executable, "-c", late], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr.startswith("cagemap: error: stopped")


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's malloc")
def test_memory_that_was_freed_is_used_again() -> None:
    script = (
        "import resource, numpy as np\n"
        "from cagemap.numerics.process import keep_memory\n"
        "keep_memory()\n"
        "def faults():\n"
        "    blocks = [np.ones(1_900_000) for _ in range(4)]\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "first, second = faults(), faults()\n"
        "print(second - first)\n"
    )
    environment = {**os.environ, "NUMPY_MADVISE_HUGEPAGE": "0"}  # which fault seldom
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment)
    assert int(said.stdout) < 1000  # of 14 800 pages


@pytest.mark.parametrize(("given", "expected"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_blas_starts_no_threads_in_a_command_unless_told(given: dict[str, str], expected: str) -> None:
    script = "import atexit, os\nfrom cagemap.cli import main\n"
    script += "atexit.register(lambda: print(os.environ['OPENBLAS_NUM_THREADS']))\nmain()"
    own = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    words = [sys.executable, "-c", script, "--version"]
    said = subprocess.run(words, capture_output=True, text=True, check=True, env=own | given)
    assert said.stdout.split()[-1] == expected


@pytest.mark.slow
def test_a_reader_that_has_gone_is_no_error(tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.obj", cube())
    with subprocess.Popen(
        [*COMMAND, "check", "box.obj"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


def test_an_output_that_is_closed_takes_all_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in `cagemap --version >&-`, where Python has no stream."""
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    escape_unprintable_output()
    say("nobody reads this")
    warn(["nor this"])


def test_more_and_fewer_words(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_result("R", identity_result())
    np.save("v.npy", np.arange(8.0))
    said = {}
    at_exit: list[Callable[[], object]] = []
    monkeypatch.setattr("atexit.register", at_exit.append)
    before = gc.get_threshold()
    for flag in ("-v", "-q", ""):
        words = ["transfer", "R", "--attribute", "v.npy", "-o", "out.npz"]
        monkeypatch.setattr(sys, "argv", ["cagemap", *([flag] if flag else []), *words])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 0
        said[flag] = capsys.readouterr()
    assert "cagemap: stage: read result" in said["-v"].err
    assert said["-q"] == ("", "")
    assert said[""].err == ""
    assert "wrote out.npz" in said[""].out
    set_verbosity(0, quiet=False)
    assert len(logging.getLogger("cagemap").handlers) == 1
    # A command, not the library, looks for cycles seldom: a third of a second of loading and leaving.
    assert gc.get_threshold()[0] >= 1_000_000
    gc.set_threshold(*before)
    frozen: list[bool] = []
    monkeypatch.setattr("gc.freeze", lambda: frozen.append(True))
    # OpenImageIO would call what is left then leaks.
    (leave,) = {done for done in at_exit if done.__module__ == "cagemap.numerics.process"}
    for modules in ({}, {"OpenImageIO": None}):
        monkeypatch.setattr("sys.modules", modules)
        leave()
    monkeypatch.undo()
    assert frozen == [True]


def test_a_warning_is_said_once_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    """Commands open some files several times."""
    for _ in range(2):
        set_verbosity(0, quiet=False)
        for words in ("one", "two", "one"):
            warn([words])
        assert capsys.readouterr().err.splitlines() == ["cagemap: warning: one", "cagemap: warning: two"]


@pytest.mark.slow
def test_names_that_are_no_text_are_written_as_escapes(tmp_path: Path) -> None:
    name = os.fsdecode(b"b\xffx.obj")
    write_mesh(tmp_path / name, cube())
    checked = subprocess.run([*COMMAND, "check", name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
    assert r"b\udcffx.obj" in checked.stdout


@pytest.mark.parametrize("suffix", [".png", ".exr", ".usda"])
def test_names_that_are_no_text_are_refused_where_a_library_needs_text(tmp_path: Path, suffix: str) -> None:
    odd = tmp_path / f"a\udc80{suffix}"
    odd.write_bytes(b"#usda 1.0\n")
    read = read_mesh if suffix == ".usda" else read_image
    pixels = np.zeros((4, 4, 3), np.float32 if suffix == ".exr" else np.uint8)
    write = partial(write_mesh, mesh=cube()) if suffix == ".usda" else partial(write_image, image=pixels)
    refuses(FormatError, "a name that is text", read, odd)
    for place in (tmp_path / f"b\udc80{suffix}", tmp_path / "c\udc80" / f"d{suffix}"):
        place.parent.mkdir(exist_ok=True)
        refuses(FormatError, "a name that is text", write, place)
        assert not place.exists()


def test_a_match_of_a_name_that_is_no_text_has_no_job_file(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "R").mkdir()
    note_match(MatchRequest(tmp_path / "a\udc80.obj", tmp_path / "b.obj", tmp_path / "R"))
    assert "no text" in caplog.text
    assert list((tmp_path / "R").iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
def test_outputs_on_a_full_disk_are_named_and_exit_with_2(tmp_path: Path) -> None:
    write_mesh(tmp_path / "b.obj", cube())
    with open("/dev/full", "w", encoding="utf-8") as full:
        words = [*COMMAND, "check", "b.obj"]
        told = subprocess.run(words, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        silent = subprocess.run([*COMMAND, "refine", "none.obj"], cwd=tmp_path, stderr=full, check=False)
        wrong = [*COMMAND, "refine", "none.obj", "-l", "1", "-o", "c.obj"]
        untold = subprocess.run(wrong, cwd=tmp_path, stdout=subprocess.PIPE, stderr=full, check=False)
    assert (told.returncode, silent.returncode, untold.returncode) == (2, 2, 2)
    assert told.stderr.startswith("cagemap: error: standard output: cannot be written (No space left on device)")


def test_an_error_of_no_file_says_what_it_may_be() -> None:
    assert explain_error(FileNotFoundError(2, "No such file or directory")).startswith("the current folder was removed")
    assert explain_error(OSError(28, "No space left on device", "a.png")).startswith("a.png: No space")
    assert "NUMBA_CACHE_DIR" in explain_error(OSError(28, "No space left on device"))


def test_a_result_with_a_name_that_is_no_text_is_written(tmp_path: Path) -> None:
    stage = "prepare a\udc80.obj"
    write_result(tmp_path / "R", replace(identity_result(), timings={stage: 1.0}))
    assert list(read_result(tmp_path / "R").timings) == [r"prepare a\udc80.obj"]


def test_a_cache_knows_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    before = surface_key(cube(), 2, config=BasisConfig(count=6))
    monkeypatch.setattr("cagemap.files.result.surface_store.code_version", lambda: "0.1.0+changed")
    assert surface_key(cube(), 2, config=BasisConfig(count=6)) != before


def test_arrays_of_read_values_are_read_only(tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.obj", cube())
    with pytest.raises(ValueError, match="read-only"):
        read_mesh(tmp_path / "box.obj").positions[0] = 0.0
    places = cube().positions[:, :2]
    further = UvSet("TEXCOORD_1", places, cube().face_indices)
    write_mesh(tmp_path / "box.glb", replace(cube().with_uvs(places, cube().face_indices), uv_sets=(further,)))
    (found,) = read_mesh(tmp_path / "box.glb").uv_sets
    assert not found.uvs.flags.writeable
    assert not found.uv_indices.flags.writeable
    write_result(tmp_path / "R", identity_result())
    result = read_result(tmp_path / "R")
    for array in (result.barycentric, result.trust, result.target.vertices, result.source.control.positions):
        assert not array.flags.writeable
