"""The process of a finish and its files: the job file makes them again, nothing is left half written."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import psutil
import pytest
from examples.shapes import creature
from typed_request import run_typed

from cagemap.errors import ParameterError
from cagemap.files.atomic import write_whole
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.studio import finish_process
from cagemap.studio.finish import Command, FinishOptions, finish_commands
from cagemap.studio.finish_layout import SIZE_KEY, VERTICES_KEY
from cagemap.studio.finish_process import RequestResult, run_command, serve
from cagemap.studio.opening import built_in_files
from cagemap.studio.state import Files
from cagemap.studio.worker import STOPPED_KIND, Failure, Worker
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import Key, Value, all_options
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.run import RunRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.run_job import run_job

from studio_boxes import until


def two_creatures(folder: Path) -> tuple[Path, Path]:
    """Files of two shapes, whose match takes a while."""
    mesh = creature()
    write_mesh(folder / "a.obj", mesh)
    write_mesh(folder / "b.obj", mesh.with_positions(mesh.positions * np.array([1.0, 1.1, 1.3])))
    return folder / "a.obj", folder / "b.obj"


@pytest.mark.slow
def test_every_request_says_how_it_ended_and_what_it_wrote(tmp_path: Path) -> None:
    target, _ = two_creatures(tmp_path)
    result = tmp_path / "ä R"
    stages: list[str] = []
    worker = Worker(stages.append, serve)
    made = [
        worker.run(Command("match", MatchRequest(target, target, result, vertices=300))),
        worker.run(Command("UVs", TransferRequest(tmp_path / "none", tmp_path / "uvs.obj", source_uvs=True))),
        worker.run(Command("map", TransferRequest(result, tmp_path / "map.npz", write_map=True))),
    ]
    worker.end()
    assert all(isinstance(one, RequestResult) for one in made)
    assert {result / name for name in ("manifest.json", "map.npz")} <= {*made[0].files}
    assert made[2].files[0] == tmp_path / "map.npz"
    assert [bool(one.failure) for one in made] == [False, True, False]
    assert "none" in made[1].failure
    assert made[1].files == ()
    assert stages


def test_warnings_are_said_once_and_what_was_written_before_an_error_is_told(tmp_path, monkeypatch):
    def work(request: TransferRequest, stages: Stages) -> None:
        for _ in range(2):
            logging.getLogger("cagemap.files").warning("%s has no UVs: `unwrap`", "a.obj")
        write_whole(tmp_path / "a.txt", "a")
        raise ParameterError("exists (`force=True`)")

    monkeypatch.setattr("cagemap.studio.finish_process.runner_of", lambda request: work)
    made = run_command(Command("", TransferRequest(tmp_path, tmp_path / "b.png")), Stages())
    assert made.warnings == ("a.obj has no UVs: --unwrap",)
    assert made.files == (tmp_path / "a.txt",)
    assert made.failure == "exists (--force)"
    assert not any(type(one).__name__ == "_Warnings" for one in logging.getLogger("cagemap").handlers)


@pytest.mark.slow
def test_a_request_that_is_stopped_leaves_nothing_half_written(tmp_path: Path) -> None:
    target, source = two_creatures(tmp_path)
    before = sorted(os.listdir(tmp_path))
    stages: list[str] = []
    worker = Worker(lambda stage: (stages.append(stage), worker.end() if len(stages) == 2 else None), serve)
    stopped = worker.run(Command("match", MatchRequest(target, source, tmp_path / "R", vertices=30_000)))
    assert isinstance(stopped, Failure)
    assert stopped.kind == STOPPED_KIND
    assert "exit code 0" in stopped.message  # by itself, not by force once patience is over
    assert sorted(os.listdir(tmp_path)) == before
    made = worker.run(
        Command("match", MatchRequest(target, target, tmp_path / "R", vertices=300))
    )  # by another process
    assert made.failure == ""
    worker.end()


def test_a_request_ends_with_whoever_runs_it_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    two_creatures(tmp_path)
    script = tmp_path / "runs.py"
    script.write_text(
        "from pathlib import Path\n"
        "from cagemap.studio.finish import Command\n"
        "from cagemap.studio.finish_process import serve\n"
        "from cagemap.studio.worker import Worker\n"
        "from cagemap.tasks.requests.match import MatchRequest\n"
        "if __name__ == '__main__':\n"
        "    worker = Worker(lambda stage: print(stage, flush=True), serve)\n"
        "    request = MatchRequest(Path('a.obj'), Path('b.obj'), None, Path('R'), vertices=200_000)\n"
        "    worker.run(Command('match', request))\n"
    )
    before = sorted(os.listdir(tmp_path))
    with subprocess.Popen([sys.executable, script], cwd=tmp_path, stdout=subprocess.PIPE, text=True) as runs:
        assert runs.stdout.readline()
        children = psutil.Process(runs.pid).children(recursive=True)
        assert children
        runs.kill()
        _, alive = psutil.wait_procs(children, timeout=15)
    assert alive == []
    assert sorted(os.listdir(tmp_path)) == before


def wait_for_threads(connection: Connection) -> None:
    """Serve, but every request waits for ever."""

    def wait(request: object, stages: Stages) -> None:
        stages("waits")
        threading.Event().wait()

    finish_process.runner_of = lambda request: wait  # type: ignore[assignment]
    serve(connection)


@pytest.mark.slow
def test_a_request_that_waits_for_its_threads_ends_too(tmp_path: Path) -> None:
    worker = Worker(lambda _: worker.end(), wait_for_threads)
    stopped = worker.run(Command("", TransferRequest(tmp_path, tmp_path / "a.png")))
    assert isinstance(stopped, Failure)
    assert "exit code 0" in stopped.message


@pytest.mark.slow
def test_a_second_signal_does_not_interrupt_what_the_first_one_removes(tmp_path: Path) -> None:
    worker = Worker(lambda _: None, remove_slowly)
    worker.start()
    process = worker._process
    ended = threading.Thread(target=worker.run, args=(Command("", TransferRequest(tmp_path, tmp_path / "a.png")),))
    ended.start()
    for number in (signal.SIGINT, signal.SIGTERM):  # as Ctrl-C in a terminal, and then the studio's end
        until(lambda number=number: (tmp_path / signal.Signals(number).name).exists())
        os.kill(process.pid, number)
    ended.join(15)
    assert (tmp_path / "removed").exists()


def remove_slowly(connection: Connection) -> None:
    """Serve, but a request waits for a signal, and takes a while to remove its files."""

    def wait(request: TransferRequest, stages: Stages) -> None:
        try:
            (request.result / "SIGINT").touch()  # within: the signal may come at once
            threading.Event().wait()
        finally:
            (request.result / "SIGTERM").touch()
            time.sleep(0.5)
            (request.result / "removed").touch()

    finish_process.runner_of = lambda request: wait  # type: ignore[assignment]
    serve(connection)


TRANSFER: dict[str, Value] = {
    "normal_map": Path("normals.png"),
    "green": "down",
    "displacement": Path("bumps.png"),
    "scale": 0.01,
    "bits": "16",
    "filter": "linear",
    "bake": ("normal", "ao"),
    "detail": Path("pony.obj"),
    "rays": 8,
    "weights": Path("skin.csv"),
    "influences": 1,
    "attribute": Path("age.npy"),
    "blend_shapes": (Path("faces"),),
    "source_uvs": True,
}
WRAP: dict[str, Value] = {"fairness": 1e-3, "normal_map": True, "displacement": True, "mhclo": True}


def write_inputs(files: Files) -> None:
    """What a rich finish reads, beside the built-in pair."""
    folder, source = files.source.parent, read_mesh(files.source)
    turn = np.linspace(0.0, 1.0, source.n_vertices)
    np.savetxt(folder / "skin.csv", np.column_stack([turn, 1 - turn]), delimiter=",", header="a,b", comments="")
    np.save(folder / "age.npy", turn)
    (folder / "faces").mkdir()
    write_mesh(folder / "faces" / "tall.obj", source.with_positions(source.positions * [1.0, 1.2, 1.0]))
    write_image(folder / "bumps.png", np.random.default_rng(0).integers(0, 256, (32, 32), dtype=np.uint8))
    write_image(folder / "normals.png", np.full((32, 32, 3), (128, 128, 255), dtype=np.uint8))


def rich_finish(files: Files, size: int, vertices: int) -> FinishOptions:
    """A finish that asks for something of every kind, of the built-in pair."""
    folder = files.source.parent
    given: dict[Key, Value] = {VERTICES_KEY: vertices, SIZE_KEY: size, ("match", "trust_landmarks"): True}
    given |= {("transfer", name): value for name, value in TRANSFER.items()}
    given |= {("wrap", name): value for name, value in WRAP.items()}
    asked = FinishOptions(maps=(("roughness", Path("bumps.png")),), map_form=".npz", wrap=True, option_values=given)
    return asked.resolve_paths(all_options(), lambda path: folder / path)


def compared(folder: Path) -> list[Path]:
    """Files of a finish that hold no place or time."""
    kinds = (".png", ".exr", ".npz", ".npy", ".csv", ".obj", ".mhclo")
    inside = [path for path in folder.rglob("*") if path.suffix in kinds and "again" not in path.parts]
    return [path for path in inside if path.parent.name != "faces"]


def same(one: Path, other: Path) -> bool:
    """Whether two files are bit for bit alike; an EXR holds the time at which it was written beside its pixels."""
    if one.suffix == ".exr":
        return bool(np.array_equal(read_image(one).pixels, read_image(other).pixels))
    return one.read_bytes() == other.read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("jobs_in_threads", "small_pages", "quick_fit")
def test_the_job_file_of_a_finish_makes_the_same_files_again(tmp_path: Path) -> None:
    files = built_in_files(tmp_path)
    write_inputs(files)
    before = compared(tmp_path)
    for command in finish_commands(all_options(), files, rich_finish(files, size=32, vertices=300), use_landmarks=True):
        run_typed(command.request)
    made = [path for path in compared(tmp_path) if path not in before]
    text, whole = run_job(RunRequest(files.result / "job.toml", workers=1), Stages())
    assert whole, text
    again = {path.name: path for path in (files.result / "again").rglob("*") if path.is_file()}
    assert len(made) > 15
    assert [path.name for path in made if not same(path, again[path.name])] == []
