"""Readings the operator enters."""

from __future__ import annotations

import time

from finger_common.diagnostics import Health

from ..clock import HostClock
from .source import FLAG_MANUAL, MoistureSource, Reading, range_flag


class ManualSource(MoistureSource):
    """Makes a reading of what `enter` is called with; no device behind it, so `read` gives nothing."""

    def __init__(self, health: Health, clock: HostClock | None = None) -> None:
        super().__init__(health)
        self._clock = clock or HostClock()
        self._index = 0
        health.hardware_id = "operator"

    def connect(self) -> None:
        """Nothing to open."""

    def close(self) -> None:
        """Nothing to release."""

    def enter(self, value: float, phase: int = 0) -> Reading:
        """The reading entered now."""
        flags = FLAG_MANUAL | range_flag(value)
        reading = Reading(self._clock.now(), value, self._index, phase, flags, "manual")
        self._index += 1
        return reading

    def read(self, timeout: float = 1.0) -> Reading | None:
        time.sleep(timeout)
        return None
