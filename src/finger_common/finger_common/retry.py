# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Pauses between attempts at something that may fail for a while."""

from __future__ import annotations


class Pauses:
    """Pauses in s that double from `first` to `longest`; `reset` begins again with the first."""

    def __init__(self, first: float, longest: float) -> None:
        self._first = first
        self._longest = longest
        self._next = first

    def next(self) -> float:
        """Pause before the next attempt."""
        pause = min(self._next, self._longest)
        self._next = 2 * pause
        return pause

    def reset(self) -> None:
        """After an attempt that succeeded."""
        self._next = self._first
