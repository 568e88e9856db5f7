"""The whole study fit from bags on disk, and its parts timed apart."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

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
"""s, for 13,500 trial simulations from bags on disk to parameters."""


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
    """Time the fit of the study; fit_study is loading, PSO and power law."""
    model = ReducedModel.load()
    trials = 3 if report.quick else TRIALS_PER_CONDITION
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "bags"
        study_bags(folder, model, trials)
        # Compile before the clock starts.
        model.batch(
            np.array([[1e5, 3e4, 0.1, 1e6]]), [(np.array([0.0, 0.1]), np.array([0.0, 0.1]))]
        )
        options = FitOptions(grid=2, polish=False, full_order=False, profiles=False, bootstrap=0)
        spent = []
        for _ in range(3):
            start = time.perf_counter()
            result = fit_bags([folder], options, None, model=model)
            spent.append(time.perf_counter() - start)
        evaluated = sum(f.pso.costs.size * len(f.problem) for f in result.fits.values())
        report.note(
            f"{evaluated} trial simulations in PSO; paper: 13,500 in 27,000 min (19 days); "
            "start points from a "
            f"grid of {options.grid}^4, which is included"
        )
        report.add("fit_study", float(np.median(spent)), "s", GOAL)
        report.add("fit_load", result.seconds["load"], "s")
        report.add("fit_pso", result.seconds["pso"], "s")
        boot = 20 if report.quick else 200
        options = FitOptions(bootstrap=boot, full_order=not report.quick)
        start = time.perf_counter()
        result = fit_bags([folder], options, Path(place) / "fit", ["natural"], model)
        report.note(
            f"one condition with everything: {time.perf_counter() - start:.1f} s; its parts "
            "follow, times three for a study"
        )
        for stage in ("grid", "polish", "full order", "profiles", "bias", "bootstrap"):
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


def _vision(report: Any, place: Path) -> None:
    """Reading bags with images through the segmenter, per bag and for 45 of them."""
    from finger_fit.study import load
    from finger_sim.study import simulate_study

    bags = simulate_study(SEED, place / "images", trials=1, refinement=1.0, report=None)
    start = time.perf_counter()
    loaded = load(bags, FitOptions())
    seconds = time.perf_counter() - start
    frames = sum(len(r.area) for r in loaded.records)
    report.note(f"{len(bags)} bags with images: {frames} frames in {seconds:.2f} s")
    report.add("fit_load_images_45", seconds / len(bags) * 45, "s")
