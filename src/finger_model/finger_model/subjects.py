# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files of subjects, and the presses of a calibration out of the live streams."""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from finger_common.contact_threshold import ONSET_FORCE
from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_common.guided_presses import CALIBRATION_PRESSES, FITTING, PRESS_BY_NAME
from finger_common.moisture import is_moisture
from finger_common.stamps import seconds
from finger_common.subject_code import check_subject
from finger_common.trial_phases import TrialPhase

from .calibration import CalibrationPress
from .parameter_sets import ParameterSets

MARGIN = 0.3
"""s of rest kept before the touch and after the release."""

LONGEST = 120_000
"""Force samples of one attempt that are kept; an attempt that is held up keeps the newest."""


def subject_file(folder: str | Path, subject: str) -> Path:
    """Where the parameters of a subject are; raises InputError for a code that is no file name."""
    return Path(folder).expanduser() / f"{check_subject(subject)}.yaml"


def check_folder(folder: str | Path) -> None:
    """Make the folder of the subjects' parameters if need be; raises InputError where nothing can
    be written into it.
    """
    path = Path(folder).expanduser()
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        raise InputError(
            f"{path}: no subject can be kept there ({error.strerror}); choose another "
            "'subjects_folder'"
        ) from None


def save_subject(folder: str | Path, subject: str, sets: ParameterSets) -> Path:
    """Write a subject's parameters; those of before are kept beside them with their date.

    Raises InputError when the folder cannot be written to.
    """
    path = subject_file(folder, subject)
    try:
        if path.exists():
            made = time.strftime("%Y%m%dT%H%M%S", time.localtime(path.stat().st_mtime))
            earlier = path.with_name(f"{subject}.{made}.yaml")
            shutil.copy2(path, earlier)
        sets.save(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return path


class _Attempt:
    """What the streams gave in one attempt at a press."""

    def __init__(self) -> None:
        self.forces: list[tuple[int, float]] = []
        self.areas: list[tuple[int, float, float]] = []


class PressCollector:
    """Keeps the presses of a calibration, announcement by announcement, in no thread of its own.

    Feed it the announcements of trials and the streams while `collecting`. An attempt that is done
    is kept, one that failed or is made again is not.
    """

    def __init__(self, rejected_flags: int = int(AreaFlag.NO_CONTACT)) -> None:
        self.rejected_flags = rejected_flags
        self._session = ""
        self._key: tuple[int, int] | None = None
        self._attempt = _Attempt()
        self._kept: dict[int, _Attempt] = {}
        self._readings: list[float] = []
        self._given = False

    @property
    def collecting(self) -> bool:
        """Whether an attempt at a press of a calibration is under way."""
        return self._key is not None

    def begins(self, session: str, condition: str) -> bool:
        """Whether this is the first announcement of a calibration that comes."""
        return session != self._session and condition in PRESS_BY_NAME

    @staticmethod
    def presses_before(index: int, phase: int, note: str) -> bool:
        """Whether presses were begun before this announcement of a calibration."""
        if phase == TrialPhase.IDLE:
            return note == FITTING
        return index > 0 or phase in (TrialPhase.PRESS, TrialPhase.LIFT, TrialPhase.DONE)

    def announce(self, session: str, condition: str, index: int, attempt: int, phase: int) -> bool:
        """A trial is in this phase now; true, once, when all presses of a calibration are done."""
        if session != self._session:
            self._session = session
            self._kept.clear()
            self._readings.clear()
        if condition not in PRESS_BY_NAME:
            self._key = None
            return False
        if phase in (TrialPhase.DONE, TrialPhase.FAILED, TrialPhase.PAUSED):
            if phase == TrialPhase.DONE and self._key == (index, attempt):
                self._kept[index] = self._attempt
            elif phase == TrialPhase.FAILED:
                self._kept.pop(index, None)
            self._key = None
        elif phase == TrialPhase.IDLE:
            self._key = None
            complete = len(self._kept) == len(CALIBRATION_PRESSES) and not self._given
            self._given = self._given or complete
            return complete
        elif self._key != (index, attempt):
            self._key, self._attempt, self._given = (index, attempt), _Attempt(), False
            self._kept.pop(index, None)
        return False

    def add_force(self, stamp_ns: int, normal_force: float) -> None:
        """One sample in N."""
        if math.isfinite(normal_force):
            forces = self._attempt.forces
            if not forces or stamp_ns > forces[-1][0]:
                forces.append((stamp_ns, normal_force))
            if len(forces) > LONGEST:
                del forces[: LONGEST // 10]

    def add_area(self, stamp_ns: int, area: float, sd: float, flags: int) -> None:
        """One measured area and its deviation in m²."""
        if not flags & self.rejected_flags:
            self._attempt.areas.append((stamp_ns, area, sd))

    def add_moisture(self, value: float) -> None:
        """One reading in a.u."""
        if is_moisture(value):
            self._readings.append(value)

    def moisture(self) -> float | None:
        """Mean reading of the calibration in a.u.; None where there was none."""
        return float(np.mean(self._readings)) if self._readings else None

    def presses(self) -> list[CalibrationPress]:
        """The kept presses in the order they were made, each from just before its touch."""
        found = [_cut(a.forces, a.areas) for a in self._kept.values()]
        presses = [press for press in found if press is not None]
        presses.sort(key=lambda press: press[0])
        if not presses:
            return []
        start = presses[0][0]
        return [
            CalibrationPress(seconds(stamps - start), force, seconds(instants - start), area, sd)
            for _, stamps, force, instants, area, sd in presses
        ]


def _cut(
    forces: Sequence[tuple[int, float]], areas: Sequence[tuple[int, float, float]]
) -> tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Of the contact: first stamp; stamps, forces; stamps, areas and deviations of the areas."""
    stamps = np.array([stamp for stamp, _ in forces], np.int64)
    force = np.array([value for _, value in forces])
    touching = np.flatnonzero(force > ONSET_FORCE)
    if not len(touching):
        return None
    margin = round(MARGIN * 1e9)
    first, last = stamps[touching[0]] - margin, stamps[touching[-1]] + margin
    inside = (stamps >= first) & (stamps <= last)
    ordered = sorted({stamp: (area, sd) for stamp, area, sd in areas}.items())
    kept = [(s, a, d) for s, (a, d) in ordered if first <= s <= last]
    columns = list(zip(*kept)) or [(), (), ()]
    return (
        int(stamps[inside][0]),
        stamps[inside],
        force[inside],
        np.array(columns[0], np.int64),
        np.array(columns[1], float),
        np.array(columns[2], float),
    )
