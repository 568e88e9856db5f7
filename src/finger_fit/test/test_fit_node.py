"""The fit node over DDS: goal, feedback, result, cancel, bad goals."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")


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

    def wait(condition: Callable[[], Any], seconds: float = 90) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
            found = condition()
            if found:
                return found
        raise AssertionError("nothing came in time: " + child.output.read_text())

    wait(action.server_is_ready)
    yield action, wait, FitParameters
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

    from finger_model.parameter_sets import ParameterSets

    action, wait, FitParameters = client
    bags = write_bags(tmp_path, double)
    options = {"full_order": False, "profiles": False, "bootstrap": 0, "grid": 2, "rounds": 6}
    heard: list[Any] = []

    def send(**fields: Any) -> Any:
        goal = FitParameters.Goal(**fields)
        asked = action.send_goal_async(goal, lambda m: heard.append(m.feedback))
        wait(asked.done)
        return asked.result()

    handle = send(bags=bags, output=str(tmp_path / "fit"), options=json.dumps(options))
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

    # Bad goals are aborted with the reason; the node goes on.
    for fields, words in (
        ({"bags": [str(tmp_path / "none")], "output": str(tmp_path / "x")}, "none"),
        ({"bags": bags, "output": str(tmp_path / "x"), "options": '{"round": 1}'}, "'round'"),
        ({"bags": bags, "output": ""}, "output"),
    ):
        handle = send(**fields)
        result = handle.get_result_async()
        wait(result.done)
        assert result.result().status == GoalStatus.STATUS_ABORTED
        assert words in result.result().result.message

    heard.clear()
    options["rounds"] = 100000
    handle = send(bags=bags, output=str(tmp_path / "cut"), options=json.dumps(options))
    second = send(bags=bags, output=str(tmp_path / "other"))
    assert not second.accepted, "one goal at a time"
    wait(lambda: any(f.stage == "pso" and f.round > 2 for f in heard))
    wait(handle.cancel_goal_async().done)
    result = handle.get_result_async()
    wait(result.done)
    assert result.result().status == GoalStatus.STATUS_CANCELED
    entry = json.loads((tmp_path / "cut" / "fit.json").read_text())["conditions"]["natural"]
    assert entry["status"] == "interrupted"
    assert ParameterSets.load(result.result().result.parameter_file).sets
