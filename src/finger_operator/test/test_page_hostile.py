# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The page's server against clients that mean harm, break off or do not read."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import Iterator
from typing import Any

import aiohttp
import pytest
from served_page import Served, next_of, received, run
from waiting import wait_until

from finger_common.errors import InputError
from finger_operator.page import server
from finger_operator.page.access import from_this_machine, same_secret
from finger_operator.page.commands import check_command


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setattr(server, "PATIENCE", 0.5)
    served = Served()
    yield served
    served.server.stop()


def connection(served: Served) -> socket.socket:
    peer = socket.create_connection(("127.0.0.1", served.server.port))
    peer.settimeout(30)
    return peer


def closed(peer: socket.socket) -> bool:
    """Whether the server has closed a connection; waits for it."""
    try:
        while peer.recv(65536):
            pass
    except ConnectionResetError:
        pass
    except TimeoutError:
        return False
    return True


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("token", ["", "wrong", "%ED%A0%80"])
def test_the_operators_stream_needs_the_token_from_everywhere(
    served: Served, monkeypatch: pytest.MonkeyPatch, local: bool, token: str
) -> None:
    monkeypatch.setattr(server, "from_this_machine", lambda *request: local)
    served.server.publish("status", {"subject": "S01"})

    async def body(session: aiohttp.ClientSession) -> None:
        for view in ("operator", "", "Participant", "participant%20"):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await served.connect(session, view, token)
        async with served.connect(session, token=served.server.token) as socket_:
            assert (await next_of(socket_, "status"))["subject"] == "S01"

    run(body)


@pytest.mark.parametrize(
    ("headers", "local"),
    [
        ({"Host": "127.0.0.1:8080"}, True),
        ({"Host": "localhost:8080"}, True),
        ({"Host": "[::1]:8080"}, True),
        ({"Host": "localhost:9000"}, False),
        ({"Host": "127.0.0.1"}, False),
        ({"Host": "rig.example"}, False),
        ({"Host": "192.168.0.7:8080"}, False),
        ({"Host": "127.0.0.1:8080", "X-Forwarded-For": "10.0.0.9"}, False),
        ({"Host": "localhost", "Forwarded": "for=10.0.0.9"}, False),
        ({"Host": "["}, False),
        ({}, False),
    ],
)
def test_what_a_proxy_forwards_is_not_from_this_machine(
    headers: dict[str, str], local: bool
) -> None:
    assert from_this_machine("127.0.0.1", 8080, headers) is local
    assert not from_this_machine("10.0.0.9", 8080, headers)


def test_the_page_behind_a_proxy_needs_the_token(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        proxy = {"X-Forwarded-For": "10.0.0.9"}
        async with session.get(served.url(), headers=proxy) as page:
            assert page.status == 403 and served.server.token not in await page.text()
        async with session.get(served.url(f"/?token={served.server.token}"), headers=proxy) as page:
            assert page.status == 200

    run(body)


@pytest.mark.parametrize("token", ["\ud800", "\udfff" * 1000, "é", "", 3, None, ["x"], {"a": 1}])
def test_a_token_of_any_kind_is_refused_with_a_sentence(served: Served, token: Any) -> None:
    assert not same_secret(token, served.server.token)

    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session, token=served.server.token) as socket_:
            text = json.dumps({"type": "command", "name": "start", "token": token, "id": 7})
            await socket_.send_str(text)
            answer = await next_of(socket_, "answer")
            assert answer["id"] == 7 and "may not command" in answer["message"]

    run(body)
    assert served.commands == []


@pytest.mark.parametrize("text", ["a\ud800", "\0", "b\udfffc"])
def test_characters_that_ros_cannot_carry_are_refused(text: str) -> None:
    for message in (
        {"name": "preparation", "arguments": {"condition": "dry", "text": text}},
        {"name": "preparation", "arguments": {"condition": text, "text": "wash"}},
    ):
        with pytest.raises(InputError, match="not text"):
            check_command(message)


@pytest.mark.parametrize(
    "value", [10**400, -(10**400), 10**9, float("nan"), float("inf"), "1", None]
)
def test_a_number_of_any_size_is_refused_in_a_sentence(value: Any) -> None:
    for name, key in (("moisture", "value"), ("repeat", "index")):
        with pytest.raises(InputError, match=key):
            check_command({"name": name, "arguments": {key: value}})


HALVES = [
    b"",
    b"GET",
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1",
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 4000,
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nabc",
]


@pytest.mark.parametrize("half", HALVES, ids=["nothing", "verb", "header", "long", "body"])
def test_half_a_request_is_closed(served: Served, half: bytes) -> None:
    with connection(served) as peer:
        peer.sendall(half)
        assert closed(peer)


def test_a_request_that_trickles_in_is_closed(served: Served) -> None:
    with connection(served) as peer:
        peer.settimeout(0.05)
        peer.sendall(b"GET / HTTP/1.1\r\n")
        end = time.monotonic() + 30
        while True:
            assert time.monotonic() < end, "still open"
            try:
                peer.sendall(b"X-A: b\r\n")
                if not peer.recv(10):
                    break
            except TimeoutError:
                continue
            except ConnectionError:
                break


def test_a_browser_that_never_reads_is_dropped_and_others_are_served(served: Served) -> None:
    request = (
        f"GET /ws?token={served.server.token} HTTP/1.1\r\nHost: {served.host}\r\n"
        f"Origin: http://{served.host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    with connection(served) as peer:
        peer.sendall(request.encode())
        wait_until(lambda: served.server._browsers, "the connection")

        async def body(session: aiohttp.ClientSession) -> None:
            async with served.connect(session, token=served.server.token) as reader:
                await next_of(reader, "hello")
                number, end = 0, time.monotonic() + 30
                while len(served.server._browsers) > 1:
                    assert time.monotonic() < end, "still connected"
                    served.server.publish_cue(time.time_ns(), {"phase": number, "x": "x" * 100_000})
                    assert (await next_of(reader, "cue"))["phase"] == number
                    number += 1

        run(body)
        assert closed(peer)
    wait_until(lambda: not served.server._browsers, "both gone")


def test_a_browser_that_never_confirms_is_dropped(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as socket_:
            message = await socket_.receive()
            while message.type is aiohttp.WSMsgType.TEXT:
                message = await socket_.receive()
            assert socket_.closed

    run(body)


def test_an_answer_that_is_not_read_is_given_up(served: Served) -> None:
    with socket.socket() as peer:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        peer.connect(("127.0.0.1", served.server.port))
        one = f"GET /static/app.js HTTP/1.1\r\nHost: {served.host}\r\n\r\n".encode()
        peer.sendall(one * 300)
        time.sleep(2.0)
        peer.settimeout(30)
        assert closed(peer)


def test_a_quiet_browser_is_kept(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session, token=served.server.token) as socket_:
            await next_of(socket_, "hello")
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(received(socket_), 1.5)
            served.server.publish_cue(time.time_ns(), {"phase": "lift"})
            assert (await next_of(socket_, "cue"))["phase"] == "lift"

    run(body)


def test_many_connections_do_not_keep_a_browser_out(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "PATIENCE", 60.0)
    monkeypatch.setattr(server, "CONNECTIONS", 20)
    peers = [connection(served) for _ in range(200)]

    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session, token=served.server.token) as socket_:
            await next_of(socket_, "hello")

    run(body)
    assert closed(peers[0])
    for peer in peers:
        peer.close()


def test_nothing_of_it_raises_in_the_server(
    served: Served, caplog: pytest.LogCaptureFixture
) -> None:
    garbage = [b"\x16\x03\x01\x02\x00\x01", b"\0" * 1000, b"GET /\xff\xfe HTTP/1.1\r\n\r\n",
               b"GET / HTTP/9.9\r\n\r\n", b"GET / HTTP/1.1\r\nHost: \xed\xa0\x80\r\n\r\n",
               b"A" * 100_000]  # fmt: skip
    for data in [*garbage, *HALVES]:
        with connection(served) as peer:
            try:
                peer.sendall(data)
            except ConnectionError:
                continue
            assert closed(peer)
    assert "Traceback" not in caplog.text
