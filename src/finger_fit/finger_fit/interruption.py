# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Ctrl-C, SIGTERM and SIGHUP during a fit: its stage ends, and what was found is written.

A signal ends at once what is `interruptible`. In the rest of a block that is `kept`, such as
between two stages and while files are written, the first one waits for the next interruptible
block. Before anything is found, and without `signals_taken` (in a script, in a node), Ctrl-C raises
KeyboardInterrupt anywhere. Only the main thread is interrupted.
"""

from __future__ import annotations

import os
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from finger_common.cli import end_workers, in_main_thread


@dataclass
class _State:
    """keeps: what is found is worth writing; found: there is something; ends: a signal ends what
    runs; waiting: one came while it did not."""

    keeps: bool = False
    found: bool = False
    ends: bool = False
    waiting: bool = False


_state = _State()


class _Interrupted(KeyboardInterrupt):
    """number: the signal that comes again where this is dropped."""

    def __init__(self, number: int) -> None:
        self.number = number


@contextmanager
def _set(**values: bool) -> Iterator[None]:
    if not in_main_thread():
        yield
        return
    before = dict(vars(_state))
    try:
        vars(_state).update(values)
        if _state.ends and _state.waiting:
            _state.waiting = False
            raise KeyboardInterrupt
        yield
    finally:
        vars(_state).update({name: before[name] for name in values})


def kept() -> Any:
    """A block whose results are worth writing, as soon as `found_something` is called."""
    return _set(keeps=True, found=False)


def found_something() -> None:
    """From here on, an interruption of a block that is kept leaves results."""
    if in_main_thread():
        _state.found = True


def not_kept() -> Any:
    """A part of it that leaves no results when it is interrupted."""
    return _set(keeps=False)


def interruptible() -> Any:
    """A part of it that KeyboardInterrupt may end; the caller keeps what was found."""
    return _set(ends=True)


@contextmanager
def signals_taken(say: Callable[[str], None]) -> Iterator[list[int]]:
    """Let signals interrupt what is kept, and say so at once; gives the list of the one that did.

    The first signal counts. After it, Ctrl-C raises KeyboardInterrupt anywhere, and SIGTERM and
    SIGHUP, which may come in pairs, do nothing. Signals that are ignored stay so. One that compiled
    code drops comes again (finger_common.cli), and is no second one.
    """
    before: dict[int, Any] = {}
    taken: list[int] = []
    if not in_main_thread():
        yield taken
        return
    again = False

    def take(number: int, frame: Any) -> None:
        nonlocal again
        if not (_state.keeps and _state.found):
            before[number](number, frame)
        elif again:
            again = False
            if _state.waiting and _state.ends:
                _state.waiting = False
                raise _Interrupted(number)
        elif taken:
            if number == signal.SIGINT:
                raise _Interrupted(number)
        else:
            taken.append(number)
            name, second = signal.Signals(number).name, "Ctrl-C gives them up"
            if number == signal.SIGINT:
                name, second = "interrupted", "Ctrl-C again gives them up"
            else:
                end_workers()
                _leave_closed_terminal()
            with suppress(OSError, RuntimeError):  # closed; or in the middle of another line
                say(f"{name}: writing the results so far; {second}")
            _state.waiting = not _state.ends
            if _state.ends:
                raise _Interrupted(number)

    hook = sys.unraisablehook

    def dropped(lost: Any) -> None:
        nonlocal again
        if taken and isinstance(lost.exc_value, KeyboardInterrupt):
            again = _state.waiting = True
        hook(lost)

    sys.unraisablehook = dropped
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if callable(usual := signal.getsignal(number)):
            before[number] = usual
            signal.signal(number, take)
    try:
        yield taken
    except KeyboardInterrupt:
        if taken and taken[0] != signal.SIGINT:
            before[taken[0]](taken[0], None)
        raise
    finally:
        _state.waiting = False
        sys.unraisablehook = hook
        for of, usual in before.items():
            if signal.getsignal(of) is take:
                signal.signal(of, usual)


def _leave_closed_terminal() -> None:
    """Print to nobody what would go to a terminal that is gone: the write would fail."""
    for stream in (1, 2):
        with suppress(OSError):
            if stat.S_ISCHR(os.fstat(stream).st_mode) and not os.isatty(stream):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
