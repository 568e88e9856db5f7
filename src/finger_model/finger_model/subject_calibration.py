# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The calibration of a subject beside the live streams: presses out of them, when it is refused,
which finger is fitted, and what is told of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from finger_common.cli import one_line
from finger_common.contact_threshold import ONSET_FORCE
from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_common.guided_presses import CALIBRATION_PRESSES, PRESS_BY_NAME, is_fitting
from finger_common.moisture import is_moisture
from finger_common.stamps import seconds
from finger_common.trial_phases import TrialPhase

from .anthropometry import GeometryEstimate
from .calibration import Calibration, CalibrationPress, calibrate, on_level_plate, subject_model
from .estimator import EstimatorSettings
from .parameter_sets import ParameterSets
from .pose.correction import PoseCorrection
from .reduced.model import ReducedModel
from .subjects import check_folder, save_subject

MARGIN = 0.3
"""s of rest kept before the touch and after the release."""

LONGEST = 120_000
"""Force samples of one attempt that are kept; an attempt that is held up keeps the newest."""


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

    def __init__(self) -> None:
        self.rejected_flags = int(AreaFlag.NO_CONTACT)
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


def why_refused(index: int, phase: int, note: str, folder: str) -> str:
    """Why a calibration cannot succeed of which this announcement is the first that comes; empty
    where it can.

    folder: of the subjects' parameters, empty for none.
    """
    if phase == TrialPhase.IDLE:
        begun = is_fitting(note)
    else:
        begun = index > 0 or phase in (TrialPhase.PRESS, TrialPhase.LIFT, TrialPhase.DONE)
    if begun:
        return "the model node was started meanwhile and has not seen all presses; begin anew"
    if phase != TrialPhase.IDLE and folder:
        try:
            check_folder(folder)
        except InputError as error:
            return one_line(error)
    return ""


def fit_subject(
    model: ReducedModel,
    sets: ParameterSets,
    presses: Sequence[CalibrationPress],
    moisture: float | None,
    settings: EstimatorSettings,
    calipers: GeometryEstimate | None,
    pose: PoseCorrection | None,
) -> Calibration:
    """Fit a subject's finger to its presses.

    model, sets: in use; calipers: what they told of the finger, None without; pose: in which the
    pad was pressed, None for a round pad on a level plate. Raises InputError as `calibrate`.
    """
    own, lengths = subject_model(model, calipers, sets)
    if pose is not None:
        presses = on_level_plate(presses, own, pose)
    return calibrate(own, sets, presses, moisture, settings, lengths)


@dataclass(frozen=True)
class Answer:
    """What is told of a calibration: a sentence, where the parameters are or why nowhere, and
    numbers with their deviations, for the page and the command."""

    sentence: str
    place: str
    kept: bool
    values: dict[str, str]

    @property
    def message(self) -> str:
        """The sentence, and why the parameters were not kept, if they were not."""
        return self.sentence if self.kept else f"{self.sentence}; {self.place}"


def keep_subject(
    folder: str, subject: str, finger: str, found: Calibration, taken: float
) -> Answer:
    """Write the parameters of a calibration that took so long (s), and tell of it.

    folder: as for `why_refused`.
    """
    rows = {}
    for quantity in found.quantities:
        rows[quantity.name] = f"{quantity.value:.6g}"
        rows[f"{quantity.name}_sd"] = f"{quantity.deviation:.3g}"
    rows["press_scatter"] = f"{found.press_scatter:.4f}"
    rows["presses"], rows["areas"] = str(found.presses), str(found.areas)
    rows["computing_s"] = f"{taken:.2f}"
    reason = "the model node has no 'subjects_folder'"
    if folder:
        try:
            rows["file"] = str(save_subject(folder, subject, found.sets, finger))
            return Answer(found.sentence(), rows["file"], True, rows)
        except InputError as error:
            reason = one_line(error)
    rows["not_kept"] = f"not kept in a file: {reason}"
    return Answer(found.sentence(), rows["not_kept"], False, rows)
