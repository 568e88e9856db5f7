# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What keeps the next trial from being recorded well, and what the operator does about it.

A device counts as gone as soon as its stream or its node's heartbeat falls silent, so that no old
value stands on the page for longer than a second. No ROS; times are s on a steady clock.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from finger_common.diagnostics import ERROR, STARTING, WARN, cause_of

STREAM_SILENT = 0.6
"""s without a sample of a stream until it counts as silent."""

NODE_SILENT = 0.9
"""s without a heartbeat until a node counts as not running; it beats every 0.25 s."""


REPORT_ENDS = 3.0
"""s behind its node's newest report from which that of a part counts no longer: the part is gone;
each part reports once a second."""

SHORT = 60
"""Characters of a device's own words that stand in the banner's large line."""


@dataclass(frozen=True)
class Device:
    """A part of the rig that a trial needs.

    nodes: all must run. stream: whose samples must come; empty for none. name: as the operator
    calls it. silence: what is said when its stream is silent. remedy: in place of that of a device
    with a cable.
    """

    key: str
    name: str
    nodes: tuple[str, ...]
    stream: str = ""
    silence: str = ""
    remedy: str = ""

    @property
    def advice(self) -> str:
        """What the operator does when it is silent or has a fault."""
        cable = f"Check power and cable of the {self.name}; its driver connects again by itself."
        return self.remedy or cable


TERMINAL = "Read the rig's terminal."
DISK_REMEDY = f"Make room on the disk of the sessions. If that is not it: {TERMINAL}"
NODE_REMEDY = "It is started again by itself. If it stays away, read the rig's terminal."
START_REMEDY = "Please wait. The very first start of a rig takes a few minutes."

DEVICES = (
    Device("protocol", "protocol", ("protocol",), remedy=TERMINAL),
    Device("force", "force sensor", ("force",), "force", "No force"),
    Device("camera", "camera", ("camera", "vision"), "area", "No contact area"),
    Device("recorder", "recorder", ("recorder",), remedy=DISK_REMEDY),
    Device("moisture", "moisture probe", ("moisture",)),
    Device("model", "model", ("model",), "model", "No estimate", TERMINAL),
)

NODE_NAMES = {
    "protocol": "protocol",
    "force": "force driver",
    "camera": "camera driver",
    "vision": "measurement of the area",
    "recorder": "recorder",
    "moisture": "moisture driver",
    "model": "model",
}

ALWAYS = ("protocol", "force")
"""Devices that no session goes without; the others count where they were seen."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    age: s since the last sign of life, None when there was none. detail: the device's own words,
    where they are too long to be read from afar. starting: it needs nothing but time.
    """

    source: str
    text: str
    remedy: str
    age: float | None = None
    detail: str = ""
    starting: bool = False


TARE_NEEDED = Problem("tare", "Tare needed.", "Take the finger off the plate, then press Tare (T).")

NO_PROBE = Problem(
    "moisture",
    "No moisture probe runs.",
    "Start the node moisture, or begin a session with Readings 0.",
)
"""Where the node was never seen, in a session that takes readings."""


def tared_by(node: str | None, values: Mapping[str, str]) -> bool | None:
    """Whether the force has a zero, by the values of a node's status in /diagnostics; None where
    they do not tell, as those of another node or of a driver that is not the suite's."""
    return values["tared"] == "yes" if node == "force" and "tared" in values else None


@dataclass(frozen=True)
class _Report:
    """Last /diagnostics of a part of a node. came: s."""

    level: int
    message: str
    came: float


class Readiness:
    """Follows streams, heartbeats and diagnostics."""

    def __init__(self) -> None:
        self._samples: dict[str, float] = {}
        self._beats: dict[str, float] = {}
        self._reports: dict[str, dict[str, _Report]] = {}
        self._tared: tuple[float, bool] | None = None
        self._starting: set[str] = set()

    def sample(self, stream: str, now: float) -> None:
        """A sample of a stream came."""
        if stream == "force" and self._silent(stream, now):
            # The driver may have started again, which loses its zero; its diagnostics tell.
            self._tared = None
        self._samples[stream] = now

    def beat(self, node: str, now: float) -> None:
        """A node's heartbeat came."""
        self._beats[node] = now

    def report(
        self, node: str, part: str, level: int, message: str, values: Mapping[str, str], now: float
    ) -> None:
        """A status of /diagnostics came. part: which health of the node."""
        self._reports.setdefault(node, {})[part] = _Report(level, message, now)
        if node == "bring_up":
            self._starting = set(values.get(STARTING, "").split())
        if (tared := tared_by(node, values)) is not None:
            self._tared = (now, tared)

    def age(self, stream: str, now: float) -> float | None:
        """s since the last sample of a stream; None before the first."""
        last = self._samples.get(stream)
        return None if last is None else now - last

    def running(self, node: str, now: float) -> bool:
        """Whether a node's heart beats."""
        last = self._beats.get(node)
        return last is not None and now - last <= NODE_SILENT

    def dead(self, now: float) -> set[str]:
        """Nodes that were seen and are silent."""
        return {node for node in self._beats if not self.running(node, now)}

    @property
    def tared(self) -> bool | None:
        """Whether the force has a zero; None while unknown."""
        return None if self._tared is None else self._tared[1]

    def problems(self, now: float, also: Collection[str] = ()) -> list[Problem]:
        """Everything that is wrong now, the most important first.

        also: keys of devices that this session does not go without, beside ALWAYS.
        """
        needed = {*ALWAYS, *also}
        problems = [self._problem(device, now, device.key in needed) for device in DEVICES]
        return [problem for problem in problems if problem is not None]

    def _silent(self, stream: str, now: float) -> bool:
        age = self.age(stream, now)
        return age is None or age > STREAM_SILENT

    def _newest_reports(self, node: str) -> list[_Report]:
        """Of the parts that a node still has."""
        reports = self._reports.get(node, {}).values()
        newest = max((report.came for report in reports), default=0.0)
        return [report for report in reports if newest - report.came <= REPORT_ENDS]

    def warning(self, node: str) -> str:
        """The warning of a node's newest reports, empty for none; faults are `problems`."""
        reports = self._newest_reports(node)
        return next((report.message for report in reports if report.level == WARN), "")

    def _problem(self, device: Device, now: float, needed: bool) -> Problem | None:
        if not needed and not self._beats.keys() & set(device.nodes):
            return None
        # A driver of another make than the suite's has no heartbeat: its stream is enough.
        flowing = bool(device.stream) and not self._silent(device.stream, now)
        for node in device.nodes:
            if not self.running(node, now) and (node in self._beats or not flowing):
                if node in self._starting:
                    return _starts(device.key, node)
                last = self._beats.get(node)
                if last is None and device.key == NO_PROBE.source:
                    return NO_PROBE
                age = None if last is None else now - last
                return Problem(
                    device.key, f"The {NODE_NAMES[node]} is not running.", NODE_REMEDY, age
                )
        fault = next(
            (
                cause  # the age of the stream says already how long it is silent
                for node in device.nodes
                for report in self._newest_reports(node)
                if report.level == ERROR and (cause := cause_of(report.message))
            ),
            "",
        )
        if device.stream and not flowing:
            if device.key == "model" and self._silent("force", now):
                return None  # the missing force says it already
            starting = [node for node in device.nodes if node in self._starting]
            if starting and not fault:
                return _starts(device.key, starting[0])
            age = self.age(device.stream, now)
            short = f": {fault}" if 0 < len(fault) <= SHORT else ""
            return Problem(
                device.key, f"{device.silence}{short}.", device.advice, age, "" if short else fault
            )
        tare = self._tare_problem() if device.key == "force" else None
        if tare is not None or not fault:
            return tare
        if len(fault) > SHORT:
            text = f"The {device.name} has a fault."
            return Problem(device.key, text, device.advice, None, fault)
        return Problem(device.key, f"{_capital(device.name)}: {fault}.", device.advice)

    def _tare_problem(self) -> Problem | None:
        if self.tared is False:
            return TARE_NEEDED
        if self.tared is None and "force" in self._beats:
            return Problem("tare", "Looking for the force sensor's zero.", "Wait a moment.")
        return None


def _starts(key: str, node: str) -> Problem:
    return Problem(key, f"The {NODE_NAMES[node]} is starting.", START_REMEDY, starting=True)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def refusal(problems: list[Problem]) -> str:
    """Why a trial may not begin; empty when it may."""
    if not problems:
        return ""
    first = problems[0]
    more = f" ({len(problems) - 1} more)" if problems[1:] else ""
    return f"Not ready: {first.text} {first.remedy}{more}"
