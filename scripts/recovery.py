"""How well a fit recovers the finger that made its data: bias, spread, Cramér–Rao bound, coverage, over many seeds.

    python scripts/recovery.py [--seeds 24] [--output out/recovery]

Presses and true areas come from the full-order model on the study's finer mesh: a pool of presses per condition is
simulated once and kept. Every seed draws 15 of them per condition and gives them new sensor and area noise, so that
seeds share presses but no noise. Each draw is fitted over the loading alone and over the whole contact. Writes
recovery.json, and prints the tables of docs/study.md.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.stats import t as student

from finger_common.files import atomic_write
from finger_fit.fit import polish
from finger_fit.identifiability import (
    _held,
    covariance,
    cramer_rao,
    quantity,
    quantity_box,
    quantity_deviation,
)
from finger_fit.local import refine
from finger_fit.options import FitOptions
from finger_fit.problem import MM4, FitProblem
from finger_fit.search import best_points, search_grid
from finger_fit.trials import prepare_all
from finger_model.reduced import ReducedModel
from finger_sim.conditions import STUDY
from finger_sim.press import Press
from finger_sim.study import (
    AREA_NOISE,
    START_NS,
    Misfit,
    StudyTrial,
    measured_area,
    measured_force,
    plan_study_trial,
)

POOL_SEED = 1
POOL = 24
"""Presses per condition; the first 15 are those of `finger-rig study --seed 1`."""

TRIALS = 15
WINDOWS = ("loading", "contact")
TOLD = {"composite_E": "E", "E2": "E2", "tau1": "tau1"}
GRID = 3

STEP = 0.02
"""s, of the model's drive; halving it changes areas by less than the noise by far."""


def _plan(misfit: bool, job: tuple[str, int]) -> StudyTrial:
    return plan_study_trial(POOL_SEED, job[0], job[1], misfit)


def pool(folder: Path, number: int = POOL, misfit: bool = False) -> dict[str, list[StudyTrial]]:
    """Presses with their true areas, simulated once and kept in `folder`."""
    path = folder / ("pool_misfit.npz" if misfit else "pool.npz")
    if path.exists():
        return _read(path)
    jobs = [(name, index) for name in STUDY for index in range(number)]
    context = multiprocessing.get_context("spawn")
    out: dict[str, list[StudyTrial]] = {name: [] for name in STUDY}
    arrays: dict[str, np.ndarray] = {}
    with ProcessPoolExecutor(2, context) as workers:
        for count, trial in enumerate(workers.map(partial(_plan, misfit), jobs), 1):
            out[trial.condition].append(trial)
            key, press = f"{trial.condition}/{trial.index}", trial.press
            arrays[f"{key}/press"] = np.array([press.time, press.force])
            arrays[f"{key}/events"] = np.array(
                [press.onset, press.cue, press.release, press.lift_off]
            )
            arrays[f"{key}/frames"] = np.array([trial.frame_time, trial.area])
            arrays[f"{key}/moisture"] = trial.moisture
            print(f"\rpool: {count}/{len(jobs)} presses", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
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
            time, force = arrays[key]
            press = Press(time, force, *map(float, arrays[f"{base}/events"]))
            frame_time, area = arrays[f"{base}/frames"]
            out[name].append(
                StudyTrial(
                    name, int(index), press, frame_time, area, arrays[f"{base}/moisture"], Misfit()
                )
            )
    return {name: sorted(trials, key=lambda t: t.index) for name, trials in out.items()}


def record(trial: StudyTrial, seed: int, noise: bool) -> Any:
    """A recorded trial of the pool with this seed's noise."""
    if noise:
        time, force = measured_force(trial, seed)
        area = measured_area(trial, seed)
        normal = -force[:, 2]
    else:
        time, normal, area = trial.press.time, trial.press.force, trial.area
    return SimpleNamespace(
        bag=f"pool_{seed}",
        subject="SIM1",
        condition=trial.condition,
        index=trial.index,
        stamp_ns=START_NS + np.round(time * 1e9).astype(np.int64),
        force=normal,
        area_stamp_ns=START_NS + np.round(trial.frame_time * 1e9).astype(np.int64),
        area=area,
        area_sd=np.full(len(area), AREA_NOISE),
        area_flags=np.where(trial.area > 0, 0, 1),
        moisture_before=list(trial.moisture[:3]),
        moisture_after=list(trial.moisture[3:]),
    )


def fit_one(
    trials: list[StudyTrial], seed: int, window: str, noise: bool, model: Any
) -> dict[str, Any]:
    """Fit one condition of one seed; everything a table needs."""
    name = trials[0].condition
    truth = STUDY[name].material.vector()
    options = FitOptions(window=window, grid=GRID, step=STEP, seed=seed)
    prepared, excluded = prepare_all([record(t, seed, noise) for t in trials], options)
    problem = FitProblem(prepared, model, options)
    grid = search_grid(problem.cost, problem.box, GRID)
    start = best_points(grid, 5)
    fit = polish(problem, start[0], float(grid.costs.min()), start[1:2])
    found = covariance(problem, fit.parameters)
    law, true_cost = problem.power_law(), float(problem.cost(truth)[0])
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
        "active": found.active,
        "excluded": len(excluded),
        "frames": len(problem.measured),
        "error_log": {},
        "covered": {},
        "interval_sd": {},
    }
    if noise:
        out["cramer_rao"] = cramer_rao(problem, truth, AREA_NOISE)
    factor = student.ppf(0.975, len(problem) - 1)
    for q in TOLD:
        true, value = float(quantity(q, truth)), float(quantity(q, fit.parameters))
        out["error_log"][q] = float(np.log(value / true))
        deviation, rise = quantity_deviation(problem, q, fit.parameters, found)
        out["interval_sd"][q] = deviation
        # The true value lies in the reported interval if the profile there stays below the threshold.
        low, high = quantity_box(q, problem.box)
        held = _held(q, problem.box, float(np.clip(true, low * (1 + 1e-9), high * (1 - 1e-9))))
        drop = 1 if q == "composite_E" else ["E0", "E1", "tau1", "E2"].index(q)
        if held is not None:
            begin = np.log(np.delete(fit.parameters, drop))
            there = refine(problem, held, begin, tolerance=1e-5).cost
            out["covered"][q] = bool(there <= fit.cost + factor**2 * rise)
    return out


_shared: dict[str, Any] = {}


def _one_seed(folder: Path, noise: bool, misfit: bool, seed: int) -> list[dict[str, Any]]:
    if "model" not in _shared:
        import numba

        numba.set_num_threads(1)
        _shared["model"] = ReducedModel.load()
        _shared["pool"] = pool(folder, misfit=misfit)
    rows = []
    for _name, trials in _shared["pool"].items():
        chosen = np.sort(np.random.default_rng([seed, 7]).permutation(len(trials))[:TRIALS])
        if not noise or misfit:
            chosen = np.arange(TRIALS)
        for window in WINDOWS:
            drawn = [trials[i] for i in chosen]
            rows.append(fit_one(drawn, seed, window, noise, _shared["model"]))
    return rows


def run(folder: Path, seeds: int, misfit: bool = False) -> dict[str, Any]:
    """All seeds on two processes, and one fit without noise first; kept on disk after every seed."""
    pool(folder, misfit=misfit)
    context = multiprocessing.get_context("spawn")
    result: dict[str, Any] = {"rows": [], "clean": [], "model": ReducedModel.load().hash}
    with ProcessPoolExecutor(2, context) as workers:
        clean = workers.submit(_one_seed, folder, False, misfit, 0)
        jobs = workers.map(partial(_one_seed, folder, True, misfit), range(100, 100 + seeds))
        result["clean"] = clean.result()
        for count, found in enumerate(jobs, 1):
            result["rows"] += found
            print(f"\rseeds: {count}/{seeds}", end="", file=sys.stderr, flush=True)
            with atomic_write(result_file(folder, misfit)) as file:
                json.dump(result, file)
        print(file=sys.stderr)
    return result


def result_file(folder: Path, misfit: bool) -> Path:
    """Where the results are kept."""
    return folder / ("recovery_misfit.json" if misfit else "recovery.json")


def statistics(rows: list[dict[str, Any]], name: str, window: str, q: str) -> dict[str, float]:
    """Bias and spread in logarithm, the Cramér–Rao bound, and coverage of one quantity."""
    chosen = [r for r in rows if r["condition"] == name and r["window"] == window]
    error = np.array([r["error_log"][q] for r in chosen])
    bound = (
        float(np.mean([r["cramer_rao"][q] for r in chosen]))
        if "cramer_rao" in chosen[0]
        else np.nan
    )
    return {
        "bias": float(error.mean()),
        "spread": float(error.std(ddof=1)) if len(error) > 1 else 0.0,
        "bound": bound,
        "coverage": float(np.mean([r["covered"][q] for r in chosen])),
        "seeds": len(chosen),
        "at_bound": float(np.mean([bool(r["active"]) for r in chosen])),
    }


SYMBOL = {"composite_E": "E", "E2": "E2", "tau1": "τ1"}


def tables(result: dict[str, Any]) -> str:
    """Markdown tables."""
    lines = [
        "| window | condition | quantity | bias (%) | spread (%) | Cramér–Rao (%) | bias / spread | spread / bound | covered | fits on a bound |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for window in WINDOWS:
        for name in STUDY:
            for q in TOLD:
                s = statistics(result["rows"], name, window, q)
                lines.append(
                    f"| {window} | {name} | {SYMBOL[q]} | {100 * s['bias']:+.1f} | {100 * s['spread']:.1f} | "
                    f"{100 * s['bound']:.1f} | {s['bias'] / max(s['spread'], 1e-12):+.2f} | {s['spread'] / s['bound']:.2f} | "
                    f"{100 * s['coverage']:.0f} % | {100 * s['at_bound']:.0f} % |"
                )
    lines += [
        "",
        "Without noise:",
        "",
        "| window | condition | E error (%) | E2 error (%) | τ1 error (%) | J (mm⁴) |",
        "|---|---|---|---|---|---|",
    ]
    for row in result["clean"]:
        e = row["error_log"]
        lines.append(
            f"| {row['window']} | {row['condition']} | {100 * e['composite_E']:+.2f} | {100 * e['E2']:+.2f} | {100 * e['tau1']:+.1f} | {row['J']:.3f} |"
        )
    rows = result["rows"]
    lines += [
        "",
        "Cost, mean over seeds (mm⁴):",
        "",
        "| window | condition | J fit | J truth | largest J fit / J truth | J power law | (J_pl − J) over the same gap at the truth | power law m | log–log m |",
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
            gap = (mean["J_power_law"] - mean["J"]) / (mean["J_power_law"] - mean["J_truth"])
            lines.append(
                f"| {window} | {name} | {mean['J']:.1f} | {mean['J_truth']:.1f} | {worst:.3f} | {mean['J_power_law']:.1f} | {gap:.2f} | {mean['power_law_m']:.2f} | {mean['power_law_log_m']:.2f} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--output", type=Path, default=Path("out/recovery"))
    parser.add_argument("--misfit", action="store_true", help="trials that differ from the model")
    parser.add_argument("--pool-only", action="store_true", help="only simulate the presses")
    parser.add_argument("--tables", action="store_true", help="print the tables of a former run")
    args = parser.parse_args()
    if args.pool_only:
        pool(args.output, misfit=args.misfit)
        return
    if args.tables:
        print(tables(json.loads(result_file(args.output, args.misfit).read_text())))
        return
    print(tables(run(args.output, args.seeds, args.misfit)))


if __name__ == "__main__":
    main()
