# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Moisture readings from a serial port, one per line."""

from __future__ import annotations

import contextlib
import termios
import time
from collections import deque
from dataclasses import dataclass

import serial

from finger_common.errors import DeviceError
from finger_common.settings import setting

from ..protocols import lines
from .source import PHASE_UNKNOWN, PHASES, MoistureSettings, MoistureSource, Reading

_LINE_TIME = 0.5
"""Seconds of silence after which an unfinished line is given up."""
_LONGEST_LINE = 5.0
"""Seconds for which bytes may come without an end of line."""
_SILENCE = 0.05
"""Seconds of silence before a line; what comes sooner after connecting may be the rest of one, and
after a line of garbage it may be garbage, too."""
_DOUBTED = 3
"""Bare numbers that may be garbage, after a line of garbage and without a silence between; garbage
makes hardly so many one after the other."""
_LOOK = 0.02
"""Seconds between looks for bytes, within which silence is noticed."""


@dataclass(frozen=True)
class SerialSettings(MoistureSettings):
    """Settings of a serial adapter."""

    serial_baud_rate: int = setting(
        9600, "serial: baud rate of the port.", unit="Bd", minimum=50, maximum=4_000_000
    )
    serial_pattern: str = setting(
        lines.DEFAULT_PATTERN,
        "serial: regular expression that a whole line must match, with a group value and perhaps a "
        "group phase.",
    )

    def validate(self) -> None:
        self.need_path("the serial port")
        lines.compile_pattern(self.serial_pattern)


class SerialSource(MoistureSource):
    """Lines of a serial adapter.

    Each must match a pattern with a group `value` and perhaps a group `phase` (before, after). What
    may be the rest of a line, after connecting or a break, is a reading only where something stands
    before its value: "2.0" may be the end of "42.0", "M=2.0" is not. So it is with numbers that
    follow at once a line that is mostly no text, as a wrong baud rate or a loose contact makes it.
    """

    NAME = "serial"
    SETTINGS = SerialSettings
    SIMULATOR = "finger_driver.simulators.serial_moisture:SerialMoistureSimulator"

    settings: SerialSettings

    def __init__(self, settings: SerialSettings) -> None:
        super().__init__(settings)
        self._pattern = lines.compile_pattern(settings.serial_pattern)
        self._port: serial.Serial | None = None
        self._splitter = lines.LineSplitter()
        self._ready: deque[tuple[int, lines.Line]] = deque()
        """Lines with their times of arrival (ns)."""
        self._doubted = 0
        """Number of bare numbers to come that may be garbage."""
        self._last_byte = self._line_began = 0.0

    def connect(self) -> None:
        self.close()
        name = self.settings.path
        try:
            self._port = serial.Serial(
                name, self.settings.serial_baud_rate, timeout=0.1, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise DeviceError(
                f"serial port '{name}' does not open ({error}); check cable, name and the group "
                "'dialout'"
            ) from None
        self._discard()
        self.health.hardware_id = name

    def flush(self) -> None:
        self._ready.clear()
        if self._port is not None and (self._waiting() or self._splitter.unfinished):
            self._discard()

    def _discard(self) -> None:
        """Discard what waits: it was measured before anybody listened, perhaps a part of a line."""
        assert self._port is not None
        try:
            self._port.reset_input_buffer()
        except (OSError, termios.error) as error:
            raise self._lost(error) from None
        self._splitter.reset(within=True)
        self._ready.clear()
        self._heard = False
        self._last_byte = time.monotonic()

    def _waiting(self) -> int:
        """Number of bytes that wait in the port."""
        assert self._port is not None
        try:
            return int(self._port.in_waiting)
        except (OSError, TypeError) as error:
            raise self._lost(error) from None

    def _lost(self, error: Exception) -> DeviceError:
        # pyserial's own errors are OSErrors; a port closed meanwhile gives a TypeError.
        return DeviceError(
            f"serial port '{self.settings.path}' was lost ({error}); check the cable"
        )

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()

    def read(self, timeout: float = 1.0) -> Reading | None:
        end = time.monotonic() + timeout
        while True:
            while self._ready:
                reading = self._parse(*self._ready.popleft())
                if reading is not None:
                    return reading
            left = end - time.monotonic()
            if left <= 0:
                return None
            self._receive(left)

    def _receive(self, timeout: float) -> None:
        if self._port is None:
            raise DeviceError(f"serial port '{self.settings.path}': not connected")
        splitter = self._splitter
        # Nothing waits that came before: not the time in which this process may have stood still.
        silent = time.monotonic() - self._last_byte
        waiting = self._waiting()
        if not waiting and splitter.unfinished and silent > _LINE_TIME:
            splitter.reset(within=True)
            self.note("malformed", "a line broke off in the middle; it is left out")
        elif not waiting and not splitter.unfinished and silent > _SILENCE:
            self._doubted = 0
            if not self._heard:
                splitter.reset()
        try:
            self._port.timeout = min(timeout, _LOOK)
            data = self._port.read(max(1, min(waiting, 4096)))
        except (OSError, TypeError) as error:
            raise self._lost(error) from None
        if not data:
            return
        now = self._last_byte = time.monotonic()
        stamp = self.clock.now()
        self._heard = True
        if not splitter.unfinished or b"\r" in data or b"\n" in data:
            self._line_began = now
        elif now - self._line_began > _LONGEST_LINE:
            self.note(
                "malformed",
                "bytes come without an end of line (CR or LF); check the baud rate and what ends "
                "a line",
            )
        self._ready.extend((stamp, line) for line in splitter.feed(data))

    def _parse(self, stamp: int, line: lines.Line) -> Reading | None:
        parsed = None if line.text is None else lines.parse_line(line.text, self._pattern)
        if parsed is not None and not parsed.bare:
            self._doubted = 0
        elif parsed is not None and (self._doubted or not line.whole):
            if self._doubted:
                self._doubted -= 1
                self.note(
                    "malformed",
                    "numbers right after a line that is not text are left out; check cable, baud "
                    "rate and what the probe sends",
                )
            self.health.count("partial")
            return None
        if parsed is not None:
            self.cleared("malformed")
            return self.reading(stamp, parsed.value, PHASES.get(parsed.phase, PHASE_UNKNOWN))
        if line.garbage:
            self._doubted = _DOUBTED
        if not line.whole:
            self.health.count("partial")
        elif line.text is None:
            self.note("malformed", "a line is too long or not ASCII text; check the baud rate")
        else:
            self.note(
                "malformed",
                f"line {line.text[:40]!r} does not match serial_pattern; it is left out",
            )
        return None
