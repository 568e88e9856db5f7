# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which press belongs to which trial: by `trial` messages if there are any, else by force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from finger_bag.read_settings import ReadSettings
from finger_bag.schema import SessionMetadata
from finger_bag.streams import (
    MOISTURE_AFTER,
    MOISTURE_BEFORE,
    MoistureReading,
    SessionStreams,
    TrialEvent,
    in_stamp_order,
)
from finger_common.axes import lateral_force, normal_force, usable
from finger_common.condition_name import check_condition_name
from finger_common.contact_threshold import LIFTOFF_FORCE, ONSET_FORCE, check_thresholds, contacts
from finger_common.errors import InputError, listed
from finger_common.flags import AreaFlag
from finger_common.settings import setting
from finger_common.stamps import nanoseconds, seconds
from finger_common.trial_phases import TrialPhase
from finger_model.paper import TARGET_FORCE

from .force_history import force_before
from .image_settings import ImageSettings
from .trial_records import Exclusion, TrialRecord, TrialSet
from .unloaded import LARGEST_TARE, Unloaded, moved_plate, pressing_force

PULLED = "pulled sideways: a trial for the friction, not for the area"


@dataclass(frozen=True)
class TrialSettings(ImageSettings, ReadSettings):
    """How trials are read."""

    onset_force: float = setting(
        ONSET_FORCE, "Normal force at which a press begins.", unit="N", minimum=0.0
    )
    liftoff_force: float = setting(
        LIFTOFF_FORCE, "Normal force below which a press ends.", unit="N", minimum=0.0
    )
    merge_gap: float = setting(
        0.1, "Presses closer in time than this are one.", unit="s", minimum=0.0
    )
    minimum_peak: float = setting(
        0.2,
        "A touch that stays below this force is no press.",
        unit="N",
        minimum=0.0,
    )
    margin: float = setting(
        0.5, "Force and areas kept before onset and after lift-off.", unit="s", minimum=0.0
    )
    image_areas: str = setting(
        "absent",
        "Measure areas in the images: where contact_area is absent, or always.",
        choices=("absent", "always"),
    )

    def validate(self) -> None:
        check_thresholds(self.onset_force, self.liftoff_force)

    def presses(self, stamp_ns: np.ndarray, force: np.ndarray) -> list[tuple[int, int]]:
        """Presses in normal forces (n,) as (first sample, first sample after)."""
        found: list[tuple[int, int]] = []
        for first, end in contacts(force, self.onset_force, self.liftoff_force):
            if found and seconds(stamp_ns[first] - stamp_ns[found[-1][1] - 1]) < self.merge_gap:
                found[-1] = (found[-1][0], end)
            else:
                found.append((first, end))
        return found

    @classmethod
    def of(cls, settings: ReadSettings) -> TrialSettings:
        """Default settings for a bag that is read in this way."""
        return cls(settings.mapping, **settings.to_dict())


def without_contact(area: np.ndarray, flags: np.ndarray) -> np.ndarray:
    """Mask (k,) of the frames that show no contact, by their areas (k,) and flags (k,)."""
    return (area <= 0.0) | ((flags & AreaFlag.NO_CONTACT) != 0)


@dataclass
class _Press:
    """A press that may become a trial."""

    first: int
    end: int
    event: TrialEvent | None
    reason: str = ""
    completed: bool = True


RELEASE = 0.5
"""s without force after which a guided press is over, by default."""

NOTABLE = 0.3
"""s between announcements and forces that two clocks explain, and no delay."""

_SAMPLE = np.dtype([("stamp_ns", "i8"), ("normal", "f8"), ("lateral", "f8"), ("pressing", "f8")])


def force_samples(streams: SessionStreams, settings: ReadSettings) -> np.ndarray:
    """Stamps and forces (n,) of the `usable` wrenches, in the order of their stamps; pressing: the
    normal force by which presses are told apart."""
    samples = np.empty(len(streams.wrenches.stamp_ns), _SAMPLE)
    samples["stamp_ns"] = streams.wrenches.stamp_ns
    samples["normal"] = normal_force(streams.wrenches.force, settings.axis)
    samples["lateral"] = lateral_force(streams.wrenches.force, settings.axis)
    samples = in_stamp_order(samples[usable(samples["normal"])])
    samples["pressing"] = pressing_force(
        np.ascontiguousarray(samples["stamp_ns"]),
        np.ascontiguousarray(samples["normal"]),
        *_frames(in_stamp_order(streams.areas)),
    )
    return samples


def _frames(areas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (m,), (k,) of the frames that show a contact, and none."""
    empty = without_contact(areas["area"], areas["flags"])
    touched = np.isfinite(areas["area"]) & ~empty
    return areas["stamp_ns"][touched], areas["stamp_ns"][empty]


def split(
    streams: SessionStreams, metadata: SessionMetadata, settings: TrialSettings, bag: str
) -> TrialSet:
    """Trials in the streams of one bag."""
    given = settings.mapping.trial
    metadata = SessionMetadata.from_mapping({**metadata.to_mapping(), **given})
    announced = streams.trials
    streams = replace(streams, trials=[_renamed(event, given) for event in announced])
    recording = _Recording(streams, metadata, settings, bag)
    stamp, normal = recording.stamp_ns, recording.pressing
    doubts = _doubts(streams, bag)
    result = TrialSet(problems=[f"{bag}: {p}" for p in streams.problems])
    if recording.unusable:
        result.problems.append(f"{bag}: {recording.unusable} wrenches without a finite force")
    result.problems += doubts
    result.problems += [f"{bag}: {words}" for words in _replaced(announced, streams.trials)]
    result.moved = recording.moved
    if result.moved is not None and abs(result.moved.force) > LARGEST_TARE:
        result.problems.append(f"{bag}: {result.moved.words}; the forces of its presses are wrong")
    if streams.trials:
        chosen, without, others = _by_messages(streams.trials, stamp, normal, recording.presses)
        heavy = [p for p in others if normal[p[0] : p[1]].max() >= settings.minimum_peak]
        result.unannounced = _unannounced(heavy, settings.minimum_peak)
        result.problems += [f"{bag}: {result.unannounced}"] if heavy else []
    else:
        chosen, without = _by_force(normal, recording.presses, settings.minimum_peak), []
    result.exclusions += [
        Exclusion(bag, e.condition, e.index, reason, e.subject or metadata.subject)
        for e, reason in without
    ]
    if not chosen and not without:
        result.exclusions.append(
            Exclusion(
                bag,
                metadata.condition,
                0,
                f"no press: normal force along {settings.axis} stays below "
                f"{settings.onset_force} N (range {normal.min():.2f} to {normal.max():.2f} N)"
                if len(normal)
                else "no press: no usable wrench",
                metadata.subject,
            )
        )
    moistures = _assign_moistures(streams.moistures, chosen, stamp)
    for number, (press, moisture) in enumerate(zip(chosen, moistures)):
        record = recording.trial(press, number, moisture, _begin_of(press, chosen))
        record = replace(record, area_source=streams.area_source, doubts=tuple(doubts))
        reason = press.reason
        if not reason and not len(record.area_stamp_ns):
            reason = "no contact area during the press"
        try:
            check_condition_name(record.condition, "condition")
        except InputError as error:
            reason = str(error)
        if reason == PULLED:
            result.pulls.append(record)
        if reason:
            result.exclusions.append(
                Exclusion(bag, record.condition, record.index, reason, record.subject)
            )
        else:
            result.trials.append(record)
    return result


def _renamed(event: TrialEvent, given: Mapping[str, str]) -> TrialEvent:
    """An announcement with what a mapping file says of all trials of the bag in its place."""
    names = {name: given[name] for name in ("session", "subject", "condition") if name in given}
    target = {"target_force": float(given["target_force"])} if "target_force" in given else {}
    return replace(event, **names, **target)  # type: ignore[arg-type]


def _replaced(before: Sequence[TrialEvent], after: Sequence[TrialEvent]) -> list[str]:
    """Say which subject and conditions of the announcements a mapping file replaces."""
    words = []
    for name in ("subject", "condition"):
        pairs = ((getattr(b, name), getattr(a, name)) for b, a in zip(before, after, strict=True))
        old = dict.fromkeys(was for was, now in pairs if was and was != now)
        if old:
            new = getattr(after[0], name)
            words.append(f"the mapping file replaces the {name} {listed(old)} by {new}")
    return words


class _Recording:
    """Streams of one bag in the order of their stamps, and the presses in them.

    unusable: wrenches without a `usable` force, which are left out.
    """

    def __init__(
        self, streams: SessionStreams, metadata: SessionMetadata, settings: TrialSettings, bag: str
    ) -> None:
        self._metadata, self._settings, self._bag = metadata, settings, bag
        normal = normal_force(streams.wrenches.force, settings.axis)
        self.unusable = int((~usable(normal)).sum())
        samples = force_samples(streams, settings)
        self.stamp_ns, self._normal, self._lateral, self.pressing = (
            np.ascontiguousarray(samples[name])
            for name in ("stamp_ns", "normal", "lateral", "pressing")
        )
        self._areas = in_stamp_order(streams.areas)
        self._indentations = in_stamp_order(streams.indentations)
        self.presses = settings.presses(self.stamp_ns, self.pressing)

    @property
    def moved(self) -> Unloaded | None:
        """How the force of the unloaded plate moves."""
        if not len(self.stamp_ns):
            return None
        touched, empty = _frames(self._areas)
        start = self.stamp_ns[0]
        time, *frames = (seconds(stamps - start) for stamps in (self.stamp_ns, touched, empty))
        return moved_plate(time, self._normal, *frames)

    def trial(
        self,
        press: _Press,
        number: int,
        moisture: tuple[list[float], list[float]],
        since: int,
    ) -> TrialRecord:
        """The trial of a press; number: of the trial in the bag, where no message tells it; since:
        sample from which on the force before is of the same finger."""
        stamp, metadata = self.stamp_ns, self._metadata
        margin = nanoseconds(self._settings.margin)
        onset = int(stamp[press.first])
        last = int(stamp[min(press.end, len(stamp)) - 1])
        # The margins hold nothing of the presses before and after.
        low = max((end for _, end in self.presses if end <= press.first), default=0)
        high = min((first for first, _ in self.presses if first >= press.end), default=len(stamp))
        low = max(low, int(np.searchsorted(stamp, onset - margin)))
        high = min(high, int(np.searchsorted(stamp, last + margin, side="right")))
        areas, indentations = (
            table[(table["stamp_ns"] >= stamp[low]) & (table["stamp_ns"] <= stamp[high - 1])]
            for table in (self._areas, self._indentations)
        )
        history_ns, history = force_before(stamp, self._normal, low, since)
        event = press.event
        index = _integer(metadata.trial_index, number) if event is None else event.index
        target = _number(event.target_force if event is not None else metadata.target_force)
        return TrialRecord(
            bag=self._bag,
            session=(event.session if event else "") or metadata.session,
            subject=(event.subject if event else "") or metadata.subject,
            finger=(event.finger if event else "") or metadata.finger,
            condition=(event.condition if event else "") or metadata.condition,
            index=index,
            attempt=event.attempt if event else 0,
            target_force=target if target > 0 else TARGET_FORCE,
            stamp_ns=stamp[low:high],
            force=self._normal[low:high],
            lateral_force=self._lateral[low:high],
            area_stamp_ns=areas["stamp_ns"].copy(),
            area=areas["area"].copy(),
            area_sd=areas["sd"].copy(),
            area_flags=areas["flags"].copy(),
            real_area=areas["real_area"].copy(),
            moisture_before=moisture[0],
            moisture_after=moisture[1],
            onset_ns=onset,
            liftoff_ns=int(stamp[press.end]) if press.end < len(stamp) else None,
            completed=press.completed,
            indentation_stamp_ns=indentations["stamp_ns"].copy(),
            indentation=indentations["indentation"].copy(),
            history_ns=history_ns,
            history=history,
        )


def _begin_of(press: _Press, chosen: Sequence[_Press]) -> int:
    """First sample behind the presses of other fingers than that of a press."""

    def finger(one: _Press) -> tuple[str, str]:
        return ("", "") if one.event is None else (one.event.subject, one.event.finger)

    others = (p.end for p in chosen if p.end <= press.first and finger(p) != finger(press))
    return max(others, default=0)


def _doubts(streams: SessionStreams, bag: str) -> list[str]:
    """Stamps that run back: they are put in order, but one of two clocks was wrong."""
    stamps = {
        "wrench": streams.wrenches.stamp_ns,
        "contact_area": streams.areas["stamp_ns"],
        "indentation": streams.indentations["stamp_ns"],
    }
    back = {name: int((np.diff(values) < 0).sum()) for name, values in stamps.items()}
    return [
        f"{bag}: {number} stamps of {name} run back; they were put in order"
        for name, number in back.items()
        if number
    ]


def _by_force(
    normal: np.ndarray, found: Sequence[tuple[int, int]], minimum_peak: float
) -> list[_Press]:
    chosen = []
    for first, end in found:
        peak = float(normal[first:end].max())
        reason = "" if peak >= minimum_peak else f"a touch of {peak:.2f} N, no press"
        chosen.append(_Press(first, end, None, reason))
    return chosen


_NAMES = ("subject", "finger", "condition")
"""Names in an announcement that may be empty."""

_UNTIL_PRESS = (TrialPhase.PREPARE, TrialPhase.MOISTURE_BEFORE, TrialPhase.PRESS)


def _announced(events: Sequence[TrialEvent]) -> list[list[TrialEvent]]:
    """Events of each trial that announce a press, in the order of the presses.

    Numbers may begin again with each subject, finger and condition, and after a verdict: phases up
    to the press begin another trial when no trial of their number and attempt has their names, or
    the newest one was judged. Later phases belong to the newest trial with their names, or else to
    the newest one. A name that is not given, as by a program that knows none, is as any other; the
    last event of a trial has all names of the trial, each as it was given first.
    """
    numbered: dict[tuple[str, int, int], list[list[TrialEvent]]] = {}
    for event in sorted(events, key=lambda e: e.stamp_ns):
        trials = numbered.setdefault((event.session, event.index, event.attempt), [])
        begins = event.phase in _UNTIL_PRESS
        named = [trial for trial in trials if _may_name(event, trial[-1])]
        fitting = named if begins else named or trials
        if not fitting or (begins and _judged(fitting[-1])):
            trials.append([event])
            continue
        names = {name: getattr(fitting[-1][-1], name) or getattr(event, name) for name in _NAMES}
        fitting[-1].append(replace(event, **names))
    pressed = (
        trial
        for trials in numbered.values()
        for trial in trials
        if any(e.phase == TrialPhase.PRESS for e in trial)
    )
    return sorted(pressed, key=_start)


def _may_name(event: TrialEvent, other: TrialEvent) -> bool:
    """Whether no name in one event differs from that in the other."""
    pairs = ((getattr(event, name), getattr(other, name)) for name in _NAMES)
    return all(a == b for a, b in pairs if a and b)


def _judged(trial: Sequence[TrialEvent]) -> bool:
    return any(e.phase in (TrialPhase.DONE, TrialPhase.FAILED) for e in trial)


def _start(group: Sequence[TrialEvent]) -> int:
    """ns; when the press of a trial is announced."""
    return next(e.stamp_ns for e in group if e.phase == TrialPhase.PRESS)


def _unannounced(presses: Sequence[tuple[int, int]], minimum_peak: float) -> str:
    if not presses:
        return ""
    number = "1 press" if len(presses) == 1 else f"{len(presses)} presses"
    belong = "belongs" if len(presses) == 1 else "belong"
    return f"{number} of {minimum_peak:g} N or more {belong} to no announced trial"


def _by_messages(
    events: Sequence[TrialEvent],
    stamp: np.ndarray,
    normal: np.ndarray,
    found: Sequence[tuple[int, int]],
) -> tuple[list[_Press], list[tuple[TrialEvent, str]], list[tuple[int, int]]]:
    """The press of each announced trial, trials without one, and presses in none of them."""
    groups = _announced(events)
    chosen: list[_Press] = []
    without: list[tuple[TrialEvent, str]] = []
    others = set(found)
    for group, following in itertools.zip_longest(groups, groups[1:]):
        start = _start(group)
        ends = [
            e.stamp_ns
            for e in group
            if e.stamp_ns > start
            and e.phase in (TrialPhase.MOISTURE_AFTER, TrialPhase.DONE, TrialPhase.FAILED)
        ]
        if following is not None:
            ends.append(_start(following))
        low = np.searchsorted(stamp, start)
        high = np.searchsorted(stamp, min(ends)) if ends else len(stamp)
        inside = [p for p in found if p[0] < high and p[1] > low and p[0] >= low]
        others -= set(inside)
        failed = next((e for e in group if e.phase == TrialPhase.FAILED), None)
        if not inside:
            text = (
                f"marked as failed: {failed.note or 'no reason given'}"
                if failed
                else f"no press{_apart(group, ends, stamp, found)}"
            )
            without.append((group[-1], text))
            continue
        best = max(inside, key=lambda p: float(normal[p[0] : p[1]].max()))
        reason = f"marked as failed: {failed.note or 'no reason given'}" if failed else ""
        if not reason and any(e.phase == TrialPhase.PULL for e in group):
            reason = PULLED
        completed = any(e.phase == TrialPhase.DONE for e in group)
        chosen.append(_Press(*best, group[-1], reason, completed))
    # A trial that was only prepared in this bag has no press to lose.
    return chosen, without, sorted(others)


def _apart(
    group: Sequence[TrialEvent],
    ends: Sequence[int],
    stamp: np.ndarray,
    found: Sequence[tuple[int, int]],
) -> str:
    """What to add to "no press" where the trial was announced by another clock than the force's.

    The cue to lift has the stamp of a force, so that the press it belongs to is known; it ends
    RELEASE before the next phase.
    """
    lifts = [e.stamp_ns for e in group if e.phase == TrialPhase.LIFT]
    of_lift = [end for first, end in found for s in lifts if stamp[first] <= s <= stamp[end - 1]]
    first, last = group[0].stamp_ns, group[-1].stamp_ns
    apart = 0.0
    if of_lift and ends:
        apart = seconds(min(ends) - int(stamp[of_lift[0] - 1])) - RELEASE
    elif len(stamp) and not lifts:
        apart = max(seconds(first - int(stamp[-1])), seconds(int(stamp[0]) - last), 0.0)
    if abs(apart) < NOTABLE:
        return ""
    return f": announcements and forces are {abs(apart):.1f} s apart"


def _assign_moistures(
    readings: Sequence[MoistureReading], chosen: Sequence[_Press], stamp: np.ndarray
) -> list[tuple[list[float], list[float]]]:
    """Readings before and after each press: by their phase, else of the nearer press."""
    result: list[tuple[list[float], list[float]]] = [([], []) for _ in chosen]
    if not chosen:
        return result
    onsets = np.array([stamp[p.first] for p in chosen], np.int64)
    ends = np.array([stamp[min(p.end, len(stamp)) - 1] for p in chosen], np.int64)
    for reading in sorted(readings, key=lambda r: r.stamp_ns):
        if not np.isfinite(reading.value):
            continue
        following = int(np.searchsorted(onsets, reading.stamp_ns))
        previous = following - 1
        after = reading.phase == MOISTURE_AFTER
        if reading.phase not in (MOISTURE_BEFORE, MOISTURE_AFTER):
            after = following >= len(chosen) or (
                previous >= 0
                and reading.stamp_ns - ends[previous] < onsets[following] - reading.stamp_ns
            )
        if after and previous >= 0:
            result[previous][1].append(reading.value)
        elif not after and following < len(chosen):
            result[following][0].append(reading.value)
    return result


def _integer(text: str, default: int) -> int:
    try:
        return int(text[:9]) + default
    except ValueError:
        return default


def _number(text: str | float) -> float:
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0
