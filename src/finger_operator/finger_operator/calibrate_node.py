# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node of `finger-rig calibrate`: tares, starts a subject's calibration, guides, shows the result.

Exit code 0: calibrated; 2 with one sentence: refused or failed. Ended while presses are made, it
aborts the session: nothing is written. Once all are made the model node fits and keeps them anyway.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from finger_common.diagnostics import ERROR, Health
from finger_common.errors import FingerError, InputError
from finger_common.flags import AreaFlag
from finger_common.guided_presses import FITTING
from finger_common.node import LATCHED_QOS, STATE_QOS, ManagedNode, main_of
from finger_common.settings import Settings, setting
from finger_msgs.msg import ContactArea, ContactState, SessionStatus

from .status_message import status_of

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
        self._touched = self._touched_since_tare = False
        self._frames = 0
        self._shown = ""
        self._session = self._before = ""
        self._newest: SessionStatus | None = None
        self._status: dict[str, Any] = {}
        self._requested = self._under_way = False

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
        self._say("waiting for the rig")
        self._timer = self.create_steady_timer(PERIOD, self._await_rig)

    def deactivate(self) -> None:
        self.destroy_timer(self._timer)
        if not self._requested:
            return
        self._requested, self._session = False, ""
        if self._status.get("message") == FITTING:
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

    # Before ------------------------------------------------------------------------------------

    def _marking(self, topic: str) -> Callable[[Any], None]:
        def mark(message: Any) -> None:
            self._seen[topic] = time.monotonic()
            if isinstance(message, ContactArea):
                self._touched = not message.flags & AreaFlag.NO_CONTACT
                self._frames += 1
                self._touched_since_tare |= self._touched

        return mark

    def _proceed(self, step: Callable[[], None]) -> None:
        """Call `step` every PERIOD from now on."""
        self.destroy_timer(self._timer)
        self._since = time.monotonic()
        self._timer = self.create_steady_timer(PERIOD, step)

    def _await_rig(self) -> None:
        clients = [*self._triggers.values(), self._model, self._protocol]
        ready = all(client.service_is_ready() for client in clients) and self._newest is not None
        missing = [text for topic, (_, text) in STREAMS.items() if topic not in self._seen]
        if not ready or missing:
            if time.monotonic() - self._since > self._settings.patience:
                raise InputError(self._absence(clients, missing))
            return
        assert self._newest is not None
        if self._newest.step not in ("closed", "finished"):
            raise InputError(
                f"a session is open ({self._newest.session}); end and close it before a calibration"
            )
        self._proceed(self._watch)
        request = GetParameters.Request(names=["subjects_folder"])
        self._model.call_async(request).add_done_callback(self._on_folder)

    def _absence(self, clients: list[Any], missing: list[str]) -> str:
        if not any(client.service_is_ready() for client in clients):
            return (
                f"no rig answers in namespace '{self.get_namespace()}'; start it with "
                "'finger-rig up', name its --namespace, or give --simulated"
            )
        if missing:
            return missing[0] + SEE
        return "the rig is not complete: force, model and protocol nodes are needed"

    def _on_folder(self, future: Any) -> None:
        folder = future.result().values[0].string_value
        subject = self._settings.subject
        if not folder:
            self._fail("the model node has no 'subjects_folder' to keep the result in; set it")
            return
        path = Path(folder).expanduser() / f"{subject}.yaml"
        if path.exists() and not self._settings.again:
            self._fail(
                f"subject {subject} is calibrated already ({path}); give --again to replace that"
            )
        else:
            self._close_earlier()

    def _close_earlier(self) -> None:
        """A session that is over but open holds its plan."""
        assert self._newest is not None
        self._before = self._newest.session
        if self._newest.step == "finished":
            self._call("protocol/close", lambda _: self._set_plan())
        else:
            self._set_plan()

    def _set_plan(self) -> None:
        values = {
            "subject": self._settings.subject,
            "session": "",
            "finger_width": self._settings.finger_width,
            "finger_depth": self._settings.finger_depth,
            "finger": self._settings.finger,
            "hand": "",
            "age": self._settings.age,
        }
        request = SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )

        def answered(future: Any) -> None:
            refused = [r.reason for r in future.result().results if not r.successful]
            if refused:
                self._fail(refused[0])
            else:
                self._say("keep the plate empty: the force is tared")
                self._proceed(self._tare_when_clear)

        self._protocol.call_async(request).add_done_callback(answered)

    def _tare_when_clear(self) -> None:
        """Take the zero once the camera sees nothing on the plate."""
        self._watch()
        if self._touched:
            self._show("Waiting: something is on the plate; lift the finger and clean the plate.")
            return
        self._proceed(self._watch)
        self._touched_since_tare = False
        self._call("force/tare", self._on_tared)

    def _on_tared(self, message: str) -> None:
        self._frames = 0
        self._proceed(self._begin_when_seen)

    def _begin_when_seen(self) -> None:
        """Begin unless the camera saw the plate touched while the zero was taken."""
        self._watch()
        if self._touched_since_tare:
            self._show("The plate was touched during the tare: once more.")
            self._proceed(self._tare_when_clear)
        elif self._frames >= FRAMES_AFTER_TARE:
            self._proceed(self._watch)
            self._requested = True
            self._call("protocol/calibrate", self._on_begun)

    def _on_begun(self, message: str) -> None:
        self._under_way = True
        if self._newest is not None:
            self._on_status(self._newest)

    def _call(self, name: str, following: Callable[[str], None]) -> None:
        def answered(future: Any) -> None:
            response = future.result()
            if response.success:
                following(response.message)
            else:
                if name == "protocol/calibrate":
                    self._requested = False  # no session of ours to end
                self._fail(response.message)

        self._triggers[name].call_async(Trigger.Request()).add_done_callback(answered)

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
            if status["message"] == FITTING:
                self._show(FITTING)
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
        self._under_way = False
        if message.level[0] >= ERROR:
            self._status = {}
            self._fail(f"not calibrated: {message.message}")
            return
        self._requested = False
        values = {item.key: item.value for item in message.values}
        self._say(message.message)
        self._say(f"computed in {values['computing_s']} s and live in the model node")
        if "file" not in values:
            self._fail(f"live until the model node ends, but {values.get('not_kept', 'not kept')}")
            return
        taken = time.monotonic() - self._began
        self._say(f"written: {values['file']} ({taken:.0f} s in all)")
        self._call("protocol/close", self._end)

    def _end(self, message: str) -> None:
        raise KeyboardInterrupt  # Done: end as after Ctrl-C.

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
        self._failure = self._failure or InputError(text[:1].lower() + text[1:].rstrip("."))

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
