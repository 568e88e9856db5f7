# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ATI Net F/T Raw Data Transfer (RDT) over UDP.

Source: ATI 9620-05-net ft, section 10, and the public driver netft/ros-netft (status word, order of
commands). Big-endian. A request is 8 bytes (0x1234, command, sample count), a record 36 bytes; in
buffered mode a datagram holds several records.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from finger_common.errors import DeviceError

PORT = 49152
HEADER = 0x1234
STOP = 0x0000
START_REALTIME = 0x0002
START_BUFFERED = 0x0003
RESET_LATCH = 0x0041
SET_BIAS = 0x0042
COMMANDS = (STOP, START_REALTIME, START_BUFFERED, RESET_LATCH, SET_BIAS)

RECORD_SIZE = 36
MAX_RECORDS = 40
MAX_COUNT = 2**31 - 1
INTERNAL_RATE = 7000.0
"""Samples per second inside a Net F/T; an Axia has others."""

SUMMARY_BIT = 1 << 31
LATCH_BIT = 1 << 16
SATURATION_BIT = 1 << 17

STATUS_BITS = {
    1: "HTTP error",
    2: "internal temperature",
    3: "reference or power",
    4: "serial link data unavailable",
    5: "analog supply low",
    6: "analog supply high",
    7: "analog ground",
    8: "insufficient gauge excitation",
    9: "excess gauge excitation",
    10: "analog watchdog",
    11: "flash SPI",
    12: "EEPROM I2C",
    13: "stack",
    14: "watchdog",
    16: "monitor condition latched",
    17: "transducer saturation or A/D error",
    18: "DeviceNet",
    19: "EtherNet/IP",
    20: "RDT communication",
    21: "CAN communication",
    22: "network communication",
    23: "configuration does not fit the calibration",
    24: "settings validation",
    25: "halted by its configuration",
    26: "program memory",
    27: "serial link communication",
    28: "analog board",
    29: "digital board",
    30: "CPU or RAM",
}


@dataclass(frozen=True)
class Record:
    """Numbers of record and internal sample, status word, counts of Fx Fy Fz Tx Ty Tz."""

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: tuple[int, int, int, int, int, int]


def encode_request(command: int, count: int = 0) -> bytes:
    """Request; count 0 starts an endless stream."""
    return struct.pack(">HHI", HEADER, command, count)


def decode_request(data: bytes) -> tuple[int, int]:
    """Command and count of a request; raises DeviceError when it is none."""
    if len(data) != 8:
        raise DeviceError(f"request has {len(data)} bytes, 8 are expected")
    header, command, count = struct.unpack(">HHI", data)
    if header != HEADER or command not in COMMANDS:
        raise DeviceError(f"not an RDT request: header 0x{header:04X}, command 0x{command:04X}")
    return command, count


def encode_record(record: Record) -> bytes:
    """The 36 bytes of a record."""
    return struct.pack(
        ">III6i",
        record.rdt_sequence & 0xFFFFFFFF,
        record.ft_sequence & 0xFFFFFFFF,
        record.status,
        *record.counts,
    )


def decode_datagram(data: bytes) -> list[Record]:
    """Records of a datagram; raises DeviceError unless it holds 1 to 40 whole ones."""
    number, rest = divmod(len(data), RECORD_SIZE)
    if rest or not 1 <= number <= MAX_RECORDS:
        raise DeviceError(f"datagram of {len(data)} bytes does not hold whole records of 36")
    records = []
    for start in range(0, len(data), RECORD_SIZE):
        rdt, ft, status, *counts = struct.unpack_from(">III6i", data, start)
        records.append(Record(rdt, ft, status, tuple(counts)))  # type: ignore[arg-type]
    return records


def difference(earlier: int, later: int) -> int:
    """Difference of two numbers of records or of internal samples, which are of 32 bits."""
    return (later - earlier + (1 << 31)) % (1 << 32) - (1 << 31)


def status_text(status: int) -> str:
    """Meaning of the set bits of a status word; of the summary bit where it is set alone."""
    if status == SUMMARY_BIT:
        return "summary bit without a cause"
    names = [STATUS_BITS.get(b, f"bit {b}") for b in range(31) if status >> b & 1]
    return ", ".join(names) or "no fault"


def real_rate(requested: float, internal: float = INTERNAL_RATE) -> float:
    """Records per second that the box sends: the smallest integer fraction of its internal rate not
    below the request. Beyond the internal rate it repeats samples.
    """
    return internal / int(internal // requested) if 0 < requested < internal else requested
