"""Fixtures that every test may use."""

from __future__ import annotations

import atexit
import gc
import inspect
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from cagemap.example import ExamplePair
    from cagemap.studio.session import Session
    from cagemap.subdivision import Refinement

    from command_line import Run

# Before NumPy is loaded: test processes run side by side, and threads that wait for each other's cores spin.
for library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
gc.set_threshold(50_000)  # looking for cycles as often as usual takes a tenth of the processor time
# Tests and the processes that they start load the same modules again and again: 6 of 10 s of collection is compiling.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# No deadlines and no check for slow examples: times depend on what else the machine does.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_xdist_auto_num_workers() -> int:
    """One process more than cores: each waits a quarter of its time, for processes that it started."""
    return (os.cpu_count() or 1) + 1


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With ``-m slow`` or ``-m browser``, files without such tests are not imported."""
    marks = {"slow", "browser"} & set(config.option.markexpr.split(" and "))
    if not marks or not collection_path.match("test_*.py"):
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if all(f"mark.{mark}" in text for mark in marks) else True


def pytest_collection_finish() -> None:
    """No cycles are looked for among what all tests share, before the process ends."""
    gc.freeze()
    atexit.register(gc.unfreeze)  # OpenImageIO calls what is left at the end leaks


@pytest.fixture(scope="session", autouse=True)
def unflushed() -> Iterator[None]:
    """Files are not flushed to the disk: 5 ms each, for what only a power cut would lose."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda number: None)
        yield


@pytest.fixture
def small_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages of reports with pictures of a few pixels in rough light, where a test asks what they say."""
    from cagemap.report import write_report

    renderer = import_module("cagemap.pictures.render")  # not the function of that name
    for name, value in (("FLOOR_CELLS", 9), ("FLOOR_SKY_DIRECTIONS", 4), ("SKY_DIRECTIONS", 4)):
        monkeypatch.setattr(renderer, name, value)
    monkeypatch.setitem(inspect.unwrap(write_report).__kwdefaults__, "size", (24, 18))


@pytest.fixture
def one_start() -> Iterator[None]:
    """Matches from one start, where a test asks for something else than the best map: half the time."""
    from quick_match import from_one_start

    with from_one_start():
        yield


@pytest.fixture
def quick_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matches of the library, commands and previews fit quickly, for tests that do not ask how accurate a map is."""
    from quick_match import fit_quickly

    fit_quickly(monkeypatch)


@pytest.fixture
def jobs_in_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers of a job are threads of this process: processes would import everything again."""
    import distributed

    cluster = distributed.LocalCluster
    monkeypatch.setattr(distributed, "LocalCluster", lambda **options: cluster(**options | {"processes": False}))


@pytest.fixture(scope="module")
def fbx_server() -> Iterator[None]:
    """FBX files are converted by processes that have the library loaded: a tenth of the time."""
    from fbx_server import Server

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cagemap.files.fbx.read.subprocess", Server)
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real control meshes beside the checkout; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("real control meshes are not beside this checkout (../shared/data)")
    return SHARED


@dataclass
class Chromium:
    """The browser that runs, and how many tests had failed when it was started."""

    program: Any = None
    failed: int = -1
    begun: ExitStack = field(default_factory=ExitStack)

    def close(self) -> None:
        with suppress(Exception):  # it may be what has failed
            self.begun.close()


@pytest.fixture(scope="session")
def chromium_held() -> Iterator[Chromium]:
    """What `browser` gives out."""
    held = Chromium()
    yield held
    held.close()


@pytest.fixture
def browser(chromium_held: Chromium, request: pytest.FixtureRequest) -> Any:
    """One headless Chromium for all tests that ask for it; what a failure left of it, no other test meets."""
    from browser_page import chromium

    if chromium_held.failed != request.session.testsfailed:
        chromium_held.close()
        chromium_held.program = chromium_held.begun.enter_context(chromium())
        chromium_held.failed = request.session.testsfailed
    return chromium_held.program


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, small_pages: None) -> Run:
    """Runs commands in an empty folder; reports have small pictures."""
    from command_line import runner

    monkeypatch.chdir(tmp_path)
    return runner(monkeypatch, capsys)


@pytest.fixture(scope="session")
def built_in_pair() -> ExamplePair:
    """The deer, the pony and their landmarks."""
    from example_once import example_pair

    return example_pair(64)


@pytest.fixture(scope="session")
def _pair_files(built_in_pair: ExamplePair, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from cagemap.files.images.image import write_image
    from cagemap.files.landmarks.pairs import write_landmarks
    from cagemap.files.meshes.formats import write_mesh

    folder = tmp_path_factory.mktemp("pair")
    write_mesh(folder / "deer.obj", built_in_pair.target)
    write_mesh(folder / "pony.obj", built_in_pair.source)
    write_image(folder / "pony.png", built_in_pair.texture)
    write_landmarks(folder / "landmarks.json", built_in_pair.landmarks)
    return folder


@pytest.fixture
def pair_files(_pair_files: Path, tmp_path: Path) -> Path:
    """The built-in pair as deer.obj, pony.obj, pony.png and landmarks.json in an empty folder."""
    return shutil.copytree(_pair_files, tmp_path, dirs_exist_ok=True)


@pytest.fixture
def result_folder(tmp_path: Path) -> Path:
    """A cube twice as large as its source, and an image over its layout."""
    import numpy as np

    from cagemap.files.images.image import write_image
    from cagemap.files.result.folder import write_result

    from example_result import identity_result

    write_result(tmp_path / "R", identity_result())
    gradient = np.linspace(40, 215, 64 * 96 * 3).reshape(3, 64, 96).astype(np.uint8)
    write_image(tmp_path / "t.png", np.moveaxis(gradient, 0, 2))
    return tmp_path / "R"


@pytest.fixture(scope="module")
def creature_at_3() -> tuple[Refinement, float]:
    """The creature's refinement to level 3, and what brings it to unit area."""
    from examples.shapes import creature

    from elastic_shapes import unit_refinement

    return unit_refinement(creature(), 3)


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two models for the studio."""
    from studio_boxes import write_boxes

    folder = tmp_path_factory.mktemp("boxes")
    write_boxes(folder)
    return folder


@pytest.fixture(scope="session")
def forked_processes() -> Iterator[None]:
    """Processes of the studio are forks of one that has loaded what they need."""
    from forked import forking

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cagemap.studio.worker.multiprocessing", SimpleNamespace(get_context=lambda method: forking()))
        yield


@pytest.fixture(scope="module")
def session(boxes: Path, forked_processes: None) -> Iterator[Session]:
    """The studio over the boxes."""
    from studio_boxes import session_of

    session = session_of(boxes)
    yield session
    session.close()


@pytest.fixture
def opened(session: Session, boxes: Path) -> Session:
    """The boxes without a landmark, mapped."""
    from studio_boxes import open_boxes

    open_boxes(session, boxes)
    return session
