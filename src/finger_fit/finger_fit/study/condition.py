# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fit of one condition, stage by stage: from the grid to the intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from finger_model.fem.area_model import FullOrderAreas

from ..engine import Engine, LocalEngine
from ..full_order import BetterModel, FullOrder, check, correct
from ..interruption import interruptible
from ..nuisance.estimate import ROUNDS, NuisanceModel, Settled
from ..nuisance.geometry import FullOrderGeometry, PopulationGeometry, geometry_responses
from ..nuisance.result import nuisance_result
from ..problem import DataError, FitProblem, fit_power_law, robust_factor
from ..results import ConditionFit, CrossCheck, indentation_fit
from ..search import LocalFit, Search, Stopped, all_free, best_points, refine, search, search_grid
from ..uncertainty import (
    Covariance,
    Profile,
    bias_corrected,
    bias_pair,
    bootstrap_sample,
    covariance,
    goodness,
    profile,
)
from .progress import Progress, Report

DISTINCT = 0.02
"""Candidates count as different when a parameter's logarithm differs by this much."""

SMALLEST_NOISE = 1e-9
"""m², of a frame: areas of a simulation have none."""

AGREEMENT = 0.02
"""A cross-check agrees when its polished J lies within this part of the fit's."""


def fit_condition(
    problem: FitProblem,
    condition: str = "",
    engine: Engine | None = None,
    folder: Path | None = None,
    report: Report | None = None,
    better: BetterModel | None = None,
) -> ConditionFit:
    """Fit one condition: grid, PSO, polish, then what the problem's options ask for.

    folder: for checkpoints, none are kept without; better: the model to correct to and check with,
    the full-order model of the same finger when None. Ctrl-C (KeyboardInterrupt) and Stopped end
    the work; what was found until then comes back with status "interrupted".
    """
    problem = problem.uncorrected()
    progress = Progress(condition, len(problem.space), report)
    stages = _Stages(problem, progress, engine or LocalEngine(), folder, better)
    fit = stages.search()
    if fit.status != "interrupted":
        try:
            with interruptible():
                stages.polish_best(fit)
                without = fit.parameters
                settled = stages.minimise(fit)
                stages.assess(fit, settled, without)
        except (KeyboardInterrupt, Stopped):
            fit.status = "interrupted"
            fit.reasons = ["interrupted after the search; the later results are incomplete"]
            # Of the parameters and the problem as the last whole stage left them.
            fit.cost = problem.area_cost(fit.parameters)
            fit.objective = float(problem.cost(fit.parameters)[0])
            fit.power_law = fit_power_law(problem)
    if not len(fit.top):
        fit.top, fit.top_costs = top_candidates(fit, problem.options.top)
    fit.areas, fit.curves = problem.areas(fit.parameters)[0], drive_areas(problem, fit.parameters)
    fit.indentation = indentation_fit(problem, fit.parameters)
    fit.goodness = goodness(problem, fit.areas, fit.power_law, problem.options.seed)
    fit.unsaved = stages.unsaved
    return fit


class _Stages:
    """The stages of one condition's fit, and what they share."""

    def __init__(
        self,
        problem: FitProblem,
        progress: Progress,
        engine: Engine,
        folder: Path | None,
        better: BetterModel | None,
    ) -> None:
        self.problem, self.options, self.progress = problem, problem.options, progress
        self.engine, self.folder = engine, folder
        full_order = self.options.full_order
        self.better = (better or FullOrder.like(problem.model, engine)) if full_order else None
        # A full-order model needs neither correction nor check.
        self.reduced = not isinstance(problem.model, FullOrderAreas)
        self.coordinates = all_free(problem)
        self.start = np.empty((0, len(problem.space)))
        self.unsaved = ""

    def search(self) -> ConditionFit:
        """Grid, PSO and power law; "interrupted" where grid or PSO did not end."""
        problem, options, progress = self.problem, self.options, self.progress
        with progress.timed("grid"):
            grid = search_grid(problem.cost, self.coordinates, options.grid, self.improving("grid"))
        self.start = best_points(grid, options.particles)
        with progress.timed("pso"):
            pso = (
                self.run("pso")
                if grid.complete
                else Search("pso", grid.candidates[:1], grid.costs[:1], False)
            )
        parameters, cost = min((grid.best, pso.best), key=lambda found: found[1])
        if pso.complete and not np.isfinite(cost):
            highest = max(float(trial.force.max()) for trial in problem.trials)
            raise DataError(
                f"no finger of the search box that was tried carries these presses, of up to "
                f"{highest:.3g} N: the model cannot follow them; check the units of force and "
                "area, give --bounds of stiffer tissue, or a lower --target-force"
            )
        with progress.timed("power law"):
            law = fit_power_law(problem)
        fit = ConditionFit(progress.condition, problem, parameters, cost, grid, pso, law)
        if problem.indentations is not None:
            fit.cost = problem.area_cost(parameters)
        fit.objective = cost
        fit.seconds = progress.seconds
        if not (grid.complete and pso.complete):
            fit.status = "interrupted"
            rounds = f"in round {len(pso.costs)} of {options.rounds}"
            fit.reasons = [f"interrupted {rounds if grid.complete else 'in the grid'}"]
        return fit

    def run(self, optimizer: str) -> Search:
        """One population search from the best grid points, with its checkpoint."""
        file = f"checkpoint_{self.progress.condition or 'all'}_{optimizer}.json"
        found = search(
            optimizer,
            self.problem.cost,
            self.coordinates,
            self.start,
            self.options.rounds,
            self.options.seed,
            None if self.folder is None else self.folder / file,
            self.options.resume,
            self.improving(optimizer),
            self.problem.key(),
        )
        self.unsaved = self.unsaved or found.unsaved
        return found

    def polish_best(self, fit: ConditionFit) -> None:
        """Polish the best candidate, and let the other optimisers check it."""
        problem, progress = self.problem, self.progress
        if self.options.polish:
            with progress.step("polish"):
                fit.polish = polish(problem, fit.parameters, self.start)
                if problem.indentations is not None:
                    problem.weigh(residual_noise(problem, fit.polish.parameters))
                    fit.polish = polish(problem, fit.polish.parameters, self.start)
                if problem.indentations is not None or fit.polish.cost < fit.objective:
                    self.take(fit, fit.polish)
        with progress.timed("cross-checks"):
            others = [name for name in self.options.optimizer if name != "pso"]
            fit.cross_checks = [self.cross_check(fit, name) for name in others]

    def minimise(self, fit: ConditionFit) -> Settled | None:
        """Estimate the nuisances and correct to full order; the nuisances, where there are any."""
        problem, options, progress = self.problem, self.options, self.progress
        model = self.nuisance_model(fit) if options.nuisances else None
        settled = None
        if model is not None:
            starts = np.vstack([fit.parameters, self.start[:2]])
            settled = self.settle(fit, model, starts, ROUNDS if self.reduced else 1)
        if self.better is not None and options.correct and self.reduced:
            stage = "correction to full order"
            with progress.timed(stage), self.whole():
                found, fit.correction = correct(
                    problem,
                    fit.parameters,
                    self.better,
                    done=lambda number: progress.count(f"{stage}, pass {number}"),
                )
            self.take(fit, found)
            if model is not None:
                settled = self.settle(fit, model, fit.parameters[None], ROUNDS)
        if settled is not None:
            # The baseline has the same force, less the tare and at the images' times.
            fit.power_law = fit_power_law(problem)
        return settled

    def settle(
        self, fit: ConditionFit, model: NuisanceModel, starts: np.ndarray, rounds: int
    ) -> Settled:
        """Fit from parameters (C, N) with the nuisances eliminated."""
        done = self.progress.count("nuisances")
        with self.progress.timed("nuisances"):
            done(0, rounds)
            with self.whole():
                settled = model.settle(starts, rounds, done)
            self.take(fit, settled.fit)
        done(rounds, rounds)
        return settled

    def take(self, fit: ConditionFit, found: LocalFit) -> None:
        """Let a fit be at a minimum that was found, of the problem as it is."""
        fit.parameters, fit.objective = found.parameters, found.cost
        self.progress.improved(self.problem.area_cost(fit.parameters), fit.parameters)

    def improving(self, stage: str) -> Callable[[int, int, float, np.ndarray], None]:
        """Callback of a search, which shows J, also where indentations are minimised beside it."""
        update, problem = self.progress.rounds(stage), self.problem
        if problem.indentations is None:
            return update
        return lambda number, rounds, _, best: update(number, rounds, problem.area_cost(best), best)

    def assess(self, fit: ConditionFit, settled: Settled | None, without: np.ndarray) -> None:
        """Compute covariance, full-order check, profiles, bias and bootstrap of a fit.

        without (N,): the parameters before the nuisances were estimated.
        """
        problem, options, progress = self.problem, self.options, self.progress
        fit.cost = problem.area_cost(fit.parameters)
        fit.top, fit.top_costs = top_candidates(fit, options.top)
        with progress.step("sensitivities"):
            fit.covariance = covariance(problem, fit.parameters)
        if settled is not None:
            allowed = settled.nuisances.names
            left_out = tuple(name for name in problem.lengths if name not in allowed)
            fit.nuisance = nuisance_result(problem, settled, fit.covariance, left_out, without)
        if self.better is not None and self.reduced:
            stage = "check against full order"
            with progress.timed(stage):
                fit.full_order = check(problem, fit.top, self.better, progress.count(stage))
            fit.reasons = fit.full_order.reasons
        if self.better is not None:
            fit.status = "not final" if fit.reasons else "final"
        if options.profiles:
            names = [n for n in problem.space.quantity_names if problem.space.can_hold(n)]
            shared = (problem, fit.parameters, fit.objective, fit.covariance)
            fit.profiles = dict(zip(names, self.map("profiles", _profile, shared, names)))
        seeded = (problem, fit.parameters, options.seed)
        # The swarm alone does not end at a minimum, so refits cannot measure its bias. Polish,
        # nuisances and correction do.
        minimum = options.polish or fit.correction is not None or fit.nuisance is not None
        if options.bias_pairs and minimum:
            pairs = self.map("bias", _bias_pair, seeded, range(options.bias_pairs))
            fit.bias_corrected = bias_corrected(problem.space, fit.parameters, np.array(pairs))
        if options.bootstrap:
            samples = self.map("bootstrap", _bootstrap, seeded, range(options.bootstrap))
            fit.samples = np.array(samples)

    @contextmanager
    def whole(self) -> Iterator[None]:
        """A stage that leaves the problem as it was where it does not end."""
        before = dict(vars(self.problem))
        try:
            yield
        except BaseException:
            vars(self.problem).update(before)
            raise

    def nuisance_model(self, fit: ConditionFit) -> NuisanceModel:
        """The nuisances of the problem; the finger's lengths by the population's model or, where
        the full order is asked for, by that."""
        problem, options, better = self.problem, self.options, self.better
        lengths = problem.lengths
        population = PopulationGeometry.like(problem.model) if lengths and self.reduced else None
        responses = {}
        if population is None and lengths and isinstance(better, FullOrder):
            with self.progress.timed("geometry"):
                count = self.progress.count("geometry")
                responses = geometry_responses(
                    problem, fit.parameters, FullOrderGeometry(better, count), lengths
                )
        return NuisanceModel(problem, options, responses, population)

    def map(self, stage: str, function: Any, shared: Any, items: Any) -> list[Any]:
        """Independent pieces of a stage, on the engine."""
        with self.progress.timed(stage):
            return self.engine.map(function, shared, items, self.progress.count(stage))

    def cross_check(self, fit: ConditionFit, name: str) -> CrossCheck:
        """Another optimiser from the same start, and whether it agrees after the same polish."""
        check = self.run(name)
        if not check.complete:
            raise Stopped
        found, cost = check.best
        polished = min(cost, refine(self.problem, self.coordinates, found).cost)
        agrees = bool(abs(polished / fit.objective - 1) < AGREEMENT)
        return CrossCheck(name, found, cost, polished, agrees)


def _profile(shared: tuple[FitProblem, np.ndarray, float, Covariance], name: str) -> Profile:
    problem, best, cost, found = shared
    return profile(problem, name, best, cost, found)


def _bias_pair(shared: tuple[FitProblem, np.ndarray, int], index: int) -> np.ndarray:
    return bias_pair(*shared, index)


def _bootstrap(shared: tuple[FitProblem, np.ndarray, int], index: int) -> np.ndarray:
    return bootstrap_sample(*shared, index)


def polish(problem: FitProblem, parameters: np.ndarray, starts: np.ndarray) -> LocalFit:
    """Bounded least squares from the best candidate (N,) and from the best two of starts (C, N).

    J can have more than one local minimum, mostly at the bounds.
    """
    coordinates = all_free(problem)
    others = [s for s in starts[:2] if not np.allclose(s, parameters, rtol=1e-9, atol=0.0)]
    found = [refine(problem, coordinates, start) for start in (parameters, *others)]
    best = min(found, key=lambda fit: fit.cost)
    return LocalFit(best.parameters, best.cost, sum(fit.evaluations for fit in found))


def residual_noise(problem: FitProblem, parameters: np.ndarray) -> float:
    """Noise (m²) of a frame by the areas' residuals at fitted parameters (N,)."""
    used = problem.weight > 0.0
    residual = (problem.areas(parameters)[0] - problem.measured)[used]
    residual = residual * robust_factor(residual, problem.options)
    degrees = max(len(residual) - len(problem.space), 1)
    return max(float(np.sqrt((residual**2).sum() / degrees)), SMALLEST_NOISE)


def top_candidates(fit: ConditionFit, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Best distinct candidates (≤ number, N) of polish, PSO and grid, and their J, best first."""
    space = fit.space
    points = [fit.parameters[None], fit.pso.candidates.reshape(-1, len(space))]
    costs = [np.array([fit.objective]), fit.pso.costs.reshape(-1)]
    points.append(best_points(fit.grid, 50))
    costs.append(np.sort(fit.grid.costs.reshape(-1), kind="stable")[:50])
    all_points, all_costs = np.concatenate(points), np.concatenate(costs)
    if not fit.problem.is_plain:
        # The costs of the search are J of uncorrected areas: those of the best are made anew.
        keep = _distinct(space.to_log(all_points[1:]), all_costs[1:], 10 * number)
        all_points = np.concatenate([all_points[:1], all_points[1:][keep]])
        all_costs = np.concatenate([all_costs[:1], fit.problem.cost(all_points[1:])])
    chosen = _distinct(space.to_log(all_points), all_costs, number)
    return all_points[chosen], all_costs[chosen]


def _distinct(places: np.ndarray, costs: np.ndarray, number: int) -> list[int]:
    """The best of places (C, N) by costs (C,) that are apart, at most a number of them."""
    chosen: list[int] = []
    for index in np.argsort(costs, kind="stable"):
        if not np.isfinite(costs[index]) or len(chosen) == number:
            break
        distance = np.abs(places[chosen] - places[index]).max(axis=1)
        if np.all(distance > DISTINCT):
            chosen.append(int(index))
    return chosen


def drive_areas(problem: FitProblem, parameters: np.ndarray) -> list[np.ndarray]:
    """Model area (n,) in m² at every step of each trial's drive, corrected as at the frames."""
    drives = [t.drive.to_model(np.arange(len(t.time))) for t in problem.trials]
    curves = [areas[0] for areas in problem.model.batch(parameters[None], drives)]
    if problem.correction is None:
        return curves
    factors = problem.correction.factor(parameters)[0][: len(problem.measured)]
    factor = np.split(factors, problem.starts[1:-1])
    return [
        areas * np.interp(trial.time, trial.frame_time, part)
        for areas, trial, part in zip(curves, problem.trials, factor)
    ]
