# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that requests one fit of the fit node, shows its progress and ends.

Exit code 0: done; 2: refused or failed.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class FitRequestSettings(Settings):
    """Parameters of the node."""

    bags: list = setting([""], "Bag files or folders to fit.")
    output: str = setting("out/fit", "Folder for parameters.yaml, fit.json and report.html.")
    conditions: list = setting([""], "Conditions to fit; empty: all.")
    options: str = setting("", "JSON object of options of finger-fit; empty: defaults.")
    server_timeout: float = setting(
        60.0, "Longest wait for the fit node to be active.", "s", 1.0, 600.0
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
        self._sent = False
        self._state: Any = None
        self._failure = ""
        self._stage = ""
        self._timer = self.create_steady_timer(0.5, self._check)

    def _check(self) -> None:
        if self._failure:
            raise FitFailed(self._failure)
        if self._sent:
            return
        self._waited += 0.5
        if self._fit_is_active() and self._client.server_is_ready():
            self._send()
        elif self._waited > self.values["server_timeout"]:
            raise FitFailed("the fit node is not active; check whether it runs and was configured")

    def _fit_is_active(self) -> bool:
        """Whether the fit node is active by its last answer; it refuses goals before."""
        request, self._state = self._state, None
        if request is not None and not request.done():
            self._state = request
        elif self._state_client.service_is_ready():
            self._state = self._state_client.call_async(GetState.Request())
        answer = request.result() if request is not None and request.done() else None
        return answer is not None and answer.current_state.id == State.PRIMARY_STATE_ACTIVE

    def _send(self) -> None:
        self._sent = True
        goal = message_of(
            FitParameters.Goal,
            {
                "bags": self._bags,
                "conditions": [c for c in self.values["conditions"] if c],
                "output": self.values["output"],
                "fit_options": parameter_fields(self._options),
            },
        )
        sent = self._client.send_goal_async(goal, feedback_callback=self._show)
        sent.add_done_callback(self._accepted)

    def _accepted(self, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._failure = "the fit node refused the goal; its log names the reason"
            return
        handle.get_result_async().add_done_callback(self._finished)

    def _show(self, message: Any) -> None:
        feedback = message.feedback
        stage = f"{feedback.condition} {feedback.stage}"
        if stage != self._stage:
            self._stage = stage
            self.get_logger().info(stage)

    def _finished(self, future: Any) -> None:
        result = future.result().result
        if not result.success:
            self._failure = f"the fit failed: {result.message}"
            return
        self.get_logger().info(f"parameters: {result.parameter_file}, report: {result.report}")
        raise KeyboardInterrupt  # Done: end as after Ctrl-C.


main = main_of(FitRequestNode)

if __name__ == "__main__":
    main()
