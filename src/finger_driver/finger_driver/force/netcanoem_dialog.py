# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Requests to one NETCANOEM board on a bus that others use too, and its start-up."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import can
import numpy as np

from finger_common.errors import DeviceError

from .. import can_bus
from ..device import Device
from ..protocols import netcanoem as protocol

_STOOD_STILL = 0.005
"""Seconds after the end of a timeout; noticed only then, this process did not run at its end."""
_SPARE = 100
"""Frames that are read after the end of a timeout, because they may have waited."""


def key_of(frame: can.Message) -> protocol.Key:
    """Opcode and length of a frame of the board."""
    return frame.arbitration_id & 0xF, frame.dlc


class Dialog:
    """Exchanges frames with one board.

    bus: open; whoever opened it shuts it down. base: the board's base identifier. timeout: s for a
    reply. device: its health counts what else the bus carries. where: names the board in errors.
    Methods that send or receive raise one of `BUS_ERRORS` when the bus fails.
    """

    def __init__(
        self, bus: can.BusABC, base: int, timeout: float, device: Device[Any], where: str
    ) -> None:
        self.bus = bus
        self._first_id = protocol.identifier(base, 0)
        self._timeout = timeout
        self._device = device
        self._where = where
        self._echoes = 0

    # Frames ----------------------------------------------------------------------------------

    def send(self, opcode: int, data: bytes = b"") -> None:
        """Send a request."""
        self.bus.send(can_bus.frame(self._first_id | opcode, data), timeout=self._timeout)

    def receive(self, end: float) -> can.Message | None:
        """Next frame of this board before `end` (monotonic s), or None; others are counted."""
        spare, again = _SPARE, True
        while spare:
            left = end - time.monotonic()
            spare -= left <= 0
            frame = self.bus.recv(max(left, 0.0))
            if frame is None:
                if not again or time.monotonic() - end < _STOOD_STILL:
                    return None
                again, end = False, time.monotonic() + self._timeout
            elif self.is_own(frame):
                return frame
        return None

    def is_own(self, frame: can.Message) -> bool:
        """Whether it is a frame of this board; others are counted."""
        if frame.is_error_frame:
            self._device.note(
                "bus_errors", "the bus carries error frames; check wiring and bit rate"
            )
        elif (
            frame.is_extended_id
            or frame.is_remote_frame
            or frame.is_fd
            or frame.arbitration_id & ~0xF != self._first_id
        ):
            self._device.health.count("foreign")
        else:
            return True
        return False

    # Requests --------------------------------------------------------------------------------

    def ask(self, opcode: int, data: bytes = b"") -> tuple[bytes, ...]:
        """Reply frames to a request, in order; tried three times, then DeviceError."""
        due = protocol.REPLIES[opcode]
        # What waits is old: on a bus that gives every frame twice, the last one of a row would be
        # taken for that of the next row.
        can_bus.discard_waiting(self.bus)
        for attempt, frames in enumerate(self._attempts(opcode, data)):
            got: dict[protocol.Key, bytes] = {}
            for frame in frames:
                key = key_of(frame)
                if key == due[0]:
                    got.clear()  # of what was on its way still
                if key in due:
                    got[key] = bytes(frame.data)
                if len(got) == len(due):
                    if attempt:
                        self._await_late(attempt * len(due))
                    return tuple(got[key] for key in due)
            self._device.health.count("retries")
        raise DeviceError(f"{self._where}: no answer to request 0x{opcode:X}; check the bus load")

    def _attempts(self, opcode: int, data: bytes = b"") -> Iterator[Iterator[can.Message]]:
        """Send a request three times; each time the frames that come before its timeout."""
        for _ in range(3):
            self.send(opcode, data)
            end = time.monotonic() + max(self._timeout, 0.1)
            yield iter(partial(self.receive, end), None)

    def _await_late(self, number: int) -> None:
        """Take replies to earlier attempts, so that none is taken for that to the next request."""
        end = time.monotonic() + (number + 1) * max(self._timeout, 0.1)
        while number and self.receive(end) is not None:
            self._device.health.count("late_replies")
            number -= 1

    # Start-up --------------------------------------------------------------------------------

    def start_up(
        self, slot: int, expected_serial: str, assumed_units: tuple[int, int]
    ) -> tuple[tuple[int, int, int], protocol.Calibration]:
        """Firmware and calibration of a board that uses a slot from then on (manual, section 10).

        expected_serial: of the transducer, empty for any. assumed_units: codes of force and torque
        for firmware that does not tell them. Raises DeviceError for another transducer, and for a
        board that does not answer or gives no usable calibration.
        """
        can_bus.discard_waiting(self.bus)
        firmware = protocol.decode_firmware(self._firmware())
        self._set_calibration(slot)
        serial = protocol.decode_serial(self.ask(protocol.READ_SERIAL)[0])
        if expected_serial and serial != expected_serial:
            raise DeviceError(
                f"{self._where}: transducer '{serial}' is connected, '{expected_serial}' is "
                "expected; connect the right one or change 'expected_serial'"
            )
        rows, again = (np.array([self._read_row(axis) for axis in range(6)]) for _ in range(2))
        if not np.array_equal(rows, again, equal_nan=True):
            raise DeviceError(
                f"{self._where}: two readings of the matrix differ; check the bus load, and that "
                "no other program or finger asks this board"
            )
        counts, codes = (protocol.DEFAULT_COUNTS,) * 2, assumed_units
        if firmware[:2] >= protocol.UNITS_SINCE:
            counts = protocol.decode_counts(self.ask(protocol.READ_COUNTS)[0])
            codes = protocol.decode_units(self.ask(protocol.READ_UNITS)[0])
        return firmware, protocol.Calibration(rows, *counts, *codes, serial)

    def _firmware(self) -> bytes:
        """Firmware frame; counts on the way how often the bus echoes an own frame."""
        first = self._first_id | protocol.READ_FIRMWARE
        for attempt, frames in enumerate(self._attempts(protocol.READ_FIRMWARE)):
            echoes = 0
            for frame in frames:
                if frame.arbitration_id != first:
                    continue
                if frame.dlc == 4:
                    self._echoes = echoes
                    self._await_late(attempt)
                    return bytes(frame.data)
                echoes += frame.dlc == 0
        raise DeviceError(
            f"{self._where}: no answer; check power, bit rate, base identifier and termination"
        )

    def _set_calibration(self, slot: int) -> None:
        """Choose the slot and see it confirmed beyond the bus's own echoes of the request."""
        expected = self._first_id | protocol.SET_CALIBRATION
        attempts = self._attempts(protocol.SET_CALIBRATION, bytes([slot]))
        for attempt, frames in enumerate(attempts):
            seen = 0
            for frame in frames:
                if frame.arbitration_id == expected and bytes(frame.data) == bytes([slot]):
                    seen += 1
                    if seen > self._echoes:
                        self._await_late(attempt)
                        return
        raise DeviceError(
            f"{self._where}: calibration slot {slot} was not confirmed; slots are 0 to 15"
        )

    def _read_row(self, axis: int) -> np.ndarray:
        return protocol.decode_matrix_row(self.ask(protocol.READ_MATRIX, bytes([axis])))
