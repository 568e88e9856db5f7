"""Where independent pieces of work run: in this process and its children, or on a Dask cluster.

A piece of work is `function(shared, item)`; results come back in the order of the items and do not depend on where
they were made.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from finger_common.errors import FingerError, InputError

Work = Callable[[Any, Any], Any]
Done = Callable[[int, int], None]
"""Called with the number of items done and their total."""


def available_cores() -> int:
    """Cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


class LocalEngine:
    """This machine. `map` runs here, one item after another (the compiled model uses all cores by itself);
    `spread` runs in one process per core, for work that uses one."""

    name = "this machine"

    def map(
        self, function: Work, shared: Any, items: Sequence[Any], done: Done | None = None
    ) -> list[Any]:
        """Results of function(shared, item), in order."""
        results = []
        for number, item in enumerate(items, 1):
            results.append(function(shared, item))
            if done is not None:
                done(number, len(items))
        return results

    def spread(
        self, function: Work, shared: Any, items: Sequence[Any], done: Done | None = None
    ) -> list[Any]:
        """As `map`, in one process per core."""
        workers = min(available_cores(), len(items))
        if workers < 2:
            return self.map(function, shared, items, done)
        # Forking a process whose kernels run threads can lock up; spawn starts clean.
        context = multiprocessing.get_context("spawn")
        results = []
        with ProcessPoolExecutor(
            workers, context, initializer=_keep, initargs=(function, shared)
        ) as pool:
            try:
                for number, result in enumerate(pool.map(_kept, items), 1):
                    results.append(result)
                    if done is not None:
                        done(number, len(items))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return results

    def close(self) -> None:
        """Nothing to release."""


_job: tuple[Work, Any] | None = None


def _keep(function: Work, shared: Any) -> None:
    global _job
    import signal

    # Ctrl-C is the parent's business; it ends the pool.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _job = (function, shared)


def _kept(item: Any) -> Any:
    assert _job is not None
    return _job[0](_job[1], item)


class DaskEngine:
    """A Dask cluster. Work lost with a worker is done again by another; nothing depends on which worker it was."""

    RETRIES = 10
    """Deaths of workers that one item may survive."""

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
                f"dask '{address}': no scheduler answers ({error}); start one with 'dask scheduler' "
                "and give its address, as in tcp://host:8786"
            ) from None
        self.name = f"Dask at {address}"

    def map(
        self, function: Work, shared: Any, items: Sequence[Any], done: Done | None = None
    ) -> list[Any]:
        """Results of function(shared, item), in order."""
        from distributed import as_completed

        # As a task, not as scattered data: a result that died with its worker is made again.
        common = self._client.submit(_same, shared, pure=False, retries=self.RETRIES)
        futures = [
            self._client.submit(_alone, function, common, item, pure=False, retries=self.RETRIES)
            for item in items
        ]
        try:
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
        """Leave the cluster as it is."""
        self._client.close()


def _same(value: Any) -> Any:
    return value


def _alone(function: Work, shared: Any, item: Any) -> Any:
    """One item on a worker that may run several threads; the compiled kernels do not nest."""
    return function(shared, item)


@contextmanager
def engine_for(address: str) -> Iterator[LocalEngine | DaskEngine]:
    """The engine for a scheduler's address, this machine for an empty one."""
    engine = DaskEngine(address) if address else LocalEngine()
    try:
        yield engine
    finally:
        engine.close()
