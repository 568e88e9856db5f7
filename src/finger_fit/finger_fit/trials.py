"""From recorded trials to what a fit compares: the model's drive and the frames that count.

A recorded trial is any object with the fields of `finger_offline.trials.TrialRecord`. Which trials are left out, and
why, is part of the result.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from .options import FitOptions

FLAG_NO_CONTACT = 1
FLAG_CLIPPED = 4
"""Bits of finger_msgs/ContactArea.flags."""

REST_FORCE = 0.005
"""N; a smoothed force at or below this is no touch: 1/171 N, the resolution of the Nano17 (paper)."""

SMALLEST_CONDITION = 3
"""Trials below which a condition cannot be bootstrapped and four parameters cannot be told from scatter."""


@dataclass(frozen=True)
class FitTrial:
    """One trial as a fit sees it (SI).

    label: bag and index; time (n,), force (n,): the model's drive from rest, time from first touch on;
    frames (k,): indices into time at which areas are compared; area (k,), area_sd (k,): measured;
    low (k,): frame lies below the low force; moisture: mean of the readings, NaN without; readings: (m,) a.u.;
    record_time (r,), record_force (r,): force as recorded over the contact, for plots; dropped: frames inside
    the window that vision could not measure.
    """

    label: str
    condition: str
    subject: str
    index: int
    time: np.ndarray
    force: np.ndarray
    frames: np.ndarray
    area: np.ndarray
    area_sd: np.ndarray
    low: np.ndarray
    moisture: float
    readings: np.ndarray
    record_time: np.ndarray
    record_force: np.ndarray
    dropped: int = 0

    @property
    def frame_time(self) -> np.ndarray:
        """Times (k,) in s of the frames that count."""
        return self.time[self.frames]

    @property
    def frame_force(self) -> np.ndarray:
        """Driving force (k,) in N at the frames that count."""
        return self.force[self.frames]


@dataclass(frozen=True)
class Exclusion:
    """A trial left out, and the reason in words."""

    label: str
    condition: str
    reason: str


class Unfit(Exception):
    """A trial that cannot take part; the message is the reason."""


def prepare(record: Any, options: FitOptions) -> FitTrial:
    """Drive and frames of one recorded trial; raises Unfit with the reason."""
    start = int(record.stamp_ns[0]) if len(record.stamp_ns) else 0
    time = (np.asarray(record.stamp_ns, dtype=np.int64) - start) * 1e-9
    force = np.asarray(record.force, dtype=float)
    frame_time = (np.asarray(record.area_stamp_ns, dtype=np.int64) - start) * 1e-9
    area = np.asarray(record.area, dtype=float)
    flags = np.asarray(record.area_flags, dtype=np.int64)
    if len(time) < 10:
        raise Unfit("no force was recorded")
    if len(frame_time) < 2:
        raise Unfit("no contact area was recorded")
    finite = np.isfinite(force)
    if not finite.all():
        raise Unfit(f"{int((~finite).sum())} force samples are not finite")
    rate = 1.0 / float(np.median(np.diff(time)))
    smooth = low_passed(force, rate, options.force_cutoff)

    reached = np.flatnonzero(smooth >= options.target_force)
    if not len(reached):
        raise Unfit(
            f"force stays at {smooth.max():.2f} N, below the target of {options.target_force:g} N"
        )
    first, last = contact_around(smooth, int(reached[0]), options.onset_force)
    gaps = np.diff(time[first : last + 1])
    if len(gaps) and gaps.max() > 0.05:
        raise Unfit(f"force samples are missing for {gaps.max():.2f} s during the contact")

    target_time = time[reached[0]]
    period = float(np.median(np.diff(frame_time)))
    inside = (frame_time >= time[first]) & (frame_time <= time[last])
    if options.window == "loading":
        after = np.flatnonzero(frame_time >= target_time)
        if not len(after) or frame_time[after[0]] > target_time + 1.5 * period:
            raise Unfit("no frame at the target force")
        inside &= frame_time <= frame_time[after[0]]
    counted = np.flatnonzero(inside)
    if len(counted) < 3:
        raise Unfit(f"{len(counted)} frames in the contact, at least 3 are needed")
    holes = np.diff(frame_time[counted])
    if holes.max() > 1.5 * period:
        number = round(float(holes.max() / period)) - 1
        raise Unfit(f"{number} frames were dropped in a row during the press")
    clipped = int(((flags[counted] & FLAG_CLIPPED) != 0).sum())
    if clipped:
        raise Unfit(f"the contact runs over the image border in {clipped} frames")
    usable = np.isfinite(area[counted]) & ((flags[counted] & FLAG_NO_CONTACT) == 0)
    dropped = int((~usable).sum())
    counted = counted[usable]
    if len(counted) < 3:
        raise Unfit(f"vision measured {len(counted)} frames of the contact, at least 3 are needed")
    readings = np.array([*record.moisture_before, *record.moisture_after], dtype=float)
    readings = readings[np.isfinite(readings)]
    if options.moisture_required and not len(readings):
        raise Unfit("no moisture reading")

    touch = first
    while touch > 0 and smooth[touch - 1] > REST_FORCE and time[first] - time[touch - 1] < 1.0:
        touch -= 1
    touch = max(touch - 1, 0)
    end = frame_time[counted[-1]]
    knots = drive_times(time[touch], end, frame_time, frame_time[counted], options)
    if options.force == "paper":
        # The paper brought the force to the frames; 0.45 of their rate keeps the filter below its limit.
        driving = np.interp(knots, time, low_passed(force, rate, 0.45 / period))
    else:
        driving = np.interp(knots, time, smooth)
    driving = np.maximum(driving, 0.0)
    driving[0] = 0.0
    frames = np.searchsorted(knots, frame_time[counted] - 1e-9)
    shown = slice(touch, last + 1)
    sd = np.asarray(record.area_sd, dtype=float)
    return FitTrial(
        label_of(record),
        record.condition or "",
        record.subject or "",
        int(record.index),
        knots - knots[0],
        driving,
        frames,
        area[counted],
        sd[counted] if len(sd) == len(area) else np.full(len(counted), np.nan),
        driving[frames] < options.low_force,
        float(readings.mean()) if len(readings) else np.nan,
        readings,
        time[shown] - knots[0],
        force[shown],
        dropped,
    )


def label_of(record: Any) -> str:
    """Bag and trial in words."""
    name = str(record.bag).rstrip("/").rsplit("/", 1)[-1]
    return f"{name} trial {int(record.index)}"


def low_passed(force: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Force (n,) in N after a zero-phase second-order Butterworth low-pass; unchanged if cutoff ≥ rate/2."""
    if cutoff >= 0.5 * rate or len(force) < 16:
        return force
    sections = butter(2, cutoff / (0.5 * rate), output="sos")
    return sosfiltfilt(sections, force)


def contact_around(force: np.ndarray, peak: int, threshold: float) -> tuple[int, int]:
    """First and last sample of the contact that holds sample `peak`: force (n,) at or above the threshold."""
    below = np.flatnonzero(force < threshold)
    before, after = below[below < peak], below[below > peak]
    first = int(before[-1]) + 1 if len(before) else 0
    last = int(after[0]) - 1 if len(after) else len(force) - 1
    return first, last


def drive_times(
    start: float, end: float, frame_time: np.ndarray, counted: np.ndarray, options: FitOptions
) -> np.ndarray:
    """Times of the model's steps: the frames, and between them even steps no longer than options.step."""
    inside = frame_time[(frame_time > start + 1e-6) & (frame_time < end - 1e-9)]
    knots = np.unique(np.concatenate([[start], inside, counted]))
    if options.force == "paper":
        return knots
    pieces = [knots[:1]]
    for low, high in itertools.pairwise(knots):
        number = max(int(np.ceil((high - low) / options.step - 1e-9)), 1)
        pieces.append(np.linspace(low, high, number + 1)[1:])
    return np.concatenate(pieces)


def prepare_all(
    records: Sequence[Any], options: FitOptions
) -> tuple[list[FitTrial], list[Exclusion]]:
    """Trials that take part, and those left out with the reason."""
    trials, exclusions = [], []
    for record in records:
        try:
            trials.append(prepare(record, options))
        except Unfit as reason:
            exclusions.append(Exclusion(label_of(record), record.condition or "", str(reason)))
    return trials, exclusions


def moisture_clusters(moisture: np.ndarray, number: int) -> np.ndarray:
    """Cluster (n,) of each reading, 0 the driest: the division that minimises the squared distance to the
    clusters' means, found exactly over all cuts of the sorted readings (dynamic programme of Fisher 1958).

    moisture: (n,) a.u., finite.
    """
    order = np.argsort(moisture, kind="stable")
    x = np.asarray(moisture, dtype=float)[order]
    n = len(x)
    number = min(number, n)
    total, square = np.cumsum(np.r_[0.0, x]), np.cumsum(np.r_[0.0, x * x])

    def spread(i: int, j: int) -> float:
        """Squared deviation of x[i:j] from its mean."""
        return square[j] - square[i] - (total[j] - total[i]) ** 2 / (j - i)

    best = np.full((number + 1, n + 1), np.inf)
    cut = np.zeros((number + 1, n + 1), dtype=int)
    best[0, 0] = 0.0
    for k in range(1, number + 1):
        for j in range(k, n + 1):
            costs = [best[k - 1, i] + spread(i, j) for i in range(k - 1, j)]
            cut[k, j] = k - 1 + int(np.argmin(costs))
            best[k, j] = min(costs)
    labels = np.empty(n, dtype=int)
    end = n
    for k in range(number, 0, -1):
        begin = cut[k, end]
        labels[order[begin:end]] = k - 1
        end = begin
    return labels
