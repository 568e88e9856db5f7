"""The streams of a session bag as arrays: what trials, validation and processing start from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from finger_common.errors import InputError

from .bulk import WRENCH_TYPE, stamps_and_wrenches
from .mapping import MappedTopic
from .read_settings import ReadSettings
from .reader import BagMessage, BagReader
from .schema import TOPICS

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

    wrench_stamp_ns, wrench_log_ns (n,): header stamp and log time; force, torque (n, 3) in the sensor's axes.
    area_stamp_ns (k,), area, real_area, area_sd (k,) in m², area_flags (k,).
    image_stamp_ns, image_log_ns (m,): frames, whether or not they were looked at.
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


def stamp_ns(message: Any) -> int:
    """Header stamp in ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def field_value(message: Any, dotted: str) -> Any:
    """Value under a dotted field name; raises AttributeError."""
    for name in dotted.split("."):
        message = getattr(message, name)
    return message


def missing(reader: BagReader, name: str, hint: str = "") -> InputError:
    """Error for a bag without a topic that is needed, naming what there is."""
    spec = TOPICS.get(name)
    kind = f" ({spec.type})" if spec else ""
    same = [t for t, i in reader.info.topics.items() if spec and i.type == spec.type]
    remedy = hint or (
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
    """Absolute topic of the wrench; raises InputError for a bag without messages or without a wrench."""
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


def read_streams(
    reader: BagReader,
    settings: ReadSettings,
    on_image: Callable[[BagMessage], None] | None = None,
    with_images: bool = True,
) -> SessionStreams:
    """Read all streams of a bag in one pass.

    on_image is called with each image message. Raises InputError when there is no wrench or the bag holds no message at all; malformed messages are left out, counted
    and listed in `problems`.
    """
    mapping = settings.mapping
    wrench = find_wrench(reader, settings)
    wrench_map = mapping.topic("wrench")
    places = {wrench: "wrench"}
    for name in ("contact_area", "moisture", "trial", "image_raw", "image_raw/compressed"):
        if name.startswith("image") and not with_images:
            continue
        topic = find_topic(reader, name, settings)
        if topic is not None:
            places.setdefault(topic, name)

    wrench_raw: list[bytes] = []
    wrench_log: list[int] = []
    areas: list[tuple[int, int, float, float, float, int]] = []
    images: list[tuple[int, int]] = []
    moistures: list[MoistureReading] = []
    trials: list[TrialEvent] = []
    malformed: dict[str, int] = {}
    first_error: dict[str, str] = {}
    expected = {topic: _expected_type(name) for topic, name in places.items()}
    plain_wrench = not wrench_map.field

    for item in reader.messages(places):
        name = places[item.topic]
        try:
            if name == "wrench" and plain_wrench and item.type == WRENCH_TYPE:
                wrench_raw.append(item.raw)
                wrench_log.append(item.log_time_ns)
                continue
            mapped = mapping.topic(name)
            if not mapped.field and item.type not in expected[item.topic]:
                raise InputError(f"type is '{item.type}', '{expected[item.topic][0]}' is needed")
            if name.startswith("image"):
                images.append((stamp_of_cdr(item.raw), item.log_time_ns))
                if on_image is not None:
                    on_image(item)
            elif name == "wrench":
                raise InputError(f"type is '{item.type}', '{WRENCH_TYPE}' is needed")
            elif name == "contact_area":
                areas.append(_area(item, mapped))
            elif name == "moisture":
                moistures.append(_moisture(item, mapped))
            elif name == "trial":
                trials.append(_trial(item))
        except (InputError, AttributeError, TypeError, ValueError) as error:
            malformed[item.topic] = malformed.get(item.topic, 0) + 1
            first_error.setdefault(item.topic, str(error))

    decode = None
    if wrench_raw:
        decode = reader.decoder(wrench, WRENCH_TYPE)
    standard = decode is None or decode.standard
    stamps, force, torque = (
        stamps_and_wrenches(wrench_raw, decode) if standard else _one_by_one(wrench_raw, decode)
    )
    log = np.array(wrench_log, np.int64)
    bad = stamps < 0
    if bad.any():
        malformed[wrench] = malformed.get(wrench, 0) + int(bad.sum())
        stamps, force, torque, log = stamps[~bad], force[~bad], torque[~bad], log[~bad]
    if wrench_map.log_time:
        stamps = log.copy()
    if not len(stamps):
        reason = first_error.get(wrench, "no message could be read" if bad.any() else "it is empty")
        raise InputError(f"{reader.path}: topic '{wrench}' holds no wrench ({reason})")
    problems = [
        f"topic '{topic}': {count} malformed messages left out"
        + (f" ({first_error[topic]})" if topic in first_error else "")
        for topic, count in malformed.items()
    ]
    table = np.array([a[2:5] for a in areas], float).reshape(-1, 3)
    return SessionStreams(
        stamps,
        log,
        force * wrench_map.scale,
        torque,
        np.array([a[0] for a in areas], np.int64),
        np.array([a[1] for a in areas], np.int64),
        table[:, 0],
        table[:, 1],
        table[:, 2],
        np.array([a[5] for a in areas], np.int64),
        np.array([i[0] for i in images], np.int64),
        np.array([i[1] for i in images], np.int64),
        moistures,
        trials,
        problems=problems + reader.all_problems(),
    )


def _expected_type(name: str) -> tuple[str, ...]:
    return (TOPICS[name].type,)


def _one_by_one(raws: list[bytes], decode: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `stamps_and_wrenches` for a definition that only has the name in common with the known one."""
    stamps = np.full(len(raws), -1, np.int64)
    force, torque = np.full((len(raws), 3), np.nan), np.full((len(raws), 3), np.nan)
    for index, raw in enumerate(raws):
        try:
            message = decode(raw)
            wrench = message.wrench
            force[index] = wrench.force.x, wrench.force.y, wrench.force.z
            torque[index] = wrench.torque.x, wrench.torque.y, wrench.torque.z
            stamps[index] = stamp_ns(message)
        except (InputError, AttributeError, TypeError, ValueError):
            continue
    return stamps, force, torque


def stamp_of_cdr(raw: bytes) -> int:
    """Header stamp (ns) of a serialized message that begins with its header, without decoding the rest.

    Raises InputError when the bytes are too short or no CDR.
    """
    if len(raw) < 12 or raw[0] != 0 or raw[1] > 1:
        raise InputError("bytes are not a message with a header")
    order: Literal["little", "big"] = "little" if raw[1] == 1 else "big"
    seconds = int.from_bytes(raw[4:8], order, signed=True)
    return seconds * 1_000_000_000 + int.from_bytes(raw[8:12], order)


def _area(item: BagMessage, mapped: MappedTopic) -> tuple[int, int, float, float, float, int]:
    message = item.message
    stamp = item.log_time_ns if mapped.log_time else stamp_ns(message)
    if mapped.field:
        value = float(field_value(message, mapped.field)) * mapped.scale
        return stamp, item.log_time_ns, value, float("nan"), float("nan"), 0
    return (
        stamp,
        item.log_time_ns,
        float(message.gross_area) * mapped.scale,
        float(message.real_area) * mapped.scale,
        float(message.area_stddev) * mapped.scale,
        int(message.flags),
    )


def _moisture(item: BagMessage, mapped: MappedTopic) -> MoistureReading:
    message = item.message
    stamp = item.log_time_ns if mapped.log_time else stamp_ns(message)
    if mapped.field:
        return MoistureReading(stamp, float(field_value(message, mapped.field)) * mapped.scale)
    return MoistureReading(stamp, float(message.value), int(message.phase), int(message.flags))


def _trial(item: BagMessage) -> TrialEvent:
    m = item.message
    return TrialEvent(
        stamp_ns(m),
        str(m.session),
        str(m.subject),
        str(m.condition),
        int(m.index),
        int(m.attempt),
        int(m.phase),
        float(m.target_force),
        str(m.note),
    )


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
