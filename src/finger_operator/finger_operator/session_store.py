# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A session on disk: the state file, with which a session can be continued, and trials.csv."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from finger_bag.reader import open_bag
from finger_bag.schema import TOPICS, full_name
from finger_bag.streams import TrialEvent
from finger_bag.writer import add_message
from finger_common.errors import InputError
from finger_common.files import atomic_write, load_json
from finger_common.plugins import Plugins
from finger_common.subject_code import alike

from .attempt import Attempt, TrialState
from .event_log import EventLog
from .steps import UNDER_WAY, Step
from .study_plan import StudyPlan

STATE_VERSION = 1
STATE_FILE = "session.json"
TABLE_FILE = "trials.csv"
COLUMNS = (
    "index,condition,attempt,verdict,time_to_target_s,peak_force_n,frames,moisture_before_au,"
    "moisture_after_au,bag,reason,notes,markers,friction,friction_stddev"
).split(",")


FURTHER_FILES = Plugins("finger_operator.session_file", "file of a session")
"""Files that other packages add to a session when it begins, by name: functions that take the plan
(as in session.json) and give the text, or None where the plan has not what they need."""

VERDICTS = ("pending", "done", "skipped")
DEFAULTS = asdict(Attempt(1))


@dataclass(frozen=True)
class SavedSession:
    """Contents of a state file."""

    plan: StudyPlan
    step: Step
    paused: bool
    current: int
    trials: list[TrialState]
    ended: str = ""


def save_state(folder: Path, session: SavedSession) -> None:
    """Write the state file, so that it survives a crash of the computer."""
    trials = [asdict(trial) for trial in session.trials]
    for attempt in (a for trial in trials for a in trial["attempts"]):
        attempt["bag"] = Path(attempt["bag"]).name  # sessions are moved and copied
    state = {
        "version": STATE_VERSION,
        "plan": session.plan.to_dict(),
        "step": session.step.value,
        "paused": session.paused,
        "current": session.current,
        "ended": session.ended,
        "trials": trials,
    }
    with atomic_write(folder / STATE_FILE, durable=True) as file:
        json.dump(state, file, indent=1)


def load_state(folder: Path) -> SavedSession:
    """Read the state file; raises InputError naming it when it cannot be used."""
    path = folder / STATE_FILE
    try:
        state = load_json(path, "session state")
        if state.get("version") != STATE_VERSION:
            raise InputError(f"version {state.get('version')} is not {STATE_VERSION}")
        plan = StudyPlan.from_dict(state["plan"])
        trials = [_trial(trial, plan) for trial in state["trials"]]
        for attempt in (a for trial in trials for a in trial.attempts if a.bag):
            attempt.bag = str(folder / Path(attempt.bag).name)
        current = state["current"]
        _check(type(current) is int and 0 <= current < len(trials), "current", current)
        _check(state["step"] in set(Step), "step", state["step"])
        step = Step(state["step"])
        recorded = step in UNDER_WAY or step is Step.CLOSING
        _check(bool(trials[current].attempts) or not recorded, "step without attempt", step.value)
        ended = str(state.get("ended", ""))
        return SavedSession(plan, step, bool(state["paused"]), current, trials, ended)
    except (InputError, KeyError, TypeError, ValueError, AttributeError) as error:
        reason = str(error).removeprefix(f"{path}: ")
        if not isinstance(error, (InputError, ValueError)):
            reason = f"{type(error).__name__}: {reason}"
        raise InputError(
            f"{path}: not a session state ({reason[:200]}); move it away to start a new session"
        ) from None


def _check(right: bool, name: str, value: object) -> None:
    if not right:
        raise ValueError(f"{name} is {str(value)[:60]!r}")


def _trial(data: dict[str, Any], plan: StudyPlan) -> TrialState:
    """A trial of the state file; raises ValueError where its values are no trial's.

    The condition is a part of the bags' names, and the plan has checked its conditions.
    """
    index, condition, verdict = data["index"], data["condition"], data["verdict"]
    _check(type(index) is int and index >= 0, "index", index)
    _check(condition in plan.conditions, "condition", condition)
    _check(verdict in VERDICTS, "verdict", verdict)
    attempts = [Attempt(**attempt) for attempt in data["attempts"]]
    for attempt in attempts:
        for name, value in asdict(attempt).items():
            _check(_fits(value, DEFAULTS[name]), name, value)
        _check(attempt.attempt >= 0, "attempt", attempt.attempt)
    return TrialState(index, condition, verdict, attempts)


def _fits(value: object, default: object) -> bool:
    """Whether a value of an attempt has the type of its default; None stands for a stamp."""
    if default is None:
        return value is None or type(value) is int
    if isinstance(default, list):
        return isinstance(value, list) and all(_fits(v, 0.0) for v in value)
    if isinstance(default, float):
        return isinstance(value, (int, float)) and math.isfinite(value)
    return type(value) is type(default)


def further_files(plan: StudyPlan) -> dict[str, str]:
    """Text of each further file of a session; raises InputError for a plan that cannot be right."""
    texts = {name: FURTHER_FILES.load(name)(plan.to_dict()) for name in FURTHER_FILES.names()}
    return {name: text for name, text in texts.items() if text is not None}


def save_table(folder: Path, trials: Sequence[TrialState], log: EventLog) -> None:
    """Write one row per attempt, with the notes and the number of markers of the log."""
    with atomic_write(folder / TABLE_FILE) as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for trial in trials:
            for a in trial.attempts:
                time, moisture = a.time_to_target, (a.moisture_before, a.moisture_after)
                rows.writerow(
                    (
                        trial.index,
                        trial.condition,
                        a.attempt,
                        a.verdict,
                        "" if time is None else f"{time:.3f}",
                        f"{a.peak_force:.4f}",
                        a.frames,
                        *(f"{fmean(m):.2f}" if m else "" for m in moisture),
                        Path(a.bag).name,
                        a.reason,
                        "; ".join(e.text for e in log.of("note", trial.index, a.attempt)),
                        len(log.of("marker", trial.index, a.attempt)),
                        *(
                            (f"{a.friction:.4f}", f"{a.friction_stddev:.4f}")
                            if a.found
                            else ("",) * 2
                        ),
                    )
                )


def folder_size(folder: Path) -> int:
    """Bytes of the files in a folder, as a bag; 0 where there is none."""
    try:
        return sum(f.stat().st_size for f in folder.iterdir() if f.is_file())
    except OSError:
        return 0


def mark_in_bag(bag: Path, event: TrialEvent) -> None:
    """Write what became of a trial into its bag, which its recorder has left: whoever reads the bag
    learns it there. Raises InputError where that cannot be."""
    with open_bag(bag) as reader:
        topic = reader.topic("trial") or full_name("trial")
        after = (reader.info.end_ns or 0) + 1
    values = {**vars(event)}
    values["header"] = {"stamp": values.pop("stamp_ns"), "frame_id": values.pop("finger")}
    add_message(bag, topic, TOPICS["trial"].type, values, max(event.stamp_ns, after))


def saved_plans(output: Path) -> dict[str, StudyPlan]:
    """Plans of the sessions in `output`, by folder; what cannot be read is left out."""
    found = {}
    for path in sorted(output.glob(f"*/{STATE_FILE}")):
        with suppress(InputError):
            found[path.parent.name] = load_state(path.parent).plan
    return found


def sessions_by_subject(plans: Mapping[str, StudyPlan]) -> dict[str, list[str]]:
    """Folders of the sessions by subject code. plans: by folder."""
    found: dict[str, list[str]] = {}
    for folder, plan in plans.items():
        found.setdefault(plan.subject, []).append(folder)
    return found


def earlier_sessions(used: Mapping[str, Sequence[str]], plan: StudyPlan) -> list[str]:
    """Of the sessions by subject code, those that may be of the same person as that of the plan,
    with the code where it was written in another way."""
    return [
        session if code == plan.subject else f"{session} as {code}"
        for code, sessions in used.items()
        if alike(code) == alike(plan.subject)
        for session in sessions
        if session != plan.session
    ]


def free_space(folder: Path) -> int | None:
    """Bytes free on the disk that holds the folder, which need not exist yet; None if unknown."""
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    try:
        return shutil.disk_usage(existing).free
    except OSError:
        return None
