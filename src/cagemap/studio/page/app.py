"""`cagemap studio`: session, messages and server together."""

from __future__ import annotations

import itertools
import json
import logging
import threading
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cagemap.studio.downloads import output_content, textured_model, textured_model_name
from cagemap.studio.landmarks import SIDES
from cagemap.studio.page.actions import Actions
from cagemap.studio.page.form import form_fields
from cagemap.studio.page.server import LOOPBACK_ADDRESSES, Server, new_token
from cagemap.studio.page.shown import constant_entries, line_drawing, listing_entries, page_state
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session
from cagemap.studio.state import Files, StudioState
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import Options

log = logging.getLogger(__name__)
# A page's request for the current list of files.
LIST_MESSAGE = '{"do":"list"}'


@dataclass(frozen=True)
class PageRequest:
    """Options of `cagemap studio`."""

    files: Files | None  # opened at the start
    options: Options  # options of the commands of a finish
    folders: tuple[Path, ...]  # nothing outside them is read or written
    host: str = "127.0.0.1"
    port: int = 8765
    vertices: int = 25_000  # approximate number of vertices of each previewed surface
    open_browser: bool = True


class StudioApp:
    """A running studio."""

    def __init__(self, request: PageRequest) -> None:
        self.session = Session(Workspace.of(*request.folders), request.vertices, request.options)
        self._actions, self._first_files = Actions(self.session), request.files
        self._drawings: dict[str, tuple[tuple[object, ...], Callable[[], bytes]]] = {}
        self._key_count, self._drawings_lock = itertools.count(1), threading.Lock()
        self._changed, self._closed = threading.Event(), False
        token = None if request.host in LOOPBACK_ADDRESSES else new_token()
        self._server = Server(
            request.host, request.port, token, self._download, self._draw, self._first_messages, self._on_message
        )
        self.session.subscribe(lambda *_: self._changed.set())
        threading.Thread(target=self._send_changes, name="studio page", daemon=True).start()
        self.address = self._server.address  # to open in a browser
        if request.files is not None:
            self.session.open(request.files)

    def close(self) -> None:
        """End the session and the server."""
        self._closed = True
        self._changed.set()
        self.session.close()
        self._server.close()

    def _send_changes(self) -> None:
        """Send the state to all pages after changes; several changes may be sent at once."""
        while True:
            self._changed.wait()
            self._changed.clear()
            if self._closed:
                return
            try:
                self._server.send(self._state())
            except Exception:  # the next change tries again
                log.exception("the page could not be updated")

    def _state(self) -> str:
        state, scene = self.session.state, self.session.scene
        return json.dumps(page_state(state, scene, self.session.workspace, self._drawing_keys(state, scene)))

    def _drawing_keys(self, state: StudioState, scene: Scene | None) -> dict[str, str]:
        """Keys of all drawings; a changed drawing gets a new key."""
        if scene is None:
            return {}
        drawings: dict[str, tuple[tuple[object, ...], Callable[[], bytes]]] = {}
        for number, side in enumerate(SIDES):
            shape, skin, curves = scene.shape(side), scene.skins[number], state.history.present.curves
            drawings[f"{side}/skin"] = (skin,), partial(bytes, skin)
            drawings[f"{side}/cage"] = (shape,), partial(line_drawing, state, scene, side, cage=True)
            drawings[f"{side}/curves"] = (shape, curves), partial(line_drawing, state, scene, side, cage=False)
        with self._drawings_lock:
            before = {key.rpartition("/")[0]: (key, content) for key, (content, _) in self._drawings.items()}
            unchanged = {
                name: key
                for name, (key, content) in before.items()
                if name in drawings and all(a is b for a, b in zip(drawings[name][0], content, strict=True))
            }
            keys = {name: unchanged.get(name) or f"{name}/{next(self._key_count)}" for name in drawings}
            self._drawings = {keys[name]: drawing for name, drawing in drawings.items()}
        return keys

    def _draw(self, key: str) -> bytes | None:
        drawing = self._drawings.get(key)
        return None if drawing is None else drawing[1]()

    def _download(self, name: str) -> tuple[bytes, str] | None:
        state = self.session.state
        if name == textured_model_name(state):
            return textured_model(state, self.session.scene), "model/gltf-binary"
        return output_content(state.outputs, name)

    def _first_messages(self) -> Iterator[str]:
        workspace, options, vertices = self.session.workspace, self.session.options, self.session.vertices
        files = self.session.state.files or self._first_files  # a page may connect before these are open
        match = None if files is None else files.recorded_match
        form = form_fields(options, vertices, {} if match is None else match.form_values)
        yield json.dumps(constant_entries() | listing_entries(workspace) | form)
        yield self._state()

    def _on_message(self, message: str | bytes, reply: Callable[[str], None]) -> None:
        self._actions.handle(message)
        if isinstance(message, bytes) or message == LIST_MESSAGE:
            reply(json.dumps(listing_entries(self.session.workspace)))


def run_page(request: PageRequest, tell: Callable[[str], None]) -> None:
    """Serve the studio until interrupted.

    ParameterError if the address cannot be served.
    """
    app = StudioApp(request)
    try:
        tell(f"The studio is at {app.address} (Ctrl-C ends it).")
        if request.open_browser:
            webbrowser.open(app.address)
        threading.Event().wait()
    finally:
        app.close()
