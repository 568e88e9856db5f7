"""Every node of a running rig: taken down and up again, and every parameter that may change."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from fingers_side_by_side import node_class  # noqa: E402
from lifecycle_msgs.msg import State, Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.parameter import Parameter as RosParameter  # noqa: E402

from finger_bringup import nodes  # noqa: E402
from finger_common.node import ManagedNode, stream_watch  # noqa: E402
from finger_common.node.described import ros_value  # noqa: E402
from finger_common.parameters import Parameter  # noqa: E402
from finger_msgs.msg import ContactArea, ContactState  # noqa: E402

if TYPE_CHECKING:
    from fingers_side_by_side import Hand

UP = (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
DOWN = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
PAUSE = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE)

ENTITIES = ("publishers", "subscriptions", "services", "clients", "timers", "guards")

FILES = {"parameter_file", "calibration_file", "attachments", "folder"}
"""Parameters that name files: set to what they are."""


def entities(node: ManagedNode) -> dict[str, Any]:
    """What a node holds of the middleware: numbers, and the topics that it publishes."""
    found: dict[str, Any] = {kind: len(list(getattr(node, kind))) for kind in ENTITIES}
    found["topics"] = sorted(publisher.topic_name for publisher in node.publishers)
    return found


def another(parameter: Parameter, value: Any) -> Any:
    """An allowed value that is not the present one, or the present one where there is no other."""
    if parameter.name in FILES or isinstance(value, list):
        return value
    if parameter.choices:
        return next((choice for choice in parameter.choices if choice != value), value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        low = parameter.minimum if parameter.minimum is not None else value - 1
        high = parameter.maximum if parameter.maximum is not None else value + 1
        # Near the present value, so that what depends on two parameters still holds.
        nearby = (value + (high - value) / 100, value - (value - low) / 100)
        for candidate in (*nearby, value + 1, value - 1):
            fitting = type(value)(candidate)
            if fitting != value and low <= fitting <= high:
                return fitting
    return value


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_node_goes_down_and_up_twice_and_leaves_nothing_behind(
    hand: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand.add_finger("thumb", further=("fit", "foxglove"))
    group: dict[str, ManagedNode] = hand.nodes["thumb"]
    hand.nodes["thumb"]["foxglove"].set_parameters([RosParameter("port", value=0)])
    for name, node in group.items():
        # All share a thread: who brings nodes up would take a long transition for a restart.
        assert name == "bring_up" or node.bring_up(), name
    hand.first(ContactArea, "/thumb/contact_area")

    def change(name: str, *transitions: int) -> None:
        for transition in transitions:
            request = ChangeState.Request(transition=Transition(id=transition))
            answer = hand.call(ChangeState, f"/thumb/{name}/change_state", request)
            assert answer.success, (name, transition)

    for name, node in group.items():
        assert node.active or node.bring_up()
        before, threads = entities(node), threading.active_count()
        for cycle in (PAUSE, (*DOWN, *UP), PAUSE, (*DOWN, *UP)):
            change(name, *cycle)
            state = hand.call(GetState, f"/thumb/{name}/get_state", GetState.Request())
            assert state.current_state.id == State.PRIMARY_STATE_ACTIVE, name
            assert entities(node) == before, name
        end = time.monotonic() + 10
        while threading.active_count() > threads + 1:
            assert time.monotonic() < end, (name, threading.enumerate())
            hand.executor.spin_once(timeout_sec=0.05)

    # The streams flow again, and nobody takes what is left for a second publisher.
    monkeypatch.setattr(stream_watch, "REMEMBERED", 0.2)
    hand.first(ContactArea, "/thumb/contact_area")
    hand.first(ContactState, "/thumb/contact_state")
    time.sleep(0.3)
    hand.levels.clear()
    hand.until(lambda: {"thumb/force: force", "thumb/vision: vision"} <= hand.levels.keys())
    for name, node in group.items():
        for health in node.healths:
            assert "second_publisher" not in health.faults, name


@pytest.mark.timeout(600)
def test_every_parameter_that_may_change_is_taken_while_the_nodes_are_active(hand: Hand) -> None:
    hand.add_finger("thumb")
    group: dict[str, ManagedNode] = hand.nodes["thumb"]
    for name, node in group.items():
        if name != "bring_up":
            assert node.bring_up(), name
    changed = 0
    for name, node in group.items():
        if name == "bring_up":
            continue
        for parameter in node.parameter_table():
            if not parameter.runtime:
                continue
            value = node.get_parameter(parameter.name).value
            for wanted in (another(parameter, value), value):
                message = ros_value(parameter, wanted).to_parameter_msg()
                request = SetParameters.Request(parameters=[message])
                answer = hand.call(SetParameters, f"/thumb/{name}/set_parameters", request)
                result = answer.results[0]
                assert result.successful, (name, parameter.name, wanted, result.reason)
                assert node.values[parameter.name] == node.get_parameter(parameter.name).value
                assert node.values[parameter.name] == wanted
                changed += wanted != value
    assert changed > 40
    for name, node in group.items():
        assert name == "bring_up" or node.active, name
    hand.first(ContactState, "/thumb/contact_state")
    hand.first(ContactArea, "/thumb/contact_area")


def test_all_nodes_that_know_the_direction_of_a_press_have_the_same_default() -> None:
    """With that of the simulated sensor (test_driver_nodes), a newcomer's first press counts."""
    tables = [node_class(entry).parameter_table() for entry in nodes.NODES.values()]
    axes = [table["normal_axis"].default for table in tables if "normal_axis" in table]
    assert len(axes) == 4 and len(set(axes)) == 1
