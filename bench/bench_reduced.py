"""Speed and accuracy of the reduced model."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from finger_model.commands.verify_reduced import SEED
from finger_model.estimator import ContactEstimator
from finger_model.finger import load_reduced
from finger_model.geometry import Geometry
from finger_model.laws.standard_linear_solid import PARAMETERS
from finger_model.paper import TARGET_FORCE
from finger_model.reduced import ReducedModel
from finger_model.reduced.error import ErrorTable, error_table
from finger_model.reduced.force_histories import human_press, random_parameters
from finger_model.reduced.model import POPULATION, load_population
from finger_model.reduced.population_build import held_out_runs
from finger_model.reduced.population_runs import random_geometry
from finger_model.reduced.population_training import measured_error
from finger_model.reduced.training_runs import held_out_case, pool, run_all
from finger_model.slip import SlipEstimator

SETS, TRIALS, FRAMES = 900, 15, 20
"""The paper's optimisation: five candidates and 60 rounds for three conditions, 15 trials each."""

PAIRS = 204

RUNS = 5
"""Of times of samples."""


def step_times(model: ReducedModel, number: int = 20000) -> np.ndarray:
    """Times (number,) in s of single steps through Python, on a press with 500 Hz."""
    state = model.start(model.space.default)
    force = 0.7 + 0.6 * np.sin(np.arange(number) * 0.01)
    for i in range(1000):
        model.step(state, 0.002, force[i])
    times = np.empty(number)
    gc.collect()
    gc.disable()
    for i in range(number):
        start = time.perf_counter()
        model.step(state, 0.002, force[i])
        times[i] = time.perf_counter() - start
    gc.enable()
    return times


def sample_times(model: ReducedModel, number: int = 20000) -> np.ndarray:
    """Times (number,) in s of `ContactEstimator.add_wrench`."""
    estimator = ContactEstimator(model)
    force = 0.7 + 0.6 * np.sin(np.arange(number) * 0.01)
    times = np.empty(number)
    gc.collect()
    gc.disable()
    for i in range(number):
        start = time.perf_counter()
        estimator.add_wrench(10**18 + 2_000_000 * i, (0.0, 0.0, -force[i]))
        times[i] = time.perf_counter() - start
    gc.enable()
    return times


def slip_sample_times(model: ReducedModel, number: int = 20000) -> np.ndarray:
    """Times (number,) in s of a sample through `ContactEstimator` and `SlipEstimator`, half of them
    in a load that is held, where it is looked for slip."""
    estimator, slip = ContactEstimator(model), SlipEstimator()
    phase = np.arange(number) * 0.01
    normal = 0.7 + 0.6 * np.sin(phase)
    lateral = np.minimum(0.2 + 0.15 * np.sin(0.7 * phase), 0.2)
    times = np.empty(number)
    gc.collect()
    gc.disable()
    for i in range(number):
        force = (lateral[i], 0.0, -normal[i])
        start = time.perf_counter()
        for estimate in estimator.add_wrench(10**18 + 2_000_000 * i, force):
            slip.add(estimate, force)
        times[i] = time.perf_counter() - start
    gc.enable()
    return times


def batch_seconds(model: ReducedModel, full_rate: bool) -> float:
    """Time (s) of 900 parameter sets over 15 trials on two threads; the best of three."""
    rng = np.random.default_rng(0)
    parameters = np.array([random_parameters(rng, PARAMETERS.box) for _ in range(SETS)])
    trials: list[tuple[np.ndarray, ...]] = []
    for _ in range(TRIALS):
        instants, force = human_press(rng, rate=500.0)
        rise = int(np.argmax(force >= TARGET_FORCE))
        frames = np.linspace(rise // FRAMES, rise, FRAMES).astype(int)
        if full_rate:
            trials.append((instants[: rise + 1], force[: rise + 1], frames))
        else:
            trials.append((instants[frames], force[frames]))
    before = numba.get_num_threads()
    numba.set_num_threads(min(2, before))
    try:
        model.batch(parameters[:2], trials)
        times = []
        for _ in range(1 if full_rate else 3):
            start = time.perf_counter()
            found = model.batch(parameters, trials)
            times.append(time.perf_counter() - start)
            assert all(np.all(np.isfinite(f)) for f in found)
    finally:
        numba.set_num_threads(before)
    return min(times)


def new_finger_times(number: int = 21) -> list[float]:
    """Times (s) from a geometry to the first contact, the file being read."""
    rng = np.random.default_rng(7)
    time_, force = np.array([0.0, 0.1]), np.array([0.0, 0.5])
    times = []
    for index in range(number + 1):
        geometry = random_geometry(rng, middle=True)
        begin = time.perf_counter()
        model = ReducedModel.load(geometry=geometry)
        model.simulate(model.space.default, time_, force)
        if index:
            times.append(time.perf_counter() - begin)
    return times


def run(report: Any) -> None:
    """Benchmark entry point."""
    own, any_finger = load_reduced(), load_reduced(POPULATION)
    _report_times(report, "reduced_step_p99", 20, step_times, own)
    _report_times(report, "estimator_sample_p99", 40, sample_times, own)
    _report_times(report, "slip_sample_p99", 50, slip_sample_times, own)
    _report_times(report, "any_finger_step_p99", 20, step_times, any_finger)
    _report_times(report, "any_finger_sample_p99", 40, sample_times, any_finger)
    _report_times(report, "any_finger_slip_sample_p99", 50, slip_sample_times, any_finger)
    report.add("reduced_paper_batch", batch_seconds(own, False), "s", 2)
    report.add("any_finger_paper_batch", batch_seconds(any_finger, False), "s", 2)
    report.add("reduced_full_rate_batch", batch_seconds(own, True), "s")
    report.add("new_finger_ms", 1e3 * np.median(new_finger_times()), "ms", 50)
    number = 24 if report.quick else PAIRS
    model = ReducedModel.load()
    with pool(2, model.geometry, 1.0, model.friction, None) as executor:
        runs = [r for r, _ in run_all(executor, [held_out_case(SEED, i) for i in range(number)])]
    _report(report, "default_finger_", error_table(model, runs))
    fingers = list(held_out_runs(SEED, 2 * number, 2))
    tables = measured_error(load_population(Geometry()).arrays, fingers)
    _report(report, "reduced_", tables["middle"])
    report.note("whole of the population box:\n" + tables["whole"].text(0.02, 0.04))


def _report_times(
    report: Any,
    name: str,
    goal: float,
    measure: Callable[[ReducedModel], np.ndarray],
    model: ReducedModel,
) -> None:
    """Add the 99th percentile, and note that of a machine that has nothing else to do."""
    times = 1e6 * np.array([measure(model) for _ in range(RUNS)])
    report.add(name, np.percentile(times, 99), "µs", goal)
    report.note(
        f"median {np.median(times):.1f} µs; p99 of the fastest of {RUNS} runs of each sample "
        f"{np.percentile(times.min(axis=0), 99):.1f} µs"
    )


def _report(report: Any, prefix: str, table: ErrorTable) -> None:
    summary = table.summary()
    report.add(prefix + "rms_error", 100 * summary["rms_p99"], "%", 1)
    report.add(prefix + "max_error", 100 * summary["worst_p99"], "%", 2)
    report.note(table.text())
