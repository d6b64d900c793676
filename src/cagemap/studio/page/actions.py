"""What a page may ask for: messages by name, each to one method of the session."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.studio.landmarks import SIDES, Side
from cagemap.studio.opening import default_files
from cagemap.studio.page.form import finish_options
from cagemap.studio.session import Session
from cagemap.studio.workspace import IMAGES, MESHES

_FILES = ("target", "source", "texture")
Sent = Mapping[str, Any]


class Actions:
    """Does what pages ask for; anything wrong becomes a message of the page."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._done: dict[str, Callable[[Sent], object]] = {
            "list": lambda _: None,  # answered by the server
            "open": self._open,
            "part": lambda sent: session.choose_part(_side(sent), sent["part"]),
            "as_it_is": lambda sent: session.take_as_it_is(_side(sent)),
            "click": lambda sent: session.click(_side(sent), *_ray(sent)),
            "probe": lambda sent: session.probe(_side(sent), *_ray(sent)),
            "move": lambda sent: session.move(int(sent["number"]), _side(sent), *_ray(sent)),
            "accept": lambda _: session.accept(),
            "next": lambda _: session.next_landmark(),
            "select": lambda sent: session.select(None if sent["number"] is None else int(sent["number"])),
            "remove": lambda sent: session.remove(int(sent["number"])),
            "rename": lambda sent: session.rename(int(sent["number"]), str(sent["name"])),
            "mirror": lambda sent: session.mirror(int(sent["number"])),
            "undo": lambda _: session.undo(),
            "redo": lambda _: session.redo(),
            "save": lambda sent: session.save(str(sent["name"])),
            "load": lambda sent: session.load(Path(sent["pairs"]), Path(sent["points"]) if sent["points"] else None),
            "view": lambda sent: session.show_as(**_view(sent["fields"])),
            "baked": self._baked,
            "again": lambda _: session.match_again(),
            "answer": lambda sent: session.choose_answer(int(sent["index"])),
            "cancel": lambda _: session.cancel(),
            "bake": lambda sent: session.finish(
                finish_options(session.options, sent["options"], session.workspace.require)
            ),
        }

    def do(self, message: str | bytes) -> None:
        """Do what one message asks for."""
        with self._session.guarded():
            try:
                if isinstance(message, bytes):
                    self._add(message)
                    return
                sent = json.loads(message)
                self._done[sent["do"]](sent)
            except (KeyError, TypeError, ValueError, IndexError) as error:
                raise ParameterError(f"the page sent {error!r}, which is not understood. Load it again.") from None

    def _open(self, sent: Sent) -> None:
        given = {name: self._session.workspace.require(sent[name]) for name in _FILES if sent.get(name)}
        if not {"target", "source"} <= set(given):
            raise ParameterError("expected a target and a source, got one of them or none. Choose both.")
        (to, of), (to_up, of_up) = ((word or None for word in sent[name]) for name in ("schemes", "ups"))
        files = default_files(
            self._session.workspace.folders[0], given["target"], given["source"], given.get("texture"), (to, of)
        )
        self._session.open(replace(files, ups=(to_up, of_up)))

    def _add(self, message: bytes) -> None:
        """Put a file into the workspace; with a role it is opened in place of the model or image that was."""
        head, content = message.split(b"\n", 1)
        sent = json.loads(head)
        added = self._session.add_file(str(sent["name"]), content)
        files, role = self._session.state.files, sent.get("role")
        if added is None or role is None:
            return
        if added.suffix.lower() in IMAGES:
            role = "texture"
        elif added.suffix.lower() not in MESHES:
            self._session.load(added)
            return
        known = {} if files is None else {name: getattr(files, name) for name in _FILES}
        chosen = known | ({"texture": None} if role == "source" else {}) | {str(role): added}
        if None in (chosen.get("target"), chosen.get("source")):
            return
        paths = (chosen["target"], chosen["source"], chosen.get("texture"))
        self._session.open(default_files(self._session.workspace.folders[0], *paths))

    def _baked(self, sent: Sent) -> None:
        images = self._session.state.images
        self._session.look_at(next((path for path in images if path.name == sent["name"]), None))


def _side(sent: Sent) -> Side:
    return {str(side): side for side in SIDES}[sent["side"]]


def _ray(sent: Sent) -> tuple[FloatArray, FloatArray]:
    origin, direction = (np.array([float(value) for value in sent[name]]) for name in ("origin", "direction"))
    if origin.shape != (3,) or direction.shape != (3,) or not all(map(math.isfinite, (*origin, *direction))):
        raise ValueError("a ray")
    return origin, direction


def _view(fields: Sent) -> dict[str, Any]:
    return {name: str(value) if name in ("mode", "pose") else bool(value) for name, value in fields.items()}
