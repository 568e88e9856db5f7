# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How much the presses differ that parameters were fitted to: what the fit says of the next press.

`presses` in parameters.yaml::

    presses:
      number: 9
      sd: 0.031        # of ln area, from press to press
      drift_sd: 0.006  # of ln area, within 1 s of a press
      slope_sd: 0.008  # of the exponent of area over force, from press to press

Without this key the estimator's settings serve: `prior_area_sd`, `contact_area_sd`, `drift_sd` and
`slope_sd`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from finger_common.errors import InputError
from finger_common.files import number

LEAST_PRESSES = 4
"""Presses of which a scatter is told: below, Student's t has no variance."""
LEAST_SD = 0.01
"""Scatter from press to press below which few presses cannot show that it is smaller."""
MISFIT_MEMORY = 0.3
"""s over which what a model cannot describe stays alike; an assumption."""
MOST_FRAMES = 150
"""Frames of a press that are compared: its length tells drift and slope, not how many there are."""

_DRIFTS = 0.04 * 0.5 ** np.arange(6)
_SLOPES = 0.032 * 0.5 ** np.arange(6)
"""Deviations that are compared, up to the double of the estimator's settings."""


@dataclass(frozen=True)
class PressResiduals:
    """One press beside its model: time (k,) in s, residual (k,) of the area over the model's, its
    deviation (k,) by the camera, and log_force (k,)."""

    time: np.ndarray
    residual: np.ndarray
    noise: np.ndarray
    log_force: np.ndarray


@dataclass(frozen=True)
class PressScatter:
    """Number of presses and how they differ; see the module."""

    number: int
    sd: float
    drift_sd: float
    slope_sd: float

    @property
    def margin(self) -> float:
        """Variance of Student's t: the scatter of few presses is not known exactly."""
        return (self.number - 1) / (self.number - 3)

    def to_dict(self) -> dict[str, Any]:
        """As the key `presses` of parameters.yaml."""
        return asdict(self)

    @classmethod
    def parse(cls, data: Any, where: str) -> PressScatter:
        """From the key `presses`; raises InputError naming `where` and key."""
        if not isinstance(data, dict):
            raise InputError(f"{where}: 'presses' needs 'key: value' lines; see docs/people.md")
        count = number(data, "number", where)
        if count < LEAST_PRESSES or count != int(count):
            raise InputError(
                f"{where}: 'number' of 'presses' is {count:g}, a whole number of {LEAST_PRESSES} "
                "or more is needed; correct it or leave 'presses' out"
            )
        found = [number(data, name, where) for name in ("sd", "drift_sd", "slope_sd")]
        if min(found) < 0 or found[0] == 0:
            raise InputError(
                f"{where}: a deviation of 'presses' is negative, or 'sd' is zero; correct it"
            )
        return cls(int(count), *found)


def press_scatter(presses: Sequence[PressResiduals], misfit: float) -> PressScatter | None:
    """What residuals of a fit tell of the presses; None for fewer than LEAST_PRESSES.

    misfit: deviation of what the model cannot describe. Drift and slope are the means of their
    variances over the likelihood of the residuals, camera and misfit taken off.
    """
    if len(presses) < LEAST_PRESSES:
        return None
    factors, own = [], []
    for press in presses:
        weight = press.noise**-2
        factors.append(weight @ press.residual / weight.sum())
        own.append(1.0 / weight.sum())
    spread = np.sum(np.square(factors)) / (len(presses) - 1) - np.mean(own)
    sd = max(float(np.sqrt(max(spread, 0.0))), LEAST_SD)
    likelihood = np.zeros((len(_DRIFTS), len(_SLOPES)))
    for press in presses:
        likelihood += _likelihood(press, sd, misfit)
    weight = np.exp(likelihood - likelihood.max())
    weight /= weight.sum()
    drift = float(np.sqrt(weight.sum(1) @ _DRIFTS**2))
    slope = float(np.sqrt(weight.sum(0) @ _SLOPES**2))
    return PressScatter(len(presses), *(float(f"{v:.3g}") for v in (sd, drift, slope)))


def _likelihood(press: PressResiduals, sd: float, misfit: float) -> np.ndarray:
    """Logarithm of the likelihood of one press for _DRIFTS × _SLOPES."""
    taken = slice(None, None, -(-len(press.time) // MOST_FRAMES))
    time, log_force = press.time[taken], press.log_force[taken]
    residual, noise = press.residual[taken], press.noise[taken]
    apart = np.abs(time[:, None] - time[None, :])
    since = time - time[0]
    fixed = np.diag(noise**2) + sd**2 + misfit**2 * np.exp(-apart / MISFIT_MEMORY)
    walk = np.minimum(since[:, None], since[None, :])
    tilt = np.outer(log_force, log_force)
    found = np.empty((len(_DRIFTS), len(_SLOPES)))
    for i, drift in enumerate(_DRIFTS):
        for j, slope in enumerate(_SLOPES):
            root = np.linalg.cholesky(fixed + drift**2 * walk + slope**2 * tilt)
            white = solve_triangular(root, residual, lower=True)
            found[i, j] = -0.5 * (white @ white) - np.log(np.diag(root)).sum()
    return found
