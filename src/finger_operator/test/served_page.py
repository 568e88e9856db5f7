# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A running page server and clients of it, for the tests."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any

import aiohttp

from finger_common.namespaces import DEFAULT_NAMESPACE
from finger_operator.page.server import PageServer
from finger_operator.page.settings import PageSettings


class Served:
    """A running server and the commands that reached it."""

    def __init__(
        self,
        now: Callable[[], int] = time.time_ns,
        namespace: str = DEFAULT_NAMESPACE,
        **settings: Any,
    ) -> None:
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.server = PageServer(PageSettings(port=0, **settings), self.command, now, namespace)
        self.server.start()
        self.host = f"127.0.0.1:{self.server.port}"

    async def command(self, name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
        self.commands.append((name, arguments))
        return name != "skip", f"did {name}"

    def url(self, path: str = "/") -> str:
        return f"http://{self.host}{path}"

    def connect(
        self, session: aiohttp.ClientSession, view: str = "operator", token: str | None = None
    ) -> Any:
        path = f"/ws?view={view}&token={self.server.token if token is None else token}"
        return session.ws_connect(self.url(path), origin=f"http://{self.host}")


def run(coroutine: Callable[[aiohttp.ClientSession], Any]) -> Any:
    async def body() -> Any:
        async with aiohttp.ClientSession() as session:
            return await asyncio.wait_for(coroutine(session), 30)

    return asyncio.run(body())


async def served_all(socket: aiohttp.ClientWebSocketResponse) -> None:
    """Wait until the server has answered everything sent so far."""
    await socket.send_json({"type": "nonsense"})
    await next_of(socket, "answer")


async def received(socket: Any) -> Any:
    """The next message: JSON, or bytes of an image. Rounds are confirmed, as the page does."""
    while True:
        message = await asyncio.wait_for(socket.receive(), 10)
        assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        data = json.loads(message.data) if isinstance(message.data, str) else message.data
        if isinstance(data, bytes) or data["type"] != "round":
            return data
        await socket.send_json({**data, "type": "got"})


async def next_of(socket: Any, kind: str) -> dict[str, Any]:
    while True:
        data = await received(socket)
        if isinstance(data, dict) and data["type"] == kind:
            return data
