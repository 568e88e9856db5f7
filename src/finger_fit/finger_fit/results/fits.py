# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit found: plain data for files, the report and programs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from finger_common.subject_code import may_be_one

from ..uncertainty import (
    NORMAL_95,
    BiasCorrected,
    Covariance,
    Goodness,
    Profile,
    shifted_interval,
    student_95,
)

if TYPE_CHECKING:
    from finger_model.fem.fields import Fields
    from finger_model.geometry import Geometry
    from finger_model.history import ContactPoint
    from finger_model.laws import ParameterSpace

    from ..full_order import Correction, FullOrderCheck
    from ..nuisance.result import NuisanceResult
    from ..options import FitOptions
    from ..problem import Exclusion, FitProblem, FitTrial, PowerLaw
    from ..search import LocalFit, Search
    from .contrasts import Contrast
    from .indentation import IndentationFit
    from .quality import Quality


def codes_of(trials: Iterable[FitTrial]) -> str:
    """Codes of the subjects of trials, with commas between."""
    return ", ".join(sorted({trial.subject for trial in trials if trial.subject}))


class Finger(NamedTuple):
    """Whose finger: code of the subject, and name such as right_index, empty where it was not
    noted."""

    subject: str
    name: str


@dataclass(frozen=True)
class CrossCheck:
    """Another optimiser on the same problem: its own best, and its J before and after the
    polish."""

    name: str
    parameters: np.ndarray
    cost: float
    polished_cost: float
    agrees: bool


NO_INTERVAL = (math.nan, math.nan)


@dataclass(frozen=True)
class QuantityResult:
    """What a fit found of one parameter or derived quantity (SI; deviations: of its logarithm).

    interval: 95 % with all that is unknown, inside the search box: by the profile, without one by
    the covariance. data_interval: from the data alone, as if the lengths of the finger and the gain
    of all areas were those of this fit; by the profile, without one of the logarithm, symmetric,
    with Student's t for one degree of freedom less than trials. cut, data_cut: whether their low
    and their high end is that of the box. bootstrap: 95 % percentiles. identifiable: None
    without a profile. sd, data_sd: with all that is unknown, and from the data alone; assumed_sd:
    what the assumed lengths and the gain of all areas add (as squares); assumed: change of the
    logarithm by one prior deviation of each. bias: None without bias pairs; corrected_interval: of
    its value, by the profile. Ends are NaN where there is no interval, deviations without
    covariance.
    """

    value: float
    interval: tuple[float, float]
    cut: tuple[bool, bool]
    data_interval: tuple[float, float]
    data_cut: tuple[bool, bool]
    bootstrap: tuple[float, float]
    identifiable: bool | None
    sd: float
    data_sd: float
    assumed_sd: float
    assumed: dict[str, float]
    bias: BiasCorrected | None
    corrected_interval: tuple[float, float]


@dataclass
class ConditionFit:
    """Everything that the fit of one condition found (SI, J in m⁴).

    parameters (N,): the result; cost: its J; objective: what was minimised, J with the nuisances
    eliminated (`problem.Goal`) and with the measured indentations; nuisance, indentation: None
    without. pso: the search alone; polish: the local least squares of J, None without. top (C, N),
    top_costs (C,): best distinct candidates. bias_corrected: empty without bias pairs; samples (B,
    N): bootstrap. areas (n,): the model's areas (m²) at the frames; goodness: R² there; curves: at
    every step of each trial's drive. status: "final", "not checked", "not final" or "interrupted",
    with reasons. unsaved: why a checkpoint lacks rounds, empty where all are whole.
    """

    condition: str
    problem: FitProblem
    parameters: np.ndarray
    cost: float
    grid: Search
    pso: Search
    power_law: PowerLaw
    polish: LocalFit | None = None
    top: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    top_costs: np.ndarray = field(default_factory=lambda: np.empty(0))
    full_order: FullOrderCheck | None = None
    correction: Correction | None = None
    cross_checks: list[CrossCheck] = field(default_factory=list)
    covariance: Covariance | None = None
    profiles: dict[str, Profile] = field(default_factory=dict)
    bias_corrected: dict[str, BiasCorrected] = field(default_factory=dict)
    samples: np.ndarray | None = None
    areas: np.ndarray = field(default_factory=lambda: np.empty(0))
    goodness: Goodness | None = None
    curves: list[np.ndarray] = field(default_factory=list)
    nuisance: NuisanceResult | None = None
    objective: float = float("nan")
    status: str = "not checked"
    reasons: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    quality: Quality | None = None
    indentation: IndentationFit | None = None
    unsaved: str = ""

    @property
    def space(self) -> ParameterSpace:
        """The space of the parameters."""
        return self.problem.space

    def quantity(self, name: str) -> float:
        """A fitted parameter or derived quantity (SI)."""
        return float(self.space.quantity(name, self.parameters))

    @property
    def moisture(self) -> tuple[float, float]:
        """Mean and standard deviation of the trials' moisture (a.u.)."""
        values = np.array([t.moisture for t in self.problem.trials])
        values = values[np.isfinite(values)]
        if not len(values):
            return float("nan"), float("nan")
        return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0

    @property
    def largest_force(self) -> float:
        """Largest force (N) of the trials."""
        return max(float(trial.force.max()) for trial in self.problem.trials)

    @property
    def full_order_cost(self) -> float:
        """J (m⁴) of the full-order areas at the result; NaN where they were not computed."""
        if self.full_order is None:
            return math.nan
        return float(self.problem.trial_costs(self.full_order.areas[0]).sum())

    def found(self, name: str) -> QuantityResult:
        """Collect what the fit says of a parameter or derived quantity."""
        known, profile = self.covariance, self.profiles.get(name)
        bias = self.bias_corrected.get(name)
        bootstrap = interval = data_interval = NO_INTERVAL
        if self.samples is not None and len(self.samples):
            low, high = np.quantile(self.space.quantity(name, self.samples), [0.025, 0.975])
            bootstrap = float(low), float(high)
        data_sd = assumed_sd = math.nan
        if known is not None:
            data_sd, assumed_sd = known.data_deviation(name), known.assumed_deviation(name)
            reach = student_95(len(self.problem)) * data_sd
            data_interval = self._around(name, reach)
            interval = self._around(name, float(np.hypot(reach, NORMAL_95 * assumed_sd)))
        cut = self._cut(name, interval)
        if profile is not None:
            interval, data_interval = profile.interval, profile.data_interval
            cut = profile.open_low, profile.open_high
        return QuantityResult(
            self.quantity(name),
            interval,
            cut,
            data_interval,
            self._cut(name, data_interval),
            bootstrap,
            None if profile is None else profile.identifiable,
            float(np.hypot(data_sd, assumed_sd)),
            data_sd,
            assumed_sd,
            {} if known is None else known.assumed_moves(name),
            bias,
            shifted_interval(profile, bias.bias) if profile and bias else NO_INTERVAL,
        )

    def _around(self, name: str, reach: float) -> tuple[float, float]:
        low, high = self.space.quantity_bounds(name, self.problem.box)
        offset = self.space.log_offset(name)
        ends = (self.quantity(name) + offset) * np.exp(np.array([-reach, reach])) - offset
        return float(max(ends[0], low)), float(min(ends[1], high))

    def _cut(self, name: str, ends: tuple[float, float]) -> tuple[bool, bool]:
        """Whether the low and the high end of an interval is that of the search box."""
        low, high = self.space.quantity_bounds(name, self.problem.box)
        rounding = 1e-9 * (high - low)
        return bool(ends[0] <= low + rounding), bool(ends[1] >= high - rounding)

    def covariance_log(self, assumed: bool = True) -> np.ndarray:
        """Covariance (N, N) of the coordinates: of the bootstrap if there is one, else of J.

        With nuisances that of their fit, for no resampling of the presses shows what they share.
        assumed: with what the assumed lengths and the gain of all areas add.
        """
        if self.covariance is not None and self.nuisance is not None:
            return self.covariance.covariance if assumed else self.covariance.data_covariance()
        if self.samples is not None and len(self.samples) > 10:
            return np.cov(self.space.to_log(self.samples).T)
        if self.covariance is not None:
            return self.covariance.covariance
        return np.zeros((len(self.space), len(self.space)))

    def median_trial(self) -> int:
        """Index of the trial with the median cost."""
        costs = self.problem.trial_costs(self.areas)
        return int(np.argsort(costs, kind="stable")[len(costs) // 2])


@dataclass(frozen=True)
class AssumedLengths:
    """Lengths of a finger as a fit assumed them.

    deviations: standard deviations (m) by key of geometry.yaml, of those that the intervals allow
    for; source: what gave the lengths, empty for the default finger, which nobody measured.
    """

    geometry: Geometry
    deviations: dict[str, float]
    source: str

    @classmethod
    def of(cls, fits: Iterable[ConditionFit]) -> list[AssumedLengths]:
        """Those of all fits, each once."""
        found: list[AssumedLengths] = []
        for problem in (fit.problem for fit in fits):
            geometry = getattr(problem.model, "geometry", None)
            if geometry is None:
                continue
            lengths = geometry.to_dict()
            relative = problem.lengths if problem.options.nuisances else {}
            deviations = {name: sd * abs(lengths[name]) for name, sd in relative.items()}
            own = cls(geometry, deviations, problem.known.source)
            if own not in found:
                found.append(own)
        return found

    @property
    def words(self) -> str:
        """Where the lengths come from."""
        return f"given by {self.source}" if self.source else "default finger, not measured"

    def to_dict(self) -> dict[str, Any]:
        """Lengths and deviations (m) for fit.json, with the words of where they come from."""
        return {
            "source": self.words,
            "lengths": self.geometry.to_dict(),
            "deviations": self.deviations,
        }


@dataclass(frozen=True)
class DeformedFinger:
    """The full-order finger of one trial at its largest force (SI), for a figure.

    strain (E,): half the difference of an element's principal in-plane stretches.
    """

    geometry: Geometry
    fields: Fields
    strain: np.ndarray
    contact: ContactPoint


@dataclass
class FitResult:
    """A whole fit: conditions in order of moisture, exclusions, provenance and time spent (s).

    lost: bags of which something could not be read.
    shared, thickness: the additional fits that were asked for; force_modes: per condition and mode
    of the force, J (mm⁴) and the headline quantity; deformed: for the report's example trial.
    subjects: of several subjects, the result of each; `fits` then holds all of them, named "SUBJECT
    CONDITION". contrasts: between the conditions of a subject. stopped: interrupted; missing:
    conditions and subjects that were not begun then, or are lost for a reason that is not their
    data.
    """

    options: FitOptions
    fits: dict[str, ConditionFit]
    exclusions: list[Exclusion]
    problems: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    sources: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    shared: Any = None
    thickness: Any = None
    force_modes: dict[str, dict[str, Any]] = field(default_factory=dict)
    deformed: DeformedFinger | None = None
    output: Path | None = None
    subjects: dict[str, FitResult] = field(default_factory=dict)
    contrasts: list[Contrast] = field(default_factory=list)
    stopped: bool = False
    missing: list[str] = field(default_factory=list)

    @property
    def space(self) -> ParameterSpace:
        """The space of the parameters, the same in all conditions."""
        return next(iter(self.fits.values())).space

    @property
    def model(self) -> Any:
        """The model that was fitted, the same in all conditions of a subject."""
        return next(iter(self.fits.values())).problem.model

    @property
    def model_error(self) -> dict[str, Any]:
        """What the reduced model's file states of its error with the parameters and forces of the
        fits, of that one where it is largest; empty for other models."""
        if not hasattr(self.model, "error_of"):
            return {}
        models: list[tuple[Any, ConditionFit]] = [(f.problem.model, f) for f in self.fits.values()]
        stated = [model.error_of(f.parameters, f.largest_force) for model, f in models]
        return max(stated, key=lambda error: error.get("rms_p99", 0.0))

    @property
    def assumed_finger(self) -> AssumedLengths | None:
        """Lengths that were assumed of the finger; None where subjects have several, and of a model
        without."""
        found = AssumedLengths.of(self.fits.values())
        return found[0] if len(found) == 1 else None

    @property
    def interrupted(self) -> bool:
        """Whether the fit was stopped, or is without a condition that its data allow."""
        return self.stopped or bool(self.unfinished)

    @property
    def unfinished(self) -> list[str]:
        """Conditions and subjects that were interrupted, or are missing."""
        cut = [name for name, fit in self.fits.items() if fit.status == "interrupted"]
        return [*cut, *self.missing]

    @property
    def finger(self) -> Finger:
        """Subject and finger of all trials; nobody's where they are of several."""
        trials = [trial for fit in self.fits.values() for trial in fit.problem.trials]
        codes, fingers = {t.subject for t in trials}, sorted({t.finger for t in trials})
        if len(codes) != 1 or not may_be_one(*fingers):
            return Finger("", "")
        return Finger(codes.pop(), max(fingers, key=len))

    @property
    def parts(self) -> dict[str, FitResult]:
        """The result of each subject; of a single one this result, with an empty name."""
        return self.subjects or {"": self}

    def example(self) -> tuple[ConditionFit, int]:
        """The condition in the middle, and the index of its trial of median cost."""
        fits = list(self.fits.values())
        fit = fits[len(fits) // 2]
        return fit, fit.median_trial()
