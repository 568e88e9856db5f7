"""Plans trials in a worker process of low priority while others are being played."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from finger_common.errors import FingerError

from .trial_plan import PlannedTrial, TrialRequest

NICENESS = 15
"""Planning must not slow down the nodes, but a participant waits for it."""


def _work(
    plan: Callable[[TrialRequest], PlannedTrial], urgent: Any, jobs: Any, results: Any
) -> None:
    """Loop of the worker, urgent requests first: the owner ends it, Ctrl-C does not."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    import cv2

    cv2.setNumThreads(1)
    owner = os.getppid()
    done = set()
    while os.getppid() == owner:
        job = _next(urgent, jobs)
        if job is None or job[0] in done:
            continue
        ticket, request = job
        done.add(ticket)
        try:
            results.put((ticket, plan(request)))
        except FingerError as error:
            results.put((ticket, str(error)))
        except Exception:
            results.put((ticket, traceback.format_exc()))


def _next(urgent: Any, jobs: Any) -> tuple[int, TrialRequest] | None:
    try:
        return urgent.get_nowait()
    except queue.Empty:
        pass
    try:
        return jobs.get(timeout=0.1)
    except queue.Empty:
        return None


class Planner:
    """Plans requested trials one after another in a process of its own.

    plan: picklable function of a TrialRequest. Requests asked for with `ask` are planned in that order; `get`
    puts one first, waits for it and forgets it.
    """

    def __init__(self, plan: Callable[[TrialRequest], PlannedTrial]) -> None:
        context = multiprocessing.get_context("spawn")
        self._urgent = context.Queue()
        self._jobs = context.Queue()
        self._results = context.Queue()
        self._tickets: dict[TrialRequest, int] = {}
        self._issued = 0
        self._done: dict[int, PlannedTrial | str] = {}
        self._lock = threading.Lock()
        self._process = context.Process(
            target=_work, args=(plan, self._urgent, self._jobs, self._results), daemon=True
        )
        self._process.start()

    def ask(self, request: TrialRequest) -> None:
        """Have a trial planned; asking again for one that is under way changes nothing."""
        with self._lock:
            known = request in self._tickets
            ticket = self._ticket(request)
        if not known:
            self._check_alive()
            self._jobs.put((ticket, request))

    def get(
        self, request: TrialRequest, stop: threading.Event | None = None
    ) -> PlannedTrial | None:
        """The planned trial, waiting for it; None when `stop` is set meanwhile. Raises FingerError."""
        with self._lock:
            ticket = self._ticket(request)
        self._check_alive()
        # The worker takes each ticket once, from whichever queue it sees it in first.
        self._urgent.put((ticket, request))
        while True:
            with self._lock:
                self._collect()
                result = self._done.pop(ticket, None)
                if result is not None:
                    del self._tickets[request]
            if isinstance(result, str):
                raise FingerError(f"trial {request.name} could not be planned: {result}")
            if result is not None:
                return result
            self._check_alive()
            if stop is None:
                time.sleep(0.02)
            elif stop.wait(0.02):
                return None

    def _ticket(self, request: TrialRequest) -> int:
        if request not in self._tickets:
            self._issued += 1
            self._tickets[request] = self._issued
        return self._tickets[request]

    def _check_alive(self) -> None:
        if not self._process.is_alive():
            raise FingerError("the planning process has ended; start the rig again")

    def _collect(self) -> None:
        while True:
            try:
                ticket, result = self._results.get_nowait()
            except queue.Empty:
                return
            self._done[ticket] = result

    def close(self) -> None:
        """End the worker, in the middle of a plan if need be. Safe to call twice."""
        if not hasattr(self, "_jobs"):
            return
        self._process.terminate()
        self._process.join(5.0)
        for channel in (self._urgent, self._jobs, self._results):
            channel.cancel_join_thread()
            channel.close()
        # Their semaphores are released with the objects; a node leaves without the interpreter's exit.
        del self._urgent, self._jobs, self._results
