# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A Robotous RFT force sensor on a python-can bus.

Models: the commands model, serial number, firmware, set output rate, one sample, start, stop and
bias; samples in two frames with Tx across them; overload bits at 120 % of the rating, bias or not;
see FAULTS. Does not model: the filter, changing identifiers, reading settings back, overload
counters, noise beyond white noise, bit rate and arbitration.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass

import numpy as np

from finger_common.settings import setting

from ..can_bus import frame as can_frame
from .simulator import BusOptions, CanSimulator
from .values import LoadOptions

FAULTS = {
    "silent": "sends nothing, as without power",
    "no_second": "leaves out the second frame of a sample",
    "swapped": "sends the second frame of a sample before the first",
    "short": "sends a frame of four bytes",
    "foreign": "sends frames of another device between the two",
    "reset": "restarts: stops streaming",
}
_RATES = (200, 10, 20, 50, 100, 200, 333, 500, 1000)
_RATING = np.array([200.0, 200.0, 200.0, 4.0, 4.0, 4.0])
"""N and N m; overload beyond 120 % of it."""
_DIVIDERS = np.array([50.0] * 3 + [2000.0] * 3)
"""Counts per N and N m of an RFT64-SB01."""


@dataclass(frozen=True)
class RftOptions(LoadOptions, BusOptions):
    """Options of the simulated sensor."""

    noise: float = setting(0.01, "Standard deviation.", unit="N", minimum=0)


class RftSimulator(CanSimulator):
    """Robotous RFT on a CAN bus."""

    NAME = "rft"
    SETTINGS = RftOptions
    FAULTS = FAULTS

    def __init__(self, settings: RftOptions) -> None:
        super().__init__()
        self._force = settings.load()
        self.bus, self.owns_bus = settings.open_bus(), True
        self._noise = settings.noise * np.array([1.0] * 3 + [0.02] * 3)
        self._random = np.random.default_rng(1)
        self._bias = np.zeros(6)
        self._rate = 200
        self._streaming = False

    def run(self) -> None:
        due = time.monotonic()
        while not self.ending:
            wait = max(0.0, min(due - time.monotonic(), 0.05)) if self._streaming else 0.05
            frame = self.request(wait)
            if frame is not None and frame.arbitration_id == 0x64 and frame.dlc == 8:
                self._command(bytes(frame.data))
            if self.faults.take("reset"):
                self._streaming, self._rate = False, 200
            now = time.monotonic()
            if not self._streaming:
                due = now
            elif now >= due:
                due = max(due + 1 / self._rate, now - 0.1)
                self._sample(0x0B)

    def _command(self, data: bytes) -> None:
        if self.faults.value("silent"):
            return
        command, parameter = data[0], data[1]
        if command in (0x01, 0x02, 0x03):
            text = {1: b"RFT64-SB01", 2: b"SIM00001", 3: b"1.82"}[command].ljust(15, b"\0")
            self._send(1, bytes([command]) + text[:7])
            self._send(2, text[7:15])
        elif command == 0x0A:
            self._sample(0x0A)
        elif command in (0x0B, 0x0C):
            self._streaming = command == 0x0B
        elif command == 0x0F:
            good = parameter < len(_RATES)
            if good:
                self._rate = _RATES[parameter]
            self._send(1, bytes([command, good, 0 if good else 2, 0, 0, 0, 0, 0]))
            self._send(2, bytes(8))
        elif command == 0x11:
            self._bias = np.array(self._force(time.time_ns())) if parameter else np.zeros(6)

    def _sample(self, response: int) -> None:
        if self.faults.value("silent"):
            return
        load = np.asarray(self._force(time.time_ns()), dtype=float)
        overload = np.abs(load) > 1.2 * _RATING
        wrench = load - self._bias + self._noise * self._random.standard_normal(6)
        counts = np.clip(np.rint(wrench * _DIVIDERS), -32768, 32767)
        bits = sum(1 << (5 - axis) for axis in range(6) if overload[axis])
        data = struct.pack(">B6hBH", response, *(int(c) for c in counts), bits, 0)
        frames = [(1, data[:8]), (2, data[8:])]
        if self.faults.take("short"):
            frames[0] = (1, data[:4])
        if self.faults.take("no_second"):
            frames.pop()
        if self.faults.take("swapped"):
            frames.reverse()
        foreign = self.faults.take("foreign")
        for identifier, payload in frames:
            self._send(identifier, payload)
            if foreign:
                self._send(0x123, bytes(8))

    def _send(self, identifier: int, data: bytes) -> None:
        self.bus.send(can_frame(identifier, data))
