# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ATI NETCANOEM wire protocol (F/T over CAN): addressing, opcodes, status word, arithmetic.

Source: ATI "F/T CAN Bus and Serial Bus Network Interface for OEM", 9610-05-1030-04, sections 7 to
10. All data are big-endian. An 11-bit identifier is `base << 4 | opcode` with a 7-bit base. A
request and its first reply carry the same identifier and differ only in length, so everything here
is matched on identifier *and* length.

Nothing in this module touches a bus: frames are (identifier, data) pairs.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from finger_common.errors import DeviceError

from . import units

DEFAULT_BASE = 0x20

READ_GAUGES = 0x0
READ_MATRIX = 0x2
READ_SERIAL = 0x5
SET_CALIBRATION = 0x6
READ_COUNTS = 0x7
READ_UNITS = 0x8
READ_DIAGNOSTIC = 0x9
RESET = 0xC
SET_BASE = 0xD
SET_BITRATE = 0xE
READ_FIRMWARE = 0xF

Key = tuple[int, int]
"""Opcode and length of a frame."""

REPLIES: dict[int, tuple[Key, ...]] = {
    READ_GAUGES: ((0x0, 8), (0x1, 6)),
    READ_MATRIX: ((0x2, 8), (0x3, 8), (0x4, 8)),
    READ_SERIAL: ((0x5, 8),),
    SET_CALIBRATION: ((0x6, 1),),
    READ_COUNTS: ((0x7, 8),),
    READ_UNITS: ((0x8, 2),),
    READ_DIAGNOSTIC: ((0x9, 2),),
    RESET: (),
    SET_BASE: ((0xD, 0),),
    SET_BITRATE: ((0xE, 0),),
    READ_FIRMWARE: ((0xF, 4),),
}
"""Each reply frame to a request's opcode (manual, table 4.2)."""

READING, ROW = REPLIES[READ_GAUGES], REPLIES[READ_MATRIX]

REQUEST_LENGTH = {
    READ_GAUGES: 0,
    READ_MATRIX: 1,
    READ_SERIAL: 0,
    SET_CALIBRATION: 1,
    READ_COUNTS: 0,
    READ_UNITS: 0,
    READ_DIAGNOSTIC: 1,
    RESET: 0,
    SET_BASE: 1,
    SET_BITRATE: 1,
    READ_FIRMWARE: 0,
}

STATUS_BITS = {
    0: "watchdog reset",
    1: "DAC/ADC check too high",
    2: "DAC/ADC check too low",
    3: "artificial analog ground out of range",
    4: "power supply too high",
    5: "power supply too low",
    6: "bad active calibration",
    7: "EEPROM failure",
    8: "configuration invalid, default settings in use",
    11: "sensor temperature too high",
    12: "sensor temperature too low",
    14: "CAN bus error",
    15: "an error without a cause",
}
"""Meaning of the status word's bits (manual, table 4.3)."""

CRITICAL_BITS = (1, 2, 3, 4, 5, 6, 7, 11, 12)
CRITICAL_MASK = sum(1 << bit for bit in CRITICAL_BITS)
"""Bits with which the gauge data cannot be used. Bit 15 does not follow bit 14 on real boards."""

BAD_CALIBRATION = 1 << 6
GAUGE_ENDS = (-32768, 32767)
"""Gauge readings that mean saturation (manual, section 7.3)."""

SLOTS = 16
MAX_BASE = 0x7F
ANY_ERROR = 0x8000
UNITS_SINCE = (3, 7)
"""Firmware that reports counts per unit and units; for older one they are assumed."""
DEFAULT_COUNTS = 1_000_000
"""Counts per unit assumed, as the manual says."""
DEFAULT_UNITS = 2, 4
"""Codes of N and N-mm, assumed where nobody sets others."""


def identifier(base: int, opcode: int) -> int:
    """11-bit identifier of an opcode; raises ValueError for a base beyond 7 bits."""
    if not 0 <= base <= MAX_BASE:
        raise ValueError(f"base identifier {base} is outside 0 … {MAX_BASE}")
    return base << 4 | opcode


def status_text(status: int) -> str:
    """Meaning of the set bits of a status word."""
    names = [STATUS_BITS.get(bit, f"bit {bit}") for bit in range(16) if status >> bit & 1]
    return ", ".join(names) or "no fault"


def _need(data: bytes, length: int, what: str) -> None:
    if len(data) != length:
        raise DeviceError(f"{what} reply has {len(data)} bytes, {length} are expected")


def decode_gauges(first: bytes, second: bytes) -> tuple[int, np.ndarray]:
    """Status word and gauges (6,) int16 in order 0…5 from the two frames of a reading.

    Raises DeviceError when a frame has the wrong length.
    """
    _need(first, 8, "first gauge")
    _need(second, 6, "second gauge")
    status, g0, g2, g4 = struct.unpack(">Hhhh", first)
    g1, g3, g5 = struct.unpack(">hhh", second)
    return status, np.array([g0, g1, g2, g3, g4, g5], dtype=np.int16)


def encode_gauges(status: int, gauges: np.ndarray) -> tuple[bytes, bytes]:
    """The two frames of a reading, from gauges (6,) in order 0…5."""
    g = [int(v) for v in gauges]
    return (struct.pack(">Hhhh", status, g[0], g[2], g[4]), struct.pack(">hhh", g[1], g[3], g[5]))


def decode_matrix_row(frames: Sequence[bytes]) -> np.ndarray:
    """One row (6,) float64 of the calibration matrix, from its three frames.

    Raises DeviceError for a wrong length.
    """
    for data in frames:
        _need(data, 8, "matrix")
    return np.array(struct.unpack(">6f", b"".join(frames)), dtype=float)


def encode_matrix_row(row: np.ndarray) -> tuple[bytes, bytes, bytes]:
    """The three frames of a matrix row."""
    data = struct.pack(">6f", *(float(v) for v in row))
    return data[:8], data[8:16], data[16:]


def decode_counts(data: bytes) -> tuple[int, int]:
    """Counts per unit of force and of torque; raises DeviceError for a wrong length or zero."""
    _need(data, 8, "counts per unit")
    force, torque = struct.unpack(">II", data)
    if force == 0 or torque == 0:
        raise DeviceError("counts per unit are zero; the active calibration is not usable")
    return force, torque


def decode_units(data: bytes) -> tuple[int, int]:
    """Codes of the force and the torque unit; raises DeviceError for a wrong length."""
    _need(data, 2, "unit code")
    return data[0], data[1]


def decode_firmware(data: bytes) -> tuple[int, int, int]:
    """Major, minor and build number of the firmware; raises DeviceError for a wrong length."""
    _need(data, 4, "firmware")
    major, minor, build = struct.unpack(">BBH", data)
    return major, minor, build


def decode_serial(data: bytes) -> str:
    """Serial number; padding (blanks or zeros, not documented) and non-ASCII bytes removed.

    Raises DeviceError for a wrong length.
    """
    _need(data, 8, "serial number")
    return "".join(chr(b) for b in data if 0x20 < b < 0x7F)


def saturated(gauges: np.ndarray) -> list[int]:
    """Indices of saturated gauges."""
    return [index for index, value in enumerate(gauges.tolist()) if value in GAUGE_ENDS]


@dataclass(frozen=True)
class Calibration:
    """What turns gauges into a wrench.

    matrix: (6, 6), rows Fx Fy Fz Tx Ty Tz, columns gauges 0…5. Raises DeviceError when it is not
    finite or singular, counts are not positive or a unit code is unknown.
    """

    matrix: np.ndarray
    counts_per_force: int = DEFAULT_COUNTS
    counts_per_torque: int = DEFAULT_COUNTS
    force_unit: int = DEFAULT_UNITS[0]
    torque_unit: int = DEFAULT_UNITS[1]
    serial: str = ""
    scaled: np.ndarray = field(init=False, repr=False)
    """(6, 6) matrix from gauge counts to N and N m."""
    _inverse: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, dtype=float)
        if matrix.shape != (6, 6) or not np.all(np.isfinite(matrix)):
            raise DeviceError("calibration matrix holds values that are not finite numbers")
        if not np.any(matrix) or np.linalg.cond(matrix) > 1e9:
            raise DeviceError(
                "calibration matrix is singular; the slot holds no usable calibration"
            )
        force = units.force_factor(self.force_unit) / self.counts_per_force
        torque = units.torque_factor(self.torque_unit) / self.counts_per_torque
        scale = np.array([force] * 3 + [torque] * 3)
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "scaled", matrix * scale[:, None])
        object.__setattr__(self, "_inverse", np.linalg.inv(self.scaled))

    def wrench(self, gauges: np.ndarray) -> np.ndarray:
        """Wrench (6,) in N and N m of gauges (6,) without their bias (manual, figure 7.1)."""
        return self.scaled @ np.asarray(gauges, dtype=float)

    def gauges(self, wrench: np.ndarray) -> np.ndarray:
        """Gauges (6,) float, not rounded, of a wrench (6,) in N and N m."""
        return self._inverse @ np.asarray(wrench, dtype=float)
