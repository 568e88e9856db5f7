# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One thread that polls several devices: it asks all of them, then takes the replies.

A thread for each device would wake up, fetch its code into the processor's caches and wait for the
interpreter's lock anew for every sample; here this happens once for the samples of all devices.
The shared thread never waits for one device. What takes longer than an exchange (a lost reply, a
check, connecting again) is done by the device's own thread, which waits in `serve` meanwhile.
"""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

_LONGEST_WAIT = 0.05
"""s after which the thread looks for devices that were stopped; those that join wake it up."""
_TOGETHER = 100e-6
"""s by which a request may be early, so that devices of one rate are asked together."""
_IDLE = 5.0
"""s without a device after which the thread ends."""


Rest = Callable[[], None]
"""What is left to do with a sample when the others have been delivered."""


class Polled(Protocol):
    """A device that is asked for each sample. Methods do not wait; they may raise.

    period, due: s between requests, and when the next one is due (monotonic s). asked: whether a
    reply is awaited. deadline: when it counts as lost (monotonic s).
    """

    period: float
    due: float
    asked: bool
    deadline: float

    def fileno(self) -> int:
        """What becomes readable when something has come."""
        raise NotImplementedError

    def needs_own_thread(self, now: float) -> bool:
        """Whether it must do something that takes time."""
        raise NotImplementedError

    def request(self) -> None:
        """Ask for a sample."""
        raise NotImplementedError

    def reply(self) -> Any:
        """The sample, None when it has not come completely."""
        raise NotImplementedError


class _Seat:
    """A device while the shared thread polls it."""

    def __init__(
        self, device: Polled, deliver: Callable[[Any], Rest | None], ended: Callable[[], bool]
    ) -> None:
        self.device = device
        self.deliver = deliver
        self.ended = ended
        self.released = threading.Event()
        self.error: BaseException | None = None
        self.rest: Rest | None = None


class SharedPolling:
    """The thread and the devices it polls."""

    def __init__(self) -> None:
        self._joining: list[_Seat] = []
        self._change = threading.Condition()
        self._running = False
        self._woken, self._wake = os.pipe()

    def serve(
        self, device: Polled, deliver: Callable[[Any], Rest | None], ended: Callable[[], bool]
    ) -> None:
        """Have the device polled until it needs its own thread, the caller's, or `ended()`.

        Samples go to `deliver`, in the shared thread. What it returns is called when no other
        device's reply waits, and before this device's next sample: work that nobody waits for.
        Raises what the device or `deliver` raised.
        """
        seat = _Seat(device, deliver, ended)
        with self._change:
            self._joining.append(seat)
            self._change.notify()
            os.write(self._wake, b"\0")
            if not self._running:
                self._running = True
                threading.Thread(target=self._run, name="polling", daemon=True).start()
        seat.released.wait()
        if seat.error is not None:
            raise seat.error

    def _run(self) -> None:
        seats: list[_Seat] = []
        while self._admit(seats):
            now = time.monotonic()
            wake = now + _LONGEST_WAIT
            for seat in list(seats):
                if self._attend(seat, now):
                    device = seat.device
                    wake = min(wake, device.deadline if device.asked else device.due)
                else:
                    seats.remove(seat)
                    self._finish(seat)
                    seat.released.set()
            if not seats:
                continue
            left = max(0.0, wake - time.monotonic())
            replied = self._replied(seats, left)
            for seat in sorted(replied, key=lambda seat: seat.rest is not None):
                self._take(seat)
            for seat in seats:
                if seat.rest is not None and self._replied(seats, 0.0):
                    break  # Their samples come first.
                self._finish(seat)

    def _replied(self, seats: list[_Seat], wait: float) -> list[_Seat]:
        """Those of which something has come, at the latest after `wait` (s); ends early when a
        device joins."""
        asked = [seat for seat in seats if seat.device.asked]
        try:
            awaited: list[Any] = [self._woken, *(seat.device for seat in asked)]
            found, _, _ = select.select(awaited, [], [], wait)
        except Exception:
            # One was closed meanwhile; it will say so itself.
            return asked
        return [seat for seat in asked if seat.device in found]

    def _admit(self, seats: list[_Seat]) -> bool:
        """Take in the devices that join; False when there are none for long."""
        if seats and not self._joining:
            return True
        with self._change:
            if not seats and not self._joining and not self._change.wait(_IDLE):
                self._running = False
                return False
            for seat in self._joining:
                for other in seats:
                    if other.device.period == seat.device.period:
                        seat.device.due = other.device.due
                        break
                seats.append(seat)
            if self._joining:
                os.read(self._woken, len(self._joining))
            self._joining.clear()
        return True

    def _attend(self, seat: _Seat, now: float) -> bool:
        """Ask the device when it is due; False when it leaves."""
        device = seat.device
        try:
            if seat.error is not None or seat.ended() or device.needs_own_thread(now):
                return False
            if not device.asked and device.due <= now + _TOGETHER:
                device.request()
        except BaseException as error:
            seat.error = error
            return False
        return True

    def _take(self, seat: _Seat) -> None:
        self._finish(seat)
        try:
            sample = seat.device.reply()
            if sample is not None and not seat.ended():
                seat.rest = seat.deliver(sample)
        except BaseException as error:
            seat.error = error

    def _finish(self, seat: _Seat) -> None:
        rest, seat.rest = seat.rest, None
        try:
            if rest is not None:
                rest()
        except BaseException as error:
            seat.error = error


SHARED = SharedPolling()
"""That of this process."""
