"""The example controller holds a contact area on a simulated finger, and opens when it cannot trust the state."""

from __future__ import annotations

import importlib.util
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_model.estimator import ContactEstimator
from finger_model.reduced import ReducedModel

NATURAL = np.array([140e3, 22.35e3, 0.5, 1795e3])
SOFTER = NATURAL * np.array([0.8, 0.8, 1.2, 1.0])
"""The simulated finger: not what the estimator believes."""

TARGET = 30e-6


@pytest.fixture(scope="module")
def example(project_root: Path) -> Any:
    path = project_root / "examples" / "grasp_controller.py"
    spec = importlib.util.spec_from_file_location("grasp_controller", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["grasp_controller"] = module
    spec.loader.exec_module(module)
    return module


class Finger:
    """A finger of SOFTER held against a plate by an actuator with a lag of 20 ms; 500 Hz."""

    def __init__(self) -> None:
        self.model = ReducedModel.load()
        self.state = self.model.start(SOFTER)
        self.force = 0.0
        self.area = 0.0

    def step(self, command: float, dt: float = 0.002) -> None:
        self.force += (command - self.force) * (1 - math.exp(-dt / 0.02))
        self.area = self.model.step(self.state, dt, self.force).area


def test_the_area_is_within_five_percent_after_one_second(example: Any) -> None:
    finger, controller = Finger(), example.AreaController(TARGET)
    estimator = ContactEstimator(finger.model)
    rng = np.random.default_rng(1)
    frames: list[tuple[int, float]] = []
    areas = []
    begin = None
    for n in range(2000):
        now, stamp = n * 0.002, 10**18 + n * 2_000_000
        if n % 50 == 25:
            frames.append((stamp, finger.area))
        if frames and stamp - frames[0][0] >= 60_000_000:
            taken, area = frames.pop(0)
            sd = 0.02 * area + 0.2e-6
            estimator.add_area(taken, area + sd * rng.normal(), sd, 0 if area > 2e-6 else 1)
        normal = finger.force + 0.003 * rng.normal()
        for estimate in estimator.add_wrench(stamp, (0.0, 0.0, -normal)):
            controller.on_state(
                now,
                estimate.area,
                estimate.area_force_slope,
                estimate.in_contact,
                estimate.flags,
            )
        if n % 5 == 0:
            command = controller.command(now, 0.01)
            if command > 0 and begin is None:
                begin = n
        finger.step(command)
        areas.append(finger.area)
    assert begin is not None
    settled = np.array(areas[begin + 500 :])
    assert np.abs(settled / TARGET - 1).max() < 0.05


def test_it_opens_on_a_stale_or_invalid_state_and_waits_before_pressing_again(example: Any) -> None:
    controller = example.AreaController(TARGET)

    def run(seconds: float, at: float, flags: int | None = 0) -> tuple[float, float]:
        for _ in range(round(seconds / 0.01)):
            at += 0.01
            if flags is not None:
                controller.on_state(at, 20e-6, 40e-6, True, flags)
            force = controller.command(at, 0.01)
        return force, at

    force, at = run(1.0, 0.0)
    assert force > 0
    force, at = run(0.06, at, None)
    assert force == 0.0
    assert "stale" in controller.reason
    force, at = run(0.15, at)
    assert force == 0.0
    force, at = run(0.5, at)
    assert force > 0
    for bad in (1, 4096, 8192):
        force, at = run(0.02, at, bad)
        assert force == 0.0
        force, at = run(0.5, at)
        assert force > 0
    controller.on_state(at + 0.01, float("nan"), 40e-6, True, 0)
    assert controller.command(at + 0.01, 0.01) == 0.0


@pytest.fixture
def ros(ros_domain: int) -> Iterator[Any]:
    import rclpy

    rclpy.init()
    node = rclpy.create_node("finger_plant")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_the_nodes_together_hold_the_area_and_open_without_state(
    ros: Any, process: Callable[..., Any], project_root: Path
) -> None:
    import rclpy
    from finger_msgs.msg import ContactArea
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    finger = Finger()
    command = [0.0]
    best = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
    wrench = ros.create_publisher(WrenchStamped, "/finger/wrench", best)
    seen = ros.create_publisher(ContactArea, "/finger/contact_area", best)
    ros.create_subscription(
        Float64, "/finger/grasp_force", lambda m: command.__setitem__(0, m.data), 1
    )
    process("-m", "finger_model.model_node", "--ros-args", "-r", "__ns:=/finger")
    controller = project_root / "examples" / "grasp_controller.py"
    process(controller, "--ros-args", "-r", "__ns:=/finger", "-p", f"target_area:={TARGET!r}")
    message, picture = WrenchStamped(), ContactArea()
    frames: list[tuple[int, float]] = []
    areas: list[tuple[float, float]] = []
    pressed_at = None
    begin = time.monotonic()
    due = stepped = begin
    n = 0
    while time.monotonic() - begin < 90:
        due = max(due + 0.002, time.monotonic() - 0.05)
        stamp = time.time_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.wrench.force.z = -finger.force
        wrench.publish(message)
        n += 1
        if n % 50 == 0:
            frames.append((stamp, finger.area))
        if frames and stamp - frames[0][0] > 40_000_000:
            taken, area = frames.pop(0)
            picture.header.stamp.sec, picture.header.stamp.nanosec = divmod(taken, 10**9)
            picture.gross_area, picture.area_stddev = area, 0.02 * area + 0.2e-6
            picture.flags = 0 if area > 2e-6 else 1
            seen.publish(picture)
        rclpy.spin_once(ros, timeout_sec=max(due - time.monotonic(), 0.0))
        while (wait := due - time.monotonic()) > 0:
            rclpy.spin_once(ros, timeout_sec=wait)
        finger.step(command[0], time.monotonic() - stepped)
        stepped = time.monotonic()
        if pressed_at is None and command[0] > 0:
            pressed_at = time.monotonic()
        if pressed_at is not None:
            areas.append((time.monotonic() - pressed_at, finger.area))
            if areas[-1][0] > 3.0:
                break
    assert pressed_at is not None, "the controller never pressed"
    held = np.array([a for t, a in areas if t > 1.0])
    assert np.abs(np.median(held) / TARGET - 1) < 0.05
    assert np.mean(np.abs(held / TARGET - 1) < 0.05) > 0.95
    # No more wrench, so no more contact state.
    quiet = time.monotonic()
    while command[0] > 0 and time.monotonic() - quiet < 2.0:
        rclpy.spin_once(ros, timeout_sec=0.05)
    assert command[0] == 0.0
