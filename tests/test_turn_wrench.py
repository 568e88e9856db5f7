"""The example that turns the wrench of a sensor at an angle."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def test_a_press_along_the_leaning_normal_comes_out_along_z(
    module_of: Callable[[str], Any],
) -> None:
    turned = module_of("examples/turn_wrench.py").turned
    angle = math.radians(20.0)
    normal = 0.0, math.sin(angle), math.cos(angle)
    assert turned(normal, angle) == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    assert turned((0.3, 0.0, 0.0), angle) == pytest.approx((0.3, 0.0, 0.0))


def test_the_force_on_a_finger_comes_out_as_that_on_the_plate(
    module_of: Callable[[str], Any],
) -> None:
    turned = module_of("examples/turn_wrench.py").turned
    angle = math.radians(20.0)
    on_finger = -0.3, -2.0 * math.sin(angle), -2.0 * math.cos(angle)
    assert turned(on_finger, angle, negate=True) == pytest.approx((0.3, 0.0, 2.0), abs=1e-12)


def test_the_node_turns_and_negates(
    ros_domain: int, process: Callable[..., Any], project_root: Path
) -> None:
    rclpy = pytest.importorskip("rclpy")
    from geometry_msgs.msg import WrenchStamped

    process(project_root / "examples" / "turn_wrench.py", "90", "--negate")
    rclpy.init()
    node = rclpy.create_node("behind_the_finger")
    found: list[Any] = []
    node.create_subscription(WrenchStamped, "wrench_turned", found.append, 10)
    publisher = node.create_publisher(WrenchStamped, "wrench", 10)
    message = WrenchStamped()
    message.header.stamp.sec = 7
    message.wrench.force.y, message.wrench.torque.x = -2.0, 0.5
    end = time.monotonic() + 60.0
    while not found and time.monotonic() < end:
        publisher.publish(message)
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()
    force, torque = found[0].wrench.force, found[0].wrench.torque
    assert (force.x, force.y, force.z) == pytest.approx((0.0, 0.0, 2.0), abs=1e-12)
    assert (torque.x, torque.y, torque.z) == pytest.approx((-0.5, 0.0, 0.0), abs=1e-12)
    assert found[0].header.stamp.sec == 7
