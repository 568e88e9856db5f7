# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Can measured indentations be those of the press? Their unit, sign and clock, told by the force.

The indentation is the approach of plate and bone, positive into the finger. Its zero is not known,
so only its change over a press is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PLAUSIBLE_TRAVEL = (2e-5, 2e-2)
"""m; the change of indentation in a press of a fingertip lies between (the paper's: about 1 mm)."""

FEWEST_READINGS = 3
"""Readings during a press below which its indentation tells nothing."""

FOLLOWS = 0.5
"""Part of its change that an indentation rises, or falls, from onset to peak force when it follows
the force, or runs against it."""


@dataclass(frozen=True)
class IndentationFault:
    """What is wrong with the indentation of a press.

    option: what probably has to be changed, "unit", "sign" or "time_offset"; text: what was found;
    certain: False for what is only suspicious.
    """

    option: str
    text: str
    certain: bool = True


def indentation_fault(
    stamp_ns: np.ndarray,
    force: np.ndarray,
    indentation_stamp_ns: np.ndarray,
    indentation: np.ndarray,
) -> IndentationFault | None:
    """Fault of the indentations (k,) in m of one press; None where they can be a finger's.

    stamp_ns (n,), force (n,) in N: the press, from onset to lift-off; indentation_stamp_ns (k,).
    Readings that are not finite do not count.
    """
    inside = (indentation_stamp_ns >= stamp_ns[0]) & (indentation_stamp_ns <= stamp_ns[-1])
    inside &= np.isfinite(indentation)
    values = indentation[inside]
    if len(values) < FEWEST_READINGS:
        return IndentationFault(
            "time_offset", f"{len(values)} readings of indentation during the press"
        )
    travel = float(np.ptp(values))
    if not PLAUSIBLE_TRAVEL[0] <= travel <= PLAUSIBLE_TRAVEL[1]:
        low, high = (1e3 * end for end in PLAUSIBLE_TRAVEL)
        return IndentationFault(
            "unit",
            f"the indentation changes by {_length(travel)} during the press, that of a fingertip "
            f"by {low:g} to {high:g} mm",
        )
    origin = stamp_ns[0]
    at = np.interp(indentation_stamp_ns[inside] - origin, stamp_ns - origin, force)
    peak = int(np.argmax(at))
    rise = float(values[peak] - values[: peak + 1][np.argmin(at[: peak + 1])])
    if rise < -FOLLOWS * travel:
        return IndentationFault(
            "sign", f"the indentation falls by {-1e3 * rise:.3g} mm while the force rises"
        )
    if rise < FOLLOWS * travel:
        return IndentationFault(
            "time_offset",
            f"the indentation changes by {1e3 * travel:.3g} mm during the press, and by "
            f"{1e3 * rise:.3g} mm of it while the force rises",
            certain=False,
        )
    return None


def _length(value: float) -> str:
    return f"{value:.4g} m" if value >= 0.1 else f"{1e3 * value:.4g} mm"
