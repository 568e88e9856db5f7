# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Requests to the recorder, sent one at a time and in order, by any service client."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

LEAVING = 0.2
"""s that a request has to leave before a process ends."""


class RecorderRequests:
    """Queue before the recorder's service.

    client: of the service. answered: called with (request, response or None, reason for None).
    """

    def __init__(self, client: Any, answered: Callable[[Any, Any, str], None]) -> None:
        self._client = client
        self._answered = answered
        self._waiting: deque[tuple[Any, float]] = deque()
        self._sent: tuple[Any, float, Any] | None = None

    @property
    def busy(self) -> bool:
        """Whether a request is waiting or has no answer yet."""
        return self._sent is not None or bool(self._waiting)

    def add(self, request: Any) -> None:
        """Send a request when those before it are answered."""
        self._waiting.append((request, time.monotonic()))

    def step(self, timeout: float) -> None:
        """Send what can be sent; give up after `timeout` s without recorder or without answer."""
        now = time.monotonic()
        if self._sent is not None:
            request, since, future = self._sent
            if now - since < timeout:
                return
            future.cancel()
            self._finish(request, None, "no answer")
        if not self._waiting:
            return
        request, since = self._waiting[0]
        if not self._client.service_is_ready():
            if now - since > timeout:
                self._waiting.popleft()
                self._finish(request, None, "the recorder is not running")
            return
        self._waiting.popleft()
        self._send(request, now)

    def send_all(self) -> None:
        """Send what waits although something is not answered yet: for an end, after which nobody
        steps, and the process may be gone.
        """
        while self._waiting and self._client.service_is_ready():
            self._send(self._waiting.popleft()[0], time.monotonic())
        if self._sent is not None:
            # The middleware sends from a thread of its own, and does not tell when it has.
            time.sleep(LEAVING)

    def _send(self, request: Any, now: float) -> None:
        future = self._client.call_async(request)
        self._sent = (request, now, future)
        future.add_done_callback(lambda done: self._on_answer(request, done))

    def _on_answer(self, request: Any, future: Any) -> None:
        if not future.cancelled():
            self._finish(request, future.result(), "")

    def _finish(self, request: Any, response: Any, reason: str) -> None:
        if self._sent is not None and self._sent[0] is request:
            self._sent = None
        self._answered(request, response, reason)
