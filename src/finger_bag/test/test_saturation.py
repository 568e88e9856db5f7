# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A force that stays at its largest value: of a sensor at the end of its range, or in a hold."""

from __future__ import annotations

import numpy as np
import pytest

from finger_bag.validate import saturations

RATE = 500.0
NANO17 = 1 / 171
"""N, its resolution."""

TIME = np.arange(0.0, 4.0, 1.0 / RATE)
HOLD = np.interp(TIME, [0.5, 1.0, 3.0, 3.2], [0.0, 1.2, 1.2, 0.0])


def noisy(force: np.ndarray, deviation: float) -> np.ndarray:
    return force + np.random.default_rng(0).normal(0.0, deviation, len(force))


def found(force: np.ndarray) -> list[bool]:
    return [at.coarse for at in saturations((TIME * 1e9).astype(np.int64), force)]


@pytest.mark.parametrize("deviation", [1e-3, 2e-3, 5e-3])
def test_a_sensor_at_the_end_of_its_range_is_no_hold(deviation: float) -> None:
    """A press of 2.4 N with a sensor of 2 N."""
    assert found(np.minimum(noisy(2.0 * HOLD, deviation), 2.0)) == [False]


def test_rounding_that_noise_exceeds_hides_no_saturation() -> None:
    force = np.round(noisy(2.0 * HOLD, 0.6 * NANO17) / NANO17) * NANO17
    assert found(np.minimum(force, 342 * NANO17)) == [False]


@pytest.mark.parametrize(
    "force",
    [
        np.round(noisy(HOLD, 1e-3), 2),
        np.round(noisy(HOLD, 1e-3), 2).astype(np.float32).astype(float),
        -np.round(noisy(HOLD, 1e-3), 2),
        HOLD,
        np.clip(2.4 * HOLD, 0.0, 1.5),
        np.round(noisy(HOLD, 0.3e-3) / NANO17) * NANO17,
        np.round(noisy(HOLD, 0.5e-3) / NANO17) * NANO17,
        np.round(noisy(HOLD, 0.5e-3) / NANO17 + 0.45) * NANO17,
    ],
    ids="hundredths singles negative noiseless clipped quiet_nano17 nano17 between".split(),
)
def test_a_quiet_hold_is_no_saturated_sensor(force: np.ndarray) -> None:
    coarse = found(force)
    assert coarse and all(coarse)
