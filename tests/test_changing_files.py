"""Files that others change while they are read, or between one command and the next."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.cli import match, own_map
from cagemap.cli.map_request import MapRequest
from cagemap.cli.match_request import MatchRequest
from cagemap.cli.progress import Stages
from cagemap.files.manifest import input_file, read_manifest
from cagemap.files.meshes import write_mesh


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


def test_a_mesh_that_is_saved_anew_while_it_is_read_is_not_taken_for_the_one_that_was_read(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = place / "a.obj", place / "b.obj"
    np.save(place / "m.npy", np.arange(8))
    monkeypatch.setattr(own_map, "read_mesh", replacing(own_map.read_mesh, a))
    own_map.run_map(MapRequest(place / "m.npy", a, b, place / "R", level=1), Stages())
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
        match.run_match(MatchRequest(a, b, None, place / "M", level=1), Stages())
    assert stated["source"]["sha256"] == match.stated_inputs({"source": Path(before)}, place)["source"]["sha256"]
