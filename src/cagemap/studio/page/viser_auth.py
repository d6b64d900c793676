"""viser's own ports answer only the door.

viser listens on loopback and lets everybody in: any site open in a browser on this machine, and any other user of it.
It has no option for that, so while its servers start, what it serves with is given a check of our own; a port that
does not refuse afterwards is an error.
"""

from __future__ import annotations

import hmac
import http
import http.client
import inspect
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from cagemap.errors import CagemapError

HEADER = "X-Cagemap-Door"
_starting = threading.Lock()


@contextmanager
def guarded(secret: str) -> Iterator[None]:
    """Whatever starts to serve inside the block answers only requests that show the secret."""
    plain: Any = websockets.asyncio.server.serve

    def serve(handler: Any, *place: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        async def checked(connection: Any, request: Request) -> Response | None:
            if not hmac.compare_digest(request.headers.get(HEADER, "").encode(), secret.encode()):
                return refusal()
            answer = None if process_request is None else process_request(connection, request)
            return await answer if inspect.isawaitable(answer) else answer

        return plain(handler, *place, process_request=checked, **options)

    with _starting:
        websockets.asyncio.server.serve = serve  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = plain  # type: ignore[misc]


def require_guarded(port: int) -> None:
    """Raise unless a port refuses whoever does not know the secret.

    Raises
    ------
    CagemapError
        If it answers: this version of viser serves in another way.
    """
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request("GET", "/")
        status = connection.getresponse().status
    finally:
        connection.close()
    if status != http.HTTPStatus.FORBIDDEN:
        raise CagemapError(
            f"the studio's inner port {port}: expected it to refuse strangers, got an answer ({status}). "
            "Install the version of viser that pyproject.toml names."
        )


def refusal() -> Response:
    """What a stranger is told."""
    body = b"open the address that `cagemap studio` printed"
    status = http.HTTPStatus.FORBIDDEN
    headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body)), "Connection": "close"})
    return Response(status.value, status.phrase, headers, body)
