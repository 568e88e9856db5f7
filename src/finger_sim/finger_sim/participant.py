# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated participant: does what the announced phase of the trial asks for, in real time.

It plays planned trials: the force on the plate and the frame the camera sees at any instant, and
moisture readings one after another. It knows no devices; the rig asks it for values and hands them
to the device simulators.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from finger_common.guided_presses import CALIBRATION_PRESSES, PRESS_BY_NAME
from finger_common.host_clock import HostClock
from finger_common.stamps import NANOSECONDS, nanoseconds, seconds
from finger_common.trial_phases import TrialPhase
from finger_model.paper import READINGS_PER_TRIAL

from .planner import Planner
from .trial_plan import PlannedTrial, TrialRequest

BEFORE, AFTER = "before", "after"
"""Side of the press on which a moisture reading is taken, as the probe sends it."""

REPEAT_DELAY = 3.0
"""s after the last reading until another is taken because the phase has not changed."""

REPEATED_READINGS = 5
"""Readings repeated at most."""


@dataclass(frozen=True)
class FrameClock:
    """Mid-exposures of the camera: frame k at first_ns + k period_ns of the host's clock."""

    first_ns: int
    period_ns: int
    host: HostClock = field(default_factory=HostClock)

    def next_after(self, stamp_ns: int) -> int:
        """Stamp of the first frame at or after a time."""
        frame = -(-(stamp_ns - self.first_ns) // self.period_ns)
        return self.first_ns + frame * self.period_ns


@dataclass(frozen=True)
class _Press:
    """A planned press that began at `start_ns`."""

    trial: PlannedTrial
    start_ns: int


def _likely_next(request: TrialRequest) -> TrialRequest:
    """The next press of a calibration, or the next trial of the same condition."""
    index, condition = request.index + 1, request.condition
    if condition in PRESS_BY_NAME and index < len(CALIBRATION_PRESSES):
        condition = CALIBRATION_PRESSES[index].name
    return replace(request, condition=condition, index=index, attempt=0)


class Participant:
    """Acts on announced phases in a thread of its own.

    clock: of the camera; a press starts on a frame, so that frame k of the plan is the k-th of the
    press. send_reading(value, side): hands a moisture reading to the probe. reading_time: s a
    reading takes. report(text): progress as text. played(trial, start_ns): called after each
    press. upcoming: trials known to come, planned ahead in this order; without them the next of
    the block is guessed.
    """

    def __init__(
        self,
        planner: Planner,
        clock: FrameClock,
        send_reading: Callable[[float, str], None],
        played: Callable[[PlannedTrial, int], None],
        reading_time: float = 1.0,
        report: Callable[[str], None] = print,
        upcoming: Sequence[TrialRequest] = (),
    ) -> None:
        self._planner = planner
        self._clock = clock
        self._send_reading = send_reading
        self._played = played
        self._reading_time = reading_time
        self._report = report
        self._upcoming = tuple(upcoming)
        self._announced: queue.SimpleQueue[tuple[TrialRequest, int] | None] = queue.SimpleQueue()
        self._last: tuple[TrialRequest, int] | None = None
        self._stop = threading.Event()
        self._press: _Press | None = None
        self._trial: PlannedTrial | None = None
        self._thread = threading.Thread(target=self._act, name="participant", daemon=True)

    def start(self) -> None:
        """Have the upcoming trials planned and begin to act."""
        for request in self._upcoming:
            self._planner.ask(request)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()
        self._announced.put(None)
        self._thread.join(5.0)

    # What the rig asks -------------------------------------------------------------------------

    def announce(self, request: TrialRequest, phase: int) -> None:
        """This trial is in this phase now; the same again changes nothing."""
        if (request, phase) != self._last:
            self._last = (request, phase)
            self._announced.put((request, phase))

    def normal_force(self, now_ns: int) -> float:
        """Force on the plate in N."""
        playing = self._press
        if playing is None:
            return 0.0
        press = playing.trial.press
        since = seconds(now_ns - playing.start_ns)
        return float(np.interp(since, press.time, press.force, left=0.0, right=0.0))

    def tangential_force(self, now_ns: int) -> np.ndarray | None:
        """Force (2,) on the plate along its x and y in N; None but in a pull."""
        playing = self._press
        if playing is None or playing.trial.pull is None:
            return None
        return playing.trial.pull.force_on_plate(seconds(now_ns - playing.start_ns))

    def pressure_center(self, now_ns: int) -> np.ndarray:
        """Point (2,) of the plate in m about which the pressure has no torque."""
        playing = self._press
        if playing is None:
            return np.zeros(2)
        trial, since = playing.trial, seconds(now_ns - playing.start_ns)
        x, y = (np.interp(since, trial.frame_time, along) for along in trial.pressure_center.T)
        return np.array([x, y])

    def frame(self, frame_ns: int) -> Path | None:
        """Image file of the contact at a frame's mid-exposure, None for an empty plate."""
        playing = self._press
        if playing is None:
            return None
        number = round((frame_ns - playing.start_ns) / self._clock.period_ns)
        frames = playing.trial.frames
        return frames[number] if 0 <= number < len(frames) else None

    # What it does ------------------------------------------------------------------------------

    def _act(self) -> None:
        for request, phase in iter(self._announced.get, None):
            try:
                self._act_on(request, phase)
            except Exception as error:
                self._report(f"simulated participant: {error}")

    def _act_on(self, request: TrialRequest, phase: int) -> None:
        if phase == TrialPhase.PREPARE:
            self._planner.ask(request)
            if not self._upcoming:
                # The next trial of the block is likely; plan it while this one is played.
                self._planner.ask(_likely_next(request))
            return
        if phase not in (TrialPhase.MOISTURE_BEFORE, TrialPhase.PRESS, TrialPhase.MOISTURE_AFTER):
            return
        trial = self._take_up(request)
        if trial is None:
            return
        if phase == TrialPhase.PRESS:
            self._play(trial)
        elif phase == TrialPhase.MOISTURE_BEFORE:
            self._give_readings(trial.moisture[: READINGS_PER_TRIAL // 2], BEFORE)
        else:
            self._give_readings(trial.moisture[READINGS_PER_TRIAL // 2 :], AFTER)

    def _take_up(self, request: TrialRequest) -> PlannedTrial | None:
        """Make a trial the current one, wait until it is planned, and delete the frames of the one
        before; None when stopped."""
        if self._trial is None or self._trial.request != request:
            for path in self._trial.frames if self._trial is not None else ():
                path.unlink(missing_ok=True)
            started = time.monotonic()
            self._trial = self._planner.get(request, self._stop)
            waited = time.monotonic() - started
            if waited > 0.1:
                self._report(f"planned trial {request.name}, waited {waited:.1f} s for it")
        return self._trial

    def _give_readings(self, values: np.ndarray, side: str) -> None:
        for value in values:
            if self._stop.wait(self._reading_time):
                return
            self._send_reading(float(value), side)
        for _ in range(REPEATED_READINGS):
            # The phase has not changed: a reading was lost on its way, take another.
            for _ in range(round(REPEAT_DELAY / 0.05)):
                if not self._announced.empty() or self._stop.wait(0.05):
                    return
            self._send_reading(float(values[-1]), side)

    def _play(self, trial: PlannedTrial) -> None:
        start_ns = self._clock.next_after(self._clock.host.now() + self._clock.period_ns)
        self._press = _Press(trial, start_ns)
        end_ns = start_ns + nanoseconds(trial.press.duration)
        self._stop.wait(max(end_ns - self._clock.host.now(), 0) / NANOSECONDS)
        self._press = None
        self._played(trial, start_ns)
