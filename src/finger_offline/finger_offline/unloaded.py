# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the force sensor reads of an unloaded plate: the tare that is left in a recorded trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHORTEST = 0.1
"""s of rest below which no tare is measured."""

STEADY = 0.006
"""N; a rest is steady while the smoothed force stays within this of its first value: the
resolution of the Nano17 (1/171 N; paper)."""

CLEARANCE = 0.05
"""s left out beside the press: the foot of a press is slow."""

LARGEST = 0.15
"""N; a steady force beyond this is a finger that rests on the plate, not a tare, unless the camera
saw no contact meanwhile."""

EMPTY_FRAMES = 2
"""Frames without a contact that show that a steady force is none of a finger."""

LATE_START = 0.08
"""N at the first sample of a press from which it began before the recording. A press cut off there
moves E by less than 10 % (simulated; at 0.1 N by 14 %, E2 by −36 %); 0.05 N may be a tare."""

DRIFT = 0.001
"""N, deviation of the tare between rest and press that no rest shows; an assumption."""


PART_OF_PEAK = 0.95
"""Target force over peak force of a press for which none was set."""


@dataclass(frozen=True)
class Tare:
    """Force (N) of the unloaded plate, its standard deviation, and the seconds it was seen."""

    force: float
    deviation: float
    seconds: float


def unloaded_tare(
    time: np.ndarray,
    force: np.ndarray,
    smooth: np.ndarray,
    touched: np.ndarray,
    empty: np.ndarray,
) -> Tare | None:
    """Tare from the rest before and after a press; None where the recording shows no rest.

    time (n,) in s, force (n,) in N as recorded, smooth (n,) without its noise; touched (m,), empty
    (k,): times at which the camera saw a contact, and at which it saw none. A finger cannot pull: a
    steady negative force is a tare of any size. Where both ends of the recording rest, their
    difference counts as drift.
    """
    if len(time) < 10:
        return None
    ends = []
    for backwards in (False, True):
        step = -1 if backwards else 1
        clock = (time[-1] - time if backwards else time - time[0])[::step]
        seen, free = (
            time[-1] - frames if backwards else frames - time[0] for frames in (touched, empty)
        )
        limit = float(seen.min()) if len(seen) else np.inf
        inside = _steady(clock, smooth[::step], limit)
        if not inside:
            continue
        level = float(np.median(smooth[::step][:inside]))
        free = free[(free >= 0.0) & (free <= clock[inside - 1])]
        if level <= LARGEST or len(free) >= EMPTY_FRAMES:
            ends.append(force[::step][:inside])
    if not ends:
        return None
    values = [float(part.mean()) for part in ends]
    number = sum(map(len, ends))
    noise = float(np.concatenate([part - part.mean() for part in ends]).std())
    # The force that drives the model is smoothed; neighbouring samples of noise count as one.
    deviation = np.hypot(noise / np.sqrt(max(number / 4.0, 1.0)), DRIFT)
    if len(values) == 2:
        deviation = np.hypot(deviation, 0.5 * (values[1] - values[0]))
    weights = np.array([len(part) for part in ends], dtype=float)
    period = float(np.median(np.diff(time)))
    return Tare(float(np.average(values, weights=weights)), float(deviation), number * period)


def reached_force(peak: float, tare: Tare | None) -> float:
    """Target force (N) that a press to a peak (N) as recorded reaches, whether or not a fit takes
    its tare off."""
    return PART_OF_PEAK * (peak - (max(tare.force, 0.0) if tare is not None else 0.0))


def _steady(clock: np.ndarray, smooth: np.ndarray, limit: float) -> int:
    """Samples of rest at the beginning of a record; clock (n,) runs from 0."""
    first = int(np.searchsorted(clock, SHORTEST))
    if first < 5 or first >= len(clock):
        return 0
    level = float(np.median(smooth[:first]))
    away = np.flatnonzero(np.abs(smooth - level) > STEADY)
    end = float(clock[away[0]]) if len(away) else float(clock[-1])
    end = min(end, limit) - CLEARANCE
    return int(np.searchsorted(clock, end)) if end >= SHORTEST else 0
