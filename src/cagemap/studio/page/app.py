"""`cagemap studio`: everything put together, until interrupted."""

from __future__ import annotations

import contextlib
import io
import logging
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import viser

from cagemap.studio.downloads import content
from cagemap.studio.landmarks import SIDES
from cagemap.studio.page.cameras import Cameras
from cagemap.studio.page.choices import Choices
from cagemap.studio.page.panels import SetupPanel, WorkPanel
from cagemap.studio.page.proxy import LOOPBACK, Door, new_token
from cagemap.studio.page.view import FIRST_VIEW, ModelView
from cagemap.studio.page.viser_auth import guarded, require_guarded
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session
from cagemap.studio.state import Files, Studio
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import Options

log = logging.getLogger(__name__)


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
        secret = new_token()
        # viser prints the addresses of its own ports, which answer nobody.
        with guarded(secret), contextlib.redirect_stdout(io.StringIO()):
            self._servers = {side: viser.ViserServer("127.0.0.1", 0, verbose=False) for side in SIDES}
        for server in self._servers.values():
            server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        target, source = self._servers["target"], self._servers["source"]
        cameras = Cameras(self.session, (target, source), FIRST_VIEW)
        self._views = (ModelView(target, "target", self.session), ModelView(source, "source", self.session))
        choices = Choices(self.session.workspace)
        self._setup = SetupPanel(target, self.session, choices, cameras.frame)
        self._work = WorkPanel(source, self.session, choices)
        self._changed, self._closed = threading.Event(), False
        self.session.subscribe(lambda *_: self._changed.set())
        threading.Thread(target=self._follow, name="studio page", daemon=True).start()
        token = None if request.host in LOOPBACK else new_token()
        ports = {side: server.get_port() for side, server in self._servers.items()}
        for port in ports.values():
            require_guarded(port)
        self._door = Door(
            {str(side): port for side, port in ports.items()},
            request.host,
            request.port,
            token,
            secret,
            lambda name: content(self.session.state.outputs, name),
        )
        self.address = self._door.address
        if request.files is not None:
            self.session.open(request.files)

    def close(self) -> None:
        """Stop everything."""
        self._closed = True
        self._changed.set()
        self.session.close()
        self._door.close()
        for server in self._servers.values():
            server.stop()

    def _follow(self) -> None:
        """Bring the page up to date whenever something changed; changes in between are skipped."""
        while True:
            self._changed.wait()
            self._changed.clear()
            if self._closed:
                return
            try:
                self._refresh(self.session.state, self.session.scene)
            except Exception:  # the next change is another try
                log.exception("the page could not be brought up to date")

    def _refresh(self, state: Studio, scene: Scene | None) -> None:
        # The panels first, in messages of their own: a page takes them at once, what is drawn with the next picture.
        self._work.refresh(state)
        self._setup.refresh(state, scene)
        for server in self._servers.values():
            server.flush()
        for view in self._views:
            view.refresh(state, scene)


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
