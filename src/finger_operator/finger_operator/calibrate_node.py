# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node of `finger-rig calibrate`: tares, starts a subject's calibration, guides, shows the result.

Exit code 0: calibrated; 2 with one sentence: refused or failed. Ended before, it aborts the
session: nothing is written.
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
from finger_common.node import LATCHED_QOS, STATE_QOS, ManagedNode, main_of
from finger_common.settings import Settings, setting
from finger_msgs.msg import ContactArea, ContactState, SessionStatus

from .status_message import status_of

PERIOD = 0.1
"""s between looks at what has come."""

NO_PROGRESS = 120.0
"""s without any progress, after which the calibration is given up."""

STREAMS = {
    "wrench": (WrenchStamped, "the force sensor is silent"),
    "contact_area": (ContactArea, "no contact area comes from the camera"),
    "contact_state": (ContactState, "the model node gives no estimate"),
}
"""What must come before a calibration can begin, and what to say otherwise."""

TRIGGERS = ("force/tare", "protocol/calibrate", "protocol/abort", "protocol/close")


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


class CalibrateNode(ManagedNode):
    """Follows one calibration of the protocol node."""

    SETTINGS = (CalibrateSettings,)
    NAME = "calibrate"

    def configure(self) -> None:
        self.healths = [Health("calibrate")]
        self._settings = self.settings(CalibrateSettings)
        self._failure: FingerError | None = None
        self._seen: set[str] = set()
        self._shown = ""
        self._session = ""
        self._newest: SessionStatus | None = None
        self._status: dict[str, Any] = {}
        self._under_way = False

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
        if self._under_way:
            self._triggers["protocol/abort"].call_async(Trigger.Request())
            time.sleep(0.3)
            self._say("aborted; nothing was written")

    # Before ------------------------------------------------------------------------------------

    def _marking(self, topic: str) -> Callable[[Any], None]:
        def mark(message: Any) -> None:
            self._seen.add(topic)

        return mark

    def _await_rig(self) -> None:
        clients = [*self._triggers.values(), self._model, self._protocol]
        ready = all(client.service_is_ready() for client in clients)
        missing = [text for topic, (_, text) in STREAMS.items() if topic not in self._seen]
        if not ready or missing:
            if time.monotonic() - self._since > self._settings.patience:
                raise InputError(self._absence(clients, missing))
            return
        self.destroy_timer(self._timer)
        self._since = time.monotonic()
        self._timer = self.create_steady_timer(PERIOD, self._watch)
        request = GetParameters.Request(names=["subjects_folder"])
        self._model.call_async(request).add_done_callback(self._on_folder)

    def _absence(self, clients: list[Any], missing: list[str]) -> str:
        if not any(client.service_is_ready() for client in clients):
            return (
                f"no rig answers in namespace '{self.get_namespace()}'; start it with "
                "'finger-rig up', name its --namespace, or give --simulated"
            )
        if missing:
            return f"{missing[0]}; see the output of 'finger-rig up'"
        return "the rig is not complete: force, model and protocol nodes are needed"

    def _on_folder(self, future: Any) -> None:
        folder = future.result().values[0].string_value
        subject = self._settings.subject
        if not folder:
            self._fail("the model node has no 'subjects_folder' to keep the result in; set it")
        elif (path := Path(folder) / f"{subject}.yaml").exists() and not self._settings.again:
            self._fail(
                f"subject {subject} is calibrated already ({path}); give --again to replace that"
            )
        else:
            self._say("keep the plate empty: the force is tared")
            self._call("force/tare", lambda _: self._set_plan())

    def _set_plan(self) -> None:
        values = {
            "subject": self._settings.subject,
            "session": "",
            "finger_width": self._settings.finger_width,
            "finger_depth": self._settings.finger_depth,
            "finger": self._settings.finger,
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
                self._call("protocol/calibrate", self._on_begun)

        self._protocol.call_async(request).add_done_callback(answered)

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
                self._fail(response.message)

        self._triggers[name].call_async(Trigger.Request()).add_done_callback(answered)

    # During ------------------------------------------------------------------------------------

    def _on_status(self, message: SessionStatus) -> None:
        self._newest = message
        if not self._under_way:
            return
        status = status_of(message)
        if "trials" not in status:
            return
        if status != self._status:
            self._since = time.monotonic()
        self._status, self._session = status, status["session"]
        text = status["instruction"]
        if status["step"] == "clear" and status["waiting_for"]:
            text = f"Waiting: {status['waiting_for']}."
        if status["step"] == "prepare":
            text += f" Target {status['target_force']:.1f} N."
        place = f"press {status['index'] + 1} of {len(status['trials'])}"
        shown = f"{place}: {text}"
        if shown != self._shown and status["step"] not in ("closing", "finished"):
            self._shown = shown
            self._say(shown)
        if status["paused"]:
            self._fail(f"the calibration is paused: {status['message'] or 'by an operator'}")
        elif status["step"] == "finished" and status["ended"]:
            self._fail(f"the calibration was {status['ended']}")

    def _on_calibration(self, message: DiagnosticStatus) -> None:
        if not self._session or message.hardware_id != self._session:
            return
        self._under_way = False
        if message.level[0] >= ERROR:
            self._fail(message.message)
            return
        values = {item.key: item.value for item in message.values}
        self._say(message.message)
        self._say(f"computed in {values['computing_s']} s and live in the model node")
        taken = time.monotonic() - self._began
        self._say(f"written: {values['file']} ({taken:.0f} s in all)")
        self._call("protocol/close", self._end)

    def _end(self, message: str) -> None:
        raise KeyboardInterrupt  # Done: end as after Ctrl-C.

    def _watch(self) -> None:
        if self._failure is not None:
            raise self._failure
        if time.monotonic() - self._since > NO_PROGRESS:
            waiting = self._status.get("waiting_for") or self._status.get("instruction", "")
            raise InputError(f"no progress for {NO_PROGRESS:.0f} s ({waiting or 'no answer'})")

    def _fail(self, text: str) -> None:
        """End with this sentence, from the timer."""
        self._failure = self._failure or InputError(text)

    @staticmethod
    def _say(text: str) -> None:
        print(text, flush=True)


main = main_of(CalibrateNode)

if __name__ == "__main__":
    main()
