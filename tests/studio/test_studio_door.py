"""What answers on the network: the door, the ports behind it, and the files it gives out."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import queue
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
import websockets.asyncio.client
import websockets.asyncio.server
import websockets.exceptions
from websockets.datastructures import Headers
from websockets.http11 import Request

from cagemap.errors import CagemapError
from cagemap.studio.page.proxy import COOKIE, Door, admits
from cagemap.studio.page.viser_auth import guarded, require_guarded

from browser_page import PATIENCE


def request(path: str = "/", **headers: str) -> Request:
    return Request(
        path, Headers({"Host": "127.0.0.1:8765"} | {name.replace("_", "-"): v for name, v in headers.items()})
    )


def test_the_door_refuses_pages_of_other_sites() -> None:
    assert admits(request(), None)
    assert admits(request(Origin="http://127.0.0.1:8765"), None)
    assert not admits(request(Origin="http://elsewhere.example"), None)
    assert not admits(request(Origin="http://127.0.0.1:9999"), None)
    # A name of someone else's that resolves to this machine.
    assert not admits(Request("/", Headers({"Host": "rebound.example:8765"})), None)
    # An image in another site's page names no origin; a link there may lead here.
    for site in ("cross-site", "same-site"):
        assert not admits(request("/files/all.zip", Sec_Fetch_Site=site, Sec_Fetch_Mode="no-cors"), None)
        assert admits(request(Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate"), None)
    assert admits(request(Sec_Fetch_Site="same-origin", Sec_Fetch_Mode="cors"), None)
    # The page's own web socket, whatever a browser takes ws:// beside http:// for.
    own = {"Origin": "http://127.0.0.1:8765", "Upgrade": "websocket", "Sec_Fetch_Mode": "websocket"}
    assert admits(request("/target/", Sec_Fetch_Site="cross-site", **own), None)


def test_the_door_asks_for_the_token() -> None:
    token = "right"
    assert admits(request("/?token=right"), token)
    assert admits(request(Cookie=f"{COOKIE}=right"), token)
    for refused in (request(), request("/?token="), request("/?token=wrong"), request(Cookie=f"{COOKIE}=wrong")):
        assert not admits(refused, token)


def answer(port: int, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    return connection.getresponse()


def test_broken_requests_are_refused_without_a_traceback(caplog: pytest.LogCaptureFixture) -> None:
    door = Door({}, "127.0.0.1", 0, None, "secret", {}.get)
    try:
        assert answer(door.port, "//[").status == 403
        for broken in (b"POST / HTTP/1.1\r\n\r\n", b"\0" * 99 + b"\r\n", b"GET / HT", b"G" * 20_000):
            with socket.create_connection(("127.0.0.1", door.port), timeout=10) as stranger:
                stranger.sendall(broken)
                stranger.shutdown(socket.SHUT_WR)
                with contextlib.suppress(ConnectionError):
                    assert b"200" not in stranger.recv(100)
        assert answer(door.port, "/").status == 200
    finally:
        door.close()
    assert "handshake failed" not in caplog.text


def test_the_door_gives_out_only_what_is_offered() -> None:
    offered = {"cow.png": (b"png", "image/png"), "RESULT.html": (b"<b>", "text/html")}
    door = Door({}, "127.0.0.1", 0, None, "secret", offered.get)
    try:
        got = answer(door.port, "/files/cow.png")
        assert (got.status, got.read()) == (200, b"png")
        assert got.headers["Content-Disposition"].startswith("attachment")
        assert "sandbox" in answer(door.port, "/files/RESULT.html").headers["Content-Security-Policy"]
        for path in ("/files/../cow.png", "/files/%2e%2e%2fcow.png", "/../etc/passwd", "//etc/passwd", "/files/", "/x"):
            assert answer(door.port, path).status == 404
        odd = ({"Host": "["}, {"Origin": "http://["})
        for stranger in ({"Host": "rebound.example"}, {"Origin": "http://elsewhere.example"}, *odd):
            assert answer(door.port, "/files/cow.png", **stranger).status == 403
    finally:
        door.close()


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_says_that_the_studio_ended_and_loads_itself_anew_when_it_is_back(browser: Any) -> None:
    from selenium.common.exceptions import WebDriverException

    def until(done: Callable[[], Any]) -> None:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            with contextlib.suppress(WebDriverException):  # the page is being loaded
                if done():
                    return
            time.sleep(0.1)
        pytest.fail(said())

    def said() -> str:
        return str(browser.execute_script("return document.getElementById('gone').innerText"))

    def first_load() -> bool:
        return bool(browser.execute_script("return window.firstLoad ?? false"))

    door = Door({}, "127.0.0.1", 0, None, "secret", lambda _: None)
    browser.get(door.address)
    browser.execute_script("window.firstLoad = true")
    assert said() == ""
    door.close()
    until(lambda: "The studio has ended" in said())
    again = Door({}, "127.0.0.1", door.port, None, "secret", lambda _: None)
    try:
        assert again.port == door.port
        until(lambda: not first_load())
        assert said() == ""
        browser.execute_script("window.firstLoad = true")
    finally:
        again.close()
    # One that is started before the page has asked is another one, too; one with a token is none of this page's.
    other = Door({}, "127.0.0.1", door.port, None, "secret", lambda _: None)
    try:
        until(lambda: not first_load())
    finally:
        other.close()
    stranger = Door({}, "127.0.0.1", door.port, "token", "secret", lambda _: None)
    try:
        until(lambda: "Another studio runs here" in said())
    finally:
        stranger.close()


def test_web_sockets_of_other_machines_need_the_token() -> None:
    async def echo(page: websockets.asyncio.server.ServerConnection) -> None:
        async for message in page:
            await page.send(message)

    async def said_back(address: str, **headers: str) -> object:
        try:
            async with websockets.asyncio.client.connect(address, additional_headers=headers) as page:
                await page.send("hello")
                return await page.recv()
        except websockets.exceptions.InvalidStatus as error:
            return error.response.status_code

    async def all_of_them() -> list[object]:
        async with websockets.asyncio.server.serve(echo, "127.0.0.1", 0) as inner:
            ports = {"target": inner.sockets[0].getsockname()[1]}
            door = await asyncio.to_thread(Door, ports, "0.0.0.0", 0, "right", "secret", {}.get)
            address, cookie = f"ws://127.0.0.1:{door.port}/target", {"Cookie": f"{COOKIE}=right"}
            strangers = ({}, {"Cookie": f"{COOKIE}=wrong"}, cookie | {"Origin": "http://elsewhere.example"})
            found = [await said_back(address, **headers) for headers in (cookie, *strangers)]
            await asyncio.to_thread(door.close)
            return found

    assert asyncio.run(all_of_them()) == ["hello", 403, 403, 403]


def test_ports_behind_the_door_answer_nobody_else() -> None:
    def serve() -> None:
        async def until_stopped() -> None:
            nonlocal stop
            stop = asyncio.Event()
            async with websockets.asyncio.server.serve(lambda _: None, "127.0.0.1", 0) as server:
                ports.put((server.sockets[0].getsockname()[1], asyncio.get_running_loop()))
                await stop.wait()

        asyncio.run(until_stopped())

    ports: queue.Queue[tuple[int, asyncio.AbstractEventLoop]] = queue.Queue()
    stop = asyncio.Event()
    for secret in ("right", None):
        with contextlib.nullcontext() if secret is None else guarded(secret):
            threading.Thread(target=serve, daemon=True).start()
            port, loop = ports.get(timeout=10)
        if secret is None:
            with pytest.raises(CagemapError, match="refuse strangers"):
                require_guarded(port)
        else:
            require_guarded(port)
            assert answer(port, "/", X_Cagemap_Door="wrong").status == 403
            # Let in, where it is told that it should have asked for a web socket.
            assert answer(port, "/", X_Cagemap_Door="right").status == 426
        loop.call_soon_threadsafe(stop.set)
