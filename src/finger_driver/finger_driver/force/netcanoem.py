"""ATI NETCANOEM on any python-can bus: start-up, polling at a fixed rate, everything that can go wrong.

The board is polled: one request, two reply frames. Frames of other devices may lie between them, the bus may echo
the driver's own frames, replies may be lost or late. Rules used here:

- The receive queue is emptied before each request, so that a frame that came twice is never taken for a later one.
- Replies are matched on identifier and length; an own echo differs in length, except for "set calibration", for
  which the echoes of the bus are counted first.
- After a poll without a complete reply a *fence* is sent, a request with a reply of its own. The board answers in
  order, so whatever arrives before the fence's reply belongs to the past and is thrown away. No reply is ever paired
  with a later request.
- The active calibration is lost when the board resets. One row of the matrix is read again every
  `calibration_check_period` seconds and after every silence; a change leads to a new start-up.
- The stamp is the middle between sending the request and the arrival of the first reply, so it is off by at most
  half a round trip.
"""

from __future__ import annotations

import contextlib
import time

import can
import numpy as np

from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import DeviceError

from .. import can_bus
from ..clock import HostClock
from ..protocols import netcanoem as protocol
from .source import CRITICAL, GOOD, SATURATED, ForceSource, WrenchSample

_CATCH_UP = 5
"""Missed polls that are made up for by polling without pause; more are skipped and counted."""
_SILENCE = 0.25
"""Seconds without a reply after which the connection counts as lost."""


class NetcanoemSource(ForceSource):
    """Driver of one NETCANOEM board.

    bus_arguments: of `can_bus.open_bus`. slot: calibration 0…15. rate: polls per second. response_timeout: s per
    request. expected_serial: refuses another transducer when not empty.
    """

    def __init__(
        self,
        bus_arguments: dict[str, object],
        base: int = protocol.DEFAULT_BASE,
        slot: int = 0,
        rate: float = 500.0,
        response_timeout: float = 0.05,
        calibration_check_period: float = 1.0,
        expected_serial: str = "",
        clock: HostClock | None = None,
        health: Health | None = None,
    ) -> None:
        super().__init__(health or Health("force", expected_rate=rate, stale_after=0.5))
        self._bus_arguments = bus_arguments
        self._base = base
        self._slot = slot
        self._period = 1.0 / rate
        self._timeout = response_timeout
        self._check_period = calibration_check_period
        self._expected_serial = expected_serial
        self._clock = clock or HostClock()
        self._bus: can.BusABC | None = None
        self._first_id = protocol.identifier(base, 0)
        self.calibration: protocol.Calibration | None = None
        self.firmware: tuple[int, int, int] | None = None
        self._rows = np.zeros((6, 6))
        self._row_due = 0
        self._echoes = 0

    # Connection ------------------------------------------------------------------------------

    def connect(self) -> None:
        self.close()
        self._bus = can_bus.open_bus(**self._bus_arguments)  # type: ignore[arg-type]
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
                self._drain()
        self._begin()

    def _begin(self) -> None:
        now = time.monotonic()
        self._next_poll = now
        self._check_due = now + self._check_period
        self._last_reply = now

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def _where(self) -> str:
        arguments = self._bus_arguments
        interface = str(arguments.get("interface", "socketcan"))
        channel = arguments.get("channel") or can_bus.DEFAULT_CHANNEL.get(interface, "")
        return f"NETCANOEM at base 0x{self._base:02X} on {interface} {channel}".rstrip()

    def _start_up(self) -> None:
        """Manual, section 10: calibration, matrix, counts, units; then one reading to see the status."""
        self._drain()
        self.firmware = protocol.decode_firmware(self._firmware())
        self._set_calibration()
        serial = protocol.decode_serial(self._ask(protocol.READ_SERIAL)[0])
        if self._expected_serial and serial != self._expected_serial:
            raise DeviceError(
                f"{self._where()}: transducer '{serial}' is connected, '{self._expected_serial}' is "
                "expected; connect the right one or change 'expected_serial'"
            )
        rows = np.array([self._read_row(axis) for axis in range(6)])
        counts, codes = (protocol.DEFAULT_COUNTS,) * 2, (2, 4)
        if self.firmware[:2] >= (3, 7):
            counts = protocol.decode_counts(self._ask(protocol.READ_COUNTS)[0])
            codes = protocol.decode_units(self._ask(protocol.READ_UNITS)[0])
        calibration = protocol.Calibration(rows, *counts, *codes, serial)
        status, _ = protocol.decode_gauges(*self._ask(protocol.READ_GAUGES))
        if status & protocol.BAD_CALIBRATION:
            raise DeviceError(
                f"{self._where()}: slot {self._slot} holds no valid calibration; choose another "
                "'calibration_slot'"
            )
        self._rows = rows
        self.calibration = calibration
        firmware = ".".join(map(str, self.firmware))
        self.health.hardware_id = f"{serial} ({self._where()})"
        self.health.notes.update(firmware=firmware, calibration_slot=str(self._slot))

    def _firmware(self) -> bytes:
        """Firmware frame; counts on the way how often the bus echoes an own frame."""
        first = self._first_id | protocol.READ_FIRMWARE
        for _ in range(3):
            self._send(protocol.READ_FIRMWARE)
            echoes = 0
            end = time.monotonic() + max(self._timeout, 0.1)
            while (frame := self._receive(end)) is not None:
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
        for _ in range(3):
            self._send(protocol.SET_CALIBRATION, bytes([self._slot]))
            seen = 0
            end = time.monotonic() + max(self._timeout, 0.1)
            while (frame := self._receive(end)) is not None:
                if frame.arbitration_id == expected and bytes(frame.data) == bytes([self._slot]):
                    seen += 1
                    if seen > self._echoes:
                        return
        raise DeviceError(
            f"{self._where()}: calibration slot {self._slot} was not confirmed; slots are 0 to 15"
        )

    def _read_row(self, axis: int) -> np.ndarray:
        return protocol.decode_matrix_row(self._ask(protocol.READ_MATRIX, bytes([axis])))  # type: ignore[arg-type]

    # Frames ----------------------------------------------------------------------------------

    def _send(self, opcode: int, data: bytes = b"") -> None:
        assert self._bus is not None
        message = can.Message(
            arbitration_id=self._first_id | opcode, data=data, is_extended_id=False
        )
        self._bus.send(message, timeout=self._timeout)

    def _receive(self, end: float) -> can.Message | None:
        """Next frame of this board before `end` (monotonic s), or None; others are counted."""
        assert self._bus is not None
        while (left := end - time.monotonic()) > 0:
            frame = self._bus.recv(left)
            if frame is None:
                return None
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
                return frame
        return None

    def _drain(self) -> int:
        """Throw away what waits in the receive queue; the number of frames."""
        assert self._bus is not None
        drained = 0
        # Bounded: a bus that is flooded must not hold the driver here for ever.
        while drained < 10_000 and self._bus.recv(0) is not None:
            drained += 1
        return drained

    def _ask(self, opcode: int, data: bytes = b"") -> tuple[bytes, ...]:
        """Reply frames to a request, in order; tried three times, then DeviceError."""
        due = protocol.REPLIES[opcode]
        for _ in range(3):
            self._send(opcode, data)
            got: dict[int, bytes] = {}
            end = time.monotonic() + max(self._timeout, 0.1)
            while len(got) < len(due) and (frame := self._receive(end)) is not None:
                key = (frame.arbitration_id & 0xF, frame.dlc)
                if key in due:
                    got[key[0]] = bytes(frame.data)
            if len(got) == len(due):
                return tuple(got[op] for op, _ in due)
            self.health.count("retries")
        raise DeviceError(f"{self._where()}: no answer to request 0x{opcode:X}; check the bus load")

    # Reading ---------------------------------------------------------------------------------

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Wait for the next poll's time and poll; None when the reply was lost.

        Raises DeviceError after 0.25 s without any reply, when the bus fails and when the board has
        forgotten its calibration.
        """
        if self._bus is None:
            raise DeviceError(f"{self._where()}: not connected")
        try:
            now = time.monotonic()
            if now >= self._check_due:
                self._check_calibration()
                now = time.monotonic()
            wait = self._next_poll - now
            if wait > timeout:
                time.sleep(timeout)
                return None
            if wait > 0:
                time.sleep(wait)
            elif -wait > _CATCH_UP * self._period:
                skipped = int(-wait / self._period)
                self.health.count("overrun", skipped)
                self._next_poll += skipped * self._period
            self._next_poll += self._period
            return self._poll()
        except can.CanError as error:
            raise DeviceError(
                f"{self._where()}: bus error ({error}); check wiring, bit rate, txqueuelen and "
                "restart-ms"
            ) from None

    def _discard_old(self) -> None:
        """Throw away what lies in the queue before a request: it can only be of the past.

        Without this a frame that came twice would be paired with those of the next reading, and so on for ever.
        """
        assert self._bus is not None
        for _ in range(1000):
            frame = self._bus.recv(0)
            if frame is None:
                return
            foreign = frame.arbitration_id & ~0xF != self._first_id or frame.is_extended_id
            self.health.count("foreign" if foreign else "old_frames")

    def _poll(self) -> WrenchSample | None:
        self._discard_old()
        sent = self._clock.now()
        self._send(protocol.READ_GAUGES)
        end = time.monotonic() + self._timeout
        first = second = None
        arrived = 0
        while first is None or second is None:
            frame = self._receive(end)
            if frame is None:
                self._lost(first is not None or second is not None)
                return None
            opcode = frame.arbitration_id & 0xF
            if opcode == 0 and frame.dlc == 8 and first is None:
                first = bytes(frame.data)
                arrived = self._arrival(frame, sent)
            elif opcode == 1 and frame.dlc == 6 and second is None:
                second = bytes(frame.data)
            elif opcode in (2, 3, 4) and frame.dlc == 8:
                # Of a fence that was given up.
                self.health.count("late_replies")
            elif not (opcode == 0 and frame.dlc == 0):
                self._malformed(frame)
        self._last_reply = time.monotonic()
        if arrived - sent > self._period * 1e9:
            self.health.count("late")
        for key in ("lost", "bus_errors", "malformed"):
            self.cleared(key)
        status, gauges = protocol.decode_gauges(first, second)
        assert self.calibration is not None
        wrench = self.calibration.wrench(gauges)
        return WrenchSample(
            (sent + arrived) // 2,
            wrench[:3],
            wrench[3:],
            gauges.astype(float),
            status,
            self._quality(status, gauges),
        )

    def _arrival(self, frame: can.Message, sent: int) -> int:
        """Host time of a frame: the interface's stamp where it can be believed, else now."""
        now = self._clock.now()
        stamped = self._clock.from_wall(round(frame.timestamp * 1e9)) if frame.timestamp else now
        # Some adapters count from their own start; a stamp outside the round trip is not host time.
        return stamped if sent <= stamped <= now else now

    def _quality(self, status: int, gauges: np.ndarray) -> int:
        if status & protocol.CRITICAL_MASK:
            text = protocol.status_text(status)
            self.note("critical", f"sensor fault: {text} (status 0x{status:04X})", ERROR)
            return CRITICAL
        self.cleared("critical")
        if status & ~0x8000:
            self.note("status_warning", f"sensor says: {protocol.status_text(status)}", WARN)
        else:
            self.cleared("status_warning")
        ends = protocol.saturated(gauges)
        if ends.size:
            which = ", ".join(map(str, ends))
            self.note("saturated", f"gauge {which} is saturated; check load and cable", ERROR)
            return SATURATED
        self.cleared("saturated")
        return GOOD

    def _malformed(self, frame: can.Message) -> None:
        self.note(
            "malformed",
            f"frame 0x{frame.arbitration_id:03X} with {frame.dlc} bytes does not belong to a reading",
        )

    def _lost(self, half: bool) -> None:
        """Account for a poll without a complete reply and throw away what is still to come of it."""
        if half:
            self.health.count("half_replies")
        self.note("lost", f"no complete reply within {self._timeout * 1e3:.0f} ms")
        silent = time.monotonic() - self._last_reply
        if not self._fence() and silent > _SILENCE:
            raise DeviceError(
                f"{self._where()}: no reply for {silent:.2f} s; check power and cable"
            )
        return None

    def _fence(self) -> bool:
        """Read a matrix row; every frame before its reply is of the past. True when it was answered."""
        self._send(protocol.READ_MATRIX, bytes([self._row_due]))
        end = time.monotonic() + self._timeout
        rows: dict[int, bytes] = {}
        late = 0
        while len(rows) < 3:
            frame = self._receive(end)
            if frame is None:
                return False
            opcode = frame.arbitration_id & 0xF
            if opcode in (2, 3, 4) and frame.dlc == 8:
                rows[opcode] = bytes(frame.data)
            elif (opcode, frame.dlc) in ((0, 8), (1, 6)):
                late += 1
        if late:
            self.health.count("late_replies", late)
        self._last_reply = time.monotonic()
        self._compare_row((rows[2], rows[3], rows[4]))
        return True

    def _check_calibration(self) -> None:
        self._check_due = time.monotonic() + self._check_period
        if self._fence():
            self._row_due = (self._row_due + 1) % 6

    def _compare_row(self, frames: tuple[bytes, bytes, bytes]) -> None:
        row = protocol.decode_matrix_row(frames)
        if not np.array_equal(row, self._rows[self._row_due], equal_nan=True):
            self.health.count("calibration_lost")
            raise DeviceError(
                f"{self._where()}: the board no longer uses calibration slot {self._slot}; it was "
                "reset or replaced, starting it up again"
            )

    def wrench_of(self, channels: np.ndarray) -> np.ndarray:
        if self.calibration is None:
            raise DeviceError(f"{self._where()}: not connected")
        return self.calibration.wrench(channels)

    @property
    def scale_id(self) -> object:
        calibration = self.calibration
        return None if calibration is None else (calibration.serial, calibration.scaled.tobytes())
