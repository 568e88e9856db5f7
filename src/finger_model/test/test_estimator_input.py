# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Rules of input of the estimator: stamps, gaps, duplicates, order, delay, events, replay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.flags import StateFlag
from finger_model.estimator import (
    ContactEstimate,
    ContactEstimator,
    EstimateBlock,
    EstimatorSettings,
    EventType,
    replay,
)
from finger_model.geometry import Geometry
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return ReducedModel.load()


@pytest.fixture
def estimator(model: ReducedModel) -> ContactEstimator:
    return ContactEstimator(model)


def press(n: int = 1000, period: int = 2 * MS) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) and forces (n, 3) of a press to 1.35 N; z of the sensor points at the finger."""
    stamps = T0 + period * np.arange(n)
    share = np.arange(n) / n
    normal = 1.35 * np.clip(np.minimum(share / 0.4, (0.9 - share) / 0.2), -0.005, 1)
    return stamps, np.column_stack([0.02 * normal, 0 * normal, -normal])


def rows(estimates: list[ContactEstimate] | EstimateBlock) -> list[tuple]:
    """As tuples in which NaN equals NaN."""
    return [tuple(repr(v) for v in e) for e in estimates]


def one(estimator: ContactEstimator, ms: int, normal: float, lateral: float = 0.0):
    """Estimates of one sample."""
    return estimator.add_wrench(T0 + ms * MS, (lateral, 0.0, -normal))


def flags(estimator: ContactEstimator, ms: int, normal: float, lateral: float = 0.0) -> int:
    return one(estimator, ms, normal, lateral)[0].flags


def fail(estimator: ContactEstimator) -> None:
    """Let the reduced model fail, as after a state that cannot be."""
    for name in estimator._state.records.states.dtype.names or ():
        estimator._state.records.states[name] = np.nan


def test_one_by_one_and_in_bulk_give_the_same_bits(model: ReducedModel) -> None:
    single, bulk = ContactEstimator(model), ContactEstimator(model)
    stamps, forces = press()
    for estimator in (single, bulk):
        estimator.add_moisture(int(stamps[0]) - 50 * MS, 80.0)
        estimator.add_moisture(int(stamps[500]), 60.0)
        for i in range(100, 800, 50):
            estimator.add_area(int(stamps[i]) + 12345, 30e-6, 1e-6)
    alone = [e for s, f in zip(stamps, forces) for e in single.add_wrench(int(s), f)]
    assert rows(alone) == rows(bulk.add_wrenches(stamps, forces))
    assert single.statistics() == bulk.statistics()
    assert single.statistics()["fused_areas"] > 5


def test_stamps_in_seconds_are_refused(model: ReducedModel) -> None:
    stamps, forces = press(10)
    with pytest.raises(InputError, match=r"float64; whole nanoseconds are needed: np\.round"):
        ContactEstimator(model).add_wrenches(stamps * 1e-9, forces)
    assert len(ContactEstimator(model).add_wrenches([], np.empty((0, 3)))) == 0


@pytest.mark.parametrize(
    "force", [(0.0, -1.0), -1.0, np.array([[0.0, 0.0, -1.0]]), (None, None, -1.0), [0.0] * 6, None]
)
def test_a_force_that_is_no_vector_is_refused(estimator: ContactEstimator, force: Any) -> None:
    with pytest.raises(
        InputError, match=r"force is .*; three numbers in N are needed, \(x, y, z\)"
    ):
        estimator.add_wrench(T0, force)
    assert estimator.last_stamp is None
    assert len(estimator.add_wrenches([], [])) == 0


def test_what_an_estimator_is_made_of_is_named(model: ReducedModel) -> None:
    wrong: Any = {"onset_force": 0.1}
    with pytest.raises(InputError, match="model is of type NoneType; give a ReducedModel"):
        ContactEstimator(None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="parameter_sets is of type str; give a ParameterSets"):
        ContactEstimator(model, "parameters.yaml")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="settings is of type dict; give a EstimatorSettings"):
        ContactEstimator(model, settings=wrong)
    with pytest.raises(InputError, match="settings is of type dict; give a EstimatorSettings"):
        ContactEstimator(model).change_settings(wrong)


@pytest.mark.parametrize("stamp", [1_700_000_000.002, 5.0, "5", None])
def test_a_single_stamp_in_seconds_is_refused(model: ReducedModel, stamp: Any) -> None:
    estimator = ContactEstimator(model)
    for add in (
        lambda: estimator.add_wrench(stamp, (0.0, 0.0, -1.0)),
        lambda: estimator.add_area(stamp, 40e-6, 1e-6),
        lambda: estimator.add_moisture(stamp, 50.0),
    ):
        with pytest.raises(InputError, match=r"whole nanoseconds are needed: round\(seconds"):
            add()
    assert estimator.last_stamp is None
    assert len(estimator.add_wrench(np.int64(10**15), (0.0, 0.0, -1.0))) == 1


def test_a_replay_of_everything_received_gives_the_same_bits(model: ReducedModel) -> None:
    rng = np.random.default_rng(3)
    live = ContactEstimator(model)
    stamps, forces = press()
    order = np.arange(len(stamps))
    # Some samples come twice, some out of order.
    order = np.insert(order, 300, 250)
    order = np.insert(order, 400, 399)
    areas, moistures, events, published = [], [], [], []
    events.append(live.start_event(int(stamps[0])))
    for n, i in enumerate(order):
        stamp = int(stamps[i])
        published += live.add_wrench(stamp, forces[i])
        if n % 50 == 0 and n > 100:
            delay = 150 * MS if n % 200 == 0 else 60 * MS
            area = (stamp - delay, 35e-6 * (1 + 0.05 * rng.normal()), 1.5e-6, 0)
            areas.append(area)
            if not live.add_area(*area):
                events.append(live.note_late(areas=[area[0]]))
        if n == 350:
            moistures.append((stamp, 75.0))
            live.add_moisture(*moistures[-1])
        if n == 450:
            events.append(live.change_settings(EstimatorSettings(drift_sd=0.05), "test"))
        if n == 600:
            events.append(live.reset())
        if n == 700:
            sets = ParameterSets([ParameterSet("x", 60.0, 1.0, (9e4, 3e4, 0.2, 1e6))])
            events.append(live.change_parameters(sets))
    assert live.counters["late_areas"] > 0
    assert live.counters["out_of_order"] == 1
    assert live.counters["duplicates"] == 1
    again = ContactEstimator(model)
    blocks = [
        (stamps[order[i : i + 97]], forces[order[i : i + 97]]) for i in range(0, len(order), 97)
    ]
    replayed = [e for block in replay(again, blocks, areas, moistures, events) for e in block]
    assert rows(replayed) == rows(published)


@pytest.mark.parametrize("known_before", [True, False])
def test_a_pause_of_the_force_is_recorded_by_its_ends(
    model: ReducedModel, known_before: bool
) -> None:
    """However long the camera went on alone, in a contact. A bag may give its areas before it."""
    live, again = ContactEstimator(model), ContactEstimator(model)
    stamps, forces = press(800)
    stamps[400:] += 3600_000 * MS
    found = [e for s, f in zip(stamps[:400], forces) for e in live.add_wrench(int(s), f)]
    areas = [(int(stamps[399]) + k * 1000 * MS, 60e-6, 1e-6) for k in range(1, 3601)]
    unused = [stamp for stamp, *rest in areas if not live.add_area(stamp, *rest, live=True)]
    assert len(unused) == len(areas) - 2
    event = live.note_pause(min(unused), max(unused))
    assert event.is_pause and len(event.late_areas) == 2
    assert not live.add_area(unused[-1], 60e-6, 1e-6, live=True)
    areas.append((int(stamps[600]), 55e-6, 1e-6))
    assert live.add_area(*areas[-1], live=False)
    found += [e for s, f in zip(stamps[400:], forces[400:]) for e in live.add_wrench(int(s), f)]
    blocks = [(stamps[:400], forces[:400]), (stamps[400:], forces[400:])]
    if known_before:
        replayed = [e for b in replay(again, blocks, areas, events=[event]) for e in b]
    else:
        replayed = list(again.add_wrenches(*blocks[0]))
        for area in areas:
            again.add_area(*area)
        replayed += [e for b in replay(again, blocks[1:], events=[event]) for e in b]
    assert rows(replayed) == rows(found)
    # Two areas of the pause were taken, but are of the contact before it.
    for estimator in (live, again):
        counts = estimator.statistics()
        assert (counts["fused_areas"], counts["rejected_areas"]) == (1, 2)


@pytest.mark.parametrize("begun", [True, False])
def test_what_becomes_of_areas_changes_at_its_stamp_in_a_replay(
    model: ReducedModel, begun: bool
) -> None:
    """A replay hands areas over before the samples, and before the changes of settings."""
    fused, apart = EstimatorSettings(), EstimatorSettings(fuse_area=False, rejected_area_flags=0)
    stamps, forces = press()
    settings = [fused, apart] if begun else [apart, fused]
    live = ContactEstimator(model, settings=settings[0])
    events = [live.start_event(int(stamps[0]))]
    found, areas = [], []
    for k, (stamp, force) in enumerate(zip(stamps.tolist(), forces)):
        if k % 50 == 10:
            areas.append((stamp, 6e-5, 2e-6, 2 * (k % 100 == 10)))
            live.add_area(*areas[-1])
        if k == 400:
            events.append(live.change_settings(settings[1]))
        found += live.add_wrench(stamp, force)
    again = ContactEstimator(model)
    (block,) = replay(again, [(stamps, forces)], areas, events=events)
    assert rows(found) == rows(block)
    assert again.statistics() == live.statistics()
    assert 0 < live.statistics()["fused_areas"] < 0.7 * len(areas)


def test_the_sign_of_the_force_follows_normal_axis(model: ReducedModel) -> None:
    for axis, force in (("-z", (0, 0, -1.0)), ("+x", (1.0, 0, 0)), ("-y", (0, -1.0, 0))):
        estimator = ContactEstimator(model, settings=EstimatorSettings(normal_axis=axis))
        (estimate,) = estimator.add_wrench(T0, force)
        assert estimate.normal_force == 1.0
        assert estimate.lateral_force == 0.0
        assert estimate.in_contact


def test_duplicates_and_samples_out_of_order_are_dropped(estimator: ContactEstimator) -> None:
    one(estimator, 0, 0.5)
    one(estimator, 10, 0.5)
    assert one(estimator, 10, 0.6) == []
    assert one(estimator, 4, 0.6) == []
    assert flags(estimator, 12, 0.5) & StateFlag.OUT_OF_ORDER
    assert not flags(estimator, 14, 0.5) & StateFlag.OUT_OF_ORDER
    assert estimator.counters == {"duplicates": 1, "out_of_order": 1}


@pytest.mark.parametrize("every", [20, 2])
def test_an_area_that_a_recorder_held_counts_once(model: ReducedModel, every: int) -> None:
    stamps, forces = press()
    areas = 40e-6 * np.sqrt(np.linspace(0.1, 1.0, 19))
    once, held = ContactEstimator(model), ContactEstimator(model)
    for ms in range(100, 2000, every):
        held.add_area(T0 + ms * MS, areas[ms // 100 - 1], 1.5e-6)
    for ms in range(100, 2000, 100):
        once.add_area(T0 + ms * MS, areas[ms // 100 - 1], 1.5e-6)
    found = rows(held.add_wrenches(stamps, forces))
    assert found == rows(once.add_wrenches(stamps, forces))
    assert held.counters["duplicate_areas"] > 70
    assert not once.counters["duplicate_areas"]


def test_equal_areas_of_a_fast_camera_count_now_and_then(model: ReducedModel) -> None:
    stamps, forces = press()
    estimator, few = ContactEstimator(model), ContactEstimator(model)
    for ms in range(100, 1000, 10):
        estimator.add_area(T0 + ms * MS, 40e-6, 1.5e-6)
    for ms in range(100, 1000, 250):
        few.add_area(T0 + ms * MS, 40e-6, 1.5e-6)
    found = rows(estimator.add_wrenches(stamps, forces))
    assert found == rows(few.add_wrenches(stamps, forces))
    assert estimator.counters["duplicate_areas"] == 86


def test_equal_areas_of_pictures_that_are_apart_all_count(model: ReducedModel) -> None:
    stamps, forces = press()
    estimator = ContactEstimator(model)
    for ms in range(100, 1000, 60):
        estimator.add_area(T0 + ms * MS, 40e-6, 1.5e-6)
    estimator.add_wrenches(stamps, forces)
    assert "duplicate_areas" not in estimator.counters


def test_a_step_far_back_in_time_resets(estimator: ContactEstimator, model: ReducedModel) -> None:
    estimator.add_moisture(T0 + 2000 * MS, 105.0)
    for ms in range(0, 3000, 2):
        one(estimator, ms, 1.0)
    # The next sample says whether time jumped or one stamp was wrong.
    assert one(estimator, 100, 0.5) == []
    estimate, after = one(estimator, 102, 0.5)
    assert estimate.flags & StateFlag.TIME_RESET
    assert estimate.flags & StateFlag.MOISTURE_MISSING, "of a reading that is still to come"
    assert not after.flags & StateFlag.TIME_RESET
    (fresh,) = one(ContactEstimator(model), 100, 0.5)
    assert estimate.model_area == fresh.model_area
    assert not flags(estimator, 104, 0.5) & StateFlag.TIME_RESET


def test_a_gap_is_flagged_and_bridged_linearly(model: ReducedModel) -> None:
    gap, dense = ContactEstimator(model), ContactEstimator(model)
    one(gap, 0, 0.2)
    one(dense, 0, 0.2)
    for ms in range(2, 202, 2):
        last = one(dense, ms, 0.2 + 0.8 * ms / 200)[0]
    (after,) = one(gap, 200, 1.0)
    assert after.flags & StateFlag.FORCE_GAP
    assert not last.flags & StateFlag.FORCE_GAP
    assert after.model_area == pytest.approx(last.model_area, rel=0.01)


def test_irregular_spacing_of_one_history_gives_one_answer(model: ReducedModel) -> None:
    stamps, forces = press(2000, MS)
    whole, thinned = ContactEstimator(model), ContactEstimator(model)
    keep = np.sort(np.random.default_rng(0).choice(2000, 700, replace=False))
    keep[-1] = 1500
    keep = np.unique(keep[keep <= 1500])
    a = whole.add_wrenches(stamps[:1501], forces[:1501]).column("model_area")[-1]
    b = thinned.add_wrenches(stamps[keep], forces[keep]).column("model_area")[-1]
    assert b == pytest.approx(a, rel=2e-3)


def test_a_force_that_is_no_number_is_flagged_and_leaves_the_state(
    estimator: ContactEstimator, model: ReducedModel
) -> None:
    other = ContactEstimator(model)
    for e in (estimator, other):
        one(e, 0, 0.5)
    (bad,) = one(estimator, 2, float("nan"))
    assert bad.flags & StateFlag.FORCE_INVALID
    assert np.isnan(bad.area)
    assert one(estimator, 4, 0.6)[0].area == one(other, 4, 0.6)[0].area


def test_contact_begins_and_ends_with_hysteresis(estimator: ContactEstimator) -> None:
    seen = [
        one(estimator, 2 * i, f)[0]
        for i, f in enumerate([0.0, 0.04, 0.05, 0.04, 0.031, 0.029, 0.04, 0.06])
    ]
    assert [e.in_contact for e in seen] == [False, False, True, True, True, False, False, True]
    assert seen[1].area == 0.0
    assert seen[1].onset_ns == 0
    assert seen[4].onset_ns == seen[2].stamp_ns
    assert seen[7].onset_ns == seen[7].stamp_ns


def test_no_contact_without_compression(estimator: ContactEstimator) -> None:
    (estimate,) = one(estimator, 0, -0.5)
    assert (estimate.area, estimate.peak_pressure, estimate.in_contact) == (0.0, 0.0, False)


def test_a_lateral_load_above_a_quarter_is_flagged(estimator: ContactEstimator) -> None:
    assert not flags(estimator, 0, 1.0, 0.24) & StateFlag.LATERAL_LOAD
    assert flags(estimator, 2, 1.0, 0.26) & StateFlag.LATERAL_LOAD


def test_strain_relaxes_in_the_air(model: ReducedModel) -> None:
    sets = ParameterSets([ParameterSet("slow", 69.0, 1.0, (1.4e5, 2.2e4, 0.5, 1.8e6))])

    def second_press(pause_ms: int) -> float:
        estimator = ContactEstimator(model, sets)
        for ms in range(0, 1000, 5):
            one(estimator, ms, 1.0)
        one(estimator, 1000, 0.0)
        for ms in range(1005, 1000 + pause_ms, 5):
            one(estimator, ms, 0.0)
        return one(estimator, 1000 + pause_ms, 0.5)[0].model_area

    fresh = one(ContactEstimator(model, sets), 0, 0.5)[0].model_area
    soon, later, at_last = second_press(50), second_press(500), second_press(5000)
    assert soon > 1.05 * fresh
    assert soon > later > at_last
    assert at_last == pytest.approx(fresh, rel=0.02)


def test_an_area_enters_at_its_stamp_plus_the_delay(estimator: ContactEstimator) -> None:
    one(estimator, 0, 0.5)
    for ms in range(2, 40, 2):
        one(estimator, ms, 0.5)
    assert estimator.add_area(T0 + 20 * MS, 25e-6, 1e-6)
    for ms in range(40, 120, 2):
        assert one(estimator, ms, 0.5)[0].flags & StateFlag.AREA_MISSING
    (entered,) = one(estimator, 120, 0.5)
    assert entered.measured_area == 25e-6
    assert entered.measured_area_age == pytest.approx(0.1)


def test_an_area_that_comes_late_is_left_out_and_flagged(estimator: ContactEstimator) -> None:
    for ms in range(0, 202, 2):
        one(estimator, ms, 0.5)
    assert not estimator.add_area(T0 + 100 * MS, 40e-6, 1e-6)
    late = one(estimator, 202, 0.5)[0]
    assert late.flags & StateFlag.AREA_LATE
    assert np.isnan(late.measured_area)
    assert not flags(estimator, 204, 0.5) & StateFlag.AREA_LATE
    assert estimator.counters["late_areas"] == 1


def test_order_of_arrival_before_the_delay_does_not_matter(model: ReducedModel) -> None:
    stamps, forces = press(400)
    areas = [(int(stamps[i]), 20e-6 + 1e-8 * i, 1e-6) for i in range(60, 300, 20)]
    early, just = ContactEstimator(model), ContactEstimator(model)
    for area in reversed(areas):
        early.add_area(*area)
    first = early.add_wrenches(stamps, forces)
    second = []
    for s, f in zip(stamps, forces):
        for area in areas:
            if area[0] + 99 * MS <= s < area[0] + 101 * MS:
                just.add_area(*area)
        second += just.add_wrench(int(s), f)
    assert rows(first) == rows(second)


def test_flagged_areas_and_outliers_are_rejected(model: ReducedModel) -> None:
    estimator = ContactEstimator(model, ParameterSets(ParameterSets.default().sets))
    for ms in range(0, 100, 2):
        one(estimator, ms, 1.0)
    area = one(estimator, 100, 1.0)[0].model_area
    estimator.add_area(T0 + 50 * MS, area, 1e-6, flags=2)
    estimator.add_area(T0 + 52 * MS, 3 * area, 1e-6)
    seen = [flags(estimator, ms, 1.0) for ms in range(102, 160, 2)]
    assert sum(bool(f & StateFlag.AREA_REJECTED) for f in seen) == 2
    assert estimator.statistics()["fused_areas"] == 0


def test_three_outliers_in_a_row_are_accepted(estimator: ContactEstimator) -> None:
    for ms in range(0, 100, 2):
        area = one(estimator, ms, 1.0)[0].model_area
    for ms in (50, 60, 70):
        estimator.add_area(T0 + ms * MS, 2.2 * area, 0.01 * area)
    for ms in range(100, 200, 2):
        (last,) = one(estimator, ms, 1.0)
    assert last.area / last.model_area > 1.5


def test_moisture_changes_parameters_at_its_time(estimator: ContactEstimator) -> None:
    (before,) = one(estimator, 0, 0.5)
    assert before.flags & StateFlag.MOISTURE_MISSING
    assert np.isnan(before.moisture)
    estimator.add_moisture(T0 + 2 * MS, 105.33)
    assert one(estimator, 100, 0.5)[0].flags & StateFlag.MOISTURE_MISSING
    (after,) = one(estimator, 102, 0.5)
    assert after.moisture == 105.33
    assert not after.flags & StateFlag.MOISTURE_MISSING
    assert after.model_area > 1.1 * before.model_area
    assert after.parameter_set.endswith("@105.33")
    estimator.add_moisture(T0 + 4 * MS, 120.0)
    assert flags(estimator, 110, 0.5) & StateFlag.MOISTURE_OUT_OF_RANGE


@pytest.mark.parametrize("camera", ["goes on", "ends"])
@pytest.mark.parametrize(("first", "second"), [(60.0, 100.0), (100.0, 40.0), (40.0, 105.0)])
def test_a_reading_does_not_undo_what_the_contact_measured(
    model: ReducedModel, first: float, second: float, camera: str
) -> None:
    """One reading just before the contact, another after a second of it."""
    estimator = ContactEstimator(model)
    estimator.add_moisture(T0 - 500 * MS, first)
    estimates = []
    for ms in range(0, 2500, 2):
        if ms % 100 == 50 and (ms < 1000 or camera == "goes on"):
            estimator.add_area(T0 + ms * MS, 55e-6, 0.5e-6)
        if ms == 1000:
            estimator.add_moisture(T0 + ms * MS, second)
        estimates += one(estimator, ms, min(0.01 * ms, 1.0))
        if ms == 1000:
            rejected = estimator.statistics()["rejected_areas"]
    late = estimates[450:]
    areas = np.array([e.area for e in late])
    deviations = np.array([e.area_stddev for e in late])
    assert late[-1].moisture == second
    assert np.all(np.abs(areas - 55e-6) < 2.0 * deviations)
    assert np.max(np.abs(np.diff(areas))) < 0.02 * 55e-6
    assert estimator.statistics()["rejected_areas"] == rejected
    # The next contact goes by the new reading.
    for ms in range(2500, 12500, 2):
        one(estimator, ms, 0.0)
    *_, last = (one(estimator, ms, 1.0)[0] for ms in range(12500, 13500, 2))
    change = last.model_area / late[-1].model_area
    assert abs(change - 1.0) > 0.1 and (change > 1.0) == (second > first)


def test_what_areas_told_of_a_finger_is_not_told_of_new_parameters(model: ReducedModel) -> None:
    material = model.material.vector()
    before, after = (
        ParameterSets([ParameterSet("one", 69.0, 0.0, tuple(factor * material))], law=model.law)
        for factor in (1.0, np.array([1.2, 1.2, 1.0, 1.2]))
    )
    estimator, fresh = ContactEstimator(model, before), ContactEstimator(model, after)
    for ms in range(0, 1500, 2):
        if ms % 100 == 50:
            estimator.add_area(T0 + ms * MS, 90e-6, 0.5e-6)
        (known,), _ = one(estimator, ms, min(0.01 * ms, 1.0)), one(fresh, ms, min(0.01 * ms, 1.0))
    assert known.area > 1.2 * known.model_area
    estimator.change_parameters(after)
    (found,), (wanted,) = one(estimator, 1500, 1.0), one(fresh, 1500, 1.0)
    assert found.area / found.model_area == pytest.approx(wanted.area / wanted.model_area, rel=0.02)
    assert found.area_stddev / found.area == pytest.approx(
        wanted.area_stddev / wanted.area, rel=0.1
    )


def test_a_reset_in_a_measured_contact_takes_the_newest_reading(model: ReducedModel) -> None:
    estimator = ContactEstimator(model)
    for ms in range(0, 1500, 2):
        if ms == 500:
            estimator.add_area(T0 + ms * MS, 55e-6, 0.5e-6)
        if ms == 1000:
            estimator.add_moisture(T0 + ms * MS, 105.0)
        one(estimator, ms, min(0.01 * ms, 1.0))
    fresh = ContactEstimator(model)
    fresh.add_moisture(T0, 105.0)
    estimator.reset()
    for ms in range(1500, 2500, 2):
        (again,), (wanted,) = one(estimator, ms, 1.0), one(fresh, ms, 1.0)
    assert again.model_area == pytest.approx(wanted.model_area, rel=1e-3)


def test_an_old_reading_and_an_old_area_are_flagged(model: ReducedModel) -> None:
    settings = EstimatorSettings(moisture_stale_after=1.0, area_stale_after=0.2)
    estimator = ContactEstimator(model, settings=settings)
    estimator.add_moisture(T0 - 500 * MS, 70.0)
    estimator.add_area(T0 + 50 * MS, 20e-6, 1e-6)
    seen = {ms: flags(estimator, ms, 0.5) for ms in range(0, 800, 10)}
    assert not seen[240] & StateFlag.AREA_STALE
    assert seen[260] & StateFlag.AREA_STALE
    assert not seen[490] & StateFlag.MOISTURE_STALE
    assert seen[510] & StateFlag.MOISTURE_STALE


@pytest.mark.parametrize("again", ["start", "reset", "parameters"])
def test_an_area_is_less_certain_the_older_the_reading_is(model: ReducedModel, again: str) -> None:
    """In the first contact, when nothing was learned yet; an old one is worth none."""

    def certainty(age: float | None) -> float:
        estimator = ContactEstimator(model)
        if age is not None:
            estimator.add_moisture(T0 - round(age * 1e9), 69.31)
        one(estimator, 0, 0.0)
        if again == "reset":
            estimator.reset()
        elif again == "parameters":
            sets = ParameterSets.default()
            assert sets.prior is not None
            prior = replace(sets.prior, misfit_sd=0.5 * sets.prior.misfit_sd)
            estimator.change_parameters(sets.with_prior(prior, model.geometry))
        found = [one(estimator, ms, min(ms / 1000, 1.0))[0] for ms in range(5, 1500, 5)][-1]
        return found.area_stddev / found.area

    fresh, stale, old, none = map(certainty, (1.0, 900.0, 3600.0, None))
    assert fresh < 0.95 * stale < 0.9 * old
    assert old == pytest.approx(none, rel=1e-3)


def test_every_unknown_value_is_nan_and_flagged(model: ReducedModel) -> None:
    estimator = ContactEstimator(model)
    sets = ParameterSets([ParameterSet("x", 60.0, 1.0, (9e4, 3e4, 0.2, 1e6))])
    stamps, forces = press(4000)
    forces[1000:1005] = np.nan
    found = []
    for i, (stamp, force) in enumerate(zip(stamps.tolist(), forces)):
        if i == 300:
            estimator.add_moisture(stamp, 70.0)
        if i == 1500:
            estimator.change_parameters(sets)
        if i == 2500:
            fail(estimator)
        if i % 50 == 0 and i > 500:
            estimator.add_area(stamp - 60 * MS, 40e-6, 2e-6)
        found += estimator.add_wrench(stamp, force)
    failed = StateFlag.FORCE_INVALID | StateFlag.MODEL_FAILED
    reasons = dict.fromkeys(
        "model_area area area_stddev area_force_slope radius indentation mean_pressure "
        "peak_pressure".split(),
        failed,
    )
    reasons |= {"moisture": StateFlag.MOISTURE_MISSING, "moisture_age": StateFlag.MOISTURE_MISSING}
    for estimate in found:
        for name, flag in reasons.items():
            assert np.isnan(getattr(estimate, name)) == bool(estimate.flags & flag), name
        missing = bool(estimate.flags & StateFlag.AREA_MISSING)
        for value in (estimate.measured_area, estimate.measured_area_age):
            assert np.isnan(value) == (missing or not estimate.in_contact)
    seen = StateFlag(int(np.bitwise_or.reduce([e.flags for e in found])))
    assert seen & StateFlag.MODEL_FAILED and seen & StateFlag.FORCE_INVALID
    assert any(e.measured_area > 0 for e in found)


def test_force_beyond_the_range_is_flagged_not_extrapolated(estimator: ContactEstimator) -> None:
    limit = estimator.force_limit
    (inside,) = one(estimator, 0, limit)
    (beyond,) = one(estimator, 2, 3 * limit)
    assert not inside.flags & StateFlag.FORCE_OUT_OF_RANGE
    assert beyond.flags & StateFlag.FORCE_OUT_OF_RANGE
    assert beyond.model_area < 1.05 * inside.model_area
    for n, force in enumerate((10 * limit, 1e12, 1e300), 2):
        (far,) = one(estimator, 2 * n, force)
        assert far.flags & StateFlag.FORCE_OUT_OF_RANGE
        for name in ("area", "area_stddev", "radius", "indentation"):
            assert getattr(far, name) == pytest.approx(getattr(beyond, name), rel=0.05), name
        # The highest pressure is at least the mean, which is that of the true force.
        assert far.peak_pressure > far.mean_pressure
    # People's peak over mean pressure grows with the force.
    assert 3 * inside.peak_pressure < beyond.peak_pressure < 4 * inside.peak_pressure


def test_tissue_that_does_not_relax_runs() -> None:
    sets = ParameterSets([ParameterSet("elastic", 69.0, 1.0, (80e3, 1e25, 0.1, 1e6))])
    estimator = ContactEstimator(load_population(Geometry(pad_semi_axis_radial=8e-3)), sets)
    *_, last = (one(estimator, ms, 0.5)[0] for ms in range(0, 20, 2))
    assert 1e-6 < last.area < 1e-3


def test_parameters_beyond_the_range_are_flagged(model: ReducedModel) -> None:
    sets = ParameterSets([ParameterSet("hard", 69.0, 1.0, (9e5, 1e5, 0.1, 1e6))])
    assert flags(ContactEstimator(model, sets), 0, 0.5) & StateFlag.PARAMETERS_OUT_OF_RANGE


def test_a_reset_keeps_the_moisture_reading_alone(estimator: ContactEstimator) -> None:
    estimator.add_moisture(T0 - 100 * MS, 50.0)
    for ms in range(0, 1000, 5):
        one(estimator, ms, 1.0)
    event = estimator.reset()
    assert event.type == EventType.RESET
    assert event.stamp_ns == T0 + 995 * MS + 1
    (after,) = one(estimator, 1000, 0.5)
    assert after.moisture == 50.0
    fresh = ContactEstimator(estimator.model)
    fresh.add_moisture(T0 - 100 * MS, 50.0)
    one(fresh, 995, 0.0)
    assert after.model_area == pytest.approx(one(fresh, 1000, 0.5)[0].model_area, rel=1e-3)


def test_the_moisture_of_one_person_is_not_that_of_the_next(estimator: ContactEstimator) -> None:
    estimator.add_moisture(T0 - 100 * MS, 110.0)
    assert one(estimator, 0, 0.0)[0].moisture == 110.0
    event = estimator.reset("another subject: S02")
    (after,) = one(estimator, 2, 0.0)
    assert np.isnan(after.moisture) and after.flags & StateFlag.MOISTURE_MISSING
    again = ContactEstimator(estimator.model)
    again.add_moisture(T0 - 100 * MS, 110.0)
    one(again, 0, 0.0)
    again.apply_event(event)
    assert rows(one(again, 2, 0.0)) == rows([after])


@pytest.mark.parametrize("reason", ["start", "another subject: S02"])
def test_a_node_that_begins_anew_keeps_the_reading_of_its_subject(
    model: ReducedModel, reason: str
) -> None:
    stamps, forces = press(400)
    first, second = ContactEstimator(model), ContactEstimator(model)
    first.add_moisture(T0 - 100 * MS, 110.0)
    seen = rows(first.add_wrenches(stamps[:200], forces[:200]))
    if reason == "start":
        second.add_moisture(T0 - 100 * MS, 110.0)
    event = second.start_event(int(stamps[200]), reason)
    seen += rows(second.add_wrenches(stamps[200:], forces[200:]))
    again = ContactEstimator(model)
    again.apply_event(event)
    again.add_moisture(T0 - 100 * MS, 110.0)
    assert rows(again.add_wrenches(stamps, forces)) == seen


def test_a_recorded_jump_does_not_act_where_time_first_passes_its_stamp(
    model: ReducedModel,
) -> None:
    """Time runs to 2 s, and from there back to 1 s, as a node recorded it."""
    stamps, forces = press(1000)
    live, recorded = ContactEstimator(model), []
    seen = rows(live.add_wrenches(stamps, forces))
    recorded.append(live.clock_jump_event(int(stamps[500])))
    seen += rows(live.add_wrenches(stamps[500:], forces[500:]))
    again = ContactEstimator(model)
    for event in recorded:
        again.apply_event(event)
    every = [*zip(stamps, forces), *zip(stamps[500:], forces[500:])]
    assert rows([e for t, f in every for e in again.add_wrench(int(t), f)]) == seen


def test_areas_without_a_force_sensor_do_not_pile_up(estimator: ContactEstimator) -> None:
    for k in range(2000):
        estimator.add_area(T0 + 100 * k * MS, 50e-6, 1e-6, live=True)
    assert len(estimator._inputs._areas) <= 21
    one(estimator, 200_000, 1.0)


def test_sets_of_another_geometry_are_refused(model: ReducedModel) -> None:
    sets = ParameterSets(ParameterSets.default().sets, geometry_hash="0" * 64)
    with pytest.raises(InputError, match="geometry"):
        ContactEstimator(model, sets)


def test_contradictory_thresholds_are_refused() -> None:
    with pytest.raises(InputError, match=r"liftoff_force.*onset_force"):
        EstimatorSettings(onset_force=0.03, liftoff_force=0.05)


def test_prediction_is_what_follows(estimator: ContactEstimator) -> None:
    for ms in range(0, 500, 2):
        (now,) = one(estimator, ms, 0.8)
    estimator.add_area(T0 + 300 * MS, 1.2 * now.model_area, 0.02 * now.model_area)
    one(estimator, 500, 0.8)
    time = np.arange(1, 51) * 0.01
    force = 0.8 + 0.5 * time
    predicted = estimator.predict(time, force)
    for t, f in zip(time, force):
        (then,) = one(estimator, 500 + round(1000 * t), f)
    assert predicted.area[-1] == pytest.approx(then.area, rel=1e-6)
    assert predicted.indentation[-1] == pytest.approx(then.indentation, rel=1e-6)


def test_a_prediction_takes_spans_of_time(estimator: ContactEstimator) -> None:
    one(estimator, 0, 0.5)
    time, force = np.array([0.1, 0.2]), np.array([0.7, 1.0])
    spans = np.round(1e9 * time).astype("m8[ns]")
    assert np.array_equal(estimator.predict(spans, force).area, estimator.predict(time, force).area)


def test_prediction_in_the_air_is_of_the_next_contact(estimator: ContactEstimator) -> None:
    """The own error of the last contact, 15 % larger than those before, is not that of the next."""
    ms = 0
    for gain in (1.0, 1.0, 1.0, 1.15):
        for k in range(750):
            (now,) = one(estimator, ms, min(k / 250, 1.0) if k < 625 else max(0.0, 13.5 - k / 50))
            ms += 2
            if k % 50 == 25 and 50 < k < 625:
                area = now.model_area
                estimator.add_area(now.stamp_ns, gain * area, 0.02 * area, live=True)
    for _ in range(500):
        one(estimator, ms, 0.0)
        ms += 2
    time = np.arange(1, 1001) * 0.002
    force = np.minimum(time, 1.0)
    predicted = estimator.predict(time, force)
    for k, f in enumerate(force):
        (then,) = one(estimator, ms + 2 * k, f)
    assert predicted.area[-1] == pytest.approx(then.area, rel=0.01)


@pytest.mark.parametrize("horizon", [0.0, 0.5])
def test_force_for_area_inverts_predict(estimator: ContactEstimator, horizon: float) -> None:
    for ms in range(0, 500, 2):
        one(estimator, ms, 0.5)
    force = estimator.force_for_area(40e-6, horizon)
    time = np.linspace(0, horizon, 21)[1:] if horizon else np.array([1e-9])
    predicted = estimator.predict(
        np.concatenate([[1e-9], time + 1e-9]), np.full(len(time) + 1, force)
    )
    assert predicted.area[-1] == pytest.approx(40e-6, rel=2e-3)


def test_impossible_questions_are_refused(estimator: ContactEstimator) -> None:
    one(estimator, 0, 0.5)
    for area in (-1e-6, 0.0, float("nan"), 1.0):
        with pytest.raises(InputError, match="area"):
            estimator.force_for_area(area)
    with pytest.raises(InputError, match="limit"):
        estimator.predict(np.array([1.0]), np.array([50.0]))
    with pytest.raises(InputError, match="above 0"):
        estimator.predict(np.array([0.0]), np.array([1.0]))
    # Neither what holds up the samples for long nor a time of which nothing is known.
    long = np.linspace(1e-3, 1.0, 5001)
    with pytest.raises(InputError, match="5001 points; give 5000 at most"):
        estimator.predict(long, np.ones(5001))
    assert len(estimator.predict(long[1:], np.ones(5000)).area) == 5000
    with pytest.raises(InputError, match=r"time ends at 1e\+09 s; give 3600 s at most"):
        estimator.predict(np.array([1e9]), np.array([1.0]))


def test_a_model_that_failed_is_flagged_and_starts_again_in_the_air(
    estimator: ContactEstimator,
) -> None:
    for ms in range(0, 100, 2):
        one(estimator, ms, 0.01 * ms)
    fail(estimator)
    failed = one(estimator, 100, 1.0)[0]
    assert failed.flags & StateFlag.MODEL_FAILED and np.isnan(failed.area)
    with pytest.raises(InputError, match="could not follow"):
        estimator.force_for_area(20e-6)
    estimator.add_area(50 * MS, 20e-6, 1e-6)
    for ms in range(102, 400, 2):
        one(estimator, ms, 1.0)
    for ms in range(400, 500, 2):
        one(estimator, ms, 0.0)
    again = one(estimator, 500, 0.5)[0]
    assert not again.flags & StateFlag.MODEL_FAILED
    assert again.area > 1e-6 and np.isfinite(again.area_stddev)


def test_a_release_is_predicted_whatever_the_number_of_points(estimator: ContactEstimator) -> None:
    for ms in range(0, 1200, 2):
        one(estimator, ms, 1.35 * min(1.0, ms / 1000))
    end = []
    for n in (200, 3, 1):
        time = np.linspace(0.0, 1.0, n + 1)[1:]
        end.append(estimator.predict(time, 1.35 - 1.15 * time).area[-1])
    assert end[1:] == pytest.approx([end[0]] * 2, rel=0.01)
