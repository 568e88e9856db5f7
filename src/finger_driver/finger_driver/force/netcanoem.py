# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ATI NETCANOEM on any python-can bus: start-up, polling at a fixed rate, faults.

The board is polled: one request, two reply frames. Frames of other devices may lie between them,
the bus may echo the driver's own frames, replies may be lost or late. Rules used here:

- The receive queue is emptied before each request, so that a frame that came twice is never paired
  with a later one.
- Replies are matched on identifier and length; an own echo differs in length, except for "set
  calibration", for which the echoes of the bus are counted first.
- After a poll without a complete reply a *fence* is sent, a request with a reply of its own. The
  board answers in order, so whatever arrives before the fence's reply is old and is discarded. No
  reply is ever paired with a later request.
- The reply to a request for a row does not say which row it is. A fence that was given up may still
  be answered, so all fences ask for the same row until no late reply has come for a while, and
  start-up, after a repeated request, waits for what is still to come and reads the matrix twice.
- A second board of the same identifier may always answer first, or always last. So what comes after
  a complete reply is compared with it. When it differs, nothing is given for a while, since it
  cannot be known which reply was the sensor's.
- The active calibration is lost when the board resets. One row of the matrix is read again every
  `calibration_check_period` seconds and after every silence; a change leads to a new start-up.
- A computer that stands still for a moment loses no reply: what has come is read also after the
  timeout, and where the timeout itself passed unseen, the board gets it once more.
- The stamp is the middle between sending the request and the arrival of the first reply, so its
  error is at most half a round trip.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import can
import numpy as np

from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.settings import setting

from .. import can_bus
from ..protocols import netcanoem as protocol
from ..shared_polling import Polled
from .source import CRITICAL, GOOD, SATURATED, ForceSettings, ForceSource, WrenchSample

_CATCH_UP = 5
"""Missed polls that are made up for by polling without pause; more are skipped and counted."""
_STOOD_STILL = 0.005
"""Seconds after the end of a timeout; noticed only then, this process did not run at its end."""
_SPARE = 100
"""Frames that are read after the end of a timeout, because they may have waited."""
_AT_ONCE = 100
"""Frames taken at once, before other devices have their turn."""
_SILENCE = 0.25
"""Seconds without a reply after which the connection counts as lost."""
_QUIET = 1.0
"""Seconds without a late reply after which the fences ask for another row."""
_DISPUTED = 0.5
"""Seconds after two different replies to one request for which no reading is given."""


@dataclass(frozen=True)
class NetcanoemSettings(can_bus.CanSettings, ForceSettings):
    """Settings of a NETCANOEM board."""

    base_identifier: int = setting(
        protocol.DEFAULT_BASE,
        "NETCANOEM: base identifier (0x20 with DIP switch SW2-1 on).",
        minimum=0,
        maximum=protocol.MAX_BASE,
    )
    calibration_slot: int = setting(
        0,
        "NETCANOEM: calibration to use; the board itself always starts with 0.",
        minimum=0,
        maximum=protocol.SLOTS - 1,
    )
    expected_serial: str = setting(
        "", "NETCANOEM: serial number that the transducer must have; empty accepts any."
    )
    response_timeout: float = setting(
        0.05,
        "NETCANOEM: time for a reply after which a poll counts as lost.",
        unit="s",
        minimum=0.001,
        maximum=1.0,
        advice="Long enough for a busy computer's pauses; shorter loses less time per lost reply.",
    )
    calibration_check_period: float = setting(
        1.0,
        "NETCANOEM: how often one row of the matrix is read again, to notice a board that was "
        "reset.",
        unit="s",
        minimum=0.05,
        maximum=3600.0,
    )


class NetcanoemSource(ForceSource):
    """ATI NETCANOEM on a CAN bus."""

    SETTINGS = NetcanoemSettings
    SIMULATOR = "finger_driver.simulators.netcanoem:NetcanoemSimulator"

    settings: NetcanoemSettings

    def __init__(self, settings: NetcanoemSettings) -> None:
        super().__init__(settings)
        self.period = 1.0 / settings.rate
        self._timeout = settings.response_timeout
        self._bus: can.BusABC | None = None
        self._first_id = protocol.identifier(settings.base_identifier, 0)
        self._poll_request = can_bus.frame(self._first_id | protocol.READ_GAUGES, b"")
        self.calibration: protocol.Calibration | None = None
        self.firmware: tuple[int, int, int] | None = None
        self._rows = np.zeros((6, 6))
        self._row_due = 0
        self._late_row = 0.0
        self._echoes = 0
        self._reply: dict[tuple[int, int], bytes] = {}
        """Frames of the last complete reading, by opcode and length; empty when it was lost."""
        self._row_reply: dict[tuple[int, int], bytes] = {}
        self._disputed_until = 0.0

    # Connection ------------------------------------------------------------------------------

    def connect(self) -> None:
        self.close()
        self._bus = self.settings.open_bus()
        try:
            self._start_up()
        except can.CanError as error:
            self.close()
            raise DeviceError(
                f"{self._where()}: the bus failed at start-up ({error}); check bit rate and wiring"
            ) from None
        except DeviceError:
            self.close()
            raise
        self._begin()

    def flush(self) -> None:
        if self._bus is not None:
            with contextlib.suppress(can.CanError):
                can_bus.discard_waiting(self._bus)
        self._begin()

    def _begin(self) -> None:
        now = time.monotonic()
        self.due = self.deadline = now
        self.asked = self._in_doubt = False
        self._first: bytes | None = None
        self._second: bytes | None = None
        self._sent = self._arrived = 0
        self._check_due = now + self.settings.calibration_check_period
        self._last_reply = now
        self._reply, self._row_reply, self._disputed_until = {}, {}, 0.0

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def _where(self) -> str:
        return f"NETCANOEM at base 0x{self.settings.base_identifier:02X} on {self.settings.where()}"

    def _start_up(self) -> None:
        """Manual, section 10: calibration, matrix, counts, units; then a reading for the status."""
        assert self._bus is not None
        can_bus.discard_waiting(self._bus)
        self.firmware = protocol.decode_firmware(self._firmware())
        self._set_calibration()
        serial = protocol.decode_serial(self._ask(protocol.READ_SERIAL)[0])
        expected = self.settings.expected_serial
        if expected and serial != expected:
            raise DeviceError(
                f"{self._where()}: transducer '{serial}' is connected, '{expected}' is expected; "
                "connect the right one or change 'expected_serial'"
            )
        rows, again = (np.array([self._read_row(axis) for axis in range(6)]) for _ in range(2))
        if not np.array_equal(rows, again, equal_nan=True):
            raise DeviceError(
                f"{self._where()}: two readings of the matrix differ; check the bus load"
            )
        counts, codes = (protocol.DEFAULT_COUNTS,) * 2, (2, 4)
        if self.firmware[:2] >= (3, 7):
            counts = protocol.decode_counts(self._ask(protocol.READ_COUNTS)[0])
            codes = protocol.decode_units(self._ask(protocol.READ_UNITS)[0])
        calibration = protocol.Calibration(rows, *counts, *codes, serial)
        steps = np.abs(calibration.scaled)
        end = steps.sum(axis=1) * protocol.SATURATED[1]
        self.check_scale(self._where(), steps.max(axis=1), end)
        status, _ = protocol.decode_gauges(*self._ask(protocol.READ_GAUGES))
        if status & protocol.BAD_CALIBRATION:
            raise DeviceError(
                f"{self._where()}: slot {self.settings.calibration_slot} holds no valid "
                "calibration; choose another 'calibration_slot'"
            )
        self._rows = rows
        self.calibration = calibration
        firmware = ".".join(map(str, self.firmware))
        self.health.hardware_id = f"{serial} ({self._where()})"
        slot = str(self.settings.calibration_slot)
        self.health.notes.update(firmware=firmware, calibration_slot=slot)

    def _firmware(self) -> bytes:
        """Firmware frame; counts on the way how often the bus echoes an own frame."""
        first = self._first_id | protocol.READ_FIRMWARE
        for frames in self._attempts(protocol.READ_FIRMWARE):
            echoes = 0
            for frame in frames:
                if frame.arbitration_id != first:
                    continue
                if frame.dlc == 4:
                    self._echoes = echoes
                    return bytes(frame.data)
                echoes += frame.dlc == 0
        raise DeviceError(
            f"{self._where()}: no answer; check power, bit rate, base identifier and termination"
        )

    def _set_calibration(self) -> None:
        """Choose the slot and see it confirmed beyond the bus's own echoes of the request."""
        expected = self._first_id | protocol.SET_CALIBRATION
        slot = self.settings.calibration_slot
        for frames in self._attempts(protocol.SET_CALIBRATION, bytes([slot])):
            seen = 0
            for frame in frames:
                if frame.arbitration_id == expected and bytes(frame.data) == bytes([slot]):
                    seen += 1
                    if seen > self._echoes:
                        return
        raise DeviceError(
            f"{self._where()}: calibration slot {slot} was not confirmed; slots are 0 to 15"
        )

    def _read_row(self, axis: int) -> np.ndarray:
        return protocol.decode_matrix_row(self._ask(protocol.READ_MATRIX, bytes([axis])))  # type: ignore[arg-type]

    # Frames ----------------------------------------------------------------------------------

    def _send(self, opcode: int, data: bytes = b"") -> None:
        assert self._bus is not None
        self._bus.send(can_bus.frame(self._first_id | opcode, data), timeout=self._timeout)

    def _receive(self, end: float) -> can.Message | None:
        """Next frame of this board before `end` (monotonic s), or None; others are counted."""
        assert self._bus is not None
        spare, again = _SPARE, True
        while spare:
            left = end - time.monotonic()
            spare -= left <= 0
            frame = self._bus.recv(max(left, 0.0))
            if frame is None:
                if not again or time.monotonic() - end < _STOOD_STILL:
                    return None
                again, end = False, time.monotonic() + self._timeout
            elif self._is_own(frame):
                return frame
        return None

    def _is_own(self, frame: can.Message) -> bool:
        """Whether it is a frame of this board; others are counted."""
        if frame.is_error_frame:
            self.note("bus_errors", "the bus carries error frames; check wiring and bit rate")
        elif (
            frame.is_extended_id
            or frame.is_remote_frame
            or frame.is_fd
            or frame.arbitration_id & ~0xF != self._first_id
        ):
            self.health.count("foreign")
        else:
            return True
        return False

    def _attempts(self, opcode: int, data: bytes = b"") -> Iterator[Iterator[can.Message]]:
        """Send a request three times; each time the frames that come before its timeout."""
        for _ in range(3):
            self._send(opcode, data)
            end = time.monotonic() + max(self._timeout, 0.1)
            yield iter(partial(self._receive, end), None)

    def _ask(self, opcode: int, data: bytes = b"") -> tuple[bytes, ...]:
        """Reply frames to a request, in order; tried three times, then DeviceError."""
        due = protocol.REPLIES[opcode]
        for attempt, frames in enumerate(self._attempts(opcode, data)):
            got: dict[int, bytes] = {}
            for frame in frames:
                key = (frame.arbitration_id & 0xF, frame.dlc)
                if key in due:
                    got[key[0]] = bytes(frame.data)
                if len(got) == len(due):
                    if attempt:
                        self._await_late(attempt * len(due))
                    return tuple(got[op] for op, _ in due)
            self.health.count("retries")
        raise DeviceError(f"{self._where()}: no answer to request 0x{opcode:X}; check the bus load")

    def _await_late(self, number: int) -> None:
        """Take replies to earlier attempts, so that none is taken for that to the next request."""
        end = time.monotonic() + (number + 1) * max(self._timeout, 0.1)
        while number and self._receive(end) is not None:
            self.health.count("late_replies")
            number -= 1

    # Reading ---------------------------------------------------------------------------------

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Wait for the next poll's time and poll; None when the reply was lost.

        Raises DeviceError after 0.25 s without any reply, when the bus fails and when the board has
        forgotten its calibration.
        """
        if self._bus is None:
            raise DeviceError(f"{self._where()}: not connected")
        try:
            if not self.asked:
                now = time.monotonic()
                if now >= self._check_due:
                    self._check_calibration()
                    now = time.monotonic()
                wait = self.due - now
                if wait > 0:
                    time.sleep(min(wait, timeout))
                    if wait > timeout:
                        return None
                self._request()
            return self._await_reply()
        except can.CanError as error:
            raise self._bus_error(error) from None

    def _bus_error(self, error: can.CanError) -> DeviceError:
        return DeviceError(
            f"{self._where()}: bus error ({error}); check wiring, bit rate, txqueuelen and "
            "restart-ms"
        )

    # Beside others in one thread ---------------------------------------------------------------

    def polled(self) -> Polled | None:
        if self._bus is None or self.needs_own_thread(time.monotonic()):
            return None
        return self if can_bus.can_be_awaited(self._bus) else None

    def fileno(self) -> int:
        assert self._bus is not None
        return self._bus.fileno()

    def needs_own_thread(self, now: float) -> bool:
        if self.asked:
            return self._in_doubt or now > self.deadline
        return now >= self._check_due

    def request(self) -> None:
        try:
            self._request()
        except can.CanError as error:
            raise self._bus_error(error) from None

    def reply(self) -> WrenchSample | None:
        assert self._bus is not None
        try:
            # Bounded: a bus that is flooded must not hold up the others.
            for _ in range(_AT_ONCE):
                frame = self._bus.recv(0)
                if frame is None or (self._is_own(frame) and not self._sort(frame)):
                    return None
                if self._first is not None and self._second is not None:
                    return self._sample()
        except can.CanError as error:
            raise self._bus_error(error) from None
        return None

    # Frames of a reading -----------------------------------------------------------------------

    def _discard_old(self) -> None:
        """Discard what lies in the queue before a request, which is old, and count it.

        A frame that came twice would else be paired with those of the next reading, and so on.
        """
        assert self._bus is not None
        for _ in range(1000):
            frame = self._bus.recv(0)
            if frame is None:
                return
            if self._is_own(frame):
                self.health.count("old_frames")
                self._compare_old(frame)

    def _compare_old(self, frame: can.Message) -> None:
        """Compare a frame that came after a complete reply with that reply."""
        key, now = (frame.arbitration_id & 0xF, frame.dlc), time.monotonic()
        reply = self._reply.get(key) or self._row_reply.get(key)
        if reply == frame.data:
            return
        if reply is not None and now - self._late_row > _QUIET:
            self._conflict()
        elif key[0] in (2, 3, 4):
            self._late_row = now

    def _conflict(self) -> None:
        self.note(
            "conflict",
            "two different replies to one request; does another device use the base identifier?",
        )
        self._disputed_until = time.monotonic() + _DISPUTED

    def _request(self) -> None:
        """Send a request; polls that were missed by far are left out and counted."""
        assert self._bus is not None
        behind = time.monotonic() - self.due
        if behind > _CATCH_UP * self.period:
            skipped = int(behind / self.period)
            self.health.count("overrun", skipped)
            self.due += skipped * self.period
        self.due += self.period
        self._discard_old()
        self._first = self._second = None
        self._in_doubt = False
        self._sent = self.clock.now()
        self._bus.send(self._poll_request, timeout=self._timeout)
        self.deadline = time.monotonic() + self._timeout
        self.asked = True

    def _await_reply(self) -> WrenchSample | None:
        """The reading that was asked for, None when it is lost or in doubt."""
        while not self._in_doubt:
            if self._first is not None and self._second is not None:
                return self._sample()
            frame = self._receive(self.deadline)
            if frame is None:
                self.asked = False
                self._lost(self._first is not None or self._second is not None)
                return None
            self._sort(frame)
        self.asked = False
        self._fence()
        return None

    def _sort(self, frame: can.Message) -> bool:
        """Take in a frame of this board; False when it leaves the reading in doubt."""
        opcode, data = frame.arbitration_id & 0xF, bytes(frame.data)
        if opcode == 0 and frame.dlc == 8 and self._first is None:
            self._first = data
            self._arrived = self.clock.of_stamp(can_bus.stamp_of(frame), earliest=self._sent)
        elif opcode == 1 and frame.dlc == 6 and self._second is None:
            self._second = data
        elif (opcode, frame.dlc) in ((0, 8), (1, 6)):
            if data not in (self._first, self._second):
                # Which of the two replies is the board's cannot be known.
                self._in_doubt = True
                self._reply = {}
                self._conflict()
                return False
            self._malformed(frame)
        elif opcode in (2, 3, 4) and frame.dlc == 8:
            # Of a fence that was given up.
            self.health.count("late_replies")
            self._late_row = time.monotonic()
        elif not (opcode == 0 and frame.dlc == 0):
            self._malformed(frame)
        return True

    def _sample(self) -> WrenchSample | None:
        """The complete reading; None while another board's could be taken for it."""
        assert self._first is not None and self._second is not None
        self.asked = False
        self._last_reply = time.monotonic()
        self._reply = {(0, 8): self._first, (1, 6): self._second}
        if self._arrived - self._sent > self.period * 1e9:
            self.health.count("late")
        self.cleared("lost", "bus_errors", "malformed", "conflict")
        if self._last_reply < self._disputed_until:
            return None
        status, gauges = protocol.decode_gauges(self._first, self._second)
        assert self.calibration is not None
        wrench = self.calibration.wrench(gauges)
        return WrenchSample(
            (self._sent + self._arrived) // 2,
            wrench[:3],
            wrench[3:],
            gauges.astype(float),
            status,
            self._quality(status, gauges),
        )

    def _quality(self, status: int, gauges: np.ndarray) -> int:
        status &= ~protocol.ANY_ERROR
        ends = protocol.saturated(gauges)
        if not status and not ends:
            self.cleared("critical", "status_warning", "saturated")
            return GOOD
        text = f"{protocol.status_text(status)} (status 0x{status:04X})"
        if status & protocol.CRITICAL_MASK:
            self.note("critical", f"sensor fault: {text}", ERROR)
            return CRITICAL
        self.cleared("critical")
        self.note_if(status != 0, "status_warning", f"sensor reports: {text}")
        if not ends:
            self.cleared("saturated")
            return GOOD
        which = ", ".join(map(str, ends))
        self.note("saturated", f"gauge {which} is saturated; check load and cable", ERROR)
        return SATURATED

    def _malformed(self, frame: can.Message) -> None:
        self.note(
            "malformed",
            f"frame 0x{frame.arbitration_id:03X} with {frame.dlc} bytes does not belong to a "
            "reading",
        )

    def _lost(self, half: bool) -> None:
        """Account for a poll without a complete reply and discard what is still to come of it."""
        if half:
            self.health.count("half_replies")
        self._reply = {}
        self.note("lost", f"no complete reply within {self._timeout * 1e3:.0f} ms")
        silent = time.monotonic() - self._last_reply
        if not self._fence() and silent > _SILENCE:
            raise DeviceError(
                f"{self._where()}: no reply for {silent:.2f} s; check power and cable"
            )
        return None

    def _fence(self) -> bool:
        """Read a matrix row; every frame before its reply is old. True when it was answered."""
        self._send(protocol.READ_MATRIX, bytes([self._row_due]))
        end = time.monotonic() + self._timeout
        rows: dict[int, bytes] = {}
        late = 0
        while len(rows) < 3:
            frame = self._receive(end)
            if frame is None:
                self._late_row = time.monotonic()
                return False
            opcode = frame.arbitration_id & 0xF
            if opcode in (2, 3, 4) and frame.dlc == 8:
                rows[opcode] = bytes(frame.data)
            elif (opcode, frame.dlc) in ((0, 8), (1, 6)):
                late += 1
                self._compare_old(frame)
        if late:
            self.health.count("late_replies", late)
        self._last_reply = time.monotonic()
        self._row_reply = {(opcode, 8): data for opcode, data in rows.items()}
        self._compare_row((rows[2], rows[3], rows[4]))
        return True

    def _check_calibration(self) -> None:
        self._check_due = time.monotonic() + self.settings.calibration_check_period
        if self._fence() and time.monotonic() - self._late_row > _QUIET:
            self._row_due = (self._row_due + 1) % 6

    def _compare_row(self, frames: tuple[bytes, bytes, bytes]) -> None:
        row = protocol.decode_matrix_row(frames)
        if not np.array_equal(row, self._rows[self._row_due], equal_nan=True):
            self.health.count("calibration_lost")
            raise DeviceError(
                f"{self._where()}: the board no longer uses calibration slot "
                f"{self.settings.calibration_slot}; it was reset or replaced, starting it up again"
            )

    def wrench_of(self, channels: np.ndarray) -> np.ndarray:
        if self.calibration is None:
            raise DeviceError(f"{self._where()}: not connected")
        return self.calibration.wrench(channels)

    @property
    def scale_id(self) -> object:
        calibration = self.calibration
        return None if calibration is None else (calibration.serial, calibration.scaled.tobytes())
