# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Readings that the operator enters."""

from __future__ import annotations

import time

from .source import FLAG_MANUAL, MoistureSource, Reading


class ManualSource(MoistureSource):
    """Readings entered by the operator.

    Each call of `enter` makes one; there is no device, so `read` gives nothing.
    """

    NAME = "manual"

    def connect(self) -> None:
        self.health.hardware_id = "operator"

    def close(self) -> None:
        """Nothing to release."""

    def enter(self, value: float, phase: int = 0) -> Reading:
        """The reading entered now."""
        return self.reading(self.clock.now(), value, phase, FLAG_MANUAL)

    def read(self, timeout: float = 1.0) -> Reading | None:
        time.sleep(timeout)
        return None
