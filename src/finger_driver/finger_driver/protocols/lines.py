# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Readings in lines of text, as a serial adapter sends them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

from finger_common.errors import InputError

DEFAULT_PATTERN = r"(?:M[= ]?)?(?P<value>[-+]?\d+(?:[.,]\d+)?)(?:[;, ](?P<phase>before|after))?"
"""A bare number, with decimal point or comma, or `M=42.0;before`."""
MAX_LINE = 256
"""Bytes; what runs on longer without an end of line is not a line."""

_FRAME = " \t\v\f\x02\x03\x04"
"""Blanks, and control characters with which devices begin and end a text or a page."""
_NO_TEXT = re.compile(r"[^\t -~]")
"""What is not in lines of text."""
_GARBAGE = 1 / 3
"""Share of such characters above which a line is garbage; below it, text with a foreign letter or
two, as in "25.1 °C"."""


class Line(NamedTuple):
    """A line of a stream of bytes."""

    text: str | None
    """None where it is too long or not ASCII."""
    whole: bool
    """Whether no beginning of it was missed."""
    garbage: bool
    """Whether it is too long or mostly no text, as by a wrong baud rate or a loose contact."""


@dataclass(frozen=True)
class ParsedLine:
    """A reading: value, phase word ("" where the line has none), and whether no letter stands
    before the value, so that it may be the rest of a longer number."""

    value: float
    phase: str
    bare: bool


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
    return ParsedLine(
        value,
        (groups.get("phase") or "").lower(),
        not any(map(str.isalpha, line[: match.start("value")])),
    )


class LineSplitter:
    """Cuts a stream of bytes into lines; memory stays bounded for any input."""

    def __init__(self) -> None:
        self._rest, self._within = b"", False

    def feed(self, data: bytes) -> list[Line]:
        """Lines that are complete now, without their ends (CR, LF or both)."""
        *lines, rest = re.split(rb"[\r\n]", self._rest + data)
        # One byte too many is enough to know that the line is too long when it ends.
        self._rest = rest[: MAX_LINE + 1]
        found: list[Line] = []
        for line in lines:
            whole, self._within = not self._within, False
            if line:
                long = len(line) > MAX_LINE
                text = None if long or not line.isascii() else line.decode("ascii")
                found.append(Line(text, whole, long or _is_garbage(line)))
        return found

    def reset(self, within: bool = False) -> None:
        """Forget an unfinished line, as after a pause or a reconnection.

        within: what comes next may begin in the middle of a line, which is then not whole.
        """
        self._rest, self._within = b"", within

    @property
    def unfinished(self) -> bool:
        """Whether bytes wait for the rest of their line."""
        return bool(self._rest)


def _is_garbage(line: bytes) -> bool:
    """Whether a line is mostly no text; a foreign letter in UTF-8 is one character."""
    text = line.decode("utf-8", "replace").strip(_FRAME)
    return len(_NO_TEXT.findall(text)) > _GARBAGE * len(text)
