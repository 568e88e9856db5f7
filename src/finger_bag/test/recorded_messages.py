# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages for the recorder, and reading them back, for processes that tests start."""

from __future__ import annotations

from pathlib import Path

from session_bags import START, wrench

from finger_bag.definitions import encode
from finger_bag.reader import open_bag
from finger_bag.recorder import Serialized
from finger_common.errors import InputError

WRENCH = "geometry_msgs/msg/WrenchStamped"
IMAGE = "sensor_msgs/msg/Image"


def serialized(number: int, topic: str = "/finger/wrench") -> Serialized:
    """A wrench of a stream at 500 Hz."""
    stamp = START + number * 2_000_000
    cdr = encode(WRENCH, wrench(stamp, 0.001 * number))
    return Serialized(topic, WRENCH, cdr, stamp + 1000, stamp + 500, number)


def read_all(path: Path) -> tuple[int, list[str]]:
    """Messages of a bag that decode, and problems."""
    good = 0
    with open_bag(path) as reader:
        for item in reader.messages():
            try:
                assert item.message is not None
                good += 1
            except InputError:
                pass
        return good, reader.all_problems()
