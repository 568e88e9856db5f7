# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""An ATI NETCANOEM board with transducer on a python-can bus, wire level.

Models: all documented opcodes, sixteen calibration slots (slot 0 active after power-up and reset),
matrix, counts and unit codes per slot, the status word with data still sent in critical errors,
16-bit gauges with saturation, noise and unloaded offset, base identifier and bit rate that take
effect at the next power-up, firmware too old for some opcodes (silence), response time; see FAULTS
for what can be switched.

Does not model: arbitration, bit timing, acknowledgement and real error frames, temperature,
hysteresis and creep of the transducer, the board's analogue filter, its diagnostic ADC's scale, its
EEPROM.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import can
import numpy as np

from finger_common.settings import setting

from ..can_bus import frame as can_frame
from ..can_bus import may_be_own
from ..protocols import netcanoem as protocol
from .simulator import BusOptions, CanSimulator
from .values import LoadOptions, no_load, numbers

FAULTS = {
    "silent": "answers nothing, as without power",
    "no_second": "leaves out the second frame of a reading",
    "late": "holds back a reading until the next request has arrived",
    "delay": "answers this many ms late",
    "swapped": "sends the second frame of a reading before the first",
    "wrong_length": "sends the first frame of a reading one byte short",
    "foreign": "sends frames of another device between request and reply",
    "extended": "sends 29-bit frames of the same number between request and reply",
    "error_frame": "sends an error frame before the reply",
    "saturated": "gauge 3 stands at its end",
    "status": "status word, bits as in the manual's table 4.3",
    "reset": "the board resets itself: slot 0, silent for 10 ms",
    "duplicate": "sends each frame of a reading twice",
    "rival": "another device sends a first frame of its own before that of a reading",
    "flood": "40 frames of other devices and of wrong lengths before a reading",
}


def _addressing(base: int | None, bitrate: int | None) -> str:
    """Base identifier and bit rate (bit/s) as text, each where it is given."""
    texts = [] if base is None else [f"base 0x{base:02X}"]
    return ", ".join(texts + ([] if bitrate is None else [f"{bitrate} bit/s"]))


def three_beam_matrix(radius: float = 5e-3, sensitivity: float = 500.0) -> np.ndarray:
    """Calibration matrix (6, 6) of an idealised transducer, N and N mm per count times 1e6.

    Three beams at 120° on `radius` (m), each with one gauge for axial and one for tangential load,
    `sensitivity` in counts per N on a beam. Statics gives gauges from the wrench; the matrix is its
    inverse.
    """
    to_gauges = np.zeros((6, 6))
    for beam in range(3):
        angle = 2 * np.pi * beam / 3
        c, s = np.cos(angle), np.sin(angle)
        axial = np.array([0, 0, 1 / 3, 2 * s / (3 * radius), -2 * c / (3 * radius), 0])
        tangential = np.array([-2 * s / 3, 2 * c / 3, 0, 0, 0, 1 / (3 * radius)])
        to_gauges[2 * beam] = sensitivity * axial
        to_gauges[2 * beam + 1] = sensitivity * tangential
    return np.linalg.inv(to_gauges) * 1e6 * np.array([1, 1, 1, 1e3, 1e3, 1e3])[:, None]


def default_calibration(slot: int = 0) -> protocol.Calibration:
    """Calibration of the simulated transducer: N and N mm, 10⁶ counts per unit, single precision.

    Each further slot is for 5 % less sensitivity, so that no two are alike.
    """
    matrix = three_beam_matrix(sensitivity=500.0 * 0.95**slot).astype(np.float32).astype(float)
    return protocol.Calibration(matrix, 1_000_000, 1_000_000, 2, 4, "FT01234")


@dataclass(frozen=True)
class NetcanoemOptions(LoadOptions, BusOptions):
    """Options of the simulated board."""

    base: int = setting(
        protocol.DEFAULT_BASE, "Base identifier.", minimum=0, maximum=protocol.MAX_BASE
    )
    slots: str = setting("0", "Slots that hold a calibration, e.g. 0,3.")
    noise: float = setting(1.0, "Standard deviation of a gauge.", unit="counts", minimum=0)
    response_time: float = setting(0.0, "Time between request and reply.", unit="s", minimum=0)


@dataclass
class NetcanoemSimulator(CanSimulator):
    """ATI NETCANOEM on a CAN bus.

    force: called with the time (ns since the epoch) of each reading, gives the wrench (6,) in N and
    N m. slots: calibrations by slot number. noise: standard deviation in counts. gauge_offset: (6,)
    counts unloaded.
    response_time: s between request and reply.
    """

    bus: can.BusABC
    force: Callable[[int], np.ndarray] = no_load
    base: int = protocol.DEFAULT_BASE
    slots: dict[int, protocol.Calibration] = field(
        default_factory=lambda: {0: default_calibration()}
    )
    firmware: tuple[int, int, int] = (3, 8, 12)
    noise: float = 1.0
    gauge_offset: np.ndarray = field(default_factory=lambda: np.zeros(6))
    response_time: float = 0.0
    seed: int = 1
    unit_codes: tuple[int, int] | None = None
    """Unit codes to send instead of the slot's, also impossible ones."""

    NAME = "netcanoem"
    SETTINGS = NetcanoemOptions
    FAULTS = FAULTS

    def __post_init__(self) -> None:
        super().__init__()
        self.active_slot = 0
        self.readings = 0
        self.bitrate: int | None = None
        """Set by opcode 0xE, in bit/s; the bus is not changed."""
        self._pending_base: int | None = None
        self._pending_bitrate: int | None = None
        self._held: list[can.Message] = []
        self._asleep_until = 0.0
        self._echo_until: dict[bytes, float] = {}
        """Unix time until which data of "set calibration" may be the echo of a reply."""
        self._random = np.random.default_rng(self.seed)

    @classmethod
    def from_settings(cls, settings: NetcanoemOptions) -> NetcanoemSimulator:
        slots = [int(slot) for slot in numbers(settings.slots, "--slots")]
        force = settings.load()
        simulator = cls(
            settings.open_bus(),
            force,
            base=settings.base,
            slots={slot: default_calibration(slot) for slot in slots},
            noise=settings.noise,
            response_time=settings.response_time,
        )
        simulator.owns_bus = True
        return simulator

    def describe(self) -> str:
        now = _addressing(self.base, self.bitrate)
        pending = _addressing(self._pending_base, self._pending_bitrate)
        return f"{super().describe()}, {now}" + (f"; after power-up {pending}" if pending else "")

    def commands(self) -> dict[str, Callable[..., None]]:
        return {"power": self.power_cycle, "units": self._set_units}

    def _set_units(self, force: str, torque: str) -> None:
        self.unit_codes = (int(force), int(torque))

    def reset(self) -> None:
        """Slot 0, nothing held back, silent for 10 ms."""
        self.active_slot = 0
        self._held.clear()
        self._asleep_until = time.monotonic() + 0.01

    def power_cycle(self) -> None:
        """Off and on: a reset, and pending base identifier and bit rate in force."""
        self.reset()
        if self._pending_base is not None:
            self.base, self._pending_base = self._pending_base, None
        if self._pending_bitrate is not None:
            self.bitrate, self._pending_bitrate = self._pending_bitrate, None

    def run(self) -> None:
        while not self.ending:
            frame = self.request(0.1)
            if frame is not None:
                self._handle(frame)

    # Requests --------------------------------------------------------------------------------

    def _handle(self, frame: can.Message) -> None:
        if frame.arbitration_id >> 4 != self.base:
            return
        opcode, data = frame.arbitration_id & 0xF, bytes(frame.data)
        # On a bus that echoes, own replies come back; their length differs from that of requests.
        if opcode not in protocol.REQUEST_LENGTH or len(data) != protocol.REQUEST_LENGTH[opcode]:
            return
        # Not so for 0x6: answering the echo of an own answer would never end. It may come twice.
        if opcode == protocol.SET_CALIBRATION and may_be_own(self.bus, frame):
            if frame.timestamp < self._echo_until.get(data, 0.0):
                return
        if self.faults.take("reset"):
            self.reset()
        if self.faults.value("silent") or time.monotonic() < self._asleep_until:
            return
        if self.response_time:
            time.sleep(self.response_time)
        if delay := self.faults.value("delay"):
            time.sleep(max(delay, 0) * 1e-3)
        for held in self._held:
            self.bus.send(held)
        self._held.clear()
        replies = self._replies(opcode, data)
        if opcode == protocol.READ_GAUGES:
            self._send_reading(replies)
        else:
            for reply, (number, _) in zip(replies, protocol.REPLIES[opcode]):
                self.bus.send(self._frame(number, reply))
            if opcode == protocol.SET_CALIBRATION:
                self._echo_until[data] = time.time() + 0.02

    def _replies(self, opcode: int, data: bytes) -> list[bytes]:
        """Data of the reply frames."""
        calibration = self.slots.get(self.active_slot)
        if opcode == protocol.READ_GAUGES:
            return list(self._reading(calibration))
        if opcode == protocol.SET_CALIBRATION:
            # The manual leaves open what becomes of a number above 15; the low bits are what fits.
            self.active_slot = data[0] % protocol.SLOTS
            return [data]
        if opcode == protocol.READ_MATRIX:
            if data[0] > 5:
                return []
            row = np.zeros(6) if calibration is None else calibration.matrix[data[0]]
            return list(protocol.encode_matrix_row(row))
        if opcode == protocol.READ_SERIAL:
            serial = "" if calibration is None else calibration.serial
            return [serial.encode("ascii")[:8].ljust(8, b"\0")]
        if opcode == protocol.READ_FIRMWARE:
            return [struct.pack(">BBH", *self.firmware)]
        if opcode == protocol.SET_BASE:
            self._pending_base = data[0] & 0x7F
            return [b""]
        if opcode == protocol.SET_BITRATE:
            self._pending_bitrate = 2_000_000 // (data[0] + 1)
            return [b""]
        if opcode == protocol.RESET:
            self.reset()
            return []
        if opcode == protocol.READ_DIAGNOSTIC:
            return [b"\x08\x00"] if self.firmware[:2] >= (3, 8) else []
        if self.firmware[:2] < protocol.UNITS_SINCE:
            return []
        calibration = calibration or default_calibration()
        if opcode == protocol.READ_COUNTS:
            counts = (calibration.counts_per_force, calibration.counts_per_torque)
            return [struct.pack(">II", *counts)]
        codes = self.unit_codes or (calibration.force_unit, calibration.torque_unit)
        return [bytes(codes)]

    def _reading(self, calibration: protocol.Calibration | None) -> tuple[bytes, bytes]:
        status = self.faults.value("status") & 0xFFFF
        gauges = np.array(self.gauge_offset, dtype=float)
        if calibration is None:
            status |= protocol.BAD_CALIBRATION
        else:
            gauges = gauges + calibration.gauges(self.force(time.time_ns()))
        if self.noise:
            gauges = gauges + self.noise * self._random.standard_normal(6)
        gauges = np.clip(np.rint(gauges), -32768, 32767)
        if self.faults.take("saturated"):
            gauges[3] = 32767
        self.readings += 1
        return protocol.encode_gauges(status, gauges)

    def _send_reading(self, replies: list[bytes]) -> None:
        frames = [self._frame(0, replies[0]), self._frame(1, replies[1])]
        if self.faults.take("foreign"):
            for number in (0x701, 0x000, 0x2F0):
                self.bus.send(can_frame(number, bytes(8)))
        if self.faults.take("extended"):
            self.bus.send(can_frame(frames[0].arbitration_id, bytes(8), extended=True))
        if self.faults.take("error_frame"):
            self.bus.send(can.Message(is_error_frame=True, is_extended_id=False))
        if self.faults.take("wrong_length"):
            frames[0] = self._frame(0, replies[0][:7])
        if self.faults.take("no_second"):
            frames.pop()
        if self.faults.take("swapped"):
            frames.reverse()
        if self.faults.take("duplicate"):
            frames = [copy for frame in frames for copy in (frame, frame)]
        if self.faults.take("rival"):
            frames.insert(0, self._frame(0, protocol.encode_gauges(0, np.full(6, 999))[0]))
        if self.faults.take("flood"):
            for number in range(20):
                self.bus.send(can_frame(0x701, bytes(8)))
                self.bus.send(self._frame(number % 2, bytes(5)))
        if self.faults.take("late"):
            self._held += frames
            return
        for frame in frames:
            self.bus.send(frame)

    def _frame(self, opcode: int, data: bytes) -> can.Message:
        return can_frame(protocol.identifier(self.base, opcode), data)
