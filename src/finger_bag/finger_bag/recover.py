"""Making damaged bags whole: everything that can be read goes, unchanged, into a new bag with index and metadata."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from finger_common.errors import InputError

from .definitions import MAXIMUM_DEFINITION
from .reader import BagReader, TopicInfo, open_bag
from .writer import BagWriter


@dataclass
class Recovery:
    """What came of it: the new bag, messages by topic, what could not be read."""

    path: Path
    message_count: int
    counts: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def announce(writer: BagWriter, topic: TopicInfo, name: str | None = None) -> None:
    """Add a topic of a bag that was read, with its own definition and quality of service, to one being written.

    Raises InputError for a topic that cannot be written as it is.
    """
    if topic.encoding != "cdr" or not topic.type:
        raise InputError(f"topic '{topic.name}' is encoded as '{topic.encoding}', not copied")
    if topic.form and len(topic.definition) <= MAXIMUM_DEFINITION:
        form, definition = topic.form, topic.definition
    else:
        form, definition = "ros2msg", None
    writer.add_topic(
        name or topic.name, topic.type, definition=definition, form=form, qos=topic.qos
    )


def copy_attachments(reader: BagReader, writer: BagWriter) -> None:
    """Copy all attachments; their names are kept as text and never used as paths."""
    for entry, data in reader.attachments():
        writer.attach(entry.name, data, entry.media_type)


def recover(source: str | Path, target: str | Path) -> Recovery:
    """Copy what can be read of a bag into a new one; the original is not touched.

    Raises InputError when nothing can be read or the target exists.
    """
    with open_bag(source) as reader:
        skipped: dict[tuple[str, str], str] = {}
        known: set[tuple[str, str]] = set()
        refused = 0
        with BagWriter(target, reader.info.metadata) as writer:
            copy_attachments(reader, writer)
            for topic in reader.info.topics.values():
                try:
                    announce(writer, topic)
                    known.add((topic.name, topic.type))
                except InputError as error:
                    skipped[(topic.name, topic.type)] = str(error)
            for message in reader.messages():
                key = (message.topic, message.type)
                if key in skipped:
                    continue
                if key not in known:
                    try:
                        announce(writer, reader.topic_info(*key))
                        known.add(key)
                    except InputError as error:
                        skipped[key] = str(error)
                        continue
                try:
                    writer.write_raw(
                        message.topic,
                        message.raw,
                        message.log_time_ns,
                        message.publish_time_ns,
                        message.sequence,
                    )
                except InputError:
                    refused += 1
            problems = [*reader.all_problems(), *skipped.values()]
            if refused:
                problems.append(f"{refused} messages were no CDR messages and were left out")
            if not writer.message_count:
                raise InputError(
                    f"{source}: no message can be recovered"
                    + (f" ({problems[0]})" if problems else "")
                )
            written = writer.close()
    return Recovery(written.path, written.message_count, written.counts, problems)
