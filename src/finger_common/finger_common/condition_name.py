# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Names of conditions, and of all else that names files of a fit: none leads to another folder."""

from __future__ import annotations

import re
from collections.abc import Iterable

from .errors import InputError

CONDITION_NAME = re.compile(r"(?:\w(?:[\w .,+()%-]{0,62}[\w.,+()%-])?)?")
"""Empty: no condition was noted."""

SESSION_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
"""Of a guided session and of its conditions. These stand between commas on the command line and in
blocks such as dry:3, and name the bags of the session, which are typed in commands."""

SPELLING_ALONE = "differ in case or spaces alone; write one name in one way"


def check_condition_name(text: str, what: str) -> str:
    """The name; raises InputError for what is none. what: is named, such as condition."""
    if not CONDITION_NAME.fullmatch(text):
        raise InputError(
            f"{what} {text[:40]!r} is not valid; use letters, digits, spaces and _ . , + ( ) % -, "
            "at most 64 characters, the last no space, the first a letter, a digit or _"
        )
    return text


def same_but_for_spelling(names: Iterable[str]) -> tuple[str, str] | None:
    """The first two different names that are one name for a reader, or for some file systems; None
    without."""
    seen: dict[str, str] = {}
    for name in names:
        first = seen.setdefault(" ".join(name.split()).casefold(), name)
        if first != name:
            return first, name
    return None
