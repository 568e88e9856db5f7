"""Turn the wrench of a sensor whose normal lies along none of its axes: an example of a node before
the model node.

    python examples/turn_wrench.py 20 --ros-args -r __ns:=/finger

The plate's normal leans by 20° from the sensor's z towards its y. The node answers each `wrench`
with `wrench_turned`, whose z is along the normal and whose stamp is that of the measurement; give
the nodes model, protocol and page the parameter `wrench_topic: wrench_turned`, and record it
(docs/rig_setup.md). A sensor behind the finger measures the force on the finger, not that on the
plate: `--negate` turns it round.
"""

from __future__ import annotations

import argparse
import math

from node_parameters import parse_arguments


def turned(
    vector: tuple[float, float, float], angle: float, negate: bool = False
) -> tuple[float, float, float]:
    """A vector (3,) in axes turned by an angle (rad) about x: z goes towards the former y.

    negate: of the reaction to it.
    """
    x, y, z = (-v for v in vector) if negate else vector
    c, s = math.cos(angle), math.sin(angle)
    return x, c * y - s * z, s * y + c * z


def main() -> None:
    """Run the node until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "angle", type=float, help="of the plate's normal from z towards y (degrees)"
    )
    parser.add_argument(
        "--negate", action="store_true", help="negate force and torque: a sensor behind the finger"
    )
    values = parse_arguments(parser)
    if not math.isfinite(values.angle):
        parser.error(f"angle is {values.angle}, a number of degrees is needed")

    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    node = rclpy.create_node("turn_wrench")
    publisher = node.create_publisher(WrenchStamped, "wrench_turned", 200)
    angle = math.radians(values.angle)

    def on_wrench(message: WrenchStamped) -> None:
        for vector in (message.wrench.force, message.wrench.torque):
            vector.x, vector.y, vector.z = turned(
                (vector.x, vector.y, vector.z), angle, values.negate
            )
        message.header.frame_id = "plate_axes"
        publisher.publish(message)

    node.create_subscription(WrenchStamped, "wrench", on_wrench, 200)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
