"""The fit node: the FitParameters action over `fit_bags`.

The fit runs in a thread; the executor passes on its progress.
"""

from __future__ import annotations

import queue
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from finger_common.cli import one_line
from finger_common.diagnostics import Health
from finger_common.errors import FingerError, InputError
from finger_common.node import ManagedNode, main_of
from finger_common.settings import Settings, setting
from finger_model.reduced import ReducedModel
from finger_msgs.action import FitParameters

from .options import FitOptions
from .search import Stopped
from .study import fit_bags


@dataclass(frozen=True)
class FitNodeSettings(Settings):
    """Parameters of the fit node."""

    reduced_model: str = setting(
        "", "Reduced model file (npz); empty: the shipped one of the default geometry."
    )


class _Job:
    """One fit in a thread; `events` carries feedback to the executor's thread."""

    def __init__(self, goal: Any, model_file: str | None) -> None:
        self.events: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.stop = threading.Event()
        self.outcome: Any = None
        self.error = ""
        self.names: tuple[str, ...] = ()
        self._goal = goal
        self._model_file = model_file
        self.thread = threading.Thread(target=self._run, name="fit", daemon=True)
        self.thread.start()

    def _progress(self, *event: Any) -> None:
        if self.stop.is_set():
            raise Stopped
        self.events.put(event)

    def _run(self) -> None:
        try:
            goal = self._goal
            if not goal.output:
                raise InputError("goal: 'output' is empty; name the folder to write to")
            model = ReducedModel.load(self._model_file)
            self.names = model.space.names
            options = FitOptions.from_json(goal.options, "goal: 'options'")
            self.outcome = fit_bags(
                list(goal.bags), options, goal.output, list(goal.conditions), model, self._progress
            )
        except Stopped:
            self.error = "cancelled before anything was found"
        except FingerError as error:
            self.error = one_line(error)
        except Exception as error:
            self.error = f"defect: {type(error).__name__}: {one_line(error)}"


class FitNode(ManagedNode):
    """Serves `~/fit`; one goal at a time."""

    NAME = "fit"
    SETTINGS = (FitNodeSettings,)

    def configure(self) -> None:
        """Check the model file and offer the action."""
        self._model_file = self.settings(FitNodeSettings).reduced_model or None
        ReducedModel.load(self._model_file)
        self.health = Health("fit", "no device")
        self.healths = [self.health]
        self._job: _Job | None = None
        self._waiting: Future | None = None
        self._server: ActionServer | None = ActionServer(
            self,
            FitParameters,
            "~/fit",
            self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )

    def activate(self) -> None:
        """Check the running job ten times a second."""
        self._timer = self.create_timer(0.1, self._check_job)

    def deactivate(self) -> None:
        """Stop the running job."""
        if self._job is not None:
            self._job.stop.set()
        self.destroy_timer(self._timer)

    def cleanup(self) -> None:
        """Withdraw the action."""
        server = getattr(self, "_server", None)
        if server is not None:
            server.destroy()
            self._server = None

    def _on_goal(self, goal: Any) -> GoalResponse:
        if self._job is not None or not self._active:
            self.get_logger().warning("goal refused: a fit is running, or the node is not active")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _execute(self, handle: Any) -> Any:
        job = _Job(handle.request, self._model_file)
        self._handle, self._job, self._waiting = handle, job, Future()
        self.get_logger().info(f"fitting {len(handle.request.bags)} bags")
        await self._waiting
        self._job = None
        return self._result(handle, job)

    def _check_job(self) -> None:
        """Publish feedback, pass on a cancel request, and end the goal when its thread has
        ended."""
        job = self._job
        if job is None or self._waiting is None or self._waiting.done():
            return
        alive = job.thread.is_alive()
        if self._handle.is_cancel_requested:
            job.stop.set()
        while not job.events.empty():
            condition, stage, number, rounds, cost, best = job.events.get()
            feedback = FitParameters.Feedback()
            feedback.parameter_names = list(job.names)
            feedback.condition, feedback.stage = condition, stage
            feedback.round, feedback.rounds = int(number), int(rounds)
            feedback.best_cost = float(cost)
            feedback.best_parameters = [float(v) for v in np.asarray(best)]
            self._handle.publish_feedback(feedback)
            self.health.sample()
        if not alive:
            self._waiting.set_result(True)

    def _result(self, handle: Any, job: _Job) -> Any:
        result = FitParameters.Result()
        outcome = job.outcome
        if outcome is not None:
            folder = Path(outcome.output)
            result.parameter_file = str(folder / "parameters.yaml")
            result.report = str(folder / "report.html")
        if handle.is_cancel_requested:
            result.message = job.error or "cancelled; the best found so far is written"
            handle.canceled()
        elif outcome is None:
            result.message = job.error
            self.log_fault(self.health, "goal", f"fit failed: {job.error}")
            handle.abort()
        else:
            self.health.recovered("goal")
            result.success = True
            result.message = "; ".join(
                f"{name}: {fit.status}" for name, fit in outcome.fits.items()
            )
            handle.succeed()
        return result


main = main_of(FitNode)

if __name__ == "__main__":
    main()
