"""What answers on the network: who may ask, the files that are given out, and the web socket of a page."""

import asyncio
import http.client
import socket
from collections.abc import Iterator
from contextlib import closing, suppress
from typing import Any

import pytest
import websockets.asyncio.client
import websockets.exceptions
from websockets.datastructures import Headers
from websockets.http11 import Request

from cagemap.studio.page.server import Server, is_admitted


def request(path: str = "/", **headers: str) -> Request:
    return Request(
        path, Headers({"Host": "127.0.0.1:8765"} | {name.replace("_", "-"): v for name, v in headers.items()})
    )


def test_the_server_refuses_pages_of_other_sites() -> None:
    assert is_admitted(request(), None)
    assert is_admitted(request(Origin="http://127.0.0.1:8765"), None)
    assert not is_admitted(request(Origin="http://elsewhere.example"), None)
    assert not is_admitted(request(Origin="http://127.0.0.1:9999"), None)
    # A name of someone else's that resolves to this machine.
    assert not is_admitted(Request("/", Headers({"Host": "rebound.example:8765"})), None)
    # An image in another site's page names no origin; a link there may lead here.
    for site in ("cross-site", "same-site"):
        assert not is_admitted(request("/files/all.zip", Sec_Fetch_Site=site, Sec_Fetch_Mode="no-cors"), None)
        assert is_admitted(request(Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate"), None)
    assert is_admitted(request(Sec_Fetch_Site="same-origin", Sec_Fetch_Mode="cors"), None)
    # The page's own web socket, whatever a browser takes ws:// beside http:// for.
    own = {"Origin": "http://127.0.0.1:8765", "Upgrade": "websocket", "Sec_Fetch_Mode": "websocket"}
    assert is_admitted(request("/socket", Sec_Fetch_Site="cross-site", **own), None)


def test_the_server_asks_for_the_token() -> None:
    token = "right"
    assert is_admitted(request("/?token=right"), token)
    assert is_admitted(request(Cookie="cagemap_studio_8765=right"), token)
    both = "cagemap_studio_8766=other; cagemap_studio_8765=right"  # a browser sends those of every port
    assert is_admitted(request(Cookie=both), token)
    wrong = (request(Cookie=f"cagemap_studio_{cookie}") for cookie in ("8765=wrong", "8766=right"))
    for refused in (request(), request("/?token="), request("/?token=wrong"), *wrong):
        assert not is_admitted(refused, token)


def answer(port: int, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    return connection.getresponse()


def server(host: str = "127.0.0.1", token: str | None = None, **asked: Any) -> Server:
    usual = {
        "download": {}.get,
        "draw": {}.get,
        "first_messages": lambda: ("hello",),
        "on_message": lambda said, reply: reply(said),
    }
    return Server(host, 0, token, **(usual | asked))


def test_broken_requests_are_refused_without_a_traceback(caplog: pytest.LogCaptureFixture) -> None:
    with closing(server()) as served:
        assert answer(served.port, "//[").status == 403
        for broken in (b"POST / HTTP/1.1\r\n\r\n", b"\0" * 99 + b"\r\n", b"GET / HT", b"G" * 20_000):
            with socket.create_connection(("127.0.0.1", served.port), timeout=10) as stranger:
                stranger.sendall(broken)
                stranger.shutdown(socket.SHUT_WR)
                with suppress(ConnectionError):
                    assert b"200" not in stranger.recv(100)
        assert answer(served.port, "/").status == 200
    assert "handshake failed" not in caplog.text


def test_the_server_gives_out_only_what_is_offered() -> None:
    offered = {"cow.png": (b"png", "image/png"), "RESULT.html": (b"<b>", "text/html")}
    with closing(server(download=offered.get, draw={"source/skin/1": b"glb"}.get)) as served:
        got = answer(served.port, "/files/cow.png")
        assert (got.status, got.read()) == (200, b"png")
        assert got.headers["Content-Disposition"].startswith("attachment")
        assert "sandbox" in answer(served.port, "/files/RESULT.html").headers["Content-Security-Policy"]
        assert answer(served.port, "/drawn/source/skin/1").read() == b"glb"
        for path in ("/", "/page.js", "/three.min.js"):
            assert answer(served.port, path).status == 200
        refused = "/drawn/source/skin/0 /page.py /files/../cow.png /files/%2e%2e%2fcow.png /files/ /x"
        for path in (*refused.split(), "/../etc/passwd", "//etc/passwd"):
            assert answer(served.port, path).status == 404
        odd = ({"Host": "["}, {"Origin": "http://["})
        for stranger in ({"Host": "rebound.example"}, {"Origin": "http://elsewhere.example"}, *odd):
            assert answer(served.port, "/files/cow.png", **stranger).status == 403


def test_a_host_without_a_valid_port_is_refused() -> None:
    with closing(server(token="right")) as served:
        for path in ("/", "/?token=right"):
            assert answer(served.port, path, Host="localhost:99999").status == 403
            assert answer(served.port, path, Host="localhost:99999", Cookie="cagemap_studio_80=right").status == 403


def test_web_sockets_of_other_machines_need_the_token() -> None:
    async def said_back(address: str, **headers: str) -> object:
        try:
            async with websockets.asyncio.client.connect(address, additional_headers=headers) as page:
                await page.send("said")
                return [await page.recv() for _ in range(2)]
        except websockets.exceptions.InvalidStatus as error:
            return error.response.status_code

    async def all_of_them() -> list[object]:
        served = await asyncio.to_thread(server, "0.0.0.0", "right")
        address, cookie = f"ws://127.0.0.1:{served.port}/socket", {"Cookie": f"cagemap_studio_{served.port}=right"}
        strangers = (
            {},
            {"Cookie": f"cagemap_studio_{served.port}=wrong"},
            cookie | {"Origin": "http://elsewhere.example"},
        )
        found = [await said_back(address, **headers) for headers in (cookie, *strangers)]
        found.append(await said_back(address.replace("socket", "other"), **cookie))
        await asyncio.to_thread(served.close)
        return found

    assert asyncio.run(all_of_them()) == [["hello", "said"], 403, 403, 403, 404]


def test_a_change_while_a_page_connects_reaches_it() -> None:
    async def all_of_them() -> None:
        def first() -> Iterator[str]:
            yield "constants"
            served.send("change")
            yield "state" * 2_000_000  # longer than one write: what comes meanwhile is sent in between or after

        served = await asyncio.to_thread(server, first_messages=first)
        async with websockets.asyncio.client.connect(f"ws://127.0.0.1:{served.port}/socket", max_size=None) as page:
            received = [await asyncio.wait_for(page.recv(), 10) for _ in range(3)]
        assert [message[:9] for message in received] == ["constants", "statestat", "change"]
        await asyncio.to_thread(served.close)

    asyncio.run(all_of_them())


def test_every_page_is_told_and_a_fault_ends_one_page_alone(caplog: pytest.LogCaptureFixture) -> None:
    def heard(said: object, _: object) -> None:
        raise ZeroDivisionError(said)

    async def all_of_them() -> None:
        served = await asyncio.to_thread(server, on_message=heard)
        connect = websockets.asyncio.client.connect
        async with (
            connect(f"ws://127.0.0.1:{served.port}/socket") as one,
            connect(f"ws://127.0.0.1:{served.port}/socket") as other,
        ):
            assert [await page.recv() for page in (one, other)] == ["hello"] * 2
            await asyncio.sleep(0.1)
            served.send("news")
            assert [await page.recv() for page in (one, other)] == ["news"] * 2
            await one.send("bad")
            with pytest.raises(websockets.exceptions.ConnectionClosed):
                await one.recv()
            served.send("more")
            assert await other.recv() == "more"
        await asyncio.to_thread(served.close)

    asyncio.run(all_of_them())
    assert "a page was not answered" in caplog.text
