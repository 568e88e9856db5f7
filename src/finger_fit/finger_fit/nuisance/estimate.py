# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Nuisance parameters: linearised around a fit, estimated with it, and named where they are not.

Parameters of the drive (tare, lag) change what the model is driven with; those of the output
(gains, collapse of the hull, lengths of the finger) multiply its areas. All of them are linearised
around the present estimate; the finger's parameters are fitted with the nuisances eliminated
(`problem.Goal`), the nuisances follow, and both are repeated until they rest. The result is the
joint maximum of the posterior, and the scatter of the presses' gains is estimated with it.

The lengths and the gain of all areas are assumed (`is_assumed`): the parameters are those of
the finger as given, whose geometry they are stored with, and the intervals allow for other lengths.
A measured indentation answers to the lengths more than the areas do. Its own answer to each length
is therefore eliminated, within the prior of the length (`problem.goal`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from finger_common.errors import ModelError

from ..nuisance_names import (
    AREA_GAIN,
    COLLAPSE,
    INDENTATION_GAIN,
    LAG,
    PRESS_GAIN,
    TARE,
    TRIAL_TARE,
    absorber_of,
    is_assumed,
)
from ..options import FitOptions
from ..problem import (
    FitProblem,
    FitTrial,
    Nuisance,
    Nuisances,
    fit_power_law,
    robust_factor,
    slope_between,
)
from ..search import LocalFit, all_free, carrying, refine
from .geometry import PopulationGeometry, Response

TRIAL_SHARE = 0.25
"""Deviation of one trial's tare over that of all, where none was measured; an assumption: a sensor
drifts slowly."""

USUAL_SCATTER, SCATTER_WEIGHT = 0.03, 2.0
"""Scatter of the presses' gains that is expected beforehand (an assumption), and the number of
presses that this counts for (scaled inverse chi-squared)."""

ROUNDS = 10
SETTLED = 0.01
"""Largest change of a parameter's logarithm, and of a nuisance over its deviation, that ends the
rounds (nuisances: ten times this)."""

RESPONSE_HOLDS = 0.2
"""Change of a parameter's logarithm up to which the answers to the lengths are not asked again
between the rounds; the last linearisation asks again."""

_LAG_STEP, _TARE_STEP = 0.004, 0.002
"""s and N, steps of the differences."""


@dataclass(frozen=True)
class Settled:
    """Nuisances with the fit at which they rest.

    scatter: standard deviation of the presses' gains (logarithm); noise: m², of a frame.
    """

    fit: LocalFit
    nuisances: Nuisances
    scatter: float
    noise: float


@dataclass
class _State:
    """Present values: tare of all and of each trial (T,), lag, log gains, collapse."""

    trial_tare: np.ndarray
    press_gain: np.ndarray
    tare: float = 0.0
    lag: float = 0.0
    collapse: float = 0.0
    indentation_gain: float = 0.0


class NuisanceModel:
    """The nuisances of one problem and their priors.

    responses: to the finger's lengths, with their deviations; population: gives them anew at each
    estimate. Lengths are allowed for with one of the two.
    """

    def __init__(
        self,
        problem: FitProblem,
        options: FitOptions,
        responses: Mapping[str, Response] | None = None,
        population: PopulationGeometry | None = None,
    ) -> None:
        self.problem, self.options, self.population = problem, options, population
        self.responses = {name: found.on(problem) for name, found in (responses or {}).items()}
        wanted = options.lengths(problem.known.deviations)
        if population is not None:
            self.responses = population.responses(problem, problem.space.default, wanted)
        self.lengths = {n: sd for n, sd in wanted.items() if n in self.responses}
        number = len(problem)
        self.rests = np.array([t.rest.force if t.rest else np.nan for t in problem.trials])
        self.unseen = np.isnan(self.rests)
        seen = self.rests[~self.unseen]
        # Trials without a rest have the tare of the others, if most of the others show one.
        usual = float(np.median(seen)) if len(seen) > number / 2 else 0.0
        spread = float(seen.std()) if len(seen) > number / 2 else options.tare_sd
        self.tare_mean = np.where(self.unseen, usual, self.rests)
        own = np.array([t.rest.deviation if t.rest else 0.0 for t in problem.trials])
        self.tare_sd = np.where(self.unseen, TRIAL_SHARE * max(spread, 1e-4), own)
        self.common_tare_sd = spread if self.unseen.any() else 0.0
        self.state = _State(np.zeros(number), np.zeros(number))
        self._answered: np.ndarray | None = None
        self.scatter, self.noise = self._first_guess()

    def _first_guess(self) -> tuple[float, float]:
        """Scatter of the gains and noise of a frame (m²), from a power law for every trial."""
        problem = self.problem
        law = fit_power_law(problem)
        shape = np.maximum(law.area(problem.force), 1e-12)
        weight, starts = problem.weight, problem.starts[:-1]
        gain = np.add.reduceat(weight * shape * problem.measured, starts) / np.maximum(
            np.add.reduceat(weight * shape * shape, starts), 1e-30
        )
        left = (problem.measured - gain[problem.trial_of] * shape)[weight > 0.0]
        noise = float(np.sqrt((left**2).sum() / max(len(left) - 2 * len(gain), 1)))
        logs = np.log(np.maximum(gain, 1e-3))
        return self._scatter_of(logs, np.zeros_like(logs)), max(noise, 1e-9)

    def _scatter_of(self, gains: np.ndarray, variance: np.ndarray) -> float:
        """Scatter of log gains (T,) known to a variance (T,) each."""
        if not self.options.press_gain:
            return 0.0
        degrees = len(gains) - 1
        own = max(float(((gains - gains.mean()) ** 2).sum() - degrees * variance.mean()), 0.0)
        prior = SCATTER_WEIGHT * USUAL_SCATTER**2
        return float(np.sqrt((own + prior) / (degrees + SCATTER_WEIGHT)))

    # Linearisation --------------------------------------------------------------------------

    def _collapse_shape(self) -> np.ndarray:
        low = self.options.low_force
        return np.clip(1.0 - self.problem.force / low, 0.0, 1.0) if low > 0 else np.zeros(0)

    def _factor(self) -> np.ndarray:
        state = self.state
        log = state.press_gain[self.problem.trial_of]
        if self.options.collapse_sd > 0 and self.options.low_force > 0:
            log = log - state.collapse * self._collapse_shape()
        return np.exp(log)

    def _row_factor(self) -> np.ndarray:
        """Factor (n + q,) of all rows: `_factor`, and the gain of the sensor."""
        factor = self._factor()
        others = len(self.problem.observed) - len(factor)
        return np.concatenate([factor, np.full(others, np.exp(self.state.indentation_gain))])

    def _drives(self, lag: float = 0.0, tare: float = 0.0) -> list[FitTrial]:
        """The trials under the present state, moved by a lag (s) and a tare (N)."""
        state = self.state
        common = np.where(self.unseen, state.tare, 0.0)
        tares = self.tare_mean + common + state.trial_tare + tare
        return [
            t.with_drive(float(value), state.lag + lag, self.options)
            for t, value in zip(self.problem.trials, tares)
        ]

    def _slope(self, parameters: np.ndarray, lag: float = 0.0, tare: float = 0.0) -> np.ndarray:
        """Slope (n + q,) of the rows over a step of the lag (s) or of the tare (N), at parameters
        (N,)."""
        moved = copy.copy(self.problem)
        ends = []
        for side in (1.0, -1.0):
            moved.redrive(self._drives(side * lag, side * tare))
            ends.append(moved.outputs(parameters)[0])
        middle = self.problem.outputs(parameters)[0]
        return slope_between(np.array(ends), middle, np.full(2, lag + tare))

    def apply(self, parameters: np.ndarray) -> Nuisances:
        """Give the problem the present state: weights, drives, and the nuisances, linearised around
        it at parameters (N,), or near them where they do not carry the load of the present drives;
        returns the nuisances."""
        problem = self.problem
        problem.weigh(self.noise)
        problem.redrive(self._drives())
        carried = carrying(problem, all_free(problem), parameters)
        if carried is None:
            raise ModelError(
                "the model cannot follow the presses once their tare and lag are estimated; fit "
                "with --no-nuisances"
            )
        parameters = carried
        if self.population is not None:
            place = problem.space.to_log(parameters)
            if self._answered is None or np.abs(place - self._answered).max() > RESPONSE_HOLDS:
                self.responses = self.population.responses(problem, parameters, self.lengths)
                self._answered = place
        problem.nuisances = self._linearised(parameters)
        return problem.nuisances

    def _linearised(self, parameters: np.ndarray) -> Nuisances:
        """Linearise around the present state and parameters (N,)."""
        problem, options, state = self.problem, self.options, self.state
        factor = self._row_factor()
        raw = problem.corrected(parameters)[0]
        outputs = problem.compared(raw) * factor
        is_area = np.arange(len(outputs)) < len(problem.measured)
        areas, others = np.where(is_area, outputs, 0.0), np.where(is_area, 0.0, outputs)
        lag = self._slope(parameters, lag=_LAG_STEP) * factor
        tare = self._slope(parameters, tare=_TARE_STEP) * factor
        unseen = np.where(self.unseen[problem.row_trial], tare, 0.0)

        def each(
            name: str, states: np.ndarray, deviations: np.ndarray, column: np.ndarray
        ) -> list[Nuisance]:
            """One parameter for every press."""
            return [
                Nuisance(name, t, at, float(sd), np.where(problem.row_trial == t, column, 0.0))
                for t, (at, sd) in enumerate(zip(states, deviations))
            ]

        found = [
            Nuisance(LAG, -1, state.lag, options.lag_sd, lag),
            Nuisance(TARE, -1, state.tare, self.common_tare_sd, unseen),
            *each(TRIAL_TARE, state.trial_tare, self.tare_sd, tare),
            Nuisance(AREA_GAIN, -1, 0.0, options.area_gain_sd, areas),
        ]
        if options.low_force > 0:
            low = np.zeros(len(outputs))
            low[is_area] = -self._collapse_shape() * areas[is_area]
            found.append(Nuisance(COLLAPSE, -1, state.collapse, options.collapse_sd, low))
        if problem.indentations is not None:
            sd = options.indentation_gain_sd
            found.append(Nuisance(INDENTATION_GAIN, -1, state.indentation_gain, sd, others))
        for name, sd in self.lengths.items():
            answer = problem.compared(raw * self.responses[name]) * factor
            found.append(Nuisance(name, -1, 0.0, sd, answer))
            if problem.indentations is not None:
                own = np.where(is_area, 0.0, answer)
                found.append(Nuisance(absorber_of(name), -1, 0.0, sd, own, absorbing=True))
        scatters = np.full(len(problem), self.scatter)
        found += each(PRESS_GAIN, state.press_gain, scatters, areas)
        return Nuisances(
            [one for one in found if one.sd > 0],
            factor,
            self.noise**2 * float(problem.weight.mean()),
            robust_factor(outputs - problem.observed, options),
        )

    # Estimation -----------------------------------------------------------------------------

    def settle(
        self,
        starts: np.ndarray,
        rounds: int = ROUNDS,
        done: Callable[[int, int], None] = lambda number, most: None,
    ) -> Settled:
        """Fit from the best of parameters (C, N); the problem keeps drives and nuisances. done:
        learns of each round but the last, and of how many there are at most."""
        problem = self.problem
        free = all_free(problem)
        space = problem.space
        starts = np.atleast_2d(starts)
        at = starts[0]
        for number in range(1, rounds + 1):
            self.apply(at)
            found = [refine(problem, free, start) for start in (at, *starts[1:])]
            fit = min(found, key=lambda f: f.cost)
            starts = starts[:1]
            move = self._follow(fit.parameters)
            change = float(np.abs(space.to_log(fit.parameters) - space.to_log(at)).max())
            at = fit.parameters
            scatter = self.scatter
            self._learn(fit.parameters)
            growth = abs(np.log(self.scatter / scatter)) if scatter > 0 else 0.0
            if max(change, 0.1 * move, 0.1 * growth) < SETTLED:
                break
            done(number, rounds)
        self._answered = None
        nuisances = self.apply(at)
        return Settled(refine(problem, free, at), nuisances, self.scatter, self.noise)

    def _follow(self, parameters: np.ndarray) -> float:
        """Move the state to the best nuisances at parameters (N,); the largest move over its
        deviation."""
        found = self.problem.nuisances
        assert found is not None
        goal = self.problem.goal()
        moves = goal.moves(goal.residuals(self.problem.outputs(parameters)[0]))
        moves = np.where(found.absorbing, 0.0, moves)
        state = self.state
        for one, move in zip(found.parameters, moves):
            if one.trial >= 0:
                getattr(state, one.name)[one.trial] += move
            elif not (one.absorbing or is_assumed(one.name)):
                setattr(state, one.name, getattr(state, one.name) + move)
        return float(np.abs(moves / found.sd).max()) if len(moves) else 0.0

    def _learn(self, parameters: np.ndarray) -> None:
        """Renew noise of a frame and scatter of the gains at the present state."""
        problem, found = self.problem, self.problem.nuisances
        assert found is not None
        problem.redrive(self._drives())
        areas = problem.areas(parameters)[0] * self._factor()
        if not np.isfinite(areas).all():
            return  # under these drives no longer carried; `apply` looks for others
        residual = areas - problem.measured
        counted = problem.weight > 0
        robust = robust_factor(residual, self.options)
        goal = problem.goal()
        used = len(problem.space) + float((1.0 - goal.spread() ** 2 / found.sd**2).sum())
        degrees = max(float(counted.sum()) - used, 0.2 * counted.sum())
        clipped = (robust * residual)[counted]
        self.noise = max(float(np.sqrt((clipped**2).sum() / degrees)), 1e-9)
        if not self.options.press_gain:
            return
        starts, weight = problem.starts[:-1], problem.weight * robust
        information = np.add.reduceat(weight * areas * areas, starts)
        score = np.add.reduceat(-weight * areas * residual, starts)
        usable = information > 0
        move = np.divide(score, information, out=np.zeros_like(score), where=usable)
        own = self.noise**2 * weight.mean() / np.where(usable, information, np.inf)
        self.scatter = self._scatter_of((self.state.press_gain + move)[usable], own[usable])
