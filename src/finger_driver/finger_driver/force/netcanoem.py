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
from dataclasses import dataclass

import can
import numpy as np

from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.settings import setting

from .. import can_bus
from ..protocols import netcanoem as protocol
from ..protocols import units
from ..protocols.netcanoem import READING, ROW
from ..shared_polling import Polled
from .netcanoem_dialog import Dialog, key_of
from .source import CRITICAL, GOOD, SATURATED, ForceSettings, ForceSource, WrenchSample

_UNKNOWN = "unknown"
"""Choice of a unit that nobody has set."""
_AT_ONCE = 100
"""Frames taken at once, before other devices have their turn."""
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
    assumed_force_unit: str = setting(
        _UNKNOWN,
        "NETCANOEM: unit of force of the calibration, for firmware before 3.7, which does not tell "
        "it; unknown takes N and warns.",
        choices=(_UNKNOWN, *units.FORCE_CODES.values()),
        advice="The calibration sheet gives it.",
    )
    assumed_torque_unit: str = setting(
        _UNKNOWN,
        "NETCANOEM: unit of torque, alike; unknown takes N-mm and warns.",
        choices=(_UNKNOWN, *units.TORQUE_CODES.values()),
        advice="The calibration sheet gives it.",
    )
    calibration_check_period: float = setting(
        1.0,
        "NETCANOEM: how often one row of the matrix is read again, to notice a board that was "
        "reset.",
        unit="s",
        minimum=0.05,
        maximum=3600.0,
    )

    def address(self) -> str:
        return f"{self.bus()}, base_identifier {self.base_identifier}"


class NetcanoemSource(ForceSource):
    """ATI NETCANOEM on a CAN bus."""

    SETTINGS = NetcanoemSettings
    SIMULATOR = "finger_driver.simulators.netcanoem:NetcanoemSimulator"

    settings: NetcanoemSettings

    def __init__(self, settings: NetcanoemSettings) -> None:
        super().__init__(settings)
        self.period = 1.0 / settings.rate
        self._timeout = settings.response_timeout
        self._dialog: Dialog | None = None
        self._poll_request = can_bus.frame(
            protocol.identifier(settings.base_identifier, protocol.READ_GAUGES), b""
        )
        self.calibration: protocol.Calibration | None = None
        self._row_due = 0
        self._late_row = 0.0

    # Connection ------------------------------------------------------------------------------

    def connect(self) -> None:
        self.close()
        settings = self.settings
        self._dialog = Dialog(
            settings.open_bus(), settings.base_identifier, self._timeout, self, self._where()
        )
        try:
            self._start_up(self._dialog)
        except can_bus.BUS_ERRORS as error:
            raise DeviceError(
                f"{self._where()}: the bus failed at start-up ({error}); check bit rate and wiring"
            ) from None
        self._begin()

    def _start_up(self, dialog: Dialog) -> None:
        slot, unit_codes = self.settings.calibration_slot, self._assumed_units()
        firmware, calibration = dialog.start_up(slot, self.settings.expected_serial, unit_codes)
        self._tell_assumed(firmware)
        steps = np.abs(calibration.scaled)
        end = steps.sum(axis=1) * protocol.GAUGE_ENDS[1]
        self.check_scale(self._where(), steps.max(axis=1), end)
        status, _ = protocol.decode_gauges(*dialog.ask(protocol.READ_GAUGES))
        if status & protocol.BAD_CALIBRATION:
            raise DeviceError(
                f"{self._where()}: slot {slot} holds no valid calibration; choose another "
                "'calibration_slot'"
            )
        self.calibration = calibration
        self.health.hardware_id = f"{calibration.serial} ({self._where()})"
        self.health.notes.update(firmware=".".join(map(str, firmware)), calibration_slot=str(slot))

    def _assumed_units(self) -> tuple[int, int]:
        """Codes of the units of a calibration whose units the board does not tell."""
        settings, (force, torque) = self.settings, protocol.DEFAULT_UNITS
        return (
            units.code_of(settings.assumed_force_unit, units.FORCE_CODES, force),
            units.code_of(settings.assumed_torque_unit, units.TORQUE_CODES, torque),
        )

    def _tell_assumed(self, firmware: tuple[int, int, int]) -> None:
        """Warn while units are assumed that nobody has confirmed: they may be wrong by far."""
        settings, (force, torque) = self.settings, self._assumed_units()
        unknown = _UNKNOWN in (settings.assumed_force_unit, settings.assumed_torque_unit)
        self.note_if(
            firmware[:2] < protocol.UNITS_SINCE and unknown,
            "units_assumed",
            f"firmware {firmware[0]}.{firmware[1]} does not tell the calibration's units: "
            f"{units.FORCE_CODES[force]} and {units.TORQUE_CODES[torque]} are assumed; set "
            "'assumed_force_unit' and 'assumed_torque_unit' from the calibration sheet",
        )

    def flush(self) -> None:
        if self._dialog is not None:
            with contextlib.suppress(*can_bus.BUS_ERRORS):
                can_bus.discard_waiting(self._dialog.bus)
        self._begin()

    def _begin(self) -> None:
        now = time.monotonic()
        self.due = self.deadline = now
        self.asked = self._in_doubt = False
        self._got: dict[protocol.Key, bytes] = {}
        """Frames of the newest reading, complete when there are two; none when it was lost."""
        self._row_got: dict[protocol.Key, bytes] = {}
        """Those of the newest row of the matrix."""
        self._sent = self._arrived = 0
        self._check_due = now + self.settings.calibration_check_period
        self._last_reply = now
        self._disputed_until = 0.0

    def close(self) -> None:
        dialog, self._dialog = self._dialog, None
        if dialog is not None:
            # An adapter that was unplugged cannot be told.
            with contextlib.suppress(*can_bus.BUS_ERRORS):
                dialog.bus.shutdown()

    def _where(self) -> str:
        return f"NETCANOEM at base 0x{self.settings.base_identifier:02X} on {self.settings.where()}"

    # Reading ---------------------------------------------------------------------------------

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Wait for the next poll's time and poll; None when the reply was lost.

        Raises DeviceError after `longest_silence` without any reply, when the bus fails and when
        the board has forgotten its calibration.
        """
        if self._dialog is None:
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
        except can_bus.BUS_ERRORS as error:
            raise self._bus_error(error) from None

    def _bus_error(self, error: Exception) -> DeviceError:
        return DeviceError(
            f"{self._where()}: bus error ({error}); check wiring, bit rate, txqueuelen and "
            "restart-ms"
        )

    # Beside others in one thread ---------------------------------------------------------------

    def polled(self) -> Polled | None:
        if self._dialog is None or self.needs_own_thread(time.monotonic()):
            return None
        return self if can_bus.can_be_awaited(self._dialog.bus) else None

    def fileno(self) -> int:
        assert self._dialog is not None
        return self._dialog.bus.fileno()

    def needs_own_thread(self, now: float) -> bool:
        if self.asked:
            return self._in_doubt or now > self.deadline
        return now >= self._check_due

    def request(self) -> None:
        try:
            self._request()
        except can_bus.BUS_ERRORS as error:
            raise self._bus_error(error) from None

    def reply(self) -> WrenchSample | None:
        dialog = self._dialog
        assert dialog is not None
        try:
            # Bounded: a bus that is flooded must not hold up the others.
            for _ in range(_AT_ONCE):
                frame = dialog.bus.recv(0)
                if frame is None or (dialog.is_own(frame) and not self._sort(frame)):
                    return None
                if len(self._got) == len(READING):
                    return self._sample()
        except can_bus.BUS_ERRORS as error:
            raise self._bus_error(error) from None
        return None

    # Frames of a reading -----------------------------------------------------------------------

    def _discard_old(self) -> None:
        """Discard what lies in the queue before a request, which is old, and count it.

        A frame that came twice would else be paired with those of the next reading, and so on.
        """
        dialog = self._dialog
        assert dialog is not None
        for _ in range(1000):
            frame = dialog.bus.recv(0)
            if frame is None:
                return
            if dialog.is_own(frame):
                self.health.count("old_frames")
                self._compare_old(frame)

    def _compare_old(self, frame: can.Message) -> None:
        """Compare a frame that came after a complete reply with that reply."""
        key, now = key_of(frame), time.monotonic()
        reply = self._got.get(key) or self._row_got.get(key)
        if reply == frame.data:
            return
        if reply is not None and now - self._late_row > _QUIET:
            self._conflict()
        elif key in ROW:
            self._late_row = now

    def _conflict(self) -> None:
        self.note(
            "conflict",
            "two different replies to one request; does another device use the base identifier, or "
            "does another program ask this board?",
        )
        self._disputed_until = time.monotonic() + _DISPUTED

    def _request(self) -> None:
        """Send a request."""
        assert self._dialog is not None
        self.due = self.poll_after(self.due)
        self._discard_old()
        self._got = {}
        self._in_doubt = False
        self._sent = self.clock.now()
        self._dialog.bus.send(self._poll_request, timeout=self._timeout)
        self.deadline = time.monotonic() + self._timeout
        self.asked = True

    def _await_reply(self) -> WrenchSample | None:
        """The reading that was asked for, None when it is lost or in doubt."""
        assert self._dialog is not None
        while not self._in_doubt:
            if len(self._got) == len(READING):
                return self._sample()
            frame = self._dialog.receive(self.deadline)
            if frame is None:
                self.asked = False
                self._lost()
                return None
            self._sort(frame)
        self.asked = False
        self._fence()
        return None

    def _sort(self, frame: can.Message) -> bool:
        """Take in a frame of this board; False when it leaves the reading in doubt."""
        key, data = key_of(frame), bytes(frame.data)
        if key in READING:
            if key not in self._got:
                self._got[key] = data
                if key == READING[0]:
                    stamp = can_bus.stamp_of(frame)
                    self._arrived = self.clock.of_stamp(stamp, earliest=self._sent)
            elif data in self._got.values():
                self._malformed(frame)
            else:
                # Which of the two replies is the board's cannot be known.
                self._in_doubt = True
                self._got = {}
                self._conflict()
                return False
        elif key in ROW:
            # Of a fence that was given up.
            self.health.count("late_replies")
            self._late_row = time.monotonic()
        elif key != (protocol.READ_GAUGES, 0):  # an echo of the request
            self._malformed(frame)
        return True

    def _sample(self) -> WrenchSample | None:
        """The complete reading; None while another board's could be taken for it."""
        assert self.calibration is not None
        self.asked = False
        self._last_reply = time.monotonic()
        if self._arrived - self._sent > self.period * 1e9:
            self.health.count("late")
        self.cleared("lost", "bus_errors", "malformed", "conflict")
        if self._last_reply < self._disputed_until:
            return None
        status, gauges = protocol.decode_gauges(*(self._got[key] for key in READING))
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
        if status != protocol.ANY_ERROR:
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

    def _lost(self) -> None:
        """Account for a poll without a complete reply and discard what is still to come of it."""
        if self._got:
            self.health.count("half_replies")
        self._got = {}
        self.note("lost", f"no complete reply within {self._timeout * 1e3:.0f} ms")
        silent = time.monotonic() - self._last_reply
        if not self._fence() and silent > self.longest_silence:
            raise DeviceError(
                f"{self._where()}: no reply for {silent:.2f} s; check power and cable"
            )

    def _fence(self) -> bool:
        """Read a matrix row; every frame before its reply is old. True when it was answered."""
        dialog = self._dialog
        assert dialog is not None
        dialog.send(protocol.READ_MATRIX, bytes([self._row_due]))
        end = time.monotonic() + self._timeout
        got: dict[protocol.Key, bytes] = {}
        late = 0
        while len(got) < len(ROW):
            frame = dialog.receive(end)
            if frame is None:
                self._late_row = time.monotonic()
                return False
            key = key_of(frame)
            if key in ROW:
                got[key] = bytes(frame.data)
            elif key in READING:
                late += 1
                self._compare_old(frame)
        if late:
            self.health.count("late_replies", late)
        self._last_reply = time.monotonic()
        self._row_got = got
        self._compare_row(protocol.decode_matrix_row([got[key] for key in ROW]))
        return True

    def _check_calibration(self) -> None:
        self._check_due = time.monotonic() + self.settings.calibration_check_period
        if self._fence() and time.monotonic() - self._late_row > _QUIET:
            self._row_due = (self._row_due + 1) % 6

    def _compare_row(self, row: np.ndarray) -> None:
        assert self.calibration is not None
        if not np.array_equal(row, self.calibration.matrix[self._row_due], equal_nan=True):
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

    @property
    def serial(self) -> str:
        return "" if self.calibration is None else self.calibration.serial
