# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Copies of bags: all that can be read (`recover`), or all but biometric data (`anonymise`)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from finger_common.errors import InputError

from .definitions import MAXIMUM_DEFINITION, TopicInfo
from .reader import BagReader, open_bag
from .schema import IMAGE_TOPICS, spec_of
from .writer import BagWriter, MessageRefused

TEXT_SUFFIXES = (".yaml", ".yml", ".json", ".csv")


@dataclass
class BagCopy:
    """The new bag: messages copied and left out on purpose, by topic; what could not be read."""

    path: Path
    counts: dict[str, int] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    dropped_attachments: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    lost: bool = False
    """Whether something that the bag holds could not be read, and is not in the copy."""

    @property
    def message_count(self) -> int:
        """Messages in the copy."""
        return sum(self.counts.values())


def announce(writer: BagWriter, topic: TopicInfo) -> None:
    """Add a topic of a bag that was read, with its own definition and quality of service, to one
    being written; the quality of service is that of the schema where the bag tells none.

    Raises InputError for a topic that cannot be written as it is.
    """
    if topic.encoding != "cdr" or not topic.type:
        raise InputError(f"topic '{topic.name}' is encoded as '{topic.encoding}', not copied")
    if topic.form and len(topic.definition) <= MAXIMUM_DEFINITION:
        form, definition = topic.form, topic.definition
    else:
        form, definition = "ros2msg", None
    writer.add_topic(
        topic.name, topic.type, definition=definition, form=form, qos=topic.qos or None
    )


def copy_attachments(reader: BagReader, writer: BagWriter) -> None:
    """Copy all attachments; their names are kept as text and never used as paths."""
    for entry, data in reader.attachments():
        writer.attach(entry.name, data, entry.media_type)


def recover(source: str | Path, target: str | Path) -> BagCopy:
    """Copy what can be read of a bag into a new one; the original is not touched.

    Raises InputError when nothing can be read, the target exists or cannot be written.
    """
    with (
        open_bag(source) as reader,
        BagWriter(target, reader.info.metadata, namespace="") as writer,
    ):
        copy_attachments(reader, writer)
        refused: dict[int, str] = {}
        announced: set[int] = set()
        malformed = 0

        def is_announced(topic: TopicInfo) -> bool:
            key = id(topic)  # of the reader, which keeps it
            if key not in announced and key not in refused:
                try:
                    announce(writer, topic)
                    announced.add(key)
                except InputError as error:
                    refused[key] = str(error)
            return key in announced

        for topic in reader.info.topics.values():
            is_announced(topic)
        for message in reader.messages():
            if not is_announced(message.info):
                continue
            try:
                writer.copy(message)
            except MessageRefused:
                malformed += 1
        problems = [*reader.all_problems(), *refused.values()]
        if malformed:
            problems.append(f"{malformed} messages were no CDR messages and were left out")
        if not writer.message_count:
            reason = f" ({problems[0]})" if problems else ""
            raise InputError(f"{source}: no message can be recovered{reason}")
        lost = reader.lost or bool(refused or malformed)
        written = writer.close()
    return BagCopy(written.path, written.counts, problems=problems, lost=lost)


def shows_no_print(topic: str, message_type: str) -> bool:
    """Whether a topic is known to show nothing of the fingerprint."""
    spec = spec_of(topic)
    return spec is not None and spec.name not in IMAGE_TOPICS and message_type == spec.type


def anonymise(source: str | Path, target: str | Path) -> BagCopy:
    """Copy a bag without biometric data; areas, outlines, force, moisture and metadata stay.

    Only topics of the bag schema are copied, and of these none that shows the print: what another
    topic holds cannot be known. Attached files are copied when they are YAML, JSON or CSV text.
    Raises InputError when the bag cannot be read or the target exists.
    """
    with open_bag(source) as reader:
        metadata = {**reader.info.metadata.to_mapping(), "anonymised": "true"}
        with BagWriter(target, metadata) as writer:
            copy = BagCopy(Path(target))
            for entry, data in reader.attachments():
                if Path(entry.name).suffix.lower() in TEXT_SUFFIXES:
                    writer.attach(entry.name, data, entry.media_type)
                else:
                    copy.dropped_attachments.append(entry.name)
            announced: set[str] = set()
            for message in reader.messages():
                if not shows_no_print(message.topic, message.type):
                    copy.dropped[message.topic] += 1
                    continue
                if message.topic not in announced:
                    # Refuses a topic of several definitions, of which one would be lost.
                    announce(writer, reader.topic_info(message.topic, message.type))
                    announced.add(message.topic)
                writer.copy(message)
            if not writer.message_count:
                raise InputError(f"{source}: holds no topic that can be kept; nothing was written")
            copy.counts = writer.close().counts
        copy.problems, copy.lost = reader.all_problems(), reader.lost
    return copy
