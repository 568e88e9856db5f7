"""The example that holds an object which gets heavier: where a fixed grip drops it, ours does not,
and it grips little harder than it must."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import wait_until

from finger_common.flags import SlipFlag
from finger_common.stamps import fill_time

EXAMPLE = "examples/slip_grip.py"


@pytest.fixture(scope="module")
def example(module_of: Callable[[str], Any]) -> Any:
    return module_of(EXAMPLE)


def test_an_object_that_gets_heavier_is_held_whatever_its_friction(example: Any) -> None:
    found = {}
    for seed, friction in enumerate((0.22, 0.3, 0.4, 0.55, 0.75, 1.0)):
        if friction < 0.8:
            assert example.hold(None, friction, seed).dropped
        found[friction] = example.hold(example.SlipGrip(force=2.0), friction, seed)
    assert not any(outcome.dropped for outcome in found.values()), found
    assert max(outcome.slid for outcome in found.values()) < 0.005
    assert np.median([outcome.slid for outcome in found.values()]) < 0.002
    assert np.median([outcome.force_ratio for outcome in found.values()]) < 1.8
    assert all(outcome.force_ratio > 1.0 for outcome in found.values())


@pytest.mark.parametrize("friction", [0.25, 0.5])
def test_an_object_is_held_by_an_estimator_that_knows_of_the_controller(
    example: Any, friction: float
) -> None:
    found = example.hold(example.SlipGrip(force=2.0), friction, grip_follows_load=True)
    assert not found.dropped
    assert found.slid < 0.008
    assert 1.1 < found.force_ratio < 1.6


@pytest.mark.parametrize("friction", [0.25, 0.35, 0.5])
def test_a_gripper_with_a_dead_time_holds(example: Any, friction: float) -> None:
    found = example.hold(example.SlipGrip(force=2.0), friction, delay=0.05)
    assert not found.dropped
    assert found.slid < 0.008
    late = example.SlipGrip(force=2.0, dither=0.0, unsure=1.0)
    found = example.hold(late, friction, delay=0.1)
    assert not found.dropped
    assert found.slid < 0.01
    assert found.force_ratio < 3.5


@pytest.mark.parametrize("zero", [0.3, -0.3])
def test_the_zero_of_the_lateral_force_does_not_take_the_margin(example: Any, zero: float) -> None:
    """0.3 N along the load, as of a hand that has turned since its tare."""
    found = example.hold(example.SlipGrip(force=2.0), 0.7, zero=zero)
    assert not found.dropped
    assert 1.2 < found.force_ratio < 1.6


@pytest.mark.parametrize(
    ("friction", "axes", "value", "length"),
    [
        (0.25, [2], 1.0, 0.002),  # P of -1 N
        (0.5, [2], 1.0, 0.002),
        (0.35, [2], 1.0, 0.03),
        (0.7, [2], 1.0, 0.03),
        (0.25, [2], -5.0, 0.002),
        (0.25, [0], 1.0, 0.002),
        (0.5, [0, 1, 2], 0.0, 0.04),
    ],
)
def test_wrong_samples_that_come_again_every_half_second_drop_nothing(
    example: Any, friction: float, axes: list[int], value: float, length: float
) -> None:
    def sensor(time: float, force: list[float]) -> list[float]:
        wrong = time > 1.2 and (time + 0.3001) % 0.5 < length
        return [value if wrong and axis in axes else f for axis, f in enumerate(force)]

    found = example.hold(example.SlipGrip(force=2.0), friction, sensor=sensor)
    assert not found.dropped
    assert found.slid < 0.01
    assert 1.05 < found.force_ratio < 2.5


@pytest.mark.parametrize("friction", [0.3, 0.5])
@pytest.mark.parametrize(("table", "lift"), [(1.5, 0.1), (3.0, 0.2)])
def test_an_object_that_is_set_down_can_be_lifted_again(
    example: Any, friction: float, table: float, lift: float
) -> None:
    """For so many seconds it stands on a table; lifting it takes tenths of a second."""
    lifted = example.set_down(5.0, table, lift)
    found = example.hold(example.SlipGrip(force=2.0), friction, lifted=lifted)
    assert not found.dropped
    assert found.slid < 0.008
    assert 1.05 < found.force_ratio < 1.9


def test_a_light_object_after_a_heavy_one_is_gripped_lightly(example: Any) -> None:
    """Once the heavy one was let go; a sensor that fails for a moment lets go of nothing."""
    known = {"friction": 0.5, "friction_sd": 0.01, "probability": 0.0, "flags": 0}
    unknown = {**known, "slip_margin": float("nan"), "flags": int(SlipFlag.NO_CONTACT)}
    light = {"normal": 4.0, "slip_margin": 0.95, **known}
    for pause, least, most in ((0.1, 1.8, 2.3), (1.0, 0.3, 0.6)):
        grip = example.SlipGrip(force=4.0)
        at = iter(np.arange(0.0, 20.0, 0.002))
        while next(at) < 1.0:
            heavy = grip.on_slip(next(at), 4.0, 0.2, **known)
        assert heavy > 4.0
        begin = next(at)
        while (now := next(at)) < begin + pause:
            grip.on_slip(now, 0.0, **unknown)
        while (now := next(at)) < begin + pause + 4.0:
            force = grip.on_slip(now, **light)
        assert least <= force < most


@pytest.mark.parametrize(("given", "next_force"), [(float("nan"), 0.3), (1.5, 1.5)])
def test_no_large_force_waits_for_the_next_object(
    example: Any, given: float, next_force: float
) -> None:
    grip, at = held_heavy(example, given)
    heavy = grip.force
    assert heavy > 4.0
    for normal in np.geomspace(4.0, 0.06, 20):
        at += 0.002
        grip.on_slip(at, normal, 0.2, 0.5, 0.01, 0.0, 0)
    held = grip.force
    assert held > 3.9
    assert empty_grip(grip, at, 0.4) == held
    assert empty_grip(grip, at + 0.4, 0.2) == next_force


@pytest.mark.parametrize(
    ("pause", "normal", "flags"),
    [
        (0.0, 0.0, SlipFlag.NO_CONTACT),  # a tare, another axis
        (1.2, 0.0, SlipFlag.NO_CONTACT),  # a driver that began anew, whose zero cancels the force
        (0.0, -1.0, SlipFlag.NO_CONTACT),
        (0.0, float("nan"), SlipFlag.FORCE_INVALID | SlipFlag.NO_CONTACT),
    ],
)
def test_a_force_that_is_gone_at_once_is_another_zero_and_lets_go_of_nothing(
    example: Any, pause: float, normal: float, flags: SlipFlag
) -> None:
    grip, at = held_heavy(example)
    heavy = grip.force
    assert empty_grip(grip, at + pause, 5.0, normal, flags) == heavy


def test_a_contact_in_doubt_lets_go_of_nothing(example: Any) -> None:
    """Its force may be too small by the zero."""
    grip, at = held_heavy(example)
    grip.on_slip(at, 0.06, 0.2, 0.5, 0.01, 0.0, 0, 1.0)
    heavy = grip.force
    assert heavy > 4.0
    assert empty_grip(grip, at, 5.0) == heavy


def test_a_grip_that_starts_without_a_contact_commands_nothing(example: Any) -> None:
    """The object may be held at another zero of the force."""
    assert np.isnan(empty_grip(example.SlipGrip(), 0.0, 5.0))


def held_heavy(example: Any, force: float = float("nan")) -> tuple[Any, float]:
    """A grip that holds an object with more than 4 N, and the time (s)."""
    grip = example.SlipGrip(force=force)
    for i in range(500):
        grip.on_slip(i * 0.002, 4.0, 0.2, 0.5, 0.01, 0.0, 0)
    return grip, 1.0


def empty_grip(
    grip: Any,
    at: float,
    duration: float,
    normal: float = 0.0,
    flags: SlipFlag = SlipFlag.NO_CONTACT,
) -> float:
    """Force after states without contact from `at` on."""
    unknown = float("nan")
    for i in range(round(duration / 0.002)):
        probability = unknown if flags & SlipFlag.FORCE_INVALID else 0.0
        stamp = at + i * 0.002
        force = grip.on_slip(stamp, normal, unknown, 0.5, 0.01, probability, int(flags), unknown)
    return force


@pytest.mark.parametrize(
    ("friction", "seed", "begin"), [(0.5, 0, 4.3), (0.5, 2, 4.3), (0.7, 1, 4.3), (0.25, 0, 3.0)]
)
def test_a_load_that_grows_while_no_sample_comes_is_held(
    example: Any, friction: float, seed: int, begin: float
) -> None:
    """With and without a known friction; the sensor is silent for 1.2 s."""
    grip = example.SlipGrip(force=2.0)
    found = example.hold(grip, friction, seed, silent=(begin, begin + 1.2))
    assert not found.dropped and found.slid < 0.012 and found.force_ratio < 2.0, found


@pytest.mark.parametrize("seed", [0, 1])
def test_what_the_largest_force_just_holds_is_held(example: Any, seed: int) -> None:
    """Where only that force holds it, the grip asks for no slip by less."""
    grip = example.SlipGrip(force=1.5, largest=1.75)
    found = example.hold(grip, 1.0, seed)
    assert grip.short and not found.dropped and found.slid < 0.005, found


@pytest.mark.parametrize("period", [0.12, 0.5])
def test_silences_that_come_again_do_not_let_the_force_grow(example: Any, period: float) -> None:
    """A guessed friction: 1 N is held at a load of 0.3 N."""
    grip = example.SlipGrip(force=1.0)
    state = (1.0, 0.4, 0.5, 0.02, 0.0, int(SlipFlag.FRICTION_ASSUMED))
    forces = []
    for i in range(200):
        grip.on_slip(i * period, *state)
        forces.append(grip.on_silence())
    assert max(forces) < 1.6 * 2.1  # the load over the share that any skin carries is 2 N


def test_a_load_that_swings_slides_little(example: Any) -> None:
    """By 30 %, as in the hand of a robot that walks; the friction is not known at first."""
    slid = []
    for friction in (0.25, 0.35, 0.5):
        for rate in (2.0, 4.0, 8.0):
            lifted = example.swing(rate)
            found = example.hold(example.SlipGrip(force=2.0), friction, lifted=lifted)
            assert not found.dropped, (friction, rate)
            slid.append(found.slid)
    assert np.mean(slid) < 0.004, slid


@pytest.mark.parametrize("rate, slid", [(100.0, 0.003), (50.0, 0.02)])
def test_a_slow_sensor_is_enough(example: Any, rate: float, slid: float) -> None:
    for friction in (0.25, 0.5):
        found = example.hold(example.SlipGrip(force=2.0), friction, rate=rate)
        assert not found.dropped and found.slid < slid, found


@pytest.mark.parametrize("friction", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("zero", [(-1.0, 0.0), (1.0, 0.0), (0.0, 1.6), (0.0, -0.5)])
def test_a_force_driver_that_starts_again_untared_drops_nothing(
    example: Any, friction: float, zero: tuple[float, float]
) -> None:
    """The margin may be anything then, also that of a load that is not there."""

    def sensor(time: float, wrench: list[float]) -> list[float]:
        shifted = [wrench[0] + zero[0], wrench[1], wrench[2] + zero[1]]
        return shifted if time > 5.0 else wrench

    grip = example.SlipGrip(force=2.0)
    found = example.hold(grip, friction, sensor=sensor, silent=(5.0, 6.2))
    assert not found.dropped and found.force_ratio < 2.5, found


@pytest.mark.parametrize("friction", [0.25, 1.0])
def test_a_controller_that_starts_in_such_a_contact_with_its_force_drops_nothing(
    example: Any, friction: float
) -> None:
    class StartsAgain:
        grip = example.SlipGrip(force=2.0)
        again = False

        def on_slip(self, stamp: float, *state: float) -> float:
            if stamp > 5.0 and not self.again:
                self.again, self.grip = True, example.SlipGrip(force=self.grip.force)
            return self.grip.on_slip(stamp, *state)

        def on_silence(self) -> float:
            return self.grip.on_silence()

    def sensor(time: float, wrench: list[float]) -> list[float]:
        return [*wrench[:2], wrench[2] + (1.6 if time > 5.0 else 0.0)]

    found = example.hold(StartsAgain(), friction, sensor=sensor, silent=(5.0, 6.2))
    assert not found.dropped and found.slid < 0.002, found


def test_ctrl_c_ends_the_simulation_quietly(
    process: Callable[..., Any], project_root: Path
) -> None:
    # A shell may have started the tests with SIGINT ignored.
    child = process(
        "-u",
        project_root / "examples" / "slip_grip.py",
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    wait_until(lambda: "friction" in child.output.read_text(), "the first line")
    child.send_signal(signal.SIGINT)
    assert child.wait(60.0) == 130
    assert "Traceback" not in child.output.read_text()


class Peer:
    """Publishes contact_slip to the node of the example and hears its commands."""

    def __init__(self, rclpy: Any) -> None:
        from std_msgs.msg import Float64

        from finger_msgs.msg import ContactSlip

        self.rclpy = rclpy
        self.node = node = rclpy.create_node("peer")
        self.commands: list[float] = []
        node.create_subscription(
            Float64, "/finger/grip_force", lambda m: self.commands.append(m.data), 10
        )
        self.publisher = node.create_publisher(ContactSlip, "/finger/contact_slip", 10)
        self.state = ContactSlip(
            normal_force=2.0, slip_margin=0.2, friction=0.5, friction_stddev=0.01
        )
        self.sent = 0

    def send(self) -> None:
        self.sent += 1
        fill_time(self.state.header.stamp, 10**18 + self.sent * 2_000_000)
        self.publisher.publish(self.state)
        self.receive()

    def receive(self) -> None:
        self.rclpy.spin_once(self.node, timeout_sec=0.01)


@pytest.fixture
def peer(ros_domain: int) -> Iterator[Peer]:
    rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    rclpy.init()
    peer = Peer(rclpy)
    yield peer
    peer.node.destroy_node()
    rclpy.try_shutdown()


class GripNode:
    """The node as a process, and what it has said."""

    def __init__(self, child: Any) -> None:
        self.output: Path = child.output

    def says(self, text: str, spin: Callable[[], None]) -> None:
        """Wait until it has said this; `spin` is called meanwhile."""
        wait_until(lambda: text in self.output.read_text(), text, spin=spin)


@pytest.fixture
def grip_node(process: Callable[..., Any], project_root: Path) -> GripNode:
    arguments = "--node", "--ros-args", "-r", "__ns:=/finger"
    return GripNode(process(project_root / EXAMPLE, *arguments))


def test_the_node_holds_its_force_while_no_state_comes(peer: Peer, grip_node: GripNode) -> None:
    commands = peer.commands
    wait_until(lambda: len(commands) > 10, "an answer", spin=peer.send)
    grip_node.says("holding 3.3", peer.receive)  # N, 1.6 times what the load needs
    held = len(commands)
    wait_until(lambda: len(commands) > held + 20, "the force again and again", spin=peer.receive)
    assert len(set(commands[held:])) == 1 and commands[-1] == pytest.approx(3.3, abs=0.1)
    grip_node.says("contact_slip comes again", peer.send)


def test_the_node_tells_a_slow_contact_slip_once(peer: Peer, grip_node: GripNode) -> None:
    commands = peer.commands
    wait_until(lambda: len(commands) > 10, "an answer", spin=peer.send)
    for _ in range(5):
        peer.send()
        before = len(commands)
        repeated = lambda: len(commands) > before + 5  # noqa: B023, E731
        wait_until(repeated, "the force, repeated", spin=peer.receive)
    said = grip_node.output.read_text()
    assert said.count("holding") == 1 and "comes again" not in said, said
    assert "on /finger/contact_slip (publishers: 1)" in said


def test_the_node_says_that_the_load_needs_more_than_it_may_give(
    peer: Peer, grip_node: GripNode
) -> None:
    peer.state.normal_force = 12.0
    grip_node.says("the load may need 12.5 N, more than 'largest', 10 N", peer.send)
    grip_node.says("the measured force is 1.1", peer.send)
    peer.state.normal_force = 8.0
    grip_node.says("'largest' is enough again", peer.send)


def test_the_node_says_that_the_force_it_begins_with_is_in_doubt(
    peer: Peer, grip_node: GripNode
) -> None:
    peer.state.slip_margin_stddev = 1.0
    grip_node.says(
        "begins with 2.00 N as measured, but the zero of the force is in doubt", peer.send
    )
    peer.state.slip_margin_stddev = 0.1
    grip_node.says("not in doubt any more", peer.send)


@pytest.mark.parametrize("margin", [1.0, -0.1, 20.0, float("nan")])
def test_a_margin_that_no_friction_gives_is_refused(example: Any, margin: float) -> None:
    with pytest.raises(ValueError, match=r"margin is .* from 0 to below 1"):
        example.SlipGrip(margin=margin)


def test_grip_answers_slip_at_once_and_lets_go_slowly(example: Any) -> None:
    grip = example.SlipGrip(force=2.0)
    grip.on_slip(0.0, 2.0, 0.5, 0.5, 0.02, 0.0, 0)  # a margin of 0.5
    for i in range(1, 26):
        slipping = grip.on_slip(i * 0.002, 2.0, 0.0, 0.5, 0.02, 1.0, int(SlipFlag.SLIPPING))
    assert slipping >= 1.6 * 2.0
    before = grip.force
    for i in range(26, 51):
        after = grip.on_slip(i * 0.002, 2.6, 0.85, 0.5, 0.02, 0.0, 0)
    assert before - 0.15 < after < before
    for probability, flags in ((0.0, 8), (float("nan"), 8), (float("nan"), 0)):
        assert grip.on_slip(1.0, float("nan"), 0.2, 0.5, 0.0, probability, flags) == after
    # Without a contact the margin is not known.
    assert grip.on_slip(1.1, 0.0, float("nan"), 0.5, 0.0, 0.0, int(SlipFlag.NO_CONTACT)) == after


def test_an_object_that_is_held_already_is_not_let_go(example: Any) -> None:
    grip = example.SlipGrip()
    assert np.isnan(grip.on_slip(0.0, float("nan"), float("nan"), 0.5, 0.2, 0.0, 8))
    for i in range(1, 200):
        force = grip.on_slip(i * 0.002, 5.0, 0.43, 0.7, 0.02, 0.0, 0)
        assert force > 4.0
