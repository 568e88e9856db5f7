"""What every source of moisture readings gives."""

from __future__ import annotations

from dataclasses import dataclass

from ..device import Device

MOISTURE_RANGE = (0.0, 130.0)
"""Range of a Corneometer, arbitrary units."""

PHASE_UNKNOWN, PHASE_BEFORE, PHASE_AFTER = 0, 1, 2
"""Phases, as in finger_msgs/Moisture."""
FLAG_OUT_OF_RANGE, FLAG_MANUAL = 1, 2
"""Flags, as in finger_msgs/Moisture."""

PHASES = {"": PHASE_UNKNOWN, "unknown": 0, "before": PHASE_BEFORE, "after": PHASE_AFTER}
"""Phases by the words a source may use."""


@dataclass(frozen=True)
class Reading:
    """One reading of skin moisture.

    stamp_ns: when the probe took it, ns since the epoch. value: 0…130 a.u., or what the probe said with
    FLAG_OUT_OF_RANGE. index: number since the source was opened, from 0. phase: PHASE_*. flags: FLAG_*.
    """

    stamp_ns: int
    value: float
    index: int
    phase: int = PHASE_UNKNOWN
    flags: int = 0
    source: str = ""


def range_flag(value: float) -> int:
    """FLAG_OUT_OF_RANGE for a value outside 0…130 a.u. (also NaN), else 0."""
    return 0 if MOISTURE_RANGE[0] <= value <= MOISTURE_RANGE[1] else FLAG_OUT_OF_RANGE


class MoistureSource(Device[Reading]):
    """A source of moisture readings, each with an index of its own."""
