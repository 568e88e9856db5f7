# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A client of Foxglove's WebSocket protocol, written to its public description."""

from __future__ import annotations

import asyncio
import functools
import itertools
import json
import struct
import time
from collections.abc import Callable
from typing import Any

import aiohttp
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore


@functools.cache
def codec(name: str, text: str) -> tuple[Typestore, str]:
    """What reads and writes a type, from nothing but its announced definition."""
    # rosbags knows messages only; the definition of a request is written like one.
    message = name.replace("/srv/", "/msg/")
    store = Typestore()
    store.register(get_types_from_msg(text, message))
    return store, message


class FoxgloveClient:
    """Keeps what the server has announced and sent.

    `channels`, `services` by name as announced; `received` every message as (channel's topic, log
    time in ns, decoded message); `told` every other message of the server.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.received: list[tuple[str, int, Any]] = []
        self.told: list[dict[str, Any]] = []
        self._socket = socket
        self._numbers = itertools.count(1)
        self._subscribed: dict[int, str] = {}
        self._answers: dict[int, Any] = {}

    async def until(self, condition: Callable[[], Any]) -> Any:
        """Take messages of the server until a condition holds; gives what it gave."""
        while not (found := condition()):
            await self._take()
        return found

    async def _take(self) -> None:
        message = await asyncio.wait_for(self._socket.receive(), 120)
        if message.type is aiohttp.WSMsgType.BINARY:
            self._take_binary(message.data)
            return
        assert message.type is aiohttp.WSMsgType.TEXT, message
        data = json.loads(message.data)
        if data["op"] == "advertise":
            self.channels.update({channel["topic"]: channel for channel in data["channels"]})
        elif data["op"] == "advertiseServices":
            self.services.update({service["name"]: service for service in data["services"]})
        elif "Unknown channel ID" in data.get("message", ""):
            # The server announces a channel a moment before it takes subscriptions to it.
            await asyncio.sleep(0.1)
            wanted = int(data["message"].rpartition(" ")[2].rstrip("."))
            for number, topic in self._subscribed.items():
                if self.channels[topic]["id"] == wanted:
                    await self._show(number, topic)
        elif data["op"] == "serviceCallFailure":
            self._answers[data["callId"]] = data["message"]
        else:
            self.told.append(data)

    def _take_binary(self, data: bytes) -> None:
        if data[0] == 1:
            subscription, log_time = struct.unpack_from("<IQ", data, 1)
            topic = self._subscribed[subscription]
            channel = self.channels[topic]
            assert channel["encoding"] == "cdr" and channel["schemaEncoding"] == "ros2msg"
            store, name = codec(channel["schemaName"], channel["schema"])
            self.received.append((topic, log_time, store.deserialize_cdr(data[13:], name)))
        elif data[0] == 3:
            service, call, length = struct.unpack_from("<III", data, 1)
            known = next(s for s in self.services.values() if s["id"] == service)["response"]
            store, name = codec(known["schemaName"], known["schema"])
            self._answers[call] = store.deserialize_cdr(data[13 + length :], name)

    async def subscribe(self, topic: str) -> int:
        """Show a topic, once it is announced; gives the number of the subscription."""
        await self.until(lambda: topic in self.channels)
        number = next(self._numbers)
        self._subscribed[number] = topic
        await self._show(number, topic)
        return number

    async def _show(self, number: int, topic: str) -> None:
        entry = {"id": number, "channelId": self.channels[topic]["id"]}
        await self._socket.send_json({"op": "subscribe", "subscriptions": [entry]})

    async def unsubscribe(self, number: int) -> None:
        await self._socket.send_json({"op": "unsubscribe", "subscriptionIds": [number]})

    async def next_of(self, topic: str) -> Any:
        """The next message of a topic that is shown."""
        start = len(self.received)
        return await self.until(
            lambda: next((m for t, _, m in self.received[start:] if t == topic), None)
        )

    async def parameters(self, *names: str) -> dict[str, Any]:
        """Values of parameters, of all without names."""
        number = str(next(self._numbers))
        await self._socket.send_json({"op": "getParameters", "parameterNames": names, "id": number})
        return await self._values(number)

    async def set_parameters(self, **values: Any) -> dict[str, Any]:
        """Set parameters, "node__parameter" for "/node.parameter"; gives the values in force."""
        number = str(next(self._numbers))
        parameters = [
            {"name": "/" + name.replace("__", "."), "value": value}
            for name, value in values.items()
        ]
        await self._socket.send_json(
            {"op": "setParameters", "parameters": parameters, "id": number}
        )
        return await self._values(number)

    async def _values(self, number: str) -> dict[str, Any]:
        answer = await self.until(
            lambda: next((m for m in self.told if m.get("id") == number), None)
        )
        return {p["name"]: p.get("value") for p in answer["parameters"]}

    async def call(self, service: str, fields: tuple[Any, ...] = ()) -> Any:
        """Call a service; gives the response, or the sentence of a failure."""
        known = await self.until(lambda: self.services.get(service))
        request = known["request"]
        store, name = codec(request["schemaName"], request["schema"])
        payload = bytes(store.serialize_cdr(store.types[name](*fields), name))
        number = next(self._numbers)
        head = struct.pack("<BIII", 2, known["id"], number, 3) + b"cdr"
        await self._socket.send_bytes(head + payload)
        return await self.until(lambda: self._answers.get(number))


async def with_client(port: int, body: Callable[[FoxgloveClient], Any]) -> Any:
    """Run a coroutine with a client of the server on that port, once the server is there."""
    async with aiohttp.ClientSession() as session:
        until = time.monotonic() + 120
        while time.monotonic() < until:
            try:
                url = f"ws://127.0.0.1:{port}"
                async with session.ws_connect(url, protocols=["foxglove.sdk.v1"]) as socket:
                    return await asyncio.wait_for(body(FoxgloveClient(socket)), 240)
            except aiohttp.ClientConnectorError:
                await asyncio.sleep(0.1)
        raise AssertionError("Foxglove is not served")
