# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Everything that the operator's page shows of a session, as plain data.

Without an open session, `step` is "closed" and only `plan`, `preparations`, `instruction`,
`used_subjects` and `disk` are there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from statistics import median, median_low
from typing import Any

from finger_common.guided_pulls import PULL_TEXT, is_pull
from finger_common.stamps import seconds

from .attempt import TrialState, scattered
from .event_log import Event
from .protocol import Protocol
from .steps import Step
from .study_plan import CLEAN_PLATE, CLEAN_PLATE_PULL, PlanSettings, preparation_of

EVENTS_SHOWN = 60

GIGABYTE = 1e9

LONGEST_WAIT = 1800.0
"""s between two trials above which it was a break, which does not belong to the pace."""

USUAL_SIZE = 220_000_000
"""Bytes of a trial with images; stands in until one was kept."""


def closed_status(
    plan: PlanSettings,
    preparations: dict[str, str],
    used_subjects: dict[str, list[str]],
    used_conditions: Iterable[str],
    free: int | None,
) -> dict[str, Any]:
    """While no session is open. plan: of the next one. used_subjects: sessions by subject code.

    used_conditions: of earlier sessions, which have a preparation too. free: bytes left on the disk
    of the sessions, None when unknown.
    """
    return {
        "step": "closed",
        "instruction": "Press Space to start a session.",
        "plan": plan.to_dict(),
        "preparations": {
            **preparations,
            **{c: preparation_of(c, preparations) for c in used_conditions},
        },
        "used_subjects": used_subjects,
        "disk": {"free_gb": _gigabytes(free)},
    }


def session_status(
    protocol: Protocol,
    free: int | None = None,
    earlier_sessions: list[str] | None = None,
    reserve: int = 0,
) -> dict[str, Any]:
    """The session, the current trial and a row for each trial.

    free: bytes left on the disk of the sessions, None when unknown. earlier_sessions: of this
    subject, or of a code like it. reserve: bytes that the recorder leaves free.
    """
    plan = protocol.plan
    trial = protocol.trials[protocol.current]
    begun = trial.attempts and protocol.step is not Step.PREPARE
    attempt = trial.attempts[-1] if begun else None
    waiting = protocol.step is Step.CLEAR and not protocol.paused
    disk = disk_status(protocol, free, reserve)
    return {
        "subject": plan.subject,
        "session": plan.session,
        "step": protocol.step.value,
        "paused": protocol.paused,
        "ended": protocol.ended,
        "message": protocol.message,
        "instruction": instruction(protocol),
        "waiting_for": protocol.waiting_for() if waiting else "",
        "index": trial.index,
        "attempt": attempt.attempt if attempt else len(trial.attempts),
        "condition": trial.condition,
        "preparation": plan.preparation(trial.condition),
        # Also those of other conditions: the participant's come by the condition of the cue.
        "preparations": {**plan.preparations, **{c: plan.preparation(c) for c in plan.conditions}},
        "prompt": CLEAN_PLATE_PULL if is_pull(trial.condition) else CLEAN_PLATE,
        "target_force": plan.press_of(trial.condition).target_force,
        "readings": plan.readings,
        "moisture_before": attempt.moisture_before if attempt else [],
        "moisture_after": attempt.moisture_after if attempt else [],
        "recording": protocol.recording.state.value,
        "conditions": list(plan.conditions),
        "plan": PlanSettings.to_dict(plan),
        "folder": str(protocol.folder),
        "trials": [_row(protocol, trial) for trial in protocol.trials],
        "notes": [_remark(e) for e in protocol.log.of("note")],
        "markers": [_remark(e) for e in protocol.log.of("marker")],
        "events": [_event(e) for e in protocol.log.events[-EVENTS_SHOWN:]],
        "summary": summary(protocol),
        "time_left": time_left(protocol),
        "disk": disk,
        "warnings": _warnings(protocol, disk, earlier_sessions or []),
    }


def instruction(protocol: Protocol) -> str:
    """What the operator does now, in one sentence or two."""
    step, plan = protocol.step, protocol.plan
    trial = protocol.trials[protocol.current]
    if protocol.paused:
        return protocol.message or "Press Space to go on."
    if step is Step.FINISHED:
        text = summary(protocol)["text"]
        return f"{protocol.message} {text}" if protocol.plan.is_calibration else text
    if protocol.message:
        return protocol.message
    if step in (Step.MOISTURE_BEFORE, Step.MOISTURE_AFTER):
        attempt = trial.attempts[-1]
        before = step is Step.MOISTURE_BEFORE
        taken = len(attempt.moisture_before if before else attempt.moisture_after)
        wanted = protocol.plan.readings
        return f"Hold the probe to the fingertip ({min(taken + 1, wanted)} of {wanted})."
    if step is Step.FAILED:
        reason = trial.attempts[-1].reason
        again = "" if protocol.ended or trial.verdict == "skipped" else " The trial is repeated."
        return f"{reason[:1].upper()}{reason[1:]}.{again}"
    return {
        Step.IDLE: "Press Space to begin.",
        Step.PREPARE: (plan.is_calibration and plan.press_of(trial.condition).text)
        or "Prepare finger and plate, then press Space.",
        Step.CLEAR: protocol.waiting_for() or "Hands off: the plate must be empty.",
        Step.PRESS: plan.press_of(trial.condition).text or "Press until the cue changes.",
        Step.PULL: PULL_TEXT,
        Step.LIFT: "Lift the finger.",
        Step.CLOSING: "Saving the trial.",
        Step.DONE: f"Trial {trial.index + 1} kept{_found(trial)}.",
    }[step]


def _found(trial: TrialState) -> str:
    found = trial.attempts[-1].found if trial.attempts else ""
    return f": {found}" if found else ""


def summary(protocol: Protocol) -> dict[str, Any]:
    """Counts of the trials of the session, and at its end what they say and what to do."""
    count = Counter(trial.verdict for trial in protocol.trials)
    failed = sum(a.verdict == "failed" for t in protocol.trials for a in t.attempts)
    planned, kept, skipped = len(protocol.trials), count["done"], count["skipped"]
    open_trials = count["pending"]
    text = ""
    if protocol.step is Step.FINISHED:
        parts = [f"{kept} of {planned} trials kept"]
        parts += [f"{skipped} skipped"] if skipped else []
        parts += [f"{open_trials} not done"] if open_trials else []
        begin = f"Session {protocol.ended}" if protocol.ended else "Finished"
        advice = []
        if protocol.ended and open_trials:
            advice.append("resume to go on")
        if skipped:
            advice.append("repeat the skipped trials from the list")
        advice.append("press Space to close the session")
        sentence = ", or ".join([", ".join(advice[:-1]), advice[-1]] if advice[:-1] else advice)
        text = f"{begin}: {', '.join(parts)}. {sentence[0].upper()}{sentence[1:]}."
    return {
        "planned": planned,
        "kept": kept,
        "skipped": skipped,
        "open": open_trials,
        "failed_attempts": failed,
        "text": text,
    }


def time_left(protocol: Protocol) -> float | None:
    """s until the open trials are done at the pace of those that were kept; None before two."""
    kept = sorted(
        (a.ended_ns, a.began_ns)
        for t in protocol.trials
        for a in t.attempts
        if a.verdict == "done" and a.ended_ns and a.began_ns
    )
    if len(kept) < 2:
        return None
    # With what came before the trial, but for a long break and where the clock was changed.
    breaks = [seconds(began - before) for (before, _), (_, began) in pairwise(kept)]
    paces = [
        seconds(ended - began) + (wait if 0.0 <= wait <= LONGEST_WAIT else 0.0)
        for (ended, began), wait in zip(kept[1:], breaks)
    ]
    return round(median_low(paces) * sum(t.verdict == "pending" for t in protocol.trials), 1)


def disk_status(protocol: Protocol, free: int | None, reserve: int = 0) -> dict[str, Any]:
    """Space on the disk of the sessions against what the open trials need, by those kept so far.

    free, reserve: as in `session_status`. Until a trial was kept, all but `free_gb` is None where
    there is room for a usual one.
    """
    sizes = [a.size for t in protocol.trials for a in t.attempts if a.size]
    room = None if free is None else max(free - reserve, 0)
    first_fits = not protocol.limits.need_recorder or room is None or room >= USUAL_SIZE
    if room is None or (not sizes and first_fits):
        return {"free_gb": _gigabytes(free), "needed_gb": None, "trials_left": None, "enough": None}
    each = median(sizes or [USUAL_SIZE])
    open_trials = sum(t.verdict == "pending" for t in protocol.trials)
    return {
        "free_gb": _gigabytes(free),
        "needed_gb": _gigabytes(math.ceil(each * open_trials)),
        "trials_left": int(room / each),
        "enough": each * open_trials <= room,
    }


def _warnings(protocol: Protocol, disk: dict[str, Any], earlier_sessions: list[str]) -> list[str]:
    """Sentences that the operator should see, without effect on the trials."""
    found = []
    if protocol.files.problem:
        found.append(f"{protocol.files.problem}. It is tried again.")
    if disk["enough"] is False:
        number = disk["trials_left"]
        room = f"room for only {number} more {'trial' if number == 1 else 'trials'}"
        found.append(
            f"The disk has {room if number else 'no room for another trial'}. Delete files that "
            "are not needed, or end the session early."
        )
    trial = protocol.trials[protocol.current]
    if trial.attempts and protocol.step is not Step.PREPARE:
        attempt, limit = trial.attempts[-1], protocol.limits.moisture_spread
        readings = {"before": attempt.moisture_before, "after": attempt.moisture_after}
        found += filter(None, (scattered(step, r, limit) for step, r in readings.items()))
    if earlier_sessions:
        found.append(used_subject(protocol.plan.subject, earlier_sessions))
    return found


def used_subject(subject: str, sessions: list[str]) -> str:
    """Warning for a subject code that has sessions already."""
    named = ", ".join(sessions[-3:])
    return (
        f"Subject code {subject} was used before ({named}). If this is another person, close the "
        "session and choose another code."
    )


def _row(protocol: Protocol, trial: TrialState) -> dict[str, Any]:
    last = trial.attempts[-1] if trial.attempts else None
    return {
        "index": trial.index,
        "condition": trial.condition,
        "verdict": trial.verdict,
        "attempts": len(trial.attempts),
        "reason": last.reason if last and last.verdict == "failed" else "",
        "time_to_target": last.time_to_target if last else None,
        "peak_force": last.peak_force if last else None,
        "notes": [_remark(e) for e in protocol.log.of("note", trial.index)],
        "markers": [_remark(e) for e in protocol.log.of("marker", trial.index)],
    }


def _remark(event: Event) -> dict[str, Any]:
    return {"time": round(seconds(event.stamp_ns), 3), "text": event.text, "attempt": event.attempt}


def _event(event: Event) -> dict[str, Any]:
    return {**_remark(event), "kind": event.kind, "index": event.index}


def _gigabytes(size: int | None) -> float | None:
    return None if size is None else round(size / GIGABYTE, 1)
