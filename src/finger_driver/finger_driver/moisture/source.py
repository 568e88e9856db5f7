# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What every source of moisture readings gives, and the settings that all of them have."""

from __future__ import annotations

from dataclasses import dataclass

from finger_common.diagnostics import Health
from finger_common.errors import InputError
from finger_common.moisture import is_moisture
from finger_common.settings import Settings, setting

from ..device import Device

PHASE_UNKNOWN, PHASE_BEFORE, PHASE_AFTER = 0, 1, 2
"""Phases, as in finger_msgs/Moisture."""
FLAG_OUT_OF_RANGE, FLAG_MANUAL = 1, 2
"""Flags, as in finger_msgs/Moisture."""

PHASES = {"before": PHASE_BEFORE, "after": PHASE_AFTER}
"""Phases by the words that a source may use; anything else is unknown."""


@dataclass(frozen=True)
class MoistureSettings(Settings):
    """Settings of every source of moisture readings."""

    path: str = setting("", "serial: the port. export: the file (CSV or XLSX).")

    def need_path(self, what: str) -> None:
        """Raise InputError where `path` is empty."""
        if not self.path:
            raise InputError(f"parameter 'path' is empty; name {what}")


@dataclass(frozen=True)
class Reading:
    """One reading of skin moisture.

    stamp_ns: when the probe took it, ns since the epoch. value: 0…130 a.u., or what the probe gave
    with FLAG_OUT_OF_RANGE. phase: PHASE_*. flags: FLAG_*.
    """

    stamp_ns: int
    value: float
    phase: int = PHASE_UNKNOWN
    flags: int = 0
    source: str = ""


class MoistureSource(Device[Reading]):
    """A source of moisture readings."""

    SETTINGS: type[MoistureSettings] = MoistureSettings
    NAME = ""
    """Name of the source in its readings."""

    def __init__(self, settings: MoistureSettings) -> None:
        super().__init__(settings, Health("moisture"))

    def reading(self, stamp_ns: int, value: float, phase: int = 0, flags: int = 0) -> Reading:
        """A reading; a value off the scale is flagged."""
        if not is_moisture(value):
            flags |= FLAG_OUT_OF_RANGE
        return Reading(stamp_ns, value, phase, flags, self.NAME)
