# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Subject codes: what a person is called in sessions, bags and files."""

from __future__ import annotations

import re

from .errors import InputError

_CODE = re.compile(r"(?=.*\d)[A-Za-z0-9_-]{1,16}")


def is_subject(code: str) -> bool:
    """Whether a text is a subject code."""
    return _CODE.fullmatch(code) is not None


def check_subject(code: str) -> str:
    """The code; raises InputError for what is none.

    With a digit in the code, a name is not typed by habit. A code can be a file's name.
    """
    if not is_subject(code):
        raise InputError(
            f"subject '{code}' is no code; use up to 16 letters, digits, - and _ with at least one "
            "digit, such as S01, and never a name"
        )
    return code
