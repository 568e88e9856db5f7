# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What all simulated devices share: faults, a thread, options, commands of `finger-device-sim`."""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import can

from finger_common.cli import one_line
from finger_common.settings import Settings, setting

from .. import can_bus
from .faults import Faults

S = TypeVar("S", bound="Simulator")


class Simulator:
    """A simulated device.

    It is served in a thread from `start` to `stop`, or within a `with` block.
    """

    NAME = ""
    """Its subcommand of `finger-device-sim`."""
    SETTINGS: type[Settings] = Settings
    """Options of the subcommand."""
    POSITIONAL = ""
    """Setting that the subcommand takes without an option's name."""
    FAULTS: Mapping[str, str] = {}
    """Meaning of each fault by its name."""

    def __init__(self) -> None:
        self.faults = Faults(self.FAULTS)
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    @classmethod
    def from_settings(cls: type[S], settings: Any) -> S:
        """Simulator of the subcommand's options; raises InputError for one that cannot be used."""
        return cls(settings)  # type: ignore[call-arg]

    def describe(self) -> str:
        """Where the device is found, as "on …" or "in …"."""
        raise NotImplementedError

    def run(self) -> None:
        """Serve the device until `ending`; called in the thread."""
        raise NotImplementedError

    def commands(self) -> dict[str, Callable[..., Any]]:
        """What lines on standard input can do beside switching faults; arguments are texts."""
        return {}

    def close(self) -> None:
        """Release what the simulator opened; called when the thread has ended."""

    @property
    def ending(self) -> bool:
        """Whether the simulator was asked to end."""
        return self._ending.is_set()

    def each(self, period: Callable[[], float]) -> Iterator[int]:
        """0, 1, 2, … every `period()` seconds until the end; a period of 0 never comes."""
        number, due = 0, time.monotonic()
        while not self._ending.wait(max(0.0, due - time.monotonic())):
            seconds = period()
            if not seconds:
                due = time.monotonic() + 0.1
                continue
            yield number
            number += 1
            due = max(due + seconds, time.monotonic() - seconds)

    def start(self: S) -> S:
        """Serve the device in a thread; returns itself."""
        self._ending.clear()
        self._thread = threading.Thread(target=self._serve, name=self.NAME, daemon=True)
        self._thread.start()
        return self

    def _serve(self) -> None:
        said = ""
        while not self.ending:
            try:
                self.run()
            except can.CanError:
                # The bus went down, or a client was too slow; the device itself continues.
                self._ending.wait(0.05)
            except Exception as error:
                # A dead thread would be silent, as a device without power.
                text = f"{self.NAME}: {type(error).__name__}: {one_line(error)}"
                if text != said:
                    print(text, flush=True)
                said = text
                self._ending.wait(0.05)

    def stop(self) -> None:
        """End the thread and release what it used."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(5)
            self._thread = None
        self.close()

    def __enter__(self: S) -> S:
        return self if self._thread is not None else self.start()

    def __exit__(self, *exception: object) -> None:
        self.stop()

    @classmethod
    def limits(cls) -> str:
        """What it does not model, from the docstring of its module or its own."""
        for text in (inspect.getdoc(inspect.getmodule(cls)), inspect.getdoc(cls)):
            _, found, rest = " ".join((text or "").split()).partition("Does not model")
            if found:
                return found + rest
        return ""


@dataclass(frozen=True)
class BusOptions(Settings):
    """The bus of a simulated device on CAN."""

    interface: str = setting("udp_multicast", "python-can interface.")
    channel: str = setting("", "Its channel; empty for its usual one.")
    bitrate: int = setting(0, "Bit rate; 0 leaves it as set.", unit="bit/s", minimum=0)
    options: str = setting("", "Its options, key=value,key=value.")

    def open_bus(self) -> can.BusABC:
        """The bus; raises InputError or DeviceError where it does not open."""
        return can_bus.open_bus(self.interface, self.channel, self.bitrate, self.options)


class CanSimulator(Simulator):
    """A simulated device on a CAN bus, which stays the caller's unless `owns_bus`."""

    bus: can.BusABC
    owns_bus = False

    def describe(self) -> str:
        return f"on {can_bus.describe(self.bus)}"

    def request(self, timeout: float) -> can.Message | None:
        """Frame that came within `timeout` (s), None for one that cannot be a request: devices take
        data frames of CAN 2.0 with 11-bit identifiers."""
        frame = self.bus.recv(timeout)
        if frame is None or frame.is_extended_id or frame.is_error_frame:
            return None
        return None if frame.is_remote_frame or frame.is_fd else frame

    def close(self) -> None:
        if self.owns_bus:
            self.bus.shutdown()
