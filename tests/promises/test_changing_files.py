"""Files that others change while they are read, or between one command and the next."""

import shutil
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result import manifest as notes
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import input_file, note_transfer, read_manifest
from cagemap.tasks import import_map, match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.match import MatchRequest

from example_result import identity_result


class StoppedError(Exception):
    """Ends a command where a test has seen enough."""


def replacing(honest: Callable[..., Any], file: Path) -> Callable[..., Any]:
    """What reads, and a program that saves the file anew just after."""

    def read(*given: Any) -> Any:
        found = honest(*given)
        file.write_text(file.read_text() + "# saved anew\n")
        return found

    return read


@pytest.fixture
def place(tmp_path: Path) -> Path:
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, cube())
    return tmp_path


def test_a_mesh_that_is_saved_anew_while_it_is_read_is_not_taken_for_the_one_that_was_read(place, monkeypatch):
    a, b = place / "a.obj", place / "b.obj"
    np.save(place / "m.npy", np.arange(8))
    monkeypatch.setattr(import_map, "read_mesh", replacing(import_map.read_mesh, a))
    import_map.run_map(MapRequest(place / "m.npy", a, b, place / "R", level=1), Stages())
    manifest = read_manifest(place / "R")
    assert input_file(place / "R", manifest, "target") is None
    assert input_file(place / "R", manifest, "source") == place / "R" / "../b.obj"

    def stop(_: object, settings: match.MatchSettings, __: object) -> None:
        stated.update(settings.entries["inputs"])
        raise StoppedError

    stated: dict[str, Any] = {}
    before = shutil.copy(b, place / "before.obj")
    monkeypatch.setattr(match, "read_inputs", replacing(match.read_inputs, b))
    monkeypatch.setattr(match, "match_inputs", stop)
    with pytest.raises(StoppedError):
        match.run_match(MatchRequest(a, b, place / "M", level=1), Stages())
    assert stated["source"]["sha256"] == match.stated_inputs({"source": Path(before)}, place)["source"]["sha256"]


@pytest.mark.parametrize(
    ("name", "text", "other"),
    [
        ("m.usda", "#usda 1.0\n(\n    subLayers = [@./other.usda@]\n)\n", "other.usda"),
        ("m.gltf", '{"buffers": [{"uri": "other.bin"}]}', "other.bin"),
    ],
)
def test_a_mesh_in_several_files_has_changed_with_each_of_them(tmp_path, name, text, other):
    """Its vertices have other numbers then. A result of an older version states the hash of the file alone."""
    if name == "m.usda":
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    (tmp_path / name).write_text(text)
    (tmp_path / other).write_text("#usda 1.0\n")
    manifest = {"inputs": notes.stated_inputs({"target": tmp_path / name}, tmp_path)}
    old = {"inputs": {"target": {**manifest["inputs"]["target"], "sha256": notes.file_hash(tmp_path / name)}}}
    assert input_file(tmp_path, manifest, "target") == input_file(tmp_path, old, "target") == tmp_path / name
    (tmp_path / other).write_text("#usda 1.0\n# changed\n")
    assert input_file(tmp_path, manifest, "target") is None


def test_transfers_that_end_at_once_are_both_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fcntl", reason="no locks of folders on this system")
    write_result(tmp_path / "R", identity_result(1))
    both = threading.Barrier(2)

    def read(root: Path) -> dict[str, Any]:
        found = read_manifest(root)
        with suppress(threading.BrokenBarrierError):
            both.wait(0.3)
        return found

    monkeypatch.setattr(notes, "read_manifest", read)
    runs = [
        threading.Thread(target=note_transfer, args=(tmp_path / "R", {"kind": "texture", "output": name}))
        for name in ("a.png", "b.png")
    ]
    for run in runs:
        run.start()
    for run in runs:
        run.join()
    assert {entry["output"] for entry in read_manifest(tmp_path / "R")["transfers"]} == {"a.png", "b.png"}
