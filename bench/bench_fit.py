"""The whole study fit from bags on disk, its parts timed apart, and a study of many people."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_fit import Trial, fit
from finger_fit.hierarchy.command import population, read_subjects
from finger_fit.options import FitOptions
from finger_fit.report import write_report
from finger_fit.study import fit_bags
from finger_model.paper import TRIALS_PER_CONDITION
from finger_model.reduced import ReducedModel
from finger_sim.conditions import STUDY
from finger_sim.press import plan_press
from finger_sim.study_bag import START_NS, TRIAL_SECONDS, write_bag
from finger_sim.study_trial import FRAME_RATE, Misfit, StudyTrial, stream

SEED = 1
GOAL = 10.0
"""s, from bags on disk to parameters with nuisances: 13,500 trial simulations in the search."""

PARTS = {"profiles": False, "bias_pairs": 0, "bootstrap": 0, "full_order": False}
"""Options of a fit without its checks and refits, whose times are given apart."""

PEOPLE, PEOPLE_GOAL = 30, 300.0
"""Subjects of three conditions with 15 presses each; s, from arrays to population."""

BETWEEN = 0.2
"""Standard deviation of the logarithm of E0 and E1 between subjects."""


def study_bags(folder: Path, model: ReducedModel, trials: int) -> None:
    """Bags of the study's presses with contact_area; areas by the reduced model, for speed is
    measured, not accuracy.
    """
    number = 0
    for name, setting in STUDY.items():
        for index in range(trials):
            press = plan_press(stream(SEED, name, index, "press"))
            phase = stream(SEED, name, index, "camera").uniform(0.0, 1.0 / FRAME_RATE)
            frames = np.arange(phase, press.duration, 1.0 / FRAME_RATE)
            knots = np.union1d(press.time[::5], frames)
            force = np.interp(knots, press.time, press.force)
            history = model.simulate(setting.material, knots, force)
            area = np.interp(frames, knots, history.area)
            moisture = setting.draw_moisture(stream(SEED, name, index, "moisture"))
            trial = StudyTrial(name, index, press, frames, area, moisture, Misfit())
            start = START_NS + number * TRIAL_SECONDS * 1_000_000_000
            write_bag(folder / f"{name}_{index:02d}", trial, SEED, False, start)
            number += 1


def run(report: Any) -> None:
    """Time the fit of the study; fit_study is loading, PSO, nuisances and power law."""
    model = ReducedModel.load()
    trials = 3 if report.quick else TRIALS_PER_CONDITION
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "bags"
        study_bags(folder, model, trials)
        # Compile before the clock starts.
        model.batch(
            np.array([[1e5, 3e4, 0.1, 1e6]]), [(np.array([0.0, 0.1]), np.array([0.0, 0.1]))]
        )
        options = FitOptions(grid=2, polish=False, **PARTS)
        spent, used = [], []
        for _ in range(3):
            start, begun = time.perf_counter(), time.process_time()
            result = fit_bags([folder], options, None, model=model)
            spent.append(time.perf_counter() - start)
            used.append(time.process_time() - begun)
        evaluated = sum(f.pso.costs.size * len(f.problem) for f in result.fits.values())
        report.note(
            f"{evaluated} trial simulations in PSO; paper: 13,500 in 27,000 min (19 days); "
            "start points from a "
            f"grid of {options.grid}^4, which is included"
        )
        report.add("fit_study", float(np.median(spent)), "s", GOAL)
        report.add("fit_study_cpu", float(np.median(used)), "s")
        for stage in ("load", "pso", "nuisances"):
            report.add(f"fit_{stage}", result.seconds[stage], "s")
        boot = 20 if report.quick else 200
        options = FitOptions(bootstrap=boot, full_order=not report.quick)
        start = time.perf_counter()
        result = fit_bags([folder], options, Path(place) / "fit", ["natural"], model)
        report.note(
            f"one condition with everything: {time.perf_counter() - start:.1f} s; its parts "
            "follow, times three for a study"
        )
        stages = ("grid", "polish", "correction to full order", "check against full order")
        for stage in (*stages, "profiles", "bias", "bootstrap"):
            if stage in result.seconds:
                report.add(f"fit_{stage.replace(' ', '_')}", result.seconds[stage], "s")
        report.note(
            f"grid of {options.grid}^4 points per condition; {boot} bootstrap samples per condition"
        )
        start = time.perf_counter()
        write_report(result, Path(place) / "report")
        report.add("fit_report", time.perf_counter() - start, "s")
        if not report.quick:
            _vision(report, Path(place))
        _population(report, model, Path(place) / "people")


def subject_trials(
    model: ReducedModel, number: int, trials: int = TRIALS_PER_CONDITION
) -> list[Trial]:
    """Presses of one subject in the three conditions: own moduli, areas by the reduced model."""
    rng = np.random.default_rng([SEED, number])
    space, factor = model.space, np.exp(BETWEEN * rng.normal())
    found = []
    for name, setting in STUDY.items():
        own = setting.material.vector() * np.where(np.array(space.names) == "tau1", 1.0, factor)
        own = np.clip(own, *space.box.T)
        for index in range(trials):
            press = plan_press(stream(number, name, index, "press"))
            frames = np.arange(rng.uniform(0.0, 1.0 / FRAME_RATE), press.duration, 1.0 / FRAME_RATE)
            knots = np.union1d(press.time[::5], frames)
            force = np.interp(knots, press.time, press.force)
            rows = np.searchsorted(knots, frames)
            area = model.batch(own, [(knots, force, rows)])[0][0]
            noisy = np.maximum(area + rng.normal(0.0, TYPICAL_AREA_NOISE, len(area)), 0.0)
            area = np.where(force[rows] > 0, noisy, 0.0)
            moisture = setting.draw_moisture(rng)[:3]
            found.append(
                Trial(
                    press.time, press.force, area, frames, name, f"S{number:02d}", moisture,
                    index=index, label=f"S{number:02d}_{name}_{index:02d}",
                )
            )  # fmt: skip
    return found


def _population(report: Any, model: ReducedModel, folder: Path) -> None:
    """From the arrays of many subjects to the population: each fitted, then the hierarchy."""
    people = 3 if report.quick else PEOPLE
    presses = 3 if report.quick else TRIALS_PER_CONDITION
    trials = [t for i in range(people) for t in subject_trials(model, i, presses)]
    start, begun = time.perf_counter(), time.process_time()
    fit(trials, model=model, grid=2, **PARTS).save(folder)
    fitted = time.perf_counter() - start
    subjects = read_subjects([str(folder)])
    population(subjects, ["composite_E", "E2", "tau1"], model.space)
    report.note(f"{people} subjects, {len(STUDY)} conditions, {len(trials)} presses")
    report.add("population_fit", time.perf_counter() - start, "s", PEOPLE_GOAL)
    report.add("population_fit_cpu", time.process_time() - begun, "s")
    report.add("population_hierarchy", time.perf_counter() - start - fitted, "s")


def _vision(report: Any, place: Path) -> None:
    """Reading bags with images through the segmenter, per bag and for 45 of them."""
    from finger_fit.study import load, reading
    from finger_sim.study import simulate_study

    bags = simulate_study(SEED, place / "images", trials=1, refinement=1.0, report=None)
    start = time.perf_counter()
    loaded = load(bags, reading(FitOptions()))
    seconds = time.perf_counter() - start
    frames = sum(len(r.area) for r in loaded.records)
    report.note(f"{len(bags)} bags with images: {frames} frames in {seconds:.2f} s")
    report.add("fit_load_images_45", seconds / len(bags) * 45, "s")
