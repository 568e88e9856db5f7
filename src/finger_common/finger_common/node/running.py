# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A node as a process: start, signals, end."""

from __future__ import annotations

import inspect
import os
import signal
import sys
import tempfile
import textwrap
import threading
import time
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logging_directory
from rclpy.signals import SignalHandlerOptions

from ..cli import EXIT_BAD_INPUT, one_line
from ..errors import FingerError, InputError
from ..stamps import LAST_STAMP, NANOSECONDS
from .managed import ManagedNode

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a node; SIGHUP comes when its terminal is closed."""

FAREWELL = 1.0
"""s at most in which a node that ends answers those who wait for it."""
DELIVERY = 0.25
"""s for an answer to be delivered."""


def use_large_shared_memory() -> None:
    """Let Fast DDS pass whole images through shared memory.

    To be called before rclpy.init by a process that publishes images. A transport named in the
    environment (FASTRTPS_DEFAULT_PROFILES_FILE, FASTDDS_BUILTIN_TRANSPORTS) takes precedence.
    """
    if "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
        profile = Path(__file__).parents[1] / "data" / "fastdds.xml"
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))


def handle_end_signals(handler: Callable[[int, Any], None]) -> None:
    """Call `handler` on every signal that ends a node; SIGHUP stays ignored under nohup."""
    for number in END_SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


class _SignalHandler:
    """Ends a node's main thread on a signal of END_SIGNALS.

    rclpy's own handlers end the context at once, before a node could publish its last state. Here
    a signal interrupts what comes before `spin`; during it, the running callback is finished first,
    unless a second signal comes more than a second later. An interruption may be lost in a callback
    of compiled code, such as that of the compiler; the wish to end stays.
    """

    def __init__(self, executor: SingleThreadedExecutor) -> None:
        self._executor = executor
        self._spinning = False
        self._requested_at: float | None = None
        self.interrupted = False
        """Whether a signal has interrupted what the main thread did."""
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        handle_end_signals(self._on_signal)
        # Python's handlers run only when the main thread is back from the middleware.
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=self._wake, args=(reading,), name="signals", daemon=True).start()
        sys.unraisablehook = self._on_lost

    def _on_signal(self, number: int, frame: Any) -> None:
        now = time.monotonic()
        first, self._requested_at = self._requested_at, self._requested_at or now
        if not self._spinning or (first is not None and now - first > 1.0):
            self.interrupted = True
            raise KeyboardInterrupt

    @staticmethod
    def _on_lost(lost: Any) -> None:
        """Python's report of an exception that nobody can catch; none of an interruption."""
        if lost.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(lost)

    def _wake(self, reading: int) -> None:
        while os.read(reading, 64):
            self._executor.wake()

    def spin(self) -> None:
        """Serve callbacks until a signal comes."""
        self._spinning = True
        while self._requested_at is None:
            self._executor.spin_once()


def say_farewell(node: ManagedNode, executor: SingleThreadedExecutor) -> None:
    """Let a released node answer those who wait for it, before it is destroyed."""
    if not node.answering:
        return
    end = time.monotonic() + FAREWELL
    while node.answering and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    end = time.monotonic() + DELIVERY
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)


def begin_ros(arguments: Sequence[str] | None) -> None:
    """rclpy.init for a process that handles its signals itself and may publish images.

    arguments: None for those of the process. Raises InputError when the system clock is outside the
    times that messages hold, the folder of the logs cannot be written, or the arguments cannot be
    used.
    """
    now = time.time_ns()
    if not 0 <= now <= LAST_STAMP:
        day = datetime(1970, 1, 1) + timedelta(seconds=now // NANOSECONDS)
        raise InputError(
            f"the system clock says {day} UTC, messages hold the years 1970 to 2037; set the clock"
        )
    use_large_shared_memory()
    try:
        rclpy.init(
            args=list(arguments) if arguments is not None else None,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except Exception as error:
        raise InputError(_why_not_begun(error)) from None


def _why_not_begun(error: Exception) -> str:
    """Sentence on an rclpy.init that failed: by the folder of the logs, or by the arguments."""
    folder = Path("~/.ros/log")
    try:
        folder = get_logging_directory()
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError) as problem:  # RuntimeError: there is no HOME
        reason = getattr(problem, "strerror", None) or one_line(problem)
        return (
            f"logs cannot be written to {folder} ({reason}); set ROS_LOG_DIR to a folder that can "
            "be written"
        )
    return (
        f"ROS arguments cannot be used ({one_line(error)}); check the parameter file and --ros-args"
    )


def run_node(
    node_class: type[ManagedNode], argv: Sequence[str] | None = None, name: str = ""
) -> int:
    """Run one node until a signal ends it; returns the exit code, 2 for one that could not begin.

    A configuration that fails leaves the node up, unconfigured, so that parameters can be corrected
    and the transition tried again; it ends a node of one task, which nobody corrects. SIGINT,
    SIGTERM and SIGHUP end it with the device released.

    name: of the command that runs the node, before the sentence on its failure; the node's where it
    is empty.
    """
    name = name or node_class.NAME
    try:
        begin_ros(argv)
    except InputError as error:
        print(f"{name}: {one_line(error)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    node: ManagedNode | None = None
    executor = SingleThreadedExecutor()
    handler = _SignalHandler(executor)
    try:
        node = node_class()
        node.interrupted = lambda: handler.interrupted
        executor.add_node(node)
        if node.autostart and not node.bring_up() and node.ONE_TASK and node.refused is not None:
            raise node.refused
        handler.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except FingerError as error:
        print(f"{name}: {one_line(error)}", file=sys.stderr)
        began = node is not None and node.active and not node.ONE_TASK
        return 1 if began else EXIT_BAD_INPUT
    finally:
        # A second Ctrl-C during release would leave devices open.
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.release()
            say_farewell(node, executor)
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
    return node.exit_code if node is not None else 0


def help_text(node_class: type[ManagedNode]) -> str:
    """What `--help` of a node's executable prints; a plain ROS node ignores it, and starts."""
    doc = inspect.getdoc(inspect.getmodule(node_class)) or ""
    lines = [
        doc,
        "",
        "usage: --ros-args [-p NAME:=VALUE …] [--params-file FILE]",
        "",
        "parameters:",
    ]
    for parameter in node_class.parameter_table():
        unit = f" {parameter.unit}" if parameter.unit else ""
        lines.append(f"  {parameter.name} ({parameter.default!r}{unit})")
        lines.append(textwrap.indent(textwrap.fill(parameter.meaning, 90), 6 * " "))
    return "\n".join(lines)


def main_of(node_class: type[ManagedNode], name: str = "") -> Any:
    """`main` function of a node's executable; its `node_class` is for processes of many nodes.

    name: as of `run_node`.
    """

    def main(argv: Sequence[str] | None = None) -> None:
        if {"-h", "--help"} & set(sys.argv[1:] if argv is None else argv):
            print(help_text(node_class))
            return
        code = run_node(node_class, argv, name)
        # Daemon threads of the middleware can hang at interpreter exit.
        os._exit(code)

    main.node_class = node_class  # type: ignore[attr-defined]
    return main
