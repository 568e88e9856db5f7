# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Subject codes: what a person is called in sessions, bags and files; and names of fingers."""

from __future__ import annotations

import re

from .errors import InputError

HANDS = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "little")

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


def finger_name(hand: str, finger: str) -> str:
    """What a subject's finger is called in bags and files, such as right_index.

    What was not noted is left out, so that nothing is the name of a finger that is not known.
    """
    return "_".join(part for part in (hand, finger) if part)


FINGER_NAMES = [finger_name(hand, finger) for hand in ("", *HANDS) for finger in ("", *FINGERS)]
"""All that can be noted of a finger."""


def known_finger(name: str) -> str:
    """The name of a finger; nothing for a text that is none."""
    return name if name in FINGER_NAMES else ""


def may_be_one(*names: str) -> bool:
    """Whether nothing that is noted tells these fingers apart."""
    parts = {part for name in names for part in name.split("_") if part}
    return len(parts & set(HANDS)) <= 1 and len(parts - set(HANDS)) <= 1


def parameter_file_name(subject: str, finger: str = "") -> str:
    """Name of the file of a subject's parameters, of one finger where it is known.

    Raises InputError for a code that is none.
    """
    return ".".join(part for part in (check_subject(subject), known_finger(finger), "yaml") if part)
