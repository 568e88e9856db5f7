"""Decoding of many wrenches at once: 500 Hz for an hour are 1.8 million messages.

The CDR bytes of a WrenchStamped have fixed places once the length of frame_id is known (OMG CDR, alignment to the
size of the element counted from the end of the encapsulation header), so messages of equal length are read as one
structured array.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from finger_common.errors import InputError

WRENCH_TYPE = "geometry_msgs/msg/WrenchStamped"
_HEAD = 16  # encapsulation 4, sec 4, nanosec 4, length of frame_id 4


def stamps_and_wrenches(
    raws: Sequence[bytes], decode: Callable[[bytes], Any] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,) in ns, forces (n, 3) in N and torques (n, 3) in N m of n serialized WrenchStamped.

    decode: decoder for messages that are not laid out as expected; None refuses them. A message that is neither is
    given the stamp -1.
    """
    number = len(raws)
    stamps = np.full(number, -1, np.int64)
    forces = np.full((number, 3), np.nan)
    torques = np.full((number, 3), np.nan)
    groups: dict[tuple[int, bytes], list[int]] = defaultdict(list)
    odd: list[int] = []
    for index, raw in enumerate(raws):
        if len(raw) < _HEAD:
            odd.append(index)
        else:
            # Length, encapsulation and length of frame_id fix the layout.
            groups[(len(raw), raw[:2] + raw[12:16])].append(index)
    for (length, key), indices in groups.items():
        order = "<" if key[1] == 1 else ">"
        (text,) = struct.unpack(order + "I", key[2:])
        begin = 4 + -(-(12 + text) // 8) * 8
        if key[:1] != b"\x00" or key[1] > 1 or not begin + 48 <= length <= begin + 51:
            odd += indices
            continue
        layout = np.dtype(
            {
                "names": ["sec", "nanosec", "values"],
                "formats": [order + "i4", order + "u4", (order + "f8", 6)],
                "offsets": [4, 8, begin],
                "itemsize": length,
            }
        )
        table = np.frombuffer(b"".join([raws[i] for i in indices]), dtype=layout)
        where = np.array(indices)
        stamps[where] = table["sec"].astype(np.int64) * 1_000_000_000 + table["nanosec"]
        forces[where] = table["values"][:, :3]
        torques[where] = table["values"][:, 3:]
    for index in odd:
        if decode is None:
            continue
        try:
            message = decode(raws[index])
            stamp = message.header.stamp
            force, torque = message.wrench.force, message.wrench.torque
            forces[index] = force.x, force.y, force.z
            torques[index] = torque.x, torque.y, torque.z
            stamps[index] = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
        except (InputError, ValueError, TypeError, AttributeError):
            continue
    return stamps, forces, torques
