# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units of force and torque by the codes and names that sensors send.

Codes: ATI manual 9610-05-1030-04, table of opcode 0x8; the same codes are used in READCALINFO of
the Net F/T (9620-05-net ft, section 11). Names: the Net F/T's XML pages.
"""

from __future__ import annotations

from finger_common.errors import DeviceError
from finger_common.units import FORCE_UNITS, TORQUE_UNITS

FORCE_CODES = {1: "lbf", 2: "N", 3: "klbf", 4: "kN", 5: "kgf", 6: "gf"}
TORQUE_CODES = {1: "lbf-in", 2: "lbf-ft", 3: "N-m", 4: "N-mm", 5: "kgf-cm", 6: "kN-m"}

_ALIASES = {"Nm": "N-m", "Nmm": "N-mm", "kg-cm": "kgf-cm", "in-lb": "lbf-in", "ft-lb": "lbf-ft"}


def code_of(unit: str, codes: dict[int, str], default: int) -> int:
    """Code of a unit by its name; `default` for a name that none of `codes` has."""
    return next((code for code, name in codes.items() if name == unit), default)


def force_factor(unit: str | int) -> float:
    """N per unit of force, given by name or code; raises DeviceError for an unknown one."""
    name = FORCE_CODES.get(unit) if isinstance(unit, int) else unit.strip()
    if name is None or name not in FORCE_UNITS:
        raise DeviceError(
            f"force unit {unit!r} is not known; set the sensor to one of {', '.join(FORCE_UNITS)}"
        )
    return FORCE_UNITS[name]


def torque_factor(unit: str | int) -> float:
    """N m per unit of torque, given by name or code; raises DeviceError for an unknown one."""
    name = TORQUE_CODES.get(unit) if isinstance(unit, int) else unit.strip()
    name = _ALIASES.get(name or "", name)
    if name is None or name not in TORQUE_UNITS:
        raise DeviceError(
            f"torque unit {unit!r} is not known; set the sensor to one of {', '.join(TORQUE_UNITS)}"
        )
    return TORQUE_UNITS[name]
