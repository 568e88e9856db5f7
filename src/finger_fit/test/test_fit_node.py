# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fit node over DDS: goal, feedback, result, cancel, bad goals."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from finger_common.parameter_values import parameter_fields

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

# A fit takes minutes on a machine that is busy with other things.
pytestmark = pytest.mark.timeout(1200)


@pytest.fixture
def client(ros_domain: int, process: Any) -> Any:
    from rclpy.action import ActionClient

    from finger_msgs.action import FitParameters

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("asker", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    child = process("-m", "finger_fit.fit_node")
    action = ActionClient(node, FitParameters, "/fit/fit")

    def wait(condition: Callable[[], Any], seconds: float = 400) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
            found = condition()
            if found:
                return found
        raise AssertionError("nothing came in time: " + child.output.read_text())

    wait(action.server_is_ready)
    yield action, wait, FitParameters, child
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


def write_bags(folder: Path, double: Any) -> list[str]:
    """Three presses of the stand-in as bags."""
    from finger_bag.writer import BagWriter

    names = []
    for index in range(3):
        record = double.make_record(index, 0.6 + 0.3 * index, 1e-6)
        path = folder / f"natural_{index}"
        with BagWriter(path, {"condition": "natural", "trial_index": index}) as bag:
            for value in (69.0, 70.0, 71.0):
                bag.write(
                    "moisture",
                    {"header": {"stamp": int(record.stamp_ns[0])}, "value": value, "phase": 1},
                )
            for stamp, force in zip(record.stamp_ns, record.force):
                bag.write(
                    "wrench",
                    {"header": {"stamp": int(stamp)}, "wrench": {"force": {"z": -float(force)}}},
                )
            for stamp, area, flags in zip(record.area_stamp_ns, record.area, record.area_flags):
                bag.write(
                    "contact_area",
                    {
                        "header": {"stamp": int(stamp)},
                        "gross_area": float(area),
                        "area_stddev": 1e-6,
                        "flags": int(flags),
                    },
                )
        names.append(str(path))
    return names


def test_goal_gives_feedback_and_the_parameter_file_and_cancel_keeps_the_best(
    client: Any, tmp_path: Path, double: Any
) -> None:
    from action_msgs.msg import GoalStatus

    from finger_common.node import message_of
    from finger_model.parameter_sets import ParameterSets

    action, wait, FitParameters, child = client
    bags = write_bags(tmp_path, double)
    options = {"full_order": False, "profiles": False, "bootstrap": 0, "grid": 2, "rounds": 6}
    heard: list[Any] = []

    def send(**fields: Any) -> Any:
        given = parameter_fields(fields.pop("options", {}))
        goal = message_of(
            FitParameters.Goal, {"options": fields.pop("text", ""), **fields, "fit_options": given}
        )
        asked = action.send_goal_async(goal, lambda m: heard.append(m.feedback))
        wait(asked.done)
        return asked.result()

    handle = send(bags=bags, output=str(tmp_path / "fit"), options=options)
    assert handle.accepted
    result = handle.get_result_async()
    wait(result.done)
    answer = result.result().result
    assert answer.success, answer.message
    assert Path(answer.report).is_file()
    sets = ParameterSets.load(answer.parameter_file)
    assert sets.sets[0].condition == "natural"
    rounds = [f.round for f in heard if f.stage == "pso"]
    assert rounds == list(range(1, 7))
    costs = [f.best_cost for f in heard if f.stage == "pso"]
    assert costs == sorted(costs, reverse=True) and costs[-1] > 0
    assert list(heard[-1].parameter_names) == ["E0", "E1", "tau1", "E2"]
    assert len(heard[-1].best_parameters) == 4

    # Bad goals are refused at once, with the reason in the log; the node goes on.
    for fields, words in (
        ({"bags": [str(tmp_path / "none")], "output": str(tmp_path / "x")}, "none: no such bag"),
        ({"bags": [], "output": str(tmp_path / "x")}, "'bags' is empty"),
        ({"bags": bags, "output": str(tmp_path / "x"), "options": {"round": 1}}, "'round'"),
        ({"bags": bags, "output": str(tmp_path / "x"), "text": '{"grid": 1}'}, "'grid'"),
        ({"bags": bags, "output": ""}, "'output' is empty"),
        ({"bags": bags, "output": "~nobody-here"}, "'~nobody-here' is no home folder here"),
        ({"bags": ["~nobody-there/x"], "output": "x"}, "'~nobody-there' is no home folder here"),
    ):
        assert not send(**fields).accepted
        wait(lambda words=words: words in child.output.read_text())
    assert not (tmp_path / "x").exists()

    heard.clear()
    options["rounds"] = 100000
    handle = send(bags=bags, output=str(tmp_path / "cut"), options=options)
    wait(lambda: any(f.stage == "pso" and f.round > 2 for f in heard))
    second = send(bags=bags, output=str(tmp_path / "other")).get_result_async()
    wait(second.done)
    assert second.result().status == GoalStatus.STATUS_ABORTED
    says = second.result().result.message
    assert re.search(r"busy: a fit is running \(3 bags, natural \w+\)", says), says
    wait(handle.cancel_goal_async().done)
    result = handle.get_result_async()
    wait(result.done)
    assert result.result().status == GoalStatus.STATUS_CANCELED
    # The answer does not wait for the report, after which the files are all there.
    wait((tmp_path / "cut" / "report.html").exists)
    entry = json.loads((tmp_path / "cut" / "fit.json").read_text())["conditions"]["natural"]
    assert entry["status"] == "interrupted"
    assert not list((tmp_path / "cut").rglob("*.yaml")), "the best so far is no finger for the node"

    # Ctrl-C on the node's terminal: whoever waits for the fit hears it. A goal that comes while the
    # ended fit still writes its report is told so, and comes again.
    heard.clear()
    while True:
        handle = send(bags=bags, output=str(tmp_path / "end"), options=options)
        result = handle.get_result_async()
        wait(lambda result=result: result.done() or any(f.stage == "pso" for f in heard))
        if not result.done():
            break
        assert "busy: an ended fit is finishing" in result.result().result.message
    child.send_signal(signal.SIGINT)
    wait(result.done)
    assert result.result().status == GoalStatus.STATUS_ABORTED
    assert "deactivated" in result.result().result.message
    assert child.wait(60) == 0, child.output.read_text()


def test_the_home_folder_is_meant_by_a_tilde(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_fit import fit_node
    from finger_msgs.action import FitParameters

    asked: list[Any] = []
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(fit_node, "fit_bags", lambda *arguments: asked.append(arguments))
    (tmp_path / "bag").mkdir()
    goal = FitParameters.Goal(bags=["~/bag"], output="~/fit")
    job = fit_node._Job(goal, fit_node.FitNodeSettings())
    job.thread.join(60)
    ((bags, _, output, *_),) = asked
    assert bags == [str(tmp_path / "bag")] and output == tmp_path / "fit"


@pytest.fixture
def slow_fit(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A fit node whose fit is at something that cannot be interrupted until it is let go."""
    import threading

    from rclpy.action import ActionClient

    from finger_fit import fit_node
    from finger_msgs.action import FitParameters

    let_go, begun = threading.Event(), threading.Event()

    def fit_bags(*arguments: Any) -> Any:
        begun.set()
        assert let_go.wait(100)
        arguments[-1]("natural", "check against full order", 1, 1, 0.0, [])

    monkeypatch.setattr(fit_node, "fit_bags", fit_bags)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    # Nobody publishes /clock: simulated time stands still, which is no reason to wait.
    node = fit_node.FitNode(
        context=context, parameter_overrides=[rclpy.Parameter("use_sim_time", value=True)]
    )
    asker = rclpy.create_node("asker", context=context)
    other = rclpy.create_node("other", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    for each in (node, asker, other):
        executor.add_node(each)
    assert node.bring_up()
    actions = [ActionClient(each, FitParameters, "/fit/fit") for each in (asker, other)]

    def wait(condition: Callable[[], Any], seconds: float = 60) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
            if condition():
                return
        raise AssertionError("nothing came in time")

    def send(folder: Path, client: int = 0) -> Any:
        begun.clear()
        goal = FitParameters.Goal(bags=[str(folder)], output=str(folder))
        asked = actions[client].send_goal_async(goal)
        wait(asked.done)
        handle = asked.result()
        return handle, handle.get_result_async() if handle.accepted else None

    for action in actions:
        wait(action.server_is_ready)
    yield node, wait, send, begun, let_go
    let_go.set()
    executor.shutdown()
    for each in (node, asker, other):
        each.destroy_node()
    rclpy.shutdown(context=context)


def test_a_cancelled_goal_is_answered_at_once_though_the_fit_cannot_stop(
    slow_fit: Any, tmp_path: Path
) -> None:
    from action_msgs.msg import GoalStatus

    node, wait, send, begun, let_go = slow_fit
    times: list[float] = []
    # A busy machine may hold up one answer; where none comes in time, it is the node.
    while not times or (times[-1] >= 2.0 and len(times) < 5):
        handle, result = send(tmp_path)
        wait(begun.is_set)
        asked = time.monotonic()
        wait(handle.cancel_goal_async().done)
        wait(result.done)
        times.append(time.monotonic() - asked)
        assert result.result().status == GoalStatus.STATUS_CANCELED
        assert "is written to" in result.result().result.message
        # Whoever comes next, through a client of its own, hears why not.
        _, early = send(tmp_path, client=1)
        wait(early.done)
        assert early.result().status == GoalStatus.STATUS_ABORTED
        assert "busy: an ended fit is finishing" in early.result().result.message
        let_go.set()
        wait(lambda: not node._job.thread.is_alive())
        let_go.clear()
    assert 1.0 < times[-1] < 2.0, times
    _, again = send(tmp_path)
    wait(begun.is_set)
    let_go.set()
    wait(again.done)
    assert again.result().status == GoalStatus.STATUS_ABORTED  # the stand-in fits nothing


@pytest.mark.parametrize("transition", ["deactivate", "active_shutdown"])
def test_deactivation_and_shutdown_end_the_goal(
    slow_fit: Any, tmp_path: Path, transition: str
) -> None:
    """By the lifecycle service, as tools ask for them."""
    from action_msgs.msg import GoalStatus
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    node, wait, send, begun, let_go = slow_fit
    _, result = send(tmp_path)
    wait(begun.is_set)
    asker = rclpy.create_node("manager", context=node.context)
    node.executor.add_node(asker)
    client = asker.create_client(ChangeState, "/fit/change_state")
    wait(client.service_is_ready)
    number = getattr(Transition, f"TRANSITION_{transition.upper()}")
    answer = client.call_async(ChangeState.Request(transition=Transition(id=number)))
    wait(answer.done)
    assert answer.result().success
    wait(result.done)
    assert result.result().status == GoalStatus.STATUS_ABORTED
    assert "the fit node was deactivated" in result.result().result.message
    if transition == "active_shutdown":
        wait(lambda: node._server is None)
    else:
        # An inactive node takes no goal, and says so at once.
        handle, _ = send(tmp_path, client=1)
        assert not handle.accepted
        assert "not active" in node.health.faults["refused"]
        # Taken down and up again, it serves the next one, once the ended fit is over.
        let_go.set()
        wait(lambda: not node._job.thread.is_alive())
        let_go.clear()
        node.trigger_cleanup()
        assert node.bring_up()
        handle, again = send(tmp_path)
        wait(begun.is_set)
        wait(handle.cancel_goal_async().done)
        wait(again.done)
        assert again.result().status == GoalStatus.STATUS_CANCELED
    asker.destroy_node()
