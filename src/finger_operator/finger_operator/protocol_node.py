"""Node that guides a study: thin shell over `protocol.Protocol`.

Publishes the latched `trial`, drives the recorder and tells the page everything on `~/status` (JSON, latched).
Control: services `~/start`, `~/pause`, `~/resume`, `~/redo`, `~/repeat` (of `selected_trial`), `~/skip`, `~/close`.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger

from finger_bag.streams import TrialEvent
from finger_common.cli import one_line
from finger_common.diagnostics import WARN, Health
from finger_common.errors import FingerError, InputError
from finger_common.files import atomic_write
from finger_common.node import POLLED_DEPTH, STATE_QOS, ManagedNode, PolledSubscription, main_of
from finger_common.parameters import Parameter, ParameterTable
from finger_msgs.msg import ContactArea, Moisture, Trial
from finger_msgs.srv import Record

from .protocol import STATE_FILE, Effect, Limits, Phase, Protocol, StartRecording, Step
from .study_plan import PREPARATIONS, StudyPlan, parse_preparations

POINTER = "current_session"
"""File in `output` that names the session under way, so that a restarted node finds it again."""

TICK = 0.05
"""s between looks at the clock, the recorder's answers and the force, and between messages to the page."""

POLL = 0.004
"""s between looks at the force during a press: the longest that the cue to lift waits for one."""

_DEFAULT = Limits()


def _limit(
    name: str, meaning: str, unit: str, low: float, high: float, advice: str = ""
) -> Parameter:
    default = getattr(_DEFAULT, name)
    return Parameter(name, default, meaning, unit, low, high, runtime=True, advice=advice)


PARAMETERS = ParameterTable(
    Parameter(
        "subject",
        "",
        "Subject code with a digit in it, such as S01; never a name. Needed before a session starts.",
        runtime=True,
    ),
    Parameter(
        "session", "", "Id of the session; empty: made from subject, date and time.", runtime=True
    ),
    Parameter(
        "conditions",
        ["dry", "natural", "moist"],
        "Blocks of the session, in this order.",
        runtime=True,
    ),
    Parameter(
        "trials", 15, "Trials per condition (the paper: 15).", minimum=1, maximum=1000, runtime=True
    ),
    Parameter(
        "readings",
        3,
        "Moisture readings before and after each press (the paper: 3); 0 for a rig without probe.",
        minimum=0,
        maximum=20,
        runtime=True,
    ),
    Parameter(
        "target_force",
        1.35,
        "Normal force at which the cue to lift is given (the paper: 1.35 N).",
        "N",
        0.06,
        50.0,
        runtime=True,
    ),
    Parameter(
        "preparations",
        [f"{name}: {text}" for name, text in PREPARATIONS.items()],
        "Preparation texts shown before each trial, one 'condition: text' each.",
        runtime=True,
    ),
    Parameter(
        "selected_trial",
        0,
        "Number of the trial that ~/repeat does again.",
        minimum=0,
        maximum=100000,
        runtime=True,
    ),
    Parameter(
        "output",
        "out/sessions",
        "Folder of the sessions; each gets a folder with its bags, session.json and trials.csv.",
        advice="Use a disk that takes 20 MB/s; a session of 45 trials with images needs about 10 GB.",
    ),
    Parameter(
        "normal_axis",
        "-z",
        "Sensor axis along which the force is positive under a press; the model's parameter of the same name.",
        choices=("+x", "-x", "+y", "-y", "+z", "-z"),
        advice="If the cue to lift never comes although the force passes the target, try the opposite sign.",
    ),
    Parameter(
        "recorder_service",
        "recorder/record",
        "Service that starts and stops the recording of a trial.",
    ),
    Parameter(
        "watched",
        ["force", "camera", "vision", "recorder"],
        "Nodes whose error in /diagnostics spoils a trial and keeps the next press from starting.",
    ),
    Parameter(
        "confirm_preparation",
        True,
        "Wait for the operator before each trial; false begins by itself (unattended runs).",
    ),
    Parameter("need_camera", True, "A trial needs contact areas; false for a rig without camera."),
    Parameter("need_recorder", True, "Every trial is recorded; false for rehearsals."),
    _limit("onset_force", "Force from which the finger counts as on the plate.", "N", 0.001, 1.0),
    _limit("liftoff_force", "Force below which the finger counts as off the plate.", "N", 0.0, 1.0),
    _limit(
        "clear_time", "How long the frame must be empty before the cue to press.", "s", 0.0, 60.0
    ),
    _limit(
        "release_time",
        "How long the finger must be off the plate to end the press.",
        "s",
        0.05,
        60.0,
    ),
    _limit("press_timeout", "Longest wait for the finger after the cue to press.", "s", 1.0, 600.0),
    _limit("target_timeout", "Longest time from first touch to the target.", "s", 0.5, 600.0),
    _limit("lift_timeout", "Longest time from the cue to lift-off.", "s", 0.5, 600.0),
    _limit(
        "gap_limit",
        "Gap between two force samples that makes a trial invalid.",
        "s",
        0.002,
        10.0,
        "Raise it above the sample period of a slow sensor.",
    ),
    _limit(
        "frame_gap_limit",
        "Gap between two contact areas that makes a trial invalid.",
        "s",
        0.02,
        10.0,
        "Raise it above three periods of a slow camera.",
    ),
    _limit(
        "stale_after",
        "Age of the newest force or area from which its source counts as silent.",
        "s",
        0.05,
        60.0,
        "Raise it when the clock of a device lags.",
    ),
    _limit("minimum_frames", "Frames with contact that a valid press needs.", "", 0, 1000),
    _limit("verdict_time", "How long a verdict is shown before the next trial.", "s", 0.1, 60.0),
    _limit("record_timeout", "Longest wait for the recorder's answer.", "s", 0.5, 120.0),
    _limit(
        "lost_limit",
        "Messages the recorder may lose in a valid trial.",
        "",
        0,
        100000,
        "Raise it only for rehearsals on a machine that is too slow.",
    ),
    _limit("max_attempts", "Failures of one trial after which the session pauses.", "", 1, 100),
)

PLAN_KEYS = ("subject", "session", "conditions", "trials", "readings", "target_force")
LIMIT_KEYS = tuple(f.name for f in fields(Limits))

SERVICES = {
    "start": "Begin a session; then: finger and plate are prepared, begin the trial.",
    "pause": "Hold the session; a press that is under way is void.",
    "resume": "Go on after a pause or a restart.",
    "redo": "Begin the trial under way again, or else the last one that was done.",
    "repeat": "Do the trial `selected_trial` again.",
    "skip": "Leave the trial at hand out.",
    "close": "Close the session; the next start begins a new one.",
}
"""Services of the node (std_srvs/Trigger), for the node reference too."""


def stamp_of(header: Any) -> int:
    """Stamp of a header in ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


class ProtocolNode(ManagedNode):
    """Guides the participant and the operator through a session."""

    TABLE = PARAMETERS
    NAME = "protocol"

    def configure(self) -> None:
        self._health = Health("protocol", stale_after=None)
        self.healths = [self._health]
        self._protocol: Protocol | None = None
        self._status = ""
        self._last_trial: Trial | None = None
        self._requests: deque[tuple[Record.Request, float]] = deque()
        self._future: Any = None
        self._request: Record.Request | None = None
        self._asked = 0.0
        self._limits = self._limits_from(self.values)
        axis = self.values["normal_axis"]
        self._axis, self._sign = axis[1], -1.0 if axis[0] == "-" else 1.0
        parse_preparations(self.values["preparations"])
        self._output = Path(self.values["output"]).expanduser().resolve()
        self._trial_publisher = self.create_publisher(Trial, "trial", STATE_QOS)
        self._status_publisher = self.create_publisher(String, "~/status", STATE_QOS)
        self._recorder = self.create_client(Record, self.values["recorder_service"])
        self._command_services = [
            self.create_service(Trigger, f"~/{name}", self._command(getattr(self, f"_{name}")))
            for name in SERVICES
        ]

    def activate(self) -> None:
        qos = self.stream_qos()
        deep = self.stream_qos(max(self.values["qos_depth"], POLLED_DEPTH))
        self._wrench = PolledSubscription(self, WrenchStamped, "wrench", deep)
        self._inputs = [
            self.create_stream_subscription(ContactArea, "contact_area", self._on_area, qos),
            self.create_stream_subscription(Moisture, "moisture", self._on_moisture, qos),
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50),
        ]
        self._resume_pointer()
        # Steady time, so that the tick goes on when simulated time jumps.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick_timer = self.create_timer(TICK, self._tick, clock=steady)
        self._press_timer = self.create_timer(POLL, self._poll, clock=steady)
        self._press_timer.cancel()

    def deactivate(self) -> None:
        for timer in (self._tick_timer, self._press_timer):
            self.destroy_timer(timer)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._wrench.destroy()
        if self._protocol is not None and not self._protocol.paused:
            if self._protocol.step not in (Step.IDLE, Step.FINISHED):
                self._protocol.pause(self._now())
                # The publisher may be destroyed next.
                self._trial_publisher.wait_for_all_acked(Duration(seconds=0.5))

    def cleanup(self) -> None:
        for service in getattr(self, "_command_services", []):
            self.destroy_service(service)
        for publisher in ("_trial_publisher", "_status_publisher"):
            if hasattr(self, publisher):
                self.destroy_publisher(getattr(self, publisher))
        self._command_services = []

    def parameters_changed(self, changes: dict[str, Any]) -> None:
        values = {**self.values, **changes}
        protocol = self._protocol
        if protocol is not None and any(
            changes.get(k, values[k]) != self.values[k] for k in PLAN_KEYS
        ):
            raise InputError("the plan of an open session cannot change; close the session first")
        texts = parse_preparations(values["preparations"])
        self._limits = self._limits_from(values)
        if protocol is not None:
            protocol.limits = self._limits
            for condition in protocol.plan.conditions:
                text = texts.get(condition)
                if text and text != protocol.plan.preparation(condition):
                    protocol.set_preparation(condition, text)

    def _limits_from(self, values: dict[str, Any]) -> Limits:
        limits = Limits(**{key: values[key] for key in LIMIT_KEYS})
        if limits.liftoff_force > limits.onset_force:
            raise InputError(
                "liftoff_force is above onset_force; a finger on the plate would count as lifted"
            )
        return limits

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    # The session -----------------------------------------------------------------------------

    def _resume_pointer(self) -> None:
        pointer = self._output / POINTER
        try:
            name = pointer.read_text().strip()
        except OSError:
            return
        if not (self._output / name / STATE_FILE).exists():
            return
        try:
            self._protocol = Protocol.resume_from(
                self._output / name, self._effect, self._now(), self._limits
            )
        except InputError as error:
            self.log_fault(self._health, "state_file", one_line(error), WARN)
            return
        self.get_logger().info(f"session {name} resumed at trial {self._protocol.current}")

    def _new_session(self) -> Protocol:
        values = self.values
        session = values["session"] or f"{values['subject']}_{time.strftime('%Y%m%dT%H%M%S')}"
        plan = StudyPlan(
            subject=values["subject"],
            session=session,
            conditions=tuple(values["conditions"]),
            trials=values["trials"],
            readings=values["readings"],
            target_force=values["target_force"],
            preparations=parse_preparations(values["preparations"]),
        )
        folder = self._output / session
        if (folder / STATE_FILE).exists():
            raise InputError(
                f"session '{session}' exists already; choose another id or leave it empty"
            )
        with atomic_write(self._output / POINTER) as file:
            file.write(session)
        return Protocol(plan, folder, self._effect, self._limits)

    def _start(self) -> str:
        if self._protocol is None:
            if self._future is not None or self._requests:
                raise InputError("the recorder is still busy; try again in a moment")
            self._protocol = self._new_session()
        self._protocol.start(self._now())
        prepare = self._protocol.step is Step.PREPARE
        return "prepare finger and plate" if prepare else "the trial begins"

    def _open(self) -> Protocol:
        if self._protocol is None:
            raise InputError("no session is open; start one first")
        return self._protocol

    def _pause(self) -> str:
        self._open().pause(self._now())
        return "paused"

    def _resume(self) -> str:
        self._open().resume(self._now())
        return "the session goes on"

    def _redo(self) -> str:
        self._open().redo(self._now())
        return f"trial {self._open().current} begins again"

    def _repeat(self) -> str:
        self._open().repeat(self.values["selected_trial"], self._now())
        return f"trial {self._open().current} begins again"

    def _skip(self) -> str:
        self._open().skip(self._now())
        return "skipped"

    def _close(self) -> str:
        protocol = self._open()
        if protocol.step not in (Step.IDLE, Step.FINISHED, Step.PREPARE, Step.FAILED, Step.DONE):
            raise InputError("a trial is under way; finish, skip or pause it first")
        (self._output / POINTER).unlink(missing_ok=True)
        self._protocol = None
        return f"session {protocol.plan.session} closed; it is in {protocol.folder}"

    def _command(self, action: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            try:
                response.message = action()
                response.success = True
            except FingerError as error:
                response.success, response.message = False, one_line(error)
            self._publish_status()
            return response

        return answer

    # Inputs ----------------------------------------------------------------------------------

    def _poll(self) -> None:
        """Take the force samples that have come: a round of the executor for each would cost a fifth of a core."""
        for data, _ in self._wrench.take():
            if self._protocol is not None:
                message = deserialize_message(data, WrenchStamped)
                force = self._sign * getattr(message.wrench.force, self._axis)
                self._protocol.wrench(stamp_of(message.header), force)

    def _on_area(self, message: ContactArea) -> None:
        self._poll()
        if self._protocol is not None:
            self._protocol.area(stamp_of(message.header), message.gross_area, message.flags)

    def _on_moisture(self, message: Moisture) -> None:
        if self._protocol is not None:
            self._protocol.moisture(stamp_of(message.header), message.value, message.flags)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if self._protocol is None:
            return
        for status in message.status:
            name = status.name.split(":")[0].rsplit("/", 1)[-1]
            if name in self.values["watched"]:
                self._protocol.health(name, status.level[0], status.message, self._now())

    def _tick(self) -> None:
        self._poll()
        self.look_for_mismatch(self._wrench)
        if self._protocol is not None:
            self._protocol.tick(self._now())
        self._serve_recorder()
        self._publish_status()
        pressing = self._protocol is not None and self._protocol.step is Step.PRESS
        if pressing and self._press_timer.is_canceled():
            self._press_timer.reset()
        elif not pressing:
            self._press_timer.cancel()

    # Effects ---------------------------------------------------------------------------------

    def _effect(self, effect: Effect) -> None:
        if not rclpy.ok(context=self.context):
            # Ctrl-C: nobody hears us any more; the state file is still written.
            return
        if isinstance(effect, TrialEvent):
            self._trial_publisher.publish(self._trial_message(effect))
            self._health.sample()
            self._health.notes["trial"] = (
                f"{effect.index} {effect.condition} {Phase(effect.phase).name}"
            )
            return
        request = Record.Request()
        if isinstance(effect, StartRecording):
            request.command = Record.Request.COMMAND_START
            request.path = effect.path
            request.trial = self._trial_message(effect.trial)
        else:
            request.command = Record.Request.COMMAND_STOP
        if self._limits.need_recorder:
            self._requests.append((request, time.monotonic()))

    def _trial_message(self, said: TrialEvent) -> Trial:
        message = Trial(
            session=said.session,
            subject=said.subject,
            condition=said.condition,
            index=said.index,
            attempt=said.attempt,
            phase=int(said.phase),
            target_force=said.target_force,
            note=said.note,
        )
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            said.stamp_ns, 1_000_000_000
        )
        return message

    def _serve_recorder(self) -> None:
        """One request to the recorder at a time, in order; a request waits until the recorder is there."""
        if self._future is not None and not self._future.done():
            if time.monotonic() - self._asked < self._limits.record_timeout:
                return
            self._future.cancel()
            if self._request is not None:
                self._recorded(self._request, None, "no answer")
        if not self._requests:
            return
        request, since = self._requests[0]
        if not self._recorder.service_is_ready():
            if time.monotonic() - since > self._limits.record_timeout:
                self._requests.popleft()
                self._recorded(request, None, "the recorder is not running")
            return
        self._requests.popleft()
        self._request, self._asked = request, time.monotonic()
        self._future = self._recorder.call_async(request)
        self._future.add_done_callback(
            lambda future: (
                None if future.cancelled() else self._recorded(request, future.result(), "")
            )
        )

    def _recorded(self, request: Record.Request, response: Any, reason: str) -> None:
        self._future = None
        started = request.command == Record.Request.COMMAND_START
        if self._protocol is None:
            return
        if response is None:
            self._protocol.recorder_answered(started, False, reason, self._now())
            return
        self._protocol.recorder_answered(
            started,
            response.success,
            response.message,
            self._now(),
            lost=0 if started else int(response.lost_count),
            bag=response.path,
        )

    def _publish_status(self) -> None:
        if self._protocol is not None:
            status = self._protocol.snapshot()
        else:
            status = {
                "step": "closed",
                "plan": {key: self.values[key] for key in PLAN_KEYS},
                "preparations": parse_preparations(self.values["preparations"]),
            }
        text = json.dumps(status)
        if text != self._status:
            self._status = text
            self._status_publisher.publish(String(data=text))


main = main_of(ProtocolNode)

if __name__ == "__main__":
    main()
