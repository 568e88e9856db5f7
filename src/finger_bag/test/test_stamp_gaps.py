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


def counted(
    stamps: Iterable[float], arrivals: Iterable[float] | None = None, rate: float = 0.0
) -> StampGaps:
    gaps, stamps = StampGaps(rate), [int(s) for s in stamps]
    for stamp, arrival in zip(stamps, (s * 1e-9 for s in stamps) if arrivals is None else arrivals):
        gaps.add(stamp, float(arrival))
    return gaps


def test_gaps_between_stamps_are_counted() -> None:
    rng = np.random.default_rng(3)
    present = [i for i in range(5000) if i not in (10, 700, 701, 702, 3000)]
    stamps = [i * PERIOD + int(rng.normal(0, 100_000)) for i in present]
    gaps = counted([*stamps, present[-1] * PERIOD, stamps[-1]])
    assert gaps.missing == 5


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
    assert counted(stamps, times).missing == 0


def test_a_silence_is_missing_however_late_it_is_noticed() -> None:
    present = np.array([i for i in range(6000) if not 2000 <= i < 4000])
    assert counted(present * PERIOD).missing == 2000


def polled(count: int, free: float, held: float, exchange: float = 0.2) -> tuple[list[float], int]:
    """Stamps (ns) of a driver that polls on a schedule, catches up five polls and leaves out what
    is older, and how many it left out. It runs for about `free` periods, and is held for about
    `held` ones."""
    rng = np.random.default_rng(1)
    now = due = 0.0
    stop, stamps, left_out = rng.exponential(free), [], 0
    while len(stamps) < count:
        now = max(now, due)
        if now > stop:
            now += rng.exponential(held)
            stop = now + rng.exponential(free)
        if now - due > 5:
            skipped = int(now - due)
            left_out += skipped
            due += skipped
        due += 1
        stamps.append(now * PERIOD + 1e9)
        now += exchange
    return stamps, left_out


@pytest.mark.parametrize(("free", "held"), [(50.0, 3.0), (8.0, 12.0), (4.0, 12.0), (3.0, 30.0)])
def test_what_a_driver_leaves_out_that_does_not_keep_up_is_counted(
    free: float, held: float
) -> None:
    stamps, left_out = polled(6000, free, held)
    assert counted(stamps, rate=500.0).missing == pytest.approx(left_out, rel=0.03, abs=3)
    # A long gap counts fully beside them.
    stamps = [s + 3500 * PERIOD * (k >= 3000) for k, s in enumerate(stamps)]
    found = counted(stamps, rate=500.0).missing
    assert found == pytest.approx(left_out + 3500, rel=0.03)


def test_a_stream_that_is_slowed_does_not_hide_its_gaps() -> None:
    """Most steps are gaps: by their median, one of 3,500 messages was one of 1,400."""
    steps = np.tile([2.5, 1.0, 2.5, 0.5, 2.5], 1200)
    missing = round(float((steps - 1).sum())) + 3500
    steps[3000] += 3500
    assert counted(1e9 + PERIOD * np.cumsum(steps), rate=500.0).missing == pytest.approx(
        missing, abs=3
    )


def test_late_messages_that_the_next_ones_make_up_for_are_not_missing() -> None:
    """A busy machine's: 58 of these were "missing"."""
    rng = np.random.default_rng(2)
    late = np.where(rng.random(4000) < 0.3, rng.exponential(0.8, 4000), 0.0)
    stamps = np.maximum.accumulate((np.arange(4000) + late) * PERIOD) + 1000 * np.arange(4000)
    assert counted(stamps).missing == 0


@pytest.mark.parametrize("rate", [200.0, 250.0, 1000.0])
def test_another_rate_than_expected_is_that_of_the_stream(rate: float) -> None:
    rng = np.random.default_rng(4)
    stamps = (np.arange(4000) + rng.normal(0, 0.05, 4000)) * 1e9 / rate
    assert counted(stamps, rate=500.0).missing == 0
    assert counted([*stamps[:2000], *stamps[2007:]], rate=500.0).missing == 7


@pytest.mark.parametrize("rate", [476.0, 450.0, 420.0, 400.0, 390.0, 300.0])
def test_rounded_stamps_miss_nothing(rate: float) -> None:
    """Stamps in whole milliseconds: 1,999 of 8,000 at 400 Hz were "missing"."""
    stamps = np.floor(np.arange(8000) * 1000 / rate) * 1e6
    assert counted(stamps).missing == counted(stamps, rate=500.0).missing == 0


@pytest.mark.parametrize("rates", [(10.0, 9.0), (10.0, 8.0), (500.0, 450.0, 500.0)])
def test_a_rate_that_changes_a_little_misses_nothing(rates: tuple[float, ...]) -> None:
    """Of a camera whose exposure changes: 146 of 2,000 were "missing"."""
    steps = np.concatenate([np.full(1000, 1e9 / rate) for rate in rates])
    assert counted(np.cumsum(steps)).missing == 0
