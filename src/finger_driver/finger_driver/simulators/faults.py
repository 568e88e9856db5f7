# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Faults of a simulated device that can be switched on and off while it runs."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from finger_common.errors import InputError, known_names


class Faults:
    """Named faults with an integer each: 0 off, n > 0 the next n occasions, -1 until switched off.

    `take` uses up one occasion; `value` does not, for faults whose number is a setting (a status
    word, a slot, …).
    """

    def __init__(self, meanings: Mapping[str, str]) -> None:
        self.meanings = dict(meanings)
        self._values = dict.fromkeys(meanings, 0)
        self._lock = threading.Lock()

    def set(self, name: str, value: int = -1) -> None:
        """Switch a fault; raises InputError for one the device does not have."""
        with self._lock:
            if name not in self._values:
                raise InputError(
                    f"fault '{name}' does not exist; {known_names(name, self._values)}"
                )
            self._values[name] = value

    def clear(self) -> None:
        """Switch all off."""
        with self._lock:
            self._values = dict.fromkeys(self._values, 0)

    def value(self, name: str) -> int:
        """The fault's number."""
        with self._lock:
            return self._values[name]

    def take(self, name: str) -> bool:
        """Whether the fault occurs on this occasion."""
        with self._lock:
            number = self._values[name]
            if number > 0:
                self._values[name] = number - 1
            return number != 0
