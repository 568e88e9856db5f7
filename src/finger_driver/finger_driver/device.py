"""What all devices have in common: connecting, health, and a thread that keeps them connected."""

from __future__ import annotations

import abc
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import DeviceError, FingerError

Sample = TypeVar("Sample")
Log = Callable[[int, str], None]
"""Called with a level of `finger_common.diagnostics` (0 for information) and a sentence."""

HOLD = 2.0
"""Seconds for which a fault that has passed is still shown."""


class Device(abc.ABC, Generic[Sample]):
    """A source of samples.

    `connect` raises DeviceError or InputError and may be called again after `close`, which may be called at any
    time. `read` waits at most `timeout` seconds and returns None when no sample came; it raises DeviceError when
    the connection is lost. Faults go into `health` and, when new, to `log`.
    """

    def __init__(self, health: Health) -> None:
        self.health = health
        self.log: Log = lambda level, message: None
        self._noted: dict[str, float] = {}

    @abc.abstractmethod
    def connect(self) -> None:
        """Open the device, check it, make it ready to be read."""

    @abc.abstractmethod
    def read(self, timeout: float) -> Sample | None:
        """Next sample, or None."""

    @abc.abstractmethod
    def close(self) -> None:
        """Release the device."""

    def flush(self) -> None:
        """Throw away what has come since `connect`; called before reading begins."""

    def note(self, key: str, message: str, level: int = WARN) -> None:
        """Count a fault, and log it when it is new."""
        self._noted[key] = time.monotonic()
        if self.health.fault(key, message, level):
            self.log(level, message)

    def cleared(self, *keys: str) -> None:
        """Say that these faults are not there at the moment; each ends when it has not been noted for HOLD s.

        So a fault that comes and goes is logged once, and a look once a second does not miss a short one.
        """
        for key in keys:
            noted = self._noted.get(key)
            if noted is not None and time.monotonic() - noted > HOLD:
                del self._noted[key]
                self.health.recovered(key)


class DeviceThread(Generic[Sample]):
    """Reads a device in a thread of its own and reconnects, ever more patiently, when it is lost.

    `on_sample` is called in that thread. The pause between attempts grows from `first_pause` to `longest_pause`
    seconds by doubling and starts anew after a sample has come.
    """

    def __init__(
        self,
        device: Device[Sample],
        on_sample: Callable[[Sample], Any],
        first_pause: float = 0.25,
        longest_pause: float = 2.0,
    ) -> None:
        self._device = device
        self._on_sample = on_sample
        self._first_pause = first_pause
        self._longest_pause = longest_pause
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, connected: bool = True) -> None:
        """Begin to read; `connected` says that `connect` has already succeeded."""
        self._stop.clear()
        self._thread = threading.Thread(
            target=self._run, args=(connected,), name=self._device.health.name, daemon=True
        )
        self._thread.start()

    def stop(self, timeout: float = 5.0) -> bool:
        """End the thread; the device stays as it is. True when the thread has ended."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is None:
            return True
        thread.join(timeout)
        return not thread.is_alive()

    @property
    def running(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _run(self, connected: bool) -> None:
        device, pause = self._device, self._first_pause
        if connected:
            device.flush()
        while not self._stop.is_set():
            try:
                if not connected:
                    device.connect()
                    connected = True
                    device.health.count("reconnects")
                    if device.health.recovered("connection"):
                        device.log(0, f"{device.health.name}: connected again")
                sample = device.read(0.1)
                if sample is not None:
                    pause = self._first_pause
                    self._on_sample(sample)
            except FingerError as error:
                connected = False
                device.note("connection", one_line(error), ERROR)
                device.close()
                self._stop.wait(pause)
                pause = min(2 * pause, self._longest_pause)
            except Exception as error:
                # A defect, not a device: say so and go on, a dead thread would fail in silence.
                if self._stop.is_set():
                    return
                device.note("internal", f"{type(error).__name__}: {one_line(error)}", ERROR)
                self._stop.wait(pause)


def connect_within(device: Device[Any], seconds: float, pause: float = 0.25) -> None:
    """Connect, trying again until `seconds` have passed; raises the last DeviceError."""
    end = time.monotonic() + seconds
    while True:
        try:
            device.connect()
            return
        except DeviceError:
            device.close()
            if time.monotonic() + pause > end:
                raise
        time.sleep(pause)
