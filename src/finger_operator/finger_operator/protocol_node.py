# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that guides a study.

It publishes the latched `trial`, starts and stops the recorder, and publishes the session for the
operator's page on `~/status` (latched). Its services are the commands of the page.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from finger_bag.streams import TrialEvent
from finger_common.cli import one_line
from finger_common.condition_name import SESSION_NAME
from finger_common.diagnostics import (
    ERROR,
    OK,
    WARN,
    Health,
    full_node_name,
    node_within,
    status_node,
)
from finger_common.errors import FingerError, InputError, listed
from finger_common.files import atomic_write, read_text, user_path
from finger_common.folder_lock import lock_folder
from finger_common.node import (
    LATCHED_QOS,
    POLLED_DEPTH,
    STATE_QOS,
    ManagedNode,
    main_of,
    message_of,
)
from finger_common.settings import Settings, setting
from finger_common.stamps import fill_time, header_stamp
from finger_common.subject_code import check_new_subject
from finger_common.trial_phases import TrialPhase
from finger_msgs.msg import ContactArea, Moisture, SessionStatus, Trial
from finger_msgs.srv import Record

from .limits import Limits
from .normal_force import NormalForce, normal_axis_setting, wrench_topic_setting
from .protocol import Effect, Protocol
from .readiness import TARE_NEEDED, refusal, tared_by
from .recorder_requests import RecorderRequests
from .recording import StartRecording, StopRecording
from .session_store import (
    STATE_FILE,
    earlier_sessions,
    free_space,
    further_files,
    saved_plans,
    sessions_by_subject,
)
from .status import GIGABYTE, USUAL_SIZE, closed_status, session_status
from .status_message import status_fields
from .steps import Step
from .study_plan import (
    PREPARATIONS,
    PlanSettings,
    StudyPlan,
    parse_preparation,
    parse_preparations,
)

POINTER = "current_session"
"""File in `output` that names the session under way, so that a restarted node finds it again."""

TICK = 0.05
"""s between steps of the protocol, and between messages to the page."""

POLL = 0.004
"""s between readings of the force during a press: the longest delay that polling adds to a cue."""


STATUS_PAUSE = 9.0
"""Times what a status took until the next one: a tenth of the node's time goes into it at most."""

FREE_SPACE_PERIOD = 5.0
"""s between readings of the free disk space."""


@dataclass(frozen=True)
class ProtocolSettings(Settings):
    """Parameters of the node beside the plan and the limits."""

    preparations: list = setting(
        [f"{name}: {text}" for name, text in PREPARATIONS.items()],
        "Preparation texts shown before each trial, one 'condition: text' each.",
        runtime=True,
    )
    preparation: str = setting(
        "", "'condition: text' that ~/preparation puts among `preparations`.", runtime=True
    )
    selected_trial: int = setting(
        0,
        "Number of the trial that ~/repeat does again.",
        minimum=0,
        maximum=100000,
        runtime=True,
    )
    note: str = setting("", "Text that ~/note adds to the event log.", runtime=True)
    note_trial: int = setting(
        -1,
        "Number of the trial that ~/note belongs to; -1: the session.",
        minimum=-1,
        maximum=100000,
        runtime=True,
    )
    output: str = setting(
        "out/sessions",
        "Folder of the sessions; each gets a folder with its bags, session.json, trials.csv and "
        "events.csv.",
        advice="Use a disk that takes 20 MB/s; a session of 45 trials with images needs about "
        f"{45 * USUAL_SIZE / GIGABYTE:.0f} GB.",
    )
    wrench_topic: str = wrench_topic_setting()
    normal_axis: str = normal_axis_setting(
        "If the cue to lift never comes although the force passes the target, try the opposite "
        "sign."
    )
    recorder_service: str = setting(
        "recorder/record",
        "Service that starts and stops the recording of a trial.",
        ros_name=True,
    )
    watched: list = setting(
        ["force", "camera", "vision", "recorder"],
        "Nodes whose error in /diagnostics makes a trial invalid and delays the next press; of "
        "this node's namespace, or with a full name such as /wrist/force.",
    )


SERVICES = {
    "start": "Begin a session; then: finger and plate are prepared, begin the trial.",
    "calibrate": "Begin the calibration of `subject`: guided presses that the model node fits.",
    "pause": "Hold the session; a press that is under way is not kept.",
    "resume": "Go on after a pause or a restart.",
    "redo": "Begin the trial under way again, or else the last one that was done.",
    "repeat": "Do the trial `selected_trial` again.",
    "skip": "Leave the current trial out.",
    "end": "End the session early; a trial under way is completed first. Data are kept.",
    "abort": "End the session at once; a trial under way is void, its bag is kept.",
    "note": "Add the parameter `note` to the trial `note_trial`, or to the session.",
    "marker": "Mark this moment in the event log.",
    "preparation": "Put `preparation` among `preparations`, and into the open session.",
    "close": "Close the session; the next start begins a new one.",
}
"""Services of the node (std_srvs/Trigger), for the node reference too."""


class ProtocolNode(ManagedNode):
    """Guides the participant and the operator through a session."""

    SETTINGS = (PlanSettings, ProtocolSettings, Limits)
    NAME = "protocol"

    def configure(self) -> None:
        self._health = Health("protocol", stale_after=None)
        self.healths = [self._health]
        self._protocol: Protocol | None = None
        self._status: dict[str, Any] = {}
        self._status_of: tuple[Any, ...] = ()
        self._status_due = -math.inf
        self._limits = self.settings(Limits)
        settings = self.settings(ProtocolSettings)
        self._normal_force = NormalForce(settings.normal_axis)
        namespace = self.get_namespace()
        self._watched = {full_node_name(name, namespace): name for name in settings.watched}
        parse_preparations(settings.preparations)
        self._output = user_path(settings.output).resolve()
        self.closing.enter_context(lock_folder(self._output, "a protocol node"))
        self._read_sessions()
        self._free: int | None = None
        self._free_read = -math.inf
        self._reserve = 0
        self._trial_publisher = self.create_publisher(Trial, "trial", STATE_QOS)
        self._status_publisher = self.create_publisher(SessionStatus, "~/status", STATE_QOS)
        client = self.create_client(Record, self.values["recorder_service"])
        self._recorder = RecorderRequests(client, self._recorded)
        for name in SERVICES:
            self.create_service(Trigger, f"~/{name}", self._command(getattr(self, f"_{name}")))

    def activate(self) -> None:
        qos = self.stream_qos()
        deep = self.stream_qos(max(self.values["qos_depth"], POLLED_DEPTH))
        self._tared: bool | None = None
        self._wrench = self.create_polled_subscription(
            WrenchStamped, self.values["wrench_topic"], deep
        )
        self.create_stream_subscription(ContactArea, "contact_area", self._on_area, qos)
        self.create_stream_subscription(Moisture, "moisture", self._on_moisture, qos)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.create_subscription(DiagnosticStatus, "calibration", self._on_calibration, LATCHED_QOS)
        if self._protocol is None or not self._protocol.files.problem:
            self._resume_pointer()  # else its state file is older than what is known here
        # Steady time, so that the tick continues when simulated time jumps.
        self.create_steady_timer(TICK, self._tick)
        self._press_timer = self.create_steady_timer(POLL, self._poll)
        self._press_timer.cancel()

    def deactivate(self) -> None:
        self.destroy_active_interfaces()
        if self._protocol is not None and not self._protocol.paused:
            if self._protocol.step not in (Step.IDLE, Step.FINISHED):
                self._protocol.pause(self.sample_time())
                # The publisher may be destroyed next.
                self._trial_publisher.wait_for_all_acked(Duration(seconds=0.5))
        if self._protocol is not None and self._protocol.recording.is_open:
            self._effect(StopRecording())
        self._recorder.send_all()
        if self._protocol is not None:
            try:
                self._protocol.files.write_all()
            except InputError as error:
                self.get_logger().error(one_line(error))

    def parameters_changed(self, changes: dict[str, Any]) -> None:
        values = {**self.values, **changes}
        protocol = self._protocol
        plan_changed = PlanSettings.select(values) != self.settings(PlanSettings)
        if protocol is not None and plan_changed:
            raise InputError("the plan of an open session cannot change; close the session first")
        texts = parse_preparations(values["preparations"])
        self._limits = Limits.select(values)
        if protocol is not None:
            protocol.limits = self._limits
        # An open session may have texts of its own: only those that are given anew count.
        if protocol is not None and "preparations" in changes:
            before = parse_preparations(self.values["preparations"])
            for condition in protocol.plan.conditions:
                text = texts.get(condition)
                if text and text != before.get(condition):
                    protocol.set_preparation(condition, text)

    # The session -----------------------------------------------------------------------------

    def _read_sessions(self) -> None:
        plans = saved_plans(self._output)
        self._used_subjects = sessions_by_subject(plans)
        studies = (plan for plan in plans.values() if not plan.is_calibration)
        self._used_conditions = sorted({name for plan in studies for name in plan.conditions})

    def _resume_pointer(self) -> None:
        pointer = self._output / POINTER
        try:
            name = read_text(pointer).strip()
        except InputError:
            return
        if not SESSION_NAME.fullmatch(name) or not (self._output / name / STATE_FILE).exists():
            return
        try:
            self._protocol = Protocol.resume_from(
                self._output / name, self._effect, self.sample_time(), self._limits
            )
        except InputError as error:
            self.log_fault(self._health, "state_file", one_line(error), WARN)
            return
        self.get_logger().info(f"session {name} resumed at trial {self._protocol.current + 1}")

    def _new_session(self, calibration: bool = False) -> Protocol:
        values = self.values
        if values["subject"] not in self._used_subjects:
            check_new_subject(values["subject"])
        session = values["session"] or f"{values['subject']}_{time.strftime('%Y%m%dT%H%M%S')}"
        plan = StudyPlan(
            **{**self.settings(PlanSettings).to_dict(), "session": session},
            preparations=parse_preparations(values["preparations"]),
        )
        if calibration:
            probe = self.count_publishers("moisture") > 0
            plan = plan.for_calibration(f"{session}_calibration", probe)
        folder = self._output / plan.session
        if (folder / STATE_FILE).exists():
            raise InputError(
                f"session '{plan.session}' exists already; choose another id or leave it empty"
            )
        for name, text in further_files(plan).items():
            with atomic_write(folder / name) as file:
                file.write(text)
        with atomic_write(self._output / POINTER, durable=True) as file:
            file.write(plan.session)
        return Protocol(plan, folder, self._effect, self._limits)

    def _start(self) -> str:
        if self._protocol is None:
            self._refuse_busy_recorder()
            self._protocol = self._new_session()
        if self._protocol.step is Step.PREPARE and not self._protocol.paused:
            self._refuse_untared()
            self._protocol.check_clocks()
        begun = "Session begun. " if self._protocol.step is Step.IDLE else ""
        self._protocol.start(self.sample_time())
        return {
            Step.PREPARE: f"{begun}Prepare the finger and the plate.",
            Step.FINISHED: "the session is finished",
        }.get(self._protocol.step, "the trial begins")

    def _calibrate(self) -> str:
        if self._protocol is not None and self._protocol.step is Step.FINISHED:
            self._close()
        if self._protocol is not None:
            raise InputError("a session is open; end and close it before a calibration")
        if not self._limits.need_camera:
            raise InputError(
                "a calibration needs the camera, and this rig runs without (need_camera)"
            )
        self._refuse_busy_recorder()
        self._refuse_untared()
        self._protocol = self._new_session(calibration=True)
        self._protocol.start(self.sample_time())
        return "the calibration begins"

    def _refuse_busy_recorder(self) -> None:
        if self._recorder.busy:
            raise InputError("the recorder is still busy; try again in a moment")

    def _refuse_untared(self) -> None:
        """Before a trial begins, as the page does."""
        if self._tared is False:
            raise InputError(refusal([TARE_NEEDED]))

    def _open(self) -> Protocol:
        if self._protocol is None:
            raise InputError("no session is open; start one first")
        return self._protocol

    def _pause(self) -> str:
        self._open().pause(self.sample_time())
        return "paused"

    def _resume(self) -> str:
        self._open().resume(self.sample_time())
        return "the session continues"

    def _redo(self) -> str:
        self._open().redo(self.sample_time())
        return f"trial {self._open().current + 1} will begin again"

    def _repeat(self) -> str:
        self._open().repeat(self.values["selected_trial"], self.sample_time())
        return f"trial {self._open().current + 1} will begin again"

    def _skip(self) -> str:
        self._open().skip(self.sample_time())
        return "skipped"

    def _end(self) -> str:
        self._open().end(self.sample_time())
        finished = self._open().step is Step.FINISHED
        return "the session is ended" if finished else "the session ends after this trial"

    def _abort(self) -> str:
        self._open().abort(self.sample_time())
        return "the session is ended"

    def _note(self) -> str:
        index = self.values["note_trial"]
        self._open().note(self.sample_time(), self.values["note"], index)
        return "note added to the session" if index < 0 else f"note added to trial {index + 1}"

    def _preparation(self) -> str:
        condition, text = parse_preparation(self.values["preparation"])
        if self._protocol is not None:
            self._protocol.set_preparation(condition, text)
        texts = {**parse_preparations(self.values["preparations"]), condition: text}
        lines = [f"{name}: {text}" for name, text in texts.items()]
        (result,) = self.set_parameters([Parameter("preparations", value=lines)])
        if not result.successful:
            raise InputError(result.reason)
        return f"preparation of '{condition}' changed"

    def _marker(self) -> str:
        return f"{self._open().mark(self.sample_time())} set"

    def _close(self) -> str:
        protocol = self._open()
        if protocol.step not in (Step.IDLE, Step.FINISHED, Step.PREPARE, Step.FAILED, Step.DONE):
            raise InputError("a trial is under way; finish, skip or pause it first")
        protocol.files.write_all()
        if protocol.files.unmarked:
            self._refuse_busy_recorder()
        unmarked = listed(bag.name for bag, _ in protocol.files.unmarked)
        if unmarked:
            unmarked = f"; not marked as failed, leave out: {unmarked}"
            self.get_logger().error(f"session {protocol.plan.session}{unmarked}")
        (self._output / POINTER).unlink(missing_ok=True)
        self._protocol = None
        self._read_sessions()
        return f"session {protocol.plan.session} closed; it is in {protocol.folder}{unmarked}"

    def _command(self, action: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            try:
                response.message = action()
                response.success = True
            except (FingerError, OSError) as error:
                response.success, response.message = False, one_line(error)
            self._publish_status()
            return response

        return answer

    # Inputs ----------------------------------------------------------------------------------

    def _poll(self) -> None:
        """Read the new force samples; one executor round for each would cost a fifth of a core."""
        for raw, _ in self._wrench.take():
            if self._protocol is not None and (message := self._wrench.read(raw)) is not None:
                normal, across = self._normal_force(message), self._normal_force.tangential(message)
                self._protocol.wrench(header_stamp(message), normal, across)

    def _on_area(self, message: ContactArea) -> None:
        self._poll()
        if self._protocol is not None:
            self._protocol.area(
                header_stamp(message), message.gross_area, message.flags, message.stick_ratio
            )

    def _on_moisture(self, message: Moisture) -> None:
        if self._protocol is not None:
            self._protocol.moisture(header_stamp(message), message.value)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            node = node_within(status.name, self.get_namespace())
            tared = tared_by(node, values)
            self._tared = self._tared if tared is None else tared
            name, protocol = self._watched.get(status_node(status.name)), self._protocol
            if protocol is None or name is None:
                continue
            now, level, text = self.sample_time(), status.level[0], status.message
            if node == "force" and self._tared is False:
                # To a trial that is no warning.
                level, text = ERROR, f"{TARE_NEEDED.text} {TARE_NEEDED.remedy}"
            protocol.health(name, level, text, now)
            if tared and "tare_offset" in values:
                protocol.tared(values["tare_offset"], now)
            if "recording" in values:
                protocol.recorder_writes(values["recording"], now)
                self._reserve = int(values.get("minimum_free", 0))

    def _on_calibration(self, message: DiagnosticStatus) -> None:
        protocol = self._protocol
        if protocol is not None and protocol.plan.session == message.hardware_id:
            good = message.level[0] < ERROR
            protocol.calibrated(good, message.message, self.sample_time())

    def _tick(self) -> None:
        self._poll()
        self.check_mismatch(self._wrench)
        if self._protocol is not None:
            if self._protocol.plan.is_calibration:
                self._watch_model(self._protocol)
            self._protocol.tick(self.sample_time())
        self._recorder.step(self._limits.record_timeout)
        if time.monotonic() - self._free_read > FREE_SPACE_PERIOD:
            self._free_read = time.monotonic()
            self._free = free_space(self._output)
            self._watch_clock()
        pressing = self._protocol is not None and self._protocol.step in (Step.PRESS, Step.PULL)
        # The status of a long session takes long, and the cue must not wait for it.
        due = not pressing and time.monotonic() >= self._status_due
        if due or self._status_of != self._stage():
            self._publish_status()
        if pressing and self._press_timer.is_canceled():
            self._press_timer.reset()
        elif not pressing:
            self._press_timer.cancel()

    def _watch_model(self, protocol: Protocol) -> None:
        """A press that the model node does not see is lost for the calibration."""
        running = self.count_publishers("contact_state") > 0
        level, text = (OK, "") if running else (ERROR, "the node is not running")
        protocol.health("model", level, text, self.sample_time())

    def _watch_clock(self) -> None:
        if self._protocol is not None:
            warning = self.host_clock.step_warning("the times of the session")
            self._protocol.clock_stepped(self.host_clock.step(), warning)

    # Effects ---------------------------------------------------------------------------------

    def _effect(self, effect: Effect) -> None:
        if not rclpy.ok(context=self.context):
            # After Ctrl-C nothing can be published; the state file is still written.
            return
        if isinstance(effect, TrialEvent):
            self._trial_publisher.publish(self._trial_message(effect))
            self._health.sample()
            self._health.notes["trial"] = (
                f"{effect.index} {effect.condition} {TrialPhase(effect.phase).name}"
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
            self._recorder.add(request)

    @staticmethod
    def _trial_message(event: TrialEvent) -> Trial:
        fields = {**vars(event), "phase": int(event.phase)}
        message = Trial()
        fill_time(message.header.stamp, fields.pop("stamp_ns"))
        message.header.frame_id = fields.pop("finger")
        for name, value in fields.items():
            setattr(message, name, value)
        return message

    def _recorded(self, request: Record.Request, response: Any, reason: str) -> None:
        if self._protocol is None:
            return
        if response is None:
            response = Record.Response(success=False, message=reason)
        answer = response.success, response.message, self.sample_time()
        if request.command == Record.Request.COMMAND_START:
            self._protocol.recorder_started(*answer, bag=response.path, asked=request.path)
        else:
            counts = {"lost": response.lost_count, "message_count": response.message_count}
            self._protocol.recorder_stopped(*answer, **counts, bag=response.path)

    def _stage(self) -> tuple[Any, ...]:
        """Of which a new status is published at once."""
        protocol = self._protocol
        return () if protocol is None else (protocol.step, protocol.paused, protocol.current)

    def _publish_status(self) -> None:
        began = time.monotonic()
        self._status_of = self._stage()
        if self._protocol is not None:
            plan = self._protocol.plan
            earlier = earlier_sessions(self._used_subjects, plan)
            status = session_status(self._protocol, self._free, earlier, self._reserve)
        else:
            status = closed_status(
                self.settings(PlanSettings),
                parse_preparations(self.values["preparations"]),
                self._used_subjects,
                self._used_conditions,
                self._free,
            )
        if status != self._status:
            self._status = copy.deepcopy(status)
            self._status_publisher.publish(message_of(SessionStatus, status_fields(status)))
        now = time.monotonic()
        self._status_due = now + STATUS_PAUSE * (now - began)


main = main_of(ProtocolNode)

if __name__ == "__main__":
    main()
