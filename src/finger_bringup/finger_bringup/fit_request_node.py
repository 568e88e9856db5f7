# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that requests one fit of the fit node, shows its progress and ends.

Exit code 0: done; 2: refused or failed. Ended before, it stops the fit.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.action import ActionClient

from finger_common.diagnostics import Health
from finger_common.errors import FingerError, InputError
from finger_common.files import parse_json
from finger_common.node import ManagedNode, main_of, message_of
from finger_common.parameter_values import parameter_fields
from finger_common.settings import Settings, setting
from finger_msgs.action import FitParameters

PERIOD = 0.5
"""s between two looks at the fit node."""
PATIENCE = 5.0
"""s until an answer counts as lost, and a fit node that is not there as ended."""


@dataclass(frozen=True)
class FitRequestSettings(Settings):
    """Parameters of the node."""

    bags: list = setting([""], "Bag files or folders to fit.")
    output: str = setting("out/fit", "Folder for parameters.yaml, fit.json and report.html.")
    conditions: list = setting([""], "Conditions to fit; empty: all.")
    options: str = setting("", "JSON object of options of finger-fit; empty: defaults.")
    server_timeout: float = setting(
        60.0, "Longest wait for the fit node to be active and to take the goal.", "s", 1.0, 600.0
    )


class FitFailed(FingerError):
    """The fit did not succeed; the message names the cause."""


class FitRequestNode(ManagedNode):
    """Sends one goal."""

    SETTINGS = (FitRequestSettings,)
    NAME = "fit_request"
    ONE_TASK = True

    def configure(self) -> None:
        self._health = Health("fit_request")
        self.healths = [self._health]
        self._bags = [bag for bag in self.values["bags"] if bag]
        if not self._bags:
            raise InputError("parameter 'bags' is empty; name the bags to fit")
        text = self.values["options"].strip()
        self._options = parse_json(text, "parameter 'options'") if text else {}
        if not isinstance(self._options, dict):
            raise InputError("parameter 'options' is no JSON object, such as {\"rounds\": 100}")
        self._client = ActionClient(self, FitParameters, "fit/fit")
        self._state_client = self.create_client(GetState, "fit/get_state")

    def activate(self) -> None:
        self._waited = 0.0
        self._unseen = 0.0
        self._goal: Any = None
        self._accepted = self._over = False
        self._state: Any = None
        self._failure = ""
        self._stage = ""
        self._timer = self.create_steady_timer(PERIOD, self._check)

    def deactivate(self) -> None:
        """Stop the fit if it runs; the fit node keeps what it has found."""
        self.destroy_timer(self._timer)
        if self._goal is None or self._over:
            return
        self._await(self._goal)  # Its answer may be under way.
        if self._goal.done() and self._goal.result().accepted:
            self._await(self._goal.result().cancel_goal_async())
            self.get_logger().info("the fit was asked to stop")

    def _await(self, answer: Any) -> None:
        end = time.monotonic() + PATIENCE
        while not answer.done() and time.monotonic() < end:
            assert self.executor is not None
            self.executor.spin_once(timeout_sec=PERIOD)

    def _check(self) -> None:
        if self._failure:
            raise FitFailed(self._failure)
        self._waited += PERIOD
        self._unseen = 0.0 if self._client.server_is_ready() else self._unseen + PERIOD
        if self._accepted:
            if self._unseen > PATIENCE:
                self._over = True
                raise FitFailed("the fit node ended before the fit did; its log names the reason")
        elif self._waited > self.values["server_timeout"]:
            raise FitFailed("the fit node is not active; check whether it runs and was configured")
        elif self._goal is None and self._ask_fit_node() and not self._unseen:
            self._send()

    def _ask_fit_node(self) -> bool:
        """Ask the fit node for its state where no answer is awaited; whether it is active by the
        answer that has come: it refuses goals before."""
        if self._state is not None:
            since, asked = self._state
            if asked.done():
                self._state = None
                return asked.result().current_state.id == State.PRIMARY_STATE_ACTIVE
            if self._waited - since > PATIENCE:  # The answer is lost: ask again.
                asked.cancel()
                self._state = None
        if self._state is None and self._state_client.service_is_ready():
            self._state = (self._waited, self._state_client.call_async(GetState.Request()))
        return False

    def _send(self) -> None:
        goal = message_of(
            FitParameters.Goal,
            {
                "bags": self._bags,
                "conditions": [c for c in self.values["conditions"] if c],
                "output": self.values["output"],
                "fit_options": parameter_fields(self._options),
            },
        )
        self._goal = self._client.send_goal_async(goal, feedback_callback=self._show)
        self._goal.add_done_callback(self._on_accepted)

    def _on_accepted(self, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._over = True
            self._failure = "the fit node refused the goal; its log names the reason"
            return
        self._accepted = True
        handle.get_result_async().add_done_callback(self._finished)

    def _show(self, message: Any) -> None:
        feedback = message.feedback
        stage = f"{feedback.condition} {feedback.stage}"
        if stage != self._stage:
            self._stage = stage
            self.get_logger().info(stage)

    def _finished(self, future: Any) -> None:
        self._over = True
        result = future.result().result
        if not result.success:
            self._failure = f"the fit failed: {result.message}"
            return
        self.get_logger().info(f"parameters: {result.parameter_file}, report: {result.report}")
        raise KeyboardInterrupt  # Done: end as after Ctrl-C.


main = main_of(FitRequestNode)

if __name__ == "__main__":
    main()
