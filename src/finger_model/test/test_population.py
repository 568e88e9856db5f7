# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The reduced model of every finger of the population box: physics, accuracy, what it refuses."""

from __future__ import annotations

import gc
import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from yielding_finger import THIN, YIELDING

from finger_common.errors import InputError, ModelError
from finger_model.anthropometry import estimate_geometry
from finger_model.compiled import njit
from finger_model.estimator import ContactEstimator, EstimatorSettings
from finger_model.fem.full_order import FullOrderModel
from finger_model.fem.mesh import similar_mesh
from finger_model.finger import simulate_reduced
from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid
from finger_model.laws.generalized_maxwell import LAWS_BY_BRANCHES
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.reduced import ReducedModel, population_runs
from finger_model.reduced.elastic_contact import ElasticContacts, LinearGuess
from finger_model.reduced.kernels import NODES, _drive, _drive_jacobian, record_types
from finger_model.reduced.model import load_population
from finger_model.reduced.population_build import PopulationSettings, build, held_out_runs
from finger_model.reduced.population_runs import held_out_case, run, training_case
from finger_model.reduced.population_training import measured_error

SLIM = Geometry(
    pad_semi_axis_radial=7e-3,
    pad_semi_axis_axial=5.5e-3,
    epidermis_thickness=0.4e-3,
    bone_semi_axis_radial=2.6e-3,
    bone_semi_axis_axial=2.0e-3,
    nail_radius=5.8e-3,
    nail_thickness=0.45e-3,
)
SOFT = StandardLinearSolid(E0=60e3, E1=30e3, tau1=0.1, E2=1200e3)
PRESS = (np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.35, 21))


def areas(geometry: Geometry, material, time=PRESS[0], force=PRESS[1]) -> np.ndarray:
    """Areas (n,) of the shipped model."""
    model = ReducedModel.load(geometry=geometry).for_material(material)
    return model.simulate(material, time, force).area


def test_the_file_is_small() -> None:
    data = Path(__file__).parents[1] / "finger_model" / "data" / "reduced_population.npz"
    assert data.stat().st_size < 10e6


@pytest.mark.parametrize(
    ("material", "own", "population"),
    [
        (StandardLinearSolid(), 1.0, 3.0),
        pytest.param(
            StandardLinearSolid(E0=150e3, E1=20e3, tau1=0.8, E2=900e3),
            5.0,
            5.0,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_error_does_not_grow_over_taps_without_a_pause(
    material: StandardLinearSolid, own: float, population: float
) -> None:
    """Share (%) of the largest area; docs/reduced_model.md."""
    instants = np.arange(0.0, 4.0001, 0.025)
    force = 0.6 * (1.0 - np.cos(4.0 * np.pi * instants))
    truth = FullOrderModel().simulate(material, instants, force).area
    for model, most in (
        (ReducedModel.load(), own),
        (load_population(Geometry()), population),
    ):
        found = model.for_material(material).simulate(material, instants, force).area
        wrong = 100.0 * np.abs(found - truth)[force >= 0.1] / truth.max()
        taps = np.array_split(wrong, 8)
        assert wrong.max() < most
        assert taps[-1].max() < 1.1 * taps[-3].max(), "it settles"


@pytest.mark.slow
def test_presses_that_are_wrong_at_one_load_are_left_out_there() -> None:
    """At single loads a few of the full order's areas are far off."""
    rng = np.random.default_rng(3)
    fingers, loads, finer_ones = 240, 3, 120
    contexts = rng.uniform(-1.0, 1.0, (2, fingers, 11))
    guess = LinearGuess(np.zeros((2, fingers, len(NODES), 2)), np.zeros((2, fingers, 3)))
    truth = np.full((2, fingers, len(NODES), 9), np.nan)
    of_finger = np.sin(contexts[..., :1] + 0.5 * contexts[..., 1:2])
    for load in range(loads):
        truth[:, :, load] = (load + 1) * of_finger * np.arange(1, 10) + 0.1
    truth[..., :3] += rng.normal(0.0, 2e-3, (2, fingers, len(NODES), 3))
    finer = truth[:, :finer_ones, :, :3] + 0.01 * of_finger[:, :finer_ones, None]
    coarse, finer_measured = truth.copy(), finer + rng.normal(0.0, 2e-3, finer.shape)
    coarse[1, 40, 0, 0] += 0.3
    coarse[0, 90, 2, 2] -= 0.2
    finer_measured[0, 20, 1, 1] += 0.2
    first = ElasticContacts.fit(contexts, guess, coarse, finer_measured, lambda share: None)
    kept, finer_kept = first.without_outliers(contexts, guess, coarse, finer_measured)
    gone = np.argwhere(np.isnan(kept[..., 0]) & np.isfinite(coarse[..., 0]))
    assert gone.tolist() == [[0, 90, 2], [1, 40, 0]]
    gone = np.argwhere(np.isnan(finer_kept[..., 0]) & np.isfinite(finer_measured[..., 0]))
    assert gone.tolist() == [[0, 20, 1], [0, 90, 2], [1, 40, 0]], "differences from wrong ones, too"
    again = ElasticContacts.fit(contexts, guess, kept, finer_kept, lambda share: None)
    wrong = [
        np.abs(found.coarse_curves(contexts, guess)[1, 40, 0, 0] - truth[1, 40, 0, 0])
        for found in (first, again)
    ]
    assert wrong[1] < 0.5 * wrong[0], wrong


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("weights", lambda a: a[:, 0]),
        ("weights", lambda a: a[:-1]),
        ("weights", lambda a: a[:, :-1]),
        ("points", lambda a: a[:, :-1]),
        ("mean", lambda a: a[:-1]),
        ("centre", lambda a: a[None]),
    ],
)
@pytest.mark.parametrize("process", ["elastic_coarse_0_0", "elastic_finer_1_0"])
def test_arrays_that_do_not_belong_together_are_refused(process: str, name: str, change) -> None:
    """Compiled code would read what is behind an array that is too short."""
    model = ReducedModel.load(geometry=SLIM)
    key = f"{process}_{name}"
    with pytest.raises(InputError, match="Gaussian process"):
        ReducedModel(dict(model.arrays) | {key: change(model.arrays[key])}, model.meta)


@pytest.mark.parametrize("friction", [0.0, 0.25, 0.6])
def test_a_finger_without_a_build_follows_the_full_order(friction: float) -> None:
    material = replace(SOFT, friction=friction)
    truth = FullOrderModel(SLIM).simulate(material, *PRESS)
    found = areas(SLIM, material)
    assert np.abs(found - truth.area)[3:].max() < 0.025 * truth.area.max()


@pytest.mark.parametrize("nail", [5.8e-3, 6.5e-3])
def test_a_nail_as_wide_as_the_finger_is_one_finger_in_both_solvers(nail: float) -> None:
    """Thick skin leaves the nail less room inside."""
    geometry = Geometry(6.5e-3, 4.7e-3, 0.8e-3, 1.85e-3, 1.75e-3, nail_radius=nail)
    material = StandardLinearSolid(E0=52e3, E1=11e3, tau1=0.05, E2=1.486e6)
    truth = FullOrderModel(geometry).simulate(material, *PRESS).area
    assert areas(geometry, material) == pytest.approx(truth, abs=0.02 * truth.max())


def test_the_error_over_random_fingers_is_that_which_is_stated() -> None:
    model = ReducedModel.load(geometry=SLIM)
    table = measured_error(model.arrays, list(held_out_runs(911, 6, 2)))["whole"]
    assert len(table.pairs) >= 5
    summary = table.summary()
    assert summary["rms_median"] < 2.0 * model.meta["measured_error"]["whole"]["rms_p90"]


@pytest.mark.slow
def test_the_goals_hold_over_fingers_that_no_training_saw() -> None:
    model = ReducedModel.load(geometry=SLIM)
    tables = measured_error(model.arrays, list(held_out_runs(912, 320, 2)))
    stated = model.meta["measured_error"]
    for region in ("middle", "whole"):
        found = tables[region].summary()
        assert found["rms_p90"] < 1.3 * stated[region]["rms_p90"]


def test_lengths_and_forces_scale_together() -> None:
    larger = Geometry(**{key: 1.3 * value for key, value in SLIM.to_dict().items()})
    # The large weights of the Gaussian processes magnify rounding to about 1e-9.
    np.testing.assert_allclose(
        areas(larger, SOFT, PRESS[0], 1.69 * PRESS[1]), 1.69 * areas(SLIM, SOFT), rtol=1e-8
    )


def test_the_error_is_stated_by_region() -> None:
    middle = ReducedModel.load(geometry=SLIM)
    wide = ReducedModel.load(
        geometry=Geometry(**{k: 11.9 / 7 * v for k, v in SLIM.to_dict().items()})
    )
    assert (middle.region_of(SOFT), wide.region_of(SOFT)) == ("middle", "whole")
    assert middle.rms_error_of(SOFT) < wide.rms_error_of(SOFT)


@pytest.mark.parametrize(
    ("change", "force", "region"),
    [
        ({}, 2.0, "middle"),
        ({}, 8.0, "whole"),
        ({"E2": 0.4 * SOFT.E0}, 1.0, "whole"),
        ({"E0": 300e3}, 1.0, "whole"),
        ({"E1": 7e3}, 1.0, "whole"),
        ({"E1": 12e3}, 1.0, "middle"),
    ],
)
def test_the_stated_error_is_that_of_the_parameters_and_the_force(
    change: dict, force: float, region: str
) -> None:
    model = ReducedModel.load(geometry=SLIM)
    material = replace(SOFT, **change)
    stated = model.meta["measured_error"][region]
    assert model.region_of(material, force) == region
    assert model.error_of(material, force) == stated
    assert model.rms_error_of(material, force) == stated["rms_p90"]


def test_the_estimator_is_less_certain_where_the_stated_error_is_larger() -> None:
    model = ReducedModel.load(geometry=SLIM)
    deviations = []
    for E2 in (501e3, 0.99 * 700e3 / 1.5):
        sets = ParameterSets([ParameterSet("x", 60.0, 1.0, (60e3, 30e3, 0.1, E2))])
        settings = EstimatorSettings(prior_area_sd=1e-3, contact_area_sd=1e-3, slope_sd=1e-3)
        estimator = ContactEstimator(model, sets, settings)
        for ms in range(0, 1000, 2):
            (found,) = estimator.add_wrench(ms * 1_000_000, (0.0, 0.0, -1e-3 * ms))
        deviations.append(found.area_stddev / found.area)
    assert deviations[1] > 1.3 * deviations[0]


def test_friction_nail_and_stiffening_matter_as_in_the_full_order() -> None:
    soft_nail = replace(SOFT, nail_modulus=2e7)
    branches = LAWS_BY_BRANCHES[1](E0=60e3, fraction_1=2 / 3, tau_1=0.1, E2=1200e3)
    stiffening = replace(branches, stiffening=6.0)
    full = FullOrderModel(SLIM)
    for other, base in (
        (replace(SOFT, friction=0.0), SOFT),
        (soft_nail, SOFT),
        (stiffening, branches),
        (replace(SOFT, stiffening=6.0), SOFT),
    ):
        truth = full.simulate(other, *PRESS).area[-1] / full.simulate(base, *PRESS).area[-1]
        found = areas(SLIM, other)[-1] / areas(SLIM, base)[-1]
        assert found == pytest.approx(truth, abs=0.02)


def test_the_default_finger_gives_way_to_the_population_where_it_must() -> None:
    model = ReducedModel.load()
    assert not model.serves_population
    assert model.for_material(StandardLinearSolid()) is model
    other = model.for_material(StandardLinearSolid(friction=0.5))
    assert other.serves_population and other.friction == 0.5
    assert other.geometry_hash == model.geometry_hash and other.hash != model.hash


@pytest.mark.parametrize(
    ("moduli", "peak"),
    [((46.5e3, 11.2e3, 0.06, 3556e3), 1.35), ((102.7e3, 79.3e3, 0.0035, 4949e3), 2.5)],
)
def test_outside_the_box_of_the_paper_the_default_finger_is_more_exact_by_the_population(
    moduli: tuple[float, ...], peak: float
) -> None:
    time, force = PRESS[0], PRESS[1] * peak / 1.35
    material = StandardLinearSolid().with_vector(np.array(moduli))
    truth = FullOrderModel(Geometry()).simulate(material, time, force).area
    found = simulate_reduced(material, time, force, Geometry()).area
    own = ReducedModel.load().simulate(material, time, force).area
    error, own_error = (np.linalg.norm(a - truth) for a in (found, own))
    assert error < 0.5 * own_error
    inside = StandardLinearSolid(E0=160e3, E1=15e3, E2=700e3, tau1=1.5)
    assert not ReducedModel.load().for_material(inside).serves_population, "nor for a tau1"


def test_streaming_batch_and_simulation_agree_to_the_bit() -> None:
    model = ReducedModel.load(geometry=SLIM)
    vector = SOFT.vector()
    simulated = model.simulate(vector, *PRESS).area
    assert np.array_equal(model.batch(vector, [PRESS])[0][0], simulated)
    state = model.start(vector)
    steps = [
        model.step(state, dt, f).area for dt, f in zip(np.diff(PRESS[0], prepend=0.0), PRESS[1])
    ]
    assert np.array_equal(steps, simulated)


@pytest.mark.parametrize("rows", [25, 121, 1201])
@pytest.mark.parametrize("material", [YIELDING, replace(YIELDING, E1=14e3, E2=130e3)])
def test_a_slow_press_does_not_depend_on_its_rows_until_it_is_refused(
    material: StandardLinearSolid, rows: int
) -> None:
    """The learned map has no solution there, or one at which the finger is less deep and strained:
    areas and indentations fell, or were 260 mm."""
    model = ReducedModel.load(geometry=THIN).for_material(material)
    vector = material.vector()
    share = np.linspace(0.0, 1.0, rows)
    time, force = 30.0 * share, 0.999 * model.force_limit(vector) * share**1.5
    (found,) = model.contacts(vector, [(time, force)])
    area, indentation = found[:, 0]
    lost = np.isnan(area)
    first = int(np.argmax(lost))
    assert 0.2 * force[-1] < force[first] < 0.95 * force[-1]
    heavy = slice(int(np.argmax(force > 0.1 * force[first])), first)
    for carried in (area[heavy], indentation[heavy]):
        assert (carried > 0.985 * np.maximum.accumulate(carried)).all()
    assert lost[first:].all() and np.isnan(indentation[first:]).all()
    soft = THIN.pad_semi_axis_axial - THIN.bone_semi_axis_axial
    assert indentation[:first].max() < soft
    with pytest.raises(ModelError, match=r"cannot follow the force of .* N at t = .*--solver full"):
        model.simulate(vector, time, force)
    kept = slice(0, first)
    assert np.array_equal(model.simulate(vector, time[kept], force[kept]).area, area[kept])
    few = 0.999 * model.force_limit(vector) * np.linspace(0.0, 1.0, 241) ** 1.5
    (other,) = model.batch(vector, [(np.linspace(0.0, 30.0, 241), few)])
    at = np.linspace(0.1, 0.9, 5) * force[first - 1]
    there = np.interp(at, few, other[0])
    assert np.abs(np.interp(at, force[kept], area[kept]) / there - 1.0).max() < 0.02


def test_one_candidate_that_cannot_carry_the_load_leaves_the_others() -> None:
    model = ReducedModel.load(geometry=THIN).for_material(YIELDING)
    stiff = replace(YIELDING, E1=150e3, E2=2e6)
    time = np.linspace(0.0, 30.0, 121)
    trial = time, 0.999 * model.force_limit(YIELDING.vector()) * time / 30.0
    vectors = np.array([stiff.vector(), YIELDING.vector(), stiff.vector()])
    (found,) = model.batch(vectors, [trial])
    assert np.isfinite(found[[0, 2]]).all() and np.isnan(found[1, -1])
    assert np.array_equal(found[0], model.simulate(stiff.vector(), *trial).area)


def test_a_step_that_fails_leaves_the_finger_as_it_was() -> None:
    model = ReducedModel.load(geometry=THIN).for_material(YIELDING)
    state = model.start(YIELDING)
    limit = model.force_limit(YIELDING)
    points = [model.step(state, 0.25, limit * share) for share in np.linspace(0.0, 1.0, 101)]
    assert points[-1].force < 0.9 * limit
    assert np.diff([p.area for p in points]).min() > -0.02 * points[-1].area
    assert points[-1].indentation < THIN.pad_semi_axis_axial
    released = [model.step(state, 0.25, f) for f in np.linspace(0.3 * limit, 0.0, 21)]
    assert released[-1].area == 0.0 and released[-1].force == 0.0
    assert abs(model.step(state, 60.0, 0.0).indentation) < 1e-6


def test_another_finger_has_another_hash() -> None:
    thicker = replace(SLIM, epidermis_thickness=0.5e-3)
    models = [ReducedModel.load(geometry=g) for g in (SLIM, thicker)]
    assert models[0].geometry_hash == SLIM.hash()
    assert len({m.hash for m in models}) == 2


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"epidermis_thickness": 1.5e-3}, "thickness of the epidermis is 1.5 mm"),
        ({"pad_semi_axis_axial": 3.5e-3, "bone_semi_axis_axial": 1.2e-3}, "pad_semi_axis_axial"),
        ({"bone_semi_axis_radial": 1.2e-3}, "bone_semi_axis_radial"),
        ({"nail_radius": 3e-3}, "nail_radius"),
        ({"nail_thickness": 0.0}, "nail_thickness"),
        ({"bone_center_height": 0.3e-3}, "bone_center_height"),
    ],
)
def test_a_finger_outside_the_box_is_refused_with_the_remedy(change: dict, word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        ReducedModel.load(geometry=replace(SLIM, **change))
    assert "finger-model reduce" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"poisson_ratio_bulk": 0.45},
        {"poisson_ratio_nail": 0.3},
        {"nail_modulus": 3e6},
        {"stiffening": 12.0},
    ],
)
def test_a_material_that_it_does_not_serve_is_refused(change: dict) -> None:
    material = replace(SOFT, **change)
    with pytest.raises(InputError, match=next(iter(change))):
        ReducedModel.load(geometry=SLIM).for_material(material)


def test_a_force_of_a_thousand_newtons_is_refused() -> None:
    with pytest.raises(InputError, match=r"1e\+03 N .* limit"):
        areas(SLIM, SOFT, np.array([0.0, 1.0]), np.array([0.0, 1000.0]))


def test_a_person_measured_with_calipers_needs_no_build() -> None:
    for width, depth in ((14e-3, 11e-3), (18e-3, 13e-3), (11e-3, 9e-3)):
        geometry = estimate_geometry(width, depth).geometry
        assert areas(geometry, SOFT)[-1] > 0


def test_a_busy_machine_does_not_cut_training_runs_short(monkeypatch: pytest.MonkeyPatch) -> None:
    case = training_case(5, 1)
    hours = itertools.count(0.0, 3600.0)
    monkeypatch.setattr(time, "perf_counter", lambda: next(hours))
    assert len(run(case, coarse=True).time) == len(case.time)


@pytest.mark.slow
def test_a_small_build_resumes(tmp_path: Path) -> None:
    settings = PopulationSettings(
        histories=50,
        soft_histories=2,
        further_histories=2,
        corrections=5,
        refining=2,
        held_out=4,
        pilots=5,
        epochs=1,
        seed=3,
    )
    output = tmp_path / "small.npz"

    class Stop(Exception):
        pass

    def stop(stage: str, share: float) -> None:
        if stage.startswith("training"):
            raise Stop

    with pytest.raises(Stop):
        build(output, settings, 2, stop)
    began = {p: p.stat().st_mtime_ns for p in (tmp_path / "small.npz.parts").glob("*.npz")}
    assert began
    stages: list[str] = []
    _, tables = build(output, settings, 2, lambda stage, share: stages.append(stage))
    assert not any("runs" in stage for stage in stages)
    assert output.exists() and not (tmp_path / "small.npz.parts").exists()
    assert ReducedModel.load(output, SLIM).serves_population
    assert tables["whole"].pairs


@pytest.mark.parametrize("duration", [1e-6, 1e6])
@pytest.mark.parametrize("geometry", [SLIM, Geometry()])
def test_sudden_and_slow_presses_are_elastic_as_in_the_full_order(
    duration: float, geometry: Geometry
) -> None:
    material = replace(SOFT, friction=0.4)
    time = np.linspace(0.0, duration, 9)
    force = np.linspace(0.0, 1.5, 9)
    truth = FullOrderModel(geometry).simulate(material, time, force)
    found = load_population(geometry).for_material(material).simulate(material, time, force)
    np.testing.assert_allclose(found.area[1:], truth.area[1:], rtol=0.02)
    np.testing.assert_allclose(found.indentation[1:], truth.indentation[1:], rtol=0.02)


def test_presses_that_are_learned_from_do_not_depend_on_their_steps_under_friction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = held_out_case(1, 3)
    assert case.material.friction > 0.5
    model = FullOrderModel(case.geometry, mesh=similar_mesh(case.geometry))

    def areas_of(steps: float) -> np.ndarray:
        monkeypatch.setattr(population_runs, "STEPS_BY_FRICTION", steps)
        return population_runs.elastic_press(model, case, False, 1.5)[2:7, 0]

    divided = areas_of(population_runs.STEPS_BY_FRICTION)
    single, finer = areas_of(0.0), areas_of(30.0)
    assert np.abs(single - finer).max() > 0.008
    assert np.abs(divided - finer).max() < 0.004


def test_fingers_do_not_depend_on_those_computed_beside_them() -> None:
    model = ReducedModel.load(geometry=SLIM)
    vectors = [model.space.default * factor for factor in (0.9, 1.0, 1.1)]
    together = model.constants(*vectors)
    assert all(np.array_equal(one, model.constants(v)[0]) for one, v in zip(together, vectors))


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_the_jacobian_of_the_drive_is_that_of_its_outputs(share: float) -> None:
    model = ReducedModel.load(geometry=SLIM)
    record = model.constants(replace(SOFT, E1=share / (1.0 - share) * SOFT.E0))
    latents = model.latents
    x, place = 0.5, np.linspace(0.12, 0.02, latents) * np.array([1, 1, 1, -1, 1, -1])

    def drive(amplitudes: np.ndarray) -> np.ndarray:
        found = np.empty(1 + latents)
        _drive_and_jacobian(model.networks, record, model.work, x, amplitudes, found)
        return found[1:]

    drive(place)
    jacobian = model.work[0]["jacobian"].copy()
    for column in range(latents):
        change = np.zeros(latents)
        change[column] = 1e-5
        slope = (drive(place + change) - drive(place - change)) / 2e-5
        np.testing.assert_allclose(jacobian[:, column], slope, atol=1e-5)


@njit
def _drive_and_jacobian(net, par, work, x, amplitudes, out):
    _drive(net[0], par[0], work[0], x, amplitudes, work[0].drive)
    out[:] = work[0].drive
    _drive_jacobian(net[0], par[0], work[0], x, amplitudes)


def test_the_types_of_a_model_outlive_it() -> None:
    # Compiled code knows a record type by its address: a model of other widths, whose type came to
    # lie where that of a former model had been, crashed.
    address = id(record_types(2, 1, 3, 4).networks)
    gc.collect()
    others = [record_types(2, 1, 3, width).networks for width in range(5, 60)]
    assert address not in map(id, others)
    assert id(record_types(2, 1, 3, 4).networks) == address
