# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One connected browser: what waits to be sent to it, and the order in which it is sent.

Cues and answers are sent at once and never dropped. Everything else goes in rounds; the next round
waits until the page says that it has the last one, so that never more than one is on its way. Of
what waits, only the newest of its kind is kept, and an image is made smaller until a round takes a
fraction of a second. So a slow link loses frame rate and detail, and what it shows is not old.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from aiohttp import web

POINTS_LIMIT = 5000
"""Points of a curve that wait for a browser; a slow one misses the rest."""

ROUND = (0.1, 0.2)
"""s that a round may take: below, images may be larger; above, they must be smaller."""

IMAGE_BYTES = (2_000, 50_000, 1_000_000)
"""Bytes of an image: the smallest limit, the first, the largest."""

READABLE = (12_000, 0.5)
"""Bytes that leave an outline and a scale bar readable, and s that a round may take before an image
has fewer: a machine that is busy for a moment must not spoil the picture."""


def smaller_image(jpeg: bytes, limit: int) -> bytes:
    """A JPEG of no more than `limit` bytes, or an eighth of the width: with fewer pixels."""
    data = np.frombuffer(jpeg, np.uint8)
    for reduced in (
        cv2.IMREAD_REDUCED_COLOR_2,
        cv2.IMREAD_REDUCED_COLOR_4,
        cv2.IMREAD_REDUCED_COLOR_8,
    ):
        if len(jpeg) <= limit:
            break
        image = cv2.imdecode(data, reduced)
        if image is None:
            break
        jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 60])[1].tobytes()
    return jpeg


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
    image: tuple[bytes, bytes] | None = None
    """Head and JPEG of the newest image."""
    image_bytes: int = IMAGE_BYTES[1]
    """Largest image that the link takes."""
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    cue_waits: asyncio.Event = field(default_factory=asyncio.Event)
    transport: asyncio.BaseTransport | None = None
    sending_since: float | None = None
    """Monotonic time since which a round is being sent, or was sent and is not confirmed."""
    cue_since: float | None = None
    """Monotonic time since which a cue is being sent."""
    rounds: int = 0
    """Number of the last round."""
    confirmed: bool = True
    """Whether the page has the last round."""

    def add_cue(self, text: str) -> None:
        """A cue or an answer, to be sent before everything else."""
        self.cues.append(text)
        self.cue_waits.set()

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

    def add_image(self, head: bytes, jpeg: bytes) -> None:
        """The newest image, with the bytes that go before it."""
        self.image = (head, jpeg)
        self.wake.set()

    def confirm(self, number: int) -> None:
        """The page has the round of that number."""
        if number != self.rounds or self.confirmed:
            return
        took = time.monotonic() - (self.sending_since or time.monotonic())
        low, high = ROUND
        smallest, _, largest = IMAGE_BYTES
        readable, patience = READABLE
        if took > high:
            if took < patience:
                smallest = min(self.image_bytes, readable)
            self.image_bytes = max(self.image_bytes // 2, smallest)
        elif took < low or self.image_bytes < readable:
            self.image_bytes = min(self.image_bytes * 5 // 4, largest)
        self.confirmed, self.sending_since = True, None
        self.wake.set()

    def answer(self, number: Any, success: bool, sentence: str, unknown: bool = False) -> None:
        """Answer the command of that number. unknown: it may be carried out still."""
        number = number if isinstance(number, int) else None
        answer = {"type": "answer", "id": number, "success": success, "message": sentence}
        if unknown:
            answer["unknown"] = True
        self.add_cue(json.dumps(answer))

    def complain(self, sentence: str, number: Any = None) -> None:
        """Answer a message that cannot be used."""
        self.bad_messages += 1
        self.answer(number, False, sentence)

    def drop(self) -> None:
        """End the connection without waiting for what is not read."""
        if isinstance(self.transport, asyncio.WriteTransport):
            self.transport.abort()

    def stuck(self, since: float) -> bool:
        """Whether something that began to be sent before that monotonic time was not taken yet."""
        begun = (self.sending_since, self.cue_since)
        return any(at is not None and at < since for at in begun)

    async def send(self) -> None:
        """Send what waits until the browser goes away.

        Cues have a sender of their own: they do not wait until a round is made or taken.
        """
        await asyncio.gather(
            self._repeat(self.cue_waits, self._send_cues), self._repeat(self.wake, self._send_round)
        )

    async def _repeat(self, wake: asyncio.Event, send: Callable[[], Awaitable[None]]) -> None:
        # The browser may go away in the middle of a message; the reader notices and cleans up.
        with suppress(ConnectionError, RuntimeError):
            while not self.socket.closed:
                await wake.wait()
                wake.clear()
                await send()

    async def _send_cues(self) -> None:
        while self.cues:
            self.cue_since = time.monotonic()
            await self.socket.send_str(self.cues.popleft())
        self.cue_since = None

    async def _send_round(self) -> None:
        """Send the newest of everything; the page confirms the last message of it."""
        if not self.confirmed or not (self.newest or self.points or self.image):
            return
        self.sending_since = time.monotonic()
        self.confirmed, self.rounds = False, self.rounds + 1
        image, self.image = self.image, None
        if image and len(image[1]) > self.image_bytes:
            small = await asyncio.to_thread(smaller_image, image[1], self.image_bytes)
            image = (image[0], small)
        newest, self.newest = self.newest, {}
        points, self.points = self.points, {}
        for text in newest.values():
            await self.socket.send_str(text)
        if points:
            await self.socket.send_str(json.dumps({"type": "points", **points}))
        if image:
            await self.socket.send_bytes(b"".join(image))
        await self.socket.send_str(json.dumps({"type": "round", "id": self.rounds}))
