# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Trials of bags: `load_trials` reads, splits and drops attempts that were done again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from finger_bag.bag_files import METADATA, find_bags
from finger_bag.reader import BagReader, open_bag
from finger_bag.streams import (
    IMAGES,
    SessionStreams,
    apart,
    find_topic,
    find_used,
    find_wrench,
    missing,
    read_streams,
)
from finger_common.errors import InputError, listed
from finger_common.subject_code import may_be_one

from .image_areas import ImageAreas
from .trial_records import Exclusion, TrialRecord, TrialSet
from .trial_split import TrialSettings, split


class NoAreas(InputError):
    """A bag does not hold the areas or images that are asked for; found: what is left of it, an
    exclusion of all that it holds."""

    def __init__(self, message: str, found: TrialSet) -> None:
        super().__init__(message)
        self.found = found


def load_trials(
    paths: str | Path | Iterable[str | Path],
    settings: TrialSettings | None = None,
) -> TrialSet:
    """Trials of bags; see TrialSettings for what can be set.

    Raises InputError for a bag that cannot be read or holds no wrench, and when all bags hold
    neither contact_area nor images.
    """
    settings = settings or TrialSettings()
    result = TrialSet()
    bags = find_bags([paths] if isinstance(paths, (str, Path)) else paths)
    lacking: list[NoAreas] = []
    for bag in bags:
        try:
            with open_bag(bag) as reader:
                found = trials_of(reader, settings)
        except NoAreas as error:
            lacking.append(error)
            found = error.found
        result.trials += found.trials
        result.pulls += found.pulls
        result.exclusions += found.exclusions
        result.problems += found.problems
        result.lost += found.lost
    check_areas(lacking, len(bags))
    result.problems += shared_sessions(result.trials)
    result.trials, again = without_superseded(result.trials)
    result.exclusions += again
    return result


def trials_of(reader: BagReader, settings: TrialSettings) -> TrialSet:
    """Trials of one opened bag."""
    return trials_in(reader, streams_with_areas(reader, settings), settings)


def trials_in(reader: BagReader, streams: SessionStreams, settings: TrialSettings) -> TrialSet:
    """Trials of the streams of a bag that were read to its end."""
    found = split(streams, reader.info.metadata, settings, str(reader.path))
    found.lost = [str(reader.path)] if reader.lost else []
    return found


def streams_with_areas(reader: BagReader, settings: TrialSettings) -> SessionStreams:
    """Streams of a bag, with areas from its images where the settings ask for it.

    Raises NoAreas when there are no areas and no images to take them from.
    """
    find_wrench(reader, settings)
    has_areas = find_used(reader, "contact_area", settings) is not None
    from_images = settings.image_areas == "always" or not has_areas
    if from_images and not any(find_topic(reader, name, settings) for name in IMAGES):
        needed, lacks = "image_raw", "no images"
        if settings.image_areas == "absent":
            needed, lacks = "contact_area", "no contact areas or images"
        about = reader.info.metadata
        reason = f"{lacks} were found; if a topic of another name holds them, give a mapping file"
        whole = Exclusion(str(reader.path), about.condition, None, reason, about.subject)
        lost = [str(reader.path)] if reader.lost else []
        problems = [f"{reader.path}: {problem}" for problem in reader.all_problems()]
        found = TrialSet(exclusions=[whole], problems=problems, lost=lost)
        raise NoAreas(str(missing(reader, needed)), found)
    measure = ImageAreas.for_bag(reader, settings) if from_images else None
    streams = read_streams(
        reader,
        settings,
        on_image=measure.add if measure else None,
        with_images=from_images,
    )
    measured = IMAGES if from_images else ("contact_area",)
    if warning := apart(reader, settings, ("wrench", *measured)):
        streams.problems.insert(0, warning)
    if measure is not None:
        streams.areas, streams.area_source = measure.table(), "images"
        streams.problems += measure.problems()
    return streams


def check_areas(lacking: Sequence[NoAreas], bags: int) -> None:
    """Raise InputError when all of so many bags are without areas."""
    if lacking and len(lacking) == bags:
        raise lacking[0]


def without_superseded(
    trials: Sequence[TrialRecord],
) -> tuple[list[TrialRecord], list[Exclusion]]:
    """Of trials that were done again, also in another bag of the folder, the last attempt, of those
    that were completed where there are any, also in another folder; and the others."""
    last: dict[tuple[Any, ...], tuple[bool, int]] = {}
    numbers = _numbers(trials)
    completed = {number for trial, number in zip(trials, numbers) if trial.completed}
    for trial, number in zip(trials, numbers):
        key = (_folder(trial), *number)
        rank = (trial.completed, trial.attempt)
        # A disk that was full may have the failed attempt, and another one the trial.
        least = (number in completed, 0)
        last[key] = max(last.get(key, rank), rank, least)
    kept, again = [], []
    for trial, number in zip(trials, numbers):
        key = (_folder(trial), *number)
        if (trial.completed, trial.attempt) < last[key]:
            why = "done again" if trial.attempt < last[key][1] else "not completed, unlike another"
            reason = f"attempt {trial.attempt}, {why}"
            again.append(Exclusion(trial.bag, trial.condition, trial.index, reason, trial.subject))
        else:
            kept.append(trial)
    return kept, again


def shared_sessions(trials: Sequence[TrialRecord]) -> list[str]:
    """Sentences on sessions of one id that were recorded in several folders: whether a trial of one
    was done again in the other is not known."""
    folders: dict[tuple[Any, ...], list[Path]] = {}
    done = [t for t in trials if t.session and t.completed]
    for trial, number in zip(done, _numbers(done)):
        known = folders.setdefault(number, [])
        known += [folder] if (folder := _folder(trial)) not in known else []
    places = {number[:2]: found for number, found in folders.items() if len(found) > 1}
    return [
        f"session '{session}' of subject {subject or 'without a code'} is in several folders "
        f"({listed(found)}) with trials of the same numbers; all of them are kept: leave out "
        "what is a copy or was done again, and give two people two codes"
        for (session, subject), found in places.items()
    ]


def _numbers(trials: Sequence[TrialRecord]) -> list[tuple[Any, ...]]:
    """What each trial has in common with its other attempts: numbers may begin again with each
    session, subject, condition and finger, unless the fingers of a number may be one."""
    numbers = [(t.session, t.subject, t.condition, t.index) for t in trials]
    fingers: dict[tuple[Any, ...], set[str]] = {}
    for trial, number in zip(trials, numbers):
        fingers.setdefault(number, set()).add(trial.finger)
    return [
        (*number, "" if may_be_one(*fingers[number]) else trial.finger)
        for trial, number in zip(trials, numbers)
    ]


def _folder(trial: TrialRecord) -> Path:
    """Where the bag of a trial is: two laboratories may give their sessions the same id."""
    path = Path(trial.bag).resolve()
    inside = path.is_file() and (path.parent / METADATA).is_file()
    return path.parents[1] if inside else path.parent
