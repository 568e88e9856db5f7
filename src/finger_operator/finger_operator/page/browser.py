"""One connected browser: what waits to be sent to it, and the order in which it is sent.

Cues and answers are sent at once and never dropped. Of everything else only the newest of its kind
is kept, so that a slow tablet loses frame rate and nothing else.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from aiohttp import web

POINTS_LIMIT = 5000
"""Points of a curve that wait for a browser; a slow one misses the rest."""


@dataclass(eq=False)
class Browser:
    """operator: has the operator's page open. images: may receive images."""

    socket: web.WebSocketResponse
    operator: bool
    images: bool
    wants_images: bool = False
    bad_messages: int = 0
    cues: deque[str] = field(default_factory=deque)
    newest: dict[str, str] = field(default_factory=dict)
    points: dict[str, list[list[Any]]] = field(default_factory=dict)
    image: bytes | None = None
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    transport: asyncio.BaseTransport | None = None
    sending_since: float | None = None
    """Monotonic time at which a round of sending began that has not ended."""

    def add_cue(self, text: str) -> None:
        """A cue or an answer, to be sent before everything else."""
        self.cues.append(text)
        self.wake.set()

    def add_state(self, kind: str, text: str) -> None:
        """The newest state of a kind."""
        self.newest[kind] = text
        self.wake.set()

    def add_points(self, batch: list[tuple[str, list[Any]]]) -> None:
        """Points of the curves."""
        for kind, value in batch:
            values = self.points.setdefault(kind, [])
            if len(values) < POINTS_LIMIT:
                values.append(value)
        self.wake.set()

    def add_image(self, data: bytes) -> None:
        """The newest image."""
        self.image = data
        self.wake.set()

    def answer(self, number: Any, success: bool, sentence: str) -> None:
        """Answer the command of that number."""
        number = number if isinstance(number, int) else None
        answer = {"type": "answer", "id": number, "success": success, "message": sentence}
        self.add_cue(json.dumps(answer))

    def complain(self, sentence: str, number: Any = None) -> None:
        """Answer a message that cannot be used."""
        self.bad_messages += 1
        self.answer(number, False, sentence)

    def drop(self) -> None:
        """End the connection without waiting for what is not read."""
        if isinstance(self.transport, asyncio.WriteTransport):
            self.transport.abort()

    async def send(self) -> None:
        """Send what waits until the browser goes away; the only writer to its socket."""
        try:
            while not self.socket.closed:
                self.sending_since = None
                await self.wake.wait()
                self.wake.clear()
                self.sending_since = time.monotonic()
                await self._send_cues()
                newest, self.newest = self.newest, {}
                for text in newest.values():
                    await self.socket.send_str(text)
                    await self._send_cues()
                if self.points:
                    points, self.points = self.points, {}
                    await self.socket.send_str(json.dumps({"type": "points", **points}))
                await self._send_cues()
                if self.image is not None:
                    image, self.image = self.image, None
                    await self.socket.send_bytes(image)
        except (ConnectionError, RuntimeError):
            # The browser went away in the middle of a message; the reader notices and cleans up.
            pass

    async def _send_cues(self) -> None:
        while self.cues:
            await self.socket.send_str(self.cues.popleft())
