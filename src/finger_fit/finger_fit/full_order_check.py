"""The top candidates once more, with the full-order model: is what the reduced model says true?"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_common.errors import ModelError
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.material import Material

from .engine import DaskEngine, Done, LocalEngine
from .local import LocalFit, refine, whole_box
from .problem import AreaCorrection, FitProblem, composite_modulus
from .trials import FitTrial

STEP = 0.04
"""s, largest time step of the full-order runs."""

REFINEMENT = 1.25
"""Of the full-order mesh. The default mesh is 0.05–0.15 % of the area off, which in the flat direction of composite
modulus against E2 makes 1 %; this one 0.02–0.07 %."""

FORCE_STEP = 0.1
"""N, largest change of force in a step, where the drive is fine enough: a release takes 0.2 s, and its areas, which
hold most of what is known of E0 and E1 apart, err by 0.5 % in steps of 0.04 s."""

AREA_LIMIT = 0.01
"""RMS difference of full and reduced order over the largest area above which a fit is not final."""

MODULUS_LIMIT = 0.02
"""Change of the best candidate's composite modulus by re-ranking above which a fit is not final."""


@dataclass(frozen=True)
class FullOrderCheck:
    """Top candidates by both models.

    parameters (C, 4); reduced_costs, full_costs (C,): J in m⁴, the reduced one with the problem's correction; areas (C, n): full-order areas (m²) at the frames;
    rms_difference: of the best candidate's areas by both models, uncorrected, over the largest area; best: index of the candidate that full
    order prefers; modulus_change: relative change of composite E that re-ranking makes; final: both are small.
    """

    parameters: np.ndarray
    reduced_costs: np.ndarray
    full_costs: np.ndarray
    areas: np.ndarray
    rms_difference: float
    best: int
    modulus_change: float

    @property
    def final(self) -> bool:
        """Whether the fit stands."""
        return not self.reasons

    @property
    def reasons(self) -> list[str]:
        """Why the fit is not final, in words."""
        out = []
        if not self.rms_difference <= AREA_LIMIT:
            out.append(
                f"full and reduced order differ by {100 * self.rms_difference:.2f} % of the largest "
                f"area (limit {100 * AREA_LIMIT:g} %)"
            )
        if not self.modulus_change <= MODULUS_LIMIT:
            out.append(
                f"re-ranking by full order changes composite E by {100 * self.modulus_change:.1f} % "
                f"(limit {100 * MODULUS_LIMIT:g} %)"
            )
        return out


@functools.lru_cache(maxsize=4)
def _model(geometry: Geometry, refinement: float) -> FullOrderModel:
    return FullOrderModel(geometry, refinement)


def full_order_areas(
    shared: tuple[Geometry, float, Material, Sequence[FitTrial]],
    item: tuple[tuple[float, ...], int],
) -> np.ndarray:
    """Areas (k,) in m² of one trial at its frames; NaN throughout where the finger cannot carry the load."""
    geometry, refinement, material, trials = shared
    parameters, index = item
    trial = trials[index]
    steps = thinned(trial, STEP)
    try:
        history = _model(geometry, refinement).simulate(
            material.with_vector(np.array(parameters)), trial.time[steps], trial.force[steps]
        )
    except ModelError:
        return np.full(len(trial.frames), np.nan)
    return history.area[np.searchsorted(steps, trial.frames)]


Simulator = Callable[[Any, Any], np.ndarray]
"""As `full_order_areas`."""


def candidate_areas(
    problem: FitProblem,
    candidates: np.ndarray,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
    material: Material | None = None,
    refinement: float = REFINEMENT,
    done: Done | None = None,
    simulate: Simulator = full_order_areas,
) -> np.ndarray:
    """Full-order areas (C, n) in m² of candidates (C, 4) at all frames."""
    items = [
        (tuple(map(float, parameters)), index)
        for parameters in candidates
        for index in range(len(problem))
    ]
    shared = (geometry, refinement, material or Material(), problem.trials)
    parts = engine.spread(simulate, shared, items, done)
    number = len(problem)
    return np.array(
        [np.concatenate(parts[c * number : (c + 1) * number]) for c in range(len(candidates))]
    )


@dataclass(frozen=True)
class Correction:
    """What consulting the full order changed: J (m⁴) of the uncorrected fit, rounds, and the largest relative
    change of the area at a frame."""

    cost_before: float
    parameters_before: np.ndarray
    rounds: int
    largest_factor: float


SHIFTS = (0.08, 0.3, 0.3, 0.12)
"""Steps of the logarithms of composite modulus, E0, tau1 and E2 over which the correction's slope is taken: about a
standard deviation of what 15 presses tell."""

FAR = 0.5
"""Move of a logarithm after which the slope is taken anew."""

SETTLED = 0.03
"""Move of a logarithm below which the correction is done; far below what 15 presses tell."""


def shifted(parameters: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Parameters (5, 4): as given, and with one of composite modulus, E0 (the composite held), tau1 and E2 moved by its
    step of SHIFTS, towards the middle of box (4, 2)."""
    E0, _, tau1, E2 = parameters
    E = float(composite_modulus(parameters))
    middle = np.sqrt(box[:, 0] * box[:, 1])
    inwards = np.where(
        np.array([E, E0, tau1, E2]) < [composite_modulus(middle), *middle[[0, 2, 3]]], 1.0, -1.0
    )
    if E0 * np.exp(-SHIFTS[1]) < 1.1 * E:
        inwards[1] = 1.0
    if E * np.exp(SHIFTS[0]) > 0.95 * E0:
        inwards[0] = -1.0
    factors = np.vstack([np.ones(4), np.exp(np.diag(inwards * np.array(SHIFTS)))])
    factors[1:][~np.eye(4, dtype=bool)] = 1.0
    e, e0, t, e2 = (factors * [E, E0, tau1, E2]).T
    return np.column_stack([e0, 1.0 / (1.0 / e - 1.0 / e0), t, e2])


def correction_around(
    problem: FitProblem,
    centre: np.ndarray,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
    slope: np.ndarray | None = None,
    done: Done | None = None,
    simulate: Simulator = full_order_areas,
) -> AreaCorrection:
    """Ratio of full to reduced order around parameters `centre` (4,), with its slope (4, n): by differences, or as
    given. Frames of a trial that full order cannot simulate keep the reduced model's area."""
    points = shifted(centre, problem.box) if slope is None else centre[None]
    full = candidate_areas(problem, points, geometry, engine, done=done, simulate=simulate)
    raw = problem.raw_areas(points)
    usable = (np.isfinite(full) & (full > 0) & (raw > 0)).all(axis=0)
    log_ratio = np.log(np.where(usable, full / raw, 1.0))
    if slope is None:
        places = AreaCorrection.place(points)
        slope = np.linalg.solve(places[1:] - places[0], log_ratio[1:] - log_ratio[0])
    return AreaCorrection(centre, log_ratio[0], slope)


def correct(
    problem: FitProblem,
    best: np.ndarray,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
    rounds: int = 3,
    done: Done | None = None,
    simulate: Simulator = full_order_areas,
) -> tuple[LocalFit, Correction]:
    """Refit with the reduced model's areas corrected to full order around the best parameters (4,).

    Each frame's area is multiplied by the ratio of full to reduced order, linear around the best parameters (space
    mapping with the fine model's derivatives: Bandler et al. 2004), the fit polished, and the ratio renewed at the
    result. The slope matters as much as the ratio: in the direction of E0 against E1 the reduced model's error changes
    as fast as the area does, and a fit with the ratio alone stays where it started. The problem keeps the last
    correction.
    """
    before = float(problem.cost(best)[0])
    start, slope_at, slope = best, best, None
    used = 0
    while used < rounds:
        used += 1
        if _moved(start, slope_at) > FAR:
            slope, slope_at = None, start
        correction = correction_around(problem, start, geometry, engine, slope, done, simulate)
        problem.correction, slope = correction, correction.slope
        fit = refine(problem, whole_box(problem.box), np.log(start))
        moved, start = _moved(fit.parameters, start), fit.parameters
        if moved < SETTLED:
            break
    largest = float(np.abs(correction.factor(start) - 1.0).max())
    return fit, Correction(before, best, used, largest)


def _moved(to: np.ndarray, since: np.ndarray) -> float:
    """Largest change of a coordinate of the correction."""
    return float(np.abs(AreaCorrection.place(to) - AreaCorrection.place(since)).max())


def thinned(trial: FitTrial, step: float) -> np.ndarray:
    """Indices into the trial's drive, its frames among them, no further apart than `step` (s) and FORCE_STEP where it
    allows."""
    keep = [0]
    frames = set(trial.frames.tolist())
    last = int(trial.frames[-1])
    for i in range(1, last + 1):
        j = min(i + 1, last)
        too_long = trial.time[j] - trial.time[keep[-1]] > step * 1.001
        too_much = abs(trial.force[j] - trial.force[keep[-1]]) > FORCE_STEP
        if i in frames or too_long or too_much:
            keep.append(i)
    return np.array(keep)


def check(
    problem: FitProblem,
    candidates: np.ndarray,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
    material: Material | None = None,
    refinement: float = REFINEMENT,
    done: Done | None = None,
    simulate: Simulator = full_order_areas,
) -> FullOrderCheck:
    """Simulate candidates (C, 4), best first, with the full-order model over all trials."""
    areas = candidate_areas(
        problem, candidates, geometry, engine, material, refinement, done, simulate
    )
    reduced = problem.raw_areas(candidates)
    reduced_costs = problem.trial_costs(problem.areas(candidates)).sum(axis=1)
    full_costs = problem.trial_costs(areas).sum(axis=1)
    best = int(np.nanargmin(full_costs)) if np.isfinite(full_costs).any() else 0
    moduli = composite_modulus(candidates)
    difference = np.sqrt(np.mean((areas[0] - reduced[0]) ** 2)) / areas[0].max()
    return FullOrderCheck(
        np.array(candidates),
        reduced_costs,
        full_costs,
        areas,
        float(difference),
        best,
        float(abs(moduli[best] / moduli[0] - 1.0)) if np.isfinite(full_costs).all() else np.nan,
    )
