# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far the estimates of a run can be trusted: the flags of the contact, counted."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES, directed, mostly_pulls, other_axis
from finger_common.flags import StateFlag
from finger_model.estimator import EstimateBlock

BEYOND_MODEL = 5
"""Samples in contact beyond the force limit from which a model does not serve; fewer are spikes."""

_DOUBTS: dict[StateFlag, tuple[float, str, str]] = {
    StateFlag.FORCE_INVALID: (0.0, "the force is not finite", "check the force sensor"),
    StateFlag.FORCE_OUT_OF_RANGE: (
        0.0,
        "the force is beyond the model, and areas are too small there",
        "name a finger that reaches further with --geometry",
    ),
    StateFlag.PARAMETERS_OUT_OF_RANGE: (
        0.0,
        "the parameters lie outside the model's range",
        "name others with --parameters, or a model with --model",
    ),
    StateFlag.FORCE_OFFSET: (
        0.02,
        "the force seems to have an offset",
        "record or import a tared force",
    ),
    StateFlag.MODEL_MISMATCH: (
        0.02,
        "areas and model disagree",
        "check the clocks of areas and force with finger-bag validate, and name your finger with "
        "--geometry or --parameters",
    ),
    StateFlag.MODEL_FAILED: (0.0, "the model failed", "name another one with --model"),
}
"""Flag -> share of the contact from which it is told; what it means; what to do."""

MANY_REJECTED = 0.25
"""Share of the areas during contact whose rejection is told: the first and the last of a press are
often none."""


class Validity:
    """Counts the flags of the samples in contact, and the areas that cannot be used."""

    def __init__(self) -> None:
        self._contact = 0
        self._flags: Counter[StateFlag] = Counter()
        self._age = math.nan
        self._used = self._areas = self._unsure = 0
        self._samples = 0
        self._squares = np.zeros(len(NORMAL_AXES))
        self._axis = DEFAULT_NORMAL_AXIS

    def add(self, block: EstimateBlock, force: np.ndarray, normal_axis: str) -> None:
        """Count the flags of a block of estimates; force (n, 3): N, what they were made of."""
        self._samples += len(block)
        self._squares += directed(force)
        self._axis = normal_axis
        touching = block.column("in_contact")
        flags = block.column("flags")[touching]
        self._contact += len(flags)
        if flags.any():
            for flag in (*_DOUBTS, StateFlag.AREA_REJECTED):
                self._flags[flag] += int(np.count_nonzero(flags & int(flag)))
        # An area that was used begins a new age of the last measurement.
        age = np.append(self._age, block.column("measured_area_age")[touching])
        self._age = float(age[-1])
        after, before = age[1:], age[:-1]
        self._used += int(np.count_nonzero((after < before) | (~(before >= 0.0) & (after >= 0.0))))

    def add_area(self, area: float, sd: float) -> None:
        """Count a measured area and its standard deviation (m²)."""
        if area > 0.0:
            self._areas += 1
            self._unsure += not (math.isfinite(sd) and sd > 0.0)

    @property
    def leaves_model(self) -> bool:
        """Whether the force goes beyond the model's limit, by more than a spike."""
        return self._flags[StateFlag.FORCE_OUT_OF_RANGE] >= BEYOND_MODEL

    def notes(self) -> list[str]:
        """Sentences on what makes estimates doubtful, with the remedy."""
        found = []
        if self._areas and (not self._contact or mostly_pulls(self._squares, self._axis)):
            remedy = other_axis(self._squares, self._axis) or "check unit and tare of the force"
            found.append(
                f"{self._areas} areas show a contact, {self._contact} of {self._samples} forces "
                f"do; {remedy}"
            )
        for flag, (least, meaning, remedy) in _DOUBTS.items():
            share = self._flags[flag] / max(self._contact, 1)
            if share > least:
                found.append(f"{_percent(share)} of the contact: {meaning} ({flag.name}); {remedy}")
        if self._unsure:
            found.append(
                f"{self._unsure} of {self._areas} areas have no standard deviation and were not "
                "used; import them again, or take 10 % with 'contact_area: {field: gross_area}' "
                "in a mapping file"
            )
        rejected = self._flags[StateFlag.AREA_REJECTED]
        if rejected > MANY_REJECTED * (rejected + self._used) and not self._unsure:
            share = rejected / (rejected + self._used)
            found.append(
                f"{_percent(share)} of the areas during contact were not used (AREA_REJECTED); "
                "check their clock, unit and flags with finger-bag validate"
            )
        return found


def _percent(share: float) -> str:
    return "less than 1 %" if share < 0.01 else f"{100.0 * share:.0f} %"
