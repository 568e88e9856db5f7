# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Two fingers in one process, with simulated boards in others: samples, an error, the end."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import WrenchStamped  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from service_calls import call  # noqa: E402
from waiting import wait_until  # noqa: E402

from finger_bringup import nodes  # noqa: E402
from finger_bringup.bring_up import ALL_ACTIVE  # noqa: E402
from finger_bringup.parameter_files import ParameterFile  # noqa: E402
from finger_common.node import LATCHED_QOS  # noqa: E402
from finger_common.stamps import header_stamp  # noqa: E402
from finger_model.estimator import ContactEstimator, replay  # noqa: E402
from finger_model.finger import load_reduced  # noqa: E402
from finger_model.messages import event_of, state_numbers, wrench_of  # noqa: E402
from finger_msgs.msg import ContactState, ModelEvent  # noqa: E402

BROKEN_MODEL = """
import sys
from pathlib import Path
from finger_common.node import main_of
from finger_model.model_node import ModelNode

class BrokenModel(ModelNode):
    def _on_sample(self, *sample):
        if Path({flag!r}).exists():
            Path({flag!r}).unlink()
            raise ZeroDivisionError("a defect of the model")
        return super()._on_sample(*sample)

main = main_of(BrokenModel)
"""

RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)


class Hand:
    """The composed process and what it publishes."""

    def __init__(self, child: Any, domain: int) -> None:
        self.child = child
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("observer", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.states: dict[str, list[ContactState]] = {}
        self.wrenches: dict[str, list[WrenchStamped]] = {}
        self.events: list[ModelEvent] = []
        listen = self.node.create_subscription
        for finger in ("thumb", "index"):
            states, wrenches = self.states.setdefault(finger, []), []
            self.wrenches[finger] = wrenches
            listen(ContactState, f"/hand/{finger}/contact_state", states.append, RELIABLE)
            listen(WrenchStamped, f"/hand/{finger}/wrench", wrenches.append, RELIABLE)
        listen(ModelEvent, "/hand/index/model_events", self.events.append, LATCHED_QOS)

    @property
    def log(self) -> str:
        return str(self.child.output.read_text())

    def node_names(self) -> set[str]:
        """Full names of the nodes there are."""
        found = self.node.get_node_names_and_namespaces()
        return {f"{namespace}/{name}" for name, namespace in found}

    def change(self, node: str, transition: int) -> None:
        """Ask a node for a transition of its lifecycle and wait until it is done."""
        request = ChangeState.Request(transition=Transition(id=transition))
        name = f"/hand/{node}/change_state"
        assert call(self.node, ChangeState, name, request, self.until).success, self.log[-4000:]

    def until(self, condition: Callable[[], Any]) -> Any:
        spin = partial(self._executor.spin_once, timeout_sec=0.05)
        return wait_until(condition, lambda: self.log[-4000:], spin=spin, seconds=150.0)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def hand(
    process: Callable[..., Any], ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Hand]:
    boards, devices = nodes.simulated_boards(["thumb", "index"])
    (tmp_path / "broken_model.py").write_text(BROKEN_MODEL.format(flag=str(tmp_path / "break it")))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    own = tmp_path / "hand.yaml"
    reliable = {"ros__parameters": {"qos_reliability": "reliable", "qos_depth": 5000}}
    own.write_text(yaml.safe_dump({"/**": reliable}))
    chosen = nodes.hand(["thumb", "index"], parameters=devices)
    file = ParameterFile(own)
    (spec,) = nodes.process_specs(chosen, tmp_path, "hand", file, compose=True, realtime=True)
    command = [
        part.replace("/hand/thumb=finger_model.model_node", "/hand/thumb=broken_model")
        for part in spec.command[1:]
    ]
    assert "/hand/thumb=broken_model" in command
    for board in boards:
        process(*board.command[1:])
    running = Hand(process(*command), ros_domain)
    yield running
    running.close()


@pytest.mark.alone
def test_a_hand_in_one_process(hand: Hand, tmp_path: Path) -> None:
    index, thumb = hand.states["index"], hand.states["thumb"]
    hand.until(lambda: ALL_ACTIVE in hand.log and len(index) > 1000 and len(thumb) > 1000)
    hand.until(lambda: any(m.in_contact for m in index))

    # Every thread has real-time priority, or the log says why not.
    hand.until(lambda: "in real time" in hand.log or "no right to real-time" in hand.log)
    if "in real time" in hand.log:
        threads = map(int, os.listdir(f"/proc/{hand.child.pid}/task"))
        assert {os.sched_getscheduler(thread) for thread in threads} == {os.SCHED_FIFO}

    # Between force and model nothing goes through DDS: this test alone subscribes.
    assert hand.node.count_subscribers("/hand/index/wrench") == 1
    assert hand.node.count_publishers("/hand/index/wrench") == 1

    # What it published is what the estimator makes of the published forces, bit for bit: from a
    # second start on, since the first samples went out before this test was seen by the publisher.
    hand.change("index/model", Transition.TRANSITION_DEACTIVATE)
    index.clear()
    hand.change("index/model", Transition.TRANSITION_ACTIVATE)
    hand.until(lambda: len(hand.events) == 2 and len(index) > 2500)
    assert any(m.in_contact for m in index)
    published = list(index)
    hand.until(lambda: header_stamp(hand.wrenches["index"][-1]) >= header_stamp(published[-1]))
    wrenches = {header_stamp(m): m for m in hand.wrenches["index"]}
    begin = event_of(hand.events[-1]).stamp_ns
    last = header_stamp(published[-1])
    stamps = sorted(s for s in wrenches if begin <= s <= last)
    forces = np.array([wrench_of(wrenches[s])[1] for s in stamps])
    (block,) = replay(
        ContactEstimator(load_reduced()),
        [(np.array(stamps), forces)],
        events=[event_of(hand.events[-1])],
    )
    expected = {e.stamp_ns: repr(state_numbers(e)) for e in block}
    seen = [m for m in published if header_stamp(m) in expected]
    assert len(seen) > 900
    for message in seen:
        assert numbers(message) == expected[header_stamp(message)]
    assert any(m.in_contact for m in seen)

    # An error in one node: the others go on, and it is made again and brought up.
    hand.until(lambda: hand.node.count_publishers("/hand/thumb/contact_state") == 1)
    (tmp_path / "break it").touch()
    hand.until(lambda: "a defect of the model" in hand.log)
    counts = len(index), len(hand.wrenches["thumb"])
    hand.until(lambda: "/hand/thumb/model failed, the other nodes go on" in hand.log)
    hand.until(lambda: len(index) > counts[0] + 500)
    hand.until(lambda: len(hand.wrenches["thumb"]) > counts[1] + 500)
    gone = len(thumb)
    hand.until(lambda: len(thumb) > gone + 500)
    intervals = np.diff([header_stamp(m) for m in index])
    missing = set(map(header_stamp, hand.wrenches["index"])) - set(map(header_stamp, index))
    assert (intervals > 0).all()
    assert not {s for s in missing if begin <= s <= header_stamp(index[-1])}

    # The end: all released, and nothing reported.
    hand.child.send_signal(signal.SIGINT)
    assert hand.child.wait(60) == 0
    assert hand.log.count("Traceback") == 1, hand.log


def test_a_clock_outside_the_times_of_messages_is_told(
    process: Callable[..., Any], ros_domain: int, tmp_path: Path
) -> None:
    script = tmp_path / "hand.py"
    script.write_text(
        "import time\ntime.time_ns = lambda: -(10**9)\n"
        "from finger_bringup.composed_node import main\nmain(['thumb=finger_model.model_node'])\n"
    )
    child = process(script)
    assert child.wait(30) == 2
    said = child.output.read_text()
    assert said.startswith("composed_node: the system clock says 1969-12-31 23:59:59 UTC")
    assert said.count("\n") == 1


def test_a_finger_without_its_sensor_holds_up_no_other_and_comes_when_it_is_plugged_in(
    process: Callable[..., Any], ros_domain: int, tmp_path: Path
) -> None:
    boards, devices = nodes.simulated_boards(["thumb", "index"])
    own = tmp_path / "hand.yaml"
    quick = {
        "/**/force": {"connect_timeout": 0.5, "rate": 100.0, "response_timeout": 0.2},
        "/**/bring_up": {"patience": 2.0, "retry": 0.5},
    }
    own.write_text(yaml.safe_dump({node: {"ros__parameters": v} for node, v in quick.items()}))
    chosen = nodes.hand(["thumb", "index"], parameters=devices)
    (spec,) = nodes.process_specs(chosen, tmp_path, "hand", ParameterFile(own), compose=True)
    process(*boards[1].command[1:])
    running = Hand(process(*spec.command[1:]), ros_domain)
    try:
        running.until(lambda: len(running.states["index"]) > 100)
        running.until(lambda: "/hand/thumb/force" in running.node_names())
        assert not running.states["thumb"]
        assert "[hand.thumb.force]: configure failed: NETCANOEM" in running.log
        assert "Traceback" not in running.log and ALL_ACTIVE not in running.log
        process(*boards[0].command[1:])
        running.until(lambda: len(running.states["thumb"]) > 100)
        running.until(lambda: ALL_ACTIVE in running.log)
        # Ctrl-C by an impatient hand.
        running.child.send_signal(signal.SIGINT)
        time.sleep(0.05)
        running.child.send_signal(signal.SIGINT)
        assert running.child.wait(60) == 0
        assert "Traceback" not in running.log
    finally:
        running.close()


def numbers(message: ContactState) -> str:
    """Numbers of a message as `state_numbers` gives those of an estimate, NaN equal to NaN."""
    found: list[Any] = []

    def add(part: Any) -> None:
        for name, kind in part.get_fields_and_field_types().items():
            value = getattr(part, name)
            if hasattr(value, "get_fields_and_field_types"):
                add(value)
            elif kind != "string":
                found.append(value)

    add(message)
    return repr(tuple(found))


def test_what_is_no_node_is_refused(process: Callable[..., Any]) -> None:
    child = process("-m", "finger_bringup.composed_node", "/hand=finger_model.paper")
    assert child.wait(60) == 2
    text = child.output.read_text()
    assert "NAMESPACE=MODULE of a node of the suite is needed" in text and "Traceback" not in text
