"""Units of force, torque and area by name, and their factors to N, N m and m².

Factors: NIST SP 811.
"""

from __future__ import annotations

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

TORQUE_UNITS = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "kgf-cm": 0.0980665,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
}
"""Newton metres per unit of torque."""

AREA_UNITS = {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6}
"""Square metres per unit of area."""
