# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which nodes a bag can be replayed through, and which of its topics they need. No ROS."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from finger_bag.reader import open_bag
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_bag.streams import IMAGES
from finger_common.errors import InputError, listed
from finger_common.namespaces import DEFAULT_NAMESPACE

PUBLISHED_AGAIN = ("contact_state", "contact_slip", "contact_shape", "model_events", "diagnostics")
"""Topics that the nodes publish again, and old diagnostics: left out of a replay."""


@dataclass(frozen=True)
class Replay:
    """nodes: names, in order. topics: to be played. heard: those that the nodes must listen to from
    the first message on. namespace: of the nodes, "/" for none. image_transport: how the images
    come that are measured again. calibration: of the plate, as it is attached to their bag."""

    nodes: tuple[str, ...]
    topics: tuple[str, ...]
    heard: tuple[str, ...]
    namespace: str = DEFAULT_NAMESPACE
    image_transport: str = "raw"
    calibration: bytes | None = None


def replay_of(
    bag: Path, vision: bool | None = None, namespace: str = "", wrench: str = "wrench"
) -> Replay:
    """How to replay a bag.

    vision: whether to measure areas in its images again; None where it holds raw ones. namespace:
    of the finger, empty for the only one of the bag, "/" for none. wrench: topic that the model
    node reads.

    Raises InputError for a bag that cannot be read or of which no node would hear anything, for one
    of several fingers of which none is named, and for one whose images are to be measured and that
    holds none.
    """
    with open_bag(bag) as reader:
        used = [name for name, topic in reader.info.topics.items() if topic.count != 0]
        place = f"/{namespace}" if namespace else _only_namespace(bag, used, wrench)
        place = "/" + place.strip("/")

        def full(topic: str) -> str:
            return topic if topic.startswith("/") else f"{place.rstrip('/')}/{topic}"

        raw, compressed = (full(topic) in used for topic in IMAGES)
        if vision and not (raw or compressed):
            raise InputError(
                f"{bag}: holds no images in namespace '{place}'; leave 'vision' out to replay the "
                "recorded areas"
            )
        measured = raw if vision is None else vision
        transport = "raw" if raw or not measured else "compressed"
        read = [full(wrench)]
        if measured:
            read.append(full("image_raw" if transport == "raw" else "image_raw/compressed"))
        heard = tuple(topic for topic in read if topic in used)
        if not heard:
            others = sorted(name for name in used if name.endswith("/wrench"))
            remedy = f"; it holds {listed(others)}: name that namespace" if others else ""
            if compressed:
                remedy += "; vision:=true measures its images"
            raise InputError(
                f"{bag}: holds no '{wrench}' in namespace '{place}' for the model{remedy}"
            )
        without = {*PUBLISHED_AGAIN, *(["contact_area"] if measured else [])}
        return Replay(
            ("vision", "model") if measured else ("model",),
            tuple(t for t in reader.info.topics if t.rsplit("/", 1)[-1] not in without),
            heard,
            place,
            transport,
            reader.attachment(CALIBRATION_ATTACHMENT) if measured else None,
        )


def _only_namespace(bag: Path, used: Collection[str], wrench: str) -> str:
    """Namespace of the wrench among the topics of a bag, or else of its images; the usual one where
    it has neither. Raises InputError where there are several."""
    for name in (wrench, *IMAGES):
        end = f"/{name}"
        found = sorted(topic.removesuffix(end) or "/" for topic in used if topic.endswith(end))
        if len(found) > 1:
            raise InputError(
                f"{bag}: holds several fingers, {listed(found)}; choose one with namespace:="
            )
        if found:
            return found[0]
    return DEFAULT_NAMESPACE
