"""How well a fit recovers the finger that made its data, over many seeds.

    python scripts/recovery.py [--seeds 24] [--antithetic 12] [--misfit] [--output out/recovery]

Bias, spread, Cramér–Rao bound and coverage; scripts/study_tables.py prints them as tables.

Presses and true areas come from the full-order model on the study's finer mesh, simulated once
and kept. Every seed draws 15 presses per condition and gives them new sensor and area noise: seeds
share presses but no noise. Each draw is fitted over the loading alone and over the whole contact,
with the stages of `finger-fit`: grid, polish, correction to full order, intervals, bias. (Without
the swarm: the polish ends at the same minimum; `start_from_truth` shows whether it did.)

The correction needs full-order areas at the parameters of each fit. For thousands of fits they come
from a table: the fit's full-order model on every press without noise, at parameter sets spread over
the region of the fits. The ratio to the reduced model is interpolated between them.

`--antithetic N` fits N of the draws once more with sign-flipped area noise. The part of the error
that is odd in the noise cancels in the mean, so that far fewer seeds separate bias from chance.

`--misfit` fits fingers that differ from the fit's assumptions: an epidermis a quarter thinner or
thicker (a few presses without noise), and areas of whole trials scattered by 5 % (many seeds).
Writes recovery.json or recovery_misfit.json.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy.interpolate import RBFInterpolator

from finger_common.files import atomic_write
from finger_common.processes import worker_pool
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_fit.engine import LocalEngine
from finger_fit.full_order import FullOrder, correct, correction_around
from finger_fit.full_order.areas import REFINEMENT
from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem, FitTrial, fit_power_law, prepare, prepare_all
from finger_fit.report_units import MM4
from finger_fit.search import all_free, best_points, refine, search_grid
from finger_fit.study import polish
from finger_fit.uncertainty import bias_corrected, bias_pair, covariance, cramer_rao, in_interval
from finger_model.fem.area_model import FullOrderAreas
from finger_model.laws import StandardLinearSolid
from finger_model.paper import TRIALS_PER_CONDITION
from finger_model.reduced import ReducedModel
from finger_sim import study_trial
from finger_sim.conditions import STUDY
from finger_sim.study_bag import START_NS
from finger_sim.study_trial import (
    AREA_SCATTER,
    Misfit,
    StudyTrial,
    measured_area,
    measured_force,
    plan_study_trial,
)

SPACE = StandardLinearSolid.PARAMETERS
POOL_SEED = 1
POOL = 20
"""Presses per condition; the first 15 are those of `finger-rig study --seed 1`."""

WINDOWS = ("loading", "contact")
QUANTITIES = ("composite_E", "E2", "tau1")
GRID = 3
FIRST_SEED = 100

SEARCHED = 2
"""Seeds that begin with the search; the others begin at the truth."""

STEP = 0.04
"""s, time step of the reduced model. It takes half the time of the default 0.02 s; the correction
includes the difference."""

PAIRS = 10
"""Bias pairs, half the default: the error of one fit's bias averages out over the seeds."""

FEW = 5
"""Presses per condition of a finger with another epidermis, fitted without noise."""

FEWEST_FREE = 15
"""Smallest number of fits off the bounds for which their own spread is given."""

FINGERS = {"true": 1.0, "thin": 0.75, "thick": 1.25}
"""Epidermis of the simulated finger over the one that the fit assumes."""

Presses = dict[str, list[StudyTrial]]


# Presses, and the table of full-order areas ---------------------------------------------------


def spread(work: Callable[[Any], Any], jobs: Sequence[Any], what: str) -> Iterable[Any]:
    """Results of work(job) in order, in two processes, with progress."""
    with worker_pool(min(2, len(jobs)), needs_main=True) as workers:
        for count, result in enumerate(workers.map(work, jobs), 1):
            print(f"\r{what}: {count}/{len(jobs)}", end="", file=sys.stderr, flush=True)
            yield result
    print(file=sys.stderr)


def kept(path: Path, make: Callable[[], Any]) -> Any:
    """What a former run kept in a file, else made now and kept."""
    if not path.exists():
        found = make()
        with atomic_write(path, "wb") as file:
            pickle.dump(found, file)
    return pickle.loads(path.read_bytes())


def _plan(job: tuple[str, int, float]) -> StudyTrial:
    name, index, factor = job
    # A quarter of the epidermis changes the area a thousand times more than the finer mesh.
    mesh = study_trial.REFINEMENT if factor == 1.0 else 1.0
    return plan_study_trial(POOL_SEED, name, index, Misfit(epidermis_factor=factor), mesh)


def pool(folder: Path, finger: str = "true") -> Presses:
    """Presses of one finger with their true areas, simulated once and kept in `folder`."""
    number = POOL if finger == "true" else FEW
    jobs = [(name, index, FINGERS[finger]) for name in STUDY for index in range(number)]
    trials = kept(
        folder / f"pool_{finger}.pickle",
        lambda: list(spread(_plan, jobs, f"presses, {finger} epidermis")),
    )
    return {name: [t for t in trials if t.condition == name] for name in STUDY}


def record(
    trial: StudyTrial, seed: int, noise: bool, factor: float = 1.0, antithetic: bool = False
) -> Any:
    """A recorded trial with this seed's noise; `factor` multiplies its areas before the noise.

    antithetic: the sign of the area noise is flipped.
    """
    trial = replace(trial, area=trial.area * factor)
    times, normal, area = trial.press.time, trial.press.force, trial.area
    if noise:
        times, force = measured_force(trial, seed)
        area, normal = measured_area(trial, seed), -force[:, 2]
        if antithetic:
            area = np.maximum(2.0 * trial.area - area, 0.0)
    return SimpleNamespace(
        bag=f"pool_{seed}",
        subject="SIM1",
        condition=trial.condition,
        index=trial.index,
        stamp_ns=START_NS + np.round(times * 1e9).astype(np.int64),
        force=normal,
        area_stamp_ns=START_NS + np.round(trial.frame_time * 1e9).astype(np.int64),
        area=area,
        area_sd=np.full(len(area), TYPICAL_AREA_NOISE),
        area_flags=np.where(trial.area > 0, 0, 1),
        moisture_before=list(trial.moisture[:3]),
        moisture_after=list(trial.moisture[3:]),
    )


def whole_press(trial: StudyTrial, step: float = STEP) -> FitTrial:
    """The press without noise, with more of its frames than any window counts."""
    options = FitOptions(window="contact", onset_force=0.02, step=step)
    return prepare(record(trial, 0, False), options)


def design(name: str) -> np.ndarray:
    """Parameter sets (6, 4) of the table around the truth of a condition.

    The truth; about one standard deviation of a fit away from it in composite modulus, tau1 and E2;
    and as far as the box allows in E0 with the composite modulus held.
    """
    low, high = SPACE["E0"].bounds
    truth = STUDY[name].material
    E0, composite = truth.E0, truth.composite_modulus
    least = max(low, 1.05 / (1.0 / composite - 1.0 / SPACE["E1"].bounds[1]))
    other = high if E0 < 0.8 * high else np.sqrt(least * high)
    factors = np.ones((6, 4))  # of composite modulus, E0, tau1 and E2
    factors[1, 0] = 1.1
    factors[2:4, 1] = least / E0, other / E0
    factors[4, 2] = 1.4
    factors[5, 3] = 1.2 if truth.E2 < 1000e3 else 0.85
    centre = SPACE.correction_coordinates(truth.vector())
    return SPACE.from_correction_coordinates(centre + np.log(factors))


def _tabulate(trial: StudyTrial) -> np.ndarray:
    """Full-order areas (6, k) of one press at the parameter sets of `design`.

    At the truth on the fit's own mesh; the change with the parameters is taken from the default
    mesh, which takes half the time.
    """
    points, press = design(trial.condition), whole_press(trial, FitOptions().step)
    drive = [(press.time, press.force, press.frames)]
    fine = FullOrderAreas(StandardLinearSolid(), refinement=REFINEMENT).batch(points[:1], drive)[0]
    coarse = FullOrderAreas(StandardLinearSolid()).batch(points, drive)[0]
    return coarse * (fine / coarse[0])


class Tabulated:
    """The full-order model by the table: the reduced model times the interpolated ratio."""

    def __init__(self, folder: Path, model: ReducedModel) -> None:
        self._model = model
        self._ratios: dict[tuple[str, int], tuple[np.ndarray, RBFInterpolator]] = {}
        self.records: dict[tuple[str, int], Any] = {}
        trials = [trial for part in pool(folder).values() for trial in part]
        table = kept(
            folder / "full_order.pickle",
            lambda: list(spread(_tabulate, trials, "full-order table")),
        )
        for trial, areas in zip(trials, table):
            press, points = whole_press(trial), design(trial.condition)
            reduced = model.batch(points, [(press.time, press.force, press.frames)])[0]
            usable = np.isfinite(areas).all(axis=1)
            log_ratio = np.log(areas[usable] / reduced[usable])
            ratio = RBFInterpolator(self._place(points[usable]), log_ratio, kernel="cubic")
            self._ratios[trial.condition, trial.index] = frame_numbers(trial.area, press), ratio

    @staticmethod
    def _place(parameters: np.ndarray) -> np.ndarray:
        """Coordinates (C, 4) in which the ratio is smooth."""
        return SPACE.correction_coordinates(np.atleast_2d(parameters)) * [2.0, 1.0, 1.0, 1.0]

    def areas(self, problem: FitProblem, candidates: np.ndarray, done: Any = None) -> np.ndarray:
        """Areas (C, n) in m² of a problem whose trials were prepared from `records`."""
        factors = []
        for trial in problem.trials:
            key = trial.condition, trial.index
            numbers, ratio = self._ratios[key]
            wanted = frame_numbers(self.records[key].area, trial)
            found = np.exp(ratio(self._place(candidates)))
            factors.append([np.interp(wanted, numbers, row) for row in found])
        return problem.raw_areas(candidates) * np.concatenate(factors, axis=1)


def frame_numbers(area: np.ndarray, trial: FitTrial) -> np.ndarray:
    """Numbers (k,) among a record's frames of those that a fit counts; a noisy area occurs once."""
    return np.array([int(np.flatnonzero(area == a)[0]) for a in trial.area])


# Fits ------------------------------------------------------------------------------------------


def errors(parameters: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Differences of the quantities' logarithms from the truth."""
    value = SPACE.quantity
    return {q: float(np.log(value(q, parameters) / value(q, truth))) for q in QUANTITIES}


def fit_one(
    trials: list[StudyTrial],
    seed: int,
    window: str,
    noise: bool,
    model: ReducedModel,
    table: Tabulated | None,
    factors: np.ndarray | None = None,
    search: bool = True,
    antithetic: bool = False,
) -> dict[str, Any]:
    """Fit one condition of one seed; everything that the tables need.

    table: None runs the full-order model itself; search: False begins at the truth.
    """
    name = trials[0].condition
    truth = STUDY[name].material.vector()
    options = FitOptions(window=window, seed=seed, step=STEP)
    factors = np.ones(len(trials)) if factors is None else factors
    records = [record(t, seed, noise, f, antithetic) for t, f in zip(trials, factors)]
    by_index = {r.index: (r, t) for r, t in zip(records, trials)}
    prepared, _ = prepare_all(records, options)
    problem = FitProblem(prepared, model, options)
    better: Any = table or FullOrder.like(model, LocalEngine(1))
    if table is not None:
        table.records = {(r.condition, r.index): r for r in records}
    out: dict[str, Any] = {"condition": name, "window": window, "seed": seed}
    begin = truth
    if search:
        free = all_free(problem)
        start = best_points(search_grid(problem.cost, free, GRID), 2)
        found = polish(problem, start[0], start[1:])
        begin = found.parameters
        out["uncorrected_error_log"] = errors(begin, truth)
        out["J_uncorrected"] = found.cost * MM4
        # Had the search missed the global minimum, a start at the truth would find a lower J.
        out["start_from_truth"] = refine(problem, free, truth).cost / found.cost
    fit, _ = correct(problem, begin, better)
    best, known = fit.parameters, covariance(problem, fit.parameters)
    true_areas = [by_index[p.index][1].area[frame_numbers(by_index[p.index][0].area, p)]
                  for p in prepared]  # fmt: skip
    law = fit_power_law(problem)
    out |= {
        "J": fit.cost * MM4,
        "J_truth": float(problem.trial_costs(np.concatenate(true_areas)).sum()) * MM4,
        "J_power_law": law.cost * MM4,
        "power_law_m": law.m,
        "power_law_log_m": law.log_m,
        "active": known.active,
        "error_log": errors(best, truth),
    }
    if noise:
        # The fit's own correction may lie far from the truth; the bound needs one at the truth.
        at_truth = FitProblem(prepared, model, options)
        at_truth.correction = correction_around(at_truth, truth, better)
        out["cramer_rao"] = cramer_rao(at_truth, truth, TYPICAL_AREA_NOISE)
    pairs = [bias_pair(problem, best, seed, i) for i in range(PAIRS)]
    corrected = bias_corrected(SPACE, best, np.array(pairs))
    for key in ("corrected_error_log", "covered", "corrected_covered", "interval_sd"):
        out[key] = {}
    for q in QUANTITIES:
        true = float(SPACE.quantity(q, truth))
        out["corrected_error_log"][q] = float(np.log(corrected[q].value / true))
        out["interval_sd"][q] = known.deviation(q)
        out["covered"][q] = in_interval(problem, q, true, best, fit.cost, known)
        # The truth lies in an interval shifted by −bias where truth · exp(bias) lies in the
        # interval itself.
        shifted = np.clip(true * np.exp(corrected[q].bias), *SPACE.quantity_bounds(q, problem.box))
        out["corrected_covered"][q] = in_interval(problem, q, shifted, best, fit.cost, known)
    return out


class Job(NamedTuple):
    """The fits of one seed."""

    seed: int
    kind: str = "rows"
    finger: str = "true"
    scatter: bool = False


_shared: dict[str, Any] = {}
"""Model, table and presses of a worker process."""


def _one_seed(folder: Path, job: Job) -> list[dict[str, Any]]:
    if not _shared:
        numba.set_num_threads(1)
        _shared["model"] = ReducedModel.load()
        _shared["table"] = Tabulated(folder, _shared["model"])
    if job.finger not in _shared:
        _shared[job.finger] = pool(folder, job.finger)
    rows = []
    for trials in _shared[job.finger].values():
        rng = np.random.default_rng([job.seed, 7])
        chosen, noise = trials[:TRIALS_PER_CONDITION], job.kind != "clean"
        if noise:
            chosen = [
                trials[i] for i in np.sort(rng.permutation(len(trials))[:TRIALS_PER_CONDITION])
            ]
        factors = (
            np.exp(rng.normal(0.0, AREA_SCATTER, TRIALS_PER_CONDITION)) if job.scatter else None
        )
        for window in WINDOWS:
            row = fit_one(
                chosen,
                job.seed,
                window,
                noise,
                _shared["model"],
                _shared["table"],
                factors,
                search=job.seed < FIRST_SEED + SEARCHED and job.kind != "antithetic",
                antithetic=job.kind == "antithetic",
            )
            rows.append({**row, "finger": job.finger})
    return rows


def run(folder: Path, seeds: int, misfit: bool = False, antithetic: int = 0) -> dict[str, Any]:
    """All seeds on two processes, and fits without noise; written again and again on the way."""
    folder.mkdir(parents=True, exist_ok=True)
    model = ReducedModel.load()
    for finger in FINGERS if misfit else ("true",):
        pool(folder, finger)
    Tabulated(folder, model)
    numbers = range(FIRST_SEED, FIRST_SEED + seeds)
    # Last those that search, which take longest.
    if misfit:
        jobs = [Job(0, "clean", finger) for finger in FINGERS]
        jobs += [Job(seed, scatter=True) for seed in reversed(numbers)]
    else:
        jobs = [Job(0, "clean"), *(Job(seed, "antithetic") for seed in numbers[:antithetic])]
        jobs += [Job(seed) for seed in reversed(numbers)]
    result: dict[str, Any] = {"rows": [], "antithetic": [], "clean": [], "model": model.hash}
    began, saved = time.time(), 0.0
    for job, rows in zip(jobs, spread(partial(_one_seed, folder), jobs, "fits")):
        result[job.kind] += rows
        if time.time() - saved > 20 or job is jobs[-1]:
            saved = time.time()
            result["seconds"] = saved - began
            with atomic_write(folder / f"recovery{'_misfit' * misfit}.json") as file:
                json.dump(result, file)
    return result


def statistics(
    rows: list[dict[str, Any]], name: str, window: str, q: str, kind: str = ""
) -> dict[str, float]:
    """Bias and spread in logarithm, the Cramér–Rao bound, and coverage of one quantity.

    kind: "corrected_" for the bias-corrected values and the intervals shifted with them. "free"
    counts the fits with no parameter on a bound, "free_spread" is theirs.
    """
    chosen = [r for r in rows if r["condition"] == name and r["window"] == window]
    found = np.array([r[f"{kind}error_log"][q] for r in chosen])
    bounds = [r["cramer_rao"][q] for r in chosen if "cramer_rao" in r]
    free = np.array([r[f"{kind}error_log"][q] for r in chosen if not r["active"]])
    return {
        "bias": float(found.mean()),
        "spread": float(found.std(ddof=1)) if len(found) > 1 else 0.0,
        "bound": float(np.mean(bounds)) if bounds else np.nan,
        "coverage": float(np.mean([r[f"{kind}covered"][q] for r in chosen])),
        "interval_sd": float(np.mean([r["interval_sd"][q] for r in chosen])),
        "at_bound": 1.0 - len(free) / len(chosen),
        "free": len(free),
        "free_spread": float(free.std(ddof=1)) if len(free) > 1 else np.nan,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument(
        "--antithetic", type=int, default=0, help="seeds fitted again with sign-flipped noise"
    )
    parser.add_argument("--output", type=Path, default=Path("out/recovery"))
    parser.add_argument("--misfit", action="store_true", help="fingers that differ from the model")
    args = parser.parse_args()
    run(args.output, args.seeds, args.misfit, args.antithetic)


if __name__ == "__main__":
    main()
