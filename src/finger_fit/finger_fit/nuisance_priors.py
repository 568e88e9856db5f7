# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of the nuisance parameters before a fit, as options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from finger_common.errors import InputError, put_once
from finger_common.settings import Settings, setting
from finger_model.geometry import LENGTHS

INDENTATION = "measured indentation"
"""Heading of the options of a displacement sensor in the help of the command."""

CALIPERS = {
    "epidermis_thickness": 0.25,
    "pad_semi_axis_radial": 0.05,
    "pad_semi_axis_axial": 0.08,
    "bone_semi_axis_axial": 0.2,
}
"""Relative deviation of the lengths of a finger measured with calipers whose geometry states none:
those of the rules (`finger_model.anthropometry`), rounded, of the lengths that change areas most.
"""

KNOWN, MEASURED = "default", "calipers"
"""Words of `geometry_sd`: what is known of the finger's lengths (`finger_lengths`), and `CALIPERS`
for any finger."""

NUISANCE = "nuisance parameters (standard deviations of their priors; 0 leaves one out)"
"""Heading of the options in the help of the command."""


@dataclass(frozen=True)
class NuisancePriors(Settings):
    """Options of what is unknown beside the finger's parameters; raises InputError for bad ones."""

    indentation_sd: float = setting(
        20e-6,
        "Standard deviation of a measured indentation at a frame; 0: do not use indentations. The "
        "error of the model's own indentation is added as squares.",
        "m",
        0.0,
        1e-3,
        group=INDENTATION,
    )
    indentation_gain_sd: float = setting(
        0.0,
        "Standard deviation of the prior of the displacement sensor's gain (logarithm); 0: the "
        "gain is trusted.",
        "",
        0.0,
        0.5,
        group=INDENTATION,
    )
    nuisances: bool = setting(
        True,
        "Allow for unknown properties of the rig and of the finger's shape. They are estimated "
        "with the parameters, or included in their intervals.",
        group=NUISANCE,
    )
    tare_sd: float = setting(
        0.02,
        "Tare left in the force of trials that never show the plate unloaded. In other trials the "
        "tare is measured on the unloaded plate.",
        "N",
        0.0,
        1.0,
        group=NUISANCE,
    )
    lag_sd: float = setting(
        0.05,
        "Delay of the images' stamps behind those of the force.",
        "s",
        0.0,
        1.0,
        group=NUISANCE,
    )
    area_gain_sd: float = setting(
        0.05,
        "Factor of all areas (logarithm): calibration of the plate, threshold of the images.",
        "",
        0.0,
        1.0,
        group=NUISANCE,
    )
    press_gain: bool = setting(
        True,
        "Factor of each press's areas, with a scatter that is estimated from the presses.",
        group=NUISANCE,
    )
    collapse_sd: float = setting(
        0.3,
        "Share of the gross area that is missing in the image at zero force. It falls to none at "
        "low_force.",
        "",
        0.0,
        1.0,
        group=NUISANCE,
    )
    geometry_sd: list[str] = setting(
        [KNOWN],
        "Relative deviations of lengths of the finger, as NAME=DEVIATION. A length that is not "
        "named keeps its default: the deviation in the geometry file; if it has none, that of "
        "calipers; without a geometry, that of a finger that nobody measured. 'calipers': as "
        "measured with calipers, in any case. NAME=0 leaves a length out, an empty list leaves "
        "out all.",
        group=NUISANCE,
    )

    def lengths(self, known: Mapping[str, float]) -> dict[str, float]:
        """Relative deviation of each length; raises InputError for what is none.

        known: those of the finger, which `geometry_sd` overrides. Without the lengths of deviation
        0, and empty where `geometry_sd` is.
        """
        found = dict(CALIPERS if MEASURED in self.geometry_sd else known)
        given: dict[str, float] = {}
        for text in self.geometry_sd:
            if text in (KNOWN, MEASURED):
                continue
            name, _, number = text.partition("=")
            try:
                value = float(number)
            except ValueError:
                value = -1.0
            if name not in LENGTHS or not 0.0 <= value <= 1.0:
                raise InputError(
                    f"geometry_sd '{text}': NAME=DEVIATION is needed, a relative deviation from 0 "
                    f"to 1 and NAME one of {', '.join(LENGTHS)}, or the word '{MEASURED}'"
                )
            put_once(given, name, value, "geometry_sd")
        found |= given
        return {n: value for n, value in found.items() if value > 0 and self.geometry_sd}
