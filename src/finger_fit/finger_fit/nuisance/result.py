# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit found about its nuisance parameters: plain data for fit.json and the report."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..nuisance_names import PRESS_GAIN, TARE, TRIAL_TARE, UNITS
from ..problem import FitProblem
from ..uncertainty import Covariance

if TYPE_CHECKING:
    from .estimate import Settled

NARROWED = 0.7
"""A nuisance counts as estimated when the data bring its deviation below this part of the
prior's."""


@dataclass(frozen=True)
class NuisanceValue:
    """One nuisance shared by all presses: estimate, deviation after the fit and before it."""

    value: float
    sd: float
    prior_sd: float
    unit: str

    @property
    def estimated(self) -> bool:
        """Whether the data tell more than the prior."""
        return self.sd < NARROWED * self.prior_sd


@dataclass(frozen=True)
class PressNuisance:
    """One press: tare (N) taken off with its deviation, whether the plate was seen unloaded, and
    the gain of its areas."""

    tare: float
    tare_sd: float
    tare_measured: bool
    gain: float


@dataclass(frozen=True)
class NuisanceResult:
    """What the fit of one condition found about its nuisances.

    values: the shared nuisances; presses: by the trials' labels; scatter: standard deviation of
    the presses' gains (logarithm); noise: m² of a frame; budget: per quantity, what the standard
    deviation of its logarithm is made of; left_out: what was asked for and could not be included;
    without: the quantities at the minimum of J, without nuisances.
    """

    values: dict[str, NuisanceValue]
    presses: dict[str, PressNuisance]
    scatter: float
    noise: float
    budget: dict[str, dict[str, float]]
    left_out: tuple[str, ...]
    without: dict[str, float]

    @property
    def not_estimated(self) -> list[str]:
        """The nuisances of which the data tell no more than the prior."""
        return [name for name, found in self.values.items() if not found.estimated]

    def to_dict(self) -> dict[str, object]:
        """Make the entry of fit.json."""
        return {
            "values": {n: {**asdict(v), "estimated": v.estimated} for n, v in self.values.items()},
            "not_estimated": self.not_estimated,
            "left_out": list(self.left_out),
            "press_scatter": self.scatter,
            "frame_noise": self.noise,
            "sd_log_parts": self.budget,
            "presses": {label: asdict(found) for label, found in self.presses.items()},
            "without_nuisances": self.without,
        }


def nuisance_result(
    problem: FitProblem,
    settled: Settled,
    known: Covariance,
    left_out: tuple[str, ...],
    without: np.ndarray,
) -> NuisanceResult:
    """Collect the nuisances of a problem where they have settled; without (N,): the parameters that
    minimise J."""
    found = settled.nuisances
    after = known.nuisance_deviations()
    values = {
        name: NuisanceValue(float(at), after[name], float(sd), UNITS.get(name, ""))
        for name, trial, at, sd in zip(found.names, found.trials, found.state, found.sd)
        if trial < 0 and name in after
    }
    own = {
        (name, int(trial)): (float(at), float(sd))
        for name, trial, at, sd in zip(found.names, found.trials, found.state, found.sd)
        if trial >= 0
    }
    spread = values[TARE].sd if TARE in values else 0.0
    presses = {}
    for index, trial in enumerate(problem.trials):
        _, tare_sd = own.get((TRIAL_TARE, index), (0.0, 0.0))
        gain, _ = own.get((PRESS_GAIN, index), (0.0, 0.0))
        seen = trial.rest is not None
        presses[trial.label] = PressNuisance(
            trial.drive.tare,
            tare_sd if seen else float(np.hypot(spread, tare_sd)),
            seen,
            float(np.exp(gain)),
        )
    space = problem.space
    return NuisanceResult(
        values,
        presses,
        settled.scatter,
        settled.noise,
        {name: known.budget(name) for name in space.quantity_names},
        left_out,
        space.quantities(without),
    )
