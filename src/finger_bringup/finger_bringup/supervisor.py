# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Keeps processes running: logged with prefixes, restarted, ended together and in order.

No ROS here: a process is a command.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from finger_common.cli import one_line
from finger_common.processes import bound_to_parent

from .restarts import FIRST_DELAY, LONGEST_DELAY, RestartDelay

COLOURS = (36, 33, 32, 35, 34, 96, 93, 92, 95, 94)
"""ANSI foreground colours of the prefixes, in the order of the processes."""


@dataclass(frozen=True)
class ProcessSpec:
    """One process to keep running.

    rank: processes of higher ranks end first. restart: start again when it ends by itself, unless
    it could not begin (see `RestartDelay.refused`). essential: its end ends everything.
    """

    name: str
    command: tuple[str, ...]
    rank: int = 0
    restart: bool = True
    essential: bool = False


@dataclass
class _Running:
    spec: ProcessSpec
    colour: int
    delay: RestartDelay
    process: subprocess.Popen[str] | None = None
    reader: threading.Thread | None = None
    restarts: int = 0
    started: float = 0.0
    restart_at: float | None = None


class Supervisor:
    """Runs processes until `stop`, or until an essential one or all of them have ended.

    line: receives every line of output as (process, text); None prints it with a coloured prefix.
    Its OSError and ValueError are passed over: that line is lost.
    first_delay, longest_delay: s before a restart, see `restarts`. When the supervisor itself is
    killed, its processes end, too.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        line: Callable[[str, str], None] | None = None,
        first_delay: float = FIRST_DELAY,
        longest_delay: float = LONGEST_DELAY,
    ) -> None:
        self._running = {
            spec.name: _Running(
                spec, COLOURS[i % len(COLOURS)], RestartDelay(first_delay, longest_delay)
            )
            for i, spec in enumerate(specs)
        }
        self._width = max((len(spec.name) for spec in specs), default=0)
        self._line = line or self.show
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._monitor: threading.Thread | None = None
        self._idle = threading.Event()
        self._stopped = threading.Event()
        self._ended = threading.Event()
        self.exit_code = 0

    # For callers -------------------------------------------------------------------------------

    def start(self) -> None:
        """Start all processes."""
        try:
            for running in self._running.values():
                self._start(running)
        except BaseException:
            self.stop()
            raise
        self._monitor = threading.Thread(target=self._watch, name="supervisor", daemon=True)
        self._monitor.start()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until `stop` was called or the processes have ended; false on timeout."""
        return self._ended.wait(timeout)

    def stop(self, patience: float = 8.0) -> None:
        """End all processes, highest rank first: SIGINT, then SIGTERM, then SIGKILL.

        patience: s before SIGTERM. Safe to call twice.
        """
        self._stopping.set()
        if self._monitor is not None:
            self._idle.wait()
        for rank in sorted({r.spec.rank for r in self._running.values()}, reverse=True):
            group = [r for r in self._running.values() if r.spec.rank == rank]
            for sign, wait in (
                (signal.SIGINT, patience),
                (signal.SIGTERM, 2.0),
                (signal.SIGKILL, 5.0),
            ):
                alive = [r for r in group if r.process is not None and r.process.poll() is None]
                if not alive:
                    break
                if sign != signal.SIGINT:
                    for running in alive:
                        self._report(running.spec.name, f"does not end, sent {sign.name}")
                for running in alive:
                    self._signal(running, sign)
                deadline = time.monotonic() + wait
                for running in alive:
                    assert running.process is not None
                    try:
                        running.process.wait(max(deadline - time.monotonic(), 0.01))
                    except subprocess.TimeoutExpired:
                        pass
        for running in self._running.values():
            if running.reader is not None:
                running.reader.join(2.0)
        self._stopped.set()
        self._ended.set()

    def alive(self) -> dict[str, bool]:
        """Whether each process runs now."""
        with self._lock:
            return {
                name: r.process is not None and r.process.poll() is None
                for name, r in self._running.items()
            }

    def restarts(self) -> dict[str, int]:
        """How often each process was started again."""
        with self._lock:
            return {name: r.restarts for name, r in self._running.items()}

    def process_id(self, name: str) -> int | None:
        """Process id of one process, None while it is down."""
        with self._lock:
            process = self._running[name].process
            return process.pid if process is not None and process.poll() is None else None

    def __enter__(self) -> Supervisor:
        self.start()
        return self

    def __exit__(self, *unused: object) -> None:
        self.stop()

    # Processes --------------------------------------------------------------------------------

    def _start(self, running: _Running) -> None:
        # A group of its own: Ctrl-C in the terminal reaches only the supervisor, which ends all in
        # order.
        process = subprocess.Popen(
            bound_to_parent(running.spec.command),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            errors="replace",
            start_new_session=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        with self._lock:
            running.process = process
            running.started = time.monotonic()
            running.restart_at = None
        running.reader = threading.Thread(
            target=self._read, args=(running, process), name=running.spec.name, daemon=True
        )
        running.reader.start()

    def _read(self, running: _Running, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for text in process.stdout:
            self._tell(running.spec.name, text.rstrip("\n"))

    def _watch(self) -> None:
        while not self._stopping.wait(0.1):
            for running in self._running.values():
                self._check(running)
        self._idle.set()
        # Processes that this thread restarted get SIGTERM when it ends: it must outlast them.
        self._stopped.wait()

    def _check(self, running: _Running) -> None:
        now = time.monotonic()
        if running.restart_at is not None:
            if now >= running.restart_at:
                self._start_again(running)
            return
        if running.process is None:
            return
        code = running.process.poll()
        if code is None:
            return
        how = f"ended with exit code {code}" if code >= 0 else f"was ended by signal {-code}"
        if running.spec.essential:
            self._report(running.spec.name, f"{how}; ending all")
            running.process = None
            self._end_all(code)
        elif running.spec.restart and not running.delay.note_end(code, now - running.started):
            delay = running.delay.after_running(now - running.started)
            self._report(running.spec.name, f"{how}; starting it again in {delay:g} s")
            running.restart_at = now + delay
        else:
            self._report(running.spec.name, f"{how}; it is not started again")
            running.process = None
            if not any(r.process for r in self._running.values()):
                self._end_all(code)

    def _end_all(self, code: int) -> None:
        self.exit_code = code if code > 0 else int(code != 0)
        self._stopping.set()
        self._ended.set()

    def _start_again(self, running: _Running) -> None:
        try:
            self._start(running)
        except OSError as error:  # no memory or no process left
            delay = running.delay.next()
            running.restart_at = time.monotonic() + delay
            text = f"cannot be started ({one_line(error)}); trying again in {delay:g} s"
            self._report(running.spec.name, text)
        else:
            running.restarts += 1
            self._report(running.spec.name, "started again")

    @staticmethod
    def _signal(running: _Running, sign: signal.Signals) -> None:
        assert running.process is not None
        try:
            os.killpg(running.process.pid, sign)
        except ProcessLookupError:
            pass

    def _report(self, name: str, text: str) -> None:
        self._tell(name, f"[supervisor] {name} {text}")

    def _tell(self, name: str, text: str) -> None:
        # A terminal that closed or a log on a full disk ends no process, nor what it waits for.
        with contextlib.suppress(OSError, ValueError):
            self._line(name, text)

    def show(self, name: str, text: str) -> None:
        """Print a line of a process with its coloured prefix."""
        prefix = f"{name:>{self._width}} |"
        if sys.stdout.isatty():
            prefix = f"\x1b[{self._running[name].colour}m{prefix}\x1b[0m"
        with self._lock:
            print(prefix, text, flush=True)
