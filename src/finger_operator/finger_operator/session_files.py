# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a session writes while it is open. What cannot be written is tried again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from finger_bag.bag_files import METADATA
from finger_bag.streams import TrialEvent
from finger_common.cli import one_line
from finger_common.errors import InputError
from finger_common.files import exists
from finger_common.stamps import seconds

from .event_log import EventLog
from .session_store import SavedSession, mark_in_bag, save_state, save_table
from .steps import BETWEEN

WRITE_AGAIN = 5.0
"""s between attempts to write what could not be written."""


class SessionFiles:
    """State file, table of trials, event log, and the marks in the bags of failed attempts.

    session: gives what is to be saved; tell: takes kind and text of what is to be logged.
    """

    def __init__(
        self,
        folder: Path,
        log: EventLog,
        session: Callable[[], SavedSession],
        tell: Callable[[str, str], None],
    ) -> None:
        self.log = log
        self.problem = ""
        """Why the session is not saved, and the remedy; empty where it is."""
        self.unmarked: list[tuple[Path, TrialEvent]] = []
        """Bags of failed attempts and what they are to say of them, once they are closed."""
        self._folder = folder
        self._session = session
        self._tell = tell
        self._tried_ns = 0
        self._saved = False

    @property
    def gone(self) -> str:
        """That the folder, in which the session was saved, is not there any longer; empty where it
        is. It is not made anew, as that could be on another disk."""
        lost = self._saved and not exists(self._folder)
        remedy = "connect its disk, or make this folder anew to go on without what was in it"
        return f"the folder is gone: {remedy}" if lost else ""

    def save(self, state: bool = True) -> None:
        """Write the state file, the table of trials and the event log; without `state` the log
        alone."""
        session = self._session()
        try:
            if self.gone:
                raise InputError(self.gone)
            if state:
                save_state(self._folder, session)
                self._saved = True
            self.log.save()
            if session.step in BETWEEN:
                save_table(self._folder, session.trials, self.log)
            if state:  # else the state may still be unwritten
                self.problem = ""
        except (OSError, InputError) as error:
            reason = one_line(error)
            if isinstance(error, OSError):
                reason = f"{error.strerror or reason}; make room or give access"
            self.problem = f"The session cannot be saved in {self._folder}: {reason}"

    def write_all(self) -> None:
        """Write all that a session leaves; raises InputError while that cannot be."""
        self.mark_bags()
        self.save()
        if self.problem:
            raise InputError(f"{self.problem}, then try again")

    def write_again(self, now_ns: int) -> None:
        """Write what could not be written before, if the last attempt was a while ago."""
        if seconds(now_ns - self._tried_ns) < WRITE_AGAIN:
            return
        self._tried_ns = now_ns
        self.mark_bags()
        if self.problem:
            self.save()

    def mark_bags(self, left: bool = False) -> None:
        """Say in bags what became of their attempts, as far as they are closed. left: the recorder
        writes none of them, also where one is not closed."""
        self.unmarked = [
            (bag, event)
            for bag, event in self.unmarked
            # The recorder may write it still.
            if not ((left or (bag / METADATA).is_file()) and self._mark(bag, event))
        ]

    def _mark(self, bag: Path, event: TrialEvent) -> bool:
        """Say in a bag what became of its attempt; false where that is to be tried again."""
        if self.gone:
            return False  # it may come back
        if not bag.is_dir():
            self._tell("warning", f"{bag} is not there, and is not marked as failed")
            return True
        try:
            mark_in_bag(bag, event)
        except (OSError, InputError) as error:
            text = f"{bag.name} is not marked as failed"
            if not any(e.kind == "fault" and e.text.startswith(text) for e in self.log.events):
                self._tell("fault", f"{text}, which is tried again: {one_line(error)}")
            return False
        return True
