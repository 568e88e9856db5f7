# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where independent pieces of work run: in this process and its children, or on a Dask cluster.

A piece of work is `function(shared, item)`. Results are in the order of the items and do not depend
on where they were computed.
"""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from finger_common.errors import FingerError, InputError
from finger_common.processes import begin_worker, worker_pool

Work = Callable[[Any, Any], Any]
Done = Callable[[int, int], None]
"""Called with the number of items done, from 0, and their total."""


def _begin(done: Done | None, items: Sequence[Any]) -> None:
    if done is not None and items:
        done(0, len(items))


def available_cores() -> int:
    """Cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


class LocalEngine:
    """This machine.

    `map` runs in this process, one item after another, for work that uses all cores itself (the
    compiled reduced model). `spread` runs in one process per core, for work that uses one, in at
    most `processes` of them (None: no limit).
    """

    name = "this machine"

    def __init__(self, processes: int | None = None) -> None:
        self._processes = available_cores() if processes is None else processes

    def map(
        self, function: Work, shared: Any, items: Sequence[Any], done: Done | None = None
    ) -> list[Any]:
        """Results of function(shared, item), in order."""
        results = []
        _begin(done, items)
        for number, item in enumerate(items, 1):
            results.append(function(shared, item))
            if done is not None:
                done(number, len(items))
        return results

    def spread(
        self, function: Work, shared: Any, items: Sequence[Any], done: Done | None = None
    ) -> list[Any]:
        """Work as `map` does, in one process per core."""
        workers = min(self._processes, len(items))
        if workers < 2:
            return self.map(function, shared, items, done)
        results = []
        job = pickle.dumps((function, shared))
        _begin(done, items)
        with TemporaryDirectory() as folder:
            # In a file: a worker that ends before it has read it must not block this process.
            path = Path(folder) / "job.pickle"
            path.write_bytes(job)
            with worker_pool(workers, _set_job, (path,), needs_main=b"__main__" in job) as pool:
                try:
                    for number, result in enumerate(pool.map(_run_job, items), 1):
                        results.append(result)
                        if done is not None:
                            done(number, len(items))
                except BrokenProcessPool:
                    raise InputError(
                        "a worker process ended before its work was done: out of memory, or "
                        "classes of the script itself are used and its code is not under "
                        "'if __name__ == \"__main__\":'; free memory, or put it there"
                    ) from None
                except BaseException:
                    pool.shutdown(wait=False, cancel_futures=True)
                    raise
        return results

    def close(self) -> None:
        """Nothing to release."""


_job: tuple[Work, Any] | None = None
"""Function and shared data of a worker process of `LocalEngine.spread`."""


def _set_job(path: Path) -> None:
    global _job
    begin_worker()
    # Ctrl-C is for the parent process, which ends the pool.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _job = pickle.loads(path.read_bytes())


def _run_job(item: Any) -> Any:
    assert _job is not None
    return _job[0](_job[1], item)


class DaskEngine:
    """A Dask cluster.

    The work of a worker that dies is repeated by another, with the same result.
    """

    RETRIES = 10
    """Times that one item is repeated after the death of its worker."""

    def __init__(self, address: str, timeout: float = 10.0) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(
                "dask: the package 'distributed' is not installed; pip install distributed"
            ) from None
        try:
            self._client = Client(address, timeout=timeout)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"dask '{address}': no scheduler answers ({error}); start one with "
                "'dask scheduler' and give its address, as in tcp://host:8786"
            ) from None
        self.name = f"Dask at {address}"

    def map(
        self, function: Work, shared: Any, items: Sequence[Any], done: Done | None = None
    ) -> list[Any]:
        """Results of function(shared, item), in order."""
        from distributed import as_completed

        # A task, not scattered data: a result lost with its worker is computed again.
        common = self._client.submit(_identity, shared, pure=False, retries=self.RETRIES)
        futures = [
            self._client.submit(function, common, item, pure=False, retries=self.RETRIES)
            for item in items
        ]
        try:
            _begin(done, items)
            if done is not None:
                for number, _ in enumerate(as_completed(futures), 1):
                    done(number, len(items))
            return self._client.gather(futures)
        except FingerError:
            raise
        except BaseException:
            self._client.cancel(futures)
            raise

    spread = map

    def close(self) -> None:
        """Disconnect; the cluster keeps running."""
        self._client.close()


def _identity(value: Any) -> Any:
    return value


Engine = LocalEngine | DaskEngine


@contextmanager
def engine_for(address: str) -> Iterator[Engine]:
    """The engine for a scheduler's address, this machine for an empty one."""
    engine = DaskEngine(address) if address else LocalEngine()
    try:
        yield engine
    finally:
        engine.close()
