"""Hold a finger's contact area on a plate by the normal force: an example of using `contact_state`.

    python examples/grasp_controller.py --ros-args -r __ns:=/finger -p target_area:=30.0e-6

The node subscribes to `contact_state` and answers every state with the force to press with, on
`grasp_force` (std_msgs/Float64, N). The controller itself, `AreaController`, uses no ROS. It moves
slower the less certain the area is. When states are stale or not valid it holds its force, and goes
on only after they have been good for a while. Only when states come that know nothing of the
contact, for a second on end, it opens (0 N). Without contact it presses with `approach_force` at
most, so that no larger force waits for the touch; a contact has ended only when no state of
`lost_after` has one, so that a wrong sample of the force drops nothing. `slip_grip.py` beside it
holds a margin against slip.

Each setting of `AreaController` is a parameter of the node.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field

from node_parameters import check_numbers, from_parameters, parse_arguments

from finger_common.flags import StateFlag

BLIND_FLAGS = StateFlag.FORCE_INVALID | StateFlag.MODEL_FAILED
"""Flags of ContactState at which nothing is known of the contact."""

INVALID_FLAGS = BLIND_FLAGS | StateFlag.TIME_RESET | StateFlag.FORCE_OFFSET
"""Flags at which the area is not to be controlled. A model node that starts again while an object
is held, without a camera, cannot tell that force from a tare (FORCE_OFFSET): no reason to open.
"""

STALE = "contact state is stale"

DOUBT = 0.3
"""Of the full speed, while the model is not yet that of this finger (MODEL_MISMATCH)."""


@dataclass
class AreaController:
    """Integral control of the normal force, scaled by the model's slope dA/dF.

    target_area: m²; gain: 1/s, of the error in area; approach_rate: N/s before contact, up to
    approach_force: N, to which the force falls when a contact has ended; lost_after: s of states
    without contact until it has, for which the force is held; largest_force: N; largest_rate: N/s;
    largest_step: s, a longer time between two states counts as this;
    stale_after: s without a state until it holds; settle: s of good states before it goes on;
    open_after: s of states that know nothing until it opens; sure: relative deviation of the area
    up to which it moves at full speed. `force` is the force to press with (N), `reason` why it does
    not control. Raises ValueError for an area that no fingertip has, and other settings that cannot
    be.
    """

    target_area: float
    gain: float = 8.0
    approach_rate: float = 1.0
    approach_force: float = 0.2
    lost_after: float = 0.04
    largest_force: float = 2.5
    largest_rate: float = 3.0
    largest_step: float = 0.02
    stale_after: float = 0.05
    settle: float = 0.2
    open_after: float = 1.0
    sure: float = 0.1
    force: float = field(default=0.0, init=False)
    reason: str = field(default="no contact state yet", init=False)
    _received: float = field(default=-math.inf, init=False)
    _stamp: float = field(default=-math.inf, init=False)
    _good_since: float = field(default=math.inf, init=False)
    _air_since: float = field(default=math.inf, init=False)
    _bad_since: float = field(default=math.inf, init=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        if not 1e-7 <= self.target_area <= 1e-3:
            raise ValueError(
                f"target_area is {self.target_area:g} m², not that of a fingertip; 30 mm² are "
                "30.0e-6"
            )

    def on_state(
        self,
        received: float,
        stamp: float,
        area: float,
        slope: float,
        in_contact: bool,
        flags: int,
        area_stddev: float = 0.0,
    ) -> float:
        """Force to press with (N) after a contact state.

        stamp: of its header (s), from which follows how long the force has acted; received: when it
        came (s), from which follows when it is stale. The two clocks need not be the same. area,
        area_stddev: m²; slope: m²/N.
        """
        self.watch(received)
        slow = received - self._received > self.stale_after
        self._received = received
        elapsed = min(max(stamp - self._stamp, 0.0), self.largest_step)
        self._stamp = stamp
        known = math.isfinite(area) and math.isfinite(slope) and math.isfinite(area_stddev)
        blind = bool(flags & BLIND_FLAGS) or not known
        self._bad_since = min(self._bad_since, received) if blind else math.inf
        if flags & INVALID_FLAGS or blind:
            if received - self._bad_since > self.open_after:
                self.force = 0.0
            self._air_since = math.inf
            # States that come slowly are stale before each: told once, not before and after each.
            return self._hold(STALE if slow else f"contact state not valid (flags {flags})")
        in_air = not in_contact or area == 0
        self._air_since = min(self._air_since, stamp) if in_air else math.inf
        lost = stamp - self._air_since >= self.lost_after
        if lost:
            self.force = min(self.force, self.approach_force)
        self._good_since = min(self._good_since, stamp)
        if stamp - self._good_since < self.settle or (in_air and not lost):
            return self.force
        self.reason = ""
        limit = self.largest_force
        if in_air:
            rate, limit = self.approach_rate, min(limit, self.approach_force)
        elif slope <= 0:
            rate = 0.0
        else:
            # Slower by as much as the deviation is larger than what counts as sure.
            caution = min(1.0, self.sure * self.target_area / max(area_stddev, 1e-12))
            if flags & StateFlag.MODEL_MISMATCH:
                caution = min(caution, DOUBT)
            rate = caution * self.gain * (self.target_area - area) / slope
        if flags & StateFlag.FORCE_OUT_OF_RANGE:
            # More force would change what the model does not know; less is always safe.
            rate = min(rate, 0.0)
        rate = min(max(rate, -self.largest_rate), self.largest_rate)
        self.force = min(max(self.force + rate * elapsed, 0.0), limit)
        return self.force

    def watch(self, now: float) -> float:
        """Force to press with (N) at `now` (s, on the clock of `received`); holds when stale."""
        if now - self._received > self.stale_after:
            self._hold(STALE)
        return self.force

    def _hold(self, reason: str) -> float:
        self.reason = reason
        self._good_since = math.inf
        return self.force


def main() -> None:
    """Run the node."""
    parse_arguments(argparse.ArgumentParser(description=__doc__.split("\n\n")[0]))

    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    from finger_common.stamps import header_stamp, seconds
    from finger_msgs.msg import ContactState

    rclpy.init()
    node = rclpy.create_node("grasp_controller")
    controller = from_parameters(node, AreaController, target_area=30.0e-6)
    publisher = node.create_publisher(Float64, "grasp_force", 1)
    # A steady clock: what is stale must not depend on a clock that may stop or be set.
    steady = rclpy.clock.Clock(clock_type=rclpy.clock.ClockType.STEADY_TIME)
    logged = controller.reason

    def now() -> float:
        return steady.now().nanoseconds * 1e-9

    def command(force: float) -> None:
        nonlocal logged
        publisher.publish(Float64(data=force))
        if controller.reason != logged:
            logged = controller.reason
            where = f"{subscription.topic_name}, publishers: {subscription.get_publisher_count()}"
            node.get_logger().info(
                f"holding {force:.2f} N: {logged} ({where})" if logged else "pressing"
            )

    def on_state(state: ContactState) -> None:
        stamp = seconds(header_stamp(state))
        area, slope, sd = state.area, state.area_force_slope, state.area_stddev
        command(controller.on_state(now(), stamp, area, slope, state.in_contact, state.flags, sd))

    # Only the newest state matters to a controller.
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    subscription = node.create_subscription(ContactState, "contact_state", on_state, qos)
    node.create_timer(0.01, lambda: command(controller.watch(now())), clock=steady)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
