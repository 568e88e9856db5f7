"""Latency and losses of `contact_state`: load, model node and a counting process, over DDS.

The load publishes `wrench` with the publish time as stamp, and `contact_area` at 10 Hz. For one
finger another process publishes images of 1280 × 1024 at 10 Hz, which the vision node processes.
The model node's own figure counts from the middleware's receive time of the wrench to the return of
publish, waiting in its queue included; it is read from /diagnostics. The end-to-end figure is from
the load's publish to the receipt by the counting process.

`python bench/bench_contact_state.py --rate 500 --fingers 1 --duration 60` runs one case.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.stamps import fill_time, header_stamp

FULL_DURATION = 60.0
SHORT_DURATION = 10.0
CASES = ((1000, 1), (2000, 1), (500, 2), (500, 5))
"""Further (rate, fingers), for SHORT_DURATION each."""


def press(seconds: np.ndarray) -> np.ndarray:
    """Normal force (N): presses of 2 s to 1.35 N, again and again."""
    phase = np.mod(seconds, 2.5)
    return 1.35 * np.clip(np.minimum(phase / 1.0, (2.2 - phase) / 0.5), 0.0, 1.0)


def send(rate: float, fingers: int, duration: float, result: Path) -> None:
    """Publish paced wrenches and areas; writes the number sent and how well the pace was kept."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from finger_msgs.msg import ContactArea, Moisture

    rclpy.init()
    node = rclpy.create_node("load")
    qos = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
    names = [f"/finger{i}" for i in range(fingers)]
    wrench = [node.create_publisher(WrenchStamped, f"{n}/wrench", qos) for n in names]
    area = [node.create_publisher(ContactArea, f"{n}/contact_area", qos) for n in names]
    moisture = [node.create_publisher(Moisture, f"{n}/moisture", qos) for n in names]
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        if all(p.get_subscription_count() > 0 for p in wrench):
            break
        time.sleep(0.05)
    time.sleep(1.5)
    message = WrenchStamped()
    measured, reading = ContactArea(), Moisture()
    reading.value = 69.0
    number = round(duration * rate)
    force = press(np.arange(number) / rate)
    sent = np.zeros(number, np.int64)
    every = max(1, round(rate / 10))
    late = 0.0
    begin = time.monotonic() + 0.1
    for i in range(number):
        due = begin + i / rate
        wait = due - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        late = max(late, time.monotonic() - due)
        message.wrench.force.z = -float(force[i])
        for publisher in wrench:
            now = time.time_ns()
            fill_time(message.header.stamp, now)
            publisher.publish(message)
            sent[i] = now
        if i % every == every // 2:
            # The image of 60 ms ago has gone through camera and vision.
            fill_time(measured.header.stamp, sent[i] - 60_000_000)
            measured.gross_area = float(50e-6 * force[i] ** 0.7)
            measured.area_stddev = 1.5e-6
            measured.flags = 0 if force[i] > 0.05 else 1
            for publisher in area:
                publisher.publish(measured)
        if i == every:
            reading.header.stamp = message.header.stamp
            for publisher in moisture:
                publisher.publish(reading)
    time.sleep(1.0)
    result.write_text(json.dumps({"sent": number * fingers, "latest": late}))
    node.destroy_node()
    rclpy.try_shutdown()


def photograph(topic: str = "/finger0/image_raw") -> None:
    """Publish images of 1280 × 1024 at 10 Hz until SIGTERM, as the camera node does."""
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import Image

    rclpy.init()
    node = rclpy.create_node("camera_load")
    qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = node.create_publisher(Image, topic, qos)
    picture = Image()
    picture.height, picture.width, picture.encoding, picture.step = 1024, 1280, "mono8", 1280
    y, x = np.mgrid[0:1024, 0:1280]
    print_like = (np.hypot(x - 640, y - 512) < 250) & (np.sin(0.6 * np.hypot(x - 500, y)) > 0)
    picture.data = np.where(print_like, 160, 30).astype(np.uint8).tobytes()
    while True:
        fill_time(picture.header.stamp, time.time_ns())
        publisher.publish(picture)
        time.sleep(0.1)


def count(fingers: int, result: Path) -> None:
    """Count contact_state messages until SIGTERM; writes number, delays and nodes' figures."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from finger_msgs.msg import ContactState

    rclpy.init()
    node = rclpy.create_node("counter")
    qos = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)
    stamps: list[list[int]] = [[] for _ in range(fingers)]
    delays: list[int] = []
    figures: dict[str, dict[str, str]] = {}
    subscriptions = []

    def take(which: int, message: Any, info: Any) -> None:
        stamp = header_stamp(message)
        stamps[which].append(stamp)
        delays.append(info["received_timestamp"] - stamp)

    def listen(which: int) -> Any:
        def callback(message: Any, info: Any) -> None:
            take(which, message, info)
            handle = subscriptions[which].handle
            while True:
                with handle:
                    taken = handle.take_message(ContactState, False)
                if taken is None:
                    return
                take(which, *taken)

        return callback

    for i in range(fingers):
        topic = f"/finger{i}/contact_state"
        subscriptions.append(node.create_subscription(ContactState, topic, listen(i), qos))

    def diagnose(message: Any) -> None:
        for status in message.status:
            if "contact state" in status.name:
                figures[status.name] = {v.key: v.value for v in status.values}

    node.create_subscription(DiagnosticArray, "/diagnostics", diagnose, 50)
    stop = False

    def end(*_: Any) -> None:
        nonlocal stop
        stop = True

    signal.signal(signal.SIGTERM, end)
    while not stop:
        rclpy.spin_once(node, timeout_sec=0.2)
    result.write_text(
        json.dumps(
            {
                "received": sum(len(set(s)) for s in stamps),
                "doubled": sum(len(s) - len(set(s)) for s in stamps),
                "p50": float(np.percentile(delays, 50)) * 1e-6 if delays else None,
                "p99": float(np.percentile(delays, 99)) * 1e-6 if delays else None,
                "max": float(np.max(delays)) * 1e-6 if delays else None,
                "nodes": figures,
            }
        )
    )
    os._exit(0)


def case(rate: float, fingers: int, duration: float) -> dict[str, Any]:
    """Run one case in its own processes and domain; returns what the processes found."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(random.SystemRandom().randint(1, 100)),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "OMP_NUM_THREADS": "1",
        }
        counted, sent = Path(folder, "counted.json"), Path(folder, "sent.json")
        children: list[subprocess.Popen[bytes]] = []

        def start(*arguments: Any) -> subprocess.Popen[bytes]:
            child = subprocess.Popen(
                [sys.executable, *map(str, arguments)],
                env=environment,
                start_new_session=True,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            children.append(child)
            return child

        try:
            for i in range(fingers):
                name = f"__ns:=/finger{i}"
                start("-m", "finger_model.model_node", "--ros-args", "-r", name)
            vision = fingers == 1
            if vision:
                start(
                    *("-m", "finger_vision.vision_node", "--ros-args", "-r", "__ns:=/finger0"),
                    *("-r", "contact_area:=contact_area_seen", "-p", "area_per_pixel:=9.86e-10"),
                )
            counter = start(__file__, "--role", "count", "--fingers", fingers, "--result", counted)
            time.sleep(3.0)
            arguments = ["--rate", rate, "--fingers", fingers, "--duration", duration]
            if vision:
                start(__file__, "--role", "photograph")
            sender = start(__file__, "--role", "send", *arguments, "--result", sent)
            sender.wait(duration + 60)
            time.sleep(1.2)
            counter.terminate()
            counter.wait(20)
            result = {**json.loads(sent.read_text()), **json.loads(counted.read_text())}
            result["vision"] = vision
            return result
        finally:
            for child in children:
                if child.poll() is None:
                    os.killpg(child.pid, signal.SIGKILL)
                child.wait()


def in_words(rate: float, fingers: int, result: dict[str, Any]) -> tuple[float, int, str]:
    """Worst node's p99 (ms), messages lost, and a line for the table."""
    nodes = result["nodes"].values()
    p50 = max(float(n.get("latency_p50_ms", "nan")) for n in nodes) if nodes else float("nan")
    p99 = max(float(n.get("latency_p99_ms", "nan")) for n in nodes) if nodes else float("nan")
    lost = result["sent"] - result["received"]
    return (
        p99,
        lost,
        f"{rate:5.0f} Hz × {fingers}: node p50 {p50:.2f} p99 {p99:.2f} ms, end to end p50 "
        f"{result['p50']:.2f} p99 {result['p99']:.2f} max {result['max']:.1f} ms, lost {lost} of "
        f"{result['sent']}, generator at most {1e3 * result['latest']:.1f} ms behind"
        + (", vision node running" if result["vision"] else ""),
    )


def run(report: Any) -> None:
    """Benchmark entry point."""
    duration = SHORT_DURATION if report.quick else FULL_DURATION
    result = case(500, 1, duration)
    p99, lost, line = in_words(500, 1, result)
    report.add("contact_state_latency_p99", p99, "ms", 1.5)
    report.add("contact_state_lost", lost, "count", 0)
    report.add("contact_state_end_to_end_p50", result["p50"], "ms")
    report.add("contact_state_end_to_end_p99", result["p99"], "ms")
    report.note(line)
    for rate, fingers in CASES:
        result = case(rate, fingers, 5.0 if report.quick else SHORT_DURATION)
        p99, lost, line = in_words(rate, fingers, result)
        tag = f"{rate}hz_{fingers}_finger" + ("s" if fingers > 1 else "")
        report.add(f"contact_state_latency_p99_{tag}", p99, "ms")
        report.add(f"contact_state_lost_{tag}", lost, "count")
        report.note(line)


def main() -> None:
    """Run one role, or one case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--role", choices=("send", "count", "photograph"))
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--fingers", type=int, default=1)
    parser.add_argument("--duration", type=float, default=SHORT_DURATION)
    parser.add_argument("--result", type=Path)
    args = parser.parse_args()
    if args.role == "send":
        send(args.rate, args.fingers, args.duration, args.result)
        os._exit(0)
    elif args.role == "photograph":
        photograph()
    elif args.role == "count":
        count(args.fingers, args.result)
    else:
        print(in_words(args.rate, args.fingers, case(args.rate, args.fingers, args.duration))[2])


if __name__ == "__main__":
    main()
