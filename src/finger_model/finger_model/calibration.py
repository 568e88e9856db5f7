# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Calibrate a subject: from a few presses under the camera to the finger's own `prior`.

    model, lengths = subject_model(load_reduced(), estimate_geometry(0.017, 0.011))
    found = calibrate(model, ParameterSets.default(), presses, moisture=64.0, lengths=lengths)
    found.sets.save("subjects/S01.yaml")

What is fitted are the finger states of the estimator (`finger_prior.COORDINATES`), so that the
result is what the estimator begins with. All areas of all presses enter at once, by Gauss and
Newton from the distribution of the sets, about the model at the states found so far:

    A = A_model exp(h x − s w₀) (1 + g + m) + n

The model is that of the finger's own lengths where calipers measured it (`subject_model`). They
stay as given; what they leave unknown widens the deviations of the tissue. So does what the model
leaves out of a finger, such as stiffening and further branches (`STRUCTURE_SD`).

g is the press's own factor, m what the states cannot describe (with a memory of 0.3 s), n the noise
of the camera. The deviation of g is that of the population, or that of the presses if they scatter
more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from finger_common.errors import InputError

from .anthropometry import GeometryEstimate
from .estimator import EstimatorSettings
from .estimator.area_filter import TISSUE
from .estimator.parameter_selection import check_sets, select_parameters
from .estimator.perturbed_finger import PerturbedFinger
from .estimator.sensitivities import SHIFT_LIMITS
from .finger import load_reduced
from .finger_prior import COORDINATES, FingerPrior
from .geometry import Geometry
from .parameter_sets import ParameterSets
from .people import People
from .pose.correction import PoseCorrection
from .press_scatter import MISFIT_MEMORY, PressResiduals, press_scatter
from .reduced.model import ReducedModel, load_population

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
MOST_SCATTER = 0.15
"""Relative deviation from press to press above which the presses are not those of one finger."""
DOUBTFUL_SCATTER = 0.08
"""The same, above which the result asks whether they are: as of areas that differ by a fifth."""
STRUCTURE_SD = {
    False: {"stiffness": 1.32, "time": 0.66, "creep": 0.55},
    True: {"stiffness": 0.95, "time": 0.57, "creep": 0.46},
}
"""By whether calipers measured the finger: how far (RMS, of the natural logarithm) the states of
the tissue are from its long-term modulus, mean creep time and creep, beside their own deviations.
The model has one branch, does not stiffen, and without calipers has the lengths of the finger in
use. For people of data/people.yaml, by
`python scripts/calibration_fingers.py --tissue --fingers 100 --seed 77`."""

_FACTORS = (
    "factors of a like finger that has one branch and does not stiffen, in brackets the range (one "
    "deviation) of this finger's own tissue"
)
_ROUNDS = 30
_CONVERGED = 2e-3
_LARGEST_STEP = 0.7
_SMALLEST_STEP = 1e-9
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

    unit: "" for a factor over the shipped finger. The deviation of a factor is that of its natural
    logarithm, times the factor.
    """

    name: str
    value: float
    deviation: float
    unit: str = ""
    meaning: str = ""

    def text(self) -> str:
        """With its interval of one deviation, of a factor even in the logarithm."""
        if self.unit:
            return f"{self.meaning} {self.value:.3g} ± {self.deviation:.2g} {self.unit}"
        ratio = math.exp(self.deviation / self.value)
        low, high = self.value / ratio, self.value * ratio
        return f"{self.meaning} {self.value:.3g} ({low:.2g} to {high:.2g})"


@dataclass(frozen=True)
class Calibration:
    """What the presses tell of a finger.

    sets: with the finger's own prior. quantities: for people; the factors are those of a finger
    with one branch that does not stiffen, their deviations those of this finger's own tissue.
    press_scatter: relative deviation of the area from press to press. residual: what is left within
    the presses, relative. areas: used. note: which lengths of the finger were taken.
    """

    sets: ParameterSets
    quantities: tuple[Quantity, ...]
    press_scatter: float
    residual: float
    presses: int
    areas: int
    note: str = ""

    def sentence(self) -> str:
        """The result in one line."""
        shown = "; ".join(quantity.text() for quantity in self.quantities)
        doubt = ""
        if self.press_scatter > DOUBTFUL_SCATTER:
            doubt = ", more than is usual: was it the same part of the same finger each time?"
        return (
            f"{shown}; {_FACTORS}; presses differ by {100 * self.press_scatter:.1f} %{doubt} "
            f"({self.presses} presses, {self.areas} areas); {self.note}"
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

    def residuals(self, x: np.ndarray) -> PressResiduals:
        """What is left of them beside the finger at x (5,)."""
        predicted = self.predicted(x)
        left = self.area / predicted - 1.0
        return PressResiduals(self.time, left, self.sd / predicted, self.h[:, 1])


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


def on_level_plate(
    presses: Sequence[CalibrationPress], model: ReducedModel, pose: PoseCorrection
) -> list[CalibrationPress]:
    """The presses with the areas of a round pad on a level plate, from those of a pad in a pose.

    model: of the finger; pose: gives aspect, tilt and skin. The estimate takes the pose into
    account by itself, so that the finger's own numbers must be without it.
    """
    own = PoseCorrection(model.geometry, pose.pose, pose.skin_ratio)
    found = []
    for press in presses:
        area = np.array([own.round_area(a) if a > 0.0 else a for a in press.area.tolist()])
        share = np.divide(area, press.area, out=np.ones_like(area), where=press.area > 0.0)
        found.append(replace(press, area=area, area_sd=press.area_sd * share))
    return found


@dataclass(frozen=True)
class Lengths:
    """What is known of the lengths of a subject's finger.

    deviations: standard deviations (m) by the keys of geometry.yaml, empty without calipers.
    note: a sentence on what was taken.
    """

    deviations: Mapping[str, float] = field(default_factory=dict)
    note: str = "without calipers: lengths of the finger in use"


def subject_model(
    model: ReducedModel, calipers: GeometryEstimate | None, sets: ParameterSets | None = None
) -> tuple[ReducedModel, Lengths]:
    """The model of a finger that calipers measured, and what they leave unknown of it.

    sets: the parameters in use, None for the shipped ones. Without calipers, for a finger outside
    the population box, and with parameters that were fitted for lengths of their own, the model is
    `model`.
    """
    if calipers is None:
        return model, Lengths()
    if sets is not None and sets.geometry_hash not in ("", calipers.geometry.hash()):
        fitted = f"{calipers.measured}: not used, the parameters in use are of one finger's lengths"
        return model, Lengths(note=fitted)
    try:
        own = load_reduced(geometry_file=calipers.geometry)
    except InputError:
        outside = f"{calipers.measured}: outside the population box; lengths of the finger in use"
        return model, Lengths(note=outside)
    return own, Lengths(calipers.deviations, f"lengths from {calipers.measured}")


def calibrate(
    model: ReducedModel,
    sets: ParameterSets,
    presses: Sequence[CalibrationPress],
    moisture: float | None = None,
    settings: EstimatorSettings | None = None,
    lengths: Lengths | None = None,
) -> Calibration:
    """Fit a finger to its presses, in the order they were made.

    sets: what is known of people; the result are these sets with another `prior`. moisture: reading
    at the presses in a.u., None where there was none. lengths: what is known of those of the
    model's finger. Raises InputError for too few usable presses, and for presses that differ more
    than those of one finger.
    """
    check_sets(sets, model)
    settings, lengths = settings or EstimatorSettings(), lengths or Lengths()
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
    error = model.rms_error_of(selected.parameters, max(float(p.force.max()) for p in good))
    scatter, misfit = People.default().press_gain, max(prior.misfit_sd, error)
    problem = _Problem(model, selected.constants, good, own, mean, inverse, misfit)
    fit = _solve(problem, scatter)
    if fit.spread > MOST_SCATTER:
        raise InputError(
            f"the presses differ by {100 * fit.spread:.0f} %, more than those of one finger: press "
            "with the same part of the same finger each time, on a clean plate, and calibrate again"
        )
    found = own @ fit.x
    uncertain = own @ np.linalg.inv(fit.information) @ own.T
    uncertain = 0.5 * (uncertain + uncertain.T)
    answers = problem.answers(fit, selected.parameters, lengths.deviations)
    assumed = own @ np.linalg.solve(fit.information, answers)
    base = sets.prior or FingerPrior((), (), misfit, 0.0, 0.0)
    own_prior = replace(base, mean=_rounded(found), covariance=tuple(map(_rounded, uncertain)))
    residuals = [press.residuals(found) for press in fit.areas]
    structure = STRUCTURE_SD[bool(lengths.deviations)]
    return Calibration(
        sets.with_prior(own_prior, model.geometry, press_scatter(residuals, misfit)),
        _quantities(model, selected.constants, found, uncertain, assumed, structure),
        fit.spread,
        float(np.sqrt(np.mean(fit.left**2))),
        len(good),
        sum(len(press.area) for press in good),
        lengths.note,
    )


def _rounded(values: np.ndarray) -> tuple[float, ...]:
    """With the digits that a file has."""
    return tuple(float(f"{value:.6g}") for value in values)


@dataclass(frozen=True)
class _Problem:
    """Least squares of the areas over x (6,): the finger's states and the moisture's error.

    own (5, 6): what x makes of the states; mean (6,), inverse (6, 6): of x before.
    """

    model: ReducedModel
    base: np.ndarray
    presses: Sequence[CalibrationPress]
    own: np.ndarray
    mean: np.ndarray
    inverse: np.ndarray
    misfit: float

    @staticmethod
    def step(x: np.ndarray, information: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Best step (6,) from x of at most _LARGEST_STEP, the tissue held in the model's range.

        Gain and stiffness move along a ridge: a step that is cut in one of them alone leads uphill.
        """
        from scipy.optimize import lsq_linear  # a third of a second to import

        low, high = np.full(len(x), -_LARGEST_STEP), np.full(len(x), _LARGEST_STEP)
        limits = 1.5 * np.array(SHIFT_LIMITS)
        low[TISSUE] = np.minimum(np.maximum(low[TISSUE], -limits - x[TISSUE]), -_SMALLEST_STEP)
        high[TISSUE] = np.maximum(np.minimum(high[TISSUE], limits - x[TISSUE]), _SMALLEST_STEP)
        root = np.linalg.cholesky(information)
        return lsq_linear(root.T, np.linalg.solve(root, gradient), (low, high)).x

    def follow(self, x: np.ndarray) -> list[_Areas]:
        """The presses beside the model of the finger at x."""
        return _follow(self.model, self.base, x[TISSUE], self.presses)

    def slope(self, x: np.ndarray, press: _Areas) -> np.ndarray:
        """Derivatives (k, 6) of the areas of a press."""
        return press.predicted(self.own @ x)[:, None] * (press.h @ self.own)

    def linearised(
        self, x: np.ndarray, areas: Sequence[_Areas], scatter: float
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Information (6, 6), gradient (6,), and the weight (k, k) of each press."""
        information, gradient, weights = self.inverse.copy(), self.inverse @ (self.mean - x), []
        for press in areas:
            predicted, slope = press.predicted(self.own @ x), self.slope(x, press)
            weight = np.linalg.inv(_covariance(press, predicted, scatter, self.misfit))
            information += slope.T @ weight @ slope
            gradient += slope.T @ weight @ (press.area - predicted)
            weights.append(weight)
        return information, gradient, weights

    def cost(self, x: np.ndarray, areas: Sequence[_Areas], weights: Sequence[np.ndarray]) -> float:
        """What is minimised, at given weights."""
        off = x - self.mean
        left = [press.area - press.predicted(self.own @ x) for press in areas]
        return float(off @ self.inverse @ off + sum(r @ w @ r for r, w in zip(left, weights)))

    def answers(
        self, fit: _Solution, parameters: np.ndarray, deviations: Mapping[str, float]
    ) -> np.ndarray:
        """Gradient (6, m) by one deviation of each length; x moves by information⁻¹ times it.

        Lengths that the reduced model of all fingers does not vary are left out.
        """
        found, x = [], fit.x
        geometry = self.model.geometry
        here = self._logarithms(x, geometry, parameters) if deviations else None
        for name, deviation in deviations.items():
            for sign in (1.0, -1.0):
                changed = {name: getattr(geometry, name) + sign * deviation}
                try:
                    there = self._logarithms(x, replace(geometry, **changed), parameters)
                except InputError:
                    continue
                assert here is not None
                total = np.zeros(len(x))
                for press, weight, a, b in zip(fit.areas, fit.weights, here, there):
                    change = press.predicted(self.own @ x) * (b - a)
                    total += self.slope(x, press).T @ weight @ change
                found.append(total)
                break
        return np.array(found).reshape(-1, len(x)).T

    def _logarithms(
        self, x: np.ndarray, geometry: Geometry, parameters: np.ndarray
    ) -> list[np.ndarray]:
        """Logarithms of the model's areas for another geometry of the population box."""
        model = load_population(geometry)
        areas = _follow(model, model.constants(parameters), x[TISSUE], self.presses)
        return [np.log(press.model) for press in areas]


@dataclass(frozen=True)
class _Solution:
    """x (6,) with the presses beside the model there, and of the step that led to it information
    (6, 6) and the weight (k, k) of each press.

    spread: relative deviation of the area from press to press; left (areas,): relative, of all
    areas within their presses.
    """

    x: np.ndarray
    areas: list[_Areas]
    information: np.ndarray
    weights: list[np.ndarray]
    spread: float
    left: np.ndarray


def _solve(problem: _Problem, scatter: float) -> _Solution:
    """Gauss and Newton's method from the mean; scatter: of presses of one finger, relative, in
    whose place that of these presses comes where it is larger."""
    x, settled = problem.mean.copy(), False
    areas = problem.follow(x)
    for _ in range(_ROUNDS):
        information, gradient, weights = problem.linearised(x, areas, scatter)
        before, present = x, problem.cost(x, areas, weights)
        step = problem.step(x, information, gradient)
        for halved in range(_HALVINGS):
            x = before + 0.5**halved * step
            areas = problem.follow(x)
            if problem.cost(x, areas, weights) <= present:
                break
        else:
            x, areas = before, problem.follow(before)
        factors, left = _factors(areas, problem.own @ x)
        spread = math.sqrt(np.sum(np.square(factors)) / max(len(problem.presses) - 2, 1))
        if np.abs(x - before).max() < _CONVERGED:
            if settled or spread <= scatter:
                break
            settled, scatter = True, spread
    return _Solution(x, areas, information, weights, spread, left)


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


def _follow(
    model: ReducedModel, base: np.ndarray, w: np.ndarray, presses: Sequence[CalibrationPress]
) -> list[_Areas]:
    """The presses beside the model of a finger at w (3,), which creeps on between them."""
    perturbed = PerturbedFinger.at(model, base, w)
    found = []
    before = presses[0].time[0]
    for press in presses:
        steps = np.arange(press.time[0], press.time[-1], MODEL_STEP)
        time = np.union1d(steps, press.area_time)
        force = np.maximum(np.interp(time, press.time, press.force, 0.0, 0.0), 0.0)
        history = perturbed.run(before, time, force)
        before = time[-1]
        at = np.searchsorted(time, press.area_time)
        sensitivities = history.sensitivities[at]
        phi = np.log(np.maximum(force[at], SMALLEST_FORCE))
        found.append(
            _Areas(
                press.area_time,
                press.area,
                press.area_sd,
                np.maximum(history.area[at], SMALLEST_MODEL_AREA),
                np.column_stack([np.ones(len(at)), phi, sensitivities]),
                sensitivities @ perturbed.shift,
            )
        )
    return found


def _quantities(
    model: ReducedModel,
    base: np.ndarray,
    x: np.ndarray,
    covariance: np.ndarray,
    assumed: np.ndarray,
    structure: Mapping[str, float],
) -> tuple[Quantity, ...]:
    """The states as people read them: the area under 1 N, and factors over the shipped finger.

    covariance (5, 5): of x at given lengths; assumed (5, m): by how much one deviation of each
    length moves x; structure: as STRUCTURE_SD. The area is measured, whatever the finger is.
    """
    time = np.linspace(0.0, _REFERENCE_TIME, 101)
    force = _REFERENCE_FORCE * np.minimum(time / 0.2, 1.0)
    press = CalibrationPress(time, force, time[-1:], np.ones(1), np.ones(1))
    seen = _follow(model, base, x[TISSUE], [press])[0]
    area = float(seen.model[0] * math.exp(seen.h[0] @ x - seen.offset[0]))
    of_area = math.sqrt(seen.h[0] @ covariance @ seen.h[0])
    deviation = np.sqrt(np.diag(covariance + assumed @ assumed.T))
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
        own = math.hypot(deviation[at], structure[name])
        rows.append(Quantity(name, factor, factor * own, "", meaning))
    return tuple(rows)
