# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node of `finger-rig calibrate`: tares, starts a subject's calibration, guides, shows the result.

Exit code 0: calibrated; 2 with one sentence: refused or failed. Ended while presses are made, it
aborts the session: nothing is written. Once all are made the model node fits and keeps them anyway.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from std_srvs.srv import Trigger

from finger_common.diagnostics import ERROR, Health
from finger_common.errors import FingerError, InputError
from finger_common.files import user_path
from finger_common.flags import AreaFlag
from finger_common.guided_presses import is_fitting
from finger_common.node import (
    LATCHED_QOS,
    STATE_QOS,
    ManagedNode,
    main_of,
    refusal_of,
    set_request,
)
from finger_common.settings import Settings, setting
from finger_common.subject_code import parameter_file_name
from finger_msgs.msg import ContactArea, ContactState, SessionStatus

from .status_message import status_of

T = TypeVar("T")
Work = Generator[None, None, T]
"""Steps of some work, and its result."""

PERIOD = 0.1
"""s between looks at what has come."""

NO_PROGRESS = 120.0
"""s without any progress, after which the calibration is given up."""

FRAMES_AFTER_TARE = 3
"""Areas after a tare that tell whether the plate was touched meanwhile."""

ENDING_TIME = 3.0
"""s to wait for the protocol node's answers when the session is aborted."""

STREAMS = {
    "wrench": (WrenchStamped, "the force sensor is silent"),
    "contact_area": (ContactArea, "no contact area comes from the camera"),
    "contact_state": (ContactState, "the model node gives no estimate"),
}
"""What must come as long as presses are made, and what to say otherwise. Each needs those before
it."""

ENDING = ("protocol/abort", "protocol/close")
SEE = "; see the output of 'finger-rig up'"

TRIGGERS = ("force/tare", "protocol/calibrate", *ENDING)


@dataclass(frozen=True)
class CalibrateSettings(Settings):
    """Parameters of the node."""

    subject: str = setting("", "Subject code with a digit in it, such as S01.")
    finger_width: float = setting(0.0, "By calipers; 0: not measured.", "m", 0.0, 0.04)
    finger_depth: float = setting(0.0, "By calipers; 0: not measured.", "m", 0.0, 0.04)
    finger: str = setting("", "Finger that is calibrated; empty: not noted.")
    age: int = setting(0, "Age of the subject; 0: not noted.", "years", 0, 120)
    again: bool = setting(False, "Replace the subject's parameters, if there are any.")
    patience: float = setting(15.0, "Longest wait for the rig.", "s", 1.0, 3600.0)
    silence: float = setting(
        20.0, "Silence of force, camera or model that ends the presses.", "s", 1.0, 3600.0
    )


def _problem(text: str) -> InputError:
    """The error of a sentence that another node gave."""
    return InputError(text[:1].lower() + text[1:].rstrip("."))


class CalibrateNode(ManagedNode):
    """Follows one calibration of the protocol node."""

    SETTINGS = (CalibrateSettings,)
    NAME = "calibrate"
    ONE_TASK = True

    def configure(self) -> None:
        self.healths = [Health("calibrate")]
        self._settings = self.settings(CalibrateSettings)
        self._failure: FingerError | None = None
        self._seen: dict[str, float] = {}
        self._frames, self._touched = 0, -1
        """Areas that came, and the number of the last one with something on the plate."""
        self._shown = ""
        self._session = self._before = ""
        self._newest: SessionStatus | None = None
        self._status: dict[str, Any] = {}
        self._requested = self._under_way = False
        self._result: DiagnosticStatus | None = None

    def activate(self) -> None:
        self._since = self._began = time.monotonic()
        qos = self.stream_qos()
        for topic, (kind, _) in STREAMS.items():
            self.create_stream_subscription(kind, topic, self._marking(topic), qos)
        self.create_subscription(SessionStatus, "protocol/status", self._on_status, STATE_QOS)
        self.create_subscription(DiagnosticStatus, "calibration", self._on_calibration, LATCHED_QOS)
        self._triggers = {name: self.create_client(Trigger, name) for name in TRIGGERS}
        self._model = self.create_client(GetParameters, "model/get_parameters")
        self._protocol = self.create_client(SetParameters, "protocol/set_parameters")
        self._work = self._steps()
        self._timer = self.create_steady_timer(PERIOD, self._advance)

    def deactivate(self) -> None:
        self.destroy_timer(self._timer)
        if not self._requested:
            return
        self._requested, self._session = False, ""
        if is_fitting(self._status.get("message", "")):
            self._say("all presses are made; the model node fits them, and the result is kept")
            return
        answers = [self._triggers[name].call_async(Trigger.Request()) for name in ENDING]
        end = time.monotonic() + ENDING_TIME
        while not all(a.done() for a in answers) and time.monotonic() < end:
            assert self.executor is not None
            self.executor.spin_once(timeout_sec=PERIOD)
        if answers[0].done():
            self._say("aborted; nothing was written")
        else:
            self._say("the protocol node does not answer; end the session on the operator's page")

    # In this order ---------------------------------------------------------------------------

    def _steps(self) -> Work[None]:
        """All that is done; what comes is looked at between two yields, each PERIOD."""
        self._say("waiting for the rig")
        yield from self._await_rig()
        request = GetParameters.Request(names=["subjects_folder"])
        answer = yield from self._ask(self._model, request)
        self._check_folder(answer.values[0].string_value)
        assert self._newest is not None
        self._before = self._newest.session
        if self._newest.step == "finished":  # one that is over but open holds its plan
            yield from self._call("protocol/close")
        answer = yield from self._ask(self._protocol, set_request(self._plan()))
        if reason := refusal_of(answer):
            raise _problem(reason)
        self._say("keep the plate empty: the force is tared")
        while not (yield from self._tare()):
            self._show("The plate was touched during the tare: once more.")
        self._requested = True
        answer = yield from self._ask(self._triggers["protocol/calibrate"], Trigger.Request())
        self._requested = answer.success  # else there is no session of ours to end
        if not answer.success:
            raise _problem(answer.message)
        self._under_way = True
        self._on_status(self._newest)
        yield from self._until(lambda: self._result is not None)
        self._show_result()
        yield from self._call("protocol/close")

    def _advance(self) -> None:
        try:
            next(self._work)
        except StopIteration:
            raise KeyboardInterrupt from None  # Done: end as after Ctrl-C.

    def _until(self, condition: Callable[[], bool]) -> Work[None]:
        """Let time pass until the condition holds; raises InputError when the rig fails."""
        self._since = time.monotonic()
        while not condition():
            yield
            self._watch()

    def _ask(self, client: Any, request: Any) -> Work[Any]:
        """Response of a service."""
        future = client.call_async(request)
        yield from self._until(future.done)
        return future.result()

    def _call(self, name: str) -> Work[None]:
        """Call a service that has to succeed."""
        answer = yield from self._ask(self._triggers[name], Trigger.Request())
        if not answer.success:
            raise _problem(answer.message)

    # Before ------------------------------------------------------------------------------------

    def _marking(self, topic: str) -> Callable[[Any], None]:
        def mark(message: Any) -> None:
            self._seen[topic] = time.monotonic()
            if isinstance(message, ContactArea):
                self._frames += 1
                if not message.flags & AreaFlag.NO_CONTACT:
                    self._touched = self._frames

        return mark

    def _await_rig(self) -> Work[None]:
        clients = [*self._triggers.values(), self._model, self._protocol]
        while True:
            ready = all(c.service_is_ready() for c in clients) and self._newest is not None
            missing = [text for topic, (_, text) in STREAMS.items() if topic not in self._seen]
            if ready and not missing:
                break
            if time.monotonic() - self._since > self._settings.patience:
                raise InputError(self._absence(clients, missing))
            yield
        assert self._newest is not None
        if self._newest.step not in ("closed", "finished"):
            raise InputError(
                f"a session is open ({self._newest.session}); end and close it before a calibration"
            )

    def _absence(self, clients: list[Any], missing: list[str]) -> str:
        if not any(client.service_is_ready() for client in clients):
            return (
                f"no rig answers in namespace '{self.get_namespace()}'; start it with "
                "'finger-rig up', name its --namespace, or give --simulated"
            )
        if missing:
            return missing[0] + SEE
        return "the rig is not complete: force, model and protocol nodes are needed"

    def _check_folder(self, folder: str) -> None:
        """Raise InputError where the model node keeps no result, or has one already."""
        subject = self._settings.subject
        if not folder:
            raise InputError(
                "the model node has no 'subjects_folder' to keep the result in; set it"
            )
        path = user_path(folder) / parameter_file_name(subject, self._settings.finger)
        if path.exists() and not self._settings.again:
            raise InputError(
                f"subject {subject} is calibrated already ({path}); give --again to replace that"
            )

    def _plan(self) -> dict[str, Any]:
        return {
            "subject": self._settings.subject,
            "session": "",
            "finger_width": self._settings.finger_width,
            "finger_depth": self._settings.finger_depth,
            "finger": self._settings.finger,
            "hand": "",
            "age": self._settings.age,
        }

    def _tare(self) -> Work[bool]:
        """Take the zero; whether the camera saw an empty plate from before until after it."""
        if self._touched == self._frames:
            self._show("Waiting: something is on the plate; lift the finger and clean the plate.")
        yield from self._until(lambda: self._touched != self._frames)
        before = self._frames
        answer = yield from self._ask(self._triggers["force/tare"], Trigger.Request())
        if not answer.success:
            # A zero that has moved far is taken when asked for again; here the plate is seen empty.
            yield from self._call("force/tare")
        enough = self._frames + FRAMES_AFTER_TARE
        yield from self._until(lambda: self._touched > before or self._frames >= enough)
        return self._touched <= before

    # During ------------------------------------------------------------------------------------

    def _on_status(self, message: SessionStatus) -> None:
        self._newest = message
        if not self._under_way:
            return
        status = status_of(message)
        if "trials" not in status or status["session"] == self._before:
            return
        if status != self._status:
            self._since = time.monotonic()
        self._status, self._session = status, status["session"]
        if status["step"] == "finished":
            if is_fitting(status["message"]):
                self._show(status["message"])
            else:
                self._fail(status["message"])
            return
        text = status["instruction"]
        if status["step"] == "clear" and status["waiting_for"]:
            text = f"Waiting: {status['waiting_for']}."
        if status["step"] == "prepare":
            text += f" Target {status['target_force']:.1f} N."
        if status["step"] != "closing":
            self._show(f"press {status['index'] + 1} of {len(status['trials'])}: {text}")
        if status["paused"]:
            self._fail(f"the calibration is paused: {status['message'] or 'by an operator'}")

    def _on_calibration(self, message: DiagnosticStatus) -> None:
        if not self._session or message.hardware_id != self._session:
            return
        self._under_way, self._result = False, message

    def _show_result(self) -> None:
        """Print what was found and where it is kept; raises InputError where it is not."""
        message = self._result
        assert message is not None
        if message.level[0] >= ERROR:
            self._status = {}
            raise _problem(f"not calibrated: {message.message}")
        self._requested = False
        values = {item.key: item.value for item in message.values}
        self._say(message.message)
        self._say(f"computed in {values['computing_s']} s and live in the model node")
        if "file" not in values:
            not_kept = values.get("not_kept", "not kept")
            raise _problem(f"live until the model node ends, but {not_kept}")
        taken = time.monotonic() - self._began
        self._say(f"written: {values['file']} ({taken:.0f} s in all)")

    def _watch(self) -> None:
        if self._failure is not None:
            raise self._failure
        now = time.monotonic()
        if not self.count_publishers("protocol/status"):
            raise InputError(f"the protocol node ended{SEE}")
        for topic, (_, text) in STREAMS.items():
            if now - self._seen[topic] > self._settings.silence:
                raise InputError(f"{text}, for {self._settings.silence:.0f} s{SEE}")
        if now - self._since > NO_PROGRESS:
            waiting = self._status.get("waiting_for") or self._status.get("instruction", "")
            raise InputError(f"no progress for {NO_PROGRESS:.0f} s ({waiting or 'no answer'})")

    def _fail(self, text: str) -> None:
        """End with this sentence, from the timer."""
        self._failure = self._failure or _problem(text)

    def _show(self, text: str) -> None:
        """Print what has not just been printed."""
        if text != self._shown:
            self._shown = text
            self._say(text)

    @staticmethod
    def _say(text: str) -> None:
        print(text, flush=True)


main = main_of(CalibrateNode)

if __name__ == "__main__":
    main()
