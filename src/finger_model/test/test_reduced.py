# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The reduced model at run time, and against the full order."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.laws import LAWS, GeneralizedMaxwell, from_branches
from finger_model.laws.standard_linear_solid import PARAMETERS
from finger_model.material import Material
from finger_model.reduced import ReducedModel
from finger_model.reduced.error import error_table, pair_error
from finger_model.reduced.force_histories import (
    random_history,
    random_parameters,
)
from finger_model.reduced.goals import GOAL_RMS, GOAL_WORST, missed
from finger_model.reduced.training_runs import Run, branch_case, held_out_case, run_case

NATURAL = np.array([80e3, 25.38e3, 0.5, 1795e3])
SEED = 909


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return ReducedModel.load()


def ramp(
    peak: float = 1.35, duration: float = 1.0, rows: int = 40
) -> tuple[np.ndarray, np.ndarray]:
    share = np.arange(1, rows + 1) / rows
    return duration * share, peak * share


def runs_against(cases: range) -> list[Run]:
    full = FullOrderModel()
    return [run_case(full, held_out_case(SEED, i), None, 0.25)[0] for i in cases]


def test_it_follows_the_full_order_over_every_kind_of_history(model: ReducedModel) -> None:
    table = error_table(model, runs_against(range(6)))
    for pair in table.pairs:
        assert pair.rms <= GOAL_RMS, pair
        assert pair.worst <= GOAL_WORST, pair
        assert pair.indentation <= 0.06, pair
        assert pair.peak <= 0.06, pair


@pytest.mark.slow
def test_ninety_nine_percent_of_the_pairs_are_within_the_goal(model: ReducedModel) -> None:
    table = error_table(model, runs_against(range(6, 210)))
    print(table.text())
    assert table.share_within() >= 0.99, table.text()
    assert table.none_beyond(), table.text()


def test_streaming_batch_and_simulation_agree_to_the_bit(model: ReducedModel) -> None:
    time, force = random_history(np.random.default_rng(4), "reload")
    whole = model.simulate(NATURAL, time, force)
    state = model.start(NATURAL)
    before = time[0]
    streamed = []
    for t, f in zip(time, force):
        streamed.append(model.step(state, t - before, f))
        before = t
    for name in ("area", "radius", "indentation", "peak_pressure", "mean_pressure"):
        assert np.array_equal([getattr(p, name) for p in streamed], getattr(whole, name))
    rows = np.array([3, 10, len(time) - 1])
    (batch,) = model.batch(np.array([NATURAL, NATURAL]), [(time, force, rows)])
    assert np.array_equal(batch, np.tile(whole.area[rows], (2, 1)))
    (contacts,) = model.contacts(np.array([NATURAL, NATURAL]), [(time, force, rows)])
    assert np.array_equal(contacts[0], batch)
    assert np.array_equal(contacts[1], np.tile(whole.indentation[rows], (2, 1)))


def test_batch_keeps_sets_and_trials_apart(model: ReducedModel) -> None:
    rng = np.random.default_rng(5)
    parameters = np.array([random_parameters(rng, PARAMETERS.box) for _ in range(7)])
    trials = [ramp(1.0, 0.5, 10), ramp(1.35, 2.0, 25), ramp(0.4, 1.0, 5)]
    found = model.contacts(parameters, trials)
    for (areas, indentations), (time, force) in zip(found, trials):
        assert areas.shape == indentations.shape == (7, len(time))
        for row, depth, vector in zip(areas, indentations, parameters):
            alone = model.simulate(vector, time, force)
            assert np.array_equal(row, alone.area)
            assert np.array_equal(depth, alone.indentation)


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([9, 9, 5], "trial 1: the wanted rows must increase from 0 to 9 at most"),
        ([-1], "the wanted rows must increase from 0"),
        ([3, 10], "the wanted rows must increase from 0"),
        (np.arange(10) > 5, r"are bool \(10,\), whole numbers .*np\.flatnonzero gives those of a"),
        ([8.9], r"are float64 \(1,\), whole numbers"),
        ([[1, 2], [3, 4]], r"are int64 \(2, 2\), whole numbers"),
    ],
)
def test_rows_that_are_none_are_refused(model: ReducedModel, rows: Any, sentence: str) -> None:
    """They left numbers in the answer that nobody had computed."""
    press = ramp(rows=10)
    with pytest.raises(InputError, match=sentence):
        model.contacts(NATURAL, [press, (*press, rows)])
    assert model.batch(NATURAL, [(*press, [])])[0].shape == (1, 0)


def test_dates_and_masks_of_a_history_are_taken_as_such(model: ReducedModel) -> None:
    time, force = ramp(rows=10)
    plain = model.simulate(NATURAL, time, force)
    for kind in ("M8[ns]", "m8[ns]"):
        dated = model.simulate(NATURAL, np.round(time * 1e9).astype(kind), force)
        np.testing.assert_allclose(dated.area, plain.area, rtol=1e-9)
    with pytest.raises(InputError, match="force in row 5 is not finite; remove the row"):
        model.simulate(NATURAL, time, np.ma.masked_array(force, time == time[4]))
    with pytest.raises(InputError, match="history: force holds something else than numbers"):
        model.simulate(NATURAL, time, force + 1j)


@pytest.mark.parametrize(
    ("dt", "force"),
    [(-0.5, 0.5), (np.nan, 0.5), (np.inf, 0.5), (0.1, np.nan), (0.1, np.inf)],
)
def test_a_step_back_or_to_no_number_is_refused(
    model: ReducedModel, dt: float, force: float
) -> None:
    state = model.start(NATURAL)
    model.step(state, 0.1, 0.5)
    with pytest.raises(InputError, match="a time of zero or more and a finite force are needed"):
        model.step(state, dt, force)
    again = model.start(NATURAL)
    model.step(again, 0.1, 0.5)
    assert model.step(state, 0.1, 1.0) == model.step(again, 0.1, 1.0)


def test_a_step_tells_the_force_that_was_held(model: ReducedModel) -> None:
    limit = model.force_limit(NATURAL)
    point = model.step(model.start(NATURAL), 1, np.float32(50.0))
    assert point.force == limit
    assert point == model.step(model.start(NATURAL), 1.0, limit)
    assert point.mean_pressure == limit / point.area


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_a_copy_of_the_shipped_model_is_the_same_model(model: ReducedModel, copied: Any) -> None:
    again = copied(model)
    assert again.gives_way
    other = Material(friction=0.5)
    found = again.for_material(other).simulate(other, *ramp())
    assert np.array_equal(found.area, model.for_material(other).simulate(other, *ramp()).area)


def test_force_and_moduli_scale_together(model: ReducedModel) -> None:
    time, force = ramp(0.6)
    factor = np.array([2.0, 2.0, 1.0, 2.0])
    one = model.simulate(NATURAL, time, force)
    two = model.simulate(NATURAL * factor, time, 2 * force)
    assert np.allclose(two.area, one.area, rtol=1e-9)
    assert np.allclose(two.peak_pressure, 2 * one.peak_pressure, rtol=1e-9)


def test_time_and_time_constant_scale_together(model: ReducedModel) -> None:
    time, force = random_history(np.random.default_rng(1), "release")
    slow = NATURAL * np.array([1, 1, 3.0, 1])
    assert np.allclose(
        model.simulate(slow, 3 * time, force).area,
        model.simulate(NATURAL, time, force).area,
        rtol=1e-9,
    )


def test_an_unloaded_finger_stays_at_rest(model: ReducedModel) -> None:
    history = model.simulate(NATURAL, np.arange(1, 200) * 0.01, np.zeros(199))
    assert np.array_equal(history.area, np.zeros(199))
    assert np.abs(history.indentation).max() < 1e-12


@pytest.mark.parametrize("step", [0.1, 0.05, 0.002])
def test_any_time_step_gives_the_same_press(model: ReducedModel, step: float) -> None:
    # Moist: the time constant is far below a camera's frame time.
    moist = np.array([160e3, 15e3, 0.01, 700e3])
    for vector in (NATURAL, moist):
        fine = model.simulate(vector, *ramp(rows=2000)).area[-1]
        coarse = model.simulate(vector, *ramp(rows=round(1.0 / step))).area[-1]
        assert coarse == pytest.approx(fine, rel=0.01)


SUDDEN = [
    # E0, E1, τ1, E2; time (s), force (N)
    ([150e3, 15e3, 0.5, 700e3], [0.0, 1.0], [1.0, 1.0]),
    ([150e3, 15e3, 0.5, 700e3], [0.0, 0.01, 0.5, 0.51, 1.0], [0.0, 0.4, 0.4, 0.8, 0.8]),
    ([80e3, 25.4e3, 0.5, 1795e3], [0.0, 0.001, 0.5, 1.0, 2.0], [0.0, 1.0, 1.0, 1.0, 1.0]),
    ([160e3, 15e3, 0.01, 700e3], [0.0, 0.5, 1.0, 1.005, 1.5], [0.0, 0.6, 1.2, 0.3, 0.3]),
    ([80e3, 25.4e3, 0.5, 1795e3], [0.0, 0.5, 1.5], [0.0, 1.2, 0.2]),
]


@pytest.mark.parametrize(("vector", "rows", "load"), SUDDEN)
def test_few_rows_of_a_sudden_load_give_what_many_give(
    model: ReducedModel, vector: list[float], rows: list[float], load: list[float]
) -> None:
    time, force = np.array(rows), np.array(load)
    within = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 300)])
    fine = np.unique(np.concatenate([a + (b - a) * within for a, b in itertools.pairwise(time)]))
    many = model.simulate(np.array(vector), fine, np.interp(fine, time, force))
    few = model.simulate(np.array(vector), time, force)
    wanted = np.searchsorted(fine, time)
    assert np.allclose(few.area, many.area[wanted], rtol=0.006)
    assert np.allclose(few.indentation, many.indentation[wanted], rtol=0.01, atol=1e-9)


def test_area_falls_with_the_moduli_and_grows_with_force(model: ReducedModel) -> None:
    time, force = ramp()
    for seed in range(20):
        vector = random_parameters(np.random.default_rng(seed), PARAMETERS.box)
        base = model.simulate(vector, time, force).area
        assert np.all(np.diff(base) > 0)
        for which in (0, 1):
            stiffer = vector.copy()
            stiffer[which] *= 1.1
            assert np.all(model.simulate(stiffer, time, force).area[4:] < base[4:])


def test_nothing_runs_away_over_the_whole_range(model: ReducedModel) -> None:
    rng = np.random.default_rng(8)
    for seed in range(60):
        vector = random_parameters(rng, PARAMETERS.range)
        kind = ("reload", "tapping", "human", "random")[seed % 4]
        time, force = random_history(rng, kind, 0.9 * model.force_limit(vector) / 1.2)
        history = model.simulate(vector, time, force)
        assert np.all(np.isfinite(history.area))
        assert history.area.max() < np.pi * 8.5e-3**2
        assert history.indentation.max() < 4e-3


@pytest.mark.parametrize(
    ("which", "value", "named"),
    [(0, 20e3, "E0"), (1, 200e3, "E1"), (2, 5.0, "tau1"), (3, 1e5, "E2")],
)
def test_parameters_out_of_range_are_named(
    model: ReducedModel, which: int, value: float, named: str
) -> None:
    vector = NATURAL.copy()
    vector[which] = value
    assert model.out_of_range(vector) == [named]
    with pytest.raises(InputError, match=named):
        model.simulate(vector, *ramp())


def test_a_force_beyond_the_limit_is_refused_with_its_time(model: ReducedModel) -> None:
    with pytest.raises(InputError, match=r"3\.5 N at t = 1 s"):
        model.simulate(NATURAL, np.array([0.5, 1.0]), np.array([1.0, 3.5]))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("friction", 0.3),
        ("poisson_ratio_bulk", 0.45),
        ("poisson_ratio_epidermis", 0.45),
        ("poisson_ratio_nail", 0.3),
        ("nail_modulus", 17e6),
    ],
)
def test_a_material_with_another_fixed_property_is_refused(
    model: ReducedModel, name: str, value: float
) -> None:
    with pytest.raises(InputError, match=f"{name}.*--solver full"):
        model.simulate(Material(**{name: value}), *ramp())


def test_a_material_of_another_law_is_refused(model: ReducedModel) -> None:
    class OtherLaw(Material):
        name = "other"

    with pytest.raises(InputError, match=r"'other'.*'standard_linear_solid'.*--solver full"):
        model.simulate(OtherLaw(), *ramp())


def test_a_file_of_another_law_is_refused(
    model: ReducedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    class OtherLaw(Material):
        name = "other"

    monkeypatch.setattr(LAWS, "_loaded", {"other": OtherLaw})
    with pytest.raises(InputError, match=r"trained on the law 'other'.*'standard_linear_solid'"):
        ReducedModel(model.arrays, {**model.meta, "law": "other"})


def branched(*branches: tuple[float, float]) -> GeneralizedMaxwell:
    """The natural finger's tissue with other branches (fraction, relaxation time)."""
    listed = [{"fraction": fraction, "tau": tau} for fraction, tau in branches]
    values = {"E0": NATURAL[0], "E2": NATURAL[3], "branches": listed}
    return from_branches(values, "material")


def test_one_branch_is_the_standard_linear_solid(model: ReducedModel) -> None:
    solid = Material()
    (branch,) = solid.branches
    material = branched(branch)
    time, force = random_history(np.random.default_rng(3), "reload")
    expected = model.simulate(solid, time, force)
    found = model.for_law(type(material)).simulate(material, time, force)
    assert found.area == pytest.approx(expected.area, rel=1e-9)
    assert found.indentation == pytest.approx(expected.indentation, rel=1e-9)


def test_branches_of_one_time_act_as_their_sum(model: ReducedModel) -> None:
    time, force = random_history(np.random.default_rng(4), "hold")
    one, three = branched((0.7, 0.1)), branched((0.3, 0.1), (0.3, 0.1), (0.1, 0.1))
    expected = model.for_law(type(one)).simulate(one, time, force).area
    found = model.for_law(type(three)).simulate(three, time, force).area
    assert found == pytest.approx(expected, rel=1e-9)


def test_branches_that_no_training_saw_follow_the_full_order(model: ReducedModel) -> None:
    """2, 3 and 4 branches of 1 ms … 10 s; `verify --reduced --branches` prints many more."""
    full = FullOrderModel()
    for index in (4, 8, 15):
        run, _ = run_case(full, branch_case(SEED, index), None, model.friction)
        error = pair_error(model, run)
        assert error is not None
        assert error.rms < 0.01
        assert error.worst < 0.03
        assert error.indentation < 0.05


def test_a_stiffening_tissue_and_a_long_term_modulus_out_of_range_are_refused(
    model: ReducedModel,
) -> None:
    stiff = dataclasses.replace(branched((0.3, 0.01), (0.4, 1.0)), stiffening=1.0)
    with pytest.raises(InputError, match=r"'stiffening' is 1.*--solver full"):
        model.for_law(type(stiff)).simulate(stiff, *ramp())
    soft = branched((0.5, 0.01), (0.49, 1.0))
    with pytest.raises(InputError, match=r"long-term modulus.*--solver full"):
        model.for_law(type(soft)).simulate(soft, *ramp())


def test_a_wrong_number_of_parameters_is_refused(model: ReducedModel) -> None:
    with pytest.raises(InputError, match="4 numbers are needed: E0, E1, tau1, E2"):
        model.simulate(np.ones(5), *ramp())


def test_a_model_of_another_geometry_is_refused(model: ReducedModel, tmp_path: Path) -> None:
    model.save(tmp_path / "model.npz")
    with pytest.raises(InputError, match="another geometry"):
        ReducedModel.load(tmp_path / "model.npz", Geometry(epidermis_thickness=0.5e-3))


def test_a_saved_file_reads_back_with_the_same_hash(model: ReducedModel, tmp_path: Path) -> None:
    model.save(tmp_path / "model.npz")
    again = ReducedModel.load(tmp_path / "model.npz", Geometry())
    assert again.hash == model.hash
    assert again.measured_error == model.measured_error


def test_a_file_that_states_a_poor_error_is_named(model: ReducedModel) -> None:
    """A good one is not, nor one that states none."""
    stated = model.measured_error
    assert missed(stated) == "" and missed({}) == ""
    for worse in ({"share_within": 0.9}, {"rms_max": 0.022}, {"worst_max": 0.05}):
        assert "is less exact than" in missed({**stated, **worse})
    words = missed({**stated, "rms_max": 0.022, "worst_max": 0.046, "indentation_max": 0.47})
    assert "2.2 % RMS and 4.6 % at an instant" in words and "47 % of the indentation" in words


def test_a_file_that_claims_another_geometry_is_refused(
    model: ReducedModel, tmp_path: Path
) -> None:
    meta = json.loads(json.dumps(model.meta))
    meta["geometry"]["epidermis_thickness"] = 0.7e-3
    with pytest.raises(InputError, match="hash"):
        ReducedModel(model.arrays, meta)


@pytest.mark.parametrize("content", [b"", b"not a model", b"PK\x03\x04broken"])
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"model\.npz"):
        ReducedModel.load(path)


def test_a_file_with_pickled_objects_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    np.savez(path, meta=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=r"model\.npz"):
        ReducedModel.load(path)


def test_the_shipped_file_describes_itself(model: ReducedModel) -> None:
    assert model.geometry_hash == Geometry().hash()
    assert model.measured_error["pairs"] >= 200
    assert model.range["force"][1] >= 3.0
    assert model.settings["histories"] >= 80
