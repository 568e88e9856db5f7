# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Child processes that do not outlive the process that started them."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Sequence

_BOUND = """
import ctypes, os, signal, sys
parent, command = int(sys.argv[1]), sys.argv[2:]
try:
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG
except (AttributeError, OSError):
    pass
if os.getppid() == parent:
    os.execvp(command[0], command)
"""


def bound_to_parent(command: Sequence[str | os.PathLike[str]]) -> list[str]:
    """The command, started so that SIGTERM reaches it when the *thread* that starts it ends, even
    by SIGKILL.

    Linux only; elsewhere the command is run as it is. Process id and exit code are the command's
    own.
    """
    return [
        *(sys.executable, "-I", "-S", "-c", _BOUND, str(os.getpid())),
        *(str(part) for part in command),
    ]


def end_with_parent() -> None:
    """Initializer of a pool's processes: they end at once when the process that started them is
    gone, even by SIGKILL, whatever they compute."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="parent", daemon=True).start()
