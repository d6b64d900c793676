"""Messages of a page, by name, each for one method of the session."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import CagemapError, ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.meshes.formats import MESH_SUFFIXES
from cagemap.numerics.arrays import FloatArray
from cagemap.studio.landmarks import SIDES, Side, SideNames
from cagemap.studio.opening import default_files
from cagemap.studio.page.form import read_form
from cagemap.studio.session import Session
from cagemap.studio.state import Files
from cagemap.studio.workspace import LANDMARK_SUFFIXES

_FILES = ("target", "source", "texture")
# A message that pages send on their own.
_UNASKED = "list"
Entries = Mapping[str, Any]


class Actions:
    """Handles messages of pages; errors are shown on the page."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._dropped: dict[str, Path | None] = {}  # files dropped before there is a model for each side
        self._handlers: dict[str, Callable[[Entries], object]] = {
            "list": lambda _: None,  # `StudioApp` replies
            "open": self._open,
            "part": lambda sent: session.choose_part(_read_side(sent), sent["part"]),
            "turn_up": lambda sent: session.turn_up(_read_side(sent)),
            "as_it_is": lambda sent: session.open_plain(_read_side(sent)),
            "click": lambda sent: session.click(_read_side(sent), *_read_ray(sent)),
            "probe": lambda sent: session.probe(_read_side(sent), *_read_ray(sent)),
            "move": lambda sent: session.move(int(sent["number"]), _read_side(sent), *_read_ray(sent)),
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
            "view": lambda sent: session.change_view(**_read_view(sent["fields"])),
            "baked": self._show_baked,
            "again": lambda _: session.match_again(),
            "answer": lambda sent: session.choose_answer(int(sent["index"])),
            "cancel": lambda _: session.cancel(),
            "bake": lambda sent: session.finish(read_form(session.options, sent["options"])),
        }

    def handle(self, message: str | bytes) -> None:
        """Handle one message."""
        error = self._session.state.error
        with self._session.report_errors():
            try:
                if isinstance(message, bytes):
                    self._add_file(message)
                    self._session.answer_error(error)
                    return
                sent = json.loads(message)
                self._handlers[sent["do"]](sent)
                if sent["do"] != _UNASKED:
                    self._session.answer_error(error)
            except CagemapError:  # also a ValueError
                raise
            except (KeyError, TypeError, ValueError, IndexError) as error:
                raise ParameterError(f"the page sent {error!r}, which is not understood. Reload it.") from None

    def _open(self, sent: Entries) -> None:
        paths = {name: self._session.workspace.resolve(sent[name]) for name in _FILES if sent.get(name)}
        if not {"target", "source"} <= set(paths):
            raise ParameterError("expected a target and a source, got one of them or none. Choose both.")
        target_scheme, source_scheme = (name or None for name in sent["schemes"])
        files = self._pair_files(paths["target"], paths["source"], paths.get("texture"))
        self._session.open(replace(files, schemes=(target_scheme, source_scheme)))

    def _add_file(self, message: bytes) -> None:
        """Add a file to the workspace; with a role, also open it."""
        head, content = message.split(b"\n", 1)
        sent = json.loads(head)
        path, role = self._session.add_file(str(sent["name"]), content, str(sent.get("drop", ""))), sent.get("role")
        if path is None or role is None:
            return
        suffix = path.suffix.lower()
        if suffix in LANDMARK_SUFFIXES:
            self._session.load(path)
            return
        if suffix not in (*IMAGE_SUFFIXES, *MESH_SUFFIXES):  # a .mtl, or a table that the form names
            return
        files = self._session.requested_files
        before = self._dropped if files is None else {name: getattr(files, name) for name in _FILES}
        replaced = {"texture": None} if files is not None and role == "source" else {}
        chosen = before | replaced | {"texture" if suffix in IMAGE_SUFFIXES else str(role): path}
        target, source = chosen.get("target"), chosen.get("source")
        if target is not None and source is not None:
            self._dropped = {}
            self._session.open(self._pair_files(target, source, chosen.get("texture")))
            return
        self._dropped = chosen
        missing = [
            f"the {side} on the {half} half"
            for side, half, model in (("target", "left", target), ("source", "right", source))
            if model is None
        ]
        self._session.note(f"{path.name} was added. Drop {' and '.join(missing)}.")

    def _pair_files(self, target: Path, source: Path, texture: Path | None) -> Files:
        """Files of a pair; a model that is open is opened as before.

        Landmarks and RESULT are those of the open pair, if both models are the same.
        """
        opened, files = self._session.requested_files, default_files(target, source, texture)
        if opened is None:
            return files
        stays = opened.target == target, opened.source == source
        if all(stays):
            return replace(opened, texture=texture)

        def of_open_models(values: SideNames) -> SideNames:
            return values[0] if stays[0] else None, values[1] if stays[1] else None

        schemes, ups, parts = map(of_open_models, (opened.schemes, opened.ups, opened.parts))
        return replace(files, schemes=schemes, ups=ups, parts=parts)

    def _show_baked(self, sent: Entries) -> None:
        images = self._session.state.baked_images
        self._session.show_baked_image(next((path for path in images if path.name == sent["name"]), None))


def _read_side(sent: Entries) -> Side:
    return {str(side): side for side in SIDES}[sent["side"]]


def _read_ray(sent: Entries) -> tuple[FloatArray, FloatArray]:
    origin, direction = (np.array([float(value) for value in sent[name]]) for name in ("origin", "direction"))
    if origin.shape != (3,) or direction.shape != (3,) or not all(map(math.isfinite, (*origin, *direction))):
        raise ValueError("a ray")
    return origin, direction


def _read_view(fields: Entries) -> dict[str, Any]:
    return {name: str(value) if name in ("mode", "pose") else bool(value) for name, value in fields.items()}
