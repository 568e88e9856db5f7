# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The handshake with the recorder: what it was asked for, and what it answered and reports.

    off → starting → on → stopping → off

Times are those of the protocol's own clock, in nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from finger_bag.streams import TrialEvent
from finger_common.stamps import seconds

from .inputs import REPORT_MEMORY

LATE_REPORT = 0.5
"""s in which reports come that were on their way when the recorder began a bag."""


@dataclass(frozen=True)
class StartRecording:
    """Ask the recorder to begin a bag."""

    path: str
    trial: TrialEvent


@dataclass(frozen=True)
class StopRecording:
    """Ask the recorder to close its bag."""


Request = StartRecording | StopRecording


class RecordingState(str, Enum):
    """What the recorder does, as far as it is known."""

    OFF = "off"
    STARTING = "starting"
    ON = "on"
    STOPPING = "stopping"


class Recording:
    """One bag after another. ask: receives every request, at once."""

    def __init__(self, ask: Callable[[Request], None]) -> None:
        self.state = RecordingState.OFF
        self._ask = ask
        self._asked_ns = 0
        self._asked_path = ""
        self._reported_ns: int | None = None
        self._other_bag_since: int | None = None
        """Since when the recorder reports another bag than that of the attempt, or none."""

    @property
    def is_open(self) -> bool:
        """Whether a bag is open, or will be as soon as the recorder answers."""
        return self.state in (RecordingState.STARTING, RecordingState.ON)

    def start(self, path: str, trial: TrialEvent, now_ns: int) -> None:
        """Ask for a bag."""
        self.state, self._asked_ns, self._asked_path = RecordingState.STARTING, now_ns, path
        self._ask(StartRecording(path, trial))

    def stop(self, now_ns: int) -> None:
        """Ask for the end of the bag."""
        self.state, self._asked_ns = RecordingState.STOPPING, now_ns
        self._ask(StopRecording())

    def is_late(self, now_ns: int, timeout: float) -> bool:
        """Whether the newest request was made more than `timeout` s ago."""
        return seconds(now_ns - self._asked_ns) > timeout

    def started(self, success: bool, asked: str = "") -> bool:
        """An answer to a start; false where it is to an earlier one, which has been stopped since.

        asked: path of the start, where it is known.
        """
        if self.state is not RecordingState.STARTING or asked not in ("", self._asked_path):
            return False
        self.state = RecordingState.ON if success else RecordingState.OFF
        return True

    def stopped(self) -> bool:
        """An answer to a stop; false where it is to an earlier one, and the next bag is being
        opened already."""
        if self.state not in (RecordingState.STOPPING, RecordingState.ON):
            return False
        self.state = RecordingState.OFF
        return True

    def reported(self, bag: str, own: str | None, now_ns: int) -> bool:
        """What the recorder says that it writes; whether it has given up a bag that it should
        write.

        bag: "no" for none. own: bag of the attempt that is being recorded, None without one.
        """
        self._reported_ns = now_ns
        if self.state is not RecordingState.ON or own is None or bag == own:
            self._other_bag_since = None
            return False
        if self._other_bag_since is None:
            self._other_bag_since = now_ns
        return seconds(now_ns - self._other_bag_since) > LATE_REPORT

    def waiting_for(self, now_ns: int) -> str:
        """Why nothing can be recorded yet; empty when nothing is in the way."""
        if self.state is not RecordingState.ON:
            return "the recorder is not running yet"
        reported = self._reported_ns
        if reported is not None and seconds(now_ns - reported) > REPORT_MEMORY:
            return "the recorder is silent"
        return ""
