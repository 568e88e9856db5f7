"""The guided study as a state machine, without ROS.

Every input carries a time in nanoseconds; the machine answers with effects (announce a phase, start or stop the
recorder) through one callback, and writes its state file at every change, so that a crash costs at most the attempt
that was under way.

    idle → prepare → moisture before → clear → press → lift → moisture after → closing → done → prepare of the next
                                        (any of them, when not valid) → failed → prepare of the same trial
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from enum import Enum, IntEnum
from pathlib import Path
from typing import Any

from finger_bag.streams import TrialEvent
from finger_common.errors import InputError
from finger_common.files import atomic_write, read_text

from .study_plan import CLEAN_PLATE, StudyPlan

STATE_VERSION = 1
STATE_FILE = "session.json"
NO_CONTACT = 1
"""ContactArea.FLAG_NO_CONTACT."""
MOISTURE_OUT_OF_RANGE = 1
"""Moisture.FLAG_OUT_OF_RANGE."""
ERROR = 2
"""Level from which a status of /diagnostics is an error."""


class Phase(IntEnum):
    """Trial.PHASE_*."""

    IDLE = 0
    PREPARE = 1
    MOISTURE_BEFORE = 2
    PRESS = 3
    LIFT = 4
    MOISTURE_AFTER = 5
    DONE = 6
    FAILED = 7
    PAUSED = 8


class Step(str, Enum):
    """Where the machine is; finer than the phases told to the world."""

    IDLE = "idle"
    PREPARE = "prepare"
    MOISTURE_BEFORE = "moisture_before"
    CLEAR = "clear"
    PRESS = "press"
    LIFT = "lift"
    MOISTURE_AFTER = "moisture_after"
    CLOSING = "closing"
    DONE = "done"
    FAILED = "failed"
    FINISHED = "finished"


PHASE_OF = {
    Step.IDLE: Phase.IDLE,
    Step.PREPARE: Phase.PREPARE,
    Step.MOISTURE_BEFORE: Phase.MOISTURE_BEFORE,
    Step.CLEAR: Phase.MOISTURE_BEFORE,
    Step.PRESS: Phase.PRESS,
    Step.LIFT: Phase.LIFT,
    Step.MOISTURE_AFTER: Phase.MOISTURE_AFTER,
    Step.CLOSING: Phase.DONE,
    Step.DONE: Phase.DONE,
    Step.FAILED: Phase.FAILED,
    Step.FINISHED: Phase.IDLE,
}

UNDER_WAY = (Step.MOISTURE_BEFORE, Step.CLEAR, Step.PRESS, Step.LIFT, Step.MOISTURE_AFTER)
"""Steps of an attempt that is being recorded."""

PRESSING = (Step.PRESS, Step.LIFT)


@dataclass(frozen=True)
class Limits:
    """Thresholds and times of the protocol (N, s)."""

    onset_force: float = 0.05
    liftoff_force: float = 0.03
    clear_time: float = 0.5
    release_time: float = 0.5
    press_timeout: float = 30.0
    target_timeout: float = 10.0
    lift_timeout: float = 10.0
    gap_limit: float = 0.05
    frame_gap_limit: float = 0.35
    stale_after: float = 0.5
    minimum_frames: int = 3
    verdict_time: float = 1.5
    record_timeout: float = 10.0
    max_attempts: int = 5
    lost_limit: int = 0
    confirm_preparation: bool = True
    need_camera: bool = True
    need_recorder: bool = True


@dataclass
class Attempt:
    """One attempt at a trial and what came of it. Stamps are ns; forces N; None: did not come to it."""

    attempt: int
    bag: str = ""
    verdict: str = "running"
    reason: str = ""
    began_ns: int | None = None
    onset_ns: int | None = None
    cue_ns: int | None = None
    lifted_ns: int | None = None
    peak_force: float = 0.0
    samples: int = 0
    frames: int = 0
    longest_gap: float = 0.0
    longest_frame_gap: float = 0.0
    moisture_before: list[float] = field(default_factory=list)
    moisture_after: list[float] = field(default_factory=list)

    @property
    def time_to_target(self) -> float | None:
        """s from onset to the cue."""
        if self.onset_ns is None or self.cue_ns is None:
            return None
        return (self.cue_ns - self.onset_ns) * 1e-9


@dataclass
class TrialState:
    """One trial of the plan; `verdict` is pending, done or skipped."""

    index: int
    condition: str
    verdict: str = "pending"
    attempts: list[Attempt] = field(default_factory=list)


@dataclass(frozen=True)
class StartRecording:
    """Ask the recorder to begin a bag."""

    path: str
    trial: TrialEvent


@dataclass(frozen=True)
class StopRecording:
    """Ask the recorder to close its bag."""


Effect = TrialEvent | StartRecording | StopRecording


class Protocol:
    """Runs one session.

    plan: what to run. folder: of the session; bags, the state file and `trials.csv` go there. effects: receives every
    effect, in order, at once. Commands raise InputError when they make no sense now.
    """

    def __init__(
        self,
        plan: StudyPlan,
        folder: str | Path,
        effects: Callable[[Effect], None],
        limits: Limits | None = None,
    ) -> None:
        self.plan = plan
        self.folder = Path(folder)
        self.limits = limits or Limits()
        self.step = Step.IDLE
        self.paused = False
        self.current = 0
        self.message = ""
        self.trials = [
            TrialState(index, condition)
            for index, condition in enumerate(
                c for c in plan.conditions for _ in range(plan.trials)
            )
        ]
        self._effects = effects
        self._now = 0
        self._step_began = 0
        self._recording = "off"
        self._record_asked = 0
        self._force: tuple[int, float] | None = None
        self._area: tuple[int, float, int] | None = None
        self._errors: dict[str, tuple[int, str]] = {}
        self._announced: tuple[object, ...] = ()
        self._clear_since: int | None = None
        self._below_since: int | None = None
        self._problems: list[str] = []

    # State file ------------------------------------------------------------------------------

    @property
    def state_file(self) -> Path:
        """Where the state is kept."""
        return self.folder / STATE_FILE

    def save(self) -> None:
        """Write the state file and the table of trials."""
        state = {
            "version": STATE_VERSION,
            "plan": self.plan.to_dict(),
            "step": self.step.value,
            "paused": self.paused,
            "current": self.current,
            "trials": [asdict(trial) for trial in self.trials],
        }
        with atomic_write(self.state_file) as file:
            json.dump(state, file, indent=1)
        if self.step in (Step.DONE, Step.FAILED, Step.FINISHED, Step.PREPARE):
            self._write_table()

    def _write_table(self) -> None:
        with atomic_write(self.folder / "trials.csv") as file:
            file.write(
                "index,condition,attempt,verdict,time_to_target_s,peak_force_n,frames,"
                "moisture_before_au,moisture_after_au,bag,reason\n"
            )
            for trial in self.trials:
                for a in trial.attempts:
                    before, after = (
                        f"{sum(m) / len(m):.2f}" if m else ""
                        for m in (a.moisture_before, a.moisture_after)
                    )
                    time = "" if a.time_to_target is None else f"{a.time_to_target:.3f}"
                    bag = Path(a.bag).name
                    reason = a.reason.replace('"', "'")
                    file.write(
                        f"{trial.index},{trial.condition},{a.attempt},{a.verdict},{time},"
                        f'{a.peak_force:.4f},{a.frames},{before},{after},{bag},"{reason}"\n'
                    )

    @classmethod
    def resume_from(
        cls,
        folder: str | Path,
        effects: Callable[[Effect], None],
        now_ns: int,
        limits: Limits | None = None,
    ) -> Protocol:
        """The session of a state file, at the same trial, paused.

        An attempt that was under way is noted as failed ("interrupted") and its trial begins again. Raises InputError
        naming the file when it cannot be used.
        """
        path = Path(folder) / STATE_FILE
        try:
            state = json.loads(read_text(path, "session state"))
            if state.get("version") != STATE_VERSION:
                raise InputError(
                    f"{path}: version {state.get('version')} is not {STATE_VERSION}; start a new session"
                )
            protocol = cls(StudyPlan.from_dict(state["plan"]), folder, effects, limits)
            protocol.trials = [
                TrialState(
                    trial["index"],
                    trial["condition"],
                    trial["verdict"],
                    [Attempt(**attempt) for attempt in trial["attempts"]],
                )
                for trial in state["trials"]
            ]
            protocol.current = int(state["current"])
            protocol.trials[protocol.current]
            step = Step(state["step"])
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise InputError(
                f"{path}: not a session state ({error!r}); move it away to start a new session"
            ) from None
        protocol._now = now_ns
        # Whatever the recorder still writes belongs to the attempt that was cut off.
        effects(StopRecording())
        if step in UNDER_WAY:
            attempt = protocol.trials[protocol.current].attempts[-1]
            attempt.verdict, attempt.reason = "failed", "interrupted: the protocol ended during it"
            protocol.message = "Resumed: the trial that was interrupted begins again."
        elif step is Step.CLOSING:
            protocol._conclude_done()
        if step is Step.IDLE:
            protocol._announce()
        elif protocol._advance():
            protocol.paused = True
            protocol._enter(Step.PREPARE)
        else:
            protocol._enter(Step.FINISHED)
        return protocol

    # Commands --------------------------------------------------------------------------------

    def start(self, now_ns: int) -> None:
        """Begin the session, or confirm that finger and plate are prepared."""
        self._now = now_ns
        if self.paused:
            raise InputError("the session is paused; resume it first")
        if self.step is Step.IDLE:
            self._enter(Step.PREPARE if self._advance() else Step.FINISHED)
        elif self.step is Step.PREPARE:
            self._begin_attempt()
        elif self.step in (Step.DONE, Step.FAILED):
            self._next()
        elif self.step is Step.FINISHED:
            raise InputError("the session is finished; start a new one or repeat a trial")
        else:
            raise InputError("the trial is under way; redo, skip or pause it")

    def pause(self, now_ns: int) -> None:
        """Hold the session. An attempt whose press is not over yet is void and begins again on `resume`."""
        self._now = now_ns
        if self.paused:
            raise InputError("the session is paused already")
        if self.step in (Step.IDLE, Step.FINISHED):
            raise InputError("no session is running")
        if self.step in UNDER_WAY and self.step is not Step.MOISTURE_AFTER:
            self._fail("paused during the trial")
        self.paused = True
        self._announce()
        self.save()

    def resume(self, now_ns: int) -> None:
        """Go on after a pause."""
        self._now = now_ns
        if not self.paused:
            raise InputError("the session is not paused")
        self.paused = False
        self.message = ""
        if self.step is Step.FAILED:
            self._enter(Step.PREPARE)
        else:
            self._step_began = now_ns
            self._announce()
            self.save()

    def redo(self, now_ns: int) -> None:
        """Begin the attempt under way again, or else the last trial that was finished."""
        self._now = now_ns
        if self.step in UNDER_WAY:
            self._fail("redone by the operator")
            self.paused = False
            self._enter(Step.PREPARE)
            return
        if self.step is Step.FAILED:
            self.paused = False
            self._enter(Step.PREPARE)
            return
        if self.step is Step.CLOSING:
            raise InputError("the bag is being closed; try again in a moment")
        done = [t for t in self.trials if t.attempts and t.verdict == "done"]
        if not done:
            raise InputError("no trial was done yet, so none can be redone")
        last = max(done, key=lambda t: t.attempts[-1].began_ns or 0)
        self.repeat(last.index, now_ns)

    def repeat(self, index: int, now_ns: int) -> None:
        """Do a trial again that was done or skipped; the session then goes on where it was."""
        self._now = now_ns
        if self.step in UNDER_WAY or self.step is Step.CLOSING:
            raise InputError("a trial is under way; finish, redo or skip it first")
        if not 0 <= index < len(self.trials):
            raise InputError(f"there is no trial {index}; give 0 to {len(self.trials) - 1}")
        trial = self.trials[index]
        for attempt in trial.attempts:
            if attempt.verdict == "done":
                attempt.verdict, attempt.reason = "superseded", "repeated by the operator"
        trial.verdict = "pending"
        self.current = index
        self.paused = False
        self._enter(Step.PREPARE)

    def skip(self, now_ns: int) -> None:
        """Leave the trial at hand out."""
        self._now = now_ns
        if self.step in (Step.IDLE, Step.FINISHED, Step.DONE, Step.CLOSING):
            raise InputError("there is no open trial to skip")
        if self.step in UNDER_WAY:
            self._fail("skipped by the operator")
        self.trials[self.current].verdict = "skipped"
        self.paused = False
        self._next()

    def set_preparation(self, condition: str, text: str) -> None:
        """Replace the preparation text of a condition."""
        if condition not in self.plan.conditions:
            known = ", ".join(self.plan.conditions)
            raise InputError(f"condition '{condition}' is not in this session; it has {known}")
        if not text.strip() or len(text) > 2000:
            raise InputError("the preparation text must have 1 to 2000 characters")
        texts = {**self.plan.preparations, condition: text.strip()}
        self.plan = StudyPlan.from_dict({**self.plan.to_dict(), "preparations": texts})
        self.save()

    # Inputs ----------------------------------------------------------------------------------

    def wrench(self, stamp_ns: int, normal_force: float) -> None:
        """One force sample: normal force in N, positive in compression; NaN for an invalid one."""
        limits = self.limits
        previous = self._force
        self._force = (stamp_ns, normal_force)
        self._now = max(self._now, stamp_ns)
        if self.paused or self.step not in PRESSING:
            return
        attempt = self._attempt
        if not math.isfinite(normal_force):
            self._problem("the force sensor reported invalid samples")
            return
        if self.step is Step.PRESS and attempt.onset_ns is None:
            if normal_force >= limits.onset_force:
                # Before the samples are looked at for gaps: what is missing at the first touch is missing.
                attempt.onset_ns = stamp_ns
        if attempt.onset_ns is not None and previous is not None:
            gap = (stamp_ns - previous[0]) * 1e-9
            attempt.longest_gap = max(attempt.longest_gap, gap)
            if gap > limits.gap_limit:
                self._problem(f"force samples missing for {gap:.2f} s")
            elif gap <= 0:
                self._problem("force stamps went back")
        attempt.samples += 1
        attempt.peak_force = max(attempt.peak_force, normal_force)
        if self.step is Step.PRESS:
            if attempt.onset_ns is not None and normal_force >= self.plan.target_force:
                attempt.cue_ns = stamp_ns
                self._below_since = None
                self._enter(Step.LIFT, stamp_ns)
                return
        if attempt.onset_ns is None:
            return
        if normal_force > limits.liftoff_force:
            self._below_since = None
        elif self._below_since is None:
            self._below_since = stamp_ns
        elif (stamp_ns - self._below_since) * 1e-9 >= limits.release_time:
            attempt.lifted_ns = self._below_since
            if self.step is Step.PRESS:
                self._fail(
                    f"lifted at {attempt.peak_force:.2f} N, before the target of "
                    f"{self.plan.target_force:.2f} N"
                )
            else:
                self._judge_press()

    def area(self, stamp_ns: int, area: float, flags: int) -> None:
        """One contact area (m²) with its quality flags."""
        previous = self._area
        self._area = (stamp_ns, area, flags)
        if self.paused or self.step not in PRESSING or self._attempt.onset_ns is None:
            return
        attempt = self._attempt
        assert attempt.onset_ns is not None
        if stamp_ns < attempt.onset_ns:
            return
        began = attempt.onset_ns if previous is None else max(previous[0], attempt.onset_ns)
        released = self._below_since if self.step is Step.LIFT else None
        if released is None or stamp_ns < released:
            self._note_frame_gap((stamp_ns - began) * 1e-9)
            if not flags & NO_CONTACT and area > 0:
                attempt.frames += 1

    def moisture(self, stamp_ns: int, value: float, flags: int = 0) -> None:
        """One moisture reading in a.u."""
        if self.paused or self.step not in (Step.MOISTURE_BEFORE, Step.MOISTURE_AFTER):
            return
        if stamp_ns < self._step_began:
            return
        if flags & MOISTURE_OUT_OF_RANGE or not math.isfinite(value):
            self.message = (
                f"Reading {value:g} is outside 0–130 a.u. and does not count; take another."
            )
            self._announce()
            return
        before = self.step is Step.MOISTURE_BEFORE
        readings = self._attempt.moisture_before if before else self._attempt.moisture_after
        readings.append(value)
        self.message = ""
        self._now = max(self._now, stamp_ns)
        if len(readings) >= self.plan.readings:
            self._enter(Step.CLEAR) if before else self._close()
        else:
            self.save()

    def health(self, name: str, level: int, message: str, now_ns: int) -> None:
        """State of a device or node whose failure spoils a trial, from /diagnostics."""
        if level < ERROR:
            self._errors.pop(name, None)
            return
        self._errors[name] = (now_ns, message)
        if self.step in PRESSING and self._attempt.onset_ns is not None:
            self._problem(f"{name}: {message}")

    def recorder_answered(
        self, started: bool, success: bool, message: str, now_ns: int, lost: int = 0, bag: str = ""
    ) -> None:
        """The recorder's answer to a start (`started`) or stop."""
        self._now = max(self._now, now_ns)
        if started:
            if self._recording != "starting":
                return
            if success:
                self._recording = "on"
                if bag:
                    self._attempt.bag = bag
                return
            self._recording = "off"
            if self.step in UNDER_WAY:
                self._fail(f"the recorder did not start: {message}")
                self._hold("The recorder did not start; see its state, then resume.")
            return
        if self._recording not in ("stopping", "on"):
            # The answer to the stop of an earlier attempt; the next bag is being opened already.
            return
        self._recording = "off"
        if self.step is not Step.CLOSING:
            return
        if not success and self.limits.need_recorder:
            self._fail(f"the recorder did not close the bag: {message}")
        elif lost > self.limits.lost_limit:
            self._fail(f"the recorder lost {lost} messages")
        else:
            self._conclude_done()
            self._enter(Step.DONE)

    def tick(self, now_ns: int) -> None:
        """Let time pass; to be called ten times a second or more."""
        self._now = max(self._now, now_ns)
        if self.paused:
            return
        limits = self.limits
        in_step = (self._now - self._step_began) * 1e-9
        if self.step is Step.PREPARE and not limits.confirm_preparation:
            if in_step >= limits.verdict_time:
                self._begin_attempt()
        elif self.step is Step.CLEAR:
            if self.waiting_for():
                self._clear_since = None
                if self._recording == "starting" and self._record_late():
                    self.recorder_answered(True, False, "no answer", self._now)
            elif self._clear_since is None:
                self._clear_since = self._now
            elif (self._now - self._clear_since) * 1e-9 >= limits.clear_time:
                self._enter(Step.PRESS)
        elif self.step in PRESSING:
            self._watch_press(in_step)
        elif self.step is Step.CLOSING and self._record_late():
            self.recorder_answered(False, False, "no answer", self._now)
        elif self.step in (Step.DONE, Step.FAILED) and in_step >= limits.verdict_time:
            self._next()

    def waiting_for(self) -> str:
        """Why the press does not begin yet; empty when nothing is in the way."""
        stale = self.limits.stale_after
        for name, (stamp, message) in self._errors.items():
            if (self._now - stamp) * 1e-9 < 3.0:
                return f"{name}: {message}"
        if self._force is None or (self._now - self._force[0]) * 1e-9 > stale:
            return "the force sensor is silent"
        if not abs(self._force[1]) < self.limits.onset_force:
            return f"{self._force[1]:.2f} N on the plate: lift the finger, or tare"
        if self.limits.need_camera:
            if self._area is None or (self._now - self._area[0]) * 1e-9 > stale:
                return "no contact area comes from the camera"
            if not self._area[2] & NO_CONTACT:
                return "something is on the plate: lift the finger and clean the plate"
        if self.limits.need_recorder and self._recording != "on":
            return "the recorder is not running yet"
        return ""

    # Inner workings --------------------------------------------------------------------------

    @property
    def _attempt(self) -> Attempt:
        return self.trials[self.current].attempts[-1]

    def _problem(self, text: str) -> None:
        # One problem of a kind is enough for the verdict.
        if not any(p.split(" ")[:3] == text.split(" ")[:3] for p in self._problems):
            self._problems.append(text)

    def _note_frame_gap(self, gap: float) -> None:
        self._attempt.longest_frame_gap = max(self._attempt.longest_frame_gap, gap)
        if self.limits.need_camera and gap > self.limits.frame_gap_limit:
            self._problem(f"camera frames missing for {gap:.2f} s")

    def _record_late(self) -> bool:
        return (self._now - self._record_asked) * 1e-9 > self.limits.record_timeout

    def _watch_press(self, in_step: float) -> None:
        limits, attempt = self.limits, self._attempt
        if self._force is not None and (self._now - self._force[0]) * 1e-9 > limits.stale_after:
            self._fail("the force sensor fell silent")
        elif self.step is Step.PRESS and attempt.onset_ns is None:
            if in_step > limits.press_timeout:
                self._fail(f"no press within {limits.press_timeout:g} s")
        elif self.step is Step.PRESS:
            assert attempt.onset_ns is not None
            if (self._now - attempt.onset_ns) * 1e-9 > limits.target_timeout:
                self._fail(
                    f"target not reached within {limits.target_timeout:g} s: "
                    f"{attempt.peak_force:.2f} of {self.plan.target_force:.2f} N"
                )
        elif in_step > limits.lift_timeout:
            self._fail(f"finger not lifted within {limits.lift_timeout:g} s of the cue")

    def _judge_press(self) -> None:
        """Verdict on the press, once the finger is off the plate."""
        attempt = self._attempt
        if self.limits.need_camera:
            assert attempt.lifted_ns is not None and attempt.onset_ns is not None
            newest = (
                attempt.onset_ns if self._area is None else max(self._area[0], attempt.onset_ns)
            )
            # Frames up to lift-off are in by now (release_time has passed), unless the camera stopped.
            self._note_frame_gap((attempt.lifted_ns - newest) * 1e-9)
            if attempt.frames < self.limits.minimum_frames:
                self._problem(
                    f"contact seen in {attempt.frames} frames, {self.limits.minimum_frames} are needed"
                )
        if self._problems:
            self._fail("; ".join(self._problems))
        elif self.plan.readings:
            self._enter(Step.MOISTURE_AFTER)
        else:
            self._close()

    def _begin_attempt(self) -> None:
        trial = self.trials[self.current]
        number = len(trial.attempts)
        bag = self.folder / f"{trial.index:03d}_{trial.condition}_{number}"
        trial.attempts.append(Attempt(number, str(bag), began_ns=self._now))
        self.message = ""
        self._problems = []
        self._clear_since = self._below_since = None
        step = Step.MOISTURE_BEFORE if self.plan.readings else Step.CLEAR
        if self.limits.need_recorder:
            self._recording, self._record_asked = "starting", self._now
            self._effects(StartRecording(str(bag), self._announcement(self._phase(step))))
        self._enter(step)

    def _close(self) -> None:
        self._attempt.reason = ""
        self._enter(Step.CLOSING)
        if self.limits.need_recorder:
            self._recording, self._record_asked = "stopping", self._now
            self._effects(StopRecording())
        else:
            self._conclude_done()
            self._enter(Step.DONE)

    def _conclude_done(self) -> None:
        self._attempt.verdict = "done"
        self.trials[self.current].verdict = "done"

    def _fail(self, reason: str) -> None:
        self._attempt.verdict, self._attempt.reason = "failed", reason
        closing = self.step is Step.CLOSING
        self._enter(Step.FAILED)
        if self.limits.need_recorder and not closing:
            self._recording = "stopping"
            self._effects(StopRecording())

    def _hold(self, message: str) -> None:
        self.paused = True
        self.message = message
        self._announce()
        self.save()

    def _advance(self) -> bool:
        """Point at the trial at hand if it is open, else at the first open one; false when there is none."""
        if self.trials[self.current].verdict == "pending":
            return True
        for trial in self.trials:
            if trial.verdict == "pending":
                self.current = trial.index
                return True
        return False

    def _next(self) -> None:
        if not self._advance():
            self._enter(Step.FINISHED)
            return
        attempts = self.trials[self.current].attempts
        in_a_row = len([a for a in attempts if a.verdict == "failed"])
        self._enter(Step.PREPARE)
        if in_a_row and in_a_row % self.limits.max_attempts == 0 and not self.paused:
            self._hold(
                f"This trial failed {in_a_row} times; look for the cause, then resume or skip it."
            )

    def _announcement(self, phase: Phase) -> TrialEvent:
        trial = self.trials[self.current]
        number = len(trial.attempts)
        open_attempt = trial.attempts and self.step not in (Step.IDLE, Step.PREPARE)
        reason = trial.attempts[-1].reason if phase is Phase.FAILED and trial.attempts else ""
        return TrialEvent(
            self._step_began if self.step in PRESSING else self._now,
            self.plan.session,
            self.plan.subject,
            trial.condition,
            trial.index,
            number - 1 if open_attempt else number,
            phase,
            self.plan.target_force,
            reason or self.message,
        )

    def _phase(self, step: Step) -> Phase:
        # Waiting for an empty frame is not told apart from what comes before it.
        return Phase.PREPARE if step is Step.CLEAR and not self.plan.readings else PHASE_OF[step]

    def _announce(self) -> None:
        said = self._announcement(Phase.PAUSED if self.paused else self._phase(self.step))
        what = (said.phase, said.index, said.attempt, said.note)
        if what != self._announced:
            self._announced = what
            self._effects(said)

    def _enter(self, step: Step, stamp_ns: int | None = None) -> None:
        # The announcement goes out before the file is written: the cue to lift must not wait for a disk.
        self.step = step
        self._step_began = self._now if stamp_ns is None else stamp_ns
        self._announce()
        self.save()

    # For the page ----------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """Everything an operator needs to see, as plain data."""
        trial = self.trials[self.current]
        attempt = trial.attempts[-1] if trial.attempts and self.step is not Step.PREPARE else None
        return {
            "subject": self.plan.subject,
            "session": self.plan.session,
            "step": self.step.value,
            "paused": self.paused,
            "message": self.message,
            "waiting_for": self.waiting_for()
            if self.step is Step.CLEAR and not self.paused
            else "",
            "index": trial.index,
            "attempt": attempt.attempt if attempt else len(trial.attempts),
            "condition": trial.condition,
            "preparation": self.plan.preparation(trial.condition),
            "preparations": {c: self.plan.preparation(c) for c in self.plan.conditions},
            "prompt": CLEAN_PLATE,
            "target_force": self.plan.target_force,
            "readings": self.plan.readings,
            "moisture_before": attempt.moisture_before if attempt else [],
            "moisture_after": attempt.moisture_after if attempt else [],
            "recording": self._recording,
            "conditions": list(self.plan.conditions),
            "folder": str(self.folder),
            "trials": [
                {
                    "index": t.index,
                    "condition": t.condition,
                    "verdict": t.verdict,
                    "attempts": len(t.attempts),
                    "reason": t.attempts[-1].reason if t.attempts else "",
                    "time_to_target": t.attempts[-1].time_to_target if t.attempts else None,
                    "peak_force": t.attempts[-1].peak_force if t.attempts else None,
                }
                for t in self.trials
            ],
        }
