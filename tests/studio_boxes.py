"""A studio's session over two boxes, with its worker's process but without a browser."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from examples.shapes import cube

from cagemap.cli.option_list import all_options
from cagemap.files.images import write_image
from cagemap.files.meshes import write_mesh
from cagemap.studio.autosave import autosave_path
from cagemap.studio.opening import default_files
from cagemap.studio.session import Session
from cagemap.studio.shape import pick
from cagemap.studio.state import View
from cagemap.studio.worker import Worker
from cagemap.studio.workspace import Workspace

# The computation stands back for everything else, so that a busy machine takes long over a first map.
PATIENCE = 150.0


def until(done: Callable[[], object], session: Session) -> None:
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end, [message.text for message in session.state.messages]
        time.sleep(0.01)


def write_boxes(folder: Path) -> None:
    """Two slanted boxes and an image."""
    mesh = cube()
    # Sides of three lengths, and slanted: no turn takes the box onto itself.
    corners = mesh.positions * [1.0, 1.3, 1.7]
    corners[:, 0] += 0.4 * corners[:, 1] * (corners[:, 2] > 0)
    write_mesh(folder / "a.obj", mesh.with_positions(corners))
    write_mesh(folder / "b.obj", mesh.with_positions(corners + np.array([4.0, 0.0, 0.0])))
    write_image(folder / "b.png", np.full((8, 8, 3), 200, dtype=np.uint8))


def session_of(folder: Path) -> Session:
    return Session(Workspace.of(folder), 300, all_options())


def open_boxes(session: Session, folder: Path) -> None:
    """Open them without a landmark, as if nothing had been done before."""
    files = default_files(folder, folder / "a.obj", folder / "b.obj", folder / "b.png")
    for path in folder.glob("*.json*"):
        path.unlink()
    autosave_path(files.landmarks).unlink(missing_ok=True)
    with session._lock:  # what an earlier test has left
        again = session.state.files == files and session.scene is not None
        session._change(messages=(), outputs=(), view=View(), finish_job=None)
    if again:
        # The match without landmarks, which is most of an opening, is there already.
        (folder / "none.json").write_text(json.dumps({"pairs": []}))
        session.load(Path("none.json"))
        autosave_path(files.landmarks).unlink(missing_ok=True)
    else:
        session.open(files)
    until(lambda: session.state.map.revision >= 1 and not session.state.map.strain, session)
    until(lambda: at_rest(session), session)


def at_rest(session: Session) -> bool:
    """Whether the computing thread waits for a wish: it does so once it has handed its last answer over."""
    return bool(session._preview._wake._waiters)  # type: ignore[attr-defined]


def click(session: Session, side: str, vertex: int) -> None:
    """A click along the ray through a corner's point, from outside."""
    scene = session.scene
    assert scene is not None
    point = scene.shape(side).to_view(scene.shape(side).positions[vertex])
    session.click(side, 3 * point, -point / np.linalg.norm(point))


def click_between(session: Session, side: str) -> np.ndarray:
    """A click on the middle of a face; the place clicked, in file units."""
    shape = session.scene.shape(side)
    middle = shape.positions[shape.control.face_indices[:4]].mean(axis=0)
    ray = shape.to_view(middle) / np.linalg.norm(shape.to_view(middle))
    hit = pick(shape, 3 * ray, -ray)
    assert hit is not None
    session.click(side, 3 * ray, -ray)
    return hit.position


class Idle(Worker):
    """Does nothing, at once."""

    def start(self) -> None:
        pass

    def run(self, task: object) -> None:
        pass
