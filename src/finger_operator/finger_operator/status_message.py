# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Between what the operator's page shows of a session (`status`) and finger_msgs/SessionStatus.

What is None there is NaN or -1 in the message. Messages are read by attribute.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from finger_common.parameter_values import parameter_fields, parameter_values
from finger_common.stamps import nanoseconds, seconds, stamp_of, time_fields

from .status import GIGABYTE

_SAME = (
    *("step", "paused", "recording", "ended", "message", "instruction", "waiting_for"),
    *("subject", "session", "folder", "index", "attempt", "condition", "preparation", "prompt"),
    *("target_force", "readings"),
)
"""Keys of a status that are fields of the message as they are."""

_LISTS = ("moisture_before", "moisture_after", "conditions", "warnings")

_TRIAL = ("index", "condition", "verdict", "attempts", "reason")

_SUMMARY = ("planned", "kept", "skipped", "open", "failed_attempts", "text")


def status_fields(status: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a SessionStatus."""
    fields = {key: status[key] for key in (*_SAME, *_LISTS) if key in status}
    fields["preparations"] = [
        {"condition": condition, "preparation": text}
        for condition, text in status["preparations"].items()
    ]
    fields["plan"] = parameter_fields(status["plan"])
    fields["disk"] = _disk_fields(status["disk"])
    if status["step"] == "closed":
        fields["used_subjects"] = [
            {"subject": subject, "sessions": list(sessions)}
            for subject, sessions in status["used_subjects"].items()
        ]
        return fields
    fields["trials"] = [_trial_fields(row) for row in status["trials"]]
    for key, kind in (("notes", "note"), ("markers", "marker"), ("events", "")):
        fields[key] = [_remark_fields(remark, kind) for remark in status[key]]
    fields["summary"] = dict(status["summary"])
    fields["time_left"] = _number(status["time_left"])
    return fields


def status_of(message: Any) -> dict[str, Any]:
    """The status that a SessionStatus was made of."""
    if message.step == "closed":
        return {
            "step": message.step,
            "instruction": message.instruction,
            "plan": parameter_values(message.plan),
            "preparations": {p.condition: p.preparation for p in message.preparations},
            "used_subjects": {s.subject: list(s.sessions) for s in message.used_subjects},
            "disk": {"free_gb": _gigabytes(message.disk.free)},
        }
    return {
        **{key: getattr(message, key) for key in _SAME},
        **{key: list(getattr(message, key)) for key in _LISTS},
        "preparations": {p.condition: p.preparation for p in message.preparations},
        "plan": parameter_values(message.plan),
        "trials": [_trial(row) for row in message.trials],
        "notes": [_remark(remark) for remark in message.notes],
        "markers": [_remark(remark) for remark in message.markers],
        "events": [
            {**_remark(remark), "kind": remark.kind, "index": remark.index}
            for remark in message.events
        ],
        "summary": {key: getattr(message.summary, key) for key in _SUMMARY},
        "time_left": _known(message.time_left),
        "disk": _disk(message.disk),
    }


def _trial_fields(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **{key: row[key] for key in _TRIAL},
        "time_to_target": _number(row["time_to_target"]),
        "peak_force": _number(row["peak_force"]),
        "notes": [_remark_fields(remark, "note") for remark in row["notes"]],
        "markers": [_remark_fields(remark, "marker") for remark in row["markers"]],
    }


def _trial(row: Any) -> dict[str, Any]:
    return {
        **{key: getattr(row, key) for key in _TRIAL},
        "time_to_target": _known(row.time_to_target),
        "peak_force": _known(row.peak_force),
        "notes": [_remark(remark) for remark in row.notes],
        "markers": [_remark(remark) for remark in row.markers],
    }


def _remark_fields(remark: Mapping[str, Any], kind: str) -> dict[str, Any]:
    return {
        "stamp": time_fields(nanoseconds(remark["time"])),
        "kind": remark.get("kind", kind),
        "text": remark["text"],
        "index": remark.get("index", -1),
        "attempt": remark["attempt"],
    }


def _remark(remark: Any) -> dict[str, Any]:
    time = round(seconds(stamp_of(remark.stamp)), 3)
    return {"time": time, "text": remark.text, "attempt": remark.attempt}


def _disk_fields(disk: Mapping[str, Any]) -> dict[str, Any]:
    left = disk.get("trials_left")
    return {
        "free": _bytes(disk["free_gb"]),
        "needed": _bytes(disk.get("needed_gb")),
        "trials_left": -1 if left is None else left,
        "low": disk.get("enough") is False,
    }


def _disk(disk: Any) -> dict[str, Any]:
    known = disk.trials_left >= 0
    return {
        "free_gb": _gigabytes(disk.free),
        "needed_gb": _gigabytes(disk.needed),
        "trials_left": disk.trials_left if known else None,
        "enough": not disk.low if known else None,
    }


def _bytes(gigabytes: float | None) -> int:
    return -1 if gigabytes is None else round(gigabytes * GIGABYTE)


def _gigabytes(size: int) -> float | None:
    return None if size < 0 else round(size / GIGABYTE, 1)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
