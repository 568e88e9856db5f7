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

HEARTBEAT = 0.25
"""s between heartbeats: what no diagnostic at 1 Hz can, they show a dead node within a second."""


class Heartbeats:
    """The thread of one context, which calls every beat each 0.25 s, spread over that time."""

    _all: dict[int, Heartbeats] = {}
    _making = threading.Lock()

    @classmethod
    def of(cls, context: Context) -> Heartbeats:
        """That of a context; it is made when it is first needed."""
        with cls._making:
            found = cls._all.get(id(context))
            if found is None or found.context is not context:
                found = cls._all[id(context)] = cls(context)
            return found

    def __init__(self, context: Context) -> None:
        self.context = context
        self._beats: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeats", daemon=True)
        self._thread.start()
        context.on_shutdown(self._end)

    def add(self, beat: Callable[[], None]) -> None:
        """Call it from now on; it shall neither wait nor raise."""
        with self._lock:
            self._beats.append(beat)

    def remove(self, beat: Callable[[], None]) -> None:
        """Do not call it after this. May be called twice."""
        with self._lock:
            self._beats = [other for other in self._beats if other != beat]

    def _end(self) -> None:
        """The context has ended: so does the thread, which must not outlive the interpreter."""
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
