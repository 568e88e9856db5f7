# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The streams of a session bag as arrays: what trials, validation and processing start from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from finger_common.errors import InputError, listed
from finger_common.stamps import header_stamp
from finger_common.subject_code import known_finger

from .cdr_layout import (
    UNREAD_STAMP,
    WRENCH_TYPE,
    frame_id_of_cdr,
    stamp_of_cdr,
    stamps_and_wrenches,
)
from .definitions import Decoder
from .mapping import MappedTopic
from .read_settings import ReadSettings
from .reader import BagMessage, BagReader
from .schema import TOPICS

MAXIMUM_TEXT = 10_000
"""Characters of a text of a `trial` message above which the message is malformed."""

STREAMS = ("contact_area", "moisture", "indentation", "trial")
"""Topics that are read beside the wrench."""
IMAGES = ("image_raw", "image_raw/compressed")
"""Topics of which the first that holds messages is read, where images are wanted."""

AREA = np.dtype(
    [
        ("stamp_ns", "i8"),
        ("log_ns", "i8"),
        ("area", "f8"),
        ("real_area", "f8"),
        ("sd", "f8"),
        ("flags", "i8"),
    ]
)
"""A measured contact: stamp of its image and log time, gross area, real area and standard deviation
of the gross area in m² (NaN where unknown), flags as in ContactArea."""

IMAGE = np.dtype([("stamp_ns", "i8"), ("log_ns", "i8")])
"""Stamp and log time of a frame."""

INDENTATION = np.dtype([("stamp_ns", "i8"), ("indentation", "f8")])
"""Stamp, and approach of plate and bone in m."""

MOISTURE_BEFORE, MOISTURE_AFTER = 1, 2
"""Phases of a reading, as in finger_msgs/Moisture."""


@dataclass(frozen=True)
class MoistureReading:
    """One reading (a.u.); phase: 0 unknown, 1 before, 2 after the press; flags as in Moisture;
    log_ns: log time, None where it is not from a bag."""

    stamp_ns: int
    value: float
    phase: int = 0
    flags: int = 0
    log_ns: int | None = None


@dataclass(frozen=True)
class TrialEvent:
    """One `trial` message; fields as in finger_msgs/Trial. finger: the header's frame."""

    stamp_ns: int
    session: str
    subject: str
    condition: str
    index: int
    attempt: int
    phase: int
    target_force: float
    note: str = ""
    finger: str = ""


class Wrenches(NamedTuple):
    """Wrenches in the order recorded: log time and stamp (n,) in ns, force (n, 3) in N and torque
    (n, 3) in N m in the sensor's axes."""

    log_ns: np.ndarray
    stamp_ns: np.ndarray
    force: np.ndarray
    torque: np.ndarray


@dataclass
class SessionStreams:
    """Streams of one bag in SI units, in the order recorded.

    areas (k,): of AREA. indentations (j,): of INDENTATION, empty where none was measured. images
    (m,): of IMAGE, whether or not they were looked at. area_source: "topic" or "images".
    """

    wrenches: Wrenches
    areas: np.ndarray
    images: np.ndarray
    indentations: np.ndarray
    moistures: list[MoistureReading] = field(default_factory=list)
    trials: list[TrialEvent] = field(default_factory=list)
    area_source: str = "topic"
    problems: list[str] = field(default_factory=list)


def missing(reader: BagReader, name: str) -> InputError:
    """Error for a bag without a topic that is needed, naming what there is."""
    spec = TOPICS.get(name)
    kind = f" ({spec.type})" if spec else ""
    same = [t for t, i in reader.info.topics.items() if spec and i.type == spec.type]
    remedy = (
        f"name the topic that holds it ({listed(sorted(same))}) in a mapping file"
        if same
        else "record it, or name the topic that holds it in a mapping file"
    )
    return InputError(f"{reader.path}: topic '{name}'{kind} is missing; {remedy}")


def find_topic(reader: BagReader, name: str, settings: ReadSettings) -> str | None:
    """Absolute topic of a stream, None when the bag has none.

    Raises InputError when the mapping names a topic that the bag does not hold.
    """
    mapped = settings.mapping.topic(name).topic
    if not mapped:
        return reader.topic(name, settings.namespace)
    absolute = mapped if mapped.startswith("/") else "/" + mapped
    if absolute not in reader.info.topics:
        raise InputError(
            f"{reader.path}: topic '{absolute}', which the mapping names for '{name}', is not in "
            f"the bag; it holds {', '.join(sorted(reader.info.topics)) or 'nothing'}"
        )
    return absolute


def find_used(reader: BagReader, name: str, settings: ReadSettings) -> str | None:
    """As `find_topic`, None also for a topic that is known to hold no message."""
    topic = find_topic(reader, name, settings)
    return None if topic is None or reader.info.topics[topic].count == 0 else topic


def find_wrench(reader: BagReader, settings: ReadSettings) -> str:
    """Absolute topic of the wrench; raises InputError for a bag without messages or wrench."""
    if not reader.info.topics or reader.info.message_count == 0:
        problems = "; ".join(reader.all_problems()[:2])
        raise InputError(
            f"{reader.path}: bag holds no message{f' ({problems})' if problems else ''}; "
            "record it again"
        )
    if settings.wrench_topic == "wrench":
        wrench = find_topic(reader, "wrench", settings)
    else:
        wrench = reader.topic(settings.wrench_topic, settings.namespace)
    if wrench is None:
        raise missing(reader, settings.wrench_topic)
    return wrench


def apart(reader: BagReader, settings: ReadSettings, names: Sequence[str]) -> str:
    """A warning where those of these streams that were found by their names alone lie in several
    namespaces, as in a bag of a hand in which one finger has no areas and another one no force; ""
    otherwise."""
    if settings.namespace:
        return ""
    known = {"wrench"} if settings.wrench_topic != "wrench" else set()
    known |= {name for name in names if settings.mapping.topic(name).topic}
    found = [find_used(reader, name, settings) for name in names if name not in known]
    topics = sorted(topic for topic in found if topic is not None)
    if len({topic.removesuffix("/compressed").rpartition("/")[0] for topic in topics}) < 2:
        return ""
    return (
        f"{listed(topics)} are taken together, though their namespaces differ: if they are not of "
        "one finger, choose with --namespace, or name the topics in a mapping file"
    )


class Malformed:
    """Messages that were left out, by topic, with the reason of the first."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}

    def add(self, topic: str, reason: object, count: int = 1) -> None:
        """Count messages of a topic; reason: text or error."""
        self.counts[topic] += count
        if isinstance(reason, AttributeError):
            reason = (
                f"their definition in the bag has no field '{reason.name}'; name the topic and a "
                "field that it has in a mapping file"
            )
        self.reasons.setdefault(topic, str(reason))

    def problems(self) -> list[str]:
        """One sentence per topic."""
        return [
            f"topic '{topic}': {count} malformed messages left out ({self.reasons[topic]})"
            for topic, count in self.counts.items()
        ]


def read_wrenches(
    items: Sequence[BagMessage], decoder: Decoder | None, mapped: MappedTopic, malformed: Malformed
) -> tuple[Wrenches, str]:
    """Wrenches of the messages of a topic, as it is mapped, and the frame_id of the first of them.

    decoder: as for `stamps_and_wrenches`. Messages that are none are left out and counted.
    """
    stamps, force, torque = stamps_and_wrenches([item.raw for item in items], decoder)
    log = np.array([item.log_time_ns for item in items], np.int64)
    unread = stamps == UNREAD_STAMP
    early = (stamps < 0) & ~unread & (not mapped.log_time)
    for bad, reason in (
        (unread, f"bytes are not a {WRENCH_TYPE}"),
        (early, "stamps lie before 1970; name 'stamp: log_time' for the wrench in a mapping file"),
    ):
        if bad.any():
            malformed.add(items[0].topic, reason, int(bad.sum()))
    good = ~(unread | early)
    if not good.all():
        stamps, force, torque, log = stamps[good], force[good], torque[good], log[good]
    frame = ""
    if len(stamps):
        first = items[int(np.argmax(good))].raw
        if decoder is None or decoder.standard:
            frame = frame_id_of_cdr(first)
        else:
            frame = str(decoder(first).header.frame_id)
    if mapped.scale != 1.0:
        # The mapping tells the unit of the force alone: zero is a sensor without torque.
        torque = np.zeros_like(torque)
    stamps = log.copy() if mapped.log_time else stamps
    with np.errstate(all="ignore"):  # the bytes of a damaged bag may be any number
        return Wrenches(log, stamps, force * mapped.scale, torque), frame


class _Wrenches:
    """Wrench messages, turned into numbers block by block: hours of them fit into memory."""

    BLOCK, BLOCK_BYTES = 20_000, 16 << 20

    def __init__(self, reader: BagReader, mapped: MappedTopic, malformed: Malformed) -> None:
        self._reader, self._mapped, self._malformed = reader, mapped, malformed
        self._items: list[BagMessage] = []
        self._bytes = 0
        self._done: list[Wrenches] = []

    def add(self, item: BagMessage) -> None:
        self._items.append(item)
        self._bytes += len(item.raw)
        if len(self._items) >= self.BLOCK or self._bytes >= self.BLOCK_BYTES:
            self._convert()

    def _convert(self) -> None:
        items = self._items
        decoder = self._reader.decoder(items[0].topic, WRENCH_TYPE) if items else None
        self._done.append(read_wrenches(items, decoder, self._mapped, self._malformed)[0])
        self._items, self._bytes = [], 0

    def arrays(self) -> Wrenches:
        """All of them."""
        self._convert()
        return Wrenches(*(np.concatenate(parts) for parts in zip(*self._done)))


def wrong_type(item: BagMessage, needed: str) -> InputError:
    """Error for a message of another type than the schema's."""
    return InputError(f"type is '{item.type}', '{needed}' is needed")


def read_streams(
    reader: BagReader,
    settings: ReadSettings,
    on_image: Callable[[BagMessage, int], None] | None = None,
    with_images: bool = True,
) -> SessionStreams:
    """Read all streams of a bag in one pass.

    on_image is called with each image message and its stamp (ns). Raises InputError when there is
    no wrench or the bag holds no message at all; malformed messages are left out, counted and
    listed in `problems`.
    """
    mapping = settings.mapping
    wrench = find_wrench(reader, settings)
    names = {wrench: "wrench"}
    # Raw and compressed images of a bag are the same ones.
    images_of = [n for n in IMAGES if find_used(reader, n, settings)][: int(with_images)]
    for name in (*STREAMS, *images_of):
        topic = find_topic(reader, name, settings)
        if topic is not None:
            names.setdefault(topic, name)
    areas: list[tuple[int, int, float, float, float, int]] = []
    images: list[tuple[int, int]] = []
    indentations: list[tuple[int, float]] = []
    moistures: list[MoistureReading] = []
    trials: list[TrialEvent] = []
    kinds: dict[str, tuple[list[Any], Callable[[BagMessage, MappedTopic], Any]]] = {
        "contact_area": (areas, _area),
        "moisture": (moistures, _moisture),
        "indentation": (indentations, _indentation),
        "trial": (trials, _trial),
        **{name: (images, _image) for name in images_of},
    }
    malformed = Malformed()
    wrenches = _Wrenches(reader, mapping.topic("wrench"), malformed)
    for item in reader.messages(names):
        name = names[item.topic]
        mapped = mapping.topic(name)
        try:
            if item.type != TOPICS[name].type and (not mapped.field or name == "wrench"):
                raise wrong_type(item, TOPICS[name].type)
            if name == "wrench":
                wrenches.add(item)
                continue
            rows, row_of = kinds[name]
            rows.append(row_of(item, mapped))
            if rows is images and on_image is not None:
                on_image(item, images[-1][0])
        except (InputError, AttributeError, TypeError, ValueError) as error:
            malformed.add(item.topic, error)
    found = wrenches.arrays()
    if not len(found.stamp_ns):
        reason = malformed.reasons.get(wrench, "it is empty")
        raise InputError(f"{reader.path}: topic '{wrench}' holds no wrench ({reason})")
    return SessionStreams(
        found,
        np.array(areas, AREA),
        np.array(images, IMAGE),
        np.array(indentations, INDENTATION),
        moistures,
        trials,
        problems=malformed.problems() + reader.all_problems(),
    )


def stamp_and_value(item: BagMessage, mapped: MappedTopic) -> tuple[int, float | None]:
    """Stamp (ns) of a message, and the value (SI) of the field that its mapping names, if any."""
    message = item.message
    stamp = (item.log_time_ns if mapped.log_time else header_stamp(message)) + mapped.offset_ns
    if not mapped.field:
        return stamp, None
    for name in mapped.field.split("."):
        message = getattr(message, name)
    return stamp, float(message) * mapped.scale


def _area(item: BagMessage, mapped: MappedTopic) -> tuple[int, int, float, float, float, int]:
    stamp, value = stamp_and_value(item, mapped)
    if value is not None:
        return stamp, item.log_time_ns, value, float("nan"), float("nan"), 0
    message = item.message
    areas = (message.gross_area, message.real_area, message.area_stddev)
    gross, real, sd = (float(value) * mapped.scale for value in areas)
    return stamp, item.log_time_ns, gross, real, sd, int(message.flags)


def image_stamp(item: BagMessage, mapped: MappedTopic) -> int:
    """Stamp (ns) of an image message, read without decoding it."""
    return (item.log_time_ns if mapped.log_time else stamp_of_cdr(item.raw)) + mapped.offset_ns


def _image(item: BagMessage, mapped: MappedTopic) -> tuple[int, int]:
    return image_stamp(item, mapped), item.log_time_ns


def _indentation(item: BagMessage, mapped: MappedTopic) -> tuple[int, float]:
    stamp, value = stamp_and_value(item, mapped)
    return stamp, float(item.message.point.z) * mapped.scale if value is None else value


def _moisture(item: BagMessage, mapped: MappedTopic) -> MoistureReading:
    stamp, value = stamp_and_value(item, mapped)
    if value is not None:
        return MoistureReading(stamp, value, log_ns=item.log_time_ns)
    message = item.message
    phase, flags = int(message.phase), int(message.flags)
    return MoistureReading(stamp, float(message.value), phase, flags, item.log_time_ns)


def _trial(item: BagMessage, mapped: MappedTopic) -> TrialEvent:
    message = item.message
    texts = [str(getattr(message, name)) for name in ("session", "subject", "condition")]
    note = str(message.note)
    if max(map(len, (*texts, note))) > MAXIMUM_TEXT:
        raise InputError(f"a text has more than {MAXIMUM_TEXT} characters")
    numbers = [int(getattr(message, name)) for name in ("index", "attempt", "phase")]
    stamp = header_stamp(message)
    finger = known_finger(str(message.header.frame_id))
    last = (float(message.target_force), note, finger)
    values: Any = (stamp, *texts, *numbers, *last)
    return TrialEvent(*values)


def in_stamp_order(table: np.ndarray) -> np.ndarray:
    """The rows (n,) of a table sorted by `stamp_ns`, later duplicates of a stamp left out."""
    ordered = table[np.argsort(table["stamp_ns"], kind="stable")]
    later = np.diff(ordered["stamp_ns"]) > 0
    return ordered[np.concatenate([[True], later])[: len(ordered)]]
