# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Creep of the skin is no lag of the clocks."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_model.reduced import ReducedModel
from finger_offline.lag import force_image_lag, lag_change, press_lags


def presses(
    lag: float, parameters: np.ndarray | None, number: int = 4, stronger: float = 1.0
) -> list[Any]:
    """Presses of 0.6 to 1.8 s with areas at 10 Hz that come late; None: a finger without creep.

    stronger: factor of force and moduli.
    """
    rng = np.random.default_rng(0)
    model = ReducedModel.load()
    found = []
    for k in range(number):
        rise = 0.6 + 0.4 * k
        time, frames = np.arange(0, rise + 1.2, 0.002), np.arange(0, rise + 1.2, 0.1)
        force = 1.5 * np.clip(np.minimum((time - 0.4) / rise, (rise + 0.75 - time) / 0.35), 0, 1)
        if parameters is None:
            area = 60e-6 * force**0.4
        else:
            area = model.batch(parameters[None], [(time, force, np.arange(len(time)))])[0][0]
        seen = np.interp(frames - lag, time, area)
        seen = np.where(seen > 0, np.maximum(seen + rng.normal(0, 1.5e-6, len(frames)), 0), 0)
        found.append(
            SimpleNamespace(
                stamp_ns=(time * 1e9).astype(np.int64),
                force=stronger * force,
                area_stamp_ns=(frames * 1e9).astype(np.int64),
                area=seen,
            )
        )
    return found


@pytest.mark.parametrize("lag", [0.0, 0.08, -0.08, 0.15])
def test_the_lag_of_the_clocks_is_found_whether_or_not_the_skin_creeps(lag: float) -> None:
    natural = ReducedModel.load().space.default
    slow = natural * [1.0, 0.8, 2.5, 1.0]
    for parameters in (None, natural, natural * [1.0, 0.7, 0.3, 0.6], slow):
        assert force_image_lag(presses(lag, parameters)) == pytest.approx(lag, abs=0.03)


def test_presses_beyond_the_range_of_the_model_tell_the_lag_too() -> None:
    """As to 9 N: force over stiffness is all that counts."""
    natural = ReducedModel.load().space.default
    found = force_image_lag(presses(0.08, natural, stronger=6.0))
    assert found == pytest.approx(0.08, abs=0.03)


def test_one_press_tells_a_lag_that_is_noted_from_none() -> None:
    natural = ReducedModel.load().space.default
    for lag in (0.0, 0.15):
        assert force_image_lag(presses(lag, natural, 1)) == pytest.approx(lag, abs=0.05)


def test_without_a_press_the_lag_is_unknown() -> None:
    assert force_image_lag([]) is None
    flat = presses(0.0, None, 1)
    flat[0].force = np.full(len(flat[0].stamp_ns), 1.0)
    assert force_image_lag(flat) is None
    press = presses(0.0, None, 1)[0]
    (few,) = presses(0.0, None, 1)
    few.area_stamp_ns, few.area = press.area_stamp_ns[:5], press.area[:5]
    assert force_image_lag([few]) is None


AT = np.array([[1.0 + 4.0 * k, 3.0 + 4.0 * k + 0.3 * (k % 3)] for k in range(8)])
"""Begin and end of presses (s)."""


def frames_of(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames at 15 Hz of presses at other times, and their areas."""
    time = np.arange(0.0, at.max() + 2.0, 1 / 15)
    inside = [(time >= low) & (time <= high) for low, high in at]
    return time, np.where(np.any(inside, axis=0), 60e-6, 0.0)


@pytest.mark.parametrize("rate", [1.03, 0.5])
def test_a_clock_of_another_rate_is_told(rate: float) -> None:
    lags = press_lags(AT, *frames_of(AT * rate))
    assert lags is not None
    found = lag_change(AT, lags, 1 / 15)
    words = re.search(r"the lag (grows|falls) by (\d+) ms a second", found)
    assert words is not None and words[1] == ("grows" if rate > 1 else "falls")
    assert int(words[2]) == pytest.approx(1e3 * abs(rate - 1), rel=0.15)


def test_frames_that_are_missing_are_told_by_their_press() -> None:
    moved = AT - np.where(np.arange(8) > 3, 1.0, 0.0)[:, None]
    lags = press_lags(AT, *frames_of(moved))
    assert lags is not None
    assert "jumps by -1.0" in (found := lag_change(AT, lags, 1 / 15)) and "press 3" in found


def test_two_presses_tell_a_gross_change_alone() -> None:
    assert "in the last" in lag_change(AT[:2], np.array([-0.5, -2.5]), 1 / 30)
    assert lag_change(AT[:2], np.array([0.2, 0.5]), 1 / 30) == ""


def test_presses_of_many_durations_have_one_lag() -> None:
    rng = np.random.default_rng(0)
    for number in (4, 6, 8):
        told = [
            lag_change(AT[:number], rng.normal(0.3, 0.15, number), 1 / 15) != "" for _ in range(200)
        ]
        assert sum(told) <= 2, number
    assert press_lags(AT, *frames_of(AT[:5])) is None
