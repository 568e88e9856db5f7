# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streams of a few messages a second that all nodes of a process wait for in one thread.

rclpy's executor asks after every entity of its node, some forty, whenever one message comes, which
takes a millisecond or more beside other work. Here a wait is for the streams alone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from .polling import PolledSubscription
from .shared import SharedInContext

_LONGEST_WAIT = 1.0
"""s after which the thread looks whether the context has ended."""

_TOGETHER = 0.001
"""s after a message in which the others of its instant come, those of a hand's other fingers: one
wait costs as much for all of them as for one."""


class WaitedSubscription:
    """A stream whose messages are delivered by the thread that the nodes of a process share.

    callback: called with each message, in that thread; it shall not wait. fail: called with the
    error when it raises; no further message is delivered then.
    """

    def __init__(
        self,
        node: Node,
        polled: PolledSubscription,
        callback: Callable[[Any], Any],
        fail: Callable[[Exception], None],
    ) -> None:
        self.polled = polled
        self._callback = callback
        self._fail = fail
        self._waiter = _Waiter.of(node.context)
        self._waiter.add(self)

    def deliver(self) -> None:
        """Pass on what has come."""
        try:
            for message in self.polled.messages():
                self._callback(message)
        except rclpy_implementation.InvalidHandle:
            self._waiter.remove(self)
        except Exception as error:
            self._waiter.remove(self)
            self._fail(error)

    def destroy(self) -> None:
        """End the subscription."""
        self._waiter.remove(self)
        self.polled.destroy()


class _Waiter(SharedInContext):
    """The thread of one context."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._streams: tuple[WaitedSubscription, ...] = ()
        self._change = threading.Lock()
        self._running = False
        handle = context.handle
        assert handle is not None, "the context is not initialised"
        with handle:
            self._guard = rclpy_implementation.GuardCondition(handle)
        self._thread: threading.Thread | None = None

    def add(self, stream: WaitedSubscription) -> None:
        """Deliver a stream."""
        with self._change:
            self._streams += (stream,)
            if not self._running:
                self._running = True
                self._thread = threading.Thread(target=self._run, name="streams", daemon=True)
                self._thread.start()
        self._wake()

    def remove(self, stream: WaitedSubscription) -> None:
        """Deliver a stream no longer. May be called twice."""
        with self._change:
            self._streams = tuple(s for s in self._streams if s is not stream)
        self._wake()

    def _wake(self) -> None:
        with self._guard:
            self._guard.trigger_guard_condition()

    def end(self) -> None:
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            self._wake()
            thread.join(_LONGEST_WAIT)

    def _run(self) -> None:
        while True:
            with self._change:
                streams = self._streams
                if not streams or not self.context.ok():
                    self._running = False
                    return
            try:
                self._wait(streams)
            except Exception:
                # The context may end at any time.
                if self.context.ok():
                    raise
                continue
            time.sleep(_TOGETHER)
            for stream in streams:
                stream.deliver()

    def _wait(self, streams: tuple[WaitedSubscription, ...]) -> None:
        """Wait for a message."""
        context = self.context.handle
        if context is None:
            return
        with ExitStack() as held:
            held.enter_context(context)
            held.enter_context(self._guard)
            handles = []
            for stream in streams:
                handle = stream.polled.handle
                try:
                    held.enter_context(handle)
                except rclpy_implementation.InvalidHandle:
                    continue
                handles.append(handle)
            waiting = rclpy_implementation.WaitSet(len(handles), 1, 0, 0, 0, 0, context)
            with waiting:
                waiting.clear_entities()
                for handle in handles:
                    waiting.add_subscription(handle)
                waiting.add_guard_condition(self._guard)
                waiting.wait(int(_LONGEST_WAIT * 1e9))
