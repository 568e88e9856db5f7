# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A recording of the real nodes over DDS gives again what they published."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from service_calls import call
from waiting import wait_until

from finger_bag.reader import open_bag
from finger_common.stamps import header_stamp
from finger_offline.process import process as run_offline
from finger_offline.process_options import ProcessOptions

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

SAMPLES = 3000
RECORDED = ("wrench", "contact_area", "moisture", "contact_state", "model_events")
RELIABLE = ("-p", "qos_reliability:=reliable", "-p", "qos_depth:=20000")


class Rig:
    """Publishes forces, areas and readings at their rates, and receives the states of the model."""

    def __init__(self, domain: int) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import WrenchStamped
        from rclpy.qos import QoSProfile

        from finger_common.node import LATCHED_QOS
        from finger_msgs.msg import ContactArea, ContactState, ModelEvent, Moisture

        deep = QoSProfile(depth=20000)
        rclpy.init(domain_id=domain)
        self.node = rclpy.create_node("rig", namespace="/finger")
        self.wrench = self.node.create_publisher(WrenchStamped, "wrench", deep)
        self.area = self.node.create_publisher(ContactArea, "contact_area", deep)
        self.moisture = self.node.create_publisher(Moisture, "moisture", deep)
        self.states: list[Any] = []
        self.events: list[Any] = []
        self.sent = 0
        self.recorded = 0
        self.model: dict[str, str] = {}
        self.node.create_subscription(ContactState, "contact_state", self.states.append, deep)
        self.node.create_subscription(ModelEvent, "model_events", self.events.append, LATCHED_QOS)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def _on_diagnostics(self, array: Any) -> None:
        for status in array.status:
            values = {v.key: v.value for v in status.values}
            if "recorder" in status.name:
                self.recorded = int(values.get("messages", 0))
            if "model" in status.name:
                self.model.update(values, **{status.name: status.message})

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 120.0) -> Any:
        spin = partial(rclpy.spin_once, self.node, timeout_sec=0.05)
        return wait_until(condition, what, spin=spin, seconds=seconds)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        return call(self.node, kind, name, request, partial(self.until, what=name))

    def send(self, publisher: Any, stamp_ns: int, **fields: Any) -> None:
        message = publisher.msg_type(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        message.header.frame_id = "force_sensor"
        publisher.publish(message)
        self.sent += 1

    def force(self, number: int, stamp_ns: int) -> None:
        from geometry_msgs.msg import Vector3, Wrench

        force = Vector3(x=0.01, z=-max(0.0, 1.2 * math.sin(number / 300)))
        self.send(self.wrench, stamp_ns, wrench=Wrench(force=force))

    def join(self) -> None:
        """Send what changes no estimate until the model node and a running recorder have had it.

        A busy middleware loses what comes before it has joined a topic's two ends, at either of
        which it may say that it has.
        """
        stamp = time.time_ns()

        def joined() -> bool:
            known = int(self.model.get("duplicate_areas", 0)) > 0 and any(
                "moisture reading -1" in text for text in self.model.values()
            )
            # Half of what was sent may be all of one topic.
            return known and self.recorded > self.sent / 2

        def resend() -> None:
            self.send(self.area, stamp, area_stddev=1e-6, flags=1)
            self.send(self.moisture, stamp, value=-1.0)
            end = time.monotonic() + 1.0  # what is recorded is told once a second
            while time.monotonic() < end:
                rclpy.spin_once(self.node, timeout_sec=0.05)

        wait_until(joined, "model node and recorder to join", spin=resend, seconds=120.0)

    def press(self) -> None:
        """Some seconds at 500 Hz with late areas, a changed setting and a reset."""
        from rcl_interfaces.msg import Parameter, ParameterValue
        from rcl_interfaces.srv import SetParameters
        from std_srvs.srv import Trigger

        change = SetParameters.Request(
            parameters=[
                Parameter(name="onset_force", value=ParameterValue(type=3, double_value=0.06))
            ]
        )
        begin, begin_ns = time.monotonic(), time.time_ns()
        for number in range(SAMPLES):
            while time.monotonic() < begin + number * 0.002:
                rclpy.spin_once(self.node, timeout_sec=0.0)
            stamp = begin_ns + number * 2_000_000
            self.force(number, stamp)
            if number % 50 == 49:
                # Every third frame is 200 ms old: beyond the fusion delay.
                age = 200_000_000 if number % 150 == 149 else 20_000_000
                force = max(0.0, 1.2 * math.sin(number / 300))
                flags = 0 if force > 0.05 else 1
                area = {"gross_area": 38e-6 * force**0.7, "area_stddev": 1e-6, "flags": flags}
                self.send(self.area, stamp - age, **area)
            if number in (100, 2500):
                self.send(self.moisture, stamp, value=60.0 + number / 100)
            if number == 1000:
                assert (
                    self.call(SetParameters, "model/set_parameters", change).results[0].successful
                )
            if number == 2000:
                assert self.call(Trigger, "model/reset", Trigger.Request()).success

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def rig(ros_domain: int) -> Any:
    rig = Rig(ros_domain)
    yield rig
    rig.close()


def test_processing_a_live_recording_gives_the_published_states_bit_for_bit(
    rig: Rig, process: Any, tmp_path: Path
) -> None:
    from finger_msgs.srv import Record

    names = ("--ros-args", "-r", "__ns:=/finger")
    model = process("-m", "finger_model.model_node", *names, *RELIABLE)
    # A recorder that gets no processor for seconds loses nothing either.
    buffered = ("-p", "buffer_time:=60.0", "-p", f"topics:={list(RECORDED)}")
    recorder = process("-m", "finger_bag.recorder_node", *names, *RELIABLE, *buffered)
    for publisher in (rig.wrench, rig.area, rig.moisture):
        rig.until(lambda p=publisher: p.get_subscription_count() == 2, "model and recorder")
    for topic in ("/finger/contact_state", "/finger/model_events"):
        rig.until(
            lambda t=topic: (
                rig.node.count_publishers(t) == 1 and rig.node.count_subscribers(t) == 2
            ),
            topic,
        )
    started = rig.call(
        Record, "recorder/record", Record.Request(command=1, path=str(tmp_path / "live"))
    )
    assert started.success, started.message
    rig.join()
    rig.press()
    rig.until(lambda: len(rig.states) == SAMPLES, "a state for each force")
    rig.until(lambda: rig.recorded >= rig.sent + 0.5 * SAMPLES, "the recorder")
    before = -1
    while before != rig.recorded:
        before, end = rig.recorded, time.monotonic() + 3.0
        while time.monotonic() < end:
            rclpy.spin_once(rig.node, timeout_sec=0.05)
    stopped = rig.call(Record, "recorder/record", Record.Request(command=0))
    assert stopped.success and stopped.lost_count == 0, stopped.message
    assert model.poll() is None and recorder.poll() is None
    # Start, settings, reset, and late areas, which depend on this run alone.
    assert len(rig.events) > 10

    result = run_offline(tmp_path / "live", tmp_path / "again")
    assert result.replayed
    again, live = states(tmp_path / "again"), states(tmp_path / "live")
    # On a busy machine the middleware joins recorder and model node seconds after it says so.
    assert len(live) > 0.5 * SAMPLES and len(again) == SAMPLES
    again = again[len(again) - len(live) :]
    differing = next((i for i, pair in enumerate(zip(again, live)) if pair[0] != pair[1]), None)
    assert differing is None, report(tmp_path, differing)
    assert again == live
    # The events matter: without the change of the setting other states come out.
    run_offline(
        tmp_path / "live", tmp_path / "other", ProcessOptions(estimator={"onset_force": 0.06})
    )
    assert states(tmp_path / "other") != states(tmp_path / "live")


def report(folder: Path, index: int) -> str:
    """Flags of the states around one that differs, and the recorded inputs and events."""
    lines = []
    for name in ("again", "live"):
        with open_bag(folder / name) as reader:
            found = [m.message for m in reader.messages(["/finger/contact_state"])]
            found.sort(key=lambda m: header_stamp(m))
            begin = header_stamp(found[0])
            lines.append(f"{name} from {index}: {[m.flags for m in found[index - 1 : index + 3]]}")
            for m in reader.messages(["/finger/contact_area", "/finger/model_events"]):
                at = (header_stamp(m.message) - begin) // 2_000_000
                logged = (m.log_time_ns - begin) / 2e6
                what = getattr(m.message, "reason", "area")
                late = str(m.message.settings).partition("late")[2] if what != "area" else ""
                lines.append(f"  {at} {what} {late} logged at {logged:.0f}")
    return "\n".join(lines)


def states(bag: Path) -> list[bytes]:
    with open_bag(bag) as reader:
        found = list(reader.messages(["/finger/contact_state"]))
    return [
        m.raw
        for m in sorted(
            found, key=lambda m: m.message.header.stamp.sec * 10**9 + m.message.header.stamp.nanosec
        )
    ]


def test_a_burst_of_events_is_recorded_whole(rig: Rig, process: Any, tmp_path: Path) -> None:
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, QoSProfile

    from finger_msgs.msg import ModelEvent, Trial
    from finger_msgs.srv import Record

    process("-m", "finger_bag.recorder_node", "--ros-args", "-r", "__ns:=/finger")
    keeping = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = rig.node.create_publisher(ModelEvent, "model_events", keeping)
    rig.until(lambda: publisher.get_subscription_count() == 2, "recorder and rig")
    trial = Trial(subject="S01")
    trial.header.frame_id = "right_index"
    request = Record.Request(command=1, path=str(tmp_path / "burst"), trial=trial)
    started = rig.call(Record, "recorder/record", request)
    assert started.success, started.message
    for number in range(100):
        publisher.publish(ModelEvent(reason=str(number)))
    assert publisher.wait_for_all_acked(Duration(seconds=60))
    stopped = rig.call(Record, "recorder/record", Record.Request(command=0))
    assert stopped.success and stopped.lost_count == 0, stopped.message
    with open_bag(tmp_path / "burst") as reader:
        assert (reader.info.metadata.subject, reader.info.metadata.finger) == ("S01", "right_index")
        reasons = [m.message.reason for m in reader.messages(["/finger/model_events"])]
    assert reasons == [str(number) for number in range(100)]
