# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Heartbeats of all nodes of a process, sent by one thread.

A timer of a node costs a round of rclpy's executor, a millisecond or more beside other work: those
of the ten nodes of a hand, four times a second, delayed its samples. Here a beat costs no more than
its message.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from rclpy.context import Context

from .shared import SharedInContext

HEARTBEAT = 0.25
"""s between heartbeats: what no diagnostic at 1 Hz can, they show a dead node within a second."""


class Heartbeats(SharedInContext):
    """The thread of one context, which calls every beat each 0.25 s, spread over that time."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._beats: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeats", daemon=True)
        self._thread.start()

    def add(self, beat: Callable[[], None]) -> None:
        """Call it from now on; it shall neither wait nor raise."""
        with self._lock:
            self._beats.append(beat)

    def remove(self, beat: Callable[[], None]) -> None:
        """Do not call it after this. May be called twice."""
        with self._lock:
            self._beats = [other for other in self._beats if other != beat]

    def end(self) -> None:
        self._ended.set()
        if self._thread is not threading.current_thread():
            self._thread.join(1.0)

    def _run(self) -> None:
        turn = 0
        # One after the other, so that a moment's work stays short.
        while not self._ended.wait(HEARTBEAT / max(len(self._beats), 1)):
            with self._lock:
                if self._beats:
                    turn = (turn + 1) % len(self._beats)
                    self._beats[turn]()
