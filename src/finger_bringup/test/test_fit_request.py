# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node that requests one fit, against a fit node that answers late, refuses or goes away."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from lifecycle_msgs.msg import State  # noqa: E402
from lifecycle_msgs.srv import GetState  # noqa: E402
from rclpy.action import ActionServer, CancelResponse, GoalResponse  # noqa: E402
from rclpy.callback_groups import ReentrantCallbackGroup  # noqa: E402
from rclpy.executors import MultiThreadedExecutor  # noqa: E402

from finger_msgs.action import FitParameters  # noqa: E402


class StandIn:
    """A fit node of the test: `accept` and `succeed` say what it does with a goal."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("fit", context=self.context)
        self.accept, self.succeed = True, True
        self.go_on = threading.Event()
        self.begun, self.cancelled = threading.Event(), threading.Event()
        self.asked = 0
        self.mute = 0
        group = ReentrantCallbackGroup()
        self.node.create_service(GetState, "fit/get_state", self._state, callback_group=group)
        self.server = ActionServer(
            self.node,
            FitParameters,
            "fit/fit",
            self._run,
            goal_callback=lambda _: GoalResponse.ACCEPT if self.accept else GoalResponse.REJECT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )
        self.executor = MultiThreadedExecutor(4, context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def _state(self, request: Any, response: Any) -> Any:
        self.asked += 1
        if self.asked <= self.mute:
            time.sleep(7.0)  # Longer than the node waits for an answer.
        response.current_state.id = State.PRIMARY_STATE_ACTIVE
        return response

    def _run(self, handle: Any) -> Any:
        self.begun.set()
        while not self.go_on.is_set():
            if handle.is_cancel_requested:
                self.cancelled.set()
                handle.canceled()
                return FitParameters.Result()
            time.sleep(0.02)
        handle.succeed() if self.succeed else handle.abort()
        return FitParameters.Result(
            success=self.succeed, message="too few presses", parameter_file="set.yaml"
        )

    def close(self) -> None:
        """Go away; a goal that runs has no result."""
        self.executor.shutdown(timeout_sec=0.0)
        self.thread.join(30)
        self.server.destroy()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        self.go_on.set()


@pytest.fixture
def fit(ros_domain: int) -> Iterator[StandIn]:
    stand_in = StandIn(ros_domain)
    yield stand_in
    if stand_in.context.ok():
        stand_in.close()


@pytest.fixture
def request_fit(process: Callable[..., Any]) -> Callable[..., Any]:
    """Function that starts the node with parameters."""

    def start(**parameters: object) -> Any:
        given = {"bags": "[a.mcap]", **parameters}
        options = [item for k, v in given.items() for item in ("-p", f"{k}:={v}")]
        return process("-m", "finger_bringup.fit_request_node", "--ros-args", *options)

    return start


def test_a_fit_that_succeeds_and_one_that_fails(fit: StandIn, request_fit: Any) -> None:
    fit.mute = 1  # The first answer is lost.
    fit.go_on.set()
    child = request_fit()
    assert child.wait(90) == 0, child.output.read_text()
    assert "parameters: set.yaml" in child.output.read_text()
    fit.succeed = False
    child = request_fit()
    assert child.wait(90) == 2
    assert "the fit failed: too few presses" in child.output.read_text()


def test_a_goal_that_is_refused(fit: StandIn, request_fit: Any) -> None:
    fit.accept = False
    child = request_fit()
    assert child.wait(90) == 2
    assert "the fit node refused the goal" in child.output.read_text()


def test_ended_before_it_stops_the_fit(fit: StandIn, request_fit: Any) -> None:
    child = request_fit()
    assert fit.begun.wait(90)
    child.send_signal(signal.SIGINT)
    assert fit.cancelled.wait(30)
    assert child.wait(60) == 0, child.output.read_text()


def test_a_fit_node_that_goes_away(fit: StandIn, request_fit: Any) -> None:
    child = request_fit()
    assert fit.begun.wait(90)
    fit.close()
    assert child.wait(90) == 2
    assert "ended before the fit did" in child.output.read_text()


def test_no_fit_node(ros_domain: int, request_fit: Any) -> None:
    child = request_fit(server_timeout=2.0)
    assert child.wait(90) == 2
    assert "the fit node is not active" in child.output.read_text()
