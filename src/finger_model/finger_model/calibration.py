# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Calibrate a subject: from a few presses under the camera to the finger's own `prior`.

    found = calibrate(ReducedModel.load(), ParameterSets.default(), presses, moisture=64.0)
    found.sets.save("subjects/S01.yaml")

What is fitted are the finger states of the estimator (`finger_prior.COORDINATES`), so that the
result is what the estimator begins with. All areas of all presses enter at once, by Gauss and
Newton from the distribution of the sets, about the model at the states found so far:

    A = A_model exp(h x − s w₀) (1 + g + m) + n

g is the press's own factor, m what the states cannot describe (with a memory of 0.3 s), n the noise
of the camera. The deviation of g is that of the population, or that of the presses if they scatter
more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError

from .estimator import EstimatorSettings, members
from .estimator.parameter_selection import check_sets, select_parameters
from .finger_prior import COORDINATES, FingerPrior
from .parameter_sets import ParameterSets
from .people import People
from .reduced.model import ReducedModel

LEAST_PRESSES = 4
"""Usable presses below which nothing is fitted."""
LEAST_AREAS = 2
"""Usable areas below which a press is not."""
SMALLEST_FORCE, SMALLEST_AREA = 0.05, 8e-6
"""N and m²: the areas of a touch that just begins are left out."""
SMALLEST_MODEL_AREA = 1e-7
"""m² of the model's finger in such an area, however far it is from the right one."""
MODEL_STEP = 0.01
"""s between instants at which the model follows the force."""
MISFIT_MEMORY = 0.3
"""s over which what the states cannot describe stays alike; an assumption."""
MOST_SCATTER = 0.15
"""Relative deviation from press to press above which the presses are not those of one finger."""

_ROUNDS = 30
_CONVERGED = 2e-3
_LARGEST_STEP = 0.7
_HALVINGS = 6
_SMALLEST_VARIANCE = 1e-6
"""Of a state that the sets hold for known."""
_STATES = len(COORDINATES)
_REFERENCE_FORCE, _REFERENCE_TIME = 1.0, 1.0


@dataclass(frozen=True)
class CalibrationPress:
    """One press as it was measured.

    time (n,) in s and normal force (n,) in N, from before the touch to after the release;
    area_time (k,) in s on the same clock, area and area_sd (k,) in m²: usable ones alone.
    """

    time: np.ndarray
    force: np.ndarray
    area_time: np.ndarray
    area: np.ndarray
    area_sd: np.ndarray


@dataclass(frozen=True)
class Quantity:
    """A number of the result with its standard deviation.

    unit: "" for a factor over the shipped finger.
    """

    name: str
    value: float
    deviation: float
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True)
class Calibration:
    """What the presses tell of a finger.

    sets: with the finger's own prior. quantities: for people. press_scatter: relative deviation of
    the area from press to press. residual: what is left within the presses, relative. areas: used.
    """

    sets: ParameterSets
    quantities: tuple[Quantity, ...]
    press_scatter: float
    residual: float
    presses: int
    areas: int

    def sentence(self) -> str:
        """The result in one line."""
        shown = "; ".join(
            f"{q.meaning} {q.value:.3g} ± {q.deviation:.2g} {q.unit}".strip()
            for q in self.quantities
        )
        return (
            f"{shown}; presses differ by {100 * self.press_scatter:.1f} % "
            f"({self.presses} presses, {self.areas} areas)"
        )


@dataclass(frozen=True)
class _Areas:
    """The areas of one press beside the model: rows h (k, 5), ln-areas of the model, and more."""

    time: np.ndarray
    area: np.ndarray
    sd: np.ndarray
    model: np.ndarray
    h: np.ndarray
    offset: np.ndarray

    def predicted(self, x: np.ndarray) -> np.ndarray:
        """Areas (k,) of the finger at x (5,)."""
        return self.model * np.exp(self.h @ x - self.offset)


def usable(presses: Sequence[CalibrationPress]) -> list[CalibrationPress]:
    """Presses with enough areas; raises InputError when there are too few of them."""
    found = []
    for press in presses:
        force = np.interp(press.area_time, press.time, press.force, 0.0, 0.0)
        good = (force > SMALLEST_FORCE) & (press.area > SMALLEST_AREA) & (press.area_sd > 0)
        good &= np.isfinite(press.area) & np.isfinite(press.area_sd)
        if np.count_nonzero(good) >= LEAST_AREAS:
            columns = press.area_time[good], press.area[good], press.area_sd[good]
            found.append(CalibrationPress(press.time, press.force, *columns))
    if len(found) < LEAST_PRESSES:
        raise InputError(
            f"{len(found)} of {len(presses)} presses have {LEAST_AREAS} usable areas or more, "
            f"{LEAST_PRESSES} are needed: check camera, light and plate, and press again"
        )
    return found


def calibrate(
    model: ReducedModel,
    sets: ParameterSets,
    presses: Sequence[CalibrationPress],
    moisture: float | None = None,
    settings: EstimatorSettings | None = None,
) -> Calibration:
    """Fit a finger to its presses, in the order they were made.

    sets: what is known of people; the result are these sets with another `prior`. moisture: reading
    at the presses in a.u., None where there was none. Raises InputError for too few usable presses,
    and for presses that differ more than those of one finger.
    """
    check_sets(sets, model)
    settings = settings or EstimatorSettings()
    good = usable(presses)
    selected = select_parameters(model, sets, settings, moisture)
    prior = selected.prior
    # The error of the moisture is fitted beside the finger, and then taken for the finger's own.
    own = np.column_stack([np.eye(_STATES), prior.moisture_direction])
    mean = np.append(prior.mean, 0.0)
    covariance = np.zeros((_STATES + 1, _STATES + 1))
    covariance[:_STATES, :_STATES] = prior.covariance
    covariance[_STATES, _STATES] = prior.moisture_variance
    inverse = np.linalg.inv(covariance + _SMALLEST_VARIANCE * np.eye(_STATES + 1))
    scatter, misfit = People.default().press_gain, max(prior.misfit_sd, model.rms_error)
    limits = 1.5 * np.array(members.LIMITS)
    x, settled = mean.copy(), False
    areas = _follow(model, selected.constants, x[2:_STATES], good)
    for _ in range(_ROUNDS):
        information, gradient, weights = inverse.copy(), inverse @ (mean - x), []
        for press in areas:
            predicted = press.predicted(own @ x)
            weights.append(np.linalg.inv(_covariance(press, predicted, scatter, misfit)))
            slope = predicted[:, None] * (press.h @ own)
            information += slope.T @ weights[-1] @ slope
            gradient += slope.T @ weights[-1] @ (press.area - predicted)

        def cost(at: np.ndarray, seen: Sequence[_Areas], weights: Sequence[np.ndarray]) -> float:
            residuals = [press.area - press.predicted(own @ at) for press in seen]
            return float(
                (at - mean) @ inverse @ (at - mean)
                + sum(r @ weight @ r for r, weight in zip(residuals, weights))
            )

        step = np.clip(np.linalg.solve(information, gradient), -_LARGEST_STEP, _LARGEST_STEP)
        before, present = x, cost(x, areas, weights)
        for halved in range(_HALVINGS):
            x = before + 0.5**halved * step
            x[2:_STATES] = np.clip(x[2:_STATES], -limits, limits)
            areas = _follow(model, selected.constants, x[2:_STATES], good)
            if cost(x, areas, weights) <= present:
                break
        factors, left = _factors(areas, own @ x)
        spread = math.sqrt(np.sum(np.square(factors)) / max(len(good) - 2, 1))
        if np.abs(x - before).max() < _CONVERGED:
            if settled or spread <= scatter:
                break
            settled, scatter = True, spread
    if spread > MOST_SCATTER:
        raise InputError(
            f"the presses differ by {100 * spread:.0f} %, more than those of one finger: press "
            "with the same part of the same finger each time, on a clean plate, and calibrate again"
        )
    found = own @ x
    uncertain = own @ np.linalg.inv(information) @ own.T
    uncertain = 0.5 * (uncertain + uncertain.T)
    base = sets.prior
    own_prior = FingerPrior(
        tuple(float(f"{v:.6g}") for v in found),
        tuple(tuple(float(f"{v:.6g}") for v in row) for row in uncertain),
        misfit if base is None else base.misfit_sd,
        0.0 if base is None else base.moisture_sd,
        0.0 if base is None else base.reading_sd,
    )
    return Calibration(
        sets.with_prior(own_prior, model.geometry_hash),
        _quantities(model, selected.constants, found, uncertain),
        spread,
        float(np.sqrt(np.mean(left**2))),
        len(good),
        sum(len(press.area) for press in good),
    )


def _factors(areas: Sequence[_Areas], x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each press's own factor of the area less one, and what is left of all areas, relative."""
    factors, left = [], []
    for press in areas:
        predicted = press.predicted(x)
        residual, share = press.area - predicted, predicted / press.sd
        factors.append(float(share @ (residual / press.sd) / (share @ share)))
        left.append(residual / predicted - factors[-1])
    return np.array(factors), np.concatenate(left)


def _covariance(press: _Areas, predicted: np.ndarray, scatter: float, misfit: float) -> np.ndarray:
    """Covariance (k, k) in m⁴ of the areas of one press about the prediction."""
    apart = np.abs(press.time[:, None] - press.time[None, :]) / MISFIT_MEMORY
    relative = scatter**2 + misfit**2 * np.exp(-apart)
    return np.diag(press.sd**2) + relative * np.outer(predicted, predicted)


def _members(
    model: ReducedModel, base: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Constants (4,) and states at rest (4,) of the finger at w (3,), scratch, and the members."""
    near = np.zeros(1, members.MEMBERS)
    members.shift_all(near, np.ascontiguousarray(w))
    constants = np.repeat(base, 1 + members.DIRECTIONS)
    finger = np.concatenate([model.state_at_rest(base)] * len(constants))
    # Apart from the model's own scratch, which a live estimator may be using.
    work = model.work.copy()
    members.place_all(model.networks, base, constants, finger, work, near)
    return constants, finger, work, near


def _follow(
    model: ReducedModel, base: np.ndarray, w: np.ndarray, presses: Sequence[CalibrationPress]
) -> list[_Areas]:
    """The presses beside the model of a finger at w (3,), which creeps on between them."""
    constants, finger, work, near = _members(model, base, w)
    found = []
    before = presses[0].time[0]
    for press in presses:
        steps = np.arange(press.time[0], press.time[-1], MODEL_STEP)
        time = np.union1d(steps, press.area_time)
        force = np.maximum(np.interp(time, press.time, press.force, 0.0, 0.0), 0.0)
        table = np.empty((len(time), 3 + 2 * members.DIRECTIONS))
        members.follow(
            model.networks, constants, finger, work, near.copy(), before, time, force, table
        )
        before = time[-1]
        at = np.searchsorted(time, press.area_time)
        sensitivities = table[at, 3 : 3 + members.DIRECTIONS]
        phi = np.log(np.maximum(force[at], SMALLEST_FORCE))
        found.append(
            _Areas(
                press.area_time,
                press.area,
                press.area_sd,
                np.maximum(table[at, 0], SMALLEST_MODEL_AREA),
                np.column_stack([np.ones(len(at)), phi, sensitivities]),
                sensitivities @ near["shift"][0],
            )
        )
    return found


def _quantities(
    model: ReducedModel, base: np.ndarray, x: np.ndarray, covariance: np.ndarray
) -> tuple[Quantity, ...]:
    """The states as people read them: the area under 1 N, and factors over the shipped finger."""
    time = np.linspace(0.0, _REFERENCE_TIME, 101)
    force = _REFERENCE_FORCE * np.minimum(time / 0.2, 1.0)
    press = CalibrationPress(time, force, time[-1:], np.ones(1), np.ones(1))
    seen = _follow(model, base, x[2:], [press])[0]
    area = float(seen.model[0] * math.exp(seen.h[0] @ x - seen.offset[0]))
    of_area = math.sqrt(seen.h[0] @ covariance @ seen.h[0])
    deviation = np.sqrt(np.diag(covariance))
    rows = [
        Quantity(
            "area_at_1N",
            1e6 * area,
            1e6 * area * of_area,
            "mm²",
            "area under 1 N",
        )
    ]
    meanings = {
        "stiffness": "moduli ×",
        "time": "creep times ×",
        "creep": "creep ×",
    }
    for name, meaning in meanings.items():
        at = COORDINATES.index(name)
        factor = math.exp(x[at])
        rows.append(Quantity(name, factor, factor * float(deviation[at]), "", meaning))
    return tuple(rows)
