"""Quality bits of a contact measurement; the same numbers as the FLAG_* constants of ContactArea.msg."""

from __future__ import annotations

from enum import IntFlag


class ContactFlag(IntFlag):
    """What speaks against a measurement; 0 means nothing."""

    NO_CONTACT = 1
    SPARSE = 2
    CLIPPED = 4
    LOW_CONTRAST = 8
    SATURATED = 16
    UNCALIBRATED = 32
    MULTIPLE_REGIONS = 64
    NO_BACKGROUND = 128


def flag_names(flags: int) -> str:
    """Names of the bits set, lower case, joined by '|'; empty for 0."""
    return "|".join(f.name.lower() for f in ContactFlag if flags & f and f.name)
