# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units of force, torque, length, area, time and modulus by name, and their factors to SI.

Factors: NIST SP 811.
"""

from __future__ import annotations

from collections.abc import Mapping

FORCE_UNITS = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "lbf": 4.4482216152605,
    "klbf": 4448.2216152605,
}
"""Newtons per unit of force."""

LARGEST_FORCE = 100.0
"""N; a finger cannot press harder without injury, another unit can."""

TORQUE_UNITS = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "kgf-cm": 0.0980665,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
}
"""Newton metres per unit of torque."""

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
"""Metres per unit of length."""

AREA_UNITS = {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6}
"""Square metres per unit of area."""

MODULUS_UNITS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9}
"""Pascals per unit of a modulus or pressure."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
"""Seconds per unit of time."""


_WEIGHTS = {"g": "gf", "kg": "kgf", "lb": "lbf"}
"""Units of mass in which scales show a force."""
_WORDS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden"), "s"),
    **dict.fromkeys(("msec", "msek", "millisecond", "milliseconds", "millisekunden"), "ms"),
    **dict.fromkeys(("usec", "usek", "microsecond", "microseconds", "mikrosekunden"), "us"),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds", "nanosekunden"), "ns"),
    **dict.fromkeys(("mins", "minute", "minutes", "minuten"), "min"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours", "stunde", "stunden"), "h"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("day", "days"), "d"),
    **dict.fromkeys(("sqmm", "mm**2"), "mm2"),
    **dict.fromkeys(("pixel", "pixels"), "px"),
}
"""Other names of units."""


def unit_named(text: str, units: Mapping[str, float]) -> str | None:
    """The unit that a text such as "mm²", "MM^2" or "n" means, None for none of them; of forces,
    "g" is the weight of a gram."""
    plain = text.strip().replace("²", "2").replace("^", "").replace("µ", "u").replace("μ", "u")
    if plain in units:
        return plain
    for names in (_WEIGHTS, _WORDS):
        other = names.get(plain.casefold())
        if other in units:
            return other
    return next((unit for unit in units if unit.casefold() == plain.casefold()), None)
