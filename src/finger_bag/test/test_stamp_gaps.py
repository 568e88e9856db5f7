# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Stamps that are missing: counted where messages are lost, and only there."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from finger_bag.stamp_gaps import StampGaps

PERIOD = 2_000_000
"""ns"""


def counted(stamps: Iterable[float], arrivals: Iterable[float] | None = None) -> StampGaps:
    gaps, stamps = StampGaps(), [int(s) for s in stamps]
    for stamp, arrival in zip(stamps, (s * 1e-9 for s in stamps) if arrivals is None else arrivals):
        gaps.add(stamp, float(arrival))
    return gaps


def test_gaps_between_stamps_are_counted() -> None:
    rng = np.random.default_rng(3)
    present = [i for i in range(5000) if i not in (10, 700, 701, 702, 3000)]
    stamps = [i * PERIOD + int(rng.normal(0, 100_000)) for i in present]
    gaps = counted([*stamps, present[-1] * PERIOD, stamps[-1]])
    assert (gaps.missing, gaps.clock_steps) == (5, 0)


@pytest.mark.parametrize("burst", [50, 100])
def test_a_burst_at_the_start_is_not_the_period(burst: int) -> None:
    """24,292 samples without a gap, of which the first came in a burst: 125,219 were "missing"."""
    first = np.arange(burst) * PERIOD / 6
    rest = first[-1] + PERIOD * np.arange(1, 24_292 - burst)
    assert counted([*first, *rest]).missing == 0


def test_what_a_driver_catches_up_is_not_missing() -> None:
    """A stall of 5 periods, then the polls that it delayed without pause."""
    stamps = [0.0]
    for number in range(3000):
        if number % 100 == 99:
            stamps.append(stamps[-1] + 5 * PERIOD)
            stamps += [stamps[-1] + 0.2 * PERIOD * k for k in (1, 2, 3, 4, 5)]
        stamps.append(stamps[-1] + PERIOD)
    assert counted(stamps).missing == 0
    # A longer stall, of which only four polls are made up for.
    stamps += list(stamps[-1] + PERIOD * np.array([20.2, 20.4, 20.6, 20.8, 22.0]))
    assert counted(stamps).missing == 17


def test_a_rate_that_changes_is_followed() -> None:
    slow = PERIOD * 5 * np.arange(1, 4000)
    assert counted(slow).missing == 0
    # Taken for gaps until the new rate has prevailed, not for ever.
    assert counted([*np.arange(2000) * PERIOD, *(2000 * PERIOD + slow)]).missing <= 4 * 750


@pytest.mark.parametrize("step", [3600.0, -3600.0, 1.5])
def test_a_stepped_clock_of_the_stamps_misses_nothing(step: float) -> None:
    times = np.arange(4000) * PERIOD * 1e-9
    stamps = (times + np.where(times > 2, step, 0)) * 1e9 + 1e14
    gaps = counted(stamps, times)
    assert (gaps.missing, gaps.clock_steps) == (0, 1)


def test_a_silence_is_missing_however_late_it_is_noticed() -> None:
    present = np.array([i for i in range(6000) if not 2000 <= i < 4000])
    gaps = counted(present * PERIOD)
    assert (gaps.missing, gaps.clock_steps) == (2000, 0)
