"""The full load of a rig on the recorder: publish it, record it, count what the bag lacks.

Two 500 Hz wrenches, contact_state at 500 Hz, 1280 × 1024 mono8 images with noise and contact_area
and camera_info at 10 Hz, moisture and trial now and then. `python bench/rig_load.py publish …` is
the publishing process.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from finger_bag.definitions import encode
from finger_bag.reader import open_bag
from finger_common.domains import free_domain

WIDTH, HEIGHT = 1280, 1024
TOPICS = {
    "wrench": ("geometry_msgs/msg/WrenchStamped", 500),
    "wrench_raw": ("geometry_msgs/msg/WrenchStamped", 500),
    "contact_state": ("finger_msgs/msg/ContactState", 500),
    "image_raw": ("sensor_msgs/msg/Image", 10),
    "contact_area": ("finger_msgs/msg/ContactArea", 10),
    "camera_info": ("sensor_msgs/msg/CameraInfo", 10),
}


@dataclass
class LoadResult:
    """Messages sent and recorded by topic. cpu: of the recorder, as a fraction of one core."""

    seconds: float
    sent: dict[str, int]
    recorded: dict[str, int]
    reported_lost: int
    cpu: float
    bag_bytes: int
    late: float

    @property
    def lost(self) -> int:
        return sum(self.sent.values()) - sum(self.recorded.values())


def samples() -> dict[str, list[bytearray]]:
    """Serialized messages to send; the stamp is written into them."""
    rng = np.random.default_rng(0)
    frames = [
        np.clip(rng.normal(120, 6, (HEIGHT, WIDTH)), 0, 255).astype(np.uint8) for _ in range(4)
    ]
    header = {"frame_id": "rig"}
    state = {"parameter_set": "00000000@69.31", "normal_force": 1.0, "area": 5e-5}
    hull = [{"x": 1e-3 * i, "y": 2e-3} for i in range(80)]
    fields = {
        "wrench": [{"wrench": {"force": {"z": -1.0}}}],
        "wrench_raw": [{"wrench": {"force": {"z": -1.1}}}],
        "contact_state": [state],
        "image_raw": [
            {"height": HEIGHT, "width": WIDTH, "step": WIDTH, "encoding": "mono8", "data": f}
            for f in frames
        ],
        "contact_area": [{"gross_area": 5e-5, "hull": hull}],
        "camera_info": [{"height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob"}],
    }
    return {
        topic: [bytearray(encode(kind, {"header": header, **f})) for f in fields[topic]]
        for topic, (kind, _) in TOPICS.items()
    }


def publish(seconds: float, result: Path, reliability: str) -> None:
    """Send the load and write how many of each were sent."""
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from finger_bag.recorder_node import message_class
    from finger_common.node import use_large_shared_memory

    use_large_shared_memory()
    rclpy.init(args=[])
    node = rclpy.create_node("rig_load", namespace="/finger")
    policy = ReliabilityPolicy.RELIABLE if reliability == "reliable" else None
    qos = QoSProfile(depth=200, reliability=policy or ReliabilityPolicy.BEST_EFFORT)
    publishers = {
        topic: node.create_publisher(message_class(kind), topic, qos)
        for topic, (kind, _) in TOPICS.items()
    }
    end = time.monotonic() + 30
    while any(p.get_subscription_count() == 0 for p in publishers.values()):
        if time.monotonic() > end:
            raise SystemExit("the recorder did not subscribe")
        time.sleep(0.1)
    time.sleep(1.0)
    messages = samples()
    sent = dict.fromkeys(TOPICS, 0)
    begin = time.monotonic()
    worst = 0.0
    for tick in range(round(seconds * 500)):
        due = begin + tick * 0.002
        left = due - time.monotonic()
        if left > 0:
            time.sleep(left)
        worst = max(worst, time.monotonic() - due)
        stamp = time.time_ns()
        head = (stamp // 10**9).to_bytes(4, "little") + (stamp % 10**9).to_bytes(4, "little")
        for topic, (_, rate) in TOPICS.items():
            if tick % (500 // rate):
                continue
            choices = messages[topic]
            message = choices[sent[topic] % len(choices)]
            message[4:12] = head
            publishers[topic].publish(bytes(message))
            sent[topic] += 1
    for publisher in publishers.values():
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=10))
    time.sleep(1.0)
    result.write_text(json.dumps({"sent": sent, "late": worst}))
    node.destroy_node()
    rclpy.shutdown()


def measure(
    seconds: float,
    folder: Path,
    reliability: str = "best_effort",
    parameters: dict[str, str] | None = None,
    on_wait: Callable[[float], None] | None = None,
) -> LoadResult:
    """Record the load for some seconds into folder/load and compare; the bag is removed."""
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(free_domain()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    counts = folder / "counts.json"
    bag = folder / "load"
    shutil.rmtree(bag, ignore_errors=True)
    arguments = ["--ros-args", "-r", "__ns:=/finger"]
    settings = {
        "folder": str(folder),
        "bag_name": "load",
        "record_at_start": "true",
        "qos_reliability": reliability,
        **(parameters or {}),
    }
    for name, value in settings.items():
        arguments += ["-p", f"{name}:={value}"]
    log = folder / "recorder.log"
    with log.open("w") as output:
        recorder = subprocess.Popen(
            [sys.executable, "-m", "finger_bag.recorder_node", *arguments],
            env=environment,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        publisher = None
        try:
            publisher = subprocess.Popen(
                [sys.executable, __file__, "publish", str(seconds), str(counts), reliability],
                env=environment,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
            begin = time.monotonic()
            cpu = 0.0
            while publisher.poll() is None:
                time.sleep(min(1.0, seconds / 20))
                cpu = process_time(recorder.pid) or cpu
                if on_wait is not None:
                    on_wait(time.monotonic() - begin)
            recorder.send_signal(signal.SIGINT)
            recorder.wait(60)
        finally:
            for child in (publisher, recorder):
                if child is not None and child.poll() is None:
                    child.kill()
                    child.wait()
    if not counts.exists():
        raise RuntimeError(f"the load could not be published: {log.read_text()[-500:]}")
    data = json.loads(counts.read_text())
    text = log.read_text()
    reported = int(text.rpartition(" lost")[0].rpartition(" ")[2]) if " lost" in text else -1
    stamps: dict[str, set[bytes]] = {topic: set() for topic in TOPICS}
    with open_bag(bag) as reader:
        if reader.all_problems():
            raise RuntimeError(f"the bag has problems: {reader.all_problems()}")
        for item in reader.messages():
            name = item.topic.removeprefix("/finger/")
            if name in stamps:
                stamps[name].add(item.raw[4:12])
        size = reader.info.size
    recorded = {topic: len(found) for topic, found in stamps.items()}
    shutil.rmtree(bag)
    return LoadResult(seconds, data["sent"], recorded, reported, cpu / seconds, size, data["late"])


def process_time(pid: int) -> float | None:
    """Processor time (s) a process has used; None where it is unknown."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=["publish"])
    parser.add_argument("seconds", type=float)
    parser.add_argument("result", type=Path)
    parser.add_argument("reliability", choices=["best_effort", "reliable"])
    args = parser.parse_args()
    publish(args.seconds, args.result, args.reliability)


if __name__ == "__main__":
    main()
