"""One address for the whole page: serves the frame around both views and passes their connections on to viser.

viser has neither tokens nor a check of who asks, so both are here: a connection must come from a page of this very
address (another site open in the same browser is refused) and, where other machines may connect, show the token. Its
own ports let nobody in but this door (`guard`).
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http
import logging
import secrets
import socket
import threading
from collections.abc import Callable
from http.cookies import SimpleCookie
from importlib import resources
from pathlib import Path
from urllib.parse import parse_qs, quote, unquote, urlsplit

import viser
import websockets.asyncio.client
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from cagemap.errors import ParameterError
from cagemap.studio.landmarks import SIDES
from cagemap.studio.page.viser_auth import HEADER, refusal

COOKIE = "cagemap_studio"
EVERYWHERE = ("0.0.0.0", "::")
LOOPBACK = ("127.0.0.1", "localhost", "::1")
# The page asks nothing of other machines, whatever viser's scripts would.
_POLICY = "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; frame-ancestors 'self'"
# What a finish wrote is looked at alone: a page of its own origin, which can reach nothing.
_SANDBOX = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:"
FILES = "/files/"
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


class Door:
    """Serves until `close`.

    Parameters
    ----------
    ports : dict of str to int
        Where viser serves each side, on loopback.
    host : str
    port : int
        The first one tried.
    token : str or None
        None only on loopback.
    secret : str
        What viser's ports ask for.
    given_out : callable
        Content and media type of a file to download, by its name; None where there is no such file.
    """

    def __init__(
        self,
        ports: dict[str, int],
        host: str,
        port: int,
        token: str | None,
        secret: str,
        given_out: Callable[[str], tuple[bytes, str] | None],
    ) -> None:
        self._ports, self._host, self._token = ports, host, token
        self._secret, self._given_out = secret, given_out
        self._files = _pages()
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._stop = asyncio.Event()
        self.port = 0
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._serve, args=(port,), name="studio door", daemon=True)
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
                    self._pass_on,
                    self._host,
                    port,
                    process_request=self._answer,
                    select_subprotocol=lambda _, offered: offered[0] if offered else None,
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

    async def _answer(self, _: websockets.asyncio.server.ServerConnection, request: Request) -> Response | None:
        """Serve a page; None lets a web socket through."""
        try:
            path = urlsplit(request.path).path
            admitted = admits(request, self._token)
        except (ValueError, LookupError):  # two hosts, an address that is none
            admitted = False
        if not admitted:
            return refusal()
        if request.headers.get("Upgrade", "").lower() == "websocket":
            known = path.strip("/") in self._ports
            return None if known else _response(http.HTTPStatus.NOT_FOUND, b"not found")
        if path.startswith(FILES):
            name = unquote(path.removeprefix(FILES))
            found = await asyncio.to_thread(self._given_out, name)
            return _response(http.HTTPStatus.NOT_FOUND, b"not found") if found is None else _file(name, *found)
        if path not in self._files:
            return _response(http.HTTPStatus.NOT_FOUND, b"not found")
        cookie = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict" if self._token else None
        return _response(http.HTTPStatus.OK, self._files[path], cookie)

    async def _pass_on(self, page: websockets.asyncio.server.ServerConnection) -> None:
        """Both directions of one connection, until either ends."""
        assert page.request is not None
        port = self._ports[urlsplit(page.request.path).path.strip("/")]
        offered = None if page.subprotocol is None else [Subprotocol(page.subprotocol)]
        async with websockets.asyncio.client.connect(
            f"ws://127.0.0.1:{port}/",
            subprotocols=offered,
            compression=None,
            max_size=None,
            additional_headers={HEADER: self._secret},
        ) as inside:
            both = [asyncio.create_task(_pump(page, inside)), asyncio.create_task(_pump(inside, page))]
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            for task in both:
                task.cancel()


_Socket = websockets.asyncio.server.ServerConnection | websockets.asyncio.client.ClientConnection


async def _pump(here: _Socket, there: _Socket) -> None:
    async for message in here:
        await there.send(message)


def _pages() -> dict[str, bytes]:
    """Everything that is served as a file: the frame, and viser's own page for each side."""
    frame, first = (
        resources.files("cagemap.studio.page").joinpath(name).read_bytes() for name in ("frame.html", "jagged.html")
    )
    client = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_bytes()
    client = client.replace(b"<head>", b"<head>" + first, 1)
    # The name of this run: a page that hears another one loads itself anew.
    return {"/": frame, "/alive": new_token().encode()} | {f"/{side}/": client for side in SIDES}


def _file(name: str, body: bytes, kind: str) -> Response:
    """A file to keep; a page to look at."""
    response = _response(http.HTTPStatus.OK, body)
    shown = kind == "text/html"
    for header, value in (
        ("Content-Type", f"{kind}; charset=utf-8" if shown else kind),
        ("Content-Disposition", "inline" if shown else f"attachment; filename*=UTF-8''{quote(name)}"),
        ("Content-Security-Policy", _SANDBOX),
        ("X-Content-Type-Options", "nosniff"),
    ):
        response.headers.pop(header, None)
        response.headers[header] = value
    return response


def _response(status: http.HTTPStatus, body: bytes, cookie: str | None = None) -> Response:
    headers = Headers(
        {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Length": str(len(body)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Frame-Options": "SAMEORIGIN",
            "Content-Security-Policy": _POLICY,
        }
    )
    if cookie is not None:
        headers["Set-Cookie"] = cookie
    return Response(status.value, status.phrase, headers, body)
