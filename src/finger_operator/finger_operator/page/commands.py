# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The commands of the page, with the names and types of their arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from finger_common.errors import InputError

from ..conditions import new_conditions
from ..trial_order import order_text

SEEN: dict[str, type] = {"seen_session": str, "seen_trial": int, "seen_step": str}
"""What a browser showed when the operator asked: another session, trial or step is not meant.

`seen_step` is "closed" where no session was open.
"""

SEEN_READINGS = "seen_readings"
"""Number of readings of the trial that a browser showed when its operator typed another one."""

PARAMETERS = "protocol/set_parameters"
"""Service that takes what a command sets."""

SUBJECT = "for_subject"
"""Argument of what begins a session: the subject that its dialog has set. Another one may have been
set since, in another dialog."""


@dataclass(frozen=True)
class Command:
    """A command of the page, and who carries it out.

    arguments: types by name. service: that carries it out; empty for none. sets: makes of the
    arguments the parameters of the protocol node, by name, that are set before. answer: makes the
    answer of the arguments and the status where no service gives one.
    """

    arguments: Mapping[str, type]
    service: str = ""
    sets: Callable[[dict[str, Any]], dict[str, Any]] = lambda given: {}
    answer: Callable[[dict[str, Any], Mapping[str, Any]], str] = lambda given, status: ""


COMMANDS: dict[str, Command] = {
    **{
        name: Command(SEEN, f"protocol/{name}")
        for name in "pause resume redo skip end abort marker close".split()
    },
    **{
        name: Command({**SEEN, SUBJECT: str}, f"protocol/{name}") for name in ("start", "calibrate")
    },
    "note": Command(
        {"text": str, "trial": int, **SEEN},
        "protocol/note",
        lambda given: {"note": given["text"], "note_trial": given["trial"] - 1},
    ),
    "repeat": Command(
        {"index": int, **SEEN},
        "protocol/repeat",
        lambda given: {"selected_trial": given["index"]},
    ),
    "preparation": Command(
        {"condition": str, "text": str, **SEEN},
        "protocol/preparation",
        lambda given: {"preparation": f"{given['condition']}: {' '.join(given['text'].split())}"},
    ),
    "configure": Command(
        {
            "subject": str,
            "age": int,
            "hand": str,
            "finger": str,
            "finger_width": float,
            "finger_depth": float,
            "conditions": list,
            "trials": int,
            "readings": int,
            "target_force": float,
            "order": str,
            "order_seed": int,
        },
        PARAMETERS,
        dict,
    ),
    "order": Command(
        {"subject": str, "conditions": list, "order": str, "order_seed": int},
        answer=lambda given, status: order_text(given),
    ),
    "new_conditions": Command(
        {"conditions": list},
        answer=lambda given, status: new_conditions(
            given["conditions"], status.get("preparations", {})
        ),
    ),
    "tare": Command({}, "force/tare"),
    "moisture": Command({"value": float, **SEEN, SEEN_READINGS: int}, "moisture/set_moisture"),
    "curves": Command({}),
}

OPTIONAL = {
    *SEEN,
    SEEN_READINGS,
    SUBJECT,
    *("age", "hand", "finger", "finger_width", "finger_depth", "order", "order_seed"),
}
"""Arguments that may be left out; the protocol's parameters stay as they are."""


def stale(arguments: dict[str, Any], status: Mapping[str, Any]) -> str:
    """What has begun since the browser showed what the operator meant; empty when nothing has.

    Takes SEEN and SEEN_READINGS out of the arguments. status: of the session.
    """
    wanted = (*SEEN, SEEN_READINGS)
    seen = {key: arguments.pop(key) for key in wanted if key in arguments}
    session, index, step = (status.get(key) for key in ("session", "index", "step"))
    taken = readings_of(status)
    now = {"seen_session": session, "seen_trial": index, "seen_step": step}
    now[SEEN_READINGS] = len(taken)
    other = {key for key, value in seen.items() if now[key] != value}
    if not other:
        return ""
    if index is None:
        return "no session is open"
    if "seen_session" in other:
        return f"session {session} is open"
    if other == {SEEN_READINGS} and taken:
        return f"a reading of {taken[-1]:g} came"
    return f"trial {index + 1} is at '{step}'"


def readings_of(status: Mapping[str, Any]) -> list[float]:
    """Moisture readings (a.u.) that the trial under way has, those before the press first."""
    return [*status.get("moisture_before", ()), *status.get("moisture_after", ())]


def check_command(message: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and checked arguments of a command; raises InputError naming what is wrong with it."""
    name = message.get("name")
    if not isinstance(name, str) or name not in COMMANDS:
        raise InputError("no such command")
    given = message.get("arguments", {})
    wanted = COMMANDS[name].arguments
    if not isinstance(given, dict) or not wanted.keys() - OPTIONAL <= given.keys() <= wanted.keys():
        raise InputError(f"command '{name}' takes the arguments {', '.join(wanted) or 'none'}")
    arguments = {}
    for key, value in given.items():
        kind = wanted[key]
        if kind is float and type(value) is int and abs(value) < 1_000_000_000:
            value = float(value)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(f"command '{name}': '{key}' is not a {kind.__name__}")
        if isinstance(value, float) and not abs(value) < 1e9:
            raise InputError(f"command '{name}': '{key}' is not a finite number")
        if isinstance(value, int) and not 0 <= value < 1_000_000:
            raise InputError(f"command '{name}': '{key}' is out of range")
        for text in value if isinstance(value, list) else [value]:
            # ROS strings hold neither.
            if isinstance(text, str) and any(c == "\0" or "\ud800" <= c <= "\udfff" for c in text):
                raise InputError(f"command '{name}': '{key}' holds characters that are not text")
        if isinstance(value, list) and not (
            0 < len(value) < 100 and all(isinstance(v, str) for v in value)
        ):
            raise InputError(f"command '{name}': '{key}' is not a list of names")
        arguments[key] = value
    return name, arguments
