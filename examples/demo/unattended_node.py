"""Node in the operator's place: waits for the suite, tares, starts the study and follows it.

Each event is one line of JSON on standard output, for the program that started the node. Exit code
0 when the study is finished, 2 with one sentence when it cannot be.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any

import rclpy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger

from finger_common.errors import FingerError
from finger_common.node import STATE_QOS, ManagedNode, main_of
from finger_common.settings import Settings, setting
from finger_msgs.msg import ContactArea, ContactState, SessionStatus
from finger_operator.status_message import status_of


@dataclass(frozen=True)
class UnattendedSettings(Settings):
    """Parameters of the node."""

    suite_timeout: float = setting(
        300.0, "Longest wait for all topics and services.", "s", 1.0, 600.0
    )
    trial_timeout: float = setting(
        60.0, "Longest time without any progress of the study.", "s", 5.0, 3600.0
    )
    max_failures: int = setting(
        5, "Number of failed attempts above which the study is given up.", minimum=0
    )


STREAMS = {
    "wrench": WrenchStamped,
    "camera_info": CameraInfo,
    "contact_area": ContactArea,
    "contact_state": ContactState,
}
"""Topics that must carry messages before the study starts."""

STEP_KEYS = ("step", "index", "attempt", "condition", "folder", "waiting_for")

SERVICES = ("force/tare", "protocol/start")


class UnattendedNode(ManagedNode):
    """Starts and follows the protocol node's study."""

    SETTINGS = (UnattendedSettings,)
    NAME = "unattended"

    def configure(self) -> None:
        self._alive: set[str] = set()
        self._reported: dict[int, tuple[str, int]] = {}
        self._step: dict[str, Any] = {}
        self._failures = 0
        self._finished = False

    def activate(self) -> None:
        self._since = time.monotonic()
        qos = self.stream_qos()
        self._listeners = {
            topic: self.create_stream_subscription(kind, topic, self._marking(topic), qos)
            for topic, kind in STREAMS.items()
        }
        self._clients_by_name = {name: self.create_client(Trigger, name) for name in SERVICES}
        self.create_subscription(SessionStatus, "protocol/status", self._on_status, STATE_QOS)
        self._emit("waiting")
        self._timer = self.create_timer(0.1, self._await_suite)

    # Start -------------------------------------------------------------------------------------

    def _marking(self, topic: str) -> Any:
        def callback(message: Any) -> None:
            self._alive.add(topic)

        return callback

    def _await_suite(self) -> None:
        missing = [f"topic '{topic}'" for topic in STREAMS if topic not in self._alive]
        missing += [
            f"service '{name}'"
            for name, client in self._clients_by_name.items()
            if not client.service_is_ready()
        ]
        waited = time.monotonic() - self._since
        if missing:
            if waited > self.values["suite_timeout"]:
                raise FingerError(
                    f"the suite is not complete after {waited:.0f} s: no {', no '.join(missing)}; "
                    "see the nodes' output"
                )
            return
        self.destroy_timer(self._timer)
        for subscription in self._listeners.values():
            self.destroy_subscription(subscription)
        self._emit("ready", waited=round(waited, 2))
        self._call("force/tare", "tared", lambda: self._call("protocol/start", "begun", None))
        self._since = time.monotonic()
        self._timer = self.create_timer(0.5, self._watch)

    def _call(self, service: str, event: str, following: Any) -> None:
        def answered(future: Any) -> None:
            answer = future.result()
            if not answer.success:
                raise FingerError(f"{service} was refused: {answer.message}")
            self._emit(event, message=answer.message)
            if following is not None:
                following()

        self._clients_by_name[service].call_async(Trigger.Request()).add_done_callback(answered)

    # Study -------------------------------------------------------------------------------------

    def _on_status(self, message: SessionStatus) -> None:
        status = status_of(message)
        if "trials" not in status or self._finished:
            return
        self._since = time.monotonic()
        step = {key: status[key] for key in STEP_KEYS}
        if step != self._step:
            self._step = step
            self._emit("step", **step)
        for trial in status["trials"]:
            state = (trial["verdict"], trial["attempts"] if trial["reason"] else 0)
            if state != self._reported.get(trial["index"], ("pending", 0)):
                self._reported[trial["index"]] = state
                self._emit("trial", **trial)
                if trial["reason"]:
                    self._failures += 1
        if self._failures > self.values["max_failures"]:
            raise FingerError(
                f"{self._failures} attempts failed, the last because: "
                f"{status['message'] or state[0]}; check the devices"
            )
        if status["paused"]:
            raise FingerError(f"the study was paused: {status['message'] or 'by an operator'}")
        if status["step"] == "finished":
            self._finished = True
            self._emit("finished", folder=status["folder"])
            rclpy.try_shutdown(context=self.context)

    def _watch(self) -> None:
        waited = time.monotonic() - self._since
        if waited > self.values["trial_timeout"]:
            raise FingerError(f"no progress of the study for {waited:.0f} s; see the nodes' output")

    @staticmethod
    def _emit(event: str, **facts: Any) -> None:
        print(json.dumps({"event": event, "time": time.time(), **facts}), flush=True)


main = main_of(UnattendedNode)

if __name__ == "__main__":
    main()
