# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The trials of a session: which is next, and what became of the attempts at it."""

from __future__ import annotations

from pathlib import Path

from finger_common.errors import InputError

from .attempt import Attempt, TrialState
from .event_log import EventLog
from .session_store import folder_size
from .study_plan import StudyPlan


class TrialQueue:
    """Trials in the order of a plan. current: index of the one that is next or under way."""

    def __init__(self, plan: StudyPlan) -> None:
        self.trials = [
            TrialState(index, condition) for index, condition in enumerate(plan.trial_conditions())
        ]
        self.current = 0

    @property
    def trial(self) -> TrialState:
        """The current trial."""
        return self.trials[self.current]

    @property
    def attempt(self) -> Attempt:
        """The newest attempt at the current trial."""
        return self.trial.attempts[-1]

    def advance(self) -> bool:
        """Choose the current trial if it is open, else the first open one; false for none."""
        pending = [t.index for t in self.trials if t.verdict == "pending"]
        if pending and self.current not in pending:
            self.current = pending[0]
        return bool(pending)

    def begin_attempt(self, folder: Path, now_ns: int) -> Attempt:
        """A further attempt at the current trial, whose bag comes into a folder."""
        trial = self.trial
        number = len(trial.attempts)
        bag = folder / f"{trial.index:03d}_{trial.condition}_{number}"
        trial.attempts.append(Attempt(number, str(bag), began_ns=now_ns))
        return self.attempt

    def conclude_done(self, now_ns: int) -> None:
        """The newest attempt counts."""
        attempt = self.attempt
        attempt.verdict, attempt.ended_ns = "done", now_ns
        attempt.size = folder_size(Path(attempt.bag))
        self.trial.verdict = "done"

    def conclude_failed(self, reason: str, now_ns: int) -> None:
        """The newest attempt does not count, and its trial is open."""
        attempt = self.attempt
        attempt.verdict, attempt.reason, attempt.ended_ns = "failed", reason, now_ns
        self.trial.verdict = "pending"

    def repeat(self, index: int) -> None:
        """Make a trial that was done or skipped the current one; raises InputError."""
        if not 0 <= index < len(self.trials):
            raise InputError(f"there is no trial {index}; give 0 to {len(self.trials) - 1}")
        self.trials[index].repeat()
        self.current = index

    def skip(self) -> None:
        """Leave the current trial out."""
        self.trial.verdict = "skipped"
        self.trial.give_up_repetition()

    def give_up_repetitions(self) -> None:
        """Let attempts that were to be repeated count again, where none came since."""
        for trial in self.trials:
            if trial.verdict == "pending":
                trial.give_up_repetition()

    def failed_in_a_row(self) -> int:
        """Failed attempts at the current trial."""
        return sum(a.verdict == "failed" for a in self.trial.attempts)

    def last_done(self, log: EventLog) -> TrialState:
        """The trial that was finished last; raises InputError without one."""
        done = [t for t in self.trials if t.attempts and t.verdict == "done"]
        if not done:
            raise InputError("no trial was done yet, so none can be redone")
        # In the order of the log: a clock may be behind that of the day before.
        kept = {e.index: place for place, e in enumerate(log.events) if e.kind == "kept"}
        return max(done, key=lambda t: (kept.get(t.index, -1), t.attempts[-1].began_ns or 0))
