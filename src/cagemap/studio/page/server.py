"""Serves the page: its files, what it draws, and one web socket for each window that shows it.

A connection must come from a page of this very address (another site open in the same browser is refused) and, where
other machines may connect, show the token.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http
import logging
import mimetypes
import secrets
import socket
import threading
from collections.abc import Callable, Iterable
from http.cookies import SimpleCookie
from importlib import resources
from urllib.parse import parse_qs, quote, unquote, urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from cagemap.errors import ParameterError

COOKIE = "cagemap_studio"
EVERYWHERE = ("0.0.0.0", "::")
LOOPBACK = ("127.0.0.1", "localhost", "::1")
_POLICY = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; frame-ancestors 'none'"
# What a finish wrote is looked at alone: a page of its own origin, which can reach nothing.
_SANDBOX = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:"
FILES, DRAWN, SOCKET = "/files/", "/drawn/", "/socket"
# Files of the page.
_PAGE = ("index.html", "page.css", "page.js", "form.js", "gl.js", "view.js")
# Seconds that open pages are given to close.
_FAREWELL = 3.0
# Strangers' broken requests are refused; what is wrong with each, nobody in front of the terminal asks.
_log = logging.getLogger(__name__)
_log.setLevel(logging.CRITICAL)
# Ports tried after the first one that is taken.
_PORTS = 20


def new_token() -> str:
    """A word that nobody guesses."""
    return secrets.token_urlsafe(24)


def admits(request: Request, token: str | None) -> bool:
    """Whether a request may come in: from a page of the same address, with the token where there is one."""
    origin, host = request.headers.get("Origin"), request.headers.get("Host", "")
    if origin is not None and urlsplit(origin).netloc != host:
        return False
    asks = request.headers.get("Sec-Fetch-Site", "none"), request.headers.get("Sec-Fetch-Mode")
    if origin is None and asks[0] not in ("none", "same-origin") and asks[1] != "navigate":
        return False  # an image or a script in a page of someone else, which names no origin
    if token is None:
        # A name that merely resolves to this machine is a page of someone else.
        return (urlsplit(f"//{host}").hostname or "") in LOOPBACK
    given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
    cookie = SimpleCookie(request.headers.get("Cookie", "")).get(COOKIE)
    return any(hmac.compare_digest(word.encode(), token.encode()) for word in (given, cookie.value if cookie else ""))


class Server:
    """Serves until `close`.

    Parameters
    ----------
    host : str
    port : int
        The first one tried.
    token : str or None
        None only on loopback.
    given_out : callable
        Content and media type of a file to download, by its name; None where there is no such file.
    drawn : callable
        A binary glTF file for the page, by its name; None where there is none of that name now.
    hello : callable
        What a page is told first.
    heard : callable
        Told of a page's message, and a function that answers that page alone; called in a thread, one at a time.
    """

    def __init__(
        self,
        host: str,
        port: int,
        token: str | None,
        given_out: Callable[[str], tuple[bytes, str] | None],
        drawn: Callable[[str], bytes | None],
        hello: Callable[[], Iterable[str]],
        heard: Callable[[str | bytes, Callable[[str], None]], None],
    ) -> None:
        self._host, self._token = host, token
        self._given_out, self._drawn, self._hello, self._heard = given_out, drawn, hello, heard
        self._files = _page_files()
        self._pages: set[ServerConnection] = set()
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._stop = asyncio.Event()
        self.port = 0
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._serve, args=(port,), name="studio server", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise ParameterError(f"--host {host}: cannot serve there ({self._error}). Name an address of this machine.")

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host = socket.gethostname() if self._host in EVERYWHERE else self._host
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/" + (f"?token={self._token}" if self._token else "")

    def tell(self, message: str) -> None:
        """Send a message to every page; returns at once."""
        with contextlib.suppress(RuntimeError):  # closed meanwhile
            self._loop.call_soon_threadsafe(lambda: websockets.asyncio.server.broadcast(self._pages, message))

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(5)

    def _serve(self, first: int) -> None:
        self._loop.run_until_complete(self._listen(first))
        self._loop.close()

    async def _listen(self, first: int) -> None:
        for port in [*range(first, first + _PORTS), 0]:
            try:
                server = await websockets.asyncio.server.serve(
                    self._talk,
                    self._host,
                    port,
                    process_request=self._answer,
                    compression=None,
                    max_size=None,
                    logger=_log,
                )
            except OSError as error:
                self._error = error
                continue
            self._error, self.port = None, server.sockets[0].getsockname()[1]
            self._ready.set()
            await self._stop.wait()
            server.close()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(server.wait_closed(), _FAREWELL)
            return
        self._ready.set()

    async def _answer(self, _: ServerConnection, request: Request) -> Response | None:
        """Serve a file; None lets a web socket through."""
        try:
            path = urlsplit(request.path).path
            admitted = admits(request, self._token)
        except (ValueError, LookupError):  # two hosts, an address that is none
            admitted = False
        if not admitted:
            return _refusal()
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return None if path == SOCKET else _response(b"not found", status=http.HTTPStatus.NOT_FOUND)
        found: Response | None = None
        if path.startswith(FILES):
            name = unquote(path.removeprefix(FILES))
            file = await asyncio.to_thread(self._given_out, name)
            found = None if file is None else _file(name, *file)
        elif path.startswith(DRAWN):
            drawn = await asyncio.to_thread(self._drawn, path.removeprefix(DRAWN))
            found = None if drawn is None else _response(drawn, "model/gltf-binary")
        elif path in self._files:
            found = _response(*self._files[path])
            if self._token:
                found.headers["Set-Cookie"] = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        return found or _response(b"not found", status=http.HTTPStatus.NOT_FOUND)

    async def _talk(self, page: ServerConnection) -> None:
        """Tell a page what there is, then listen to it until it closes."""

        def reply(message: str) -> None:
            asyncio.run_coroutine_threadsafe(page.send(message), self._loop)

        try:
            for message in self._hello():
                await page.send(message)
            self._pages.add(page)
            try:
                async for heard in page:
                    await asyncio.to_thread(self._heard, heard, reply)
            finally:
                self._pages.discard(page)
        except ConnectionClosed:
            pass
        except Exception:  # the server's own log is silent
            logging.getLogger("cagemap").exception("a page was not answered")
            raise


def _page_files() -> dict[str, tuple[bytes, str]]:
    """Content and kind of what is served as a file."""
    page, three = resources.files("cagemap.studio.page"), resources.files("cagemap.report.three")
    found = {f"/{name}": page.joinpath(name).read_bytes() for name in _PAGE}
    found |= {"/three.min.js": three.joinpath("three.min.js").read_bytes()}
    kinds = {path: mimetypes.guess_type(path)[0] or "text/html" for path in found}
    return {path.replace("/index.html", "/"): (body, f"{kinds[path]}; charset=utf-8") for path, body in found.items()}


def _file(name: str, body: bytes, kind: str) -> Response:
    """A file to keep; a page to look at."""
    shown = kind == "text/html"
    response = _response(body, f"{kind}; charset=utf-8" if shown else kind)
    del response.headers["Content-Security-Policy"]
    response.headers["Content-Security-Policy"] = _SANDBOX
    response.headers["Content-Disposition"] = "inline" if shown else f"attachment; filename*=UTF-8''{quote(name)}"
    return response


def _refusal() -> Response:
    """What a stranger is told."""
    return _response(b"open the address that `cagemap studio` printed", status=http.HTTPStatus.FORBIDDEN)


def _response(body: bytes, kind: str = "text/plain", status: http.HTTPStatus = http.HTTPStatus.OK) -> Response:
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Content-Security-Policy": _POLICY,
        }
    )
    return Response(status.value, status.phrase, headers, body)
