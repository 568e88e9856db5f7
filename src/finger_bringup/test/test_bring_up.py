# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bringing lifecycle nodes up in order: the rule on plain data, then over DDS with real nodes."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from finger_bringup.bring_up import (
    ACTIVATE,
    ACTIVE,
    CONFIGURE,
    FINALIZED,
    INACTIVE,
    UNCONFIGURED,
    BringUp,
)


def test_groups_come_up_one_after_the_other() -> None:
    plan = BringUp([["force", "camera"], ["model"]], patience=10.0)
    states = dict.fromkeys(plan.nodes, UNCONFIGURED)
    assert plan.steps(states, 0.0) == [("force", CONFIGURE), ("camera", CONFIGURE)]
    states.update(force=INACTIVE)
    assert plan.steps(states, 1.0) == [("force", ACTIVATE), ("camera", CONFIGURE)]
    states.update(force=ACTIVE, camera=ACTIVE)
    assert plan.steps(states, 2.0) == [("model", CONFIGURE)]
    states.update(model=ACTIVE)
    assert plan.steps(states, 3.0) == [] and plan.missing(states) == []


def test_a_device_that_is_not_there_holds_up_the_rest_only_for_a_while() -> None:
    plan = BringUp([["camera"], ["model"]], patience=10.0, retry=5.0)
    states = dict.fromkeys(plan.nodes, UNCONFIGURED)
    assert plan.steps(states, 0.0) == [("camera", CONFIGURE)]
    plan.failed("camera", 1.0)
    assert plan.steps(states, 2.0) == []
    assert plan.steps(states, 6.5) == [("camera", CONFIGURE)]
    plan.failed("camera", 7.0)
    assert plan.steps(states, 10.5) == [("model", CONFIGURE)]
    assert plan.missing(states) == ["camera", "model"]


def test_a_restarted_node_is_brought_up_again_and_a_silent_one_is_left_alone() -> None:
    plan = BringUp([["force"], ["model"]])
    assert plan.steps({"force": ACTIVE, "model": UNCONFIGURED}, 100.0) == [("model", CONFIGURE)]
    assert plan.steps({"force": UNCONFIGURED, "model": ACTIVE}, 200.0) == [("force", CONFIGURE)]
    assert plan.steps({"force": ACTIVE}, 300.0) == []


def test_a_node_that_somebody_takes_down_is_left_to_them_until_it_is_active_again() -> None:
    plan = BringUp([["force"], ["model"]])

    def steps(state: int, asked: float, now: float) -> list[tuple[str, int]]:
        plan.answered("force", state, asked, now)
        return plan.steps({"force": state, "model": ACTIVE}, now)

    # Its own transitions are nobody's wish.
    assert steps(UNCONFIGURED, 0.0, 0.1) == [("force", CONFIGURE)]
    assert steps(INACTIVE, 0.2, 0.3) == [("force", ACTIVATE)]
    assert steps(ACTIVE, 0.4, 0.5) == []
    assert steps(INACTIVE, 0.6, 0.7) == [] and plan.taken_down == {"force": INACTIVE}
    assert plan.missing({"force": INACTIVE, "model": ACTIVE}) == []
    # A clean-up that takes long answers the question that was asked before it.
    assert steps(UNCONFIGURED, 0.9, 4.0) == []
    assert steps(INACTIVE, 4.2, 4.3) == []
    assert steps(ACTIVE, 4.4, 4.5) == [] and not plan.taken_down
    # A clean-up between two questions: the node itself reports it, so that it is somebody's wish,
    # whether the question was asked before it or after it.
    for asked in (6.0, 7.0):
        plan.moved("force", asked - 0.3)
        assert steps(ACTIVE, asked - 0.4, asked - 0.2) == [], "the answer is older"
        assert steps(UNCONFIGURED, asked + 0.7, asked + 0.8) == []
        assert plan.taken_down == {"force": UNCONFIGURED}
        assert steps(ACTIVE, asked + 0.9, asked + 0.9) == [] and not plan.taken_down
    # A process that ended answers later questions only: it is brought up.
    assert steps(UNCONFIGURED, 9.0, 9.1) == [("force", CONFIGURE)] and not plan.taken_down
    assert steps(ACTIVE, 9.2, 9.3) == []
    assert steps(INACTIVE, 9.4, 9.5) == []
    assert steps(UNCONFIGURED, 11.0, 11.1) == [("force", CONFIGURE)] and not plan.taken_down


@pytest.mark.parametrize("before", [ACTIVE, UNCONFIGURED])
def test_after_a_shutdown_only_another_process_is_brought_up(before: int) -> None:
    plan = BringUp([["force"]])
    plan.answered("force", before, 0.0, 0.1)
    for now in (5.0, 10.0):
        plan.answered("force", FINALIZED, now, now)
        assert plan.taken_down == {"force": FINALIZED} and not plan.missing({"force": FINALIZED})
    plan.answered("force", UNCONFIGURED, 10.1, 10.2)
    assert plan.steps({"force": UNCONFIGURED}, 10.2) == [("force", CONFIGURE)]
    assert not plan.taken_down


class Node:
    """What `bring_up` asks of a lifecycle node; the first `lost` requests of a change get lost.
    refuses: whether it refuses every transition."""

    def __init__(self, lost: int = 0, ready: bool = True, refuses: bool = False) -> None:
        self.state, self.lost, self.ready = UNCONFIGURED, lost, ready
        self.refuses = refuses
        self.asked = 0

    def service_is_ready(self) -> bool:
        return self.ready

    def call_async(self, request: Any) -> Any:
        from rclpy.task import Future

        answer = Future()
        if not hasattr(request, "transition"):
            answer.set_result(SimpleNamespace(current_state=SimpleNamespace(id=self.state)))
            return answer
        self.asked += 1
        if self.refuses:
            answer.set_result(SimpleNamespace(success=False))
        elif self.asked > self.lost:
            self.state = {CONFIGURE: INACTIVE, ACTIVATE: ACTIVE}[request.transition.id]
            answer.set_result(SimpleNamespace(success=True))
        return answer


@contextmanager
def manager_of(ros_domain: int, *order: str) -> Iterator[Any]:
    """The node `bring_up` of these groups, configured and not served."""
    rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from finger_bringup.bring_up_node import BringUpNode

    rclpy.init(domain_id=ros_domain)
    try:
        manager = BringUpNode()
        manager.set_parameters([rclpy.Parameter("order", value=list(order))])
        manager.values = manager.read_parameters()
        manager.configure()
        manager.healths[0].state = "active"
        yield manager
        manager.destroy_node()
    finally:
        rclpy.shutdown()


def serve(manager: Any, name: str, get_state: Node, change_state: Node) -> None:
    """Let these nodes answer in place of the node of this name."""
    node = manager._nodes[name]
    node.get_state, node.change_state = get_state, change_state


def test_nodes_that_refuse_and_those_that_were_shut_down_are_named(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with manager_of(ros_domain, "force", "vision model") as manager:
        nodes = {"force": Node(), "vision": Node(refuses=True), "model": Node()}
        for name, node in nodes.items():
            serve(manager, name, node, node)
        health = manager.healths[0]

        def said(after: float) -> tuple[int, str]:
            nonlocal now
            now += after
            manager._step()
            report = health.report()
            return report.level, report.message

        level, text = said(0.0)
        assert level == 1 and "refused: vision;" in text
        assert not manager._complete
        nodes["vision"].refuses = False
        assert said(10.0)[0] == 0
        nodes["model"].state = FINALIZED
        for _ in range(3):
            level, text = said(1.1)
        assert level == 1 and "shut down: model; restart its process" in text
        assert "activated again" not in text
        nodes["model"].state = UNCONFIGURED
        assert said(1.1)[0] == 0 and nodes["model"].state == ACTIVE


def test_a_transition_whose_request_was_lost_is_asked_for_again(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_bringup import bring_up_node

    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with manager_of(ros_domain, "force", "model") as manager:
        # The first one's service was not discovered yet: a request to it would be lost.
        nodes = {"force": Node(ready=False), "model": Node(lost=1)}
        serve(manager, "force", Node(), nodes["force"])
        serve(manager, "model", nodes["model"], nodes["model"])
        manager._step()
        assert nodes["force"].asked == 0
        nodes["force"].ready = True
        serve(manager, "force", nodes["force"], nodes["force"])
        manager._step()
        # One transition follows the other at once, up to the request that gets lost.
        assert nodes["force"].state == ACTIVE
        assert (nodes["model"].asked, nodes["model"].state) == (1, UNCONFIGURED)
        now = bring_up_node.STATE_TIMEOUT + 1.0
        manager._step()
        manager._step()
        assert nodes["model"].state == ACTIVE


def test_nodes_come_up_over_dds_and_again_after_a_kill(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from rcl_interfaces.srv import SetParameters

    def start(module: str, *parameters: str) -> Any:
        flags = [flag for p in parameters for flag in ("-p", p)]
        return process("-m", f"finger_{module}", "--ros-args", *flags)

    def start_protocol() -> Any:
        return start("operator.protocol_node", "autostart:=false", f"output:={tmp_path}")

    protocol = start_protocol()
    start("operator.page_node", "autostart:=false", "port:=0")
    manager = start("bringup.bring_up_node", "order:=[protocol, page]")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("observer", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    said: list[Any] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", said.append, 50)
    clients = {n: node.create_client(GetState, f"{n}/get_state") for n in ("protocol", "page")}

    def call(client: Any, request: Any, seconds: float = 3.0) -> Any:
        future = client.call_async(request)
        executor.spin_until_future_complete(future, timeout_sec=seconds)
        return future.result()

    def wait(condition: Callable[[], bool], seconds: float = 150.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, manager.output.read_text()

    def diagnosis() -> str:
        """What the next report of bring_up complains of."""
        said.clear()
        own: list[Any] = []
        while not own:
            executor.spin_once(timeout_sec=0.05)
            own = [s for m in said for s in m.status if s.name.startswith("bring_up:")]
        return str(own[-1].message) if own[-1].level != b"\0" else ""

    def active(name: str) -> bool:
        answer = call(clients[name], GetState.Request())
        return answer is not None and answer.current_state.id == ACTIVE

    try:
        wait(lambda: active("protocol") and active("page"))
        wait(lambda: "all nodes are active: protocol, page" in manager.output.read_text())
        # A transition the state does not have is refused and ends nothing.
        change = node.create_client(ChangeState, "page/change_state")
        wrong = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
        wait(change.service_is_ready)
        answer = call(change, wrong, 90.0)
        assert answer is not None and not answer.success
        wait(lambda: active("page"))

        def request(transition: int) -> bool:
            asked = ChangeState.Request(transition=Transition(id=transition))
            answer = call(change, asked, 90.0)
            return answer is not None and answer.success

        # Whoever takes a node down, to change a parameter, is not brought up against, slowly ...
        assert request(Transition.TRANSITION_DEACTIVATE)
        wait(lambda: "by request: page (inactive)" in diagnosis())
        assert request(Transition.TRANSITION_CLEANUP)
        wait(lambda: "by request: page (unconfigured)" in diagnosis())
        assert request(Transition.TRANSITION_CONFIGURE) and request(Transition.TRANSITION_ACTIVATE)
        wait(lambda: not diagnosis())
        # ... or faster than states are asked for.
        assert request(Transition.TRANSITION_DEACTIVATE) and request(Transition.TRANSITION_CLEANUP)
        wait(lambda: "by request: page (unconfigured)" in diagnosis())
        value = rclpy.Parameter("display_rate", value=7.0).to_parameter_msg()
        parameters = node.create_client(SetParameters, "page/set_parameters")
        wait(parameters.service_is_ready)
        set_request = SetParameters.Request(parameters=[value])
        assert call(parameters, set_request, 90.0).results[0].successful
        assert not active("page")
        assert request(Transition.TRANSITION_CONFIGURE) and request(Transition.TRANSITION_ACTIVATE)
        wait(lambda: not diagnosis())
        os.killpg(protocol.pid, signal.SIGKILL)
        protocol.wait(60)
        start_protocol()
        wait(lambda: active("protocol") and active("page"))
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
