# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A moisture probe's serial adapter behind a pseudo-terminal: one line per reading.

Models: lines at the port of a real adapter, unplugging and plugging in again under the same name (a
symbolic link), half lines, noise, a wrong unit's number (FAULTS). Does not model: baud rate, parity
and framing errors (a pty has none), the second that a Corneometer needs for a reading, its
calibration. The line format is this project's: no public protocol of the probe is known.
"""

from __future__ import annotations

import os
import pty
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from finger_common.settings import Settings, setting

from .simulator import Simulator
from .values import numbers

FAULTS = {
    "silent": "sends nothing",
    "half_line": "sends the first half of a line without an end",
    "garbage": "sends bytes that are not text",
    "no_end": "sends digits without any end of line",
    "held": "keeps a reading back and sends it in one piece with the next",
}


@dataclass(frozen=True)
class SerialOptions(Settings):
    """Options of the simulated adapter."""

    link: str = setting("", "Symbolic link to the pseudo-terminal; empty for none.")
    values: str = setting("", "Readings to send in turn, repeatedly, separated by commas.")
    period: float = setting(5.0, "Time between readings.", unit="s", minimum=0.01)


class SerialMoistureSimulator(Simulator):
    """Serial moisture adapter on a pseudo-terminal.

    Its far end is named `port`; `link`, if given, is a symbolic link to it that stays. `values` are
    sent in turn every `period` s.
    """

    NAME = "serial"
    SETTINGS = SerialOptions
    FAULTS = FAULTS

    def __init__(
        self,
        link: str | Path | None = None,
        values: list[float] | None = None,
        period: float = 5.0,
    ) -> None:
        super().__init__()
        self._link = Path(link) if link is not None else None
        self._values = values or []
        self._period = period
        self._controller = self._far = -1
        self._held = b""
        self.plug_in()

    @classmethod
    def from_settings(cls, settings: SerialOptions) -> SerialMoistureSimulator:
        return cls(
            settings.link or None,
            values=numbers(settings.values, "--values"),
            period=settings.period,
        )

    def describe(self) -> str:
        return f"on {self.port}"

    def commands(self) -> dict[str, Callable[..., None]]:
        return {
            "send": lambda value, phase="before": self.send(float(value), phase),
            "unplug": self.unplug,
            "plug": self.plug_in,
        }

    def run(self) -> None:
        for number in self.each(lambda: self._period if self._values else 0.0):
            self.send(self._values[number % len(self._values)])

    @property
    def port(self) -> str:
        """Name of the port to open: the link, or the pty's own."""
        return str(self._link) if self._link is not None else self._name

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._controller >= 0

    def plug_in(self) -> None:
        """Make the port appear."""
        self.unplug()
        self._controller, self._far = pty.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._controller, False)
        self._name = os.ttyname(self._far)
        if self._link is not None:
            temporary = self._link.with_name(f".{self._link.name}.new")
            temporary.unlink(missing_ok=True)
            temporary.symlink_to(self._name)
            os.replace(temporary, self._link)

    def unplug(self) -> None:
        """Make the port vanish; a reader gets an error."""
        for descriptor in (self._controller, self._far):
            if descriptor >= 0:
                os.close(descriptor)
        self._controller = self._far = -1
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def send(self, value: float, phase: str = "before") -> None:
        """Send one reading; phase is "before", "after" or ""."""
        separator = ";" if phase else ""
        data = f"M={value:.1f}{separator}{phase}\r\n".encode("ascii")
        if self.faults.take("silent"):
            return
        if self.faults.take("half_line"):
            data = data[: len(data) // 2]
        if self.faults.take("garbage"):
            data = bytes(range(128, 200)) + b"\r\n"
        if self.faults.take("no_end"):
            data = b"7" * 4000
        data, self._held = self._held + data, b""
        if self.faults.take("held"):
            self._held = data
            return
        self._write(data)

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._controller, data)
        except OSError:
            # Unplugged, or no reader; an adapter's buffer overflows, too.
            pass

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()
