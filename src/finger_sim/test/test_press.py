# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated hand presses like the participant of the paper."""

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_model.paper import TARGET_FORCE
from finger_sim.press import PressStyle, plan_press

PRESSES = [plan_press(np.random.default_rng(seed)) for seed in range(200)]


def test_same_seed_gives_the_same_press_and_another_seed_another() -> None:
    one, two = (plan_press(np.random.default_rng(7)) for _ in range(2))
    assert np.array_equal(one.time, two.time) and np.array_equal(one.force, two.force)
    other = plan_press(np.random.default_rng(8))
    assert len(other.force) != len(one.force) or not np.allclose(other.force, one.force)


def test_force_is_zero_before_onset_and_after_lift_off_and_never_negative() -> None:
    for press in PRESSES:
        assert np.all(press.force >= 0)
        assert np.all(press.force[press.time <= press.onset] == 0)
        assert np.all(press.force[press.time > press.lift_off + 2e-3] == 0)
        assert press.force[-1] == 0 and press.time[0] == 0


def test_cue_is_the_first_sample_at_the_target_and_the_hand_overshoots() -> None:
    overshoots = []
    for press in PRESSES:
        at_cue = np.searchsorted(press.time, press.cue)
        assert press.force[at_cue] >= TARGET_FORCE
        assert np.all(press.force[:at_cue] < TARGET_FORCE)
        assert press.onset < press.cue < press.release < press.lift_off
        overshoots.append(press.force.max() / TARGET_FORCE - 1)
    assert 0.05 < np.median(overshoots) < 0.25
    assert min(overshoots) >= 0 and max(overshoots) < 0.8


def test_time_to_target_spans_the_half_to_two_seconds_of_the_paper() -> None:
    ramps = np.array([p.cue - p.onset for p in PRESSES])
    assert ramps.min() > 0.4 and ramps.max() < 2.2
    assert ramps.min() < 0.65 and ramps.max() > 1.85


def test_tremor_lies_at_8_to_12_hz() -> None:
    """Held force: power above the drift peaks in the tremor band and is 1.5 % of the force."""
    style = PressStyle(ramp=(1.0, 1.0), hold=(8.0, 8.0), drift=0.0)
    press = plan_press(np.random.default_rng(1), style)
    held = press.force[(press.time > press.cue + 0.5) & (press.time < press.release - 0.1)]
    held = held / held.mean() - 1
    power = np.abs(np.fft.rfft(held * np.hanning(len(held)))) ** 2
    frequency = np.fft.rfftfreq(len(held), 1 / 500)
    band = (frequency > 7.5) & (frequency < 12.5)
    assert power[band].sum() > 0.98 * power[1:].sum()
    assert held.std() == pytest.approx(style.tremor, rel=0.25)


def test_without_fluctuation_the_ramp_reaches_the_target_in_the_given_time() -> None:
    style = PressStyle(ramp=(0.8, 0.8), shape=(1.0, 1.0), tremor=0.0, drift=0.0)
    press = plan_press(np.random.default_rng(1), style)
    assert press.cue - press.onset == pytest.approx(0.8, abs=2e-3)
    middle = np.interp(press.onset + 0.4, press.time, press.force)
    assert middle == pytest.approx(TARGET_FORCE / 2, rel=1e-9)


def test_force_has_no_jumps() -> None:
    """No step larger than the fastest release could make in a sample."""
    for press in PRESSES:
        fastest = np.pi / 2 * press.force.max() / (press.lift_off - press.release) / 500
        assert np.abs(np.diff(press.force)).max() < 1.5 * max(fastest, 0.012)


def test_a_press_without_duration_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="ramp is 0 s"):
        plan_press(np.random.default_rng(0), PressStyle(ramp=(0.0, 0.0)))
