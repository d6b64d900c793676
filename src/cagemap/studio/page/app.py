"""`cagemap studio`: everything put together, until interrupted."""

from __future__ import annotations

import itertools
import json
import logging
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cagemap.studio.downloads import content, textured, textured_name
from cagemap.studio.landmarks import SIDES
from cagemap.studio.page.actions import Actions
from cagemap.studio.page.form import form
from cagemap.studio.page.server import LOOPBACK, Server, new_token
from cagemap.studio.page.shown import fixed, lines, listing, page_state
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session
from cagemap.studio.state import Files, Studio
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import Options

log = logging.getLogger(__name__)
# What a page asks for to know the files that have come since.
LIST = '{"do":"list"}'


@dataclass(frozen=True)
class PageRequest:
    """What was asked for on the command line.

    Attributes
    ----------
    files : Files or None
        Opened at the start.
    options : mapping
        What the commands of a finish can be asked.
    folders : tuple of Path
        The page reads and writes nothing outside them.
    host : str
    port : int
    vertices : int
        Of each previewed surface, about.
    open_browser : bool
    """

    files: Files | None
    options: Options
    folders: tuple[Path, ...]
    host: str = "127.0.0.1"
    port: int = 8765
    vertices: int = 25_000
    open_browser: bool = True


class StudioApp:
    """A running studio.

    Attributes
    ----------
    session : Session
    address : str
        What to open in a browser.
    """

    def __init__(self, request: PageRequest) -> None:
        self.session = Session(Workspace.of(*request.folders), request.vertices, request.options)
        self._actions = Actions(self.session)
        self._drawn: dict[str, tuple[object, Callable[[], bytes]]] = {}
        self._count, self._drawing = itertools.count(1), threading.Lock()
        self._changed, self._closed = threading.Event(), False
        token = None if request.host in LOOPBACK else new_token()
        self._server = Server(request.host, request.port, token, self._given_out, self._draw, self._hello, self._heard)
        self.session.subscribe(lambda *_: self._changed.set())
        threading.Thread(target=self._follow, name="studio page", daemon=True).start()
        self.address = self._server.address
        if request.files is not None:
            self.session.open(request.files)

    def close(self) -> None:
        """Stop everything."""
        self._closed = True
        self._changed.set()
        self.session.close()
        self._server.close()

    def _follow(self) -> None:
        """Tell all pages whenever something changed; changes in between are skipped."""
        while True:
            self._changed.wait()
            self._changed.clear()
            if self._closed:
                return
            try:
                self._server.tell(self._state())
            except Exception:  # the next change is another try
                log.exception("the page could not be brought up to date")

    def _state(self) -> str:
        state, scene = self.session.state, self.session.scene
        return json.dumps(page_state(state, scene, self.session.workspace, self._keys(state, scene)))

    def _keys(self, state: Studio, scene: Scene | None) -> dict[str, str]:
        """Names of what there is to draw: another one for whatever has changed."""
        if scene is None:
            return {}
        now: dict[str, tuple[object, Callable[[], bytes]]] = {}
        for number, side in enumerate(SIDES):
            shape, skin, curves = scene.shape(side), scene.skins[number], state.history.present.curves
            now[f"{side}/skin"] = skin, partial(bytes, skin)
            now[f"{side}/cage"] = shape, partial(lines, state, scene, side, cage=True)
            now[f"{side}/curves"] = (shape, curves), partial(lines, state, scene, side, cage=False)
        with self._drawing:
            known = {key.rpartition("/")[0]: (key, of) for key, (of, _) in self._drawn.items()}
            same = {name: key for name, (key, of) in known.items() if name in now and _same(now[name][0], of)}
            keys = {name: same.get(name) or f"{name}/{next(self._count)}" for name in now}
            self._drawn = {keys[name]: one for name, one in now.items()}
        return keys

    def _draw(self, key: str) -> bytes | None:
        found = self._drawn.get(key)
        return None if found is None else found[1]()

    def _given_out(self, name: str) -> tuple[bytes, str] | None:
        state = self.session.state
        if name == textured_name(state):
            return textured(state), "model/gltf-binary"
        return content(state.outputs, name)

    def _hello(self) -> tuple[str, ...]:
        workspace, options = self.session.workspace, self.session.options
        return json.dumps(fixed() | listing(workspace) | form(options)), self._state()

    def _heard(self, message: str | bytes, reply: Callable[[str], None]) -> None:
        self._actions.do(message)
        if isinstance(message, bytes) or message == LIST:
            reply(json.dumps(listing(self.session.workspace)))


def _same(one: object, other: object) -> bool:
    """Whether two values, or all of two tuples, are the very same."""
    ones, others = (value if isinstance(value, tuple) else (value,) for value in (one, other))
    return len(ones) == len(others) and all(a is b for a, b in zip(ones, others, strict=True))


def run_page(request: PageRequest, tell: Callable[[str], None]) -> None:
    """Serve until interrupted.

    Raises
    ------
    ParameterError
        If the address cannot be served.
    """
    app = StudioApp(request)
    try:
        tell(f"The studio is at {app.address} (Ctrl-C ends it).")
        if request.open_browser:
            webbrowser.open(app.address)
        threading.Event().wait()
    finally:
        app.close()
