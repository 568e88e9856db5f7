# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Clocks, stamps and tare: accuracy in physical units."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from finger_common.errors import DeviceError
from finger_common.host_clock import HostClock
from finger_driver.clock import ClockMapper, IncreasingStamps
from finger_driver.force.source import GOOD, SATURATED, ForceSource, WrenchSample
from finger_driver.tare import AGAIN, FarTares, TareCollector


@pytest.mark.parametrize("drift", [0.0, 50e-6, -120e-6])
def test_a_device_clock_is_mapped_to_a_tenth_of_the_jitter(drift: float) -> None:
    """500 Hz for 40 s; receipt late by 0.3 ms and exponential jitter of 1 ms, as over a network."""
    random = np.random.default_rng(7)
    mapper = ClockMapper(1e7)
    start = 1_700_000_000_000_000_000
    errors = []
    last = 0
    for index in range(20_000):
        true_time = index * 0.002
        ticks = round(true_time / (1 + drift) * 1e7) + 12345
        received = start + round((true_time + 0.0003 + random.exponential(0.001)) * 1e9)
        stamp = mapper.update(ticks, received)
        assert last < stamp <= received
        last = stamp
        errors.append((stamp - start) * 1e-9 - true_time - 0.0003)
    assert mapper.drift == pytest.approx(drift, abs=5e-6)
    assert np.abs(errors[10_000:]).max() < 1e-4
    assert mapper.jitter == pytest.approx(0.001, rel=0.3)


@pytest.mark.parametrize("late", [(0.0, 1.5), (0.0, 3.0), (6.0, 8.5)])
def test_a_computer_that_is_late_for_a_while_does_not_bend_the_clock(
    late: tuple[float, float],
) -> None:
    """Frames at 10 Hz wait 0.35 s in the queue of a camera, at the start or later."""
    random = np.random.default_rng(1)
    mapper = ClockMapper(1e7)
    start, errors = 1_700_000_000_000_000_000, []
    for index in range(600):
        true = 0.1 * index
        delay = 0.004 + random.exponential(0.001) + (0.35 if late[0] <= true < late[1] else 0.0)
        stamp = mapper.update(round(true * (1 - 40e-6) * 1e7), start + round((true + delay) * 1e9))
        errors.append((stamp - start) * 1e-9 - true - 0.004)
    # At the start nothing else is known until the queue is empty, and stamps never go back.
    after = np.abs(errors)[int(10 * late[1]) + 4 :]
    assert after.max() < 0.005
    assert after[100:].max() < 0.002


def test_a_device_of_another_rate_is_still_found_out() -> None:
    """It sends 1 % slower than it states."""
    mapper = ClockMapper(500.0)
    for index in range(10_000):
        mapper.update(index, 10**18 + round(index * 0.002 * 1.01 * 1e9))
    assert mapper.drift == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize("slow", [0.005, 0.02, 0.05])
def test_a_device_of_another_rate_is_found_out_before_its_stamps_lag(slow: float) -> None:
    """Records at 500 Hz as stated, received with a jitter of 0.2 ms, as of a Net F/T."""
    random = np.random.default_rng(3)
    mapper, lag = ClockMapper(500.0, block=0.25, blocks=120), []
    for index in range(6000):
        received = 10**18 + round((index * 0.002 * (1 + slow) + random.exponential(2e-4)) * 1e9)
        lag.append((received - mapper.update(index, received)) * 1e-9)
    # Three blocks have to pass.
    assert max(lag) < 0.002 + 0.8 * slow
    assert max(lag[1000:]) < 0.005
    assert mapper.drift == pytest.approx(slow, rel=0.02)


def test_blocks_that_are_late_one_after_the_other_are_no_other_rate() -> None:
    mapper = ClockMapper(500.0, block=0.25, blocks=120)
    for index in range(3500):
        late = 0.005 * (index >= 300) + 0.02 * (index >= 900)
        stamp = mapper.update(index, 10**18 + index * 2_000_000 + round(late * 1e9))
        assert stamp - 10**18 - index * 2_000_000 < 0.001e9
    assert abs(mapper.drift) < 1e-4


@pytest.mark.parametrize("jump", [0.03, 2.0, 100.0])
def test_a_device_clock_that_jumps_forward_is_mapped_anew(jump: float) -> None:
    """Frames at 10 Hz, received 3 ms late with a jitter of 0.5 ms; the clock jumps after 20 s."""
    random = np.random.default_rng(1)
    mapper, errors, start = ClockMapper(1e7), [], 1_700_000_000_000_000_000
    for index in range(600):
        true = 0.1 * index
        received = start + round((true + 0.003 + random.exponential(5e-4)) * 1e9)
        stamp = mapper.update(round((true + (jump if true >= 20 else 0.0)) * 1e7), received)
        assert stamp <= received
        errors.append((stamp - start) * 1e-9 - true - 0.003)
    assert np.abs(errors).max() < 0.005
    assert mapper.jumps == 1 and abs(mapper.drift) < 2e-5


def test_one_wrong_time_of_receipt_does_not_move_the_mapping() -> None:
    """Nor does another one later."""
    mapper, start = ClockMapper(500.0), 10**18
    for index in range(5000):
        true, wrong = start + index * 2_000_000, index in (3000, 4200)
        stamp = mapper.update(index, true - 10**9 if wrong else true + 300_000)
        # The one itself is stamped as early as stamps that increase allow.
        assert abs(stamp - true) < (2_000_000 if wrong else 300_001)
    assert mapper.jumps == 0


def test_stamps_of_a_device_of_another_rate_are_times_of_receipt() -> None:
    mapper, random = ClockMapper(500.0, block=0.25, blocks=120), np.random.default_rng(3)
    for index in range(3000):
        received = 10**18 + round((index * 0.002 * 1.02 + random.exponential(2e-4)) * 1e9)
        stamp = mapper.update(index, received)
        assert not mapper.another_rate or stamp == received
    assert mapper.another_rate


def test_a_device_clock_that_starts_again_is_mapped_anew() -> None:
    mapper = ClockMapper(1000.0)
    for index in range(5000):
        mapper.update(index, 10**18 + index * 1_000_000)
    stamp = mapper.update(3, 10**18 + 9_000_000_000)
    assert stamp == 10**18 + 9_000_000_000


def test_host_time_does_not_follow_a_step_of_the_wall_clock() -> None:
    wall, steady = [10**18], [0]
    clock = HostClock(lambda: wall[0], lambda: steady[0])
    steady[0] += 1_000_000_000
    wall[0] += 1_000_000_000 - 3600_000_000_000
    assert clock.now() == 10**18 + 1_000_000_000
    assert clock.step() == pytest.approx(-3600)
    assert clock.of_wall(wall[0] - 7) == clock.now() - 7
    assert "suspended" not in clock.step_warning("stamps")
    wall[0] += 2 * 3600_000_000_000
    assert clock.of_wall(wall[0] + 7) == clock.now() + 7
    assert "+3600.000 s or the computer was suspended" in clock.step_warning("stamps")


def test_a_busy_machine_is_no_step_of_the_clock() -> None:
    """Another program runs between two readings."""
    steady = [0]

    def late() -> int:
        steady[0] += 200_000_000
        return steady[0]

    clock = HostClock(lambda: 10**18 + steady[0], late)
    clock._offset = 10**18
    assert clock.step() == 0.0 and clock.of_wall(5) == 5


def test_only_later_stamps_pass() -> None:
    stamps = IncreasingStamps()
    assert [stamps.accept(s) for s in (5, 6, 6, 4, 7)] == [True, True, False, False, True]


class Direct(ForceSource):
    def __init__(self) -> None:
        pass


def collect(
    force: Callable[[float], float], noise: float = 0.005, quality: int = GOOD
) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    collector = TareCollector(0.5, 0.05, 0.002)
    for index in range(10_000):
        time = index * 0.002
        wrench = np.array([0, 0, force(time), 0, 0, 0]) + noise * random.standard_normal(6)
        wrench[3:] *= 0.01
        sample = WrenchSample(index * 2_000_000, wrench[:3], wrench[3:], wrench, 0, quality)
        if collector.add(sample):
            break
    return collector.result(Direct())


def test_tare_of_a_still_signal_finds_its_mean() -> None:
    bias, offset = collect(lambda t: -1.7)
    # 251 samples of 5 mN noise: the mean is good to 0.32 mN (one standard deviation).
    assert offset[2] == pytest.approx(-1.7, abs=0.0013)
    np.testing.assert_array_equal(bias, offset)


@pytest.mark.parametrize(
    "force",
    [lambda t: 0.3 * t, lambda t: 0.1 * np.sin(2 * np.pi * 3 * t), lambda t: float(t > 0.3)],
    ids=["ramp", "tremor", "touch"],
)
def test_tare_of_a_moving_signal_is_refused(force: Callable[[float], float]) -> None:
    with pytest.raises(DeviceError, match="moved by up to"):
        collect(force)


def test_tare_of_a_moving_torque_is_refused_though_the_force_is_still() -> None:
    collector = TareCollector(0.5, 0.05, 0.002)
    for index in range(251):
        torque = 0.01 * index / 250
        collector.add(WrenchSample.of_wrench(2_000_000 * index, np.array([0, 0, 0, torque, 0, 0])))
    with pytest.raises(DeviceError, match=r"moved by up to 0 N and 0\.009"):
        collector.result(Direct())


def test_tare_of_a_fraction_of_its_time_is_refused() -> None:
    """A stream that ends, or pauses, says nothing of the time that was asked for."""
    for stamps in (range(20), [*range(20), 5000]):
        collector = TareCollector(10.0, 0.05, 0.002)
        for k in stamps:
            collector.add(WrenchSample.of_wrench(2_000_000 * k, np.zeros(6)))
        with pytest.raises(DeviceError, match="of 10 s only"):
            collector.result(Direct())


def test_tare_is_refused_while_the_sensor_reports_faults() -> None:
    with pytest.raises(DeviceError, match="faults"):
        collect(lambda t: 0.0, quality=SATURATED)


def test_a_tare_far_from_the_one_in_force_is_taken_when_it_is_asked_for_again() -> None:
    now = 0.0
    tares = FarTares(lambda: now)
    held = np.array([0.3, 0.0, -1.0])
    tares.check(np.array([0.05, 0.0, 0.1]), 0.2)  # an ordinary drift
    with pytest.raises(DeviceError, match=r"moved by 1\.04 N since the last tare.* within 30 s"):
        tares.check(held, 0.2)
    now += 1.0
    with pytest.raises(DeviceError, match=r"moved by 1\.53 N"):
        tares.check(held - [0.0, 0.0, 0.5], 0.2)  # it is not what was refused
    now += AGAIN + 1.0
    with pytest.raises(DeviceError, match="moved"):
        tares.check(held, 0.2)  # long after
    now += AGAIN - 1.0
    tares.check(held + 0.02, 0.2)  # on purpose
    with pytest.raises(DeviceError, match="moved"):
        tares.check(held, 0.2)  # one confirmation serves one tare
    tares.check(np.zeros(3), 0.2)
    with pytest.raises(DeviceError, match="moved"):
        tares.check(held, 0.2)  # one that was taken between
