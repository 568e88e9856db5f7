"""What it costs to publish wrenches reliably, beside best effort, at 500 Hz.

A publisher in this process; in processes of their own a best-effort reader, as the model node is
one, and a reader with rclpy's default QoS, which runs, or is stopped as a debugger stops it. For
each case the time of one `publish` and the delay from there to the best-effort reader.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from finger_common.domains import free_domain
from finger_common.node.qos import BEST_EFFORT, RELIABLE, stream_qos
from finger_common.stamps import fill_time, header_stamp

RATE = 500.0
CASES = (
    ("best effort", BEST_EFFORT, ""),
    ("reliable", RELIABLE, ""),
    ("reliable, default reader", RELIABLE, "runs"),
    ("reliable, stopped reader", RELIABLE, "stopped"),
)


def read(reliability: str, output: Path) -> None:
    """Process that reads until SIGINT and writes what came, and how late (ns)."""
    rclpy.init()
    node = rclpy.create_node(f"reader_{reliability}")
    delays: list[int] = []
    node.create_subscription(
        WrenchStamped,
        "wrench",
        lambda message: delays.append(time.time_ns() - header_stamp(message)),
        stream_qos(reliability, 200, publisher=False),
    )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        # With a time limit: a signal between Python's check and the wait wakes no wait.
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.2)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    output.write_text(json.dumps(delays))
    os._exit(0)


def measure(case: str, reliability: str, bystander: str, seconds: float, report: Any) -> None:
    """One case."""
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    children = []
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "delays.json"
        for kind in [BEST_EFFORT, *([RELIABLE] if bystander else [])]:
            file = output if kind == BEST_EFFORT else Path(folder) / "other.json"
            children.append(subprocess.Popen([sys.executable, __file__, kind, str(file)]))
        context = rclpy.Context()
        rclpy.init(context=context)
        node = rclpy.create_node("publisher", context=context)
        publisher = node.create_publisher(
            WrenchStamped, "wrench", stream_qos(reliability, 200, publisher=True)
        )
        try:
            end = time.monotonic() + 60
            while publisher.get_subscription_count() < len(children):
                if time.monotonic() > end:
                    raise RuntimeError("the readers did not connect")
                time.sleep(0.05)
            if bystander == "stopped":
                os.kill(children[1].pid, signal.SIGSTOP)
            costs = []
            message = WrenchStamped()
            due = time.monotonic()
            for _ in range(int(seconds * RATE)):
                due += 1 / RATE
                time.sleep(max(due - time.monotonic(), 0.0))
                fill_time(message.header.stamp, time.time_ns())
                start = time.perf_counter_ns()
                publisher.publish(message)
                costs.append(time.perf_counter_ns() - start)
            time.sleep(0.5)
            for child in children:
                os.kill(child.pid, signal.SIGCONT)
                child.send_signal(signal.SIGINT)
                child.wait(30)
            delays = json.loads(output.read_text())
        finally:
            for child in children:
                if child.poll() is None:
                    child.kill()
                    child.wait()
            node.destroy_node()
            rclpy.shutdown(context=context)
    name = "qos_" + case.replace(",", "").replace(" ", "_")
    report.add(f"{name}_publish_p99", float(np.percentile(costs, 99)) * 1e-3, "µs")
    report.add(f"{name}_delay_p99", float(np.percentile(delays, 99)) * 1e-6, "ms")
    report.add(f"{name}_lost", len(costs) - len(delays), "count", goal=0)
    report.note(
        f"{case}: publish {np.percentile(costs, 50) * 1e-3:.1f} µs, delay "
        f"{np.percentile(delays, 50) * 1e-6:.3f} ms (medians)"
    )


def run(report: Any) -> None:
    """Called by bench/run.py."""
    for case, reliability, bystander in CASES:
        measure(case, reliability, bystander, 4.0 if report.quick else 20.0, report)


if __name__ == "__main__":
    read(sys.argv[1], Path(sys.argv[2]))
