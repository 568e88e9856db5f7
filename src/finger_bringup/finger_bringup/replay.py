# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which nodes a bag can be replayed through, and which of its topics they need. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from finger_bag.reader import open_bag
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_common.errors import InputError

PUBLISHED_AGAIN = ("contact_state", "contact_slip", "contact_shape", "model_events", "diagnostics")
"""Topics that the nodes publish again, and old diagnostics: left out of a replay."""


@dataclass(frozen=True)
class Replay:
    """nodes: names, in order. topics: to be played. image_transport: how the images come that are
    measured again. calibration: of the plate, as it is attached to their bag."""

    nodes: tuple[str, ...]
    topics: tuple[str, ...]
    image_transport: str = "raw"
    calibration: bytes | None = None


def replay_of(bag: Path, vision: bool | None = None) -> Replay:
    """How to replay a bag.

    vision: whether to measure areas in its images again; None where it holds raw ones. Raises
    InputError for a bag that cannot be read, and for one whose images are to be measured and that
    holds none.
    """
    with open_bag(bag) as reader:
        used = [name for name, topic in reader.info.topics.items() if topic.count != 0]
        raw, compressed = (
            any(name.endswith(end) for name in used)
            for end in ("/image_raw", "/image_raw/compressed")
        )
        if vision and not (raw or compressed):
            raise InputError(
                f"{bag}: holds no images; leave 'vision' out to replay the recorded areas"
            )
        measured = raw if vision is None else vision
        without = {*PUBLISHED_AGAIN, *(["contact_area"] if measured else [])}
        return Replay(
            ("vision", "model") if measured else ("model",),
            tuple(t for t in reader.info.topics if t.rsplit("/", 1)[-1] not in without),
            "raw" if raw or not measured else "compressed",
            reader.attachment(CALIBRATION_ATTACHMENT) if measured else None,
        )
