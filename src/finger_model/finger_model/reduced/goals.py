# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How exact the reduced model of one geometry is to be, and whether a file says that it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

GOAL_RMS, GOAL_WORST, LIMIT_RMS, LIMIT_WORST = 0.01, 0.02, 0.015, 0.04
"""Shares of the history's largest area.

GOAL: RMS and worst instant of GOAL_SHARE of the pairs; LIMIT: of every pair.
"""

GOAL_SHARE = 0.99


def missed(stated: Mapping[str, Any]) -> str:
    """In words, how the error that a file states (`ErrorTable.summary`) misses the goals; empty
    where it meets them, and where the file states none."""
    if not {"share_within", "rms_max", "worst_max", "indentation_max"} <= set(stated):
        return ""
    within = stated["rms_max"] <= LIMIT_RMS and stated["worst_max"] <= LIMIT_WORST
    if stated["share_within"] >= GOAL_SHARE and within:
        return ""
    rms, worst, indentation = (
        f"{100 * stated[f'{name}_max']:.2g} %" for name in ("rms", "worst", "indentation")
    )
    return (
        f"the reduced model is less exact than 'finger-model verify --reduced' allows: its file "
        f"states errors of the area of up to {rms} RMS and {worst} at an instant (at most "
        f"{100 * LIMIT_RMS:g} % and {100 * LIMIT_WORST:g} %), and {indentation} of the "
        "indentation; build it again with the default settings of 'finger-model reduce', or more "
        "training runs"
    )
