# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The scale of the moisture probe, in arbitrary units (Courage + Khazaka Corneometer CM 825)."""

from __future__ import annotations

import math

MOISTURE_RANGE = (0.0, 130.0)
"""a.u., first and last value of the scale."""


MOISTURE_TEXT = f"{MOISTURE_RANGE[0]:g} … {MOISTURE_RANGE[1]:g} a.u."
"""The scale as error sentences name it."""


def is_moisture(value: float) -> bool:
    """Whether a reading lies on the scale; false for NaN."""
    return math.isfinite(value) and MOISTURE_RANGE[0] <= value <= MOISTURE_RANGE[1]
