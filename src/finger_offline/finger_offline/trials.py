"""From bags to trials: which press belongs to which trial, with its force, areas and moisture readings.

Bags that hold `trial` messages are split by them. Others are split by the force: a trial is a press from onset to
lift-off. Which presses were left out, and why, is part of the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.mapping import AXES, TopicMapping
from finger_bag.reader import BagReader, open_bag
from finger_bag.schema import SessionMetadata
from finger_bag.streams import (
    MOISTURE_AFTER,
    MOISTURE_BEFORE,
    PHASE_DONE,
    PHASE_FAILED,
    PHASE_MOISTURE_AFTER,
    PHASE_PRESS,
    MoistureReading,
    SessionStreams,
    TrialEvent,
    find_topic,
    find_wrench,
    in_stamp_order,
    missing,
    read_streams,
)
from finger_common.errors import InputError

IMAGE_AREAS = ("absent", "always", "never")
DEFAULT_TARGET = 1.35
"""N; the paper's cue to lift."""


@dataclass(frozen=True)
class TrialSettings:
    """How trials are read.

    normal_axis: sensor axis along which force is positive when the finger presses; None takes it from the mapping,
    else "-z". wrench_topic: "wrench", "wrench_raw" or an absolute name. namespace: of the rig's topics, None to find
    it. onset_force, liftoff_force (N): a press begins and ends here. merge_gap (s): presses closer than this are one.
    minimum_peak (N): a touch that stays below is no trial when there are no `trial` messages. margin (s): force and
    areas kept before onset and after lift-off. image_areas: take areas from images when contact_area is "absent",
    "always" or "never". calibration: plate calibration for them, None for the one attached to the bag; area_per_pixel (m²) stands in
    for one. condition,
    subject: override what the bag says.
    """

    normal_axis: str | None = None
    wrench_topic: str = "wrench"
    namespace: str | None = None
    mapping: TopicMapping = field(default_factory=TopicMapping)
    onset_force: float = 0.05
    liftoff_force: float = 0.03
    merge_gap: float = 0.1
    minimum_peak: float = 0.2
    margin: float = 0.5
    image_areas: str = "absent"
    calibration: str | None = None
    area_per_pixel: float | None = None
    condition: str | None = None
    subject: str | None = None

    def __post_init__(self) -> None:
        if self.normal_axis is not None and self.normal_axis not in AXES:
            raise InputError(
                f"normal_axis is {self.normal_axis!r}, choose one of {', '.join(AXES)}"
            )
        if not 0 <= self.liftoff_force < self.onset_force:
            raise InputError(
                f"liftoff_force is {self.liftoff_force} N, not below onset_force "
                f"({self.onset_force} N); lower one or raise the other"
            )
        if self.image_areas not in IMAGE_AREAS:
            raise InputError(
                f"image_areas is {self.image_areas!r}, choose one of {', '.join(IMAGE_AREAS)}"
            )

    @property
    def axis(self) -> str:
        """Normal axis in force."""
        return self.normal_axis or self.mapping.normal_axis or "-z"


@dataclass(frozen=True)
class TrialRecord:
    """One trial (SI). Stamps are acquisition times in ns.

    stamp_ns (n,), force (n,): normal force, positive in compression, at full rate, from `margin` before onset to
    `margin` after lift-off; lateral_force (n,). area_stamp_ns, area, area_sd (m², NaN where unknown), area_flags (k,):
    gross areas; real_area (k,). moisture_before, moisture_after: readings (a.u.). onset_ns, liftoff_ns: first sample
    at or above the onset force, first one below the lift-off force (None when the recording ends before).
    area_source: "topic" or "images".
    """

    bag: str
    session: str
    subject: str
    condition: str
    index: int
    attempt: int
    target_force: float
    stamp_ns: np.ndarray
    force: np.ndarray
    lateral_force: np.ndarray
    area_stamp_ns: np.ndarray
    area: np.ndarray
    area_sd: np.ndarray
    area_flags: np.ndarray
    real_area: np.ndarray
    moisture_before: list[float]
    moisture_after: list[float]
    onset_ns: int
    liftoff_ns: int | None
    area_source: str = "topic"

    @property
    def moisture(self) -> float:
        """Mean of all readings (a.u.), NaN without any."""
        readings = self.moisture_before + self.moisture_after
        return float(np.mean(readings)) if readings else float("nan")

    @property
    def peak_force(self) -> float:
        """Largest normal force (N)."""
        return float(np.nanmax(self.force)) if len(self.force) else float("nan")


@dataclass(frozen=True)
class Exclusion:
    """A press or trial that was left out, and the reason in words."""

    bag: str
    condition: str
    index: int
    reason: str


@dataclass
class TrialSet:
    """Trials of one or more bags, what was left out, and what was wrong with the bags."""

    trials: list[TrialRecord] = field(default_factory=list)
    exclusions: list[Exclusion] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Any:
        return iter(self.trials)

    @property
    def conditions(self) -> list[str]:
        """Conditions in the order they appear."""
        return list(dict.fromkeys(t.condition for t in self.trials))

    def of(self, condition: str) -> list[TrialRecord]:
        """Trials of one condition."""
        return [t for t in self.trials if t.condition == condition]


def find_bags(paths: Iterable[str | Path]) -> list[Path]:
    """Bags among files and folders; a folder that is no bag stands for the bags directly in it.

    Raises InputError for a path that does not exist or a folder without bags.
    """
    found: list[Path] = []
    for item in paths:
        path = Path(item)
        if path.is_dir() and not _is_bag(path):
            inside = sorted(
                p
                for p in path.iterdir()
                if not p.name.startswith(".") and p.is_dir() and _is_bag(p)
            )
            if not inside:
                raise InputError(f"{path}: no bag in this folder; give a bag or a folder of bags")
            found += inside
        else:
            if not path.exists():
                raise InputError(f"{path}: no such bag; check the path")
            found.append(path)
    if not found:
        raise InputError("no bag was given; name bags or a folder of bags")
    return found


def _is_bag(folder: Path) -> bool:
    if (folder / "metadata.yaml").is_file():
        return True
    return any(p.name.removesuffix(".zstd").endswith((".mcap", ".db3")) for p in folder.iterdir())


def load_trials(
    paths: str | Path | Iterable[str | Path],
    settings: TrialSettings | Mapping[str, Any] | None = None,
    progress: Callable[[int, int, Path], None] | None = None,
) -> TrialSet:
    """Trials of bags; see TrialSettings for what can be set.

    progress is called with (number of bags done, number of bags, bag). Raises InputError for a bag that cannot be
    read, holds no wrench, or holds neither contact_area nor images.
    """
    if not isinstance(settings, TrialSettings):
        settings = TrialSettings(**dict(settings or {}))
    bags = find_bags([paths] if isinstance(paths, (str, Path)) else paths)
    result = TrialSet()
    for number, bag in enumerate(bags):
        if progress is not None:
            progress(number, len(bags), bag)
        with open_bag(bag) as reader:
            found = trials_of(reader, settings)
        result.trials += found.trials
        result.exclusions += found.exclusions
        result.problems += found.problems
    _drop_superseded(result)
    if progress is not None:
        progress(len(bags), len(bags), bags[-1])
    return result


def trials_of(reader: BagReader, settings: TrialSettings) -> TrialSet:
    """Trials of one opened bag."""
    streams = streams_with_areas(reader, settings)
    return split(streams, reader.info.metadata, settings, str(reader.path))


def streams_with_areas(reader: BagReader, settings: TrialSettings) -> SessionStreams:
    """Streams of a bag, with areas from its images where the settings ask for it.

    Raises InputError when there are no areas and no images to take them from.
    """
    find_wrench(reader, settings.mapping, settings.namespace, settings.wrench_topic)
    area_topic = find_topic(reader, "contact_area", settings.mapping, settings.namespace)
    if area_topic is not None and reader.info.topics[area_topic].count == 0:
        area_topic = None
    images = [
        t
        for name in ("image_raw", "image_raw/compressed")
        if (t := find_topic(reader, name, settings.mapping, settings.namespace)) is not None
    ]
    from_images = settings.image_areas == "always" or (
        settings.image_areas == "absent" and area_topic is None
    )
    if from_images and not images:
        raise missing(reader, "contact_area" if settings.image_areas == "absent" else "image_raw")
    if area_topic is None and not from_images:
        raise missing(
            reader, "contact_area", "measure it in the images ('finger-bag process --images')"
        )
    measure = None
    if from_images:
        from .image_areas import ImageAreas

        measure = ImageAreas.for_bag(reader, settings.calibration, settings.area_per_pixel)
    streams = read_streams(
        reader,
        settings.mapping,
        settings.namespace,
        settings.wrench_topic,
        on_image=measure.add if measure else None,
        with_images=from_images,
    )
    if measure is not None:
        for name, values in measure.arrays().items():
            setattr(streams, name, values)
        streams.area_source = "images"
    return streams


def normal_and_lateral(force: np.ndarray, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Normal force (n,), positive in compression, and magnitude of the rest (n,) of forces (n, 3)."""
    column = "xyz".index(axis[1])
    normal = force[:, column] * (1.0 if axis[0] == "+" else -1.0)
    lateral = np.hypot(*(force[:, c] for c in range(3) if c != column))
    return normal, lateral


def presses(
    stamp_ns: np.ndarray,
    force: np.ndarray,
    onset_force: float = 0.05,
    liftoff_force: float = 0.03,
    merge_gap: float = 0.1,
) -> list[tuple[int, int]]:
    """Presses as (first, end) indices into normal forces (n,): first sample at or above onset_force, first below
    liftoff_force after it (n when there is none). Presses closer than merge_gap (s) are one."""
    up, down = force >= onset_force, force < liftoff_force
    marks = np.where(up, 1, np.where(down, -1, 0))
    last = np.maximum.accumulate(np.where(marks != 0, np.arange(len(marks)), -1))
    contact = (last >= 0) & (marks[np.maximum(last, 0)] == 1)
    edges = np.diff(np.concatenate([[0], contact.astype(np.int8), [0]]))
    found: list[tuple[int, int]] = []
    for first, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)):
        if found and (stamp_ns[first] - stamp_ns[found[-1][1] - 1]) * 1e-9 < merge_gap:
            found[-1] = (found[-1][0], int(end))
        else:
            found.append((int(first), int(end)))
    return found


@dataclass
class _Press:
    """A press that may become a trial."""

    first: int
    end: int
    event: TrialEvent | None
    reason: str = ""


def split(
    streams: SessionStreams, metadata: SessionMetadata, settings: TrialSettings, bag: str
) -> TrialSet:
    """Trials in the streams of one bag."""
    metadata = SessionMetadata.from_mapping(
        {**metadata.to_mapping(), **{k: str(v) for k, v in settings.mapping.trial.items()}}
    )
    result = TrialSet(problems=[f"{bag}: {p}" for p in streams.problems])
    normal, lateral = normal_and_lateral(streams.force, settings.axis)
    finite = np.isfinite(normal)
    if not finite.all():
        result.problems.append(f"{bag}: {int((~finite).sum())} wrenches without a finite force")
    stamp, normal, lateral = in_stamp_order(
        streams.wrench_stamp_ns[finite], normal[finite], lateral[finite]
    )
    areas = list(
        in_stamp_order(
            streams.area_stamp_ns,
            streams.area,
            streams.area_sd,
            streams.area_flags,
            streams.real_area,
        )
    )
    found = presses(stamp, normal, settings.onset_force, settings.liftoff_force, settings.merge_gap)
    if streams.trials:
        chosen, without = _by_messages(streams.trials, stamp, normal, found)
    else:
        chosen, without = _by_force(normal, found, settings.minimum_peak), []
    result.exclusions += [
        Exclusion(bag, settings.condition or e.condition, e.index, reason) for e, reason in without
    ]
    if not chosen and not without:
        result.exclusions.append(
            Exclusion(
                bag,
                settings.condition or metadata.condition,
                0,
                f"no press: normal force along {settings.axis} stays below {settings.onset_force} N "
                f"(it runs from {normal.min():.2f} to {normal.max():.2f} N)"
                if len(normal)
                else "no press: no usable wrench",
            )
        )
    moistures = _assign_moistures(streams.moistures, chosen, stamp)
    for number, press in enumerate(chosen):
        record = _record(
            press, number, stamp, normal, lateral, areas, moistures[number], metadata, settings, bag
        )
        record = replace(record, area_source=streams.area_source)
        reason = press.reason
        if not reason and not len(record.area_stamp_ns):
            reason = "no contact area during the press"
        if reason:
            result.exclusions.append(Exclusion(bag, record.condition, record.index, reason))
        else:
            result.trials.append(record)
    return result


def _by_force(
    normal: np.ndarray, found: Sequence[tuple[int, int]], minimum_peak: float
) -> list[_Press]:
    chosen = []
    for first, end in found:
        peak = float(normal[first:end].max())
        reason = "" if peak >= minimum_peak else f"a touch of {peak:.2f} N, no press"
        chosen.append(_Press(first, end, None, reason))
    return chosen


def _by_messages(
    events: Sequence[TrialEvent],
    stamp: np.ndarray,
    normal: np.ndarray,
    found: Sequence[tuple[int, int]],
) -> tuple[list[_Press], list[tuple[TrialEvent, str]]]:
    """The press of each announced trial, and trials without one."""
    groups: dict[tuple[str, int, int], list[TrialEvent]] = {}
    for event in sorted(events, key=lambda e: e.stamp_ns):
        groups.setdefault((event.session, event.index, event.attempt), []).append(event)
    starts = {
        key: next(e.stamp_ns for e in group if e.phase == PHASE_PRESS)
        for key, group in groups.items()
        if any(e.phase == PHASE_PRESS for e in group)
    }
    ordered = sorted(starts, key=lambda key: starts[key])
    chosen: list[_Press] = []
    without: list[tuple[TrialEvent, str]] = []
    for position, key in enumerate(ordered):
        group = groups[key]
        start = starts[key]
        ends = [
            e.stamp_ns
            for e in group
            if e.stamp_ns > start and e.phase in (PHASE_MOISTURE_AFTER, PHASE_DONE, PHASE_FAILED)
        ]
        if position + 1 < len(ordered):
            ends.append(starts[ordered[position + 1]])
        low = np.searchsorted(stamp, start)
        high = np.searchsorted(stamp, min(ends)) if ends else len(stamp)
        inside = [p for p in found if p[0] < high and p[1] > low and p[0] >= low]
        failed = next((e for e in group if e.phase == PHASE_FAILED), None)
        if not inside:
            text = f"marked as failed: {failed.note or 'no reason given'}" if failed else "no press"
            without.append((group[0], text))
            continue
        best = max(inside, key=lambda p: float(normal[p[0] : p[1]].max()))
        reason = f"marked as failed: {failed.note or 'no reason given'}" if failed else ""
        chosen.append(_Press(*best, group[-1], reason))
    # A trial that was only prepared in this bag has no press to lose.
    return chosen, without


def _assign_moistures(
    readings: Sequence[MoistureReading], chosen: Sequence[_Press], stamp: np.ndarray
) -> list[tuple[list[float], list[float]]]:
    """Readings before and after each press: by their phase, else by the press that is nearer in time."""
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


def _record(
    press: _Press,
    number: int,
    stamp: np.ndarray,
    normal: np.ndarray,
    lateral: np.ndarray,
    areas: list[np.ndarray],
    moisture: tuple[list[float], list[float]],
    metadata: SessionMetadata,
    settings: TrialSettings,
    bag: str,
) -> TrialRecord:
    margin = round(settings.margin * 1e9)
    onset = int(stamp[press.first])
    last = int(stamp[min(press.end, len(stamp)) - 1])
    low = int(np.searchsorted(stamp, onset - margin))
    high = int(np.searchsorted(stamp, last + margin, side="right"))
    near = (areas[0] >= onset - margin) & (areas[0] <= last + margin)
    event = press.event
    index = _integer(metadata.trial_index, number) if event is None else event.index
    target = event.target_force if event is not None else _number(metadata.target_force)
    return TrialRecord(
        bag=bag,
        session=(event.session if event else "") or metadata.session,
        subject=settings.subject or (event.subject if event else "") or metadata.subject,
        condition=settings.condition or (event.condition if event else "") or metadata.condition,
        index=index,
        attempt=event.attempt if event else 0,
        target_force=target if target > 0 else DEFAULT_TARGET,
        stamp_ns=stamp[low:high],
        force=normal[low:high],
        lateral_force=lateral[low:high],
        area_stamp_ns=areas[0][near],
        area=areas[1][near],
        area_sd=areas[2][near],
        area_flags=areas[3][near],
        real_area=areas[4][near],
        moisture_before=moisture[0],
        moisture_after=moisture[1],
        onset_ns=onset,
        liftoff_ns=int(stamp[press.end]) if press.end < len(stamp) else None,
    )


def _integer(text: str, default: int) -> int:
    try:
        return int(text) + default
    except ValueError:
        return default


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def _drop_superseded(result: TrialSet) -> None:
    """Of a trial that was redone, keep the last attempt."""
    last: dict[tuple[str, str, str, int], int] = {}
    for trial in result.trials:
        key = (trial.session, trial.subject, trial.condition, trial.index)
        last[key] = max(last.get(key, 0), trial.attempt)
    kept = []
    for trial in result.trials:
        key = (trial.session, trial.subject, trial.condition, trial.index)
        if trial.attempt < last[key]:
            reason = f"attempt {trial.attempt}, done again"
            result.exclusions.append(Exclusion(trial.bag, trial.condition, trial.index, reason))
        else:
            kept.append(trial)
    result.trials = kept
