"""A session on disk: the state file, with which a session can be continued, and trials.csv."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean

from finger_common.errors import InputError
from finger_common.files import atomic_write, read_text

from .attempt import Attempt, TrialState
from .event_log import EventLog
from .study_plan import StudyPlan

STATE_VERSION = 1
STATE_FILE = "session.json"
TABLE_FILE = "trials.csv"
COLUMNS = (
    "index,condition,attempt,verdict,time_to_target_s,peak_force_n,frames,moisture_before_au,"
    "moisture_after_au,bag,reason,notes,markers"
).split(",")


@dataclass(frozen=True)
class SavedSession:
    """Contents of a state file."""

    plan: StudyPlan
    step: str
    paused: bool
    current: int
    trials: list[TrialState]
    ended: str = ""


def save_state(folder: Path, session: SavedSession) -> None:
    """Write the state file."""
    state = {
        "version": STATE_VERSION,
        "plan": session.plan.to_dict(),
        "step": session.step,
        "paused": session.paused,
        "current": session.current,
        "ended": session.ended,
        "trials": [asdict(trial) for trial in session.trials],
    }
    with atomic_write(folder / STATE_FILE) as file:
        json.dump(state, file, indent=1)


def load_state(folder: Path) -> SavedSession:
    """Read the state file; raises InputError naming it when it cannot be used."""
    path = folder / STATE_FILE
    try:
        state = json.loads(read_text(path, "session state"))
        if state.get("version") != STATE_VERSION:
            raise InputError(
                f"{path}: version {state.get('version')} is not {STATE_VERSION}; "
                "start a new session"
            )
        trials = [
            TrialState(
                trial["index"],
                trial["condition"],
                trial["verdict"],
                [Attempt(**attempt) for attempt in trial["attempts"]],
            )
            for trial in state["trials"]
        ]
        current = int(state["current"])
        trials[current]
        plan = StudyPlan.from_dict(state["plan"])
        step, paused, ended = str(state["step"]), bool(state["paused"]), state.get("ended", "")
        return SavedSession(plan, step, paused, current, trials, str(ended))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(
            f"{path}: not a session state ({error!r}); move it away to start a new session"
        ) from None


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
                    )
                )


def folder_size(folder: Path) -> int:
    """Bytes of the files in a folder, as a bag; 0 where there is none."""
    try:
        return sum(f.stat().st_size for f in folder.iterdir() if f.is_file())
    except OSError:
        return 0


def sessions_by_subject(output: Path) -> dict[str, list[str]]:
    """Folders of the sessions in `output`, by subject code; what cannot be read is left out."""
    found: dict[str, list[str]] = {}
    for path in sorted(output.glob(f"*/{STATE_FILE}")):
        try:
            subject = load_state(path.parent).plan.subject
        except InputError:
            continue
        found.setdefault(subject, []).append(path.parent.name)
    return found


def free_space(folder: Path) -> int | None:
    """Bytes free on the disk that holds the folder, which need not exist yet; None if unknown."""
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    try:
        return shutil.disk_usage(existing).free
    except OSError:
        return None
