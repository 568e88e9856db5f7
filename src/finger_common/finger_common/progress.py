# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Progress of a command on standard error, with the time that is left.

On a terminal a bar per stage; otherwise (a file, a pipe, a batch system) a plain line per stage
every few seconds, and one at its end.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from .cli import plain

T = TypeVar("T")
S = TypeVar("S", bound="Stages")

LINE_PERIOD = 5.0
"""s between plain lines."""

SILENCE = 15.0
"""s without a line after which one says that work goes on."""


def duration_text(duration: float) -> str:
    """Seconds as a person reads them: 9 s, 4:07 min, 2:05 h."""
    whole = round(duration)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes}:{rest:02d} min"
    return f"{minutes // 60}:{minutes % 60:02d} h"


class Stages:
    """Shows the progress of named stages; a context manager.

    quiet: shows nothing. terminal: whether bars may be drawn, None to find out. line: receives the
    plain lines; None writes them to standard error. brief: nothing is left of a stage that was over
    before its first line was due, and of a bar.
    """

    def __init__(
        self,
        quiet: bool = False,
        terminal: bool | None = None,
        line: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
        brief: bool = False,
    ) -> None:
        terminal = sys.stderr.isatty() if terminal is None else terminal
        self._quiet = quiet
        self._brief = brief
        self._own_lines = line is None
        self._line = line or self._write
        self._clock = clock
        self._ended = threading.Event()
        self._last_line = self._last_update = clock()
        self._last_stage, self._last_finished = "", False
        self._began: dict[str, tuple[float, float]] = {}
        self._shown: dict[str, float] = {}
        self._finished: set[str] = set()
        self._tasks: dict[str, TaskID] = {}
        self._bars: Progress | None = None
        if terminal and not quiet:
            self._bars = Progress(
                TextColumn("{task.description:<22}"),
                BarColumn(),
                TextColumn("{task.percentage:3.0f} %"),
                TimeRemainingColumn(elapsed_when_finished=True),
                TextColumn("{task.fields[note]}"),
                console=Console(stderr=True),
                transient=brief,
            )

    def __enter__(self: S) -> S:
        if self._bars is not None:
            self._bars.start()
        elif self._own_lines and not self._quiet:
            threading.Thread(target=self._beats, daemon=True, name="progress").start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._bars is not None:
            self._bars.stop()

    def _beats(self) -> None:
        while not self._ended.wait(LINE_PERIOD):
            self.beat()

    def beat(self) -> None:
        """A line where none came for a while: what tells nothing is still running."""
        now, stage = self._clock(), self._last_stage
        if now - self._last_line < SILENCE:
            return
        if stage and not self._last_finished:
            self._say(f"{stage}: still running after {duration_text(now - self._began[stage][0])}")
            return
        since = duration_text(now - self._last_update)
        self._say(f"still running, {since} after the {f'end of {stage}' if stage else 'start'}")

    def _say(self, text: str) -> None:
        self._last_line = self._clock()
        self._line(text)

    def update(self, stage: str, done: float, total: float = 1.0, note: str = "") -> None:
        """How much of a stage is done, in any unit; the first call names it."""
        if self._quiet:
            return
        if self._bars is not None:
            if stage not in self._tasks:
                name = escape(stage)
                self._tasks[stage] = self._bars.add_task(name, total=total, note="")
            values: dict[str, Any] = {"completed": done, "total": total, "note": escape(note)}
            self._bars.update(self._tasks[stage], **values)
            return
        now = self._clock()
        finished = done >= total
        self._last_update, self._last_stage, self._last_finished = now, stage, finished
        if stage in self._finished and not finished:
            # It is done once more, with other values.
            self._finished.discard(stage)
            self._began[stage] = (now, done)
            self._shown[stage] = now
        first, at_first = self._began.setdefault(stage, (now, done))
        due = now - self._shown.get(stage, first) >= LINE_PERIOD
        due = due or (finished and not (self._brief and stage not in self._shown))
        if stage in self._finished or not due:
            return
        self._shown[stage] = now
        if finished:
            self._finished.add(stage)
            time_text = f"done in {duration_text(now - first)}"
        else:
            progress = done - at_first
            left = (now - first) * (total - done) / progress if progress > 0 else None
            time_text = f"{100 * done / total:.0f} %"
            time_text += "" if left is None else f", {duration_text(left)} left"
        self._say(": ".join([stage, ", ".join(filter(None, [time_text, note]))]))

    def track(self, items: Iterable[T], stage: str, total: int) -> Iterator[T]:
        """The items one by one, `total` in all, as a stage."""
        self.update(stage, 0, total)
        for number, item in enumerate(items, 1):
            yield item
            self.update(stage, number, total)

    def say(self, text: str) -> None:
        """Print a line on standard error, above the bars, also when quiet."""
        if self._bars is None:
            self._write(text)
        else:
            self._bars.console.print(plain(text), markup=False, highlight=False, soft_wrap=True)

    @staticmethod
    def _write(text: str) -> None:
        with suppress(OSError):  # nobody reads it any more; the work goes on
            print(plain(text), file=sys.stderr, flush=True)
