# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Will it slip? Stick ratio, margin and probability of slip, and friction, sample by sample.

    slip = SlipEstimator()
    for estimate, force in zip(estimates, lateral_forces):
        found = slip.add(estimate.stamp, estimate.normal_force, force, estimate.in_contact,
                         estimate.indentation)
        if found.slip_probability > 0.5:
            grip_harder()

Coulomb friction with one coefficient that is estimated while running, quasi-static, independent of
rate. The output is a function of the stamped inputs in their order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from finger_common.errors import InputError

from . import kernels
from .settings import SlipSettings

NATURAL_MOISTURE = 69.0
"""Moisture (a.u.) at which the prior's median friction holds."""
SHIFT_LIMIT = 1.0
"""Largest change of ln μ that moisture makes."""


class SlipEstimate(NamedTuple):
    """Tangential state of the contact at one instant (SI).

    stamp (ns); normal_force P (N); tangential_force Q (2,) in N, of the plate on the skin in the
    sensor's axes that span the plate; stick_ratio: share of the contact's area that sticks;
    slip_margin: 1 − |Q|/(μP); each with its standard deviation; slip_probability: that the whole
    contact slips now or within the horizon; friction μ and its standard deviation;
    tangential_displacement (2,) in m: of the plate against the bone since the contact began, as far
    as the skin sticks; tangential_stiffness (N/m); slips: slips seen so far; slipping: the contact
    slips now. Without contact all but forces and friction are NaN and the probability is 0.
    """

    stamp: int
    normal_force: float
    tangential_force: tuple[float, float]
    stick_ratio: float
    stick_ratio_stddev: float
    slip_margin: float
    slip_margin_stddev: float
    slip_probability: float
    friction: float
    friction_stddev: float
    tangential_displacement: tuple[float, float]
    tangential_stiffness: float
    slips: int
    slipping: bool


class SlipEstimator:
    """Slip of one finger's contact; see the module. settings: None for the defaults."""

    def __init__(self, settings: SlipSettings | None = None) -> None:
        self.settings = settings or SlipSettings()
        self._config = np.zeros(1, kernels.CONFIGURATION)
        self._state = np.zeros(1, kernels.STATE)
        self._stamps = np.zeros(1, np.int64)
        self._normal = np.zeros(1)
        self._lateral = np.zeros((1, 2))
        self._touching = np.zeros(1, bool)
        self._indentation = np.zeros(1)
        self._row = np.zeros(1, kernels.OUTPUT)
        self.configure(self.settings)
        self.reset()

    def configure(self, settings: SlipSettings, moisture: float = math.nan) -> None:
        """Take over settings. moisture (a.u.) shifts the prior's friction; NaN: it is not known.

        The prior enters at the next reset, or at once where nothing was learned yet.
        """
        self.settings = settings
        shift = 0.0
        if math.isfinite(moisture):
            shift = settings.friction_moisture_slope * (moisture - NATURAL_MOISTURE)
            shift = min(max(shift, -SHIFT_LIMIT), SHIFT_LIMIT)
        self._config["prior_mean"] = math.log(settings.friction_prior) + shift
        self._config["prior_sd"] = settings.friction_prior_sd
        self._config["drift"] = settings.friction_drift
        self._config["horizon"] = settings.slip_horizon
        self._config["noise"] = settings.tangential_noise
        if not self._state["told"][0]:
            kernels.set_prior(self._config[0], self._state[0])

    def reset(self) -> None:
        """A finger and a plate that were not seen before."""
        self._state[:] = np.zeros(1, kernels.STATE)
        kernels.set_prior(self._config[0], self._state[0])

    def add(
        self,
        stamp: int,
        normal_force: float,
        lateral: tuple[float, float],
        touching: bool,
        indentation: float = math.nan,
    ) -> SlipEstimate:
        """One sample: stamp (ns), P (N), Q (2,) in N, whether in contact, indentation (m)."""
        self._stamps[0] = stamp
        self._normal[0] = normal_force
        self._lateral[0, 0], self._lateral[0, 1] = lateral
        self._touching[0] = touching
        self._indentation[0] = indentation
        self._follow(
            self._stamps,
            self._normal,
            self._lateral,
            self._touching,
            self._indentation,
            self._row,
        )
        values = list(self._row.item())
        values[2], values[10] = tuple(values[2]), tuple(values[10])
        return SlipEstimate._make(values)

    def add_many(
        self,
        stamps: np.ndarray,
        normal_force: np.ndarray,
        lateral: np.ndarray,
        touching: np.ndarray,
        indentation: np.ndarray,
    ) -> np.ndarray:
        """As `add` for n samples; rows (n,) of `kernels.OUTPUT`. lateral is (n, 2)."""
        rows = np.zeros(len(stamps), kernels.OUTPUT)
        if lateral.shape != (len(stamps), 2):
            raise InputError(f"lateral has shape {lateral.shape}, ({len(stamps)}, 2) is needed")
        self._follow(
            np.ascontiguousarray(stamps, np.int64),
            np.ascontiguousarray(normal_force, float),
            np.ascontiguousarray(lateral, float),
            np.ascontiguousarray(touching, bool),
            np.ascontiguousarray(indentation, float),
            rows,
        )
        return rows

    def _follow(self, *arrays: np.ndarray) -> None:
        kernels.follow_many(self._config, self._state, *arrays)

    def add_stick_ratio(self, stamp: int, stick_ratio: float, sd: float) -> bool:
        """A stick ratio seen by a camera at `stamp` (ns) with its standard deviation.

        False when it tells nothing: no contact then, no tangential load, or after a reversal.
        """
        if not (math.isfinite(stick_ratio) and sd > 0.0):
            return False
        return bool(kernels.see_stick(self._state[0], stamp, float(stick_ratio), float(sd)))
