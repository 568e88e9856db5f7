"""The simulated participant: does what the trial's phase on the screen says, in real time.

Plays planned trials: the force on the plate and the frame the camera sees at any instant, and moisture readings
one after another. Knows nothing of devices; the rig asks it for values and hands them to the device simulators.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .planner import Planner
from .trial_plan import PlannedTrial, TrialRequest

PHASE_PREPARE, PHASE_MOISTURE_BEFORE, PHASE_PRESS, PHASE_MOISTURE_AFTER = 1, 2, 3, 5
"""Phases the participant acts upon, numbered as in finger_msgs/Trial."""

BEFORE, AFTER = 1, 2
"""Phase of a moisture reading, numbered as in finger_msgs/Moisture."""

READINGS_A_SIDE = 3

PATIENCE = 3.0
"""s after the last reading until another is taken because the screen still asks for it."""

MOST_RETAKEN = 5


@dataclass(frozen=True)
class _Played:
    trial: PlannedTrial
    start_ns: int


class Participant:
    """Acts on announced phases in a thread of its own.

    frame_period_ns, first_frame_ns: the camera's clock; a press starts on a frame, so that frame k of the plan is
    the k-th of the press. send_reading(value, phase): hands a moisture reading to the probe. reading_time: s a
    reading takes. report(text): progress in words. played(trial, start_ns): called after each press. upcoming: trials
    known to come, planned ahead in this order; without them the next of the block is guessed.
    """

    def __init__(
        self,
        planner: Planner,
        frame_period_ns: int,
        first_frame_ns: int,
        send_reading: Callable[[float, int], None],
        reading_time: float = 1.0,
        report: Callable[[str], None] = print,
        played: Callable[[PlannedTrial, int], None] | None = None,
        upcoming: Sequence[TrialRequest] = (),
    ) -> None:
        self._planner = planner
        self._period = frame_period_ns
        self._first = first_frame_ns
        self._send_reading = send_reading
        self._reading_time = reading_time
        self._report = report
        self._played_callback = played
        self._upcoming = tuple(upcoming)
        self._commands: queue.SimpleQueue[tuple[TrialRequest, int] | None] = queue.SimpleQueue()
        self._seen: tuple[TrialRequest, int] | None = None
        self._stop = threading.Event()
        self._playing: _Played | None = None
        self._trial: PlannedTrial | None = None
        self._thread = threading.Thread(target=self._live, name="participant", daemon=True)
        self.error: BaseException | None = None

    def start(self) -> None:
        for request in self._upcoming:
            self._planner.ask(request)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._commands.put(None)
        self._thread.join(5.0)

    # What the rig asks -------------------------------------------------------------------------

    def see(self, request: TrialRequest, phase: int) -> None:
        """The screen shows this trial and phase; the same again changes nothing."""
        if (request, phase) != self._seen:
            self._seen = (request, phase)
            self._commands.put((request, phase))

    def normal_force(self, now_ns: int) -> float:
        """Force on the plate in N."""
        playing = self._playing
        if playing is None:
            return 0.0
        press = playing.trial.press
        since = (now_ns - playing.start_ns) * 1e-9
        return float(np.interp(since, press.time, press.force, left=0.0, right=0.0))

    def frame(self, frame_ns: int) -> Path | None:
        """Image file of the contact at a frame's mid-exposure, None for an empty plate."""
        playing = self._playing
        if playing is None:
            return None
        number = round((frame_ns - playing.start_ns) / self._period)
        frames = playing.trial.frames
        return frames[number] if 0 <= number < len(frames) else None

    # What it does ------------------------------------------------------------------------------

    def _live(self) -> None:
        while not self._stop.is_set():
            command = self._commands.get()
            if command is None:
                return
            try:
                self._act(*command)
            except BaseException as error:
                self.error = error
                self._report(f"simulated participant: {error}")

    def _act(self, request: TrialRequest, phase: int) -> None:
        if phase == PHASE_PREPARE:
            self._planner.ask(request)
            if not self._upcoming:
                # The next trial of the block is likely; plan it while this one is played.
                self._planner.ask(replace(request, index=request.index + 1, attempt=0))
        elif phase == PHASE_MOISTURE_BEFORE:
            if self._load(request) is not None:
                self._give_readings(BEFORE)
        elif phase == PHASE_PRESS:
            if self._load(request) is not None:
                self._press()
        elif phase == PHASE_MOISTURE_AFTER:
            if self._load(request) is not None:
                self._give_readings(AFTER)

    def _load(self, request: TrialRequest) -> PlannedTrial | None:
        if self._trial is None or self._trial.request != request:
            if self._trial is not None:
                for path in self._trial.frames:
                    path.unlink(missing_ok=True)
            started = time.monotonic()
            self._trial = self._planner.get(request, self._stop)
            waited = time.monotonic() - started
            if waited > 0.1:
                self._report(f"planned trial {request.name}, waited {waited:.1f} s for it")
        return self._trial

    def _give_readings(self, side: int) -> None:
        assert self._trial is not None
        first = 0 if side == BEFORE else READINGS_A_SIDE
        for value in self._trial.moisture[first : first + READINGS_A_SIDE]:
            if self._stop.wait(self._reading_time):
                return
            self._send_reading(float(value), side)
        for _ in range(MOST_RETAKEN):
            # The screen still asks for readings: one was lost on its way, take another.
            for _ in range(round(PATIENCE / 0.05)):
                if not self._commands.empty() or self._stop.wait(0.05):
                    return
            self._send_reading(float(value), side)

    def _press(self) -> None:
        trial = self._trial
        assert trial is not None
        soon = time.time_ns() + self._period
        frame = -(-(soon - self._first) // self._period)
        start_ns = self._first + frame * self._period
        self._playing = _Played(trial, start_ns)
        end_ns = start_ns + round(trial.press.duration * 1e9)
        self._stop.wait(max(end_ns - time.time_ns(), 0) * 1e-9)
        self._playing = None
        if self._played_callback is not None:
            self._played_callback(trial, start_ns)
