"""Everything that the operator's page shows of a session, as plain data."""

from __future__ import annotations

from typing import Any

from .attempt import TrialState
from .protocol import Protocol, Step
from .study_plan import CLEAN_PLATE


def session_status(protocol: Protocol) -> dict[str, Any]:
    """The session, the current trial and a row for each trial."""
    plan = protocol.plan
    trial = protocol.trials[protocol.current]
    begun = trial.attempts and protocol.step is not Step.PREPARE
    attempt = trial.attempts[-1] if begun else None
    waiting = protocol.step is Step.CLEAR and not protocol.paused
    return {
        "subject": plan.subject,
        "session": plan.session,
        "step": protocol.step.value,
        "paused": protocol.paused,
        "message": protocol.message,
        "waiting_for": protocol.waiting_for() if waiting else "",
        "index": trial.index,
        "attempt": attempt.attempt if attempt else len(trial.attempts),
        "condition": trial.condition,
        "preparation": plan.preparation(trial.condition),
        "preparations": {c: plan.preparation(c) for c in plan.conditions},
        "prompt": CLEAN_PLATE,
        "target_force": plan.target_force,
        "readings": plan.readings,
        "moisture_before": attempt.moisture_before if attempt else [],
        "moisture_after": attempt.moisture_after if attempt else [],
        "recording": protocol.recording,
        "conditions": list(plan.conditions),
        "folder": str(protocol.folder),
        "trials": [_row(trial) for trial in protocol.trials],
    }


def _row(trial: TrialState) -> dict[str, Any]:
    last = trial.attempts[-1] if trial.attempts else None
    return {
        "index": trial.index,
        "condition": trial.condition,
        "verdict": trial.verdict,
        "attempts": len(trial.attempts),
        "reason": last.reason if last else "",
        "time_to_target": last.time_to_target if last else None,
        "peak_force": last.peak_force if last else None,
    }
