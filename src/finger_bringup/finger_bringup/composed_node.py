# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Several nodes in one process.

    python -m finger_bringup.composed_node /hand/thumb=finger_driver.force_node \\
        /hand/thumb=finger_model.model_node --ros-args --params-file hand.yaml

Samples pass from force to model without the middleware (`finger_common.node.local`), and what is
loaded and compiled for one finger serves all.

Each node has a thread and an executor of its own, so that one that waits (for a device that is not
there, for a tare) holds up no other. A node whose callback raises is released and made again after
a delay, as the supervisor does it with a process; the others go on. Only what ends the process
itself, such as a crash in compiled code, ends all of them, and the supervisor starts them again.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger

from finger_common.cli import EXIT_BAD_INPUT, one_line
from finger_common.errors import FingerError, InputError
from finger_common.node import ManagedNode, begin_ros
from finger_common.node.running import handle_end_signals, say_farewell
from finger_common.priority import run_in_real_time

from .restarts import RestartDelay

SWITCH_INTERVAL = 5e-5
"""s after which a thread that computes lets another one run that has a sample to process."""

COMING_UP = 15.0
"""s at most in which threads alternate as usual (5 ms): switching costs a fifth of the start."""

LONGEST_END = 10.0
"""s in which a node has to end."""


class Member:
    """One node of the process, in a thread of its own.

    text: "NAMESPACE=MODULE" as on the command line; the module is that of a node of the suite.
    Raises InputError for another text.
    """

    def __init__(self, text: str) -> None:
        self.namespace, _, module = text.partition("=")
        try:
            self.node_class: type[ManagedNode] = importlib.import_module(module).main.node_class
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(
                f"'{text}': NAMESPACE=MODULE of a node of the suite is needed ({one_line(error)})"
            ) from None
        self.name = f"{self.namespace}/{self.node_class.NAME}"
        self.exit_code = 0
        self._ending = threading.Event()
        self._executor: SingleThreadedExecutor | None = None
        self._node: ManagedNode | None = None
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)

    def start(self) -> None:
        """Make the node and serve it."""
        self._thread.start()

    @property
    def active(self) -> bool:
        """Whether its node is there and active."""
        return self._node is not None and self._node.active

    def end(self) -> None:
        """Release the node; one that hangs is left behind."""
        self._ending.set()
        if self._executor is not None:
            self._executor.wake()
        self._thread.join(LONGEST_END)

    def _run(self) -> None:
        delay = RestartDelay()
        while not self._ending.is_set():
            started = time.monotonic()
            try:
                self._serve()
                continue
            except ExternalShutdownException:
                return
            except FingerError as error:
                reason = one_line(error)
            except Exception:
                reason = traceback.format_exc()
            wait = delay.after_running(time.monotonic() - started)
            get_logger("composed").error(
                f"{self.name} failed, the other nodes go on; it starts again in {wait:g} s: "
                f"{reason}"
            )
            self._ending.wait(wait)

    def _serve(self) -> None:
        """Make the node and serve its callbacks until the end, or until one of them raises."""
        executor = SingleThreadedExecutor()
        node: ManagedNode | None = None
        try:
            node = self.node_class(namespace=self.namespace)
            executor.add_node(node)
            self._executor, self._node = executor, node
            if node.autostart:
                node.bring_up()
            while not self._ending.is_set():
                executor.spin_once()
        finally:
            self._executor = self._node = None
            if node is not None:
                self._release(node)
                say_farewell(node, executor)
                self.exit_code = node.exit_code
                executor.remove_node(node)
                node.destroy_node()
            executor.shutdown()

    def _release(self, node: ManagedNode) -> None:
        try:
            node.release()
        except Exception:
            # Reported by the node; the next one of this name must be made all the same.
            pass


def _main(argv: Sequence[str]) -> int:
    at = argv.index("--ros-args") if "--ros-args" in argv else len(argv)
    parser = argparse.ArgumentParser(prog="composed_node", description="Several nodes at once.")
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("nodes", nargs="+", metavar="NAMESPACE=MODULE")
    arguments = parser.parse_args(argv[:at])
    try:
        members = [Member(text) for text in arguments.nodes]
        begin_ros(argv[at:])
    except InputError as error:
        print(f"composed_node: {one_line(error)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    ending = threading.Event()
    handle_end_signals(lambda *_: ending.set())
    for member in members:
        member.start()
    latest = time.monotonic() + COMING_UP
    while not all(member.active for member in members) and time.monotonic() < latest:
        if ending.wait(0.05):
            break
    sys.setswitchinterval(SWITCH_INTERVAL)
    if arguments.realtime:
        # Not before: kernels that are compiled must not keep everything else from the processor.
        refused = run_in_real_time()
        if refused:
            get_logger("composed").warning(f"{refused}; samples are late while others compute")
        else:
            get_logger("composed").info("in real time")
    ending.wait()
    # As the supervisor ends processes: the last one first, one after the other.
    for member in reversed(members):
        member.end()
    rclpy.try_shutdown()
    return max(member.exit_code for member in members)


def main(argv: Sequence[str] | None = None) -> Any:
    """Entry point."""
    code = _main(sys.argv[1:] if argv is None else argv)
    sys.stdout.flush()
    sys.stderr.flush()
    # Threads of the middleware can hang at interpreter exit.
    os._exit(code)


if __name__ == "__main__":
    main()
