# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""From recorded trials to what a fit compares: the force that drives the model, and the frames.

A recorded trial is any object with the fields of `finger_offline.trial_records.TrialRecord`. The
trials that are excluded, and the reasons, are part of the result.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from finger_common.contact_threshold import LIFTOFF_FORCE, contacts
from finger_common.usable_press import LONGEST_GAP, Frames, frames_of_press
from finger_offline.unloaded import LATE_START, Tare, unloaded_tare

from ..options import FitOptions
from ..report_units import minus

REST_FORCE = 0.005
"""N; a smoothed force up to this is no touch: 1/171 N, the resolution of the Nano17 (paper)."""

PACKET = 25
"""Samples over which the period of a force is taken."""

FEWEST_INDENTATIONS = 3
"""Frames with a measured indentation below which a trial's indentation is not used."""

LONGEST_INDENTATION_GAP = 0.05
"""s between two readings of the indentation over which it is not interpolated."""


@dataclass(frozen=True)
class Drive:
    """What drives the model through a trial, from rest on (SI), time from first touch.

    time (n,), force (n,): at the model's steps; frames (k,), indentation_rows (q,): indices into
    time at which areas and indentations are compared; record_time (r,), record_force (r,): force
    during the contact as recorded, for plots; before_time, before_force (h,): contacts before, of
    which the tissue may not have recovered, times below 0; tare: N, taken off the force; lag: s by
    which the images' stamps are late.
    """

    time: np.ndarray
    force: np.ndarray
    frames: np.ndarray
    indentation_rows: np.ndarray
    record_time: np.ndarray
    record_force: np.ndarray
    before_time: np.ndarray
    before_force: np.ndarray
    tare: float
    lag: float

    def to_model(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time, force and rows of all that drives the model, where rows (f,) of `time` are
        wanted."""
        return (
            np.concatenate([self.before_time, self.time]),
            np.concatenate([self.before_force, self.force]),
            len(self.before_time) + rows,
        )

    @property
    def highest(self) -> float:
        """Largest force (N) that drives the model."""
        return float(max(self.force.max(), self.before_force.max(initial=0.0)))


@dataclass(frozen=True)
class Recording:
    """What the drive of a trial is made of (SI), times from the first sample.

    time, force, smooth (n,): as recorded, and low-passed; driving (n,): as the model gets it;
    onset: index of the first sample that counts; last: of the last sample of the contact;
    frame_time (m,): of all frames; counted (k,): indices of those that count; indentation_time
    (q,): at which the indentation is compared, on the clock of the force; before_time, before (h,):
    force before, times below 0, empty where it is not known or has no effect any more.
    """

    time: np.ndarray
    force: np.ndarray
    smooth: np.ndarray
    driving: np.ndarray
    onset: int
    last: int
    frame_time: np.ndarray
    counted: np.ndarray
    indentation_time: np.ndarray
    before_time: np.ndarray
    before: np.ndarray

    def contacts_before(
        self, tare: float, until: float, options: FitOptions
    ) -> tuple[np.ndarray, np.ndarray]:
        """Times (h,) in s and forces (h,) in N of the contacts before a time (s), from rest on;
        nothing without one. tare: N."""
        known = self.before_time < until
        time, force = self.before_time[known], self.before[known] - tare
        if not np.any(force >= options.onset_force):
            return np.empty(0), np.empty(0)
        force[force < LIFTOFF_FORCE] = 0.0
        force[0] = 0.0
        # Of a rest, its ends are enough.
        touched = np.pad(force > 0.0, 1)
        kept = touched[:-2] | touched[1:-1] | touched[2:]
        return time[kept], force[kept]

    def drive(self, tare: float, lag: float, options: FitOptions) -> Drive:
        """Make the drive for a tare (N) of the force and a lag (s) of the images."""
        time, smooth, first = self.time, self.smooth - tare, self.onset
        touch = first
        while touch > 0 and smooth[touch - 1] > REST_FORCE and time[first] - time[touch - 1] < 1.0:
            touch -= 1
        touch = max(touch - 1, 0)
        frame_time = self.frame_time - lag
        counted = frame_time[self.counted]
        # A frame before the first touch has no contact, and drives nothing.
        start = min(float(time[touch]), float(counted[0]) - 1e-3)
        wanted = np.union1d(counted, self.indentation_time)
        # Times apart by rounding alone are one.
        wanted = wanted[np.diff(wanted, prepend=-np.inf) > 1e-9]
        wanted = wanted[wanted > start]
        knots = drive_times(start, float(wanted[-1]), frame_time, wanted, options)
        driving = np.maximum(np.interp(knots, time, self.driving - tare), 0.0)
        driving[knots <= time[touch]] = 0.0
        frames, rows = (np.searchsorted(knots, t - 2e-9) for t in (counted, self.indentation_time))
        before_time, before_force = self.contacts_before(tare, start, options)
        shown = slice(int(np.searchsorted(time, knots[0])), self.last + 1)
        return Drive(
            knots - knots[0],
            driving,
            frames,
            rows,
            time[shown] - knots[0],
            self.force[shown] - tare,
            before_time - knots[0],
            before_force,
            tare,
            lag,
        )


@dataclass(frozen=True)
class FitTrial:
    """One trial as a fit uses it (SI).

    record: the recorded trial that it is made of; label: bag and index; area (k,), area_sd (k,):
    measured at the frames that count; low (k,): the frame lies below the low force; moisture: mean
    of the readings, NaN without any; readings (m,): a.u.; dropped: frames inside the window without
    a measured area; rest: the unloaded plate, None where the trial does not show it. indentation
    (q,): measured, in m from an unknown zero, at the times of the frames that count on the clock of
    the force; empty where none was measured. finger: such as
    right_index, empty where it was not noted.
    """

    record: Any
    label: str
    condition: str
    subject: str
    index: int
    area: np.ndarray
    area_sd: np.ndarray
    low: np.ndarray
    moisture: float
    readings: np.ndarray
    dropped: int
    rest: Tare | None
    indentation: np.ndarray
    recording: Recording
    drive: Drive
    finger: str = ""

    def with_drive(self, tare: float, lag: float, options: FitOptions) -> FitTrial:
        """Drive the same frames with another tare (N) and another lag of the images (s)."""
        return replace(self, drive=self.recording.drive(tare, lag, options))

    @property
    def time(self) -> np.ndarray:
        """Times (n,) in s of the drive."""
        return self.drive.time

    @property
    def force(self) -> np.ndarray:
        """Force (n,) in N of the drive."""
        return self.drive.force

    @property
    def frames(self) -> np.ndarray:
        """Indices (k,) into time of the frames that count."""
        return self.drive.frames

    @property
    def frame_time(self) -> np.ndarray:
        """Times (k,) in s of the frames that count."""
        return self.time[self.frames]

    @property
    def loading(self) -> float:
        """Time (s) of the largest force."""
        return float(self.time[int(np.argmax(self.force))])

    @property
    def frame_force(self) -> np.ndarray:
        """Driving force (k,) in N at the frames that count."""
        return self.force[self.frames]


@dataclass(frozen=True)
class Exclusion:
    """An excluded trial and the reason."""

    label: str
    condition: str
    reason: str
    subject: str = ""

    @classmethod
    def of(cls, record: Any, reason: str) -> Exclusion:
        """Name a recorded trial that is left out, or one left out when the bags were read."""
        return cls(label_of(record), record.condition or "", reason, record.subject or "")


def by_reason(exclusions: Iterable[Exclusion]) -> dict[tuple[str, str], list[str]]:
    """Labels of the excluded trials by condition and reason, in their order."""
    found: dict[tuple[str, str], list[str]] = {}
    for exclusion in exclusions:
        found.setdefault((exclusion.condition, exclusion.reason), []).append(exclusion.label)
    return found


class TrialRejected(Exception):
    """A trial that cannot be used; the message is the reason."""


@dataclass(frozen=True)
class _Streams:
    """Force (n,) in N and frames (m,) of a record, times in s from its stamp `start` (ns)."""

    start: int
    time: np.ndarray
    force: np.ndarray
    frames: Frames

    @classmethod
    def of(cls, record: Any) -> _Streams:
        """Take the streams out of a record; raises TrialRejected where one is missing."""
        start = int(record.stamp_ns[0]) if len(record.stamp_ns) else 0
        frames = Frames(
            (np.asarray(record.area_stamp_ns, dtype=np.int64) - start) * 1e-9,
            np.asarray(record.area, dtype=float),
            np.asarray(record.area_flags, dtype=np.int64),
        )
        found = cls(
            start,
            (np.asarray(record.stamp_ns, dtype=np.int64) - start) * 1e-9,
            np.asarray(record.force, dtype=float),
            frames,
        )
        if len(found.time) < 10:
            raise TrialRejected("no force was recorded")
        if len(frames.time) < 2:
            raise TrialRejected("no contact area was recorded")
        wrong = int((~np.isfinite(found.force)).sum())
        if wrong:
            raise TrialRejected(f"{wrong} force samples are not finite")
        return found


def prepare(record: Any, options: FitOptions, memory: float = 0.0) -> FitTrial:
    """Drive and frames of one recorded trial; raises TrialRejected with the reason.

    memory: s before its onset whose contacts have an effect, as of `FitOptions.memory`.
    """
    target = options.target_of(record)
    if target <= options.onset_force:
        raise TrialRejected(
            f"its target of {target:g} N is not above the onset force of "
            f"{options.onset_force:g} N; lower onset_force"
        )
    streams = _Streams.of(record)
    time, force, frames = streams.time, streams.force, streams.frames
    frame_time = frames.time
    smooth = smoothed(time, force, options.force_cutoff)
    rest = None
    if options.nuisances:
        touched, empty = frame_time[frames.measured], frame_time[frames.empty]
        rest = unloaded_tare(time, force, smooth, touched, empty)
    tare = rest.force if rest else 0.0
    highest = float(force.max()) - tare
    first, reached, last = _contact(time, smooth, tare, target, highest, options)
    counted, dropped = _frames(frames, time[first], time[reached], time[last], options)
    readings = np.array([*record.moisture_before, *record.moisture_after], dtype=float)
    readings = readings[np.isfinite(readings)]
    if options.moisture_required and not len(readings):
        raise TrialRejected("no moisture reading")
    driving = smooth
    if options.force == "paper":
        # The paper brought the force to the frames; 0.45 of their rate keeps the filter below its
        # limit.
        driving = smoothed(time, force, 0.45 / frames.period)
    indented, indentation = _indentation(record, streams.start, frame_time[counted], options)
    recording = Recording(
        time,
        force,
        smooth,
        driving,
        first,
        last,
        frame_time,
        counted,
        indented,
        *_before(record, streams.start, time[first] - memory),
    )
    drive = recording.drive(tare, 0.0, options)
    sd = np.asarray(record.area_sd, dtype=float)
    return FitTrial(
        record=record,
        label=label_of(record),
        condition=record.condition or "",
        subject=record.subject or "",
        index=int(record.index),
        area=frames.area[counted],
        area_sd=sd[counted] if len(sd) == len(frame_time) else np.full(len(counted), np.nan),
        low=drive.force[drive.frames] < options.low_force,
        moisture=float(readings.mean()) if len(readings) else np.nan,
        readings=readings,
        dropped=dropped,
        rest=rest,
        indentation=indentation,
        recording=recording,
        drive=drive,
        finger=finger_of(record),
    )


def _contact(
    time: np.ndarray,
    smooth: np.ndarray,
    tare: float,
    target: float,
    highest: float,
    options: FitOptions,
) -> tuple[int, int, int]:
    """Find the samples at which the contact begins, reaches its target (N), and ends.

    time (n,) in s, smooth (n,): force in N with its tare; highest: N, of a sample as recorded.
    Raises TrialRejected without such a contact, or with gaps in it.
    """
    smooth = smooth - tare
    reached = np.flatnonzero(smooth >= target)
    if not len(reached):
        less = f" without its tare of {tare:+.2f} N" if abs(tare) > 0.005 else ""
        stays = f"force stays at {smooth.max():.2f} N{less}, below the target of {target:g} N"
        if not options.target_force:
            stays += " of the trial itself"
            if highest >= target:
                stays += (
                    f", though samples go up to {highest:.2f} N, perhaps spikes (a trial without a "
                    "target has 95 % of its largest sample)"
                )
        raise TrialRejected(minus(f"{stays}; set target_force to what the presses reach"))
    onset = options.onset_force
    first, end = next(c for c in contacts(smooth, onset, onset) if c[0] <= reached[0] < c[1])
    if first == 0 and smooth[0] > LATE_START:
        raise TrialRejected(
            f"the force is {smooth[0]:.2f} N at its first sample: the press began before the "
            "recording, and what the skin did then is unknown; record from before the contact on, "
            "or take the tare off"
        )
    gaps = np.diff(time[first:end])
    if len(gaps) and gaps.max() > max(LONGEST_GAP, 2.5 * sample_period(time)):
        raise TrialRejected(f"force samples are missing for {gaps.max():.2f} s during the contact")
    return first, int(reached[0]), end - 1


def _frames(
    frames: Frames, onset: float, reached: float, liftoff: float, options: FitOptions
) -> tuple[np.ndarray, int]:
    """Find the frames (k,) that count, and how many inside the window have no area.

    onset, reached, liftoff: times in s of the contact's begin, of its target force and of its end.
    Raises TrialRejected where the window has too few frames, or one runs over the border.
    """
    until = reached if options.window == "loading" else None
    inside, fault = frames_of_press(frames, onset, liftoff, until)
    if fault:
        raise TrialRejected(fault)
    measured = inside[frames.measured[inside]]
    return measured, len(inside) - len(measured)


def _indentation(
    record: Any, start: int, instants: np.ndarray, options: FitOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Find the times (q,) among the instants (k,) in s at which the indentation of a record is
    known, and its values (q,) in m, smoothed as the force is; nothing where fewer than three are
    known.

    start: ns, time 0.
    """
    none = np.empty(0), np.empty(0)
    values = np.asarray(getattr(record, "indentation", ()), dtype=float)
    usable = np.isfinite(values)
    if not options.indentation_sd or usable.sum() < FEWEST_INDENTATIONS:
        return none
    time = (np.asarray(record.indentation_stamp_ns, dtype=np.int64)[usable] - start) * 1e-9
    period = float(np.median(np.diff(time)))
    smooth = smoothed(time, values[usable], options.force_cutoff)
    after = np.searchsorted(time, instants)
    inside = (after > 0) & (after < len(time))
    after = np.clip(after, 1, len(time) - 1)
    near = time[after] - time[after - 1] <= max(1.5 * period, LONGEST_INDENTATION_GAP)
    # An instant that meets a reading needs no other.
    known = (inside & near) | (np.abs(time[after] - instants) < 1e-6)
    known |= np.abs(time[after - 1] - instants) < 1e-6
    if known.sum() < FEWEST_INDENTATIONS:
        return none
    return instants[known], np.interp(instants[known], time, smooth)


def _before(record: Any, start: int, since: float) -> tuple[np.ndarray, np.ndarray]:
    """Find times (h,) in s and forces (h,) in N from a time (s) to the first sample of a record;
    nothing where none is known. start: ns, time 0."""
    stamps = np.asarray(getattr(record, "history_ns", ()), dtype=np.int64)
    time, force = (stamps - start) * 1e-9, np.asarray(getattr(record, "history", ()), dtype=float)
    kept = time >= since
    if not kept.any():
        return np.empty(0), np.empty(0)
    return np.append(time[kept], 0.0), np.append(force[kept], float(record.force[0]))


def label_of(record: Any) -> str:
    """Name of a trial: its bag and its index; of a whole bag, without an index, the bag's."""
    name = str(record.bag).rstrip("/").rsplit("/", 1)[-1]
    return name if record.index is None else f"{name} trial {int(record.index)}"


def finger_of(record: Any) -> str:
    """Finger of a recorded trial, such as right_index; empty where it was not noted."""
    return getattr(record, "finger", "") or ""


def sample_period(time: np.ndarray) -> float:
    """Time (s) between samples (n,), n > 1, also of such as arrive in packets with one stamp each
    or with nearly one; gaps do not count."""
    over = min(PACKET, len(time) - 1)
    return float(np.median(time[over:] - time[:-over])) / over


def smoothed(time: np.ndarray, values: np.ndarray, cutoff: float) -> np.ndarray:
    """`low_passed` of values (n,) at times (n,) in s; uneven ones are filtered on an even grid."""
    period = sample_period(time)
    steps = np.diff(time)
    if np.mean(np.abs(steps / period - 1.0) < 0.5) > 0.9:
        return low_passed(values, 1.0 / period, cutoff)
    even = np.linspace(time[0], time[-1], max(round((time[-1] - time[0]) / period), 1) + 1)
    if len(even) > 4 * len(time):
        return values  # nearly all of it is a gap
    return np.interp(time, even, low_passed(np.interp(even, time, values), 1.0 / period, cutoff))


def low_passed(force: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Force (n,) in N after a zero-phase second-order Butterworth low-pass filter.

    Unchanged if cutoff ≥ rate / 2.
    """
    if cutoff >= 0.5 * rate or len(force) < 16:
        return force
    from scipy.signal import butter, sosfiltfilt  # half a second

    sections = butter(2, cutoff / (0.5 * rate), output="sos")
    return sosfiltfilt(sections, force)


def drive_times(
    start: float, end: float, frame_time: np.ndarray, counted: np.ndarray, options: FitOptions
) -> np.ndarray:
    """Times of the model's steps: the frames, and between them even steps up to options.step."""
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
    records: Sequence[Any], options: FitOptions, memory: float = 0.0
) -> tuple[list[FitTrial], list[Exclusion]]:
    """Usable trials, and the excluded ones with their reasons; memory: s, as of `prepare`."""
    trials, exclusions = [], []
    for record in records:
        try:
            trials.append(prepare(record, options, memory))
        except TrialRejected as reason:
            exclusions.append(Exclusion.of(record, str(reason)))
    return trials, exclusions
