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
"""Seconds after which an unfinished line is given up: its rest would be read as another number."""


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

    Each must match a pattern with a group `value` and perhaps a group `phase` (before, after).
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
        self._ready: deque[tuple[int, str]] = deque()
        self._last_byte = 0.0

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
        # What waited in the port was measured before anybody listened.
        self.flush()
        self._last_byte = time.monotonic()
        self.health.hardware_id = name

    def flush(self) -> None:
        if self._port is not None:
            try:
                self._port.reset_input_buffer()
            except (OSError, termios.error) as error:
                raise DeviceError(
                    f"serial port '{self.settings.path}' is lost ({error}); check the cable"
                ) from None
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
        try:
            self._port.timeout = min(timeout, 0.1)
            data = self._port.read(max(1, min(self._port.in_waiting, 4096)))
        except (OSError, TypeError) as error:
            # pyserial's own errors are OSErrors; a port closed meanwhile gives a TypeError.
            raise DeviceError(f"serial port '{self.settings.path}' was lost ({error})") from None
        now = time.monotonic()
        if self._splitter.unfinished and now - self._last_byte > _LINE_TIME:
            self._splitter.reset()
            self.note("malformed", "a line broke off in the middle; it is left out")
        if not data:
            return
        self._last_byte = now
        stamp = self.clock.now()
        dropped = self._splitter.dropped
        self._ready.extend((stamp, line) for line in self._splitter.feed(data))
        for _ in range(self._splitter.dropped - dropped):
            self.note("malformed", "a line is too long or not ASCII text; check the baud rate")

    def _parse(self, stamp: int, line: str) -> Reading | None:
        parsed = lines.parse_line(line, self._pattern)
        if parsed is None:
            self.note(
                "malformed", f"line {line[:40]!r} does not match serial_pattern; it is left out"
            )
            return None
        self.cleared("malformed")
        return self.reading(stamp, parsed.value, PHASES.get(parsed.phase, PHASE_UNKNOWN))
