"""The example controller holds a contact area on a simulated finger; its force on bad states."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import wait_until

from finger_common.flags import FORCE_ALONE, StateFlag
from finger_common.stamps import fill_time, header_stamp
from finger_model.estimator import ContactEstimator
from finger_model.finger import load_reduced
from finger_model.material import Material
from finger_model.reduced import ReducedModel

SOFTER = Material().vector() * np.array([0.8, 0.8, 1.2, 1.0])
"""Parameters of the simulated finger, which differ from the estimator's."""

TARGET = 30e-6


@pytest.fixture(scope="module")
def example(module_of: Callable[[str], Any]) -> Any:
    return module_of("examples/grasp_controller.py")


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


def regulated(
    controller: Any,
    seconds: float,
    apart: tuple[float, float],
    faulty: Callable[[int], float] = lambda n: 0.0,
) -> tuple[np.ndarray, int]:
    """Areas (n,) in m² at 500 Hz under the controller, and the first sample it pressed at; between
    the two times `apart` (s) the plate is out of reach, so that no command makes a force. faulty:
    error (N) of a sample of the force."""
    finger, estimator = Finger(), ContactEstimator(load_reduced())
    rng = np.random.default_rng(1)
    frames: list[tuple[int, float]] = []
    areas = []
    begin = None
    command = 0.0
    for n in range(round(seconds / 0.002)):
        now, stamp = n * 0.002, 10**18 + n * 2_000_000
        if n % 50 == 25:
            frames.append((stamp, finger.area))
        if frames and stamp - frames[0][0] >= 60_000_000:
            taken, area = frames.pop(0)
            sd = 0.02 * area + 0.2e-6
            estimator.add_area(taken, area + sd * rng.normal(), sd, 0 if area > 2e-6 else 1)
        normal = finger.force + 0.003 * rng.normal() + faulty(n)
        for estimate in estimator.add_wrench(stamp, (0.0, 0.0, -normal)):
            command = controller.on_state(
                now,
                now,
                estimate.area,
                estimate.area_force_slope,
                estimate.in_contact,
                estimate.flags,
                estimate.area_stddev,
            )
        if command > 0 and begin is None:
            begin = n
        finger.step(0.0 if apart[0] <= now < apart[1] else command)
        areas.append(finger.area)
    assert begin is not None
    return np.array(areas), begin


def test_the_area_is_within_five_percent_after_1_1_seconds(example: Any) -> None:
    areas, begin = regulated(example.AreaController(TARGET), 4.0, (0.0, 0.0))
    assert np.abs(areas[begin + 550 :] / TARGET - 1).max() < 0.05


@pytest.mark.parametrize(
    "apart", [(0.0, 2.0), (3.0, 4.0)], ids=["long approach", "lost and touched again"]
)
def test_no_large_force_waits_for_the_touch(example: Any, apart: tuple[float, float]) -> None:
    controller = example.AreaController(TARGET)
    areas, _ = regulated(controller, 7.0, apart)
    touched = areas[round(apart[1] / 0.002) :]
    assert touched.max() < 1.15 * TARGET
    assert np.abs(touched[550:] / TARGET - 1).max() < 0.05


def run(
    controller: Any, seconds: float, at: float, flags: int | None = 0, sd: float = 0.0
) -> tuple[float, float]:
    """Force and time after states of 100 Hz, or after none where flags is None."""
    for _ in range(round(seconds / 0.01)):
        at += 0.01
        if flags is not None:
            controller.on_state(at, at, 20e-6, 40e-6, True, flags, sd)
        force = controller.watch(at)
    return force, at


def test_it_holds_on_stale_states_and_waits_before_it_goes_on(example: Any) -> None:
    controller = example.AreaController(TARGET)
    force, at = run(controller, 0.6, 0.0)
    assert force > 0
    held, at = run(controller, 5.0, at, None)
    assert held == force
    assert "stale" in controller.reason
    held, at = run(controller, 0.15, at)
    assert held == force
    further, at = run(controller, 0.5, at)
    assert further > force


def test_the_reason_does_not_change_with_each_state_that_comes_slowly(example: Any) -> None:
    controller = example.AreaController(TARGET)
    flags, reasons = int(StateFlag.FORCE_OFFSET), []
    for i in range(1, 6):
        controller.on_state(0.1 * i, 0.1 * i, 20e-6, 40e-6, True, flags)
        reasons.append(controller.reason)
        controller.watch(0.1 * i + 0.09)
        reasons.append(controller.reason)
    assert set(reasons) == {"contact state is stale"}


def test_the_node_says_on_which_topic_no_state_comes(
    ros_domain: int, process: Callable[..., Any], project_root: Path
) -> None:
    controller = project_root / "examples" / "grasp_controller.py"
    child = process(controller, "--ros-args", "-r", "__ns:=/thumb")
    said = "holding 0.00 N: contact state is stale (/thumb/contact_state, publishers: 0)"
    wait_until(lambda: said in child.output.read_text(), said)


def test_a_large_force_does_not_wait_for_the_touch_after_a_hole_in_the_states(
    example: Any,
) -> None:
    controller = example.AreaController(TARGET)
    force, at = run(controller, 2.0, 0.0)
    assert force > controller.approach_force
    held, at = run(controller, 3.0, at, None)
    assert held == force
    for _ in range(6):
        at += 0.01
        found = controller.on_state(at, at, 0.0, 0.0, False, 0)
    assert found == controller.approach_force


def test_slow_states_without_contact_end_the_large_force(example: Any) -> None:
    """Each of them is stale before the next one comes."""
    controller = example.AreaController(TARGET)
    force, at = run(controller, 2.0, 0.0)
    assert force > controller.approach_force
    for _ in range(2):
        _, at = run(controller, 0.09, at, None)
        at += 0.01
        found = controller.on_state(at, at, 0.0, 0.0, False, 0)
    assert found == controller.approach_force


@pytest.mark.parametrize("wrong", [1, 15], ids=["one sample", "30 ms"])
def test_wrong_samples_below_the_contact_do_not_let_go(example: Any, wrong: int) -> None:
    """Once a second the force reads 2 N less for up to 30 ms, while a plate is held."""

    def faulty(n: int) -> float:
        return -2.0 if n > 1500 and n % 500 < wrong else 0.0

    target = 45e-6  # of 0.44 N, far above approach_force
    areas, begin = regulated(example.AreaController(target), 7.0, (0.0, 0.0), faulty)
    # Each time another contact begins for the estimator.
    assert np.abs(areas[begin + 550 :] / target - 1).max() < 0.1


def test_states_without_contact_must_last_until_the_force_falls(example: Any) -> None:
    """A state with a contact, or one that is not valid, between them begins their time anew."""
    controller = example.AreaController(TARGET)
    force, at = run(controller, 2.0, 0.0)
    for between in (0, int(StateFlag.FORCE_INVALID)):
        for _ in range(20):
            for _ in range(3):
                at += 0.01
                assert controller.on_state(at, at, 0.0, 0.0, False, 0) == force
            _, at = run(controller, 0.01, at, between)
            force = controller.force
    for _ in range(6):
        at += 0.01
        found = controller.on_state(at, at, 0.0, 0.0, False, 0)
    assert found == controller.approach_force


@pytest.mark.parametrize(
    ("bad", "opens"),
    [
        (StateFlag.FORCE_INVALID, True),
        (StateFlag.MODEL_FAILED, True),
        (StateFlag.TIME_RESET, False),
        (StateFlag.FORCE_OFFSET, False),
    ],
)
def test_it_holds_on_invalid_states_and_opens_when_nothing_is_known(
    example: Any, bad: StateFlag, opens: bool
) -> None:
    controller = example.AreaController(TARGET)
    force, at = run(controller, 0.6, 0.0)
    assert force > 0
    # Chatter of the flag, and of the arrival of states, never opens the hand.
    for _ in range(12):
        held, at = run(controller, 0.02, at, bad)
        held, at = run(controller, 0.1, at)
        held, at = run(controller, 0.07, at, None)
        assert held == force
    opened, at = run(controller, 1.2, at, bad)
    assert opened == (0.0 if opens else force)
    again, at = run(controller, 0.5, at)
    assert again > opened


def test_an_area_that_is_no_number_is_not_controlled(example: Any) -> None:
    controller = example.AreaController(TARGET)
    force, at = run(controller, 0.6, 0.0)
    assert controller.on_state(at + 0.01, at + 0.01, float("nan"), 40e-6, True, 0) == force


@pytest.mark.parametrize("seen", [False, True], ids=["force alone", "camera"])
def test_a_model_node_that_starts_again_drops_nothing(example: Any, seen: bool) -> None:
    finger, controller = Finger(), example.AreaController(TARGET)
    estimator = ContactEstimator(load_reduced())
    commands, areas = [], []
    for n in range(4000):
        now, stamp = n * 0.002, 10**18 + n * 2_000_000
        if n == 2000:
            estimator = ContactEstimator(load_reduced())
        if seen and n % 50 == 0:
            estimator.add_area(stamp, finger.area, 0.5e-6, 0 if finger.area > 2e-6 else 1)
        controller.watch(now)
        if not 1900 <= n < 2000:  # it is gone
            for e in estimator.add_wrench(stamp, (0.0, 0.0, -finger.force)):
                values = e.area, e.area_force_slope, e.in_contact, e.flags, e.area_stddev
                controller.on_state(now, now, *values)
        commands.append(controller.force)
        finger.step(controller.force)
        areas.append(finger.area)
    held = commands[1900]
    assert held > 0.15
    assert min(commands[1900:]) > 0.8 * held and max(commands[1900:]) < 1.2 * held
    if seen:
        assert controller.reason == ""
        assert np.abs(np.array(areas[-500:]) / TARGET - 1).max() < 0.05
    else:
        # A force that was there from the start may be a tare; it is held until the contact ends.
        assert commands[-1] == commands[2000] and "not valid" in controller.reason


@pytest.mark.parametrize(
    "zero, seen", [(-1.6, False), (-0.5, False), (-1.6, True), (-0.5, True), (None, True)]
)
def test_a_force_driver_that_starts_again_untared_drops_nothing(
    example: Any, zero: float | None, seen: bool
) -> None:
    """zero: N, None for one that cancels the held force; seen: by a camera."""
    target = 45e-6
    finger, controller = Finger(), example.AreaController(target)
    estimator = ContactEstimator(load_reduced())
    commands = []
    for n in range(4500):
        now, stamp = n * 0.002, 10**18 + n * 2_000_000
        if seen and n % 50 == 0:
            estimator.add_area(stamp, finger.area, 0.5e-6, 0 if finger.area > 2e-6 else 1)
        controller.watch(now)
        if not 2000 <= n < 2600:  # it is gone
            if n == 2600 and zero is None:
                zero = -finger.force
            normal = finger.force + (zero or 0.0) * (n >= 2600)
            for e in estimator.add_wrench(stamp, (0.0, 0.0, -normal)):
                values = e.area, e.area_force_slope, e.in_contact, e.flags, e.area_stddev
                controller.on_state(now, now, *values)
        commands.append(controller.force)
        finger.step(controller.force)
    held = commands[2000]
    assert held > 2.0 * controller.approach_force
    assert set(commands[2000:]) == {held} and "not valid" in controller.reason


@pytest.mark.parametrize("slope", [0.0, -1e-6])
def test_it_never_presses_on_beyond_what_the_model_knows(example: Any, slope: float) -> None:
    controller = example.AreaController(TARGET)
    force, at = run(controller, 0.6, 0.0)
    for _ in range(200):
        at += 0.01
        flags = int(StateFlag.FORCE_OUT_OF_RANGE)
        assert controller.on_state(at, at, 20e-6, 40e-6, True, flags) <= force
        # Neither without a way to tell what more force would do.
        assert controller.on_state(at, at, 20e-6, slope, True, 0) <= force


def test_it_is_slower_while_the_model_is_not_this_finger(example: Any) -> None:
    plain, doubted = example.AreaController(TARGET), example.AreaController(TARGET)
    fast, _ = run(plain, 0.4, 0.0)
    slow, _ = run(doubted, 0.4, 0.0, StateFlag.MODEL_MISMATCH)
    assert 0 < slow < 0.6 * fast


@pytest.mark.parametrize("target", [30.0, 0.3, 0.0, -30e-6, math.nan])
def test_a_target_that_no_fingertip_has_is_refused(example: Any, target: float) -> None:
    with pytest.raises(ValueError, match="target_area"):
        example.AreaController(target)


def test_it_slows_down_when_unsure(example: Any) -> None:
    sure, unsure = example.AreaController(TARGET), example.AreaController(TARGET)
    fast, _ = run(sure, 0.6, 0.0, sd=0.05 * TARGET)
    slow, _ = run(unsure, 0.6, 0.0, sd=0.5 * TARGET)
    assert slow == pytest.approx(fast / 5, rel=0.05)


def test_flags_of_force_alone_leave_out_camera_and_moisture() -> None:
    for flag in StateFlag:
        optional = flag.name.startswith(("AREA_", "MOISTURE_"))  # type: ignore[union-attr]
        assert bool(flag & FORCE_ALONE) != optional


@pytest.fixture
def ros(ros_domain: int) -> Iterator[Any]:
    import rclpy

    rclpy.init()
    node = rclpy.create_node("finger_plant")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("name", "kind", "values"),
    [
        ("grasp_controller", "AreaController", {"approach_force": 0.05, "largest_rate": 1.5}),
        ("slip_grip", "SlipGrip", {"margin": 0.5, "largest": 4.0}),
    ],
)
def test_each_setting_of_an_example_is_a_parameter_of_its_node(
    ros: Any, module_of: Callable[[str], Any], name: str, kind: str, values: dict[str, float]
) -> None:
    import rclpy
    from rclpy.parameter import Parameter

    example = getattr(module_of(f"examples/{name}.py"), kind)
    from_parameters = module_of("examples/node_parameters.py").from_parameters
    given = [Parameter(key, value=value) for key, value in values.items()]
    needed = {"target_area": TARGET} if kind == "AreaController" else {}

    def controller(*parameters: Any) -> Any:
        node = rclpy.create_node("user", parameter_overrides=list(parameters))
        try:
            return from_parameters(node, example, **needed)
        finally:
            node.destroy_node()

    found, plain = controller(*given), controller()
    assert {key: getattr(found, key) for key in values} == values
    assert all(getattr(plain, key) != value for key, value in values.items())
    with pytest.raises(SystemExit) as ended:
        controller(*given, Parameter("aproach_force", value=0.05))
    assert ended.value.code == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ["grasp_controller.py", "--ros-args", "-p", "aproach_force:=0.05"],
            "parameter 'aproach_force' does not exist; did you mean 'approach_force'?",
        ),
        (
            ["grasp_controller.py", "--ros-args", "-p", "target_area:=30.0"],
            "target_area is 30 m²",
        ),
        (["slip_grip.py", "--node", "--ros-args", "-p", "margin:=2.0"], "margin is 2"),
        (["slip_grip.py", "--node", "--ros-args", "-p", "margin:=wide"], "margin"),
        (["slip_grip.py", "--node", "--ros-args", "-p", "rise:=-40.0"], "rise is -40"),
        (["slip_grip.py", "--node", "--ros-args", "-p", "rise:=5"], "write 5.0"),
        (["slip_grip.py", "--node", "--ros-args", "-p", "smallest:=12.0"], "above largest"),
        (
            ["grasp_controller.py", "--ros-args", "-p", "largest_force:=.nan"],
            "largest_force is nan",
        ),
        (["grasp_controller.py", "target_area:=30.0e-6"], "unrecognized arguments: target_area"),
        (["grasp_controller.py", "--ros-args", "-p", "target_area"], "target_area"),
        (["slip_grip.py", "--nodes", "--ros-args", "-r", "__ns:=/finger"], "--nodes"),
        (["slip_grip.py", "--ros-args", "-r", "__ns:=/finger"], "give --node"),
        (["turn_wrench.py", "20", "--negative"], "unrecognized arguments: --negative"),
    ],
)
def test_a_parameter_that_an_example_cannot_use_ends_it(
    ros_domain: int,
    process: Callable[..., Any],
    project_root: Path,
    arguments: list[str],
    says: str,
) -> None:
    child = process(project_root / "examples" / arguments[0], *arguments[1:])
    assert child.wait(60.0) == 2
    told = child.output.read_text()
    assert says in told and "Traceback" not in told


def test_the_nodes_together_hold_the_area_and_the_force_without_state(
    ros: Any, process: Callable[..., Any], project_root: Path
) -> None:
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    from finger_msgs.msg import ContactArea, ContactState

    finger = Finger()
    commands: list[float] = []
    answered: list[int] = []
    best = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
    wrench = ros.create_publisher(WrenchStamped, "/finger/wrench", best)
    seen = ros.create_publisher(ContactArea, "/finger/contact_area", best)
    ros.create_subscription(Float64, "/finger/grasp_force", lambda m: commands.append(m.data), 10)
    ros.create_subscription(
        ContactState,
        "/finger/contact_state",
        lambda m: answered.append(header_stamp(m)),
        best,
    )

    def start_model() -> Any:
        return process("-m", "finger_model.model_node", "--ros-args", "-r", "__ns:=/finger")

    model = start_model()
    controller = project_root / "examples" / "grasp_controller.py"
    # The plant waits for each answer, so the result does not depend on the speed of the machine;
    # the controller therefore accepts old states.
    arguments = ("-p", f"target_area:={TARGET!r}", "-p", "stale_after:=20.0")
    process(controller, "--ros-args", "-r", "__ns:=/finger", *arguments)

    def wait(condition: Callable[[], bool], seconds: float) -> bool:
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            rclpy.spin_once(ros, timeout_sec=0.05)
        return condition()

    message, picture = WrenchStamped(), ContactArea()

    def push(stamp: int) -> None:
        fill_time(message.header.stamp, stamp)
        message.wrench.force.z = -finger.force
        wrench.publish(message)

    # Until all three have found one another.
    for _ in range(600):
        push(time.time_ns())
        if wait(lambda: len(answered) > 0 and len(commands) > 0, 0.1):
            break
    frames: list[tuple[int, float]] = []
    areas: list[float] = []
    begin, pressed_at = time.time_ns(), None
    for n in range(2500):
        stamp = begin + n * 2_000_000
        commands.clear()
        push(stamp)
        assert wait(lambda stamp=stamp: stamp in answered[-3:] and len(commands) > 0, 20.0), n
        if n % 50 == 0:
            frames.append((stamp, finger.area))
        if frames and stamp - frames[0][0] > 40_000_000:
            taken, area = frames.pop(0)
            fill_time(picture.header.stamp, taken)
            picture.gross_area, picture.area_stddev = area, 0.02 * area + 0.2e-6
            picture.flags = 0 if area > 2e-6 else 1
            seen.publish(picture)
        finger.step(commands[-1])
        areas.append(finger.area)
        if pressed_at is None and commands[-1] > 0:
            pressed_at = n
    assert pressed_at is not None, "the controller never pressed"
    held = np.array(areas[pressed_at + 500 :])
    assert len(held) > 1000
    assert np.abs(held / TARGET - 1).max() < 0.05
    # No more wrench, so no more contact state: the force stays.
    commands.clear()
    assert wait(lambda: len(commands) > 100, 60.0)
    assert min(commands) > 0 and np.ptp(commands[-50:]) == 0
    # The model node is killed and starts again in the contact, the camera is gone: it stays, too.
    os.killpg(model.pid, signal.SIGKILL)
    model.wait()
    start_model()
    held, since, stamp = commands[-1], len(commands), begin + 10**11
    for _ in range(600):
        push(stamp := stamp + 2_000_000)
        if wait(lambda stamp=stamp: stamp in answered[-3:], 0.1):
            break
    for _ in range(700):
        push(stamp := stamp + 2_000_000)
        assert wait(lambda stamp=stamp: stamp in answered[-3:], 20.0)
    assert set(commands[since:]) == {held}
