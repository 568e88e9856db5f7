"""Time to fit a subject's six presses, in the model node's own code."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from finger_common.guided_presses import CALIBRATION_PRESSES
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.calibration import CalibrationPress, calibrate
from finger_model.finger import load_reduced
from finger_model.parameter_sets import ParameterSets
from finger_model.people import People
from finger_model.reduced.model import load_population
from finger_sim.press import guided_style, plan_press


def presses_of(index: int) -> list[CalibrationPress]:
    """Six guided presses of a finger of the population, areas at 10 Hz with noise."""
    rng = np.random.default_rng([5, index])
    person = People.default().draw(rng)
    model = load_population(person.geometry).for_material(person.material)
    constants = model.constants(person.material)
    state, at, before, found = model.state_at_rest(constants), 1.0, 0.0, []
    for guided in CALIBRATION_PRESSES:
        plan = plan_press(rng, style=guided_style(guided), target_force=guided.target_force)
        time_s = at + plan.time
        table = model.run(constants, state, time_s, plan.force, before)
        before, at = time_s[-1], time_s[-1] + 2.0
        frames = np.arange(time_s[0], time_s[-1], 0.1)
        area = np.interp(frames, time_s, table[:, 0])
        area = area[area > 0] + TYPICAL_AREA_NOISE * rng.normal(size=np.count_nonzero(area > 0))
        frames = frames[np.interp(frames, time_s, table[:, 0]) > 0]
        deviation = np.full(len(area), TYPICAL_AREA_NOISE)
        found.append(CalibrationPress(time_s, plan.force, frames, area, deviation))
    return found


def run(report: Any) -> None:
    times = []
    for index in range(2 if report.quick else 10):
        presses = presses_of(index)
        began = time.perf_counter()
        calibrate(load_reduced(), ParameterSets.default(), presses)
        times.append(time.perf_counter() - began)
    report.add("subject_calibration_s", max(times), "s", 10.0)
