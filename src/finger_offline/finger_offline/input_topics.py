# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which topics of a bag a run of `finger-bag process` reads, and which ones it replaces."""

from __future__ import annotations

from dataclasses import dataclass

from finger_bag.mapping import MappedTopic
from finger_bag.reader import BagReader
from finger_bag.streams import IMAGES, apart, find_topic, find_used, find_wrench, missing

from .process_options import ProcessOptions


@dataclass(frozen=True)
class InputTopics:
    """Absolute names of the topics that a run reads, None for those it does not use."""

    wrench: str
    area: str | None
    moisture: str | None
    image: str | None
    image_mapping: MappedTopic
    """How the images are stamped."""
    events: str | None
    namespace: str
    """Where the results go, such as "/finger"; "" for none."""
    replaced: frozenset[str]
    """Topics of the input that are not copied: the run writes its own."""
    apart: str = ""
    """What to say of a force and areas, or events, that may be of different fingers."""

    @classmethod
    def of(cls, reader: BagReader, options: ProcessOptions) -> InputTopics:
        """Find them; raises InputError without a wrench, or without images that are asked for."""
        wrench = find_wrench(reader, options)
        area = find_topic(reader, "contact_area", options)
        images = [
            (topic, options.mapping.topic(name))
            for name in IMAGES
            if (topic := find_used(reader, name, options)) is not None
        ]
        absent = find_used(reader, "contact_area", options) is None
        from_images = options.images == "yes" or (
            options.images == "auto" and absent and bool(images)
        )
        if from_images and not images:
            raise missing(reader, "image_raw")
        measured = IMAGES if from_images else ("contact_area",)
        recorded = find_topic(reader, "model_events", options)
        follow = find_used(reader, "model_events", options) is not None
        same = follow and not options.is_own()
        # Beside the former states: their force may come from a topic of another namespace.
        if options.namespace:
            namespace = f"/{options.namespace.strip('/')}".rstrip("/")
        else:
            namespace = (recorded or wrench).rpartition("/")[0]
        replaced = {f"{namespace}/contact_state"}
        # What the recording made of the former states; with other settings it is theirs no more.
        if options.slip or not same:
            replaced.add(f"{namespace}/contact_slip")
        if options.shape or not same:
            replaced.add(f"{namespace}/contact_shape")
        if from_images:
            replaced |= {f"{namespace}/contact_area", area or ""}
        if not same:
            replaced.add(recorded or "")
        return cls(
            wrench=wrench,
            area=None if from_images else area,
            moisture=find_topic(reader, "moisture", options),
            image=images[0][0] if from_images else None,
            image_mapping=images[0][1] if from_images else MappedTopic(),
            events=recorded if follow else None,
            namespace=namespace,
            replaced=frozenset(replaced),
            apart=apart(reader, options, ("wrench", *measured, "model_events")),
        )

    def used(self) -> list[str]:
        """The topics that are read."""
        topics = (self.wrench, self.area, self.moisture, self.image, self.events)
        return [topic for topic in topics if topic is not None]

    def result(self, name: str) -> str:
        """Absolute topic of a result, such as "contact_state"."""
        return f"{self.namespace}/{name}"
