"""Reading a bag of 12 h: speed on one core, memory, and the time until `info` answers.

Messages of the rig's full rate (wrench, wrench_raw and contact_state at 500 Hz, images, areas and
camera_info at 10 Hz, diagnostics at 1 Hz) with the sizes of real ones, but for the images, which
are of 4 kB; numbers are noise, so that a chunk compresses as little as a real one. Every message is
read and counted. `--quick` reads one hour.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.definitions import definition_text
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter

START = 1_700_000_000_000_000_000
STEP = 2_000_000
SIZES = {
    "wrench": 92,
    "wrench_raw": 92,
    "contact_state": 264,
    "image_raw/compressed": 4096,
    "contact_area": 1024,
    "camera_info": 400,
    "/diagnostics": 2000,
}
EVERY = {"image_raw/compressed": 50, "contact_area": 50, "camera_info": 50, "/diagnostics": 500}
"""Steps of 2 ms from one message to the next; others come at each step."""


def make_bag(path: Path, hours: float) -> Counter[str]:
    """Write the bag; gives the messages by topic."""
    rng = np.random.default_rng(0)
    noise = {topic: rng.bytes(size * 64) for topic, size in SIZES.items()}
    with BagWriter(path) as bag:
        names = {topic: bag.add_topic(topic) for topic in SIZES}
        for i in range(round(hours * 3600 / (STEP * 1e-9))):
            for topic, size in SIZES.items():
                if i % EVERY.get(topic, 1) == 0:
                    begin = (i % 64) * size
                    data = b"\x00\x01\x00\x00" + noise[topic][begin : begin + size - 8]
                    stamp = START + i * STEP
                    # The last bytes differ from message to message, as measured numbers do.
                    bag.write_raw(
                        names[topic], data + (i * 2654435761).to_bytes(8, "little"), stamp
                    )
        return Counter(bag.counts)


def memory() -> float:
    """Most memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(report: Any) -> None:
    definition_text("finger_msgs/msg/ContactState")
    hours = 1.0 if report.quick else 12.0
    folder = Path(tempfile.mkdtemp(prefix="bench_long_bag"))
    try:
        written = make_bag(folder / "bag", hours)
        began = time.process_time()
        with open_bag(folder / "bag") as reader:
            report.add("long_bag_info", time.process_time() - began, "s", 2.0)
            assert reader.info.message_count == written.total(), reader.info.message_count
            size = reader.info.size
            before = memory()
            began = time.process_time()
            found: Counter[str] = Counter()
            content = 0
            for message in reader.messages():
                found[message.topic] += 1
                content += len(message.raw)
            took = time.process_time() - began
            assert not reader.all_problems(), reader.all_problems()
        assert found == written, found
        report.note(
            f"{hours:g} h, {size / 1e9:.2f} GB in the file, {content / 1e9:.2f} GB of messages: "
            f"{found.total()} messages written and read, {took:.0f} s of one core"
        )
        report.add("long_bag_read", size / took / 1e6, "MB/s", 20.0, "higher")
        report.add("long_bag_memory", memory() - before, "MB", 100.0)
    finally:
        shutil.rmtree(folder)
