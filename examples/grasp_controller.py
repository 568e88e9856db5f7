"""Hold a finger's contact area on a plate by regulating the normal force: an example of using `contact_state`.

    python examples/grasp_controller.py --ros-args -r __ns:=/finger -p target_area:=30.0e-6

Subscribes `contact_state`, publishes the force to press with on `grasp_force` (std_msgs/Float64, N) at 100 Hz. The
controller itself, `AreaController`, knows no ROS. It opens (0 N) when the state is stale, invalid or has been reset,
and stays open until the state has been good for a while.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

OPENING_FLAGS = 1 | 4096 | 8192
"""FLAG_FORCE_INVALID, FLAG_MODEL_FAILED, FLAG_TIME_RESET of ContactState: open at once."""


@dataclass
class AreaController:
    """Integral control of the normal force, scaled by the model's slope dA/dF.

    target_area: m²; gain: 1/s, of the error in area; approach_rate: N/s before contact; largest_force: N;
    largest_rate: N/s; stale_after: s without a state until it opens; settle: s of good states before it presses again.
    """

    target_area: float
    gain: float = 8.0
    approach_rate: float = 1.0
    largest_force: float = 2.5
    largest_rate: float = 3.0
    stale_after: float = 0.05
    settle: float = 0.2
    force: float = 0.0
    reason: str = "no contact state yet"
    _last: float = -math.inf
    _good_since: float = math.inf
    _area: float = 0.0
    _slope: float = 0.0
    _contact: bool = False

    def on_state(self, now: float, area: float, slope: float, in_contact: bool, flags: int) -> None:
        """Take a contact state received at `now` (s)."""
        good = not flags & OPENING_FLAGS and math.isfinite(area) and math.isfinite(slope)
        if not good:
            self._open(f"contact state not valid (flags {flags})")
            return
        if not math.isfinite(self._good_since) or now - self._last > self.stale_after:
            self._good_since = now
        self._last = now
        self._area, self._slope, self._contact = area, slope, in_contact

    def command(self, now: float, dt: float) -> float:
        """Force to press with (N); called every `dt` (s)."""
        if now - self._last > self.stale_after:
            self._open("contact state is stale")
        if now - self._good_since < self.settle or not math.isfinite(self._good_since):
            self.force = 0.0
            return 0.0
        self.reason = ""
        if not self._contact or self._slope <= 0:
            rate = self.approach_rate
        else:
            rate = self.gain * (self.target_area - self._area) / self._slope
        rate = min(max(rate, -self.largest_rate), self.largest_rate)
        self.force = min(max(self.force + rate * dt, 0.0), self.largest_force)
        return self.force

    def _open(self, reason: str) -> None:
        self.force = 0.0
        self.reason = reason
        self._good_since = math.inf


def main() -> None:
    """Run the node."""
    import rclpy
    from finger_msgs.msg import ContactState
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    rclpy.init()
    node = rclpy.create_node("grasp_controller")
    target = node.declare_parameter("target_area", 30.0e-6).value
    controller = AreaController(target)
    publisher = node.create_publisher(Float64, "grasp_force", 1)
    steady = rclpy.clock.Clock(clock_type=rclpy.clock.ClockType.STEADY_TIME)
    said = controller.reason

    def now() -> float:
        return steady.now().nanoseconds * 1e-9

    def on_state(state: ContactState) -> None:
        controller.on_state(
            now(), state.area, state.area_force_slope, state.in_contact, state.flags
        )

    def tick() -> None:
        nonlocal said
        publisher.publish(Float64(data=controller.command(now(), 0.01)))
        if controller.reason != said:
            said = controller.reason
            node.get_logger().info(f"open: {said}" if said else "pressing")

    # Only the newest state matters to a controller.
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(ContactState, "contact_state", on_state, qos)
    node.create_timer(0.01, tick, clock=steady)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
