# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Child processes that do not outlive the process that started them, and threads side by side."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from threadpoolctl import threadpool_limits

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""What `map` is: results of a function in the order of its arguments."""

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


def begin_worker() -> None:
    """Initializer of a pool's processes: they end at once when the process that started them is
    gone, even by SIGKILL, whatever they compute, and linear algebra takes one thread in each."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # libraries that are loaded later
    threadpool_limits(1)
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    for number in (signal.SIGTERM, signal.SIGHUP):  # a fork took the parent's handlers over
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
            signal.signal(number, signal.SIG_DFL)

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="parent", daemon=True).start()


class _Workers(ProcessPoolExecutor):
    """Processes that do not run the script which starts them, so that it needs no main guard."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        with _without_main():  # processes are started here
            return super().submit(function, *args, **kwargs)


def worker_pool(
    workers: int,
    initializer: Callable[..., object] = begin_worker,
    arguments: Sequence[Any] = (),
    *,
    needs_main: bool = False,
) -> ProcessPoolExecutor:
    """Processes for work of one's own, started anew: a fork of a process whose libraries run
    threads can deadlock.

    initializer: of each process; it calls `begin_worker`. needs_main: whether the work has classes
    or functions of the script that starts them. Then its code must be under a main guard.
    """
    kind = ProcessPoolExecutor if needs_main else _Workers
    spawn = multiprocessing.get_context("spawn")
    return kind(workers, spawn, initializer=initializer, initargs=tuple(arguments))


@contextmanager
def _without_main() -> Iterator[None]:
    """Processes started meanwhile do not run the main script again."""
    main = sys.modules["__main__"]
    names = [name for name in ("__file__", "__spec__") if name in vars(main)]
    hidden = [(name, vars(main).pop(name)) for name in names]
    main.__spec__ = None
    try:
        yield
    finally:
        for name, value in hidden:
            setattr(main, name, value)


@contextmanager
def in_threads(workers: int) -> Iterator[Map]:
    """A `map` that works in so many threads, each with linear algebra of its own."""
    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        yield pool.map
