# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The cost J of a parameter set on the frames that count, as in the paper.

J = Σ over trials of the mean over the trial's frames of (model area − measured area)², in m⁴
(reports: mm⁴). Where an indentation was measured, its rows (`indentation`) are added to what is
minimised, but not to J.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from finger_common.errors import InputError
from finger_common.files import sha256_of
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.laws import ConstitutiveLaw, ParameterSpace, StandardLinearSolid

from ..fingers import KnownLengths
from ..options import FitOptions
from .goal import Goal, Nuisances, losses
from .indentation import IndentationRows
from .outputs import in_rows, trial_outputs
from .trials import FitTrial

SMALLEST_FORCE = 0.05
"""N; areas under less are too small to compare."""


class DataError(InputError):
    """The trials of a condition allow no fit."""


class AreaModel(Protocol):
    """What a fit needs of a model: the space of its parameters, and areas.

    For trials with a measured indentation also `contacts`, as `ReducedModel` has it.
    """

    space: ParameterSpace

    def batch(
        self, parameters: np.ndarray, trials: Sequence[tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """Areas (P, f) in m² per trial, of parameters (P, D) in SI units.

        A trial is time (n,) in s, force (n,) in N and rows (f,), the samples whose area is wanted.
        """
        ...


def material_of(model: Any) -> ConstitutiveLaw | None:
    """Law and fixed properties of a model: its `material`, or the default law where the model
    states none and has its parameters; else None."""
    stated: ConstitutiveLaw | None = getattr(model, "material", None)
    if stated is None and model.space.names == StandardLinearSolid.PARAMETERS.names:
        return StandardLinearSolid()
    return stated


def force_limit_of(model: Any, parameters: np.ndarray) -> float:
    """Force (N) at which a model of parameters (D,) holds what is beyond; infinite without one."""
    limit = getattr(model, "force_limit", None)
    return math.inf if limit is None else float(limit(parameters))


@dataclass(frozen=True)
class AreaCorrection:
    """Factor that turns a model's areas (n) and indentations (q) into those of a better model, near
    some parameters.

    The logarithm of the factor is linear in the space's correction coordinates (logarithms):
    log_ratio (n + q,) at `centre` (D,), a parameter set, and slope (D, n + q).
    """

    space: ParameterSpace
    centre: np.ndarray
    log_ratio: np.ndarray
    slope: np.ndarray

    def factor(self, parameters: np.ndarray) -> np.ndarray:
        """Factor (P, n + q) for parameters (P, D)."""
        place = self.space.correction_coordinates
        away = np.atleast_2d(place(parameters)) - place(self.centre)
        return np.exp(self.log_ratio + away @ self.slope)


class FitProblem:
    """Trials of one condition, the model and the options: everything J depends on.

    known: of the lengths of the model's finger; by the model where it is left out. space: of the
    model's parameters; box (D, 2): the search box in SI units. Arrays over all
    frames, trial after trial: measured (n,) m², force (n,) N, trial_of (n,), weight (n,), which
    sums to one within a trial. correction: of the model's areas, None before the correction to
    full order. indentations: of the trials that have them, q rows; None without. row_trial (n +
    q,), row_weight (n + q,): of areas and indentations. area_noise: m², of a frame, by which
    indentations weigh. nuisances: eliminated from the cost, None before they were estimated. Calls
    are deterministic and safe from several threads.
    """

    def __init__(
        self,
        trials: Sequence[FitTrial],
        model: AreaModel,
        options: FitOptions,
        known: KnownLengths | None = None,
    ) -> None:
        self.trials = tuple(trials)
        self.model = model
        self.options = options
        self.known = known or KnownLengths.of_model(model)
        self.space: ParameterSpace = model.space
        self.box = options.box(self.space)
        self.measured = np.concatenate([t.area for t in self.trials])
        self.force = np.concatenate([t.frame_force for t in self.trials])
        lengths = [len(t.frames) for t in self.trials]
        self.trial_of = np.repeat(np.arange(len(lengths)), lengths)
        self.starts = np.concatenate([[0], np.cumsum(lengths)])
        raw = np.where(np.concatenate([t.low for t in self.trials]), options.low_force_weight, 1.0)
        if not raw.any():
            raise DataError(
                f"every frame of these trials lies below low_force {options.low_force:g} N, where "
                "frames weigh nothing; lower low_force or raise low_force_weight"
            )
        sums = np.add.reduceat(raw, self.starts[:-1])
        # A trial whose frames all have weight zero does not count.
        self.weight = raw / np.where(sums > 0, sums, 1.0)[self.trial_of]
        self.correction: AreaCorrection | None = None
        self.nuisances: Nuisances | None = None
        self.indentations = IndentationRows.of(self.trials, model, options.indentation_sd)
        self.weigh(TYPICAL_AREA_NOISE)

    def __len__(self) -> int:
        return len(self.trials)

    @property
    def lengths(self) -> dict[str, float]:
        """Relative deviation of each length of the finger that the fit allows for."""
        return self.options.lengths(self.known.deviations)

    def areas(self, parameters: np.ndarray) -> np.ndarray:
        """Areas (P, n) in m² at the frames that count, for parameters (P, D): the model's,
        corrected."""
        return self.corrected(parameters)[:, : len(self.measured)]

    def raw_areas(self, parameters: np.ndarray) -> np.ndarray:
        """Areas (P, n) in m² as of `areas`, without the correction."""
        return self.raw(parameters)[:, : len(self.measured)]

    def raw(self, parameters: np.ndarray) -> np.ndarray:
        """The model's areas (m²), then its indentations (m), (P, n + q), without the correction."""
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        return in_rows(trial_outputs(self.model, parameters, self.trials), self.trials)

    def corrected(self, parameters: np.ndarray) -> np.ndarray:
        """Areas and indentations (P, n + q) as of `raw`, corrected."""
        raw = self.raw(parameters)
        return raw if self.correction is None else raw * self.correction.factor(parameters)

    def correction_at(self, parameters: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Factor (n,) of the correction for the areas of other presses, for parameters (D,) under
        forces (n,) in N: a parabola of the force's logarithm through those of the frames, held
        beyond them."""
        if self.correction is None:
            return np.ones_like(force)
        factor = self.correction.factor(parameters)[0, : len(self.measured)]
        place = np.log(np.maximum(self.force, SMALLEST_FORCE))
        found = np.polyfit(place, np.log(factor), 2, w=np.sqrt(self.weight))
        at = np.log(np.maximum(force, SMALLEST_FORCE))
        return np.exp(np.polyval(found, np.clip(at, place.min(), place.max())))

    def outputs(self, parameters: np.ndarray) -> np.ndarray:
        """Rows (P, n + q) in m² for parameters (P, D) that stand against `observed`: areas, and
        indentations as `IndentationRows.compared` makes them."""
        return self.compared(self.corrected(parameters))

    def compared(self, raw: np.ndarray) -> np.ndarray:
        """Rows (…, n + q) in m² of areas and indentations as of `raw`; a linear map."""
        if self.indentations is None:
            return raw
        areas, indentations = np.split(raw, [len(self.measured)], axis=-1)
        rows = self.indentations.compared(indentations, self.area_noise)
        return np.concatenate([areas, rows], axis=-1)

    @property
    def is_plain(self) -> bool:
        """Whether what is minimised is J of the model's own areas, as in a search."""
        return self.correction is None and self.nuisances is None and self.indentations is None

    @property
    def observed(self) -> np.ndarray:
        """What was measured, as rows (n + q,) in m²."""
        return np.concatenate([self.measured, self._indented])

    @observed.setter
    def observed(self, rows: np.ndarray) -> None:
        self.measured, self._indented = np.split(rows, [len(self.measured)])

    @property
    def row_trial(self) -> np.ndarray:
        """Trial (n + q,) of each row."""
        found = self.indentations
        return self.trial_of if found is None else np.concatenate([self.trial_of, found.trial_of])

    @property
    def row_weight(self) -> np.ndarray:
        """Weight (n + q,) of each row."""
        found = self.indentations
        return self.weight if found is None else np.concatenate([self.weight, found.weight])

    def by_trial(self, rows: np.ndarray) -> np.ndarray:
        """Sums (…, T) of rows (…, n + q) over each trial."""
        found = np.add.reduceat(rows[..., : len(self.measured)], self.starts[:-1], axis=-1)
        if self.indentations is not None:
            own = self.indentations.sums(rows[..., len(self.measured) :])
            found[..., self.indentations.trials] += own
        return found

    def weigh(self, area_noise: float) -> None:
        """Let indentations weigh beside areas of this noise (m²)."""
        self.area_noise = area_noise
        found = self.indentations
        self._indented = (
            np.empty(0) if found is None else found.compared(found.measured, area_noise)
        )

    def uncorrected(self) -> FitProblem:
        """Copy the problem without correction and nuisances, which a fit sets."""
        found = copy.copy(self)
        found.correction = found.nuisances = None
        found.weigh(TYPICAL_AREA_NOISE)
        return found

    def redrive(self, trials: Sequence[FitTrial]) -> None:
        """Take the same trials under other drives (another tare, another lag)."""
        self.trials = tuple(trials)
        self.force = np.concatenate([t.frame_force for t in self.trials])

    def trial_costs(self, areas: np.ndarray) -> np.ndarray:
        """Part of J (…, T) in m⁴ of every trial for areas (…, n), whatever the nuisances: the
        weighted mean of its frames' losses."""
        lost = self.weight * losses(areas - self.measured, self.options)
        return np.add.reduceat(lost, self.starts[:-1], axis=-1)

    def area_cost(self, parameters: np.ndarray) -> float:
        """J (m⁴) of parameters (D,): of the areas alone, without priors."""
        return float(self.trial_costs(self.areas(parameters)[0]).sum())

    def goal(self, weight: np.ndarray | None = None) -> Goal:
        """What is minimised, under the rows' own weights or others (n + q,), as the bootstrap
        has."""
        if weight is None:
            return Goal(self.observed, self.row_weight, self.options, self.nuisances)
        own, given = self.by_trial(self.row_weight), self.by_trial(weight)
        repeats = np.divide(given, own, out=np.zeros_like(own), where=own > 0)
        return Goal(self.observed, weight, self.options, self.nuisances, repeats)

    def cost(self, parameters: np.ndarray) -> np.ndarray:
        """What is minimised (P,), in m⁴, of parameters (P, D): J, with the indentations and with
        the nuisances eliminated where there are any."""
        if self.nuisances is None and self.indentations is None:
            found = self.trial_costs(self.areas(parameters)).sum(axis=-1)
            return np.where(np.isfinite(found), found, np.inf)
        return self.goal().cost(self.outputs(parameters))

    def key(self) -> str:
        """Hash of what a cost depends on: frames, drive, weights, loss and model."""
        parts: list[Any] = [self.measured.tobytes(), self.weight.tobytes()]
        if self.indentations is not None:
            parts += [self.indentations.measured.tobytes(), self.indentations.sd.tobytes()]
        for trial in self.trials:
            parts += [part.tobytes() for part in trial.drive.to_model(trial.frames)]
        parts.append(str(getattr(self.model, "hash", "")).encode())
        return sha256_of([sha256_of(b"".join(parts)), self.options.loss, self.options.huber_scale])
