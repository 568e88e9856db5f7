# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Lab Streaming Layer: streams out and in with their stamps, in a session of their own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed")

from geometry_msgs.msg import WrenchStamped  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from service_calls import answer  # noqa: E402

from finger_bridge import lsl  # noqa: E402
from finger_bridge.lsl import STREAMS, ClockMap, fill_message, sample_of  # noqa: E402
from finger_bridge.lsl_node import LslSettings  # noqa: E402
from finger_common.errors import InputError  # noqa: E402
from finger_common.node import LATCHED_QOS  # noqa: E402
from finger_common.stamps import fill_time, header_stamp  # noqa: E402
from finger_msgs.msg import ContactArea, ContactState, Moisture, Trial  # noqa: E402


def test_the_error_of_the_clock_map_is_a_bound() -> None:
    """Readings of one clock take 0 to 1 ms of the other; the true offset is known."""
    true, now = 1_700_000_000_000_000_000, [0]

    def tick() -> None:
        now[0] += (now[0] * 7919 + 104_729) % 1_000_003

    def ros() -> int:
        tick()
        return now[0] + true

    def local() -> float:
        tick()
        return now[0] * 1e-9

    clocks = ClockMap(ros, local, readings=20)
    assert 0 < clocks.error < 1e-3
    assert abs(clocks.to_ros(5.0) - (true + 5 * 10**9)) <= clocks.error * 1e9 + 500
    assert clocks.to_lsl(clocks.to_ros(7.25)) == pytest.approx(7.25, abs=1e-9)
    assert ClockMap(time.time_ns).error < 1e-3, "on this machine"


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("wrench", WrenchStamped()),
        ("contact_area", ContactArea(gross_area=1e-4, real_area=5e-5, area_stddev=2e-6, flags=8)),
        ("moisture", Moisture(value=43.5)),
        ("contact_state", ContactState(normal_force=1.2, in_contact=True, area=9e-5, flags=256)),
        ("trial", Trial(subject="S01", condition="dry", index=3, phase=Trial.PHASE_LIFT)),
    ],
)
def test_a_message_comes_back_from_its_sample(topic: str, message: Any) -> None:
    sample = sample_of(STREAMS[topic], message)
    back = type(message)()
    fill_message(STREAMS[topic], back, sample)
    assert sample_of(STREAMS[topic], back) == sample
    assert len(sample) == (len(STREAMS[topic].channels) or 1)


@pytest.mark.parametrize(
    "marker",
    [
        *("go", "{}", '{"phase": "up"}', "[1]", '{"phase": 3}', "[" * 100_000, "9" * 5000),
        '{"phase": "press", "index": -1}',
    ],
)
def test_a_marker_that_is_no_trial_is_named(marker: str) -> None:
    with pytest.raises(InputError, match="is no trial"):
        fill_message(STREAMS["trial"], Trial(check_fields=True), [marker])


def test_settings_that_cannot_be_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for settings, says in (
        ({"send": ["wrenches"]}, "did you mean 'wrench'"),
        ({"receive": ["moisture"]}, "give 'topic=name of the stream'"),
        ({"receive": ["contact_state=A"]}, "'contact_state=A' is not understood"),
        ({"receive": ["wrench=Plate"]}, "'wrench' is in 'send' and in 'receive'"),
    ):
        with pytest.raises(InputError, match=says):
            LslSettings(**settings)  # type: ignore[arg-type]
    monkeypatch.setattr(lsl, "pylsl", None)
    with pytest.raises(InputError, match="pip install pylsl"):
        lsl.require()


def test_streams_go_out_and_come_in_with_their_time(
    ros_domain: int, process: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "lsl_api.cfg"
    config.write_text(f"[multicast]\nResolveScope = machine\n[lab]\nSessionID = test{ros_domain}\n")
    monkeypatch.setenv("LSLAPICFG", str(config))
    # liblsl reads its configuration once, so that the other side of LSL is a process, too.
    script = Path(__file__).with_name("lsl_peer.py")
    helper = process(script, tmp_path / "peer.json")
    node = process(
        *("-m", "finger_bridge.lsl_node", "--ros-args", "-r", "__ns:=/left"),
        *("-p", "send:=[wrench, trial]", "-p", "receive:=['moisture=Corneometer']"),
    )
    rclpy.init()
    try:
        peer = rclpy.create_node("peer", namespace="left")
        wrench = peer.create_publisher(WrenchStamped, "wrench", LATCHED_QOS)
        trial = peer.create_publisher(Trial, "trial", LATCHED_QOS)
        readings: list[Moisture] = []
        peer.create_subscription(Moisture, "moisture", readings.append, qos_profile_sensor_data)
        message = WrenchStamped()
        sent: dict[float, int] = {}

        def until(condition: Callable[[], Any], act: Callable[[], None] = lambda: None) -> None:
            end = time.monotonic() + 90
            while not condition():
                assert time.monotonic() < end, (node.output.read_text(), helper.output.read_text())
                act()
                rclpy.spin_once(peer, timeout_sec=0.02)

        def press() -> None:
            stamp = time.time_ns()
            message.wrench.force.z = float(len(sent))
            sent[message.wrench.force.z] = stamp
            fill_time(message.header.stamp, stamp)
            wrench.publish(message)

        trial.publish(Trial(subject="S01", phase=Trial.PHASE_PRESS))
        until(lambda: (tmp_path / "peer.json").exists() and readings, press)
        seen = json.loads((tmp_path / "peer.json").read_text())
        # Paused and taken up again, it is the only publisher of what it receives, as before.
        change = peer.create_client(ChangeState, "lsl/change_state")
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE) * 2:
            request = ChangeState.Request(transition=Transition(id=transition))
            assert answer(change, request, until).success
        count = len(readings)
        until(lambda: len(readings) > count)
        assert peer.count_publishers("moisture") == 1
        # The other program ends and comes again; then it comes with another clock.
        helper.kill()
        until(lambda: "broke off" in node.output.read_text())
        helper = process(script, tmp_path / "again.json")
        count = len(readings)
        until(lambda: len(readings) > count, press)
        helper.kill()
        helper = process(script, tmp_path / "unix.json", "unix")
        until(lambda: "s ahead, and are left out; stamp" in node.output.read_text(), press)
        assert all(header_stamp(reading) < time.time_ns() for reading in readings)
    finally:
        rclpy.try_shutdown()
    assert seen["labels"] == [channel.label for channel in STREAMS["wrench"].channels]
    assert seen["marker"]["subject"] == "S01" and seen["marker"]["phase"] == "press"
    # The peer maps LSL's clock to the wall clock by itself.
    for force, wall in seen["samples"]:
        assert abs(wall - sent[force] * 1e-9) < 2e-3
    first = readings[0]
    assert abs(header_stamp(first) * 1e-9 - seen["began"] - first.value) < 5e-3
