"""HTTP and WebSocket server of the page.

Requests must come from a page of the same address, not from another site in the same browser. If other machines can
connect, they must show the token.
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

WILDCARD_ADDRESSES = ("0.0.0.0", "::")
LOOPBACK_ADDRESSES = ("127.0.0.1", "localhost", "::1")
_POLICY = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; frame-ancestors 'none'"
# For written reports: an origin of their own, without access to the studio.
_SANDBOX = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:"
FILES_PATH, DRAWINGS_PATH, SOCKET_PATH = "/files/", "/drawn/", "/socket"
_PAGE_FILES = ("index.html", "page.css", "page.js", "form.js", "gl.js", "view.js")
# Seconds for open pages to close.
_CLOSE_TIMEOUT = 3.0
# Malformed requests are refused without a log entry.
_log = logging.getLogger(__name__)
_log.setLevel(logging.CRITICAL)
# Ports tried if the first one is in use.
_PORT_ATTEMPTS = 20


def new_token() -> str:
    """A random token."""
    return secrets.token_urlsafe(24)


def is_admitted(request: Request, token: str | None) -> bool:
    """Whether a request comes from the same address and has the token, if any."""
    origin, host = request.headers.get("Origin"), request.headers.get("Host", "")
    if origin is not None and urlsplit(origin).netloc != host:
        return False
    site, mode = request.headers.get("Sec-Fetch-Site", "none"), request.headers.get("Sec-Fetch-Mode")
    if origin is None and site not in ("none", "same-origin") and mode != "navigate":
        return False  # an image or script in a page of another site
    if token is None:
        # Another name that resolves to this machine belongs to another site (DNS rebinding).
        return (urlsplit(f"//{host}").hostname or "") in LOOPBACK_ADDRESSES
    query = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
    cookie = SimpleCookie(request.headers.get("Cookie", "")).get(_cookie_name(request))
    return any(hmac.compare_digest(word.encode(), token.encode()) for word in (query, cookie.value if cookie else ""))


def _cookie_name(request: Request) -> str:
    """Name of the cookie with the token: browsers keep those of all ports of a host together."""
    host = request.headers.get("Host", "")
    return f"cagemap_studio_{urlsplit(f'//{host}').port or 80}"


class Server:
    """Serves the page in a thread until `close`.

    ``port``: following ports are tried if it is in use.
    ``token``: None only on a loopback address.
    ``download``: content and media type of a file by its name; None for an unknown name.
    ``draw``: binary glTF of a drawing by its key; None for an unknown or old key.
    ``first_messages``: messages for a page that connects, the second of them made after the first is sent.
    ``on_message``: called in a thread with a page's message and a function that replies to that page.
    """

    def __init__(
        self,
        host: str,
        port: int,
        token: str | None,
        download: Callable[[str], tuple[bytes, str] | None],
        draw: Callable[[str], bytes | None],
        first_messages: Callable[[], Iterable[str]],
        on_message: Callable[[str | bytes, Callable[[str], None]], None],
    ) -> None:
        self._host, self._token = host, token
        self._download, self._draw = download, draw
        self._first_messages, self._on_message = first_messages, on_message
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
        """The address to open in a browser."""
        host = socket.gethostname() if self._host in WILDCARD_ADDRESSES else self._host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self._token}" if self._token else "")

    def send(self, message: str) -> None:
        """Send a message to every page, without waiting."""
        with contextlib.suppress(RuntimeError):  # the server is closed
            self._loop.call_soon_threadsafe(lambda: websockets.asyncio.server.broadcast(self._pages, message))

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(5)

    def _serve(self, first: int) -> None:
        self._loop.run_until_complete(self._listen(first))
        self._loop.close()

    async def _listen(self, first: int) -> None:
        for port in [*range(first, first + _PORT_ATTEMPTS), 0]:
            try:
                server = await websockets.asyncio.server.serve(
                    self._serve_socket,
                    self._host,
                    port,
                    process_request=self._respond,
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
                await asyncio.wait_for(server.wait_closed(), _CLOSE_TIMEOUT)
            return
        self._ready.set()

    async def _respond(self, _: ServerConnection, request: Request) -> Response | None:
        """Respond with a file; None accepts a web socket."""
        try:
            path = urlsplit(request.path).path
            admitted = is_admitted(request, self._token)
        except (ValueError, LookupError):  # malformed headers or address
            admitted = False
        if not admitted:
            return _response(b"open the address that `cagemap studio` printed", status=http.HTTPStatus.FORBIDDEN)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return None if path == SOCKET_PATH else _response(b"not found", status=http.HTTPStatus.NOT_FOUND)
        response: Response | None = None
        if path.startswith(FILES_PATH):
            name = unquote(path.removeprefix(FILES_PATH))
            file = await asyncio.to_thread(self._download, name)
            response = None if file is None else _file_response(name, *file)
        elif path.startswith(DRAWINGS_PATH):
            drawn = await asyncio.to_thread(self._draw, path.removeprefix(DRAWINGS_PATH))
            response = None if drawn is None else _response(drawn, "model/gltf-binary")
        elif path in self._files:
            response = _response(*self._files[path])
            if self._token:
                response.headers["Set-Cookie"] = (
                    f"{_cookie_name(request)}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                )
        return response or _response(b"not found", status=http.HTTPStatus.NOT_FOUND)

    async def _serve_socket(self, page: ServerConnection) -> None:
        """Send the first messages to a page, then receive until it closes."""

        def reply(message: str) -> None:
            asyncio.run_coroutine_threadsafe(page.send(message), self._loop)

        try:
            try:
                for message in self._first_messages():
                    await page.send(message)
                    self._pages.add(page)  # before the next message, the state: none of its changes may be missed
                async for received in page:
                    await asyncio.to_thread(self._on_message, received, reply)
            finally:
                self._pages.discard(page)
        except ConnectionClosed:
            pass
        except Exception:  # the log of websockets is off
            logging.getLogger("cagemap").exception("a page was not answered")
            raise


def _page_files() -> dict[str, tuple[bytes, str]]:
    """Content and media type of the page's files by path."""
    page, three = resources.files("cagemap.studio.page"), resources.files("cagemap.report.three")
    contents = {f"/{name}": page.joinpath(name).read_bytes() for name in _PAGE_FILES}
    contents |= {"/three.min.js": three.joinpath("three.min.js").read_bytes()}
    kinds = {path: mimetypes.guess_type(path)[0] or "text/html" for path in contents}
    return {
        path.replace("/index.html", "/"): (body, f"{kinds[path]}; charset=utf-8") for path, body in contents.items()
    }


def _file_response(name: str, body: bytes, kind: str) -> Response:
    """A download, or an HTML page that is shown."""
    is_page = kind == "text/html"
    response = _response(body, f"{kind}; charset=utf-8" if is_page else kind)
    del response.headers["Content-Security-Policy"]
    response.headers["Content-Security-Policy"] = _SANDBOX
    response.headers["Content-Disposition"] = "inline" if is_page else f"attachment; filename*=UTF-8''{quote(name)}"
    return response


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
