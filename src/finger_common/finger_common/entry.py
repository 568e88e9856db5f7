# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Start of every command and node: Ctrl-C ends it without a traceback, also while it loads.

`setup.cfg` names a function as ``finger_common.entry:finger_bag.cli.main``: it is imported when it
is called, under guard. ``python -m finger_common.entry finger_bag.cli info BAG`` does the same for
the ``main`` of a module.
This module imports nothing that takes time.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from typing import Any

EXIT_INTERRUPTED = 130


def command_of(module: str) -> tuple[str, ...]:
    """Command that runs a module's ``main`` with this Python; its arguments follow."""
    return (sys.executable, "-m", __name__, module)


def _end(number: int, frame: Any) -> None:
    os._exit(EXIT_INTERRUPTED)


def start(path: str) -> Any:
    """Import the function ``module.name`` and return what it returns, or 130 after Ctrl-C.

    While it is imported, and when it has returned, Ctrl-C ends the process at once: compiled
    modules may turn a KeyboardInterrupt into any other error. A SIGINT that the caller ignores
    stays ignored.
    """
    usual = signal.getsignal(signal.SIGINT)
    guarded = usual is signal.default_int_handler
    if guarded:
        signal.signal(signal.SIGINT, _end)
    module, _, name = path.rpartition(".")
    main = getattr(importlib.import_module(module), name)
    try:
        if guarded:
            signal.signal(signal.SIGINT, usual)
        return main()
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    finally:
        if guarded:
            signal.signal(signal.SIGINT, _end)


class _Function:
    """A function by its dotted path, imported when it is called."""

    def __init__(self, path: str) -> None:
        self._path = path

    def __getattr__(self, name: str) -> _Function:
        return _Function(f"{self._path}.{name}")

    def __call__(self) -> Any:
        return start(self._path)


def __getattr__(name: str) -> _Function:
    """The package `name`, for ``finger_common.entry:name.module.function``."""
    if name.startswith("_"):
        raise AttributeError(name)
    return _Function(name)


if __name__ == "__main__":
    sys.argv = sys.argv[1:]
    sys.exit(start(f"{sys.argv[0]}.main"))
