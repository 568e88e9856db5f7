# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The error family of the suite.

FingerError
├── InputError    what the user gave cannot be used: files, values, arguments (exit code 2)
├── DeviceError   a device is missing, silent or sends wrong data
└── ModelError    a computation failed; names time and load

Every message is one sentence that names what is wrong, where, and what to change.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

TWICE = "'{}' is there twice; keep one"
"""Of a name, of which the later value would silently replace the first."""


class FingerError(Exception):
    """Base class of all errors raised on purpose by the suite."""


class InputError(FingerError):
    """A file, value or argument that cannot be used.

    Raised for: a missing or unreadable file, a wrong header, key, type or range, contradictory
    options.
    """


class DeviceError(FingerError):
    """A device that is absent, silent, misconfigured or reports a fault.

    Raised for: connection refused or lost, no reply within the deadline, an unexpected reply, a
    critical status.
    """


class ModelError(FingerError):
    """A computation that could not be carried out.

    Raised for: no convergence of a load step, a load the finger cannot carry; names time, force and
    cause.
    """


def check_type(value: object, kind: type, name: str) -> None:
    """Raise InputError, with the name, for a value of another type."""
    if not isinstance(value, kind):
        raise InputError(f"{name} is of type {type(value).__name__}; give a {kind.__name__}")


def put_once(found: dict[str, Any], name: str, value: Any, where: str) -> None:
    """Add a named value; raises InputError, naming `where`, for one that is there already."""
    if name in found:
        raise InputError(f"{where}: {TWICE.format(name)}")
    found[name] = value


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that was probably meant: one that begins so, or is spelt alike."""
    names = list(known)
    begun = [n for n in names if len(name) > 1 and n.startswith(name)]
    return next(iter([*begun, *difflib.get_close_matches(name, names, 1, 0.6)]), None)


def known_names(name: str, known: Iterable[str]) -> str:
    """End of a sentence about an unknown name: which one was probably meant, and which exist."""
    names = [str(n) for n in known]
    near = nearest(name, names)
    listed = f"nown are {', '.join(names) or 'none'}"
    return f"k{listed}" if near is None else f"did you mean '{near}'? K{listed}"


def listed(names: Iterable[object], most: int = 5, separator: str = ", ") -> str:
    """The names in a sentence, of many the first ones and how many more there are."""
    words = [str(name) for name in names]
    more = len(words) - most
    shown = separator.join(words[:most])
    if more <= 0:
        return shown
    return f"{shown}{separator.replace(',', '')}and {more} more"
