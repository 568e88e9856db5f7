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


def check_new_subject(code: str) -> str:
    """As `check_subject`, for a person that nothing was recorded of: older codes may begin with
    - or _, which commands take for an option."""
    if not check_subject(code)[0].isalnum():
        raise InputError(f"subject '{code}' must begin with a letter or a digit, such as S01")
    return code


def alike(code: str) -> str:
    """Equal for codes that may have been meant for one person: S01, s01 and S1."""
    return re.sub(r"(?<!\d)0+(?=\d)", "", code.casefold())
