# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fit node: the FitParameters action over `fit_bags`.

The fit runs in a thread; the executor passes on its progress. A goal that is cancelled, and one
whose node is deactivated or shut down, is answered within PATIENCE, whatever the thread is at.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from finger_common.cli import one_line
from finger_common.diagnostics import WARN, Health
from finger_common.errors import FingerError, InputError
from finger_common.files import user_path
from finger_common.node import ManagedNode, main_of
from finger_common.parameter_values import parameter_values
from finger_common.settings import Settings, setting
from finger_msgs.action import FitParameters

from .fingers import ALL, Fingers
from .options import FitOptions
from .results import parameter_files
from .search import Stopped
from .study import fit_bags

PATIENCE = 1.5
"""s that the answer to a cancelled goal waits for the thread to write the best found so far."""


@dataclass(frozen=True)
class FitNodeSettings(Settings):
    """Parameters of the fit node."""

    reduced_model: str = setting("", "Reduced model file (npz); empty: the shipped one.")
    geometry_file: str = setting("", "geometry.yaml of the finger; empty: the default geometry.")


def _fingers_of(settings: FitNodeSettings) -> Fingers:
    return Fingers.load({ALL: settings.geometry_file}, settings.reduced_model)


def checked_options(goal: Any) -> FitOptions:
    """Options of a FitParameters goal; raises InputError for what no fit could be made of."""
    if not goal.output:
        raise InputError("goal: 'output' is empty; name the folder to write to")
    user_path(goal.output)  # which may name a home folder of nobody
    if not goal.bags:
        raise InputError("goal: 'bags' is empty; name the bags to fit")
    for bag in goal.bags:
        if not user_path(bag).exists():
            raise InputError(f"goal: 'bags': {bag}: no such bag or folder; correct the path")
    if not goal.fit_options:
        return FitOptions.from_json(goal.options, "goal: 'options'")
    if goal.options:
        raise InputError("goal: 'fit_options' and 'options' are both given; leave one out")
    return FitOptions.from_mapping(parameter_values(goal.fit_options), "goal: 'fit_options'")


class _Job:
    """One fit in a thread; `events` carries feedback to the executor's thread.

    bags, output: paths of the goal, with the home folder for ~. stop: tells the thread to end.
    answered: done when the goal may be answered. reason: why it ended before its time, empty where
    the client cancelled it.
    """

    def __init__(self, goal: Any, settings: FitNodeSettings) -> None:
        self.events: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.stop = threading.Event()
        self.outcome: Any = None
        self.error = ""
        self.names: tuple[str, ...] = ()
        self.answered = Future()
        self.reason = ""
        self.stopped_at = math.inf
        self.bags = [str(user_path(bag)) for bag in goal.bags]
        self.output = user_path(goal.output)
        self.stage = "load"
        self._goal = goal
        self._settings = settings
        self.thread = threading.Thread(target=self._run, name="fit", daemon=True)
        self.thread.start()

    def _progress(self, *event: Any) -> None:
        if self.stop.is_set():
            raise Stopped
        self.events.put(event)

    def _run(self) -> None:
        try:
            goal = self._goal
            options = checked_options(goal)
            fingers = _fingers_of(self._settings)
            self.names = fingers.space.names
            self.outcome = fit_bags(
                self.bags, options, self.output, list(goal.conditions), fingers, self._progress
            )
        except Stopped:
            self.error = "nothing was found before"
        except FingerError as error:
            self.error = one_line(error)
        except Exception as error:
            self.error = f"defect: {type(error).__name__}: {one_line(error)}"

    def end(self, reason: str = "") -> None:
        """Tell the thread to end."""
        if not self.stop.is_set():
            self.reason = reason
            self.stopped_at = time.monotonic()
            self.stop.set()


class FitNode(ManagedNode):
    """Serves `~/fit`; one goal at a time."""

    NAME = "fit"
    SETTINGS = (FitNodeSettings,)

    _job: _Job | None = None
    """The newest one; its thread may outlast the configuration that it was begun in."""
    _handle: Any = None
    """Of the goal that is being answered."""
    _server: ActionServer | None = None
    _farewell: Any = None
    """Timer that withdraws the action, once the last goal is answered."""

    def configure(self) -> None:
        """Check the model file and offer the action."""
        self._model_settings = self.settings(FitNodeSettings)
        _fingers_of(self._model_settings)
        self.health = Health("fit", "no device")
        self.healths = [self.health]
        self._withdraw(at_once=True)
        self._handle = None
        self._server = ActionServer(
            self,
            FitParameters,
            "~/fit",
            self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )

    def activate(self) -> None:
        """Check the running job ten times a second."""
        # Steady time: a cancel is answered also while simulated time stands still.
        self._timer = self.create_steady_timer(0.1, self._check_job)

    def deactivate(self) -> None:
        """End the running job and let its client know."""
        self.destroy_timer(self._timer)
        if self._job is not None:
            self._job.end("the fit node was deactivated")
            if not self._job.answered.done():
                self._job.answered.set_result(True)

    def cleanup(self) -> None:
        """Withdraw the action, once the client of a goal that was ended has its answer."""
        if self.answering:
            self._farewell = self.create_steady_timer(0.1, self._withdraw)
        else:
            self._withdraw()

    def _withdraw(self, at_once: bool = False) -> None:
        if self.answering and not at_once:
            return
        farewell, server = self._farewell, self._server
        self._farewell = self._server = None
        if farewell is not None:
            self.destroy_timer(farewell)
        if server is not None:
            server.destroy()

    @property
    def answering(self) -> bool:
        return self._handle is not None

    def _on_goal(self, goal: Any) -> GoalResponse:
        # A refusal of an action carries no reason: what only time changes is answered instead.
        try:
            if not self.active:
                raise InputError("the fit node is not active; activate it first")
            checked_options(goal)
        except FingerError as error:
            text = f"goal refused: {one_line(error)}"
            self.health.fault("refused", text, WARN)
            self.get_logger().warning(text)
            return GoalResponse.REJECT
        self.health.recovered("refused")
        return GoalResponse.ACCEPT

    async def _execute(self, handle: Any) -> Any:
        if self._job is not None and (self.answering or self._job.thread.is_alive()):
            bags = len(self._job.bags)
            state = "an ended fit is finishing" if self._job.stop.is_set() else "a fit is running"
            handle.abort()
            return FitParameters.Result(
                message=f"busy: {state} ({bags} bags, {self._job.stage}); try again after it"
            )
        job = self._job = _Job(handle.request, self._model_settings)
        self._handle = handle
        self.get_logger().info(f"fitting {len(job.bags)} bags")
        try:
            await job.answered
            return self._result(handle, job)
        finally:
            self._handle = None

    def _check_job(self) -> None:
        """Publish feedback, pass on a cancel request, and end the goal when its thread has
        ended."""
        job = self._job
        if job is None or job.answered.done():
            return
        alive = job.thread.is_alive()
        if self._handle.is_cancel_requested:
            job.end()
            alive = alive and time.monotonic() - job.stopped_at < PATIENCE
        while not job.events.empty():
            condition, stage, number, rounds, cost, best = job.events.get()
            job.stage = f"{condition} {stage}".strip()
            feedback = FitParameters.Feedback()
            feedback.parameter_names = list(job.names)
            feedback.condition, feedback.stage = condition, stage
            feedback.round, feedback.rounds = int(number), int(rounds)
            feedback.best_cost = float(cost)
            feedback.best_parameters = [float(v) for v in np.asarray(best)]
            self._handle.publish_feedback(feedback)
            self.health.sample()
        if not alive:
            job.answered.set_result(True)

    def _result(self, handle: Any, job: _Job) -> Any:
        result = FitParameters.Result()
        outcome = job.outcome
        if outcome is not None:
            folder = Path(outcome.output)
            files = [
                folder / name / file
                for name, part in outcome.parts.items()
                for file in parameter_files(part)
            ]
            result.parameter_file = str(files[0]) if files else ""
            result.report = str(folder / "report.html")
        if job.thread.is_alive():
            found = f"what was found so far is written to {job.output} in a moment"
        else:
            found = job.error or "the best found so far is written"
        if job.reason:
            result.message = f"{job.reason}; {found}"
            handle.abort()
        elif handle.is_cancel_requested:
            result.message = f"cancelled; {found}"
            handle.canceled()
        elif outcome is None:
            result.message = job.error
            self.log_fault(self.health, "goal", f"fit failed: {job.error}")
            handle.abort()
        else:
            self.health.recovered("goal")
            states = [f"{name}: {fit.status}" for name, fit in outcome.fits.items()]
            states += [f"{name}: lost, see the notes in the report" for name in outcome.missing]
            result.success, result.message = not outcome.missing, "; ".join(states)
            (handle.succeed if result.success else handle.abort)()
        return result


main = main_of(FitNode)

if __name__ == "__main__":
    main()
