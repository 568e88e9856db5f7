# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Slip estimator: law of the elements, friction learned, slips foretold."""

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from finger_common.cli import run as run_command
from finger_common.errors import InputError
from finger_common.flags import SlipFlag, StateFlag
from finger_model.cli import _main
from finger_model.estimator import ContactEstimator, EstimateBlock, EstimatorSettings
from finger_model.finger import simulate_reduced
from finger_model.geometry import Geometry
from finger_model.material import Material
from finger_model.paper import NATURAL
from finger_model.reduced import ReducedModel
from finger_model.shape.estimate import NO_OUTLINE
from finger_model.slip import SlipEstimator, SlipSettings, backbone, elements
from finger_model.slip.estimate import slip_estimates
from finger_model.slip.pull import pull_history
from finger_model.slip_and_shape import SlipAndShape
from finger_model.verification.cases import CALCULIX_FINGER, elastic

RATE = 500.0
KNOWN = {"friction_prior_sd": 0.01, "tangential_noise": 0.0002, "level_sd": 0.0}


def run(estimator, normal, lateral, start=0):
    """Rows of samples at 500 Hz: normal (n,), lateral (n,) along a fixed direction."""
    stamps = start + (np.arange(len(normal)) * 1e9 / RATE).astype(np.int64)
    along = np.outer(lateral, [0.6, 0.8])
    return estimator.add_many(stamps, normal, along, normal > 0.03, np.full(len(normal), 1e-3))


def ramp(*corners):
    """Piecewise linear values at 500 Hz; corners are (time, value)."""
    times, values = np.transpose(corners)
    return np.interp(np.arange(0.0, times[-1], 1.0 / RATE), times, values)


def test_elements_follow_the_backbone_and_turn_by_masings_rule():
    states = np.zeros(1, elements.ELEMENTS)
    state = states[0]
    load = 2.0
    found = {}
    for ratio in np.linspace(0.0, 0.9, 91):
        stick = elements.pull(state, load, ratio * load, 0.0)
        found[round(float(ratio), 2)] = stick, states["moved"][0, 0]
    for ratio, (stick, _) in found.items():
        assert stick == pytest.approx(float(backbone.stick_ratio(ratio)), abs=0.05), ratio
    # Back from r = 0.9 the path is the first one, twice as large (Masing 1926).
    turn = found[0.9][1]
    for change in (0.2, 0.6, 1.0, 1.4):
        stick = elements.pull(state, load, (0.9 - change) * load, 0.0)
        first = found[round(change / 2, 2)]
        assert turn - states["moved"][0, 0] == pytest.approx(2.0 * first[1], rel=0.03)
        assert stick == pytest.approx(first[0], abs=0.05)


@pytest.mark.parametrize("obliquity", [0.1, 0.22])
def test_what_comes_with_the_load_sticks_and_what_is_pulled_after_it_does_not(obliquity):
    """Mindlin and Deresiewicz (1953): at a constant obliquity below friction nothing slips. The
    three-dimensional model has stick ratios of 1.00 to 0.96 at 0.15/0.25."""
    friction, rows = 0.25, np.linspace(0.01, 1.0, 100)

    def stick_after(state, normal, pull):
        elements.press(state, friction, normal, 0.0, pull, 0.0)
        return elements.pull(state, friction * normal, pull, 0.0)

    oblique, pressed_first = np.zeros(2, elements.ELEMENTS)
    assert min(stick_after(oblique, P, obliquity * P) for P in rows) == 1.0
    # Beyond it a pull at constant P follows the backbone of what is left of the friction.
    stick = stick_after(oblique, 1.0, obliquity + 0.6 * (friction - obliquity))
    assert stick == pytest.approx(float(backbone.stick_ratio(0.6)), abs=0.05)
    stick_after(pressed_first, 1.0, 0.0)
    stick = stick_after(pressed_first, 1.0, obliquity)
    assert stick == pytest.approx(float(backbone.stick_ratio(obliquity / friction)), abs=0.05)


def test_a_grip_that_tightens_with_its_load_does_not_slip():
    estimator = SlipEstimator(SlipSettings(friction_prior=0.5, **KNOWN))
    noise = 0.002 * np.random.default_rng(1).standard_normal((2, 1000))
    normal = ramp((0.0, 0.03), (2.0, 2.0)) + noise[0]
    rows = run(estimator, normal, 0.35 * normal + noise[1])
    assert rows["stick_ratio"][200:].min() > 0.9
    assert rows["slip_margin"][-1] == pytest.approx(0.3, abs=0.03)


def test_an_oblique_press_that_is_relieved_and_repeated_sticks():
    """Also where the first sample of a contact is under load, as after a reset."""
    estimator = SlipEstimator(SlipSettings(friction_prior=0.8, **KNOWN))
    normal = ramp((0.0, 0.1), (1.0, 5.0), (2.0, 0.06), (3.0, 5.0))
    rows = run(estimator, normal, 0.3 * normal)
    assert rows["stick_ratio"][5] > 0.95
    assert rows["stick_ratio"][normal > 2.0].min() > 0.9
    held = SlipEstimator(SlipSettings(friction_prior=0.8, **KNOWN))
    rows = run(held, np.full(300, 5.0), np.full(300, 3.0))
    assert rows["stick_ratio"][-1] == pytest.approx(float(backbone.stick_ratio(0.75)), abs=0.05)


def test_a_pull_under_a_normal_force_that_trembles_follows_the_backbone():
    """Noise brings a little of Q with P: no fall of P then ends the first pull."""
    estimator = SlipEstimator(SlipSettings(friction_prior=0.5, **KNOWN))
    noise = 0.005 * np.random.default_rng(2).standard_normal((2, 1000))
    time = np.arange(1000) / RATE
    tremor = 1.0 + 0.03 * np.sin(7.0 * time) + 0.03 * np.sin(53.0 * time)
    normal = ramp((0.0, 0.1), (0.3, 1.0), (2.0, 1.0)) * tremor
    lateral = ramp((0.0, 0.0), (0.6, 0.0), (2.0, 0.45))
    rows = run(estimator, normal + noise[0], lateral + noise[1])
    pulled = (time > 0.7) & (time < 1.95)
    error = rows["stick_ratio"] - backbone.stick_ratio(lateral / (0.5 * normal))
    assert np.sqrt(np.mean(error[pulled] ** 2)) < 0.06


def test_a_stuck_contact_has_all_margin_and_a_slipping_one_none():
    estimator = SlipEstimator(SlipSettings(friction_prior=0.5, **KNOWN))
    normal = 1.0 + 0.02 * np.sin(2 * np.pi * 1.5 * np.arange(1000) / RATE)
    lateral = np.minimum(ramp((0.0, 0.0), (0.4, 0.0), (1.2, 0.6), (2.0, 0.6)), 0.5 * normal)
    rows = run(estimator, normal, lateral)
    assert rows["stick_ratio"][150] == pytest.approx(1.0)
    assert rows["slip_margin"][150] == pytest.approx(1.0, abs=0.01)
    middle = np.searchsorted(lateral, 0.3)
    assert rows["slip_margin"][middle] == pytest.approx(0.4, abs=0.03)
    assert rows["stick_ratio"][middle] == pytest.approx(float(backbone.stick_ratio(0.6)), abs=0.05)
    assert rows["slip_probability"][middle] < 0.05
    assert rows["slip_probability"][-1] > 0.9
    assert rows["stick_ratio"][-1] < 0.05 and rows["slip_margin"][-1] < 0.05
    assert np.all(np.diff(rows["slip_margin"][250:520]) < 0.01)


def test_friction_is_learned_from_slips_and_kept_from_contact_to_contact():
    rng = np.random.default_rng(3)
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    friction = 0.8
    for number in range(2):
        wobble = ramp((0, 0), (0.3, 1.0), (2.2, 1.0), (2.3, 0.0), (2.6, 0.0))
        time = np.arange(len(wobble)) / RATE
        normal = 1.5 * wobble * (1.0 + 0.03 * np.sin(2 * np.pi * 1.3 * time))
        pull = ramp((0, 0), (0.5, 0.0), (1.7, 1.5), (2.2, 1.5), (2.25, 0.0), (2.6, 0.0))
        lateral = np.minimum(pull, friction * normal)
        noise = rng.normal(0.0, 0.005, (2, len(normal)))
        rows = run(estimator, normal + noise[0], lateral + noise[1], number * 10**10)
        assert rows["slips"][-1] == number + 1
    assert rows["friction"][-1] == pytest.approx(friction, rel=0.05)
    assert rows["friction_stddev"][-1] < 0.1 * friction
    announced = np.argmax(rows["slip_probability"] > 0.15)
    slipped = np.argmax(pull > friction * normal + (time < 0.5))
    assert 10 <= slipped - announced < 100


def test_a_pull_that_is_held_is_no_slip():
    estimator = SlipEstimator(SlipSettings(friction_prior=0.6, tangential_noise=0.002))
    time = np.arange(1500) / RATE
    normal = 1.0 + 0.05 * np.sin(2 * np.pi * 2.0 * time)
    lateral = ramp((0, 0), (0.5, 0), (1.0, 0.25), (3.0, 0.24))
    rows = run(estimator, normal, lateral)
    assert rows["slips"][-1] == 0
    assert not (rows["flags"] & SlipFlag.SLIPPING).any()
    assert rows["slip_probability"][600:].max() < 0.1


def test_a_camera_tells_the_friction_before_the_first_slip():
    def friction(camera):
        estimator = SlipEstimator(SlipSettings(tangential_noise=0.002))
        found = 0.3 * np.ones(1)
        lateral = ramp((0, 0), (0.3, 0.0), (1.3, 0.18))
        for begin in range(0, len(lateral), 50):
            part = slice(begin, begin + 50)
            stamps = (np.arange(begin, begin + len(lateral[part])) * 2_000_000).astype(np.int64)
            along = np.outer(lateral[part], [1.0, 0.0])
            n = len(stamps)
            rows = estimator.add_many(stamps, np.ones(n), along, np.ones(n, bool), np.ones(n))
            found = rows["friction"], rows["friction_stddev"]
            if camera and begin > 200:
                seen = float(backbone.stick_ratio(lateral[begin] / 0.25))
                assert estimator.add_stick_ratio(int(stamps[0]), seen, 0.05)
        return found[0][-1], found[1][-1]

    blind, wide = friction(False)
    seen, narrow = friction(True)
    assert seen == pytest.approx(0.25, rel=0.1)
    assert abs(blind - 0.25) > 0.1 and narrow < 0.5 * wide


def test_a_camera_tells_of_a_first_pull_in_every_contact():
    """The first contact is pulled back before it ends; s(r) does not hold then."""
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.002))
    normal = ramp((0, 0), (0.2, 1), (1.5, 1), (1.6, 0), (2.0, 0), (2.2, 1), (3.0, 1))
    run(estimator, normal, ramp((0, 0), (0.3, 0), (0.8, 0.18), (1.3, 0), (2.4, 0), (3.0, 0.15)))
    told = [estimator.add_stick_ratio(at, 0.7, 0.05) for at in (700_000_000, 10**9, 2_900_000_000)]
    assert told == [True, False, True]


def test_one_by_one_and_many_at_once_agree_to_the_bit():
    rng = np.random.default_rng(1)
    n = 400
    normal = np.abs(rng.normal(0.8, 0.1, n)) * ramp((0, 0), (0.2, 1), (0.7, 1), (0.8, 0))
    lateral = rng.normal(0.2, 0.05, (n, 2))
    stamps = np.cumsum(rng.integers(1_500_000, 2_500_000, n))
    touching, depth = normal > 0.05, np.full(n, 1e-3)
    rows = SlipEstimator().add_many(stamps, normal, lateral, touching, depth)
    single = SlipEstimator()
    for i in range(n):
        part = slice(i, i + 1)
        row = single.add_many(
            stamps[part], normal[part], lateral[part], touching[part], depth[part]
        )
        found = slip_estimates(row)[0]
        for name in ("stick_ratio", "slip_probability", "friction", "slip_margin_stddev"):
            a, b = getattr(found, name), rows[name][i]
            assert a == b or (math.isnan(a) and math.isnan(b))


def test_stamps_that_count_from_a_trigger_may_be_negative():
    """Nothing was forecast before time 0, and a slip was learned less from."""
    _, normal, lateral, _ = slipping(2, 0.5)
    later, earlier = (run(SlipEstimator(), normal, lateral + 0.1, s) for s in (10**11, -(10**11)))
    for name in ("slip_probability", "friction", "slip_margin", "stick_ratio"):
        np.testing.assert_array_equal(later[name], earlier[name])


def test_without_contact_nothing_is_claimed():
    rows = run(SlipEstimator(), np.zeros(50), np.full(50, 0.02))
    for name in ("stick_ratio", "slip_margin", "tangential_stiffness"):
        assert np.isnan(rows[name]).all()
    assert (rows["slip_probability"] == 0.0).all()
    assert (rows["flags"] & SlipFlag.NO_CONTACT).all()
    assert np.isfinite(rows["friction"]).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_not_finite_leaves_no_trace(bad):
    normal, lateral = np.full(600, 1.0), np.full(600, 0.1)
    clean = run(SlipEstimator(), normal, lateral)
    for broken in ((300, "normal"), (300, "lateral")):
        n, q = normal.copy(), lateral.copy()
        (n if broken[1] == "normal" else q)[broken[0]] = bad
        rows = run(SlipEstimator(), n, q)
        assert rows["flags"][300] == SlipFlag.FORCE_INVALID | SlipFlag.FRICTION_ASSUMED
        assert np.flatnonzero(np.isnan(rows["slip_probability"])).tolist() == [300]
        assert rows["friction"][-1] == pytest.approx(clean["friction"][-1], rel=1e-3)
        assert rows["stick_ratio"][-1] == pytest.approx(clean["stick_ratio"][-1], abs=1e-3)


def test_moisture_shifts_the_prior_until_something_was_learned():
    n = 10
    still = np.arange(n) * 2_000_000, np.ones(n), np.zeros((n, 2)), np.ones(n, bool), np.ones(n)

    def friction(estimator, moisture):
        return estimator.add_many(*still, np.full(n, moisture))["friction"][-1]

    dry = friction(SlipEstimator(), 37.0)
    assert dry < 0.8 * friction(SlipEstimator(), 69.0) < 0.7 * friction(SlipEstimator(), 105.0)
    assert friction(SlipEstimator(), math.nan) == friction(SlipEstimator(), NATURAL.moisture)


def test_live_samples_and_blocks_of_estimates_agree_to_the_bit():
    model = ReducedModel.load()
    rng = np.random.default_rng(4)
    n = 600
    stamps = 10**18 + np.cumsum(rng.integers(1_800_000, 2_200_000, n))
    stamps[400:] -= 10**12  # time jumps back: everything begins anew
    normal = ramp((0, 0), (0.3, 1.0), (1.0, 1.0), (1.2, 0.0))[:n]
    pull = ramp((0, 0), (0.4, 0.0), (1.0, 0.4), (1.2, 0.4))[:n]
    forces = np.column_stack([pull, rng.normal(0, 0.01, n), -normal])
    contact, slip = ContactEstimator(model), SlipEstimator()
    of = dict(zip(stamps.tolist(), forces))  # one that jumps back waits for its successor
    single = [
        slip.add(estimate, of[estimate.stamp_ns])
        for stamp, force in zip(stamps.tolist(), forces)
        for estimate in contact.add_wrench(stamp, force)
    ]
    block = ContactEstimator(model).add_wrenches(stamps, forces)
    many = slip_estimates(SlipEstimator().add_block(block, forces))
    assert len(single) == len(many) == n
    assert repr(single) == repr(many)
    later = SlipEstimator().add_block(type(block)(block.rows[400:]), forces[400:])
    assert repr(single[400:]) == repr(slip_estimates(later))


def test_a_force_that_the_contact_estimator_doubts_teaches_no_friction():
    """Sample by sample and by blocks."""
    normal = ramp((0, 0), (0.3, 1), (1.8, 1), (1.9, 0), (2, 0))
    pull = ramp((0, 0), (1.8, 1), (2, 0))
    forces = np.column_stack([pull, 0.0 * pull, -normal])
    block = ContactEstimator(ReducedModel.load()).add_wrenches(
        10**18 + np.arange(len(normal)) * 2_000_000, forces
    )
    found = []
    for doubted in (False, True):
        rows = block.rows.copy()
        rows["flags"][rows["in_contact"]] |= int(StateFlag.FORCE_OFFSET) * doubted
        again, slip = EstimateBlock(rows), SlipEstimator()
        single = [slip.add(e, f) for e, f in zip(again, forces.tolist(), strict=True)]
        many = SlipEstimator().add_block(again, forces)
        assert single[-1].friction == many["friction"][-1]
        found.append(many["friction"][[0, -1]])
    assert found[0][1] > 1.5 * found[0][0]
    assert found[1][1] == pytest.approx(found[1][0], rel=0.05)


def test_a_setting_that_changes_leaves_what_was_learned_and_another_plate_the_zero():
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    _, normal, lateral, _ = slipping(3, 0.9)
    _, light, pull, _ = slipping(1, 0.9)
    run(estimator, *noisy(normal, lateral + 0.2))
    estimator.configure(replace(estimator.settings, slip_horizon=0.05))
    after = run(estimator, np.zeros(1), np.full(1, 0.2), 12 * 10**9)
    assert after["friction"][0] == pytest.approx(0.9, rel=0.05)
    estimator.change_surface()
    touched = light > 0.0
    rows = run(estimator, light[touched], pull[touched] + 0.2, 13 * 10**9)
    assert rows["friction"][-1] == pytest.approx(0.9, rel=0.05)


def test_stick_ratios_enter_by_their_stamps_whenever_they_come():
    model = ReducedModel.load()
    n = 900
    stamps = 10**18 + 2_000_000 * np.arange(n, dtype=np.int64)
    normal = ramp((0, 0), (0.3, 1.0), (1.8, 1.0))[:n]
    pull = ramp((0, 0), (0.4, 0.0), (1.8, 0.22))[:n]
    forces = np.column_stack([pull, np.zeros(n), -normal])
    frames = [(int(stamps[k]) + 700_000, 0.05 * (9 - k // 100), 0.05) for k in range(350, 850, 30)]
    contact, slip = ContactEstimator(model), SlipEstimator()
    slip.sticks.delay = 0.1
    late = []
    single = []
    for stamp, force in zip(stamps.tolist(), forces):
        # Each comes 30 to 90 ms after its stamp, and not in order.
        late += [
            f for f in frames if f[0] // 2_000_000 + 15 + 30 * (f[0] % 3) == stamp // 2_000_000
        ]
        while late:
            slip.expect_stick_ratio(*late.pop())
        for estimate in contact.add_wrench(stamp, force):
            single.append(slip.add(estimate, force))
    many = SlipEstimator()
    many.sticks.delay = 0.1
    for frame in frames[::-1] + frames[:3]:
        many.expect_stick_ratio(*frame)
    many.expect_stick_ratio(int(stamps[500]), math.nan, math.nan)
    block = ContactEstimator(model).add_wrenches(stamps, forces)
    assert repr(single) == repr(slip_estimates(many.add_block(block, forces)))
    blind = SlipEstimator().add_block(block, forces)
    assert repr(slip_estimates(blind)[:390]) == repr(single[:390])
    assert single[-1].friction < 0.85 * blind["friction"][-1], "seen slip says: slippery"


@pytest.mark.parametrize("gap", ["none", "in the air", "under load"])
def test_what_slipped_while_the_camera_was_away_does_not_count_as_sticking(gap: str) -> None:
    """It follows the skin anew then, and sees nothing slip: a load is held."""
    contact = ContactEstimator(ReducedModel.load())
    beside = SlipAndShape(contact, SlipSettings(), None)
    anew = {"none": -1, "in the air": 0, "under load": 816}[gap]
    for k in range(1500):
        stamp = 10**15 + 2_000_000 * k
        normal, pull = min(1.0, k / 250), 0.3 * min(1.0, max(0.0, k - 300) / 500)
        seen = 0.98 if gap == "under load" else float(backbone.stick_ratio(pull / 0.5))
        if k == anew:
            beside.see_area(stamp, (math.nan, math.nan), NO_OUTLINE)
        elif k > max(anew, 300) and k % 16 == 0:
            beside.see_area(stamp, (seen, 0.05), NO_OUTLINE)
        force = (pull, 0.0, -normal)
        for estimate in contact.add_wrench(stamp, force):
            state, _ = beside.process(estimate, force, (0.0, 0.0, 0.0))
    assert state is not None
    assert state.slip_margin == pytest.approx(0.4, abs=2.0 * state.slip_margin_stddev)
    if gap == "under load":
        assert state.friction_stddev > 0.15, "as without a camera"
    else:
        assert state.friction == pytest.approx(0.5, rel=0.1)


def test_a_ratio_after_a_gap_of_the_camera_still_says_what_has_slipped() -> None:
    """At most as much sticks as it saw stick."""
    found = {}
    for seen in (False, True):
        contact, slip = ContactEstimator(ReducedModel.load()), SlipEstimator()
        for k in range(1200):
            stamp = 10**15 + 2_000_000 * k
            normal, pull = min(1.0, k / 250), 0.2 * min(1.0, max(0.0, k - 300) / 500)
            if k == 816:
                slip.expect_lost_sight(stamp)
            if seen and k > 816 and k % 16 == 0:
                slip.expect_stick_ratio(stamp, 0.2, 0.05)
            for estimate in contact.add_wrench(stamp, (pull, 0.0, -normal)):
                found[seen] = slip.add(estimate, (pull, 0.0, -normal)).friction
    assert found[True] < 0.6 * found[False]


@pytest.mark.parametrize("settled", [False, True])
def test_a_force_of_another_zero_is_told_without_a_contact_too(settled: bool) -> None:
    """With slips that were seen, nothing else would say that a thing may be held."""
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    if settled:
        _, normal, lateral, _ = slipping(3, 0.9)
        run(estimator, *noisy(normal, lateral))
    n = 10
    stamps = 20 * 10**9 + 2_000_000 * np.arange(n, dtype=np.int64)
    for doubted in (False, True):
        rows = estimator.add_many(
            stamps,
            np.zeros(n),
            np.zeros((n, 2)),
            np.zeros(n, bool),
            np.zeros(n),
            doubted=np.full(n, doubted),
        )
        stamps += 10**8
        wanted = SlipFlag.NO_CONTACT
        if doubted or not settled:
            wanted |= SlipFlag.FRICTION_ASSUMED
        assert (rows["flags"] == int(wanted)).all()


SHEAR = (
    (
        (9.83, 8.40, 0.40, 4.44, 4.60, 0.0, 6.51, 0.71),
        60.0,
        (0.07, 0.43, 1.56),
        (250.0, 284.0, 316.0),
    ),
    (
        (6.06, 3.86, 0.94, 2.81, 1.64, 0.0, 4.46, 0.69),
        22.0,
        (0.09, 0.48, 1.85),
        (267.0, 323.0, 370.0),
    ),
    (
        (9.43, 5.24, 0.73, 5.11, 2.42, 0.0, 5.75, 0.55),
        24.9,
        (0.18, 1.37, 5.57),
        (348.0, 427.0, 538.0),
    ),
    (
        (6.18, 3.88, 0.54, 2.71, 1.85, 0.0, 4.97, 0.37),
        18.1,
        (0.05, 0.35, 1.46),
        (252.0, 318.0, 360.0),
    ),
    (
        (9.33, 5.25, 0.99, 3.54, 1.78, 0.0, 8.09, 0.75),
        71.1,
        (0.24, 1.25, 4.83),
        (710.0, 815.0, 902.0),
    ),
    (
        (8.39, 6.03, 0.83, 2.11, 2.57, 0.0, 6.79, 0.23),
        69.8,
        (0.12, 0.47, 1.35),
        (210.0, 245.0, 301.0),
    ),
)
"""Lengths of a Geometry (mm), E₂/E, and P (N) and tangential stiffness (N/m) at 0.03, 0.08 and 0.15
of the pad's semi-axis in the three-dimensional model; E 30 kPa."""


def held(estimator, indentation, seconds=0.02, normal=1.0):
    """Rows at 500 Hz of a press (N) that is pulled by 0.1 N at once, 0.1 s after the onset."""
    n = 50 + round(seconds * RATE)
    pull = np.where(np.arange(n) < 50, 0.0, 0.1)
    rows = 2_000_000 * np.arange(n), np.full(n, normal), np.column_stack([pull, 0.0 * pull])
    return estimator.add_many(*rows, np.ones(n, bool), np.full(n, indentation))


def test_tangential_stiffness_is_that_of_the_three_dimensional_model():
    errors = []
    for lengths, ratio, forces, exact in SHEAR:
        geometry = Geometry(*(value * 1e-3 for value in lengths))
        estimator = SlipEstimator()
        estimator.assume(geometry, elastic(30e3, E2=ratio * 30e3))
        depths = np.array([0.03, 0.08, 0.15]) * geometry.pad_semi_axis_radial
        found = [
            held(estimator, depth, normal=force)["tangential_stiffness"][-1]
            for depth, force in zip(depths.tolist(), forces, strict=True)
        ]
        errors.append(np.array(found) / exact - 1.0)
    assert np.abs(errors).max() < 0.2
    assert np.sqrt(np.mean(np.square(errors))) < 0.1
    # CalculiX 2.20, friction 0.5: 0.367 N/mm at the first 70 µm, pressed by 0.818 mm to 0.52 N.
    estimator = SlipEstimator()
    estimator.assume(CALCULIX_FINGER, elastic(30.23e3, E2=1652e3))
    found = held(estimator, 0.818e-3, normal=0.52)["tangential_stiffness"][-1]
    assert found == pytest.approx(367.0, rel=0.1)


def test_a_pulled_finger_creeps_to_what_its_long_term_modulus_lets_it():
    material = Material()
    estimator = SlipEstimator(SlipSettings(**KNOWN, friction_prior=2.0))
    estimator.assume(Geometry(), material)
    rows = held(estimator, 0.6e-3, 4.0)
    moved = rows["tangential_displacement"][:, 0] * rows["tangential_stiffness"]
    assert moved[49] == 0.0
    since = 0.002 * np.arange(len(rows) - 50)
    # The skin carries a part and does not relax: less creep than that of the tissue alone.
    rest = 0.1 / moved[-1]
    assert material.long_term_fraction < rest < 0.4
    creep_time = material.branches[0].relaxation_time / rest
    creep = (1.0 - np.exp(-since / creep_time)) * (1.0 / rest - 1.0)
    np.testing.assert_allclose(moved[100:], 0.1 * (1.0 + creep)[50:], rtol=0.05)


@pytest.mark.parametrize(
    ("seconds", "exact"),
    [(0.05, (0.02678, 0.05522, 0.08584, 0.12059)), (1.0, (0.03701, 0.09017, 0.15573, 0.23042))],
)
def test_a_pulled_finger_moves_as_in_three_dimensions(seconds, exact):
    """The default finger, natural, pressed to 0.5 N in 0.5 s; the displacements (mm) at 0.2, 0.4,
    0.6 and 0.8 of the friction are of SolidModel."""
    material = replace(Material(), **NATURAL.parameters)
    time = np.append(np.linspace(0.02, 0.5, 25), 0.5 + 0.01 * seconds * np.arange(1, 81))
    contact = simulate_reduced(material, time, np.minimum(time, 0.5), Geometry())
    pull = material.friction * 0.5 * np.maximum(time - 0.5, 0.0) / seconds
    found = pull_history(contact, pull, Geometry(), material).tangential_displacement
    np.testing.assert_allclose(1e3 * found[44::20], exact, rtol=0.08)


def test_another_finger_is_less_stiff_to_shear():
    default, soft = SlipEstimator(), SlipEstimator()
    moduli = {name: 0.5 * getattr(Material(), name) for name in ("E0", "E2", "nail_modulus")}
    soft.assume(Geometry(), replace(Material(), **moduli))
    of_default, of_soft = (
        held(estimator, 0.6e-3, normal=force)["tangential_stiffness"][-1]
        for estimator, force in ((default, 1.0), (soft, 0.5))
    )
    assert of_soft == pytest.approx(0.5 * of_default, rel=0.02)


@pytest.mark.parametrize("force", [30.0, 1e4, 1e300])
def test_a_load_beyond_all_that_was_compared_leaves_a_stiffness(force):
    """As of a wrong sample; what it takes has an end."""
    found = held(SlipEstimator(), 0.6e-3, normal=force)
    little = held(SlipEstimator(), 0.6e-3, normal=0.1)["tangential_stiffness"][-1]
    assert 0.3 * little < found["tangential_stiffness"][-1] < little
    assert np.isfinite(found["tangential_displacement"]).all()


@pytest.mark.parametrize("rate", [500, 50, 40, 20, 15])
def test_slips_teach_friction_at_any_rate_of_the_sensor(rate):
    rng = np.random.default_rng(rate)
    time = np.arange(0.0, 5.2, 1.0 / rate)
    phase = time % 2.6
    normal = np.interp(phase, [0.0, 0.3, 2.3, 2.5], [0.0, 1.0, 1.0, 0.0])
    pull = np.interp(phase, [0.4, 1.0, 2.3, 2.5], [0.0, 0.7, 0.7, 0.0])
    lateral = np.column_stack([np.minimum(pull, 0.6 * normal), 0.0 * time])
    found = SlipEstimator().add_many(
        (time * 1e9).astype(np.int64),
        normal + rng.normal(0.0, 0.005, len(time)),
        lateral + rng.normal(0.0, 0.005, lateral.shape),
        normal > 0.03,
        np.full(len(time), 1e-3),
    )
    assert found["slips"][-1] == 2
    assert found["friction"][-1] == pytest.approx(0.6, rel=0.1)


def test_bad_values_are_refused():
    with pytest.raises(InputError, match="friction_prior"):
        SlipSettings(friction_prior=0.0)
    with pytest.raises(InputError, match=r"\(3, 2\) is needed"):
        SlipEstimator().add_many(np.arange(3), np.ones(3), np.ones((3, 3)), np.ones(3), np.ones(3))
    assert not SlipEstimator().add_stick_ratio(5, math.nan, 0.05)


def test_slips_are_announced_and_alarms_are_true(module_of):
    study = module_of("scripts/slip_study.py").study
    found = study(fingers=12, seed=2, camera=True)
    assert found["announced_percent"] >= 95
    assert found["false_alarms_percent"] <= 6
    assert found["friction_within_10_percent"] >= 95
    blind = study(fingers=12, seed=2, camera=False)
    assert blind["announced_later_percent"] >= 92


def test_simulate_gives_stick_and_slip_of_a_long_history_at_once(tmp_path, capsys):
    time = np.arange(0.0, 3.0, 0.002)
    normal = np.interp(time, [0, 0.5, 2.6, 2.8], [0.0, 0.52, 0.52, 0.0])
    pull = np.interp(time, [0.6, 1.2, 1.6, 2.2, 2.5], [0.0, 0.2, -0.1, 0.3, 0.3])
    rows = np.column_stack([time, normal, pull])
    header = "time_s,force_n,tangential_force_n"
    np.savetxt(tmp_path / "pull.csv", rows, delimiter=",", header=header, comments="")
    (tmp_path / "skin.yaml").write_text("E0: 60.46e3\nE1: 60.46e3\ntau1: 0.01\nfriction: 0.5\n")
    force, skin = str(tmp_path / "pull.csv"), str(tmp_path / "skin.yaml")
    arguments = ["simulate", "--force", force, "--material", skin, "--solver", "reduced"]
    assert run_command(_main, [*arguments, "-o", str(tmp_path / "out.csv")]) == 0
    table = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)

    def at(seconds):
        return round(seconds / 0.002)

    assert np.isnan(table["stick_ratio"][0]) and table["stick_ratio"][at(0.55)] == 1.0
    assert table["slip_margin"][at(1.2)] == pytest.approx(1 - 0.2 / 0.26, abs=0.01)
    first = float(backbone.stick_ratio(0.2 / 0.26))
    assert table["stick_ratio"][at(1.2) - 1] == pytest.approx(first, abs=0.06)
    assert table["stick_ratio"][at(1.25)] == 1.0  # after the turn all sticks again
    assert table["slip_margin"][at(2.2)] == 0.0 and table["stick_ratio"][at(2.3)] == 0.0
    moved = table["tangential_displacement_mm"]
    assert 0.2 < moved[at(1.2)] < 1.5 and np.isnan(moved[at(2.3)])
    # The way back is another one than the way there.
    there = int(np.argmax(pull > 0.1))
    back = at(1.2) + int(np.argmax(pull[at(1.2) :] < 0.1))
    assert moved[back] > moved[there] + 0.005
    assert run_command(_main, [*arguments, "--tilt-deg", "10"]) == 2
    assert "use --solver full" in capsys.readouterr().err


def test_elements_carry_the_pull_whatever_the_normal_force_did_before():
    rng = np.random.default_rng(0)
    for _ in range(40):
        state = np.zeros(1, elements.ELEMENTS).view(np.recarray)[0]
        normal = np.exp(np.cumsum(rng.normal(size=50) * rng.choice([0.01, 0.1, 0.3])))
        for load in normal:
            angle, size = rng.uniform(0.0, 6.3), 0.99 * load * rng.random()
            pull = size * math.cos(angle), size * math.sin(angle)
            elements.press(state, 1.0, load, 0.0, *pull)
            elements.pull(state, load, *pull)
            assert np.hypot(*(state.force.mean(axis=0) - pull)) < 2e-6 * load


def test_a_finger_that_is_relieved_under_a_pull_goes_back(tmp_path):
    pull = tmp_path / "pull.csv"
    pull.write_text(
        "time_s,force_n,tangential_force_n\n0,0,0\n0.5,4,0\n1,4,0.9\n1.25,2.5,0.5\n1.5,1,0.1\n"
    )
    out = tmp_path / "out.csv"
    _main(["simulate", "--force", str(pull), "--solver", "reduced", "-o", str(out)])
    moved = np.genfromtxt(out, delimiter=",", names=True)["tangential_displacement_mm"]
    assert moved[2] > moved[3] > moved[4] > 0.0


def test_a_pull_is_the_same_whatever_freed_memory_holds(tmp_path):
    rows = "time_s,force_n,tangential_force_n\n0,1,0\n0.1,1,0.1\n0.2,1,0.2\n0.3,1,-0.1\n"
    (tmp_path / "pull.csv").write_text(rows)
    command = [sys.executable, "-c", "from finger_model.cli import main; main()", "simulate"]
    command += ["--force", str(tmp_path / "pull.csv"), "--solver", "reduced", "-o"]
    for name, freed in (("as_it_was.csv", "0"), ("overwritten.csv", "85")):
        environment = {**os.environ, "MALLOC_PERTURB_": freed}
        subprocess.run([*command, str(tmp_path / name)], env=environment, check=True)
    found = [(tmp_path / name).read_text() for name in ("as_it_was.csv", "overwritten.csv")]
    assert found[0] == found[1]


@pytest.mark.parametrize("prior", [{}, {"friction_prior": 0.1, "friction_prior_sd": 0.01}])
def test_a_ratio_beyond_all_frictions_is_not_taken_for_certain(prior):
    """As of a shear that was not tared, at the first touch."""
    rows = run(SlipEstimator(SlipSettings(**prior)), ramp((0, 0.0), (1, 1.0)), np.full(500, 0.5))
    told = rows[np.isfinite(rows["stick_ratio"])]
    assert len(told) > 400
    for name in ("friction", "slip_margin", "slip_probability", "stick_ratio_stddev"):
        assert np.isfinite(told[name]).all(), name
    if not prior:
        assert np.all(told["friction_stddev"] >= 0.5 * told["friction"])


def carried(dips: bool, picks: int = 1, fraction: float = 0.3) -> tuple[float, float, int, float]:
    """Friction and its deviation, slips counted, and the largest probability of slip at the end of
    `picks` holds of a thing that never slides, whose load dips now and then."""
    random = np.random.default_rng(1)
    contact, slip = ContactEstimator(ReducedModel.load()), SlipEstimator()
    stamp, most = 10**15, 0.0
    for _ in range(picks):
        for k in range(3000):
            t = k / 500
            normal = min(1.0, t / 0.3) if t < 5.8 else max(0.0, (5.9 - t) / 0.1)
            pull = fraction * min(1.0, max(0.0, t - 0.4) / 0.4)
            pull *= 1.0 if t < 5.8 else 0.9 * normal  # it is put down
            for dip in (2.0, 3.2, 4.4) if dips else ():
                if dip < t < dip + 0.4:
                    pull -= 0.1 * np.sin(np.pi * (t - dip) / 0.4)
            noise = 0.003 * random.standard_normal(2) if normal > 0.01 else np.zeros(2)
            stamp += 2_000_000
            force = (pull + noise[0], 0.0, -(normal + noise[1]))
            for estimate in contact.add_wrench(stamp, force):
                found = slip.add(estimate, force)
            if 5.2 < t < 5.7:
                most = max(most, found.slip_probability)
                last = found.friction, found.friction_stddev
    return *last, found.slips, most


@pytest.mark.parametrize(("dips", "picks"), [(True, 1), (False, 8)])
def test_a_thing_that_is_held_at_one_ratio_again_and_again_does_not_slip(
    dips: bool, picks: int
) -> None:
    friction, deviation, slips, probability = carried(dips, picks)
    assert slips <= 1 and probability < 0.45
    assert friction > 0.36 and deviation > 0.1


def test_a_camera_is_not_surer_after_a_long_hold_than_after_a_short_one() -> None:
    """Its frames of one hold err alike."""
    found = []
    for hold in (2.0, 30.0):
        random = np.random.default_rng(0)
        contact, slip = ContactEstimator(ReducedModel.load()), SlipEstimator()
        slip.sticks.delay = 0.05
        for k in range(round(500 * hold)):
            stamp = 10**15 + 2_000_000 * k
            normal, pull = min(1.0, k / 250), 0.3 * min(1.0, max(0.0, k - 300) / 500)
            if k % 16 == 0 and k > 400:
                seen = float(backbone.stick_ratio(pull / normal / 0.6))
                slip.expect_stick_ratio(stamp, seen + 0.02 * random.standard_normal(), 0.05)
            for estimate in contact.add_wrench(stamp, (pull, 0.0, -normal)):
                state = slip.add(estimate, (pull, 0.0, -normal))
        found.append(state)
    assert found[1].friction == pytest.approx(0.6, rel=0.1)
    assert 0.9 * found[1].friction_stddev > found[0].friction_stddev > 0.008


def test_the_bone_moves_over_the_plate_where_the_finger_pulls_to() -> None:
    contact, slip = ContactEstimator(ReducedModel.load()), SlipEstimator()
    for k in range(600):
        force = (0.1 * min(1.0, k / 300), 0.0, -1.0)
        for estimate in contact.add_wrench(10**15 + 2_000_000 * k, force):
            state = slip.add(estimate, force)
    assert state.tangential_displacement[0] > 1e-5


def test_another_normal_axis_than_the_contacts_is_refused() -> None:
    """P would enter as Q."""
    settings = EstimatorSettings(normal_axis="+x")
    contact, slip = ContactEstimator(ReducedModel.load(), settings=settings), SlipEstimator()
    turned = SlipEstimator(normal_axis="+x")

    def run(slip: SlipEstimator) -> None:
        for k in range(10):
            force = (0.1 * (k + 1), 0.01, 0.0)
            for estimate in contact.add_wrench(10**15 + 2_000_000 * (k + 1), force):
                slip.add(estimate, force)

    with pytest.raises(InputError, match=r"the lateral force is .* give SlipEstimator the normal_"):
        run(slip)
    contact = ContactEstimator(ReducedModel.load(), settings=settings)
    run(turned)


def test_the_sample_that_waited_at_a_jump_of_time_is_not_refused() -> None:
    """Its estimate comes with the force of the next one."""
    contact, slip = ContactEstimator(ReducedModel.load()), SlipEstimator()
    for k, stamp in enumerate((1, 2, 3, 4, 5)):
        force, jump = (0.1 * k, 0.0, -1.0), 3600 * 10**9 * (stamp > 2)
        for estimate in contact.add_wrench(10**15 + 2_000_000 * stamp + jump, force):
            slip.add(estimate, force)
    assert contact.last_stamp == 10**15 + 10_000_000 + 3600 * 10**9


def test_many_samples_of_other_lengths_are_refused() -> None:
    with pytest.raises(InputError, match=r"normal_force has shape \(3,\), \(5,\) is needed"):
        SlipEstimator().add_many(
            np.arange(5) + 10**15, np.ones(3), np.zeros((5, 2)), np.ones(5, bool), np.ones(5)
        )


def test_a_sensor_that_was_not_tared_teaches_no_friction():
    """What was taken for a contact is forgotten where the estimator doubts it at its end."""

    def pulled(estimator, start):
        rows = run(estimator, ramp((0.0, 1.0), (2.0, 1.0)), ramp((0.0, 0.0), (2.0, 0.6)), start)
        return rows["friction"], np.flatnonzero(rows["slip_probability"] > 0.1)[0]

    estimator, fresh = SlipEstimator(), SlipEstimator()
    n = 1000
    stamps = (np.arange(n) * 1e9 / RATE).astype(np.int64)
    offset = np.ones(n), np.outer(np.full(n, 1.4), [0.6, 0.8])
    offset[0][-100:] = offset[1][-100:] = 0.0
    touching = offset[0] > 0.03
    rows = estimator.add_many(
        stamps, *offset, touching, np.full(n, 1e-3), doubted=touching & (stamps > 10**9)
    )
    assert rows["friction"][500] > 1.3
    assert rows["slips"][-1] == 0
    for found, wanted in zip(pulled(estimator, 3 * 10**9), pulled(fresh, 3 * 10**9)):
        assert found == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("residue", [0.03, 0.05, 0.06])
def test_what_a_tare_leaves_of_the_lateral_force_does_not_hide_slips(residue):
    """Presses from nothing to 1 N, each pulled until it slips at 0.4."""
    rng = np.random.default_rng(5)
    estimator = SlipEstimator()
    announced = 0
    for number in range(4):
        normal = ramp((0.0, 0.0), (0.2, 0.0), (0.7, 1.0), (2.5, 1.0), (2.8, 0.0), (3.0, 0.0))
        normal *= 1.0 + 0.015 * np.sin(2 * np.pi * 8.5 * np.arange(len(normal)) / RATE)
        pull = ramp((0.0, 0.0), (0.9, 0.0), (2.3, 0.55), (2.5, 0.55), (2.6, 0.0), (3.0, 0.0))
        slides = (pull >= 0.4 * normal) & (normal > 0.5)
        pull = np.minimum(pull, 0.4 * normal) + residue + 0.003 * rng.standard_normal(len(pull))
        rows = run(estimator, normal, pull, 4 * 10**9 * number)
        announced += rows["slip_probability"][slides].max() > 0.15
    assert announced == 4
    assert rows["friction"][-1] < 0.6


def shaken(time: np.ndarray, share: float = 0.015) -> np.ndarray:
    """Tremor of a finger: factors of its force."""
    return 1.0 + share * np.sin(2 * np.pi * 8.5 * time) + 0.03 * np.sin(2 * np.pi * 1.1 * time)


def noisy(normal: np.ndarray, lateral: np.ndarray, sd: float = 0.005, seed: int = 0):
    """Both forces with noise (N)."""
    noise = np.random.default_rng(seed).normal(0.0, sd, (2, len(normal)))
    touching = normal > 0.01
    return normal + noise[0] * touching, lateral + noise[1] * touching


def presses(count: int, length: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Time, and a normal force of up to 1 N, in presses of this length (s)."""
    time = np.arange(0.0, count * length, 1.0 / RATE)
    corners = [0.0, 0.3, 0.6, length - 0.6, length - 0.3, length]
    return time, np.interp(time % length, corners, [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize("degrees", [5, 10])
@pytest.mark.parametrize("swing", [0.0, 0.2])
def test_a_press_that_is_oblique_from_the_first_touch_on_is_no_slip(degrees, swing):
    time, normal = presses(8)
    normal = normal * (1.0 + swing * np.sin(2 * np.pi * 2.0 * time))
    rows = run(SlipEstimator(), *noisy(normal, math.tan(math.radians(degrees)) * normal))
    assert rows["slips"][-1] == 0 and not (rows["flags"] & SlipFlag.SLIPPING).any()
    assert rows["friction"][-1] > 0.4


@pytest.mark.parametrize(("noise", "said"), [(0.01, 0.01), (0.02, 0.01), (0.02, 0.02)])
def test_a_load_that_is_held_for_a_minute_does_not_come_to_slip_by_noise(noise, said):
    time = np.arange(0.0, 60.0, 1.0 / RATE)
    normal, pull = np.minimum(time / 0.5, 1.0), 0.3 * np.clip(2.0 * (time - 0.5), 0.0, 1.0)
    forces = np.column_stack([normal, 0.6 * pull, 0.8 * pull])
    forces += np.random.default_rng(0).normal(0.0, noise, forces.shape)
    rows = SlipEstimator(SlipSettings(tangential_noise=said)).add_many(
        (time * 1e9).astype(np.int64),
        forces[:, 0],
        forces[:, 1:],
        normal > 0.03,
        np.full(len(time), 1e-3),
    )
    assert rows["slips"][-1] == 0 and not (rows["flags"] & SlipFlag.SLIPPING).any()
    assert rows["friction"][-1] > 0.4


def test_light_things_teach_no_low_friction():
    """What is held is chosen by who holds it: it tells nothing but a lower bound."""
    time, normal = presses(30)
    shares = np.random.default_rng(2).uniform(0.05, 0.2, 30)
    lateral = np.interp(time % 3.0, [0.7, 0.9, 2.0, 2.3], [0.0, 1.0, 1.0, 0.0])
    lateral *= shares[(time // 3.0).astype(int)]
    rows = run(SlipEstimator(), *noisy(normal * shaken(time), lateral))
    assert rows["slips"][-1] == 0 and rows["friction"][-1] > 0.4


@pytest.mark.parametrize(("size", "samples"), [(10.0, 1), (3.0, 5), (5.0, 10), (100.0, 1)])
def test_a_knock_teaches_no_friction(size, samples):
    _, normal = presses(1)
    found = []
    for knock in (0.0, size):
        forces = noisy(normal, 0.0 * normal)
        forces[1][600 : 600 + samples] += knock
        found.append(run(SlipEstimator(), *forces)[-1])
    assert found[1]["slips"] == 0
    assert found[1]["friction"] == pytest.approx(found[0]["friction"], rel=0.05)


def test_a_more_slippery_thing_than_before_is_noticed():
    estimator, found = SlipEstimator(), []
    for number, friction in enumerate([0.9] * 3 + [0.3] * 2):
        time, normal = presses(1, 4.0)
        normal = normal * shaken(time)
        pull = 1.2 * friction * ramp((0, 0), (0.8, 0), (1.8, 1), (3.1, 1), (3.3, 0), (4, 0))
        forces = noisy(normal, np.minimum(pull, friction * normal), seed=number)
        rows = run(estimator, *forces, number * 5 * 10**9)
        slips = (pull > friction * normal) & (time > 1.0) & (time < 3.0)
        alarm = (rows["slip_probability"] > 0.15) & (time > 0.8)
        found.append(time[np.argmax(alarm)] - time[np.argmax(slips)] if alarm.any() else math.inf)
    assert max(found[1:3]) < -0.02
    assert found[3] < 0.5  # the first slip on it
    assert found[4] < -0.02
    assert rows["friction"][-1] == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize("lag", [0.03, 0.08])
@pytest.mark.parametrize("rate", [0.5, 1.0])
def test_a_grip_that_follows_its_load_does_not_slip(rate, lag):
    """P follows Q there, with the lag of a controller."""
    time = np.arange(0.0, 10.0, 1.0 / RATE)
    load = 0.8 * np.clip(2.0 * (time - 0.5), 0.0, 1.0)
    load *= 1.0 + 0.3 * np.sin(2 * np.pi * rate * np.maximum(time - 2.0, 0.0))
    grip = 0.5 + 2.2 * np.interp(time - lag, time, load)
    settings = SlipSettings(tangential_noise=0.005, grip_follows_load=True)
    rows = run(SlipEstimator(settings), *noisy(grip, load))
    assert rows["slips"][-1] == 0
    assert np.mean((rows["flags"] & SlipFlag.SLIPPING) > 0) < 0.02


def test_slip_that_comes_and_goes_with_the_grip_is_seen():
    """The grip swings about what holds the load: it slips where the grip is low."""
    time = np.arange(0.0, 6.0, 1.0 / RATE)
    load = 0.8 * np.clip(2.0 * (time - 0.5), 0.0, 1.0)
    grip = ramp((0, 1.5), (2, 1.5), (4, 1.02), (6, 1.02))
    grip *= 1.0 + 0.06 * np.sin(2 * np.pi * 6.0 * time)
    settings = SlipSettings(tangential_noise=0.005, grip_follows_load=True)
    rows = run(SlipEstimator(settings), *noisy(grip, np.minimum(load, 0.8 * grip)))
    assert rows["slips"][-1] >= 1
    assert rows["friction"][-1] == pytest.approx(0.8, rel=0.05)


def test_forces_of_other_samples_are_refused():
    contact = ContactEstimator(ReducedModel.load())
    stamps = np.arange(100) * 2_000_000
    forces = np.column_stack([np.linspace(0.0, 0.3, 100), np.zeros(100), np.full(100, -1.0)])
    repeated = np.repeat(np.arange(100), np.where(np.arange(100) < 20, 2, 1))
    block = contact.add_wrenches(stamps[repeated], forces[repeated])
    with pytest.raises(InputError, match=r"shape \(120, 3\), \(100, 3\) is needed"):
        SlipEstimator().add_block(block, forces[repeated])
    with pytest.raises(InputError, match="its own sample"):
        SlipEstimator().add_block(block, forces[repeated][:100])
    with pytest.raises(InputError, match="normal_axis"):
        SlipEstimator(normal_axis="+x").add_block(block, forces)
    assert len(SlipEstimator().add_block(block, forces.tolist())) == 100


@pytest.mark.parametrize("pull", [np.zeros(5), np.zeros(20), np.full(10, np.nan)])
def test_a_pull_of_another_length_is_refused(pull):
    material = Material()
    contact = ReducedModel.load().simulate(material, np.arange(10.0), np.ones(10))
    with pytest.raises(InputError, match="10 finite numbers are needed"):
        pull_history(contact, pull, Geometry(), material)


def test_a_prior_beyond_all_frictions_leaves_numbers():
    estimator = SlipEstimator(SlipSettings(friction_prior=2.0, friction_prior_sd=0.01))
    normal = ramp((0.0, 0.0), (0.2, 1.0), (0.4, 1.0), (0.6, 0.0), (0.8, 0.0), (1.0, 1.0))
    moisture = np.full(len(normal), 110.0)
    stamps = (np.arange(len(normal)) * 2_000_000).astype(np.int64)
    rows = estimator.add_many(
        stamps, normal, np.zeros((len(normal), 2)), normal > 0.03, normal * 1e-3, moisture
    )
    assert np.isfinite(rows["friction"]).all()


def slipping(count: int, friction: float, rise: float = 1.0) -> tuple[np.ndarray, ...]:
    """Time, P, Q and whether it slides of presses of 1 N, each pulled until it slides, with half a
    second in the air before each."""
    time, normal = presses(count, 4.0)
    normal = np.where(time % 4.0 < 0.5, 0.0, normal * shaken(time))
    pull = np.interp(time % 4.0, [0.9, 0.9 + rise, 3.0, 3.2], [0.0, friction, friction * 1.3, 0.0])
    pull = np.where(time % 4.0 < 3.0, pull + 0.3 * np.clip(time % 4.0 - 0.9 - rise, 0, 0.3), pull)
    slides = (pull >= friction * normal) & (normal > 0.5)
    return time, normal, np.minimum(pull, friction * normal), slides


@pytest.mark.parametrize("offset", [0.05, -0.05, 0.2, -0.2])
def test_the_zero_of_the_lateral_force_is_learned_in_the_air(offset):
    _, normal, lateral, slides = slipping(3, 0.5)
    noise = np.random.default_rng(3).normal(0.0, 0.005, len(normal))
    rows = run(
        SlipEstimator(SlipSettings(tangential_noise=0.005)), normal, lateral + offset + noise
    )
    assert rows["friction"][-1] == pytest.approx(0.5, rel=0.05)
    assert abs(rows["friction"][-1] - 0.5) < 3.0 * rows["friction_stddev"][-1]
    last = slides & (np.arange(len(slides)) > 4000)
    assert rows["slip_probability"][last].max() > 0.9


def test_a_silence_in_a_hold_leaves_margin_and_zero_unknown():
    """As of a driver that starts again: its lateral zero has moved by 0.2 N. Friction, which was
    learned before, is kept, and the next time in the air tells the new zero."""
    time, normal, lateral, _ = slipping(3, 0.5)
    hold = time[:4000]
    gripped = np.interp(hold, [0.5, 0.8, 6.0, 6.2, 6.8, 7.1], [0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    pulled = np.interp(hold, [1.0, 1.5, 5.9, 6.1, 7.2, 7.5], [0.0, 0.2, 0.2, 0.0, 0.0, 0.2])
    resumed = hold >= 3.0
    stamps = np.concatenate([time, 12.0 + hold + 4.0 * resumed])
    normal = np.concatenate([normal, gripped])
    lateral = np.concatenate([lateral, pulled + 0.2 * resumed])
    noise = np.random.default_rng(3).normal(0.0, 0.005, (len(stamps), 3))
    forces = np.stack([lateral, np.zeros(len(stamps)), -normal], axis=1) + noise
    block = ContactEstimator(ReducedModel.load()).add_wrenches((stamps * 1e9).astype(int), forces)
    rows = SlipEstimator(SlipSettings(tangential_noise=0.005)).add_block(block, forces)[6000:]
    assumed = rows["flags"] & SlipFlag.FRICTION_ASSUMED != 0
    known, after, again = ((hold > a) & (hold < b) for a, b in ((2, 3), (3, 5.8), (7.6, 8)))
    after &= rows["flags"] & SlipFlag.NO_CONTACT == 0
    for part in (known, again):
        assert not assumed[part].any()
        assert rows["slip_margin"][part] == pytest.approx(1.0 - 0.2 / 0.5, abs=0.06)
    assert assumed[after].all()
    assert rows["slip_margin_stddev"][after].min() >= 1.0
    assert rows["friction"][after] == pytest.approx(0.5, rel=0.06)


def test_a_lateral_force_that_changed_in_the_air_is_no_sure_zero():
    """As the weight of a gripper that turns before it touches."""
    time, normal, lateral, _ = slipping(3, 0.5)
    weight = np.where(time < 0.3, -0.15, 0.15)
    noise = np.random.default_rng(3).normal(0.0, 0.005, len(time))
    rows = run(
        SlipEstimator(SlipSettings(tangential_noise=0.005)), normal, lateral + weight + noise
    )
    pulled = (time % 4.0 > 1.5) & (time % 4.0 < 3.0)
    assert (rows["flags"][pulled] & SlipFlag.FRICTION_ASSUMED).all()
    error = np.abs(rows["friction"] - 0.5)[pulled]
    assert np.all(error < 3.0 * rows["friction_stddev"][pulled])


@pytest.mark.parametrize("offset", [0.1, 0.5, 5.0])
@pytest.mark.parametrize("after", [0.1, 0.6, 2.0])
def test_a_tare_before_a_press_gives_the_new_zero(offset, after):
    """As a robot does that starts, tares and grips. Without a pull no slip is announced."""
    time = np.arange(0.0, 6.0 + after, 1.0 / RATE)
    touch = 4.0 + after
    normal = np.interp(time, [touch, touch + 0.3], [0.0, 1.0])
    noise = np.random.default_rng(3).normal(0.0, 0.005, len(time))
    settings = SlipSettings(tangential_noise=0.005)
    rows = run(SlipEstimator(settings), normal, np.where(time < 4.0, offset, 0.0) + noise)
    pressed = rows[time > touch + 0.4]
    if after < 0.5:  # the zero is not known yet
        assert pressed["slip_margin_stddev"].min() > 0.1
        return
    assert pressed["slip_margin"] == pytest.approx(1.0, abs=0.05)
    assert pressed["slip_margin_stddev"].max() < 0.1
    assert pressed["slip_probability"].max() < 0.05


def test_a_gripper_that_moves_until_it_touches_has_no_sure_zero():
    """It begins to turn after a rest: the first change alone is a step, as of a tare."""
    for begin in np.arange(3.0, 3.5, 0.05):
        time = np.arange(0.0, 6.0, 1.0 / RATE)
        normal = np.interp(time, [4.0, 4.3], [0.0, 1.0])
        weight = np.interp(time, [begin, 4.0], [0.0, 1.0])
        rows = run(SlipEstimator(SlipSettings()), normal, weight)
        pressed = rows[time > 4.4]
        assert (pressed["flags"] & SlipFlag.FRICTION_ASSUMED).all()
        assert pressed["slip_margin_stddev"].min() > 0.2, begin


def test_what_a_finger_leaves_at_lift_off_is_no_zero():
    """It still rubs for 60 ms when its normal force is too small to count."""
    _, normal, lateral, _ = slipping(2, 0.5)
    lift = int(np.flatnonzero(normal[:2000] > 0.03)[-1]) + 1
    rubbed = lateral.copy()
    rubbed[lift : lift + 30] = 0.3
    clean, found = (run(SlipEstimator(), normal, q)[2000:] for q in (lateral, rubbed))
    assert clean.tobytes() == found.tobytes()


def test_a_zero_that_is_not_clear_blurs_margin_and_forecast():
    """In the air Q is 0.1 N, swinging by as much: 0.14 N of 1 N are unsure in the contact."""
    time = np.arange(0.0, 2.4, 1.0 / RATE)
    normal = np.interp(time, [1.12, 1.32], [0.0, 1.0])
    pull = np.interp(time, [1.4, 1.9], [0.0, 0.3])
    swing = np.where(normal > 0.0, 0.0, 0.1 + 0.14 * np.sin(2 * np.pi * time))
    settings = SlipSettings(friction_prior=0.5, **KNOWN)
    sure, blurred = (run(SlipEstimator(settings), normal, pull + s)[-1] for s in (0.0, swing))
    assert sure["slip_margin_stddev"] < 0.05 and sure["slip_probability"] < 0.01
    assert blurred["slip_margin_stddev"] == pytest.approx(0.14 / 0.5, rel=0.1)
    # Q reaches 0.5 N where its error is 0.2 N.
    assert blurred["slip_probability"] > 0.05
    assert blurred["flags"] & SlipFlag.FRICTION_ASSUMED


def test_an_exact_zero_in_the_air_changes_nothing():
    _, normal, lateral, _ = slipping(1, 0.5)
    rows, touching = run(SlipEstimator(), normal, lateral), normal > 0.03
    begin = int(np.argmax(touching))
    alone = run(SlipEstimator(), normal[begin:], lateral[begin:], begin * 2_000_000)
    assert rows[begin:].tobytes() == alone.tobytes()


@pytest.mark.parametrize("change", [0.5, 2.0])
def test_friction_that_changes_while_the_finger_slides_is_followed(change):
    time = np.arange(0.0, 60.0, 1.0 / RATE)
    friction = 0.5 * np.interp(time, [0.0, 60.0], [1.0, change])
    normal = np.minimum(time / 0.3, 1.0) * shaken(time)
    pull = np.clip(time - 1.0, 0.0, 1.5)
    rows = run(
        SlipEstimator(SlipSettings(tangential_noise=0.005)),
        *noisy(normal, np.minimum(pull, friction * normal)),
    )
    late = time > 5.0
    error = (rows["friction"] - friction)[late]
    assert np.all(np.abs(error) < 3.5 * rows["friction_stddev"][late])
    assert np.all(np.abs(error) < 0.1 * friction[late])
    assert (rows["flags"][late] & SlipFlag.SLIPPING).all()


def test_what_was_learned_of_friction_is_less_sure_in_a_long_contact():
    """As from contact to contact every 3 s: sweat comes, too, where the finger stays."""
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    _, normal, lateral, _ = slipping(3, 0.5)
    run(estimator, *noisy(normal, lateral))
    held = ramp((0.0, 0.0), (0.5, 1.0), (40.0, 1.0))
    rows = run(estimator, held, 0.0 * held, 13 * 10**9)
    deviation = rows["friction_stddev"] / rows["friction"]
    grown = deviation[-1] ** 2 - deviation[500] ** 2
    drift = SlipSettings().friction_drift
    assert grown == pytest.approx(drift**2 * 39.0 / 3.0, rel=0.3)


@pytest.mark.parametrize("ratio", [0.2, 0.3])
def test_the_margin_before_the_first_slip_is_that_of_all_frictions_that_may_be(ratio):
    """Those of the prior beyond what the contact carries."""
    lateral = ramp((0.0, 0.0), (0.3, 0.0), (0.8, ratio))
    row = run(SlipEstimator(), np.ones(len(lateral)), lateral)[-1]
    frictions = np.exp(np.random.default_rng(0).normal(math.log(0.45), 0.5, 20000))
    margins = 1.0 - ratio / frictions[frictions > ratio]
    assert row["slip_margin"] == pytest.approx(margins.mean(), abs=0.04)
    assert row["slip_margin_stddev"] == pytest.approx(margins.std(), rel=0.2)


def test_one_pull_that_is_held_does_not_pass_for_a_known_friction(module_of):
    study = module_of("scripts/slip_study.py")
    held, slid = [], []
    for _, pulls in study.followed(14, 4, False):
        slips = 0
        for one, rows in pulls:
            slips += not math.isnan(one.slip)
            assumed = bool(rows["flags"][-1] & SlipFlag.FRICTION_ASSUMED)
            if slips == 0:
                held.append(assumed)
            elif slips > 1:
                slid.append(assumed)
    assert len(held) > 10 and all(held)
    assert np.mean(slid) < 0.05


@pytest.mark.parametrize("rise", [0.15, 0.3])
def test_a_slide_at_a_known_friction_is_told_soon(rise):
    time, normal, lateral, slides = slipping(3, 0.5, rise)
    rows = run(SlipEstimator(SlipSettings(tangential_noise=0.005)), *noisy(normal, lateral))
    since = time - time[np.argmax(slides & (time > 8.0))]
    soon = slides & (since > 0.06) & (since < 0.1)
    assert soon.sum() > 10
    assert np.mean(rows["slip_probability"][soon] > 0.4) > 0.9


@pytest.mark.parametrize(("rate", "air"), [(100, 0.0), (100, 0.5), (50, 0.5)])
def test_noise_beyond_the_stated_one_is_noticed_at_a_low_rate(rate, air):
    time, normal, lateral, _ = slipping(4, 0.4)
    forces = np.column_stack([normal, 0.6 * lateral, 0.8 * lateral])
    forces += np.random.default_rng(1).normal(0.0, 0.05, forces.shape)
    kept = np.arange(0, len(time), round(RATE / rate))
    kept = kept[(time[kept] % 4.0 > 0.5 - air) & (normal[kept] + air > 0.0)]
    rows = SlipEstimator(SlipSettings(tangential_noise=0.005)).add_many(
        (time[kept] * 1e9).astype(np.int64),
        forces[kept, 0],
        forces[kept, 1:],
        normal[kept] > 0.03,
        np.full(len(kept), 1e-3),
    )
    found, left = rows[normal[kept] > 0.5], 1.0 - lateral / np.maximum(0.4 * normal, 1e-3)
    assert np.mean(np.abs(found["friction"] - 0.4) < 2.0 * found["friction_stddev"]) > 0.95
    error = found["slip_margin"] - left[kept][normal[kept] > 0.5]
    assert np.mean(error > 2.0 * found["slip_margin_stddev"]) < 0.08


def test_noise_that_was_not_seen_leaves_friction_assumed():
    """Below some 80 Hz a contact does not show it, only the air does."""
    time, normal, lateral, _ = slipping(3, 0.5)
    kept = np.arange(0, len(time), 10)
    kept = kept[normal[kept] > 0.1]
    rows = SlipEstimator().add_many(
        (time[kept] * 1e9).astype(np.int64),
        normal[kept],
        np.outer(lateral[kept], [0.6, 0.8]),
        np.ones(len(kept), bool),
        np.full(len(kept), 1e-3),
    )
    assert rows["slips"][-1] >= 1
    assert (rows["flags"] & SlipFlag.FRICTION_ASSUMED).all()


def held_loads(noise: float, seconds: float, count: int, seed: int = 1, swing: float = 0.0):
    """Time, and P, Qx, Qy (n, 3) of loads of 0.2 to 0.4 N that are held with 1 N."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE)
    for _ in range(count):
        normal = np.interp(time, [1.0, 1.5], [0.0, 1.0])
        normal *= 1.0 + swing * np.sin(2 * np.pi * rng.uniform(0.2, 2.0) * time + rng.uniform(0, 6))
        pull = np.interp(time, [2.0, 2.5], [0.0, rng.uniform(0.2, 0.4)])
        forces = np.column_stack([normal, pull, 0.0 * time])
        yield time, forces + rng.normal(0.0, noise, forces.shape)


def of_load(time: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Rows of what `held_loads` gives."""
    return SlipEstimator().add_many(
        (time * 1e9).astype(np.int64), forces[:, 0], forces[:, 1:], time >= 1.0, 5e-4 * (time >= 1)
    )


@pytest.mark.parametrize("times", [2, 4, 10])
def test_a_sensor_that_repeats_its_samples_tells_no_more_than_one_that_does_not(times):
    """It measures at 250, 125 or 50 Hz."""
    found = []
    for time, forces in held_loads(0.01, 10.0, 6, swing=0.03):
        repeated = np.repeat(forces[::times], times, axis=0)[: len(time)]
        row, once = (
            of_load(*of)[-1] for of in ((time, repeated), (time[::times], forces[::times]))
        )
        found.append(row["slips"])
        assert row["slips"] == once["slips"] and row["flags"] & SlipFlag.FRICTION_ASSUMED
        assert row["friction"] == pytest.approx(once["friction"], rel=0.05)
    assert sum(found) <= 1


def test_a_force_that_stays_the_same_is_measured_all_the_same():
    """Without noise: a pull that has come to a stop is no longer foretold to go on."""
    rows = run(SlipEstimator(), np.ones(600), ramp((0.0, 0.0), (0.5, 0.0), (1.0, 0.3), (1.2, 0.3)))
    assert rows["slip_probability"][515] < 0.7 * rows["slip_probability"][498]


@pytest.mark.parametrize(("noise", "most"), [(0.005, 0.02), (0.01, 0.15)])
def test_a_load_that_is_held_still_does_not_alarm_for_long(noise, most):
    """From 1 s after the pull has stopped on."""
    alarm = [
        np.mean(of_load(time, forces)["slip_probability"][time > 3.5] > 0.15)
        for time, forces in held_loads(noise, 12.0, 8)
    ]
    assert np.mean(alarm) < most


def tilted_pulls(estimator, degrees, friction, angles, pulled=1.3, start=0, seed=0):
    """Rows of one pull in each of these directions (rad), to `pulled` times the friction unless it
    slips, and back before the finger lifts, by a sensor whose normal axis leans towards x."""
    rng, lean = np.random.default_rng(seed), math.radians(degrees)
    rows = []
    for number, angle in enumerate(angles):
        time, normal = presses(1, 4.0)
        normal = normal * shaken(time)
        pull = pulled * friction * ramp((0, 0), (0.8, 0), (1.8, 1), (2.4, 1), (2.6, 0), (4, 0))
        along = np.outer(np.minimum(pull, friction * normal), [math.cos(angle), math.sin(angle)])
        turned = math.cos(lean) * normal - math.sin(lean) * along[:, 0]
        along[:, 0] = math.cos(lean) * along[:, 0] + math.sin(lean) * normal
        along += rng.normal(0.0, 0.005, along.shape)
        stamps = start + number * 5 * 10**9 + (2_000_000 * np.arange(len(time))).astype(np.int64)
        depth = np.full(len(time), 1e-3)
        rows.append(estimator.add_many(stamps, turned, along, turned > 0.03, depth))
    return np.concatenate(rows)


def test_a_sensor_that_is_not_level_does_not_bias_friction_beyond_its_deviation():
    """Slips in several directions tell the tilt."""
    off, far = [], 0
    for seed in range(8):
        angles = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, 6)
        estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
        last = tilted_pulls(estimator, 3.0, 0.5, angles, seed=seed)[-1]
        off.append(abs(last["friction"] / 0.5 - 1.0))
        far += abs(last["friction"] - 0.5) > 2.0 * last["friction_stddev"]
    assert np.median(off) < 0.04 and far <= 1


def test_what_a_tilt_makes_of_the_normal_force_is_no_slip():
    """Where nothing pulls, or a pull against the tilt is over, Q is in proportion to P."""
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    known = tilted_pulls(estimator, 5.0, 0.6, [0.0, math.pi])[-1]
    held = tilted_pulls(estimator, 5.0, 0.6, [math.pi, 3.0, 3.3], pulled=0.5, start=10**11)[-1]
    assert held["slips"] == known["slips"]
    assert held["friction"] == pytest.approx(0.6, rel=0.1)


@pytest.mark.parametrize("seconds", [0.03, 0.06])
def test_a_lateral_force_that_comes_late_teaches_no_friction_at_a_fast_release(seconds):
    """By 10 ms, of a pull that is held."""
    end = (2.0, 1.5), (2.0 + seconds, 0.0), (2.3, 0.0)
    normal = ramp((0, 0), (0.3, 1.5), *end)
    pull = np.roll(0.3 * ramp((0, 0), (0.5, 0), (1.2, 1.5), *end), 5)
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.002))
    friction = run(estimator, normal, pull)["friction"]
    assert friction[-1] == pytest.approx(friction[950], rel=0.05)


def test_the_tilt_of_a_sensor_is_kept_where_the_plate_changes():
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    tilted_pulls(estimator, 4.0, 0.6, [0.0, math.pi, 1.6, 4.7])
    estimator.change_surface()
    one = tilted_pulls(estimator, 4.0, 0.3, [math.pi], start=10**11)[-1]
    assert one["friction"] == pytest.approx(0.3, rel=0.05)
    estimator.reset()
    assert tilted_pulls(estimator, 4.0, 0.3, [math.pi])[-1]["friction"] < 0.27


def after_slips(count: int, normal: np.ndarray, lateral: np.ndarray, seed: int, share: float):
    """Rows of the given P and Q, of a hand that trembles by `share`, after slips at 0.5; and
    whether it slides there."""
    rng = np.random.default_rng(seed)
    _, before, pull, _ = slipping(count, 0.5)
    time = np.arange(len(before) + len(normal)) / RATE
    waves = 2 * np.pi * (rng.uniform(1.0, 10.0, (8, 1)) * time + rng.uniform(0.0, 1.0, (8, 1)))
    tremor = 1.0 + 0.5 * share * np.sin(waves).sum(axis=0)
    normal = np.append(before, normal) * tremor
    lateral = np.append(pull * tremor[: len(pull)], lateral)
    slides = lateral >= 0.5 * normal
    estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
    rows = run(estimator, *noisy(normal, np.minimum(lateral, 0.5 * normal), seed=seed))
    return rows[len(before) :], slides[len(before) :]


@pytest.mark.parametrize(("slips", "most"), [(0, 0.1), (2, 0.005)])
def test_a_held_thing_that_is_moved_up_and_down_does_not_slip(slips, most):
    """Each turn of Q looks still for a moment: chance must not get a new try there."""
    time = np.arange(0.0, 20.0, 1.0 / RATE)
    normal, load = np.interp(time, [0.4, 0.6], [0.0, 1.0]), np.interp(time, [0.8, 1.3], [0.0, 0.2])
    rise = np.interp(time, [17.0, 18.5], [0.0, 0.4])
    alarms, warned = [], []
    for seed in range(10):
        pull = load * (1.0 + 0.2 * np.sin(4 * np.pi * time + seed)) + rise
        rows, slides = after_slips(slips, normal, pull, seed, 0.03)
        alarm = rows["slip_probability"] > 0.15
        holds = (time > 1.5) & (time < 17.0)
        alarms.append(alarm[holds].mean())
        if slips:
            assert rows["friction"][holds][-1] == pytest.approx(0.5, rel=0.1)
        # A slip that comes then is foretold.
        onset = np.argmax(slides & (time > 17.0))
        warned.append(alarm[onset - 500 : onset - 10].any())
    assert np.mean(alarms) < most and all(warned)


@pytest.mark.parametrize("seconds", [1.5, 2.0, 3.0])
def test_a_grip_that_loosens_under_a_steady_load_is_foretold(seconds):
    time = np.arange(0.0, 1.3 + seconds, 1.0 / RATE)
    normal = np.interp(time, [0.4, 0.6, 1.3, 1.3 + seconds], [0.0, 1.0, 1.0, 0.0])
    pull = np.interp(time, [0.7, 1.1], [0.0, 0.2])
    for seed in range(8):
        rows, slides = after_slips(2, normal, pull, seed, 0.01)
        onset = np.argmax(slides & (time > 1.3))
        assert (rows["slip_probability"][onset - 100 : onset - 15] > 0.15).any(), seed


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_an_oblique_press_that_is_put_down_again_sticks(noise):
    """As in three dimensions, where all of it sticks at Q/P = 0.3 and friction 0.5."""
    normal = ramp((0.0, 0.05), (2.0, 1.0), (3.0, 0.1))
    forces = noise * np.random.default_rng(1).standard_normal((2, len(normal)))
    forces += normal, 0.3 * normal
    rows = run(SlipEstimator(SlipSettings(friction_prior=0.5, **KNOWN)), *forces)
    assert rows["stick_ratio"][500:].min() > 0.9
    assert rows["slip_probability"][500:].max() < 0.15  # Q falls with P


def test_what_is_pressed_obliquely_moves_as_in_three_dimensions():
    """Q/P = 0.3, up to 1 N and down to 0.1 N; the displacements (mm) are of SolidModel."""
    material = Material(E0=120e3, E1=120e3, tau1=0.002, E2=1.8e6, friction=0.5)
    force = np.append(np.arange(1.0, 9.0) / 8.0, 1.0 - 0.9 * np.arange(1.0, 9.0) / 8.0)
    contact = simulate_reduced(material, 0.05 * np.arange(1.0, 17.0), force, Geometry())
    found = pull_history(contact, 0.3 * force, Geometry(), material)
    assert found.stick_ratio.min() == 1.0
    up, down = found.tangential_displacement[[1, 3, 5, 7]], found.tangential_displacement[9::2]
    np.testing.assert_allclose(up * 1e3, [0.1367, 0.2464, 0.3500, 0.4500], rtol=0.09)
    np.testing.assert_allclose(down * 1e3, [0.3622, 0.2701, 0.1732, 0.0673], rtol=0.16)


def spoiled(normal, lateral, size, samples, q_size=0.0, value=None):
    """P and Q with wrong samples every half a second: `samples` in a row are `size` N larger, or
    have this value, Q is q_size N larger."""
    wrong = np.arange(len(normal)) % 250 >= 250 - samples
    other = normal + size if value is None else value
    return np.where(wrong, other, normal), lateral + q_size * wrong


SPIKES = [
    {"size": 0.0, "value": -1.0, "samples": 1},
    {"size": 0.0, "value": -1.0, "samples": 15},
    {"size": 0.0, "value": 0.0, "samples": 20},
    {"size": 2.0, "samples": 1},
    {"size": 2.0, "samples": 15},
    {"size": -0.6, "samples": 1},
    {"size": -0.6, "samples": 15},
    {"size": 0.0, "samples": 1, "q_size": 1.0},
    {"size": 0.0, "samples": 15, "q_size": 0.5},
    {"size": 0.0, "samples": 1, "value": math.nan},
]


@pytest.mark.parametrize("spike", SPIKES, ids=str)
def test_wrong_samples_in_a_contact_teach_nothing_and_hide_no_slip(spike):
    _, normal, lateral, slides = slipping(4, 0.5)
    forces = noisy(normal, lateral)
    settings = SlipSettings(tangential_noise=0.005)
    clean = run(SlipEstimator(settings), *forces)
    inside = normal > 0.9
    wrong = np.where(inside, spoiled(*forces, **spike), forces)
    rows = run(SlipEstimator(settings), *wrong)
    assert rows["slips"][-1] == clean["slips"][-1] == 4
    assert rows["friction"][-1] == pytest.approx(0.5, rel=0.03)
    assert rows["friction_stddev"][-1] == pytest.approx(clean["friction_stddev"][-1], rel=0.2)
    for begin in range(0, len(slides), 2000):
        one = slice(begin, begin + 2000)
        assert np.nanmax(rows["slip_probability"][one][slides[one]]) > 0.9


@pytest.mark.parametrize("size", [2.0, -2.0])
def test_wrong_samples_in_the_air_leave_friction_and_zero(size):
    time, normal, lateral, _ = slipping(3, 0.5)
    air = np.zeros(5000)
    forces = noisy(np.concatenate([normal, air]), np.concatenate([lateral, air]))
    forces = np.stack(forces) + np.array([[0.0], [0.1]])
    settings = SlipSettings(tangential_noise=0.005)
    clean = run(SlipEstimator(settings), *forces)
    once = np.arange(5000) % 100 == 50
    forces[:, len(time) :] += size * once
    estimator = SlipEstimator(settings)
    rows = run(estimator, *forces)
    for name in ("friction", "friction_stddev", "slips"):
        assert rows[name][-1] == pytest.approx(clean[name][-1], rel=1e-3)
    held = np.concatenate([np.full(200, 0.0), np.interp(np.arange(800), [0, 150], [0.0, 1.0])])
    pulled = np.interp(np.arange(1000), [400, 600], [0.0, 0.25])
    last = run(estimator, held, pulled + 0.1, int(1e9 * len(forces[0]) / RATE))[-1]
    assert last["slip_margin"] == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize(("normal_after", "lateral_after"), [(0.3, 0.25), (1.0, 0.6), (0.0, 0.0)])
def test_a_real_jump_is_told_within_three_samples(normal_after, lateral_after):
    """Of 0.25 N held at 1 N, with a friction of 0.5 that is known."""
    _, normal, lateral, _ = slipping(3, 0.5)
    held = np.interp(np.arange(2000), [250, 400], [0.0, 1.0])
    pulled = np.interp(np.arange(2000), [500, 700], [0.0, 0.25])
    held[1000:], pulled[1000:] = normal_after, lateral_after
    forces = noisy(np.concatenate([normal, held]), np.concatenate([lateral, pulled]))
    rows = run(SlipEstimator(SlipSettings(tangential_noise=0.005)), *forces)[len(normal) + 1000 :]
    if normal_after == 0.0:
        assert (rows["flags"] & SlipFlag.NO_CONTACT).all()
    else:
        assert rows["slip_probability"][2] > 0.15
        assert rows["slip_probability"][3:20].min() > 0.9


@pytest.mark.parametrize(("hz", "share"), [(20, 0.15), (30, 0.2), (50, 0.15)])
def test_a_grip_that_trembles_shows_its_slips(hz, share):
    time, normal, lateral, slides = slipping(4, 0.5)
    swing = 1.0 + share * np.sin(2.0 * np.pi * hz * time)
    forces = noisy(normal * swing, np.minimum(lateral, 0.5 * normal * swing))
    rows = run(SlipEstimator(SlipSettings(tangential_noise=0.005)), *forces)
    assert rows["slips"][-1] == 4
    assert np.mean(rows["slip_probability"][slides] > 0.15) > 0.5


@pytest.mark.parametrize("lasts", [0.01, 0.02, 0.04])
@pytest.mark.parametrize(("up", "aside"), [(1.0, 0.3), (5.0, 1.5), (0.0, 0.2)])
def test_knocks_on_what_is_held_are_no_slips(lasts, up, aside):
    """Half-sine knocks every 0.4 s on 0.25 N that are held at 1 N, with a friction of 0.5."""
    _, normal, lateral, _ = slipping(3, 0.5)
    time = np.arange(2000) / RATE
    held = np.interp(time, [0.3, 0.5, 3.9, 4.0], [0.0, 1.0, 1.0, 0.0])
    since = time % 0.4 - 0.2
    knock = np.where((since > 0.0) & (since < lasts), np.sin(np.pi * since / lasts), 0.0)
    knock[(time < 0.8) | (time > 3.9)] = 0.0
    forces = noisy(
        np.concatenate([normal, held + up * knock]),
        np.concatenate([lateral, 0.25 * held + aside * knock]),
    )
    rows = run(SlipEstimator(SlipSettings(tangential_noise=0.005)), *forces)
    assert rows["slips"][-1] == rows["slips"][len(normal) - 1] == 3
    assert rows["friction"][-1] == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("gap", [0.01, 0.02, 0.04])
def test_a_second_contact_soon_after_the_first_is_another_one(gap):
    """Held at a ratio of 0.35, let go, and held at 0.1: no slip."""
    _, normal, lateral, _ = slipping(3, 0.5)
    time = np.arange(2000) / RATE
    again = 1.53 + gap
    knots = [0.5, 0.52, 1.5, 1.53, again, again + 0.03, 3.0, 3.02]
    held = np.interp(time, knots, [0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0])
    pulled = np.where(time < 1.53 + 0.5 * gap, 0.35, 0.1) * held
    forces = noisy(np.concatenate([normal, held]), np.concatenate([lateral, pulled]))
    rows = run(SlipEstimator(SlipSettings(tangential_noise=0.005)), *forces)
    assert rows["slips"][-1] == rows["slips"][len(normal) - 1] == 3
    assert rows["friction"][-1] == pytest.approx(0.5, rel=0.05)
