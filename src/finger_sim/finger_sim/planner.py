# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Plans trials in a worker process of low priority while others are played."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection

from finger_common.errors import FingerError

from .trial_plan import PlannedTrial, TrialRequest

NICENESS = 15
"""Planning must not slow down the nodes, although a participant waits for it."""

Plan = Callable[[TrialRequest], PlannedTrial]


def _work(plan: Plan, owner: Connection) -> None:
    """Answer requests with planned trials, or with the text of an error, until the owner ends.

    Ctrl-C in the owner's terminal does not end the worker: the owner does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    import cv2

    cv2.setNumThreads(1)
    with suppress(EOFError, BrokenPipeError):
        while True:
            request = owner.recv()
            try:
                owner.send(plan(request))
            except FingerError as error:
                owner.send(str(error))
            except BrokenPipeError:
                raise
            except Exception:
                owner.send(traceback.format_exc())


class Planner:
    """Plans requested trials one after another in a process of its own.

    plan: picklable function of a TrialRequest. Trials requested with `ask` are planned in that
    order; `get` moves one to the front and waits for it. A trial that was fetched is forgotten.
    """

    def __init__(self, plan: Plan) -> None:
        context = multiprocessing.get_context("spawn")
        self._worker, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(plan, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._changed = threading.Condition()
        self._waiting: list[TrialRequest] = []
        self._busy: TrialRequest | None = None
        self._planned: dict[TrialRequest, PlannedTrial | str] = {}
        self._ended = False
        threading.Thread(target=self._serve, name="planner", daemon=True).start()

    def ask(self, request: TrialRequest) -> None:
        """Have a trial planned; asking again for one that is not fetched yet changes nothing."""
        with self._changed:
            if request not in (self._busy, *self._waiting, *self._planned):
                self._waiting.append(request)
                self._changed.notify_all()

    def get(
        self, request: TrialRequest, stop: threading.Event | None = None
    ) -> PlannedTrial | None:
        """The planned trial, waiting for it; None when `stop` is set meanwhile.

        Raises FingerError for a trial that cannot be planned.
        """
        self.ask(request)
        with self._changed:
            if request in self._waiting:
                self._waiting.remove(request)
                self._waiting.insert(0, request)
            while not self._changed.wait_for(lambda: request in self._planned or self._ended, 0.1):
                if stop is not None and stop.is_set():
                    return None
            result = self._planned.pop(request, None)
        if result is None:
            raise FingerError("the planning process has ended; start the rig again")
        if isinstance(result, str):
            raise FingerError(f"trial {request.name} could not be planned: {result}")
        return result

    def _serve(self) -> None:
        """Hand the worker one request after another until it ends."""
        with suppress(EOFError, OSError):
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting or self._ended)
                    if self._ended:
                        break
                    self._busy = self._waiting.pop(0)
                self._worker.send(self._busy)
                result = self._worker.recv()
                with self._changed:
                    self._planned[self._busy] = result
                    self._busy = None
                    self._changed.notify_all()
        self.close()

    def close(self) -> None:
        """End the worker, also in the middle of a plan. Safe to call twice."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._process.terminate()
        self._process.join(5.0)
