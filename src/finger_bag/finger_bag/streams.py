# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The streams of a session bag as arrays: what trials, validation and processing start from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.stamps import header_stamp

from .cdr_layout import WRENCH_TYPE, stamp_of_cdr, stamps_and_wrenches
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

MOISTURE_BEFORE, MOISTURE_AFTER = 1, 2
"""Phases of a reading, as in finger_msgs/Moisture."""


@dataclass(frozen=True)
class MoistureReading:
    """One reading (a.u.); phase: 0 unknown, 1 before, 2 after the press; flags as in Moisture."""

    stamp_ns: int
    value: float
    phase: int = 0
    flags: int = 0


@dataclass(frozen=True)
class TrialEvent:
    """One `trial` message; fields as in finger_msgs/Trial."""

    stamp_ns: int
    session: str
    subject: str
    condition: str
    index: int
    attempt: int
    phase: int
    target_force: float
    note: str = ""


@dataclass
class SessionStreams:
    """Streams of one bag in SI units, in the order recorded.

    wrench_stamp_ns, wrench_log_ns (n,): header stamp and log time; force, torque (n, 3) in the
    sensor's axes. area_stamp_ns (k,), area, real_area, area_sd (k,) in m², area_flags (k,).
    indentation_stamp_ns, indentation (j,) in m, empty where none was measured. image_stamp_ns,
    image_log_ns (m,): frames, whether or not they were looked at.
    """

    wrench_stamp_ns: np.ndarray
    wrench_log_ns: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    area_stamp_ns: np.ndarray
    area_log_ns: np.ndarray
    area: np.ndarray
    real_area: np.ndarray
    area_sd: np.ndarray
    area_flags: np.ndarray
    image_stamp_ns: np.ndarray
    image_log_ns: np.ndarray
    moistures: list[MoistureReading] = field(default_factory=list)
    trials: list[TrialEvent] = field(default_factory=list)
    area_source: str = "topic"
    problems: list[str] = field(default_factory=list)
    indentation_stamp_ns: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    indentation: np.ndarray = field(default_factory=lambda: np.empty(0))


def missing(reader: BagReader, name: str) -> InputError:
    """Error for a bag without a topic that is needed, naming what there is."""
    spec = TOPICS.get(name)
    kind = f" ({spec.type})" if spec else ""
    same = [t for t, i in reader.info.topics.items() if spec and i.type == spec.type]
    remedy = (
        f"name the topic that holds it ({', '.join(sorted(same)[:5])}) in a mapping file"
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


class Malformed:
    """Messages that were left out, by topic, with the reason of the first."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}

    def add(self, topic: str, reason: object, count: int = 1) -> None:
        """Count messages of a topic; reason: text or error."""
        self.counts[topic] += count
        self.reasons.setdefault(topic, str(reason))

    def problems(self) -> list[str]:
        """One sentence per topic."""
        return [
            f"topic '{topic}': {count} malformed messages left out ({self.reasons[topic]})"
            for topic, count in self.counts.items()
        ]


class _Wrenches:
    """Wrench messages, turned into numbers block by block: hours of them fit into memory."""

    BLOCK, BLOCK_BYTES = 20_000, 16 << 20

    def __init__(self, reader: BagReader, topic: str) -> None:
        self._reader, self._topic = reader, topic
        self._log: list[int] = []
        self._raw: list[bytes] = []
        self._bytes = 0
        self._done: list[tuple[np.ndarray, ...]] = []

    def add(self, item: BagMessage) -> None:
        self._log.append(item.log_time_ns)
        self._raw.append(item.raw)
        self._bytes += len(item.raw)
        if len(self._raw) >= self.BLOCK or self._bytes >= self.BLOCK_BYTES:
            self._convert()

    def _convert(self) -> None:
        decode = self._reader.decoder(self._topic, WRENCH_TYPE) if self._raw else None
        fixed = decode is None or decode.standard
        numbers = stamps_and_wrenches(self._raw, decode, fixed)
        self._done.append((np.array(self._log, np.int64), *numbers))
        self._log, self._raw, self._bytes = [], [], 0

    def arrays(self) -> list[np.ndarray]:
        """Log time, stamp, force and torque of all, as `stamps_and_wrenches` gives them."""
        self._convert()
        return [np.concatenate(parts) for parts in zip(*self._done)]


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
    wrenches = _Wrenches(reader, wrench)
    areas: list[tuple[int, int, float, float, float, int]] = []
    images: list[tuple[int, int]] = []
    moistures: list[MoistureReading] = []
    trials: list[TrialEvent] = []
    indentations: list[tuple[int, float]] = []
    malformed = Malformed()
    for item in reader.messages(names):
        name = names[item.topic]
        mapped = mapping.topic(name)
        try:
            if item.type != TOPICS[name].type and (not mapped.field or name == "wrench"):
                raise wrong_type(item, TOPICS[name].type)
            if name == "wrench":
                wrenches.add(item)
            elif name == "contact_area":
                areas.append(_area(item, mapped))
            elif name == "moisture":
                moistures.append(_moisture(item, mapped))
            elif name == "indentation":
                indentations.append(_indentation(item, mapped))
            elif name == "trial":
                trials.append(_trial(item.message))
            else:
                shot = item.log_time_ns if mapped.log_time else stamp_of_cdr(item.raw)
                images.append((shot, item.log_time_ns))
                if on_image is not None:
                    on_image(item, shot)
        except (InputError, AttributeError, TypeError, ValueError) as error:
            malformed.add(item.topic, error)
    log, stamps, force, torque = wrenches.arrays()
    good = stamps >= 0
    if not good.all():
        malformed.add(wrench, f"bytes are not a {WRENCH_TYPE}", int((~good).sum()))
        stamps, force, torque, log = stamps[good], force[good], torque[good], log[good]
    if not len(stamps):
        reason = malformed.reasons.get(wrench, "it is empty")
        raise InputError(f"{reader.path}: topic '{wrench}' holds no wrench ({reason})")
    wrench_map = mapping.topic("wrench")
    table = np.array([a[2:5] for a in areas], float).reshape(-1, 3)
    return SessionStreams(
        wrench_stamp_ns=log.copy() if wrench_map.log_time else stamps,
        wrench_log_ns=log,
        force=force * wrench_map.scale,
        torque=torque,
        area_stamp_ns=np.array([a[0] for a in areas], np.int64),
        area_log_ns=np.array([a[1] for a in areas], np.int64),
        area=table[:, 0],
        real_area=table[:, 1],
        area_sd=table[:, 2],
        area_flags=np.array([a[5] for a in areas], np.int64),
        image_stamp_ns=np.array([i[0] for i in images], np.int64),
        image_log_ns=np.array([i[1] for i in images], np.int64),
        moistures=moistures,
        trials=trials,
        indentation_stamp_ns=np.array([i[0] for i in indentations], np.int64),
        indentation=np.array([i[1] for i in indentations], float),
        problems=malformed.problems() + reader.all_problems(),
    )


def stamp_and_value(item: BagMessage, mapped: MappedTopic) -> tuple[int, float | None]:
    """Stamp (ns) of a message, and the value (SI) of the field that its mapping names, if any."""
    message = item.message
    stamp = item.log_time_ns if mapped.log_time else header_stamp(message)
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


def _indentation(item: BagMessage, mapped: MappedTopic) -> tuple[int, float]:
    stamp, value = stamp_and_value(item, mapped)
    return stamp, float(item.message.point.z) * mapped.scale if value is None else value


def _moisture(item: BagMessage, mapped: MappedTopic) -> MoistureReading:
    stamp, value = stamp_and_value(item, mapped)
    if value is not None:
        return MoistureReading(stamp, value)
    message = item.message
    return MoistureReading(stamp, float(message.value), int(message.phase), int(message.flags))


def _trial(message: Any) -> TrialEvent:
    texts = [str(getattr(message, name)) for name in ("session", "subject", "condition")]
    note = str(message.note)
    if max(map(len, (*texts, note))) > MAXIMUM_TEXT:
        raise InputError(f"a text has more than {MAXIMUM_TEXT} characters")
    numbers = [int(getattr(message, name)) for name in ("index", "attempt", "phase")]
    stamp = header_stamp(message)
    last = (float(message.target_force), note)
    values: Any = (stamp, *texts, *numbers, *last)
    return TrialEvent(*values)


def in_stamp_order(stamps: np.ndarray, *others: np.ndarray) -> Iterator[np.ndarray]:
    """Arrays sorted by stamp, later duplicates of a stamp left out."""
    if not len(stamps):
        yield from (stamps, *others)
        return
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    keep = order[np.concatenate([[True], np.diff(ordered) > 0])]
    for array in (stamps, *others):
        yield array[keep]
