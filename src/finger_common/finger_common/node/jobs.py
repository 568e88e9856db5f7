# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What other threads let a node do in its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from rclpy.node import Node

from ..errors import DeviceError

T = TypeVar("T")


class Jobs:
    """Does in a node's own thread, one after the other, what other threads ask for."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._waiting: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]]
        self._waiting = queue.SimpleQueue()
        self._open = True
        self._lock = threading.Lock()
        self._wake = node.create_guard_condition(self._serve)

    def call(self, action: Callable[[], T]) -> Future[T]:
        """Do something in the node's thread; the future has what it returns or raises.

        After `close`, and for what still waited then, that is a DeviceError.
        """
        future: Future[T] = Future()
        with self._lock:
            if self._open:
                self._waiting.put((future, action))
                self._wake.trigger()
                return future
        future.set_exception(DeviceError("the node is ending"))
        return future

    def close(self) -> None:
        """Do nothing more. To be called in the node's thread."""
        with self._lock:
            self._open = False
        self._node.destroy_guard_condition(self._wake)
        self._serve()

    def _serve(self) -> None:
        while not self._waiting.empty():
            future, action = self._waiting.get_nowait()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                if not self._open:
                    raise DeviceError("the node is ending")
                future.set_result(action())
            except Exception as error:
                future.set_exception(error)
