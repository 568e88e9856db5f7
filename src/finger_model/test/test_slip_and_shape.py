# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""No sample waits for what a new moisture reading makes of the finger, in contact and slip."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from finger_common.moisture import MOISTURE_RANGE
from finger_model.estimator import ContactEstimator, EstimatorSettings, estimator
from finger_model.estimator.parameter_selection import select_parameters
from finger_model.geometry import Geometry
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population
from finger_model.shape.estimate import MeasuredOutline
from finger_model.shape.settings import PoseSettings
from finger_model.slip import SlipSettings
from finger_model.slip.shear import _table, shear_curve
from finger_model.slip_and_shape import SlipAndShape, prepare

T0, MS = 1_700_000_000_000_000_000, 1_000_000


def stiffnesses(readings):
    """What slip takes the finger for after each reading (n, depths), and the tables computed."""
    contact = ContactEstimator(ReducedModel.load())
    slip_and_shape = SlipAndShape(contact, SlipSettings(), None)
    found, before = [], _table.cache_info().misses
    for k, value in enumerate(readings):
        contact.add_moisture(T0 + k * 1000 * MS, float(value))
        for n in (0, 200):
            for estimate in contact.add_wrench(T0 + (k * 1000 + n) * MS, (0.0, 0.0, 0.0)):
                slip_and_shape.process(estimate, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        found.append(slip_and_shape._slip._config["finger"]["shear"][0].copy())
    return np.array(found), _table.cache_info().misses - before


def test_what_areas_of_a_pause_showed_is_forgotten() -> None:
    """A replay hears of the pause when they wait already; live none of them was used."""
    slip_and_shape = SlipAndShape(
        ContactEstimator(ReducedModel.load()), SlipSettings(), PoseSettings()
    )
    outline = MeasuredOutline((0.0, 0.0), 8e-3, 6e-3, 0.0, 1e-4, 1e-4, 1e-4)
    for k in range(5):
        slip_and_shape.see_area(T0 + k * 1000 * MS, (0.5, 0.05), outline)
    slip_and_shape.leave_out(T0 + 1000 * MS, T0 + 3000 * MS)
    for waiting in (slip_and_shape._slip.sticks, slip_and_shape._pose.outlines):
        assert [stamp for stamp, _ in waiting.due(T0 + 9000 * MS)] == [T0, T0 + 4000 * MS]


def test_readings_find_their_tables_ready_and_give_the_same_numbers() -> None:
    readings = np.linspace(*MOISTURE_RANGE, 14)
    _table.cache_clear()
    unprepared, computed = stiffnesses(readings)
    assert computed > 3
    _table.cache_clear()
    prepare(ReducedModel.load(), ParameterSets.default())
    prepared, computed = stiffnesses(readings)
    assert computed == 0
    assert np.array_equal(prepared, unprepared)


def test_the_tables_of_a_hand_are_kept() -> None:
    model, sets = ReducedModel.load(), ParameterSets.default()
    hand = [replace(Geometry(), pad_semi_axis_axial=(5.0 + 0.2 * k) * 1e-3) for k in range(5)]
    ends = [model.material.with_vector(sets.interpolate(m).parameters) for m in MOISTURE_RANGE]
    computed = []
    for _ in range(2):
        before = _table.cache_info().misses
        for geometry in hand:
            for material in ends:
                for softer in (1.0, 1.3, 1.7, 2.2):
                    nail = material.nail_modulus / softer
                    shear_curve(geometry, replace(material, nail_modulus=nail))
        computed.append(_table.cache_info().misses - before)
    assert computed[0] > 16 and computed[1] == 0


@pytest.mark.parametrize("geometry", [None, replace(Geometry(), pad_semi_axis_axial=5.4e-3)])
def test_a_reading_that_was_prepared_costs_its_sample_nothing_and_changes_nothing(
    geometry: Geometry | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = ReducedModel.load() if geometry is None else load_population(geometry)
    selections = []

    def counted(*arguments: Any) -> Any:
        selections.append(threading.current_thread())
        return select_parameters(*arguments)

    monkeypatch.setattr(estimator, "select_parameters", counted)
    found = []
    for ahead in (False, True):
        contact, rows = ContactEstimator(model), []
        for k in range(400):
            if k % 100 == 50:
                contact.add_moisture(T0 + 2 * k * MS, 0.3 * k)
                if ahead:
                    thread = threading.Thread(target=contact.prepare_moisture, args=(0.3 * k,))
                    thread.start()
            if k == 230:
                contact.change_settings(EstimatorSettings(prior_area_sd=0.2))
            selections.clear()
            rows += contact.add_wrench(T0 + 2 * k * MS, (0.0, 0.0, -min(1.0, 0.02 * (k % 200))))
            if ahead and k % 100 == 80:
                thread.join()
            if ahead and k != 230:
                assert threading.current_thread() not in selections
        found.append(rows)
    assert repr(found[0]) == repr(found[1])
