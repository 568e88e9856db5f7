# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The tangential law of the contact: parallel elements that stick up to their own limits.

An Iwan model (W. D. Iwan, J. Appl. Mech. 33(4):893–900, 1966): N elements share the contact's area
in equal parts, move with the same displacement, and each slips at its own limit. Under a first pull
the stick ratio s then follows the ratio r = |Q|/(μP) along a given curve s(r), its backbone: from
dr/du = s the displacement at which the last share s sticks is u(s) = ∫ dr/s, which is the limit of
the element at that share. Reversals follow from the elements by themselves (Masing's rules).

Reduced loading (Cattaneo 1938, Mindlin 1949, Ciavarella 1998) would give s = (1 − r)^m for an area
that grows as P^m. A finger sticks longer: its skin is some fifty times as stiff as the tissue
behind it and moves as one piece. So the backbone is taken from the three-dimensional solution.
"""

from __future__ import annotations

import numpy as np

STICK_CURVE = np.array(
    [
        (0.000, 1.000),
        (0.250, 1.000),
        (0.345, 0.953),
        (0.442, 0.815),
        (0.537, 0.595),
        (0.632, 0.434),
        (0.724, 0.316),
        (0.815, 0.206),
        (0.903, 0.030),
        (0.960, 0.012),
        (1.000, 0.010),
    ]
)
"""r = |Q|/(μP) and stick ratio by slip of a first pull. CalculiX 2.20, the finger of its curves
(`CALCULIX_FINGER`), 30.23 kPa, friction 0.5, pressed to 0.52 N; r in the middle of the interval
that the stick ratio belongs to; the ends of the curve are extrapolated."""

SLIP_COMPLIANCE = 0.08
"""Share of the contact in the compliance: what the displacement of the elements beyond that of a
stuck contact adds, over Q/K; the rest lies in the tissue, which does not see the slip."""


def stick_ratio(r: np.ndarray | float) -> np.ndarray:
    """Stick ratio of a first pull at r = |Q|/(μP); 0 from r = 1 on."""
    return np.where(np.asarray(r) < 1.0, np.interp(r, *STICK_CURVE.T), 0.0)


def limits(count: int) -> np.ndarray:
    """Limits (count,) of the elements over μP/count, smallest first; their mean is 1."""
    r = np.linspace(0.0, 1.0, 2001)
    stick = np.interp(r, *STICK_CURVE.T)
    middle = 0.5 * (r[1:] + r[:-1])
    moved = np.concatenate([[0.0], np.cumsum(np.diff(r) / np.interp(middle, *STICK_CURVE.T))])
    share = (np.arange(100 * count) + 0.5) / (100 * count)
    found = np.interp(share, 1.0 - stick, moved).reshape(count, 100).mean(axis=1)
    return found / found.mean()
