# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the force sensor reads of an unloaded plate: the tare that is left in a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d, uniform_filter1d

from finger_common.contact_threshold import contacts
from finger_common.stamps import seconds

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
"""Frames without contact that prove that a steady force is not from a finger."""

LATE_START = 0.08
"""N at the first sample of a press from which it began before the recording. A press cut off there
moves E by less than 10 % (simulated; at 0.1 N by 14 %, E2 by −36 %); 0.05 N may be a tare."""

DRIFT = 0.001
"""N, deviation of the tare between rest and press that no rest shows; an assumption."""

SMOOTHING = 0.04
"""s over which the force is averaged to see whether it rests."""

REST = 0.2
"""s of steady force that count as a rest between two presses."""

SMALL_TARE = 0.02
"""N; presses are told apart without regard to a smaller tare: a contact ends at 0.03 N."""

LARGEST_TARE = 0.1
"""N of force without contact from which it is refused: a fit of such a force is not final."""

DRIFTS = 0.03
"""N between two rests from which the tare is said to move."""

JUMP = 0.8
"""Share of its whole movement by which the tare changes between two rests where it jumps."""

PRESSED = 0.2
"""N above the rests beside it from which a force is a press: a trial's `minimum_peak`."""

SPIKE, SPIKE_WINDOW = 0.3, 7
"""N by which a spike leaves the samples beside it, and samples among which it is sought; one or two
of them may be spikes."""

SPIKE_RATIO = 4.0
"""Height of a spike over the range of the samples beside it: a fast press is none."""

PART_OF_PEAK = 0.95
"""Target force over peak force of a press for which none was set."""


@dataclass(frozen=True)
class Tare:
    """Force (N) of the unloaded plate, its standard deviation, and the seconds it was seen."""

    force: float
    deviation: float
    seconds: float


@dataclass(frozen=True)
class Unloaded:
    """The unloaded plate in a whole recording: its force (N) farthest from zero, in words, and
    between which times (s) it moves; None where it does not."""

    force: float
    words: str
    moves: tuple[float, float] | None = None


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
    """Target force (N, rounded down to 0.01 N) that a press to a peak (N) as recorded reaches,
    whether or not a fit takes its tare off."""
    reached = PART_OF_PEAK * (peak - (max(tare.force, 0.0) if tare is not None else 0.0))
    return math.floor(reached * 100) / 100


def without_spikes(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force (n,) whose isolated spikes, of one or two samples, have the median of the samples
    around them; and the indices (k,) of the spikes."""
    if len(force) < SPIKE_WINDOW:
        return force, np.empty(0, int)
    middle = median_filter(force, SPIKE_WINDOW, mode="nearest")
    away = force - middle
    found = np.flatnonzero(np.abs(away) > SPIKE)
    around = np.clip(found[:, None] + np.arange(SPIKE_WINDOW) - SPIKE_WINDOW // 2, 0, None)
    values = np.sort(force[np.minimum(around, len(force) - 1)], axis=1)
    up = values[:, -3] - values[:, 0]
    down = values[:, -1] - values[:, 2]
    beside = np.where(away[found] > 0.0, up, down)
    found = found[np.abs(away[found]) > SPIKE_RATIO * beside]
    if not len(found):
        return force, found
    cleaned = force.copy()
    cleaned[found] = middle[found]
    return cleaned, found


def smooth_force(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Force (n,) averaged over `SMOOTHING`; time (n,) in s."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else SMOOTHING
    return uniform_filter1d(force, max(round(SMOOTHING / period), 1), mode="nearest")


def pressed_force(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Force (n,) of which the peak of a press is taken, without spikes and noise; time (n,) in s,
    force (n,) in N."""
    return smooth_force(time, without_spikes(force)[0])


def rest_levels(
    time: np.ndarray, force: np.ndarray, touched: np.ndarray, empty: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Middle times (r,) in s and forces (r,) in N of the rests of a recording, in its order: where
    the force is steady and no finger touches.

    time (n,) in s, force (n,) in N; touched (m,), empty (k,): times at which the camera saw a
    contact, and at which it saw none. Without a camera a small steady force is a rest; a larger one
    is none, whatever the camera says: its clock may be wrong.
    """
    # Areas of a clock that is a little late touch the edge of a rest.
    found = [r for r in _steady_parts(time, force, touched, empty) if r.is_small and not r.touched]
    return np.array([0.5 * (r.begin + r.end) for r in found]), np.array([r.level for r in found])


class _Steady(NamedTuple):
    """A steady part of a recording: times in s, force in N, frames with and without a contact."""

    begin: float
    end: float
    level: float
    seen: int
    free: int

    @property
    def is_small(self) -> bool:
        """Whether it may be a tare by its size."""
        return abs(self.level) <= LARGEST

    @property
    def touched(self) -> bool:
        """Whether the camera saw a finger."""
        return self.seen > self.free


def _steady_parts(
    time: np.ndarray, force: np.ndarray, touched: np.ndarray, empty: np.ndarray
) -> list[_Steady]:
    """Where the force is steady, in order; arguments as of `rest_levels`."""
    if len(time) < 10 or time[-1] <= REST:
        return []
    smooth = smooth_force(time, force)
    window = max(round(REST / max(float(np.median(np.diff(time))), 1e-6)), 2)
    high = maximum_filter1d(smooth, window, mode="nearest")
    steady = high - minimum_filter1d(smooth, window, mode="nearest") <= 2.0 * STEADY
    found = []
    for first, end in contacts(steady.astype(float), 0.5, 0.5):
        begin, stop = float(time[first]), float(time[end - 1])
        if stop - begin >= 0.5 * SHORTEST:
            seen, free = (
                int(np.count_nonzero((times >= begin) & (times <= stop)))
                for times in (touched, empty)
            )
            found.append(_Steady(begin, stop, float(np.median(smooth[first:end])), seen, free))
    return found


def moved_plate(
    time: np.ndarray, force: np.ndarray, touched: np.ndarray, empty: np.ndarray
) -> Unloaded | None:
    """How the force of the unloaded plate moves, by jump or drift, from one press of a recording to
    the next; None where it does not. Arguments as of `rest_levels`.

    Rests before and after a press count, or all where there is no press: a tare between presses
    moves the force too. A steady negative force is a rest of any size, for a finger cannot pull; a
    positive one beyond `LARGEST` where the camera, which agrees with the force elsewhere, saw none.
    """
    force, _ = without_spikes(force)
    parts = _steady_parts(time, force, touched, empty)
    sees = len(touched) > 0 and not any(p.touched for p in parts if p.is_small)
    rests = [
        p
        for p in parts
        if not p.touched
        and (p.level <= LARGEST or (sees and p.seen == 0 and p.free >= EMPTY_FRAMES))
    ]
    if not rests:
        return None
    # The stretch before the first rest, those between two, and that after the last one.
    ends = np.searchsorted(time, [r.end for r in rests], side="right")
    begins = np.searchsorted(time, [r.begin for r in rests])
    levels = np.array([-np.inf, *(r.level for r in rests), -np.inf])
    stretches = zip([0, *ends], [*begins, len(time)], np.maximum(levels[:-1], levels[1:]))
    pressed = [b > a and float(force[a:b].max()) - base > PRESSED for a, b, base in stretches]
    chosen = [r for r, *sides in zip(rests, pressed, pressed[1:]) if any(sides)] or rests
    levels = np.array([r.level for r in chosen])
    if float(np.ptp(levels)) <= DRIFTS:
        return None
    # A jump is most of the change, from one rest to the next; a drift needs several.
    jumps = np.flatnonzero(np.abs(np.diff(levels)) > JUMP * np.ptp(levels))
    span, verb = sorted([int(np.argmin(levels)), int(np.argmax(levels))]), "drifts"
    if len(levels) > 2 and len(jumps):
        span, verb = [int(jumps[0]), int(jumps[0]) + 1], "jumps"
    first, last = (chosen[k] for k in span)
    return Unloaded(
        float(levels[np.argmax(np.abs(levels))]),
        f"the force {verb} from {_newtons(first.level)} to {_newtons(last.level)} while nothing "
        f"touches the plate, between {first.end:.1f} s and {last.begin:.1f} s",
        (first.end, last.begin),
    )


def pressing_force(
    stamp_ns: np.ndarray, force: np.ndarray, touched_ns: np.ndarray, empty_ns: np.ndarray
) -> np.ndarray:
    """Force (n,) in N by which presses are told apart: without isolated spikes and, where the
    unloaded plate would count as touched, without a tare that may drift.

    stamp_ns (n,); touched_ns (m,), empty_ns (k,): of the frames that show a contact, and none.
    """
    cleaned, _ = without_spikes(force)
    if not len(force):
        return cleaned
    time, touched, empty = (
        seconds(np.asarray(stamps) - stamp_ns[0]) for stamps in (stamp_ns, touched_ns, empty_ns)
    )
    at, levels = rest_levels(time, cleaned, touched, empty)
    if not len(at) or levels.max() < SMALL_TARE:
        return cleaned
    return cleaned - np.maximum(np.interp(time, at, levels), 0.0)


def unloaded_plate(
    time: np.ndarray, force: np.ndarray, touched: np.ndarray, empty: np.ndarray
) -> Unloaded | None:
    """What the recording shows of the unloaded plate, None where it shows no rest; arguments as of
    `rest_levels`."""
    moved = moved_plate(time, force, touched, empty)
    if moved is not None:
        return moved
    force, _ = without_spikes(force)
    tare = unloaded_tare(time, force, smooth_force(time, force), touched, empty)
    if tare is None:
        return None
    words = f"the force is {_newtons(tare.force)} while nothing touches the plate"
    return Unloaded(tare.force, f"{words} ({tare.seconds:.2g} s at the beginning or end)")


def _newtons(force: float) -> str:
    return f"{round(force, 2) + 0.0:.2f} N"


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
