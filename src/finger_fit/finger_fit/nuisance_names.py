# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Names and units of the nuisance parameters."""

from __future__ import annotations

from finger_model.geometry import LENGTHS

TARE, TRIAL_TARE, LAG = "tare", "trial_tare", "lag"
AREA_GAIN, COLLAPSE = "area_gain", "collapse"
INDENTATION_GAIN, PRESS_GAIN = "indentation_gain", "press_gain"
"""Beside the lengths of the finger, by their keys in geometry.yaml."""

UNITS = {TARE: "N", TRIAL_TARE: "N", LAG: "s"}
"""The others are shares (logarithms of factors)."""


def is_assumed(nuisance: str) -> bool:
    """Whether a nuisance is the same in all presses and conditions of a finger on its plate.

    These are the lengths of the finger and the gain of all areas. More presses do not lower what
    they add to an interval; only a better measurement of them does.
    """
    return nuisance == AREA_GAIN or nuisance in LENGTHS


def absorber_of(length: str) -> str:
    """Name of what an assumed length does to the indentation, which is eliminated
    (`problem.goal`)."""
    return f"indentation by {length}"


WORDS = {
    LAG: "lag of the images",
    AREA_GAIN: "gain of all areas",
    INDENTATION_GAIN: "gain of the displacement sensor",
    COLLAPSE: "collapse of the hull below the low force",
    "pad_semi_axis_radial": "width of the pad",
    "pad_semi_axis_axial": "depth of the pad",
    "bone_semi_axis_radial": "width of the bone",
    "bone_semi_axis_axial": "height of the bone",
    "bone_center_height": "height of the bone's centre",
    "nail_radius": "width of the nail",
}


def name_of(nuisance: str) -> str:
    """A nuisance in words."""
    return WORDS.get(nuisance, nuisance.replace("_", " "))
