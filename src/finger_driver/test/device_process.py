# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Helpers of the driver tests.

Simulators in processes of their own, steered over their standard input, and the table that a
moisture probe's program writes; an observer of nodes.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from service_calls import call
from waiting import wait_until

from finger_common.processes import bound_to_parent
from finger_driver.simulators.netft import NetFtSimulator


class DeviceProcess:
    """`finger-device-sim …` in a process; `say` sends a command and waits until it is done."""

    def __init__(self, *arguments: object) -> None:
        self._child = subprocess.Popen(
            bound_to_parent(
                [sys.executable, "-m", "finger_driver.simulators.cli", *map(str, arguments)]
            ),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._lines: list[str] = []
        self._news = threading.Condition()
        self._answered = 0
        threading.Thread(target=self._listen, daemon=True).start()
        self.ready = self._wait(lambda: self._find("ready"), 90)

    def _listen(self) -> None:
        assert self._child.stdout is not None
        for line in self._child.stdout:
            with self._news:
                self._lines.append(line.strip())
                self._news.notify_all()

    def _find(self, start: str) -> str | None:
        return next((line for line in self._lines if line.startswith(start)), None)

    def _wait(self, condition: Callable[[], Any], seconds: float) -> Any:
        with self._news:
            if not self._news.wait_for(condition, seconds):
                raise AssertionError(f"no answer of the simulator: {self._lines}")
            return condition()

    def say(self, command: str) -> None:
        assert self._child.stdin is not None
        self._answered += 1
        self._child.stdin.write(command + "\n")
        self._child.stdin.flush()

        def answers() -> list[str]:
            return [line for line in self._lines if re.match("ok|refused", line)]

        self._wait(lambda: len(answers()) >= self._answered, 60)
        assert answers()[self._answered - 1].startswith("ok"), answers()[-1]

    def port(self, name: str) -> int:
        """Number behind a word of the line that says it is ready."""
        match = re.search(rf"{name} (\d+)", self.ready)
        assert match is not None, self.ready
        return int(match[1])

    @property
    def pid(self) -> int:
        """Process id."""
        return self._child.pid

    def close(self) -> None:
        if self._child.poll() is None:
            os.killpg(self._child.pid, signal.SIGTERM)
            try:
                self._child.wait(5)
            except subprocess.TimeoutExpired:
                os.killpg(self._child.pid, signal.SIGKILL)
                self._child.wait()


def netft_settings(box: DeviceProcess | NetFtSimulator, **further: object) -> dict[str, Any]:
    """Settings of the driver of a Net F/T box on this host."""
    own = isinstance(box, DeviceProcess)
    return {
        "device": "netft",
        "netft_host": "127.0.0.1",
        "netft_port": box.port("RDT port") if own else box.port,
        "netft_http_port": box.port("HTTP port") if own else box.http_port,
        **further,
    }


@contextlib.contextmanager
def device(*arguments: object) -> Iterator[DeviceProcess]:
    process = DeviceProcess(*arguments)
    try:
        yield process
    finally:
        process.close()


class Observer:
    """A node in this process that listens and calls services."""

    def __init__(self, domain: int) -> None:
        import rclpy
        import rclpy.executors

        self._rclpy = rclpy
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("observer", context=self.context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def listen(
        self,
        kind: Any,
        topic: str,
        depth: int = 200,
        reliable: bool = False,
        latched: bool = False,
    ) -> list[Any]:
        """Messages as they come; latched: also those from before the two have found each other."""
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        from finger_common.node import LATCHED_QOS

        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        profile = LATCHED_QOS if latched else QoSProfile(depth=depth, reliability=reliability)
        got: list[Any] = []
        self.node.create_subscription(kind, topic, got.append, profile)
        return got

    def until(
        self, condition: Callable[[], Any], seconds: float = 120, what: str = "an answer"
    ) -> Any:
        spin = partial(self._executor.spin_once, timeout_sec=0.05)
        return wait_until(condition, what, spin=spin, seconds=seconds)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        return call(self.node, kind, name, request, partial(self.until, what=name))

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._rclpy.shutdown(context=self.context)
