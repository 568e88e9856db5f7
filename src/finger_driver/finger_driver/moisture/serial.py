"""Moisture readings from a serial port, one per line."""

from __future__ import annotations

import contextlib
import time
from collections import deque

import serial

from finger_common.diagnostics import Health
from finger_common.errors import DeviceError

from ..clock import HostClock
from ..protocols import lines
from .source import PHASES, MoistureSource, Reading, range_flag

_LINE_TIME = 0.5
"""Seconds after which an unfinished line is given up: its rest, if it came, would be read as a number of its own."""


class SerialSource(MoistureSource):
    """Reads lines that match a pattern with a group `value` and perhaps a group `phase` ("before", "after")."""

    def __init__(
        self,
        port: str,
        baud_rate: int,
        pattern: str,
        health: Health,
        clock: HostClock | None = None,
    ) -> None:
        super().__init__(health)
        self._port_name = port
        self._baud_rate = baud_rate
        self._pattern = lines.compile_pattern(pattern)
        self._clock = clock or HostClock()
        self._port: serial.Serial | None = None
        self._splitter = lines.LineSplitter()
        self._ready: deque[tuple[int, str]] = deque()
        self._index = 0

    def connect(self) -> None:
        self.close()
        try:
            self._port = serial.Serial(
                self._port_name, self._baud_rate, timeout=0.1, exclusive=True
            )
            # What waited in the port was measured before somebody listened.
            self._port.reset_input_buffer()
        except (OSError, ValueError, serial.SerialException) as error:
            raise DeviceError(
                f"serial port '{self._port_name}' does not open ({error}); check cable, name and the "
                "group 'dialout'"
            ) from None
        self._splitter.reset()
        self._ready.clear()
        self._last_byte = time.monotonic()
        self.health.hardware_id = self._port_name

    def flush(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.reset_input_buffer()
        self._splitter.reset()
        self._ready.clear()

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()

    def read(self, timeout: float = 1.0) -> Reading | None:
        end = time.monotonic() + timeout
        while True:
            while self._ready:
                stamp, line = self._ready.popleft()
                reading = self._reading(stamp, line)
                if reading is not None:
                    return reading
            left = end - time.monotonic()
            if left <= 0:
                return None
            self._receive(left)

    def _receive(self, timeout: float) -> None:
        if self._port is None:
            raise DeviceError(f"serial port '{self._port_name}': not connected")
        try:
            self._port.timeout = min(timeout, 0.1)
            data = self._port.read(max(1, min(self._port.in_waiting, 4096)))
        except (OSError, TypeError, serial.SerialException) as error:
            raise DeviceError(f"serial port '{self._port_name}' was lost ({error})") from None
        now = time.monotonic()
        if not data:
            if self._splitter.unfinished and now - self._last_byte > _LINE_TIME:
                self._splitter.reset()
                self.note("malformed", "a line broke off in the middle; it is left out")
            return
        if self._splitter.unfinished and now - self._last_byte > _LINE_TIME:
            self._splitter.reset()
            self.note("malformed", "a line broke off in the middle; it is left out")
        self._last_byte = now
        stamp = self._clock.now()
        dropped = self._splitter.dropped
        self._ready.extend((stamp, line) for line in self._splitter.feed(data))
        for _ in range(self._splitter.dropped - dropped):
            self.note("malformed", "a line is too long or not ASCII text; check the baud rate")

    def _reading(self, stamp: int, line: str) -> Reading | None:
        parsed = lines.parse_line(line, self._pattern)
        if parsed is None:
            self.note(
                "malformed", f"line {line[:40]!r} does not match serial_pattern; it is left out"
            )
            return None
        self.cleared("malformed")
        reading = Reading(
            stamp,
            parsed.value,
            self._index,
            PHASES.get(parsed.phase, 0),
            range_flag(parsed.value),
            "serial",
        )
        self._index += 1
        return reading
