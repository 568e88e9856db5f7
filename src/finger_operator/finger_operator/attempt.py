# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The trials of a session and their attempts, as kept in the state file and in trials.csv."""

from __future__ import annotations

from dataclasses import dataclass, field

from finger_common.stamps import seconds


@dataclass
class Attempt:
    """One attempt at a trial and its result.

    verdict: running, done, failed or superseded. Stamps are in ns, forces in N, gaps in s, the
    size of the bag in bytes; None for an event that did not occur. friction: that of a pull that
    slipped, 0 where there was none.
    """

    attempt: int
    bag: str = ""
    verdict: str = "running"
    reason: str = ""
    began_ns: int | None = None
    ended_ns: int | None = None
    onset_ns: int | None = None
    cue_ns: int | None = None
    lifted_ns: int | None = None
    peak_force: float = 0.0
    samples: int = 0
    frames: int = 0
    size: int = 0
    longest_gap: float = 0.0
    longest_frame_gap: float = 0.0
    pull_ns: int | None = None
    slip_ns: int | None = None
    friction: float = 0.0
    friction_stddev: float = 0.0
    moisture_before: list[float] = field(default_factory=list)
    moisture_after: list[float] = field(default_factory=list)

    @property
    def time_to_target(self) -> float | None:
        """s from onset to the cue to lift."""
        if self.onset_ns is None or self.cue_ns is None:
            return None
        return seconds(self.cue_ns - self.onset_ns)

    @property
    def found(self) -> str:
        """What a pull has found, for people; empty for a press."""
        if self.slip_ns is None:
            return ""
        return f"slipped, friction {self.friction:.2f} ± {self.friction_stddev:.2f}"


def scattered(step: str, readings: list[float], limit: float) -> str:
    """That readings (a.u.) of a step, before or after, lie farther apart than a limit; empty where
    they do not."""
    spread = max(readings, default=0.0) - min(readings, default=0.0)
    if spread <= limit:
        return ""
    values = ", ".join(f"{value:g}" for value in readings)
    return (
        f"The readings {step} the press are {spread:.0f} a.u. apart ({values}). Redo the trial if "
        "the probe was not held well."
    )


@dataclass
class TrialState:
    """One trial of the plan; `verdict` is pending, done or skipped."""

    index: int
    condition: str
    verdict: str = "pending"
    attempts: list[Attempt] = field(default_factory=list)

    def repeat(self) -> None:
        """Let the attempt that counted count no more."""
        for attempt in self.attempts:
            if attempt.verdict == "done":
                attempt.verdict, attempt.reason = "superseded", "repeated by the operator"
        self.verdict = "pending"

    def give_up_repetition(self) -> None:
        """Let the newest attempt that was to be repeated count again, if there is one."""
        for attempt in reversed(self.attempts):
            if attempt.verdict == "superseded":
                attempt.verdict, attempt.reason, self.verdict = "done", "", "done"
                break
