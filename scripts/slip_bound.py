# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What force alone can tell of the first slip: an ideal observer of the pulls of `slip_study`.

    python scripts/slip_bound.py [--fingers 200]

prints, for each price of a missed slip, the share of slips announced and of pulls with a false
alarm, as `slip_study.py` counts them, and the error of the stick ratio before the first slip.

The observer has no noise and no delay. It knows how the study draws friction, times and stops, and
the rate of |Q|/P; not the friction itself. As long as a finger has not slipped, force tells of it
only that friction is above the largest ratio carried. So its best rule is to give the alarm at a
ratio that is chosen when the pull begins. After the first slip it is taken to make no mistake.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from slip_study import AHEAD, FALSE_RATIO, FALSE_TIME, FRICTIONS, PULLS, RISES, SLIPS, STOPS

from finger_model.slip import backbone

FRICTION = np.geomspace(*FRICTIONS, 200)
PRICES = 0.3, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5
"""Of a missed slip, in false alarms."""


def belief(rate: float, carried: float) -> np.ndarray:
    """Weights of FRICTION when |Q|/P rises at a rate (1/s) and `carried` was carried before."""
    rise = FRICTION / rate
    weight = ((rise >= RISES[0]) & (rise <= RISES[1]) & (carried < FRICTION)).astype(float)
    return weight / weight.sum()


def mistakes(rate: float, carried: float, alarms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities of a missed slip and of a false alarm for alarms (n,) at ratios |Q|/P."""
    weight, alarm = belief(rate, carried), alarms[:, None]
    left = (FRICTION - alarm) / rate
    early = (left > FALSE_TIME) & (alarm < FALSE_RATIO * FRICTION)
    reached = np.clip((STOPS[1] - alarm / FRICTION) / (STOPS[1] - STOPS[0]), 0.0, 1.0)
    missed = SLIPS * (left < AHEAD)
    false = early * (SLIPS + (1.0 - SLIPS) * reached)
    return missed @ weight, false @ weight


def stick_error(friction: float, rate: float, carried: float, end: float) -> float:
    """Mean square error of the best estimate of the stick ratio along a pull to a ratio `end`."""
    squares = []
    for ratio in np.linspace(0.0, 0.999 * end, 25):
        weight = belief(rate, max(carried, ratio))
        best = weight @ backbone.stick_ratio(ratio / FRICTION)
        squares.append((best - float(backbone.stick_ratio(ratio / friction))) ** 2)
    return float(np.mean(squares))


def observe(fingers: int, price: float) -> dict[str, float]:
    """Figures over fingers of PULLS pulls."""
    rng = np.random.default_rng(1)
    alarms = np.concatenate([[0.0], np.geomspace(0.02, 1.19, 90)])
    announced: list[bool] = []
    errors: list[float] = []
    false, later = 0, 0
    for _ in range(fingers):
        friction = math.exp(rng.uniform(*np.log(FRICTIONS)))
        carried, known = 0.0, False
        for _ in range(PULLS):
            rise = math.exp(rng.uniform(*np.log(RISES)))
            slips = bool(rng.random() < SLIPS)
            end = friction * (1.0 if slips else rng.uniform(*STOPS))
            if known:
                later += slips
                continue
            rate = friction / rise
            missed, early = mistakes(rate, carried, alarms)
            alarm = float(alarms[np.argmin(price * missed + early)])
            left = (friction - alarm) / rate
            false += end > alarm and left > FALSE_TIME and alarm < FALSE_RATIO * friction
            if slips:
                announced.append(left >= AHEAD)
                known = True
            errors.append(stick_error(friction, rate, carried, end))
            carried = max(carried, end)
    return {
        "announced_percent": 100.0 * (sum(announced) + later) / (len(announced) + later),
        "announced_first_percent": 100.0 * float(np.mean(announced)),
        "false_alarms_percent": 100.0 * false / (fingers * PULLS),
        "stick_ratio_rms_before_a_slip": math.sqrt(np.mean(errors)),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fingers", type=int, default=200)
    values = parser.parse_args()
    for price in PRICES:
        found = observe(values.fingers, price)
        print(f"{price:4.1f}", "  ".join(f"{key} {value:.3g}" for key, value in found.items()))


if __name__ == "__main__":
    main()
