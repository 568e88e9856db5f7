"""Keeps a set of processes running: started in order, logged with prefixes, restarted, ended together.

No ROS here: a process is a command. `finger-rig up` runs the node table through it where launch_ros is missing.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from finger_common.errors import FingerError
from finger_common.processes import bound_to_parent

COLOURS = (36, 33, 32, 35, 34, 96, 93, 92, 95, 94)
"""ANSI foreground colours of the prefixes, in the order of the processes."""


@dataclass(frozen=True)
class ProcessSpec:
    """One process to keep running.

    rank: processes of a rank start when those of lower ranks are ready; they end in the reverse order.
    ready_text: text in a line of output that says the process is ready; None: ready once started.
    respawn: start again when it ends by itself. essential: its end ends everything.
    """

    name: str
    command: tuple[str, ...]
    rank: int = 0
    ready_text: str | None = None
    respawn: bool = True
    essential: bool = False
    environment: tuple[tuple[str, str], ...] = ()


@dataclass
class _Running:
    spec: ProcessSpec
    colour: int
    process: subprocess.Popen[str] | None = None
    reader: threading.Thread | None = None
    ready: threading.Event = field(default_factory=threading.Event)
    restarts: int = 0
    deaths_in_a_row: int = 0
    started: float = 0.0
    restart_at: float | None = None


class Supervisor:
    """Runs processes until `stop`, or until an essential one ends. When the supervisor itself is killed, they end, too.

    respawn_delay: s before the first restart, doubled for each further one up to `longest_delay`, back to the
    first after a minute without a death. `line` receives every line of output as (process, text); None prints
    it with a coloured prefix.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        line: Callable[[str, str], None] | None = None,
        respawn_delay: float = 1.0,
        longest_delay: float = 15.0,
        ready_timeout: float = 60.0,
    ) -> None:
        self._running = {
            spec.name: _Running(spec, COLOURS[i % len(COLOURS)]) for i, spec in enumerate(specs)
        }
        self._width = max((len(spec.name) for spec in specs), default=0)
        self._line = line or self._print
        self._respawn_delay = respawn_delay
        self._longest_delay = longest_delay
        self._ready_timeout = ready_timeout
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._monitor: threading.Thread | None = None
        self._idle = threading.Event()
        self._stopped = threading.Event()
        self._ended = threading.Event()
        self.exit_code = 0

    # What a caller does ------------------------------------------------------------------------

    def start(self) -> None:
        """Start all processes in order; raises FingerError when one does not become ready, after ending all."""
        try:
            ranks = sorted({r.spec.rank for r in self._running.values()})
            for rank in ranks:
                group = [r for r in self._running.values() if r.spec.rank == rank]
                for running in group:
                    self._start(running)
                for running in group:
                    self._await_ready(running)
        except BaseException:
            self.stop()
            raise
        self._monitor = threading.Thread(target=self._watch, name="supervisor", daemon=True)
        self._monitor.start()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until `stop` was called or an essential process ended; false on timeout."""
        return self._ended.wait(timeout)

    def stop(self, patience: float = 8.0) -> None:
        """End all processes, highest rank first: SIGINT, then SIGTERM, then SIGKILL. Safe to call twice."""
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
                        self._say(running.spec.name, f"does not end, sent {sign.name}")
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

    # How it does it ----------------------------------------------------------------------------

    def _start(self, running: _Running) -> None:
        # A group of its own: Ctrl-C in the terminal reaches only the supervisor, which ends all in order.
        process = subprocess.Popen(
            bound_to_parent(running.spec.command),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            errors="replace",
            start_new_session=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **dict(running.spec.environment)},
        )
        with self._lock:
            running.process = process
            running.started = time.monotonic()
            running.restart_at = None
        if running.spec.ready_text is None:
            running.ready.set()
        running.reader = threading.Thread(
            target=self._read, args=(running, process), name=running.spec.name, daemon=True
        )
        running.reader.start()

    def _read(self, running: _Running, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for text in process.stdout:
            text = text.rstrip("\n")
            self._line(running.spec.name, text)
            if running.spec.ready_text is not None and running.spec.ready_text in text:
                running.ready.set()

    def _await_ready(self, running: _Running) -> None:
        deadline = time.monotonic() + self._ready_timeout
        while not running.ready.wait(0.05):
            assert running.process is not None
            code = running.process.poll()
            if code is not None:
                raise FingerError(
                    f"'{running.spec.name}' ended with exit code {code} before it was ready; see its output"
                )
            if time.monotonic() > deadline:
                raise FingerError(
                    f"'{running.spec.name}' was not ready within {self._ready_timeout:g} s; see its output"
                )

    def _watch(self) -> None:
        while not self._stopping.wait(0.1):
            for running in self._running.values():
                self._look_at(running)
        self._idle.set()
        # What this thread started again would be told to end with it, out of order.
        self._stopped.wait()

    def _look_at(self, running: _Running) -> None:
        now = time.monotonic()
        if running.restart_at is not None:
            if now >= running.restart_at:
                running.restarts += 1
                self._start(running)
                self._say(running.spec.name, "started again")
            return
        if running.process is None:
            return
        code = running.process.poll()
        if code is None:
            return
        how = f"ended with exit code {code}" if code >= 0 else f"was ended by signal {-code}"
        if running.spec.essential:
            self._say(running.spec.name, f"{how}; ending all")
            running.process = None
            self.exit_code = code if code > 0 else int(code != 0)
            self._stopping.set()
            self._ended.set()
        elif running.spec.respawn:
            if now - running.started > 60.0:
                running.deaths_in_a_row = 0
            delay = min(self._respawn_delay * 2**running.deaths_in_a_row, self._longest_delay)
            running.deaths_in_a_row += 1
            self._say(running.spec.name, f"{how}; starting it again in {delay:g} s")
            running.restart_at = now + delay
        else:
            self._say(running.spec.name, how)
            running.process = None

    @staticmethod
    def _signal(running: _Running, sign: signal.Signals) -> None:
        assert running.process is not None
        try:
            os.killpg(running.process.pid, sign)
        except ProcessLookupError:
            pass

    def _say(self, name: str, text: str) -> None:
        self._line(name, f"[supervisor] {name} {text}")

    def _print(self, name: str, text: str) -> None:
        prefix = f"{name:>{self._width}} |"
        if sys.stdout.isatty():
            prefix = f"\x1b[{self._running[name].colour}m{prefix}\x1b[0m"
        with self._lock:
            print(prefix, text, flush=True)
