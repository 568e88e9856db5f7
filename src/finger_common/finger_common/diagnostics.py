# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Health of a source of data: rates, counters and faults, without ROS.

A fault is reported for logging once when it begins, then only counted; it ends at once when the
source calls `recovered`, and after HOLD when it calls `cleared`. The node turns a `Health` into a
DiagnosticStatus once a second; whether samples come as fast as they should is judged then.
"""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels of diagnostic_msgs/DiagnosticStatus."""

STARTING = "starting"
"""Value of the node `bring_up` that names, with spaces between, the nodes that were not up yet."""

MIXED_INPUT = "mixed_input"
"""Key of the fault that several nodes publish what one reads; numbers of samples mean nothing."""

HOLD = 2.0
"""s for which a fault that is absent, or has passed, is still shown."""

_SILENCE = re.compile(r"no sample (yet|for [\d.]+ s)( \([^()]*\))?(: )?")
"""What the report of a silent source begins with: the age, and the `advice` of its Health."""

_SHORTEST, _FEWEST = 0.5, 5
"""s that a rate is measured over at least, and samples that are due meanwhile."""

_APART = 2
"""Reports with numbers, the first of which is of the time in which they went back."""

_PATIENCE, _START = 5, 20.0
"""Wrong rates in a row after which they are logged, and right ones after which their end is; s from
the first sample in which none is counted, as the start of other nodes keeps the computer busy."""


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


def cause_of(message: str) -> str:
    """What a report's message says beside the age of the last sample and the advice on it; empty
    for nothing."""
    return message[found.end() :] if (found := _SILENCE.match(message)) else message


@dataclass
class HealthReport:
    """State of a `Health` at one time: the worst level, and all faults, the worst one first.

    news: level and sentence of what is to be logged of the rate; the sentence is empty for nothing.
    """

    level: int
    message: str
    hardware_id: str
    values: dict[str, str] = field(default_factory=dict)
    news: tuple[int, str] = (OK, "")


@dataclass
class _Fault:
    """A fault that is shown. noted: time when it was noted last. absent: whether it was not there
    when looked for since."""

    level: int
    message: str
    noted: float
    absent: bool = False


class Health:
    """Thread-safe counters and faults of one source.

    expected_rate: samples per second, None where there is no fixed rate; then the rate is judged
    by the samples that are lost by their numbers (`numbered`).
    rate_tolerance: relative deviation of the measured rate that is still OK.
    stale_after: seconds without a sample until the source counts as silent, None for never.

    `activity` is the message of an active source without a fault, in place of "active". `advice`
    is what is told of a silent one: where its samples should come from and what to check, without
    brackets.
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
        self.activity = self.advice = ""
        self.counters: Counter[str] = Counter()
        self.notes: dict[str, str] = {}
        self.last_error = ""
        self._clock = clock
        self._lock = threading.Lock()
        self._faults: dict[str, _Fault] = {}
        self._count = self._missed = self._gaps = 0
        """Samples, those that were lost, and those that numbers left out since the last report."""
        self._apart = 0
        """Reports with numbers in which gaps are not counted, as numbers went back before."""
        self._compared = False
        """Whether a number followed another one since the last report."""
        self._number: int | None = None
        self._first_sample: float | None = None
        self._last_sample: float | None = None
        self._since: tuple[float, int, int] | None = None
        """Begin of the measurement of the rate, and samples and missed ones until then."""
        self._wrong_rates = 0
        self._rate_told = False

    def sample(self) -> None:
        """Count a good sample."""
        with self._lock:
            now, last = self._clock(), self._last_sample
            self._count += 1
            self._last_sample = now
            if self._first_sample is None:
                self._first_sample = now
            if self._since is None or (
                # A silence is told as such; the rate is that of what comes after it.
                self.stale_after is not None
                and last is not None
                and now - last > max(self.stale_after, _SHORTEST)
            ):
                self._since = (now, self._count, self._missed + self._gaps)

    def numbered(self, number: int | None) -> None:
        """Count samples as lost that are missing before this one, by the number that its publisher
        gave it; None where it gives none. A number that is not higher begins another count, and
        what is left out until this report and the next one with numbers is no loss: two publishers
        may count apart."""
        with self._lock:
            last, self._number = self._number, number
            if last is None or number is None:
                return
            self._compared = True
            self._gaps += max(number - last - 1, 0)
            if number <= last:
                self._apart = _APART

    def count(self, what: str, number: int = 1) -> None:
        """Count an event, such as "lost", "late", "malformed", "saturated"."""
        with self._lock:
            self.counters[what] += number

    def fault(self, key: str, message: str, level: int = ERROR) -> bool:
        """Note a fault; true when it is new, so that the caller logs it once."""
        with self._lock:
            self._end_absent()
            new = key not in self._faults
            self._faults[key] = _Fault(level, message, self._clock())
            self.counters[key] += 1
            self.last_error = message
            return new

    def cleared(self, *keys: str) -> None:
        """These faults are absent now; each ends when it has not been noted for HOLD s.

        A fault that comes and goes is logged once, and diagnostics once a second do not miss it.
        """
        with self._lock:
            for key in keys:
                fault = self._faults.get(key)
                if fault is not None:
                    fault.absent = True

    def passed(self, key: str, message: str) -> bool:
        """A fault is over: for HOLD s more the message is shown as a warning in its place. True
        when there was one."""
        with self._lock:
            found = key in self._faults
            if found:
                self._faults[key] = _Fault(WARN, message, self._clock(), absent=True)
            return found

    def _end_absent(self) -> None:
        now = self._clock()
        for key, fault in list(self._faults.items()):
            if fault.absent and now - fault.noted > HOLD:
                del self._faults[key]

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
            self._end_absent()
            return {key: fault.message for key, fault in self._faults.items()}

    def report(self) -> HealthReport:
        """State now; the measured rate is that since the last report, or the one before it."""
        with self._lock:
            self._end_absent()
            now = self._clock()
            age = None if self._last_sample is None else now - self._last_sample
            silent = ""
            if (
                self.state == "active"
                and self.stale_after is not None
                and (age is None or age > self.stale_after)
            ):
                silent = "no sample yet" if age is None else f"no sample for {age:.1f} s"
                silent += f" ({self.advice})" if self.advice else ""
            self._count_lost()
            rate, news = self._measure(now, bool(silent))
            level, message = OK, self.state
            if self.state == "active" and self.activity:
                message = self.activity
            if self._faults:
                faults = sorted(self._faults.values(), key=lambda fault: -fault.level)
                level, message = faults[0].level, "; ".join(fault.message for fault in faults)
            if silent and level < ERROR:
                # What is wrong may explain the silence, but a warning would hide it.
                message = f"{silent}: {message}" if level else silent
                level = ERROR
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
            return HealthReport(level, message, self.hardware_id, values, news)

    def _count_lost(self) -> None:
        """Count what numbers left out since the last report, unless they are of two publishers."""
        if self._apart or MIXED_INPUT in self._faults:
            if self._since is not None:
                self._since = (*self._since[:2], min(self._since[2], self._missed))
        elif self._gaps:
            self._missed += self._gaps
            self.counters["lost"] += self._gaps
        self._gaps, self._apart = 0, max(self._apart - self._compared, 0)
        self._compared = False

    def _measure(self, now: float, silent: bool) -> tuple[float | None, tuple[int, str]]:
        """Rate (Hz) and what is to be logged of it; a wrong one is a fault from now on."""
        told_otherwise = silent or any(f.level >= ERROR for f in self._faults.values())
        if told_otherwise or self.state != "active":
            self._faults.pop("rate", None)
        if self._since is None or self._first_sample is None or now <= self._since[0]:
            return None, (OK, "")
        passed = now - self._since[0]
        rate = (self._count - self._since[1]) / passed
        expected = self.expected_rate or rate + (self._missed - self._since[2]) / passed
        if passed < _SHORTEST or passed * expected < _FEWEST:
            return rate, (OK, "")
        self._since = (now, self._count, self._missed)
        if told_otherwise or self.state != "active":
            return rate, (OK, "")
        if abs(rate / expected - 1) > self.rate_tolerance:
            text = self._wrong_rate(rate, expected)
            self._faults["rate"] = _Fault(WARN, text, now)
            self.counters["rate"] += 1
            self.last_error = text
            if now - self._first_sample > _START:
                self._wrong_rates = min(self._wrong_rates + 1, _PATIENCE)
            if self._wrong_rates == _PATIENCE and not self._rate_told:
                self._rate_told = True
                return rate, (WARN, f"{self.name}: {text}")
        else:
            self._faults.pop("rate", None)
            self._wrong_rates = max(self._wrong_rates - 1, 0)
            if self._rate_told and not self._wrong_rates:
                self._rate_told = False
                return rate, (OK, f"{self.name}: rate {rate:.1f} Hz, as expected again")
        return rate, (OK, "")

    def _wrong_rate(self, rate: float, expected: float) -> str:
        if not self.expected_rate:
            return (
                f"{rate:.1f} of {expected:.1f} samples per second come through, the others are "
                "lost: this computer does not keep up"
            )
        text = f"rate {rate:.1f} Hz, expected {expected:.1f} Hz"
        slow = ": device, bus or this computer does not keep up"
        return text + slow if rate < expected else text
