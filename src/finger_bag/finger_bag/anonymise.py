"""A copy of a bag without biometric data: no images; areas, outlines, force, moisture and metadata stay.

Only topics of the bag schema are kept, and of these none that shows the print: what another topic holds cannot be
known. Attached files are kept when they are YAML, JSON or CSV text.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from finger_common.errors import InputError

from .reader import open_bag
from .recover import announce
from .schema import IMAGE_TOPICS, spec_of
from .writer import BagWriter

TEXT_SUFFIXES = (".yaml", ".yml", ".json", ".csv")


@dataclass
class Anonymised:
    """The new bag, messages kept and dropped by topic, attachments dropped."""

    path: Path
    kept: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    dropped_attachments: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def is_kept(topic: str, message_type: str) -> bool:
    """Whether a topic is known to show nothing of the print."""
    spec = spec_of(topic)
    return spec is not None and spec.name not in IMAGE_TOPICS and message_type == spec.type


def anonymise(source: str | Path, target: str | Path) -> Anonymised:
    """Copy a bag without its images; raises InputError when it cannot be read or the target exists."""
    dropped: dict[str, int] = {}
    dropped_attachments = []
    with open_bag(source) as reader:
        announced: set[str] = set()
        with BagWriter(target, {**reader.info.metadata.to_mapping(), "anonymised": "true"}) as bag:
            for entry, data in reader.attachments():
                if Path(entry.name).suffix.lower() in TEXT_SUFFIXES:
                    bag.attach(entry.name, data, entry.media_type)
                else:
                    dropped_attachments.append(entry.name)
            for item in reader.messages():
                if not is_kept(item.topic, item.type):
                    dropped[item.topic] = dropped.get(item.topic, 0) + 1
                    continue
                if item.topic not in announced:
                    announce(bag, reader.topic_info(item.topic, item.type))
                    announced.add(item.topic)
                bag.write_raw(
                    item.topic, item.raw, item.log_time_ns, item.publish_time_ns, item.sequence
                )
            if not bag.message_count:
                raise InputError(f"{source}: holds no topic that can be kept; nothing was written")
            written = bag.close()
        return Anonymised(
            written.path, written.counts, dropped, dropped_attachments, reader.all_problems()
        )
