# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A guided session as a state machine, without ROS.

Every input carries a time in nanoseconds: commands and ticks that of the protocol's own clock,
samples their stamp, which may be of another clock. What is waited for is measured by the first,
what happened in a press by the second; phases are announced by that of the force, as readers find
the presses by it. The machine answers with effects (announce a phase, start or stop the recorder)
through one callback, and writes its state file at every change, so that a crash costs at most the
attempt that was under way. What cannot be written is tried again while the session is open.

    idle → prepare → moisture before → clear → press → lift → moisture after → closing → done
    press → pull → lift, where the trial is a pull
    done → prepare of the next trial;  any of them, when not valid → failed → prepare of the same
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from finger_bag.streams import TrialEvent
from finger_common.diagnostics import ERROR
from finger_common.errors import InputError
from finger_common.guided_presses import FITTING
from finger_common.guided_pulls import is_pull
from finger_common.host_clock import NOTABLE_STEP
from finger_common.stamps import seconds
from finger_common.subject_code import finger_name
from finger_common.trial_phases import TrialPhase

from .attempt import Attempt, TrialState, scattered
from .event_log import Event, EventLog, note_text
from .inputs import Inputs
from .limits import Limits
from .press import Press, PressEvent
from .pull import Pull
from .recording import Recording, RecordingState, Request, StopRecording
from .session_files import SessionFiles
from .session_store import SavedSession, load_state
from .steps import PHASE_OF, PRESSING, UNDER_WAY, Step
from .study_plan import StudyPlan
from .trial_queue import TrialQueue

Effect = TrialEvent | Request

GUIDANCE_TIME = 3.0
"""s for which the text of a calibration's press is shown before the plate has to be clear."""

WAITING_TIME = 300.0
"""s without a reading, or without a free plate, after which an attempt that is recorded ends."""

ZERO_TOLD = 2.0
"""s after a press within which a report of a zero may be of one that was set during it."""

FIT_TIME = 120.0
"""s to wait for the result of a calibration: a second of work, on a busy machine a minute."""


class Protocol:
    """Runs one session.

    plan: what to run. folder: of the session; bags, the state file and `trials.csv` go there.
    effects: receives every effect, in order, at once. Commands raise InputError when they make no
    sense now.
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
        self._limits = limits or Limits()
        self.step = Step.IDLE
        self.paused = False
        self.message = ""
        self.fitting = False
        """Whether all presses of a calibration are made, and the model node fits them."""
        self._queue = TrialQueue(plan)
        self.ended = ""
        self.log = EventLog(self.folder)
        self.files = SessionFiles(self.folder, self.log, self._session, self._log)
        self._effects = effects
        self._now = 0
        self._step_began = 0
        self._step_stamp = 0
        """Stamp of the sample that brought the step, where one did."""
        self.recording = Recording(effects)
        self._lifted_at = 0
        self._last_progress = 0
        self._inputs = Inputs()
        self._known_result = ""
        self._announced: tuple[object, ...] = ()
        self._clear_since: int | None = None
        self._press: Press | None = None
        self._clock_step = 0.0
        self._waits: dict[Step, Callable[[float], None]] = {
            Step.PREPARE: self._await_preparation,
            **dict.fromkeys((Step.MOISTURE_BEFORE, Step.MOISTURE_AFTER), self._await_progress),
            Step.CLEAR: self._await_clear_plate,
            **dict.fromkeys(PRESSING, self._check_time),
            Step.CLOSING: self._await_recorder,
            **dict.fromkeys((Step.DONE, Step.FAILED), self._show_verdict),
            Step.FINISHED: self._await_fit,
        }
        """What is done at each tick, by step; called with the s that the step has lasted."""

    @property
    def limits(self) -> Limits:
        """Thresholds and times; may be replaced at any time."""
        return self._limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        self._limits = limits
        if self._press is not None:
            self._press.limits = limits

    @property
    def trials(self) -> list[TrialState]:
        """The trials in their order."""
        return self._queue.trials

    @property
    def current(self) -> int:
        """Index of the trial that is next or under way."""
        return self._queue.current

    # Saved state -----------------------------------------------------------------------------

    def _session(self) -> SavedSession:
        return SavedSession(
            self.plan, self.step, self.paused, self.current, self.trials, self.ended
        )

    def _log(self, kind: str, text: str, of_trial: bool = True) -> None:
        """Add to the event log, for the current trial or for the session as a whole."""
        index = attempt = -1
        if of_trial and self.step not in (Step.IDLE, Step.FINISHED):
            event = self._announcement(TrialPhase.IDLE)
            index, attempt = event.index, event.attempt
        self.log.add(Event(self._now, kind, " ".join(text.split()), index, attempt))

    @classmethod
    def resume_from(
        cls,
        folder: str | Path,
        effects: Callable[[Effect], None],
        now_ns: int,
        limits: Limits | None = None,
    ) -> Protocol:
        """The session of a state file, at the same trial, paused.

        An attempt that was under way is noted as failed ("interrupted"), in its bag as soon as the
        recorder has closed it, and its trial begins again.
        Raises InputError naming the file when it cannot be used.
        """
        saved = load_state(Path(folder))
        protocol = cls(saved.plan, folder, effects, limits)
        protocol._restore(saved, now_ns)
        return protocol

    def _restore(self, saved: SavedSession, now_ns: int) -> None:
        self._queue.trials, self._queue.current = saved.trials, saved.current
        self.ended = saved.ended
        self._now = self._step_stamp = now_ns
        self.step = step = saved.step
        self.log = self.files.log = EventLog.load(self.folder)
        self._log("session", "the protocol was started again", of_trial=False)
        # A bag that is still being written belongs to the interrupted attempt.
        self._effects(StopRecording())
        if step in UNDER_WAY:
            self._conclude_failed("interrupted: the protocol ended during it")
            self._note_unmarked()
            number = self.current + 1
            self.message = f"Restarted. Trial {number} will begin again: press Space."
        elif step is Step.CLOSING:
            self._conclude_done()
        if step is Step.IDLE:
            self._announce()
        elif self._advance():
            self.paused = True
            self.message = self.message or "Restarted. Press Space to go on."
            self._enter(Step.PREPARE)
        else:
            self.message = ""
            # A result of the model node that was there before is not asked for again.
            results = [e.text for e in self.log.events if e.kind == "calibration"]
            self._known_result = results[-1] if results else ""
            self._enter(Step.FINISHED)

    # Commands --------------------------------------------------------------------------------

    def start(self, now_ns: int) -> None:
        """Begin the session, or confirm that finger and plate are prepared."""
        self._now = now_ns
        if self.paused:
            raise InputError("the session is paused; resume it first")
        if self.step is Step.IDLE:
            plan = self.plan
            begun = f"session {plan.session} begun: subject {plan.subject}, order {plan.order}"
            self._log("session", begun)
            self._enter(Step.PREPARE if self._advance() else Step.FINISHED)
        elif self.step is Step.PREPARE:
            self._begin_attempt()
        elif self.step in (Step.DONE, Step.FAILED):
            self._next()
        elif self.step is Step.FINISHED:
            raise InputError("the session is finished; close it, or repeat a trial")
        else:
            raise InputError("the trial is under way; redo, skip or pause it")

    def pause(self, now_ns: int) -> None:
        """Hold the session; an attempt whose press is not over is void and begins again."""
        self._now = now_ns
        if self.paused:
            raise InputError("the session is paused already")
        if self.step in (Step.IDLE, Step.FINISHED):
            raise InputError("no session is running")
        if self.step in UNDER_WAY and self.step is not Step.MOISTURE_AFTER:
            self._fail("paused during the trial")
        self._log("command", "paused")
        self._hold(self.message)

    def resume(self, now_ns: int) -> None:
        """Go on after a pause, or with the open trials of a session that was ended early."""
        self._now = now_ns
        if self.step is Step.FINISHED and self.ended:
            self.ended = ""
            self._log("command", "resumed after its end", of_trial=False)
            self._enter(Step.PREPARE if self._advance() else Step.FINISHED)
            return
        if not self.paused:
            raise InputError("the session is not paused")
        self.paused = False
        self._log("command", "resumed")
        self.message = ""
        if self.step is Step.FAILED:
            self._enter(Step.PREPARE)
        else:
            self._step_began = self._last_progress = now_ns
            self._announce()
            self.files.save()

    def redo(self, now_ns: int) -> None:
        """Begin the attempt under way again, or else the last trial that was finished."""
        self._now = now_ns
        if self.step in UNDER_WAY or self.step is Step.FAILED:
            if self.step in UNDER_WAY:
                self._fail("redone by the operator")
            self.paused = False
            self.message = ""
            self._enter(Step.PREPARE)
            return
        if self.step is Step.CLOSING:
            raise InputError("the bag is being closed; try again in a moment")
        if self.step is Step.PREPARE and self._queue.trial.attempts:
            raise InputError(f"trial {self.current + 1} begins again already")
        self.repeat(self._queue.last_done(self.log).index, now_ns)

    def repeat(self, index: int, now_ns: int) -> None:
        """Do a trial again that was done or skipped; the session then continues where it was."""
        self._now = now_ns
        if self.step in UNDER_WAY or self.step is Step.CLOSING:
            raise InputError("a trial is under way; finish, redo or skip it first")
        self._queue.repeat(index)
        self.paused = False
        self.message = ""
        self._enter(Step.PREPARE)
        self._log("command", "repeated by the operator")
        self.files.save()

    def skip(self, now_ns: int) -> None:
        """Leave the current trial out."""
        self._now = now_ns
        if self.step in (Step.IDLE, Step.FINISHED, Step.DONE, Step.CLOSING):
            raise InputError("there is no open trial to skip")
        if self.step in UNDER_WAY:
            self._fail("skipped by the operator")
        self._queue.skip()
        self._log("command", "skipped")
        self.paused = False
        self.message = ""
        self._next()

    def end(self, now_ns: int) -> None:
        """End the session early; a trial under way is completed first. All data are kept."""
        self._finish_early(now_ns, "ended early by the operator")

    def abort(self, now_ns: int, how: str = "aborted by the operator") -> None:
        """End the session at once; a trial under way is void, its bag is kept."""
        self._finish_early(now_ns, how)
        if self.step in UNDER_WAY:
            self._fail(self.ended)
            self._enter(Step.FINISHED)

    def _finish_early(self, now_ns: int, how: str) -> None:
        self._now = now_ns
        if self.step is Step.FINISHED:
            raise InputError("the session is finished already; close it")
        self.ended = how
        self._log("command", how, of_trial=False)
        self.paused = False
        self.message = ""
        if self.step in UNDER_WAY or self.step is Step.CLOSING:
            self._announce()
            self.files.save()
        else:
            self._enter(Step.FINISHED)

    def note(self, now_ns: int, text: str, index: int = -1) -> None:
        """Add a note to a trial (the newest attempt at it), or with −1 to the session."""
        self._now = now_ns
        line = note_text(text)
        last = len(self.trials) - 1
        if not -1 <= index <= last:
            raise InputError(f"there is no trial {index}; give 0 to {last}, or -1 for the session")
        attempt = max(len(self.trials[index].attempts) - 1, 0) if index >= 0 else -1
        self.log.add(Event(now_ns, "note", line, index, attempt))
        self.files.save(state=self.step not in PRESSING)

    def mark(self, now_ns: int) -> str:
        """Mark this moment in the trial under way, else in the session; returns its name."""
        self._now = now_ns
        name = f"marker {sum(e.kind == 'marker' for e in self.log.events) + 1}"
        self._log("marker", name)
        self.files.save(state=self.step not in PRESSING)
        return name

    def set_preparation(self, condition: str, text: str) -> None:
        """Replace the preparation text of a condition."""
        if condition not in self.plan.conditions:
            known = ", ".join(self.plan.conditions)
            raise InputError(f"condition '{condition}' is not in this session; it has {known}")
        if self.plan.is_calibration:
            raise InputError("the texts of a calibration's presses are fixed")
        if not text.strip() or len(text) > 2000:
            raise InputError("the preparation text must have 1 to 2000 characters")
        texts = {**self.plan.preparations, condition: text.strip()}
        self.plan = StudyPlan.from_dict({**self.plan.to_dict(), "preparations": texts})
        self.files.save()

    # Inputs ----------------------------------------------------------------------------------

    def wrench(self, stamp_ns: int, normal_force: float, tangential_force: float = 0.0) -> None:
        """One force sample: normal force in N, positive in compression, and the size of the force
        along the plate; NaN for an invalid one."""
        previous = self._inputs.force_stamp
        self._inputs.add_force(stamp_ns, normal_force, self._now)
        if self.step is Step.CLEAR and self._clear_since is not None and self._press is not None:
            if abs(normal_force) < self.limits.onset_force:
                self._press.add_rest(stamp_ns, normal_force)
            else:  # a press that begins before its cue would not be found in the bag
                self._plate_taken()
        if self.paused or self.step not in PRESSING or self._press is None:
            return
        event = self._press.add_force(stamp_ns, normal_force, previous, tangential_force)
        if event is PressEvent.TARGET_REACHED:
            self._enter(Step.LIFT, stamp_ns)
        elif event is PressEvent.PULL_BEGINS:
            self._enter(Step.PULL, stamp_ns)
        elif event is PressEvent.FINGER_OFF:
            self._lifted_at = self._now
            reason = self._press.judge()
            if reason:
                self._fail(reason)
            elif self.plan.readings:
                self._enter(Step.MOISTURE_AFTER)
            else:
                self._close()

    def area(self, stamp_ns: int, area: float, flags: int, stick_ratio: float = math.nan) -> None:
        """One contact area (m²) with its quality flags, and the stick ratio where it is known."""
        self._inputs.add_area(stamp_ns, area, flags, self._now)
        if not self.paused and self.step in PRESSING and self._press is not None:
            self._press.add_area(stamp_ns, area, flags, stick_ratio)

    def moisture(self, stamp_ns: int, value: float) -> None:
        """One moisture reading in a.u."""
        if self.paused or self.step not in (Step.MOISTURE_BEFORE, Step.MOISTURE_AFTER):
            return
        self.message = self._inputs.refuse_reading(
            value, stamp_ns, self._step_began, self._now, self.limits
        )
        if self.message:
            self._announce()
            return
        before = self.step is Step.MOISTURE_BEFORE
        readings = self._attempt.moisture_before if before else self._attempt.moisture_after
        readings.append(value)
        self._last_progress = self._now
        if len(readings) >= self.plan.readings:
            step = "before" if before else "after"
            if warning := scattered(step, readings, self.limits.moisture_spread):
                self._log("warning", warning)
            self._enter(Step.CLEAR) if before else self._close()
        else:
            self.files.save()

    def health(self, name: str, level: int, message: str, now_ns: int) -> None:
        """State of a device or node whose failure makes a trial invalid, from /diagnostics."""
        self._now = max(self._now, now_ns)
        if news := self._inputs.add_health(name, level, message, now_ns):
            self._log("fault", news)
        if level >= ERROR and self.step in PRESSING and self._press is not None:
            if self._press.attempt.onset_ns is not None:
                self._press.add_problem(f"{name}: {message}")

    def tared(self, zero: str, now_ns: int) -> None:
        """The zero that is subtracted from the force, as its driver tells it once a second: numbers
        with commas between, the first three in N.

        A zero that was set to the force of a finger reads as lift-off: such a press is void, also
        where it is over by the time of the report.
        """
        self._now = max(self._now, now_ns)
        shift = self._inputs.set_zero(zero)
        if shift is None:
            return
        self._log("command", f"force tared, zero at {zero}")
        just_over = (
            self.step in (Step.MOISTURE_AFTER, Step.CLOSING, Step.DONE)
            and seconds(self._now - self._lifted_at) <= ZERO_TOLD
        )
        pressed = self._press if self.step in PRESSING or just_over else None
        if pressed is not None and shift > self.limits.zero_limit and pressed.fell_by(shift):
            self._fail(pressed.with_problems("the zero was changed during the press"))

    def recorder_writes(self, bag: str, now_ns: int) -> None:
        """What the recorder itself says that it writes, again and again; "no" for no bag."""
        self._now = max(self._now, now_ns)
        own = self._attempt.bag if self.step in UNDER_WAY else None
        if self.recording.reported(bag, own, self._now):
            self._fail("the recorder no longer writes the bag of this trial")
            self._note_unmarked()

    def recorder_started(
        self, success: bool, message: str, now_ns: int, bag: str = "", asked: str = ""
    ) -> None:
        """The recorder's answer to a start. bag: what it writes; asked: path of the start."""
        self._now = max(self._now, now_ns)
        if not self.recording.started(success, asked):
            return
        if success:
            self._attempt.bag = bag or self._attempt.bag
        elif self.step in UNDER_WAY:
            self._fail(f"the recorder did not start: {message}")
            self._hold("The recorder did not start; check its state, then resume.")

    def recorder_stopped(
        self,
        success: bool,
        message: str,
        now_ns: int,
        lost: int = 0,
        message_count: int | None = None,
        bag: str = "",
    ) -> None:
        """The recorder's answer to a stop. lost: messages that are not in the bag. message_count,
        bag: those that are in it, and its path, where they are told.
        """
        self._now = max(self._now, now_ns)
        self.files.mark_bags(left=True)
        if not self.recording.stopped() or self.step is not Step.CLOSING:
            return
        if not success and self.limits.need_recorder:
            self._fail(f"the recorder did not close the bag: {message}")
        elif bag and Path(bag) != Path(self._attempt.bag):
            self._fail("the recording was stopped by somebody else")
        elif message_count == 0:
            self._fail("the bag holds no message")
        elif lost > self.limits.lost_limit:
            self._fail(f"the recorder lost {lost} messages")
        else:
            self._keep()

    def tick(self, now_ns: int) -> None:
        """Let time pass; to be called ten times a second or more."""
        self._now = max(self._now, now_ns)
        self._inputs.compare_clocks(now_ns)
        for news in self._inputs.silences(self._now, self.limits):
            self._log("fault", news)
        # A bag that is open after the press grows in a pause too.
        waits = not self.paused or self.step in (Step.MOISTURE_AFTER, Step.CLOSING)
        if waits and self.step in self._waits:
            self._waits[self.step](seconds(self._now - self._step_began))
        if self.step not in PRESSING:
            self.files.write_again(self._now)

    def _await_preparation(self, in_step: float) -> None:
        if self.plan.is_calibration:
            begins = in_step >= GUIDANCE_TIME
        else:
            begins = not self.limits.confirm_preparation and in_step >= self.limits.verdict_time
        if begins:
            self._begin_attempt()

    def _await_progress(self, in_step: float) -> None:
        """End an attempt that nobody goes on with, as its bag grows all the while; after the press
        it is kept with the readings that it has, also in a pause."""
        waited = seconds(self._now - self._last_progress)
        if not self.limits.need_recorder or waited <= WAITING_TIME:
            return
        reason = f"nobody went on for {WAITING_TIME / 60:g} min"
        if self.step is Step.MOISTURE_AFTER:
            self._log("command", f"{reason}: closed with the readings so far")
            self._close()
            return
        self._fail(reason)
        if not self.ended:
            self._hold("Nobody went on, and the recording was ended. Press Space to go on.")

    def _await_clear_plate(self, in_step: float) -> None:
        if self.waiting_for():
            self._plate_taken()
            if self.recording.state is RecordingState.STARTING and self._recorder_is_late():
                self.recorder_started(False, "no answer", self._now)
            else:
                self._await_progress(in_step)
        elif self._clear_since is None:
            self._clear_since = self._now
        elif seconds(self._now - self._clear_since) >= self.limits.clear_time:
            self._enter(Step.PRESS)

    def _plate_taken(self) -> None:
        """The wait for a free plate begins again."""
        self._clear_since = None
        if self._press is not None:
            self._press.forget_rest()

    def _check_time(self, in_step: float) -> None:
        """Fail a press whose force is missing or that exceeds a limit of time."""
        assert self._press is not None
        if self._inputs.force_fell_silent(self._now, self.limits):
            self._fail(self._press.with_problems("the force sensor fell silent"))
        elif reason := self._press.see_time(self._now, in_step):
            self._fail(self._press.with_problems(reason))

    def _await_recorder(self, in_step: float) -> None:
        if self._recorder_is_late():
            self.recorder_stopped(False, "no answer", self._now)

    def _show_verdict(self, in_step: float) -> None:
        if in_step >= self.limits.verdict_time:
            self._next()

    def _await_fit(self, in_step: float) -> None:
        if self.fitting and in_step > FIT_TIME:
            late = f"the model node gave no result within {FIT_TIME:.0f} s"
            self.calibrated(False, late, self._now)

    def calibrated(self, success: bool, result: str, now_ns: int) -> None:
        """What the model node made of the presses, in a sentence; a refusal ends the presses. There
        is one result.
        """
        self._now = max(self._now, now_ns)
        if self.step is not Step.FINISHED and not success:
            self.abort(now_ns, f"given up ({result})")
        elif not self.fitting:
            return
        self.fitting = False
        self.message = f"Calibrated: {result}." if success else f"Not calibrated: {result}."
        self._log("calibration", self.message, of_trial=False)
        self._announce()
        self.files.save()

    def clock_stepped(self, step: float, warning: str) -> None:
        """Where the system clock stands, s from where it was when this node began, and the warning
        of it; each further step is logged."""
        if abs(step - self._clock_step) > NOTABLE_STEP:
            self._clock_step = step
            back = "the system clock is where it was when this node began"
            self._log("warning", warning or back, of_trial=False)

    def check_clocks(self) -> None:
        """Log where force or camera is stamped by a clock that is far from the others."""
        if apart := self._inputs.clocks_apart() or self._inputs.camera_apart(self.limits):
            self._log("warning", apart)

    def waiting_for(self) -> str:
        """Why the press does not begin yet; empty when nothing is in the way."""
        if reason := self._inputs.waiting_for(self._now, self.limits):
            return reason
        return self.recording.waiting_for(self._now) if self.limits.need_recorder else ""

    # Transitions -----------------------------------------------------------------------------

    @property
    def _attempt(self) -> Attempt:
        return self._queue.attempt

    def _recorder_is_late(self) -> bool:
        return self.recording.is_late(self._now, self.limits.record_timeout)

    def _begin_attempt(self) -> None:
        if gone := self.files.gone:
            self._hold(f"{self.folder}: {gone}. Then resume.")
            return
        condition = self._queue.trial.condition
        attempt = self._queue.begin_attempt(self.folder, self._now)
        kind = Pull if is_pull(condition) else Press
        self._press = kind(attempt, self.plan.press_of(condition), self.limits)
        self.message = ""
        self._clear_since = None
        step = Step.MOISTURE_BEFORE if self.plan.readings else Step.CLEAR
        if self.limits.need_recorder:
            self.recording.start(attempt.bag, self._announcement(self._phase(step)), self._now)
        self._enter(step)

    def _close(self) -> None:
        self._attempt.reason = ""
        self._enter(Step.CLOSING)
        # It is off where the node was deactivated after the press: the bag was closed then.
        if self.limits.need_recorder and self.recording.state is not RecordingState.OFF:
            self.recording.stop(self._now)
        else:
            self._keep()

    def _keep(self) -> None:
        self._conclude_done()
        self._enter(Step.DONE)

    def _conclude_done(self) -> None:
        self._queue.conclude_done(self._now)
        found = f": {self._attempt.found}" if self._attempt.found else ""
        self._log("kept", f"trial {self.current + 1} kept{found}")

    def _conclude_failed(self, reason: str) -> None:
        self._queue.conclude_failed(reason, self._now)
        self._log("failed", reason)

    def _fail(self, reason: str) -> None:
        self._conclude_failed(reason)
        closing = self.step in (Step.CLOSING, Step.DONE)
        self._enter(Step.FAILED)
        if self.limits.need_recorder and not closing:
            self.recording.stop(self._now)
        elif closing:
            self._note_unmarked()
            self.files.mark_bags()

    def _note_unmarked(self) -> None:
        """The bag of the newest attempt is to say that it failed."""
        failed = self._announcement(TrialPhase.FAILED)
        self.files.unmarked.append((Path(self._attempt.bag), failed))

    def _hold(self, message: str) -> None:
        self.paused = True
        self.message = message
        self._announce()
        self.files.save()

    def _advance(self) -> bool:
        """Choose the next trial; false for none, and for a session that was ended."""
        return not self.ended and self._queue.advance()

    def _next(self) -> None:
        if not self._advance():
            self._enter(Step.FINISHED)
            return
        in_a_row = self._queue.failed_in_a_row()
        self._enter(Step.PREPARE)
        if in_a_row and in_a_row % self.limits.max_attempts == 0 and not self.paused:
            self._hold(
                f"This trial failed {in_a_row} times; find the cause, then resume or skip it."
            )

    def _announcement(self, phase: TrialPhase) -> TrialEvent:
        trial = self._queue.trial
        number = len(trial.attempts)
        open_attempt = trial.attempts and self.step not in (Step.IDLE, Step.PREPARE)
        note = ""
        if phase is TrialPhase.FAILED and trial.attempts:
            note = trial.attempts[-1].reason
        elif phase is TrialPhase.DONE:
            # With the last message of its bag, what was found and noted comes into the bag.
            remarks = self.log.remarks(trial.index, len(trial.attempts) - 1)
            note = "; ".join(filter(None, [trial.attempts[-1].found, *remarks]))
        return TrialEvent(
            self._step_stamp if self.step in PRESSING else self._stamp(),
            self.plan.session,
            self.plan.subject,
            trial.condition,
            trial.index,
            number - 1 if open_attempt else number,
            phase,
            self.plan.press_of(trial.condition).target_force,
            note or self.message,
            finger_name(self.plan.hand, self.plan.finger),
        )

    def _stamp(self) -> int:
        """This moment by the clock of the force; by the protocol's own where no force comes."""
        newest = self._inputs.force_stamp
        silent = self._inputs.force_fell_silent(self._now, self.limits)
        return self._now if newest is None or silent else newest

    def _phase(self, step: Step) -> TrialPhase:
        if step is Step.CLEAR and not self.plan.readings:
            # The wait for an empty frame belongs to the phase before it.
            return TrialPhase.PREPARE
        return PHASE_OF[step] if step in PHASE_OF else TrialPhase[step.name]

    def _announce(self) -> None:
        # With the last message of its bag a trial is done, also where it is closed in a pause.
        paused = self.paused and self.step is not Step.CLOSING
        event = self._announcement(TrialPhase.PAUSED if paused else self._phase(self.step))
        news = (event.phase, event.index, event.attempt, event.note)
        if news != self._announced:
            self._announced = news
            self._effects(event)

    def _enter(self, step: Step, stamp_ns: int | None = None) -> None:
        # The announcement goes out first: the cue to lift must not wait for a disk.
        if step is Step.FINISHED:
            self._queue.give_up_repetitions()
        self.fitting = False
        if step is Step.FINISHED and self.plan.is_calibration:
            done = all(trial.verdict == "done" for trial in self.trials)
            self.fitting = done and not self._known_result
            why = self.ended or "not all presses were made"
            unknown = FITTING if done else f"Not calibrated: {why}."
            self.message, self._known_result = self._known_result or unknown, ""
        self.step = step
        self._step_began = self._last_progress = self._now
        self._step_stamp = self._stamp() if stamp_ns is None else stamp_ns
        self._announce()
        self._log("step", step.value.replace("_", " "))
        # Of a session with thousands of trials that takes long, and the next cue must not wait. A
        # press that is interrupted begins again at whichever of its steps.
        self.files.save(state=step not in PRESSING)
