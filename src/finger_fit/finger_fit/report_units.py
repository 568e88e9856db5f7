# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Factors from SI to the units of reports, and how many digits they show."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

import numpy as np

MM = 1e3
"""mm in a m."""

MM2 = 1e6
"""mm² in a m²."""

MM4 = 1e12
"""mm⁴ in a m⁴."""


def three_digits(value: float) -> str:
    """A value with three significant digits and no exponent: 1230, 41.0, 0.00123."""
    if not np.isfinite(value):
        return "–"
    rounded = float(f"{value:.2e}")
    digits = 2 - math.floor(math.log10(abs(rounded))) if rounded else 2
    return f"{rounded:.{max(digits, 0)}f}"


CUT_NOTE = "* The search box ends here. The data do not limit the value on this side."


def interval_text(ends: Iterable[str], cut: Sequence[bool], between: str) -> str:
    """Both ends of an interval; a * marks those where the search box cuts it off (`CUT_NOTE`)."""
    return between.join(end + "*" * at_box for end, at_box in zip(ends, cut, strict=True))


def minus(text: str) -> str:
    """Text with the minus sign of print; a zero has no sign."""
    return re.sub(r"[+-](0(?:\.0+)?)(?![\d.])", r"\1", text).replace("-", "−")
