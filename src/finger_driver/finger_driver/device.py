# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What all devices have in common: connecting, health, and a thread that keeps them connected."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import DeviceError, FingerError
from finger_common.host_clock import HostClock
from finger_common.retry import Pauses
from finger_common.settings import Settings

from .shared_polling import SHARED, Polled, Rest

Sample = TypeVar("Sample")
Log = Callable[[int, str], None]
"""Called with a level of `finger_common.diagnostics` (0 for information) and a sentence."""


class Device(Generic[Sample]):
    """A source of samples.

    `connect` raises DeviceError or InputError and may be called again after `close`, which may be
    called at any time, also once the device is gone. `read` waits at most `timeout` seconds and
    returns None when no sample came; it raises DeviceError when the connection is lost. Faults go
    into `health` and, when new, to `log`. Stamps come from `clock`.
    """

    SETTINGS: type[Settings] = Settings
    """The settings that the class is made with."""
    SIMULATOR: str = ""
    """Its simulator as "module:class", for `finger-device-sim`; empty where there is none."""

    def __init__(self, settings: Any, health: Health) -> None:
        self.settings = settings
        self.health = health
        self.clock = HostClock()
        self.log: Log = lambda level, message: None

    def connect(self) -> None:
        """Open the device, check it, make it ready to be read."""
        raise NotImplementedError

    def read(self, timeout: float) -> Sample | None:
        """Next sample, or None."""
        raise NotImplementedError

    def close(self) -> None:
        """Release the device."""
        raise NotImplementedError

    def polled(self) -> Polled | None:
        """The device for a thread that polls several; None where it needs its own for now."""
        return None

    def flush(self) -> None:
        """Discard what has come since `connect`; called before reading begins."""

    def note(self, key: str, message: str, level: int = WARN) -> None:
        """Count a fault, and log it when it is new."""
        if self.health.fault(key, message, level):
            self.log(level, message)

    def cleared(self, *keys: str) -> None:
        """These faults are absent now, see `Health.cleared`."""
        self.health.cleared(*keys)

    def note_if(self, present: bool, key: str, message: str) -> None:
        """Note a fault that is present, clear one that is absent."""
        if present:
            self.note(key, message)
        else:
            self.cleared(key)


class DeviceThread(Generic[Sample]):
    """Reads a device in a thread of its own and connects again when it is lost.

    `on_sample` is called in that thread, or in the one that polls several devices, while this one
    waits. What it returns is called afterwards; where several devices replied at once, after the
    samples of all of them. A sample resets the pause between attempts. `on_connected_again` is
    called in the device's own thread, before the first sample of the new connection.
    """

    def __init__(
        self,
        device: Device[Sample],
        on_sample: Callable[[Sample], Rest | None],
        pauses: Pauses,
        on_connected_again: Callable[[], None] = lambda: None,
    ) -> None:
        self._device = device
        self._on_sample = on_sample
        self._pauses = pauses
        self._on_connected_again = on_connected_again
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._lost = ""
        """Why the device was lost, until it is seen to work again."""

    def connect(self, seconds: float) -> None:
        """Connect, trying again until `seconds` have passed; raises the last DeviceError, and at
        once InputError, or DeviceError for a defect of the driver."""
        end = time.monotonic() + seconds
        while True:
            try:
                self._device.connect()
                break
            except DeviceError:
                self._close()
                pause = self._pauses.next()
                if time.monotonic() + pause > end:
                    raise
            except FingerError:
                raise
            except Exception as error:
                driver, kind = type(self._device).__name__, type(error).__name__
                raise DeviceError(
                    f"{driver}.connect failed ({kind}: {one_line(error)}); correct this driver or "
                    "its settings"
                ) from error
            time.sleep(pause)
        self._pauses.reset()

    def start(self) -> None:
        """Begin to read the device, which is connected."""
        self._stop.clear()
        self._thread = threading.Thread(
            target=self._run, name=self._device.health.name, daemon=True
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
        """Whether the thread was started and has not ended."""
        return self._thread is not None and self._thread.is_alive()

    def _run(self) -> None:
        device, connected, flushed = self._device, True, False
        while not self._stop.is_set():
            try:
                if not flushed:
                    flushed = True
                    device.flush()
                if not connected:
                    device.connect()
                    connected = True
                    device.health.count("reconnects")
                    self._on_connected_again()
                polled = device.polled()
                if polled is not None:
                    SHARED.serve(polled, self._deliver, self._stop.is_set)
                    continue
                sample = device.read(0.1)
                if sample is None:
                    if device.health.stale_after is None:  # its next one may be minutes away
                        self._works()
                    continue
                rest = self._deliver(sample)
                if rest is not None:
                    rest()
            except FingerError as error:
                connected, self._lost = False, one_line(error)
                device.note("connection", self._lost, ERROR)
                self._close()
                self._stop.wait(self._pauses.next())
            except Exception as error:
                # A defect of the program: a dead thread would fail silently.
                if self._stop.is_set():
                    return
                connected, self._lost = False, f"{type(error).__name__}: {one_line(error)}"
                device.note("internal", self._lost, ERROR)
                self._close()
                self._stop.wait(self._pauses.next())

    def _close(self) -> None:
        """Release the device, which may fail where it was unplugged."""
        try:
            self._device.close()
        except Exception as error:
            kind = type(error).__name__
            self._device.note("close", f"closing it failed ({kind}: {one_line(error)})")

    def _deliver(self, sample: Sample) -> Rest | None:
        self._pauses.reset()
        rest = self._on_sample(sample)
        self._works()
        return rest

    def _works(self) -> None:
        """The device was read without a failure; a device that only connects may not work."""
        if not self._lost:
            return
        lost, self._lost, health = self._lost, "", self._device.health
        health.cleared("internal", "close")
        if health.passed("connection", f"connected again after: {lost}"):
            self._device.log(0, f"{health.name}: connected again")
