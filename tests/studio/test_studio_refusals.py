"""What the studio cannot open: every message names the file or control, what is wrong, and what to do."""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh.parts import join_meshes
from cagemap.studio.autosave import read_autosave, write_autosave
from cagemap.studio.landmarks import Landmark, LandmarkList, Place
from cagemap.studio.models import open_model
from cagemap.studio.page.server import Server

from refusals import Refusal
from studio_boxes import session_of, write_boxes


def autosave(edit: Callable[[dict[str, Any]], object]) -> Callable[[Path], object]:
    """Reads an autosave of one landmark after an edit of its entries."""

    def read(place: Path) -> object:
        corner = Place((0.0, 0.0, 0.0), (0, 1, 2), (0.25, 0.25, 0.5))
        write_autosave(place / "a.json", LandmarkList((Landmark(1, "nose", corner, corner),)))
        entries = json.loads((place / "a.json").read_text())
        edit(entries)
        (place / "a.json").write_text(json.dumps(entries))
        return read_autosave(place / "a.json", (8, 8))

    return read


def spoilt(why: str, edit: Callable[[dict[str, Any]], object]) -> Refusal:
    expected = "a.json: expected an autosave of the studio for these models"
    return Refusal(autosave(edit), expected, f"found something else ({why}", "It was moved to a.json.1.")


def several_pieces(place: Path) -> object:
    """One object of two boxes."""
    boxes = join_meshes([cube(), cube().with_positions(cube().positions + 9.0)])
    mesh = replace(boxes, face_objects=np.repeat([0, 1], [12, 0]), object_names=("both", "none"))
    write_mesh(place / "m.obj", join_meshes([mesh, cube().with_positions(cube().positions - 9.0)]))
    return open_model(place / "m.obj", None, None, 300, "object:both")


REFUSED = {
    "an autosave of another form": spoilt("KeyError('format')", lambda entries: entries.update(format="x")),
    "an autosave of a larger model": spoilt(
        "ValueError('landmarks of a model that has more than 8 vertices",
        lambda entries: entries.update(pairs=[{"name": "chin", "source": 0, "target": 99}]),
    ),
    "an autosave of a place that is nowhere": spoilt(
        "ValueError('a place at 0.0", lambda entries: entries["items"][0]["target"].update(weights=[1, 1, 1])
    ),
    "an object of two pieces": Refusal(
        several_pieces,
        "m.obj: expected a part of one connected piece ... got 2: ",
        "Press Open… and choose one of these under Part.",
    ),
    "an address of another machine": Refusal(
        lambda place: Server("203.0.113.1", 0, None, *[lambda *given: None] * 4),
        "--host 203.0.113.1:  ... cannot serve there ( ... Name an address of this machine.",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_opened_is_refused(name: str, tmp_path: Path) -> None:
    REFUSED[name].check(tmp_path)


def test_without_models_there_is_no_next_landmark(tmp_path: Path) -> None:
    write_boxes(tmp_path)
    with closing(session_of(tmp_path)) as session:
        session.next_landmark()
        (message,) = session.state.messages
    assert message.text.endswith("expected two open models, there are none yet. Choose a target and a source.")
