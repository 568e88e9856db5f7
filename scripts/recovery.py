"""How well a fit recovers the finger that made its data: bias, spread, Cramér–Rao bound, coverage, over many seeds.

    python scripts/recovery.py [--seeds 24] [--mirror 12] [--misfit] [--output out/recovery]

Presses and true areas come from the full-order model on the study's finer mesh, simulated once and kept. Every seed
draws 15 presses per condition and gives them new sensor and area noise, so that seeds share presses but no noise. Each
draw is fitted over the loading alone and over the whole contact, as `finger-fit` fits: grid, polish, correction to full
order, polish, intervals, bias. (The swarm is left out: the polish ends in the same valley; `start_from_truth` in the result
tells whether it did.)

The correction needs full-order areas at each fit's own parameters. For thousands of fits they come from a table: the
fit's full-order model (its mesh and step) on every press without noise, at parameter sets spread over where the fits
fall; the ratio to the reduced model is interpolated between them. `--exact N` runs the model itself for N seeds and says
what difference that makes.

`--mirror N` fits N of the draws once more with their area noise turned round: the error's odd part cancels in the mean, which
then tells a bias from chance with far fewer seeds.

`--misfit` fits fingers that differ from the fit's assumptions: an epidermis a quarter thinner or thicker (a few presses
without noise), and areas of whole trials scattered by 5 % (many seeds). Writes recovery.json (recovery_misfit.json) and prints the tables of docs/study.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RBFInterpolator

from finger_common.files import atomic_write
from finger_fit.bias import bias_pair, unbiased
from finger_fit.engine import LocalEngine
from finger_fit.fit import polish
from finger_fit.full_order_check import (
    REFINEMENT,
    correct,
    correction_around,
    full_order_areas,
)
from finger_fit.identifiability import (
    covariance,
    cramer_rao,
    in_interval,
    quantity,
    quantity_box,
    quantity_deviation,
)
from finger_fit.local import refine, whole_box
from finger_fit.options import FitOptions
from finger_fit.problem import MM4, FitProblem
from finger_fit.search import best_points, search_grid
from finger_fit.trials import FitTrial, prepare, prepare_all
from finger_model.geometry import Geometry
from finger_model.material import Material
from finger_model.paper import TRIALS_PER_CONDITION
from finger_model.reduced import ReducedModel
from finger_sim.conditions import STUDY
from finger_sim.press import Press
from finger_sim.study_bag import START_NS
from finger_sim.study_trial import (
    AREA_NOISE,
    AREA_SCATTER,
    Misfit,
    StudyTrial,
    measured_area,
    measured_force,
    plan_study_trial,
)
from finger_sim.study_trial import REFINEMENT as REFINEMENT_OF_STUDY

POOL_SEED = 1
POOL = 20
"""Presses per condition; the first 15 are those of `finger-rig study --seed 1`."""

WINDOWS = ("loading", "contact")
TOLD = ("composite_E", "E2", "tau1")
SYMBOL = {"composite_E": "E", "E2": "E2", "tau1": "τ1"}
GRID = 3
FIRST_SEED = 100

SEARCHED = 2
"""Seeds that begin with the whole search; the others begin at the truth."""

STEP = 0.04
"""s, time step of the reduced model: half the time of the default's 0.02 s, and the correction takes up the difference."""

PAIRS = 10
"""Of the bias's bootstrap, half the default's: what one fit's bias then errs by averages out over the seeds."""

FEW = 5
"""Presses per condition of a finger with another epidermis: what it does is no matter of chance."""

FEWEST_FREE = 15
"""Fits that a spread of their own is told for."""

FINGERS = {"true": 1.0, "thin": 0.75, "thick": 1.25}
"""Epidermis of the simulated finger over the one the fit assumes."""


# Presses, and the table of full-order areas ---------------------------------------------------


def _spread(
    work: Callable[[Any], Any], jobs: Sequence[Any], what: str, processes: int = 2
) -> Iterable[Any]:
    """Results of work(job) in order, in processes of their own, with progress."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(jobs)), context) as workers:
        for count, result in enumerate(workers.map(work, jobs), 1):
            print(f"\r{what}: {count}/{len(jobs)}", end="", file=sys.stderr, flush=True)
            yield result
    print(file=sys.stderr)


def _plan(job: tuple[str, int, float]) -> StudyTrial:
    name, index, factor = job
    # A quarter of the epidermis is a thousand times what the finer mesh changes.
    mesh = REFINEMENT_OF_STUDY if factor == 1.0 else 1.0
    return plan_study_trial(POOL_SEED, name, index, Misfit(epidermis_factor=factor), mesh)


def pool(folder: Path, finger: str = "true") -> dict[str, list[StudyTrial]]:
    """Presses of one finger with their true areas, simulated once and kept in `folder`."""
    number = POOL if finger == "true" else FEW
    path = folder / ("pool.npz" if finger == "true" else f"pool_{finger}.npz")
    if path.exists():
        return {name: trials[:number] for name, trials in _read(path).items()}
    folder.mkdir(parents=True, exist_ok=True)
    out: dict[str, list[StudyTrial]] = {name: [] for name in STUDY}
    arrays: dict[str, np.ndarray] = {}
    jobs = [(name, index, FINGERS[finger]) for name in STUDY for index in range(number)]
    for trial in _spread(_plan, jobs, f"presses, {finger} epidermis"):
        out[trial.condition].append(trial)
        key, press = f"{trial.condition}/{trial.index}", trial.press
        arrays[f"{key}/press"] = np.array([press.time, press.force])
        arrays[f"{key}/events"] = np.array([press.onset, press.cue, press.release, press.lift_off])
        arrays[f"{key}/frames"] = np.array([trial.frame_time, trial.area])
        arrays[f"{key}/moisture"] = trial.moisture
    with atomic_write(path, "wb") as file:
        np.savez_compressed(file, **arrays)
    return out


def _read(path: Path) -> dict[str, list[StudyTrial]]:
    out: dict[str, list[StudyTrial]] = {name: [] for name in STUDY}
    with np.load(path) as arrays:
        for key in arrays.files:
            if not key.endswith("/press"):
                continue
            name, index = key.split("/")[:2]
            base = f"{name}/{index}"
            press = Press(*arrays[key], *map(float, arrays[f"{base}/events"]))
            frame_time, area = arrays[f"{base}/frames"]
            moisture = arrays[f"{base}/moisture"]
            trial = StudyTrial(name, int(index), press, frame_time, area, moisture, Misfit())
            out[name].append(trial)
    return {name: sorted(trials, key=lambda t: t.index) for name, trials in out.items()}


def record(
    trial: StudyTrial, seed: int, noise: bool, factor: float = 1.0, mirror: bool = False
) -> Any:
    """A recorded trial of the pool with this seed's noise, mirrored with its areas' noise turned round; `factor` on its
    areas before the noise."""
    from dataclasses import replace

    trial = replace(trial, area=trial.area * factor)
    if noise:
        time_, force = measured_force(trial, seed)
        area, normal = measured_area(trial, seed), -force[:, 2]
        if mirror:
            area = np.maximum(2.0 * trial.area - area, 0.0)
    else:
        time_, normal, area = trial.press.time, trial.press.force, trial.area
    return SimpleNamespace(
        bag=f"pool_{seed}",
        subject="SIM1",
        condition=trial.condition,
        index=trial.index,
        stamp_ns=START_NS + np.round(time_ * 1e9).astype(np.int64),
        force=normal,
        area_stamp_ns=START_NS + np.round(trial.frame_time * 1e9).astype(np.int64),
        area=area,
        area_sd=np.full(len(area), AREA_NOISE),
        area_flags=np.where(trial.area > 0, 0, 1),
        moisture_before=list(trial.moisture[:3]),
        moisture_after=list(trial.moisture[3:]),
    )


def whole_press(trial: StudyTrial, step: float = STEP) -> FitTrial:
    """The press without noise, with more of its frames than any window counts."""
    options = FitOptions(window="contact", onset_force=0.02, step=step)
    return prepare(record(trial, 0, False), options)


def design(name: str) -> np.ndarray:
    """Parameter sets (6, 4) of the table: the truth, and about one deviation of a fit away from it in composite
    modulus, tau1 and E2, and as far as the box allows in E0 with the composite held."""
    box = FitOptions().box()
    E0, _, tau1, E2 = STUDY[name].material.vector()
    E = STUDY[name].material.composite_modulus
    least = max(box[0, 0], 1.05 / (1.0 / E - 1.0 / box[1, 1]))
    sets = [(E, E0, tau1, E2), (1.1 * E, E0, tau1, E2), (E, least, tau1, E2)]
    other = box[0, 1] if E0 < 0.8 * box[0, 1] else np.sqrt(least * box[0, 1])
    sets += [(E, other, tau1, E2), (E, E0, 1.4 * tau1, E2)]
    sets += [(E, E0, tau1, E2 * (1.2 if E2 < 1000e3 else 0.85))]
    return np.array([[e0, 1.0 / (1.0 / e - 1.0 / e0), t, e2] for e, e0, t, e2 in sets])


def _tabulate(job: tuple[StudyTrial, np.ndarray]) -> np.ndarray:
    """Areas (6, k) of one press. The fit's own mesh at the truth; how areas change with the parameters is taken from the
    default mesh, which takes half the time."""
    trial, points = job
    press = [whole_press(trial, FitOptions().step)]
    fine = full_order_areas((Geometry(), REFINEMENT, Material(), press), (tuple(points[0]), 0))
    shared = (Geometry(), 1.0, Material(), press)
    coarse = np.array([full_order_areas(shared, (tuple(p), 0)) for p in points])
    return coarse * (fine / coarse[0])


def full_order_table(folder: Path) -> dict[str, np.ndarray]:
    """Areas (6, frames) of every press of the pool by "condition/index"; simulated once and kept."""
    path = folder / "full_order.npz"
    if path.exists():
        with np.load(path) as arrays:
            return {key: arrays[key] for key in arrays.files}
    trials = [trial for part in pool(folder).values() for trial in part]
    jobs = [(trial, design(trial.condition)) for trial in trials]
    table = {
        f"{trial.condition}/{trial.index}": areas
        for trial, areas in zip(trials, _spread(_tabulate, jobs, "full-order table"))
    }
    with atomic_write(path, "wb") as file:
        np.savez_compressed(file, **table)
    return table


class Tabulated:
    """Stands in for `full_order_areas`: the reduced model times the table's ratio at the parameters asked for."""

    def __init__(self, folder: Path, model: ReducedModel) -> None:
        self._model = model
        self._ratios: dict[str, tuple[np.ndarray, RBFInterpolator]] = {}
        table, presses = full_order_table(folder), pool(folder)
        for name, trials in presses.items():
            points = design(name)
            for trial in trials:
                fine, areas = whole_press(trial), table[f"{name}/{trial.index}"]
                reduced = model.batch(points, [(fine.time, fine.force, fine.frames)])[0]
                usable = np.isfinite(areas).all(axis=1)
                interpolator = RBFInterpolator(
                    self._place(points[usable]),
                    np.log(areas[usable] / reduced[usable]),
                    kernel="cubic",
                )
                self._ratios[f"{name}/{trial.index}"] = (
                    frame_numbers(trial.area, fine),
                    interpolator,
                )

    @staticmethod
    def _place(parameters: np.ndarray) -> np.ndarray:
        """Coordinates (n, 4) in which the ratio is smooth: composite modulus, E0, tau1, E2."""
        logs = np.log(np.atleast_2d(parameters))
        composite = np.log(quantity("composite_E", np.atleast_2d(parameters)))
        return np.column_stack([2.0 * composite, logs[:, 0], logs[:, 2], logs[:, 3]])

    def simulator(self, recorded: Sequence[Any]) -> Callable[[Any, Any], np.ndarray]:
        """For trials prepared from these records."""
        by_name = {f"{r.condition}/{r.index}": r for r in recorded}

        def simulate(shared: Any, item: tuple[tuple[float, ...], int]) -> np.ndarray:
            parameters, trial = np.array(item[0]), shared[3][item[1]]
            key = f"{trial.condition}/{trial.index}"
            numbers, interpolator = self._ratios[key]
            ratio = np.exp(interpolator(self._place(parameters))[0])
            drive = [(trial.time, trial.force, trial.frames)]
            reduced = self._model.batch(parameters[None], drive)[0][0]
            wanted = frame_numbers(by_name[key].area, trial)
            return reduced * np.interp(wanted, numbers, ratio)

        return simulate


def frame_numbers(area: np.ndarray, trial: FitTrial) -> np.ndarray:
    """Numbers (k,) among a record's frames of those a fit counts; a noisy area occurs once."""
    return np.array([int(np.flatnonzero(area == a)[0]) for a in trial.area])


# Fits ------------------------------------------------------------------------------------------


class Here(LocalEngine):
    """Everything in this process."""

    spread = LocalEngine.map


def errors(parameters: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Differences of the told quantities' logarithms from the truth."""
    return {q: float(np.log(quantity(q, parameters) / quantity(q, truth))) for q in TOLD}


def fit_one(
    trials: list[StudyTrial],
    seed: int,
    window: str,
    noise: bool,
    model: Any,
    table: Tabulated | None,
    factors: np.ndarray | None = None,
    search: bool = True,
    mirror: bool = False,
) -> dict[str, Any]:
    """Fit one condition of one seed; everything the tables need. table: None runs the full-order model itself;
    search: False begins at the truth."""
    name = trials[0].condition
    truth = STUDY[name].material.vector()
    options = FitOptions(window=window, seed=seed, step=STEP)
    factors = np.ones(len(trials)) if factors is None else factors
    recorded = [record(t, seed, noise, f, mirror) for t, f in zip(trials, factors)]
    prepared, excluded = prepare_all(recorded, options)
    problem = FitProblem(prepared, model, options)
    simulate = full_order_areas if table is None else table.simulator(recorded)
    searched: dict[str, Any] = {}
    begin = truth
    if search:
        grid = search_grid(problem.cost, problem.box, GRID)
        start = best_points(grid, 2)
        found = polish(problem, start[0], float(grid.costs.min()), start[1:2])
        # Had the search missed a valley, a start at the truth would find a lower J.
        from_truth = refine(problem, whole_box(problem.box), np.log(truth))
        begin = found.parameters
        searched = {
            "uncorrected": begin.tolist(),
            "uncorrected_error_log": errors(begin, truth),
            "J_uncorrected": found.cost * MM4,
            "start_from_truth": from_truth.cost / found.cost,
        }
    fit, correction = correct(problem, begin, Geometry(), Here(), simulate=simulate)
    told = covariance(problem, fit.parameters)
    law = problem.power_law()
    by_key = {f"{r.condition}/{r.index}": (r, t) for r, t in zip(recorded, trials)}
    pairs = [(*by_key[f"{p.condition}/{p.index}"], p) for p in prepared]
    true_areas = np.concatenate([t.area[frame_numbers(r.area, p)] for r, t, p in pairs])
    true_cost = float(problem.trial_costs(true_areas).sum())
    out: dict[str, Any] = {
        "condition": name,
        "window": window,
        "seed": seed,
        "parameters": fit.parameters.tolist(),
        "J": fit.cost * MM4,
        "J_truth": true_cost * MM4,
        "J_power_law": law.cost * MM4,
        "power_law_m": law.m,
        "power_law_log_m": law.log_m,
        "largest_correction": correction.largest_factor,
        "active": told.active,
        "noise": told.noise,
        "excluded": len(excluded),
        "frames": len(problem.measured),
        "error_log": errors(fit.parameters, truth),
        "corrected_error_log": {},
        "bias_log": {},
        "covered": {},
        "corrected_covered": {},
        "interval_sd": {},
        **searched,
    }
    if noise:
        # The fit's own correction may lie far from the truth: sensitivities there need one of their own.
        at_truth = FitProblem(prepared, model, options)
        at_truth.correction = correction_around(
            at_truth, truth, Geometry(), Here(), simulate=simulate
        )
        out["cramer_rao"] = cramer_rao(at_truth, truth, AREA_NOISE)
    pairs = [bias_pair(problem, fit.parameters, seed, i) for i in range(PAIRS)]
    corrected = unbiased(fit.parameters, np.array(pairs))
    for q in TOLD:
        true = float(quantity(q, truth))
        out["bias_log"][q] = corrected[q].bias
        out["corrected_error_log"][q] = float(np.log(corrected[q].value / true))
        out["interval_sd"][q], _ = quantity_deviation(problem, q, fit.parameters, told)
        out["covered"][q] = in_interval(problem, q, true, fit.parameters, fit.cost, told)
        # The truth lies in an interval moved by −bias where truth · exp(bias) lies in the interval itself.
        low, high = quantity_box(q, problem.box)
        moved = float(np.clip(true * np.exp(corrected[q].bias), low, high))
        out["corrected_covered"][q] = in_interval(problem, q, moved, fit.parameters, fit.cost, told)
    return out


_shared: dict[str, Any] = {}


class Job(NamedTuple):
    """The fits of one seed."""

    seed: int
    finger: str = "true"
    scatter: bool = False
    noise: bool = True
    exact: bool = False
    mirror: bool = False


def _one_seed(folder: Path, job: Job) -> list[dict[str, Any]]:
    """Fits of one seed."""
    seed, finger, scatter, noise, exact, mirror = job
    if "model" not in _shared:
        import numba

        numba.set_num_threads(1)
        _shared["model"] = ReducedModel.load()
    if finger not in _shared:
        _shared[finger] = pool(folder, finger)
    if not exact and "table" not in _shared:
        _shared["table"] = Tabulated(folder, _shared["model"])
    table = None if exact else _shared["table"]
    rows = []
    for trials in _shared[finger].values():
        rng = np.random.default_rng([seed, 7])
        chosen = (
            np.sort(rng.permutation(len(trials))[:TRIALS_PER_CONDITION])
            if noise
            else np.arange(min(TRIALS_PER_CONDITION, len(trials)))
        )
        factors = np.exp(rng.normal(0.0, AREA_SCATTER, TRIALS_PER_CONDITION)) if scatter else None
        for window in WINDOWS:
            row = fit_one(
                [trials[i] for i in chosen], seed, window, noise, _shared["model"], table, factors,
                search=seed < FIRST_SEED + SEARCHED and not mirror, mirror=mirror,
            )  # fmt: skip
            about = {"finger": finger, "scatter": scatter, "exact": exact, "mirror": mirror}
            rows.append({**row, **about})
    return rows


def run(
    folder: Path, seeds: int, misfit: bool = False, exact: int = 0, mirror: int = 0
) -> dict[str, Any]:
    """All seeds on two processes, and fits without noise; kept on disk after every seed."""
    for finger in FINGERS if misfit else ("true",):
        pool(folder, finger)
    full_order_table(folder)
    seed_numbers = range(FIRST_SEED, FIRST_SEED + seeds)
    if misfit:
        jobs = [Job(0, finger, noise=False) for finger in ("true", "thin", "thick")]
        jobs += [Job(seed, scatter=True) for seed in reversed(seed_numbers)]
    else:
        jobs = [Job(0, noise=False)]
        jobs += [Job(seed, mirror=True) for seed in seed_numbers[:mirror]]
        # Last those that search, which take longest.
        jobs += [Job(seed) for seed in reversed(seed_numbers)]
        if exact:
            jobs += [Job(0, noise=False, exact=True)]
            jobs += [Job(seed, exact=True) for seed in seed_numbers[:exact]]
    model = ReducedModel.load()
    result: dict[str, Any] = {"rows": [], "mirrored": [], "clean": [], "exact": []}
    result["model"] = model.hash
    began, saved = time.time(), 0.0
    for job, rows in zip(jobs, _spread(partial(_one_seed, folder), jobs, "fits")):
        kind = "rows" if job.noise else "clean"
        kind = "exact" if job.exact else "mirrored" if job.mirror else kind
        result[kind] += rows
        if time.time() - saved > 20 or job is jobs[-1]:
            saved = time.time()
            result["seconds"] = saved - began
            with atomic_write(result_file(folder, misfit)) as file:
                json.dump(result, file)
    return result


def result_file(folder: Path, misfit: bool) -> Path:
    """Where the results are kept."""
    return folder / ("recovery_misfit.json" if misfit else "recovery.json")


# Tables ----------------------------------------------------------------------------------------


def statistics(
    rows: list[dict[str, Any]], name: str, window: str, q: str, kind: str = ""
) -> dict[str, float]:
    """Bias and spread in logarithm, the Cramér–Rao bound, and coverage of one quantity; kind: "corrected_" for the
    bias-corrected values and the intervals moved with them. "free" counts the fits with no parameter on a bound,
    "free_spread" is theirs."""
    chosen = [r for r in rows if r["condition"] == name and r["window"] == window]
    errors = np.array([r[f"{kind}error_log"][q] for r in chosen])
    bounds = [r["cramer_rao"][q] for r in chosen if "cramer_rao" in r]
    free = np.array([r[f"{kind}error_log"][q] for r in chosen if not r["active"]])
    return {
        "bias": float(errors.mean()),
        "spread": float(errors.std(ddof=1)) if len(errors) > 1 else 0.0,
        "bound": float(np.mean(bounds)) if bounds else np.nan,
        "coverage": float(np.mean([r[f"{kind}covered"][q] for r in chosen])),
        "seeds": len(chosen),
        "at_bound": 1.0 - len(free) / len(chosen),
        "free": len(free),
        "free_spread": float(free.std(ddof=1)) if len(free) > 1 else np.nan,
    }


def _cells() -> Iterable[tuple[str, str, str]]:
    """Window, condition and quantity of every row."""
    return itertools.product(WINDOWS, STUDY, TOLD)


def _row(s: dict[str, float], window: str, name: str, q: str) -> str:
    free = f"{s['free_spread'] / s['bound']:.2f}" if s["free"] >= FEWEST_FREE else "–"
    return (
        f"| {window} | {name} | {SYMBOL[q]} | {100 * s['bias']:+.1f} | {100 * s['spread']:.1f} | "
        f"{100 * s['bound']:.1f} | {s['bias'] / max(s['spread'], 1e-12):+.2f} | {s['spread'] / s['bound']:.2f} | "
        f"{free} | {100 * s['coverage']:.0f} % |"
    )


def tables(result: dict[str, Any]) -> str:
    """Markdown tables of a run without misfit."""
    rows, clean = result["rows"], result["clean"]
    lines = [
        "Estimates, which minimise J:",
        "",
        "| window | condition | quantity | bias (%) | spread (%) | Cramér–Rao (%) | bias / spread | spread / bound "
        "| the same, fits off the bounds | covered | mean interval SD (%) | fits on a bound |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for window, name, q in _cells():
        part = [r for r in rows if r["condition"] == name and r["window"] == window]
        told = np.mean([r["interval_sd"][q] for r in part])
        s = statistics(rows, name, window, q)
        lines.append(f"{_row(s, window, name, q)} {100 * told:.1f} | {100 * s['at_bound']:.0f} % |")
    lines += [
        "",
        "Bias-corrected (covered: by the interval moved with the value):",
        "",
        "| window | condition | quantity | bias (%) | spread (%) | Cramér–Rao (%) | bias / spread | spread / bound "
        "| the same, fits off the bounds | covered |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for window, name, q in _cells():
        lines.append(_row(statistics(rows, name, window, q, "corrected_"), window, name, q))
    lines += _mirrored_table(result)
    lines += [
        "",
        "Without noise (in brackets: before the correction to full order):",
        "",
        "| window | condition | E error (%) | E2 error (%) | τ1 error (%) | J (mm⁴) |",
        "|---|---|---|---|---|---|",
    ]
    for row in clean:
        cells = [
            f"{100 * row['error_log'][q]:+.2f} ({100 * row['uncorrected_error_log'][q]:+.1f})"
            for q in TOLD
        ]
        lines.append(
            f"| {row['window']} | {row['condition']} | {' | '.join(cells)} | {row['J']:.3f} ({row['J_uncorrected']:.2f}) |"
        )
    lines += [
        "",
        "Cost, mean over seeds (mm⁴):",
        "",
        "| window | condition | J fit | J truth | largest J fit / J truth | J power law | largest difference of "
        "J_pl − J at fit and truth | power law m | log–log m |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for window in WINDOWS:
        for name in STUDY:
            part = [r for r in rows if r["condition"] == name and r["window"] == window]
            mean = {
                k: float(np.mean([r[k] for r in part]))
                for k in ("J", "J_truth", "J_power_law", "power_law_m", "power_law_log_m")
            }
            worst = max(r["J"] / r["J_truth"] for r in part)
            apart = max(abs(r["J"] - r["J_truth"]) for r in part)
            share = max(
                abs(r["J"] - r["J_truth"]) / abs(r["J_power_law"] - r["J_truth"]) for r in part
            )
            lines.append(
                f"| {window} | {name} | {mean['J']:.1f} | {mean['J_truth']:.1f} | {worst:.3f} | {mean['J_power_law']:.1f} | "
                f"{apart:.1f} mm⁴, {100 * share:.0f} % | {mean['power_law_m']:.2f} | {mean['power_law_log_m']:.2f} |"
            )
    lines += ["", _searches(result)]
    return "\n".join(lines)


def mirrored_bias(
    result: dict[str, Any], name: str, window: str, q: str, kind: str = ""
) -> tuple[float, float, int]:
    """Bias over spread, its standard error, and pairs: means of two fits whose area noise has opposite signs."""
    error = f"{kind}error_log"
    first, second = (
        {
            r["seed"]: r[error][q]
            for r in result.get(part, [])
            if (r["condition"], r["window"]) == (name, window)
        }
        for part in ("rows", "mirrored")
    )
    means = np.array([0.5 * (first[s] + second[s]) for s in sorted(second) if s in first])
    spread = statistics(result["rows"], name, window, q, kind)["spread"]
    if len(means) < 2:
        return np.nan, np.nan, len(means)
    chance = means.std(ddof=1) / np.sqrt(len(means))
    return float(means.mean() / spread), float(chance / spread), len(means)


def _mirrored_table(result: dict[str, Any]) -> list[str]:
    """Lines of the table of biases with the noise's odd part cancelled; none without mirrored fits."""
    pairs = len({r["seed"] for r in result.get("mirrored", [])})
    if pairs < 2:
        return []
    lines = [
        "",
        f"Bias / spread of {pairs} seeds, each fitted also with its area noise turned round (± standard error of the mean):",
        "",
        "| window | condition | E, estimate | E, corrected | E2, estimate | E2, corrected | τ1, estimate | τ1, corrected |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for window, name in itertools.product(WINDOWS, STUDY):
        cells = []
        for q, kind in itertools.product(TOLD, ("", "corrected_")):
            bias, chance, _ = mirrored_bias(result, name, window, q, kind)
            cells.append(f"{bias:+.2f} ± {chance:.2f}")
        lines.append(f"| {window} | {name} | {' | '.join(cells)} |")
    return lines


def _searches(result: dict[str, Any]) -> str:
    """What the search and the full-order table may have missed, in words."""
    rows = result["rows"]
    searched = [r for r in rows if "start_from_truth" in r]
    missed = sum(r["start_from_truth"] < 0.999 for r in searched)
    text = (
        f"{len({r['seed'] for r in rows})} seeds, {len(rows)} fits. {len(searched)} of them began with the search; in "
        f"{missed} of these a start at the truth found a J lower by more than 0.1 %. "
    )
    exact = {(r["seed"], r["condition"], r["window"]): r for r in result["exact"]}
    pairs = [
        (r, exact[key])
        for r in rows + result["clean"]
        if (key := (r["seed"], r["condition"], r["window"])) in exact
    ]
    if pairs:
        worst = {q: max(abs(a["error_log"][q] - b["error_log"][q]) for a, b in pairs) for q in TOLD}
        text += (
            f"Corrected by full-order runs at the fits' own parameters instead of the table's, {len(pairs)} fits differ by at "
            "most " + ", ".join(f"{100 * v:.2f} % in {SYMBOL[q]}" for q, v in worst.items()) + ". "
        )
    return text + f"Reduced model {result['model'][:12]}."


def misfit_table(result: dict[str, Any]) -> str:
    """Markdown table of the bias that misfit makes."""
    seeds = len({r["seed"] for r in result["rows"]})
    lines = [
        f"| window | condition | quantity | epidermis −25 % | epidermis +25 % | areas scattered by 5 %: bias ± spread, {seeds} seeds "
        "| bias-corrected | covered, estimate and corrected |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for window in WINDOWS:
        for name in STUDY:
            for q in TOLD:
                shift = {
                    r["finger"]: 100 * np.expm1(r["error_log"][q])
                    for r in result["clean"]
                    if r["condition"] == name and r["window"] == window
                }
                cells = [f"{shift[finger]:+.0f} %" for finger in ("thin", "thick")]
                both = [statistics(result["rows"], name, window, q, k) for k in ("", "corrected_")]
                cells += [f"{100 * s['bias']:+.0f} ± {100 * s['spread']:.0f} %" for s in both]
                cells.append(", ".join(f"{100 * s['coverage']:.0f} %" for s in both))
                lines.append(f"| {window} | {name} | {SYMBOL[q]} | {' | '.join(cells)} |")
    lines += ["", "J of the fit without noise (mm⁴), epidermis thinner, as assumed, thicker:", ""]
    for window in WINDOWS:
        costs = []
        for name in STUDY:
            by_finger = {
                r["finger"]: r["J"]
                for r in result["clean"]
                if r["condition"] == name and r["window"] == window
            }
            costs.append(
                f"{name} " + ", ".join(f"{by_finger[f]:.2f}" for f in ("thin", "true", "thick"))
            )
        lines.append(f"- {window}: " + "; ".join(costs) + ".")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument(
        "--exact", type=int, default=0, help="seeds also corrected by the model itself"
    )
    parser.add_argument(
        "--mirror", type=int, default=0, help="seeds fitted again with their noise turned round"
    )
    parser.add_argument("--output", type=Path, default=Path("out/recovery"))
    parser.add_argument("--misfit", action="store_true", help="fingers that differ from the model")
    parser.add_argument("--pool-only", action="store_true", help="only simulate the presses")
    parser.add_argument("--tables", action="store_true", help="print the tables of a former run")
    args = parser.parse_args()
    make = misfit_table if args.misfit else tables
    if args.pool_only:
        for finger in FINGERS if args.misfit else ("true",):
            pool(args.output, finger)
        full_order_table(args.output)
        return
    if args.tables:
        print(make(json.loads(result_file(args.output, args.misfit).read_text())))
        return
    print(make(run(args.output, args.seeds, args.misfit, args.exact, args.mirror)))


if __name__ == "__main__":
    main()
