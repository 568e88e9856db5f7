# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Readings in lines of text, as a serial adapter sends them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from finger_common.errors import InputError

DEFAULT_PATTERN = r"(?:M[= ]?)?(?P<value>[-+]?\d+(?:[.,]\d+)?)(?:[;, ](?P<phase>before|after))?"
"""A bare number, with decimal point or comma, or `M=42.0;before`."""
MAX_LINE = 256
"""Bytes; what runs on longer without an end of line is not a line."""


@dataclass(frozen=True)
class ParsedLine:
    """Value and phase word ("" where the line has none) of a reading."""

    value: float
    phase: str = ""


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """Compiled pattern; raises InputError for a wrong one or one without a group `value`."""
    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise InputError(
            f"serial_pattern '{pattern}' is not a regular expression: {error}"
        ) from None
    if "value" not in compiled.groupindex:
        raise InputError(
            f"serial_pattern '{pattern}' has no group named value; write (?P<value>…) around the "
            "number"
        )
    return compiled


def parse_line(line: str, pattern: re.Pattern[str]) -> ParsedLine | None:
    """The reading in a line, None when the whole does not match or holds no finite number."""
    match = pattern.fullmatch(line.strip())
    if match is None:
        return None
    groups = match.groupdict()
    try:
        value = float((groups["value"] or "").replace(",", "."))
    except ValueError:
        return None
    if not math.isfinite(value):
        return None
    return ParsedLine(value, (groups.get("phase") or "").lower())


class LineSplitter:
    """Cuts a stream of bytes into lines; memory stays bounded for any input."""

    def __init__(self) -> None:
        self._rest, self._within = b"", False
        self.dropped = 0
        """Lines left out because they were too long or not ASCII."""
        self.partial = 0
        """Lines left out because their beginning may have been missed."""

    def feed(self, data: bytes) -> list[str]:
        """Complete lines in what has come so far, without their ends (CR, LF or both)."""
        *lines, rest = re.split(rb"[\r\n]", self._rest + data)
        # One byte too many is enough to know that the line is too long when it ends.
        self._rest = rest[: MAX_LINE + 1]
        if self._within and lines:
            self._within = False
            self.partial += bool(lines.pop(0))
        good = [line for line in lines if len(line) <= MAX_LINE and line.isascii()]
        self.dropped += len(lines) - len(good)
        return [line.decode("ascii") for line in good if line]

    def reset(self, within: bool = False) -> None:
        """Forget an unfinished line, as after a pause or a reconnection.

        within: what comes next may begin in the middle of a line, which is left out.
        """
        self._rest, self._within = b"", within

    @property
    def unfinished(self) -> bool:
        """Whether bytes wait for the rest of their line."""
        return bool(self._rest)
