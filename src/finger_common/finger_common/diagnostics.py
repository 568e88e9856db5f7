# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Health of a source of data: rates, counters and faults, without ROS.

A fault is reported for logging once when it begins, then only counted; it ends when the source
calls `recovered`. The node turns a `Health` into a DiagnosticStatus once a second.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels of diagnostic_msgs/DiagnosticStatus."""

STARTING = "starting"
"""Value of the node `bring_up` that names, with spaces between, the nodes that were not up yet."""


def full_node_name(name: str, namespace: str) -> str:
    """A node's name with its namespace, as in /diagnostics: "left/force". "/a/b" has its own."""
    return name.lstrip("/") if name.startswith("/") else f"{namespace}/{name}".lstrip("/")


def status_node(status_name: str) -> str:
    """Full name of the node in the name of a status, "namespace/node: part"."""
    return status_name.split(":")[0].lstrip("/")


def node_within(status_name: str, namespace: str) -> str | None:
    """The node's name within a namespace; None for a node outside of it, of another finger."""
    prefix = full_node_name("", namespace)
    node = status_node(status_name)
    return node[len(prefix) :] if node.startswith(prefix) else None


@dataclass
class HealthReport:
    """State of a `Health` at one time: the worst level, and all faults, the worst one first."""

    level: int
    message: str
    hardware_id: str
    values: dict[str, str] = field(default_factory=dict)


class Health:
    """Thread-safe counters and faults of one source.

    expected_rate: samples per second, None where there is no fixed rate.
    rate_tolerance: relative deviation of the measured rate that is still OK.
    stale_after: seconds without a sample until the source counts as silent, None for never.

    `activity` is the message of an active source without a fault, in place of "active".
    """

    def __init__(
        self,
        name: str,
        hardware_id: str = "",
        expected_rate: float | None = None,
        rate_tolerance: float = 0.2,
        stale_after: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self.hardware_id = hardware_id
        self.expected_rate = expected_rate
        self.rate_tolerance = rate_tolerance
        self.stale_after = stale_after
        self.state = "unconfigured"
        self.activity = ""
        self.counters: Counter[str] = Counter()
        self.notes: dict[str, str] = {}
        self.last_error = ""
        self._clock = clock
        self._lock = threading.Lock()
        self._faults: dict[str, tuple[int, str]] = {}
        self._count = 0
        self._last_sample: float | None = None
        self._since: tuple[float, int] | None = None

    def sample(self) -> None:
        """Count a good sample."""
        with self._lock:
            self._count += 1
            self._last_sample = self._clock()
            if self._since is None:
                self._since = (self._last_sample, self._count)

    def count(self, what: str, number: int = 1) -> None:
        """Count an event, such as "lost", "late", "malformed", "saturated"."""
        with self._lock:
            self.counters[what] += number

    def fault(self, key: str, message: str, level: int = ERROR) -> bool:
        """Note a fault; true when it is new, so that the caller logs it once."""
        with self._lock:
            new = key not in self._faults
            self._faults[key] = (level, message)
            self.counters[key] += 1
            self.last_error = message
            return new

    def recovered(self, key: str | None = None) -> bool:
        """End one fault, or all; true when there was one to end."""
        with self._lock:
            if key is None:
                had = bool(self._faults)
                self._faults.clear()
                return had
            return self._faults.pop(key, None) is not None

    @property
    def faults(self) -> dict[str, str]:
        """Faults that last, by key."""
        with self._lock:
            return {key: message for key, (_, message) in self._faults.items()}

    def report(self) -> HealthReport:
        """State now; the measured rate is that since the last report."""
        with self._lock:
            now = self._clock()
            rate = None
            if self._since is not None and now > self._since[0]:
                rate = (self._count - self._since[1]) / (now - self._since[0])
                self._since = (now, self._count)
            age = None if self._last_sample is None else now - self._last_sample
            level, message = OK, self.state
            if self.state == "active" and self.activity:
                message = self.activity
            if self._faults:
                faults = sorted(self._faults.values(), key=lambda fault: -fault[0])
                level, message = faults[0][0], "; ".join(text for _, text in faults)
            if self.state == "active" and level < ERROR:
                if self.stale_after is not None and (age is None or age > self.stale_after):
                    silent = "no sample yet" if age is None else f"no sample for {age:.1f} s"
                    # What is wrong may explain the silence, but a warning would hide it.
                    message = f"{silent}: {message}" if level else silent
                    level = ERROR
                elif (
                    level == OK
                    and self.expected_rate
                    and rate is not None
                    and abs(rate / self.expected_rate - 1) > self.rate_tolerance
                ):
                    level = WARN
                    message = f"rate {rate:.1f} Hz, expected {self.expected_rate:.1f} Hz"
            values = {"state": self.state, "samples": str(self._count)}
            if rate is not None:
                values["measured_rate_hz"] = f"{rate:.2f}"
            if self.expected_rate:
                values["expected_rate_hz"] = f"{self.expected_rate:.2f}"
            if age is not None:
                values["last_sample_age_s"] = f"{age:.3f}"
            values.update({key: str(number) for key, number in sorted(self.counters.items())})
            values.update(self.notes)
            values["last_error"] = self.last_error
            return HealthReport(level, message, self.hardware_id, values)
