"""The fit node: FitParameters action over `fit_bags`. The work runs in a thread; the executor only passes on."""

from __future__ import annotations

import queue
import threading
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from finger_common.cli import one_line
from finger_common.diagnostics import Health
from finger_common.errors import FingerError, InputError
from finger_common.node import ManagedNode, main_of
from finger_common.parameters import Parameter, ParameterTable
from finger_msgs.action import FitParameters

from .options import FitOptions
from .search import Stopped


class _Job:
    """One fit in a thread; `events` carries feedback to the executor's thread."""

    def __init__(self, goal: Any, model_file: str) -> None:
        self.events: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.stop = threading.Event()
        self.outcome: Any = None
        self.error = ""
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
            from finger_model.reduced import ReducedModel

            from .fit import fit_bags

            goal = self._goal
            if not goal.output:
                raise InputError("goal: 'output' is empty; name the folder to write to")
            model = ReducedModel.load(self._model_file or None)
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
    TABLE = ParameterTable(
        Parameter(
            "reduced_model",
            "",
            "Reduced model file (npz); empty takes the one shipped for the default geometry.",
        ),
    )

    def configure(self) -> None:
        """Check the model file and offer the action."""
        from finger_model.reduced import ReducedModel

        ReducedModel.load(self.values["reduced_model"] or None)
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
        """Look after the running job ten times a second."""
        self._timer = self.create_timer(0.1, self._look)

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
        job = _Job(handle.request, self.values["reduced_model"])
        self._handle, self._job, self._waiting = handle, job, Future()
        self.get_logger().info(f"fitting {len(handle.request.bags)} bags")
        await self._waiting
        self._job = None
        return self._result(handle, job)

    def _look(self) -> None:
        """Pass on feedback, notice a cancel, and let the goal end when its thread has."""
        job = self._job
        if job is None or self._waiting is None or self._waiting.done():
            return
        alive = job.thread.is_alive()
        if self._handle.is_cancel_requested:
            job.stop.set()
        while not job.events.empty():
            condition, stage, number, rounds, cost, best = job.events.get()
            feedback = FitParameters.Feedback()
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
