# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Keys that pause a replay, for one who types in a terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from .replay import Pause

HELP = "space bar: pause, go on; s: next message; Ctrl-C: end"
_LOOK = 0.1
"""s between two looks whether the replay has ended."""


@contextmanager
def pause_keys(pause: Pause) -> Iterator[None]:
    """The space bar pauses and goes on, and s gives the next message, while this lasts.

    Does nothing where standard input is no terminal, or belongs to another program.
    """
    try:
        keyboard = sys.stdin.fileno()
        ours = os.tcgetpgrp(keyboard) == os.getpgrp()
    except (AttributeError, OSError, ValueError):
        ours = False
    if not ours:
        yield
        return
    print(HELP, file=sys.stderr)
    before = termios.tcgetattr(keyboard)
    ended = threading.Event()
    thread = threading.Thread(target=_listen, args=(keyboard, pause, ended), name="keys")
    tty.setcbreak(keyboard)
    try:
        thread.start()
        yield
    finally:
        ended.set()
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)
        thread.join()


def _listen(keyboard: int, pause: Pause, ended: threading.Event) -> None:
    while not ended.is_set():
        if not select.select([keyboard], [], [], _LOOK)[0]:
            continue
        keys = os.read(keyboard, 64)
        if not keys:  # the terminal is gone
            return
        for key in keys.decode(errors="replace"):
            if key == " ":
                pause.toggle()
                print("paused" if pause.on else "goes on", file=sys.stderr)
            elif key == "s":
                pause.step()
