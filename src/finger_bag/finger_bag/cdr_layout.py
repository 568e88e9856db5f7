# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where the fields of a serialized message are, so that many messages are read or written as one
array.

500 Hz for an hour are 1.8 million messages. The places follow from the message definition (OMG CDR:
each number is aligned to its size, counted from the end of the encapsulation header of 4 bytes)
once the lengths of its texts are known; messages of equal lengths are one structured NumPy array.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from finger_common.errors import InputError
from finger_common.stamps import NANOSECONDS, header_stamp

from .definitions import Decoder, typestore
from .schema import TOPICS

WRENCH_TYPE = TOPICS["wrench"].type

_NUMPY = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1"}


@lru_cache(maxsize=64)
def cdr_layout(
    message_type: str, text_lengths: tuple[int, ...] = (), little: bool = True, padding: int = 0
) -> np.dtype[Any]:
    """Structured dtype of a serialized message: fields by dotted name, such as "header.stamp.sec".

    text_lengths: bytes of each text of the message in order, the closing zero included; the length
    itself is the field "NAME.length". padding: bytes behind the last field. Raises InputError for a
    type that holds a sequence.
    """
    order: Any = "<" if little else ">"
    lengths = iter(text_lengths)
    found: dict[str, tuple[Any, int]] = {"encapsulation": ("V4", 0)}
    end = 4

    def add(name: str, dtype: Any, alignment: int) -> None:
        nonlocal end
        place = 4 + -(-(end - 4) // alignment) * alignment
        found[name] = (dtype, place)
        end = place + np.dtype(dtype).itemsize

    def visit(message: str, prefix: str) -> None:
        fields: Any = typestore().fielddefs[message][1]
        for name, (kind, detail) in fields:
            if kind == Nodetype.NAME:
                visit(detail, f"{prefix}{name}.")
                continue
            base, count = (detail[0], 1) if kind == Nodetype.BASE else (detail[0][1][0], detail[1])
            if (
                kind == Nodetype.SEQUENCE
                or base in ("wstring",)
                or (base == "string" and count > 1)
            ):
                raise InputError(f"message type '{message_type}' has no fixed layout ('{name}')")
            if base == "string":
                add(f"{prefix}{name}.length", order + "u4", 4)
                add(prefix + name, f"S{next(lengths)}", 1)
                continue
            number = np.dtype(_NUMPY.get(base, base)).newbyteorder(order)
            add(prefix + name, (number, count) if count > 1 else number, number.itemsize)

    visit(message_type, "")
    formats, offsets = zip(*found.values())
    return np.dtype(
        {"names": list(found), "formats": formats, "offsets": offsets, "itemsize": end + padding}
    )


def _offset(message_type: str, name: str) -> int:
    """Place of a field that stands before or at the first text."""
    return int(cdr_layout(message_type, (0,)).fields[name][1])  # type: ignore[index]


_SECONDS = _offset("std_msgs/msg/Header", "stamp.sec")
_NANOSECONDS = _offset("std_msgs/msg/Header", "stamp.nanosec")
_FRAME_LENGTH = _offset("std_msgs/msg/Header", "frame_id.length")
_FRAME = _offset("std_msgs/msg/Header", "frame_id")


def _is_little(raw: bytes) -> bool:
    if len(raw) < _FRAME or raw[0] != 0 or raw[1] > 1:
        raise InputError("bytes are not a message with a header")
    return raw[1] == 1


def stamp_of_cdr(raw: bytes) -> int:
    """Header stamp (ns) of a serialized message; raises InputError for bytes without a header."""
    order = "little" if _is_little(raw) else "big"
    seconds = int.from_bytes(raw[_SECONDS : _SECONDS + 4], order, signed=True)  # type: ignore[arg-type]
    nanoseconds = int.from_bytes(raw[_NANOSECONDS : _NANOSECONDS + 4], order)  # type: ignore[arg-type]
    return seconds * NANOSECONDS + nanoseconds


def frame_id_of_cdr(raw: bytes) -> str:
    """frame_id of a serialized message; raises InputError for bytes without a header."""
    order = "little" if _is_little(raw) else "big"
    length = int.from_bytes(raw[_FRAME_LENGTH:_FRAME], order)  # type: ignore[arg-type]
    return raw[_FRAME : _FRAME + max(length - 1, 0)].decode(errors="replace")


def stamps_of(table: np.ndarray, prefix: str) -> np.ndarray:
    """Stamps (n,) in ns of a time field of a structured array."""
    return table[prefix + ".sec"].astype(np.int64) * NANOSECONDS + table[prefix + ".nanosec"]


def set_stamps(table: np.ndarray, prefix: str, stamps_ns: np.ndarray) -> None:
    """Fill a time field of a structured array."""
    table[prefix + ".sec"], table[prefix + ".nanosec"] = np.divmod(stamps_ns, NANOSECONDS)


UNREAD_STAMP = -1
"""ns; of a message that is none."""


def stamps_and_wrenches(
    raws: Sequence[bytes], decoder: Decoder | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,) in ns, forces (n, 3) in N and torques (n, 3) in N m of n serialized
    WrenchStamped.

    decoder: for messages that are not laid out as expected, and for all where their definition is
    not the known one; None refuses them. A message that is neither is given UNREAD_STAMP.
    """
    number = len(raws)
    fixed = decoder is None or decoder.standard
    stamps = np.full(number, UNREAD_STAMP, np.int64)
    values = {part: np.full((number, 3), np.nan) for part in ("force", "torque")}
    groups: dict[tuple[int, bytes], list[int]] = defaultdict(list)
    others: list[int] = []
    for index, raw in enumerate(raws):
        if fixed and len(raw) >= _FRAME:
            # Length, encapsulation and length of frame_id fix the layout.
            groups[(len(raw), raw[:2] + raw[_FRAME_LENGTH:_FRAME])].append(index)
        else:
            others.append(index)
    for (size, key), indices in groups.items():
        little = key[1] == 1
        text = int.from_bytes(key[2:], "little" if little else "big")
        known = key[0] == 0 and key[1] <= 1 and text < size
        padding = size - cdr_layout(WRENCH_TYPE, (text,), little).itemsize if known else -1
        if not 0 <= padding < 4:
            others += indices
            continue
        layout = cdr_layout(WRENCH_TYPE, (text,), little, padding)
        table = np.frombuffer(b"".join([raws[i] for i in indices]), dtype=layout)
        where = np.array(indices)
        stamps[where] = stamps_of(table, "header.stamp")
        for part, columns in values.items():
            for axis, name in enumerate("xyz"):
                columns[where, axis] = table[f"wrench.{part}.{name}"]
    for index in others if decoder is not None else ():
        try:
            message = decoder(raws[index])  # type: ignore[misc]
            for part, columns in values.items():
                vector = getattr(message.wrench, part)
                columns[index] = vector.x, vector.y, vector.z
            stamps[index] = header_stamp(message)
        except (InputError, ValueError, TypeError, AttributeError):
            continue
    return stamps, values["force"], values["torque"]


def zero_messages(message_type: str, count: int, texts: Mapping[str, str]) -> np.ndarray:
    """Structured array (count,) of messages whose numbers are 0.

    texts: all texts that the type has, by dotted name, in order.
    """
    encoded = {name: text.encode() + b"\x00" for name, text in texts.items()}
    table = np.zeros(count, cdr_layout(message_type, tuple(map(len, encoded.values()))))
    table["encapsulation"] = np.void(b"\x00\x01\x00\x00")  # little endian
    for name, text in encoded.items():
        table[name + ".length"], table[name] = len(text), text
    return table


def serialized(table: np.ndarray) -> list[bytes]:
    """Messages of a structured array, each as bytes."""
    data, size = table.tobytes(), table.dtype.itemsize
    return [data[begin : begin + size] for begin in range(0, len(data), size)]
