# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Between nodes of one process, and as bytes: what a fast stream does beside the middleware."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import WrenchStamped  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import Image, Temperature  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from finger_common.node import (  # noqa: E402
    FixedMessage,
    Listeners,
    LocalPublisher,
    LocalSubscription,
)


@pytest.fixture
def node(ros_domain: int) -> Iterator[Any]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("hand", namespace="/left", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.parametrize("frame", ["", "s", "sensor", "a frame with blanks", "Kraftmeßgerät"])
def test_packed_messages_are_those_that_the_middleware_serializes(frame: str) -> None:
    numbers = np.random.default_rng(len(frame)).normal(size=6)
    message = WrenchStamped(header=Header(frame_id=frame))
    packed = FixedMessage(message).pack(1_700_000_000, 999_999_999, *numbers)
    again = deserialize_message(packed, WrenchStamped)
    assert len(packed) == len(serialize_message(message))
    assert (again.header.stamp.sec, again.header.stamp.nanosec) == (1_700_000_000, 999_999_999)
    assert again.header.frame_id == frame
    force, torque = again.wrench.force, again.wrench.torque
    # Bit for bit.
    assert (force.x, force.y, force.z, torque.x, torque.y, torque.z) == tuple(numbers)


def test_a_type_without_a_fixed_layout_is_refused() -> None:
    assert FixedMessage(Temperature()).pack(1, 2, 3.0, 4.0)
    with pytest.raises(TypeError, match="'data' of type sequence<uint8>"):
        FixedMessage(Image())


def test_samples_reach_the_subscribers_of_the_same_topic_only(node: Any) -> None:
    got: list[tuple[str, int]] = []

    def listen(topic: str) -> LocalSubscription:
        return LocalSubscription(node, topic, lambda n: got.append((topic, n)), pytest.fail)

    relative, absolute, other = listen("wrench"), listen("/left/wrench"), listen("/right/wrench")
    assert not relative.fed
    publisher = LocalPublisher(node, "wrench")
    assert relative.fed and absolute.fed and not other.fed
    publisher.send(1)
    relative.close()
    publisher.send(2)
    publisher.close()
    assert got == [("wrench", 1), ("/left/wrench", 1), ("/left/wrench", 2)]
    assert not absolute.fed
    absolute.close()
    other.close()


def test_a_subscriber_that_raises_is_left_out_and_the_others_go_on(node: Any) -> None:
    failures: list[Exception] = []
    calls: list[int] = []
    got: list[int] = []

    def broken(number: int) -> None:
        calls.append(number)
        raise ZeroDivisionError("a defect")

    bad = LocalSubscription(node, "wrench", broken, failures.append)
    good = LocalSubscription(node, "wrench", got.append, pytest.fail)
    publisher = LocalPublisher(node, "wrench")
    for number in range(3):
        publisher.send(number)
    assert got == [0, 1, 2] and calls == [0]
    assert [str(error) for error in failures] == ["a defect"]
    for end in (bad, good, publisher):
        end.close()


def test_what_can_wait_is_left_to_the_publisher_and_guarded_too(node: Any) -> None:
    done: list[str] = []
    failures: list[Exception] = []

    def listen(number: int):
        done.append(f"sample {number}")

        def rest() -> None:
            if number == 1:
                raise ZeroDivisionError("a defect")
            done.append(f"rest {number}")

        return rest

    subscription = LocalSubscription(node, "wrench", listen, failures.append)
    publisher = LocalPublisher(node, "wrench")
    for number in range(3):
        rests = publisher.send(number)
        done.append("sent")
        for rest in rests:
            rest()
    assert done == ["sample 0", "sent", "rest 0", "sample 1", "sent", "sent"]
    assert [str(error) for error in failures] == ["a defect"]
    subscription.close()
    publisher.close()


def test_listeners_are_seen_when_they_come_and_go(node: Any) -> None:
    qos = QoSProfile(depth=1)
    listeners = Listeners(node.create_publisher(WrenchStamped, "seen", qos))

    def seen(wanted: bool) -> bool:
        end = time.monotonic() + 20.0
        while listeners.present() != wanted and time.monotonic() < end:
            time.sleep(0.01)
        return listeners.present() == wanted

    assert not listeners.present()
    subscription = node.create_subscription(WrenchStamped, "seen", lambda _: None, qos)
    assert seen(True)
    node.destroy_subscription(subscription)
    assert seen(False)


def test_what_is_kept_for_later_listeners_always_has_some(node: Any) -> None:
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    assert Listeners(node.create_publisher(WrenchStamped, "kept", qos)).present()
