"""Node in the operator's place: waits for the suite, tares, starts the study and follows it to its end.

For simulated participants, sample bags and tests. Each event is one line of JSON on standard output, for programs
that watch it. Exit code 0 when the study is finished, 2 with one sentence when it cannot be.
"""

from __future__ import annotations

import json
import time
from typing import Any

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import String
from std_srvs.srv import Trigger

from finger_common.errors import FingerError
from finger_common.node import ManagedNode, main_of
from finger_common.parameters import Parameter, ParameterTable
from finger_msgs.msg import ContactArea, ContactState

PARAMETERS = ParameterTable(
    Parameter(
        "suite_timeout",
        90.0,
        "Longest wait for all topics and services.",
        unit="s",
        minimum=1.0,
        maximum=600.0,
    ),
    Parameter(
        "trial_timeout",
        60.0,
        "Longest time without any progress of the study.",
        unit="s",
        minimum=5.0,
        maximum=3600.0,
    ),
    Parameter("max_failures", 5, "Failed attempts after which the study is given up.", minimum=0),
)

STREAMS = {
    "wrench": WrenchStamped,
    "camera_info": CameraInfo,
    "contact_area": ContactArea,
    "contact_state": ContactState,
}
"""Topics that must be alive before the study starts."""

STEP_KEYS = ("step", "index", "attempt", "condition", "folder", "waiting_for")

SERVICES = ("force/tare", "protocol/start")


class UnattendedNode(ManagedNode):
    """Starts and follows the protocol node's study."""

    TABLE = PARAMETERS
    NAME = "unattended"

    def configure(self) -> None:
        self._alive: set[str] = set()
        self._told: dict[int, tuple[str, int]] = {}
        self._step: dict[str, Any] = {}
        self._failures = 0
        self._finished = False

    def activate(self) -> None:
        self._since = time.monotonic()
        qos = self.stream_qos()
        self._listeners = {
            topic: self.create_stream_subscription(kind, topic, self._noting(topic), qos)
            for topic, kind in STREAMS.items()
        }
        self._clients_by_name = {name: self.create_client(Trigger, name) for name in SERVICES}
        latched = QoSProfile(
            depth=1,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        self.create_subscription(String, "protocol/status", self._on_status, latched)
        self._emit("waiting")
        self._timer = self.create_timer(0.1, self._await_suite)

    # Start -------------------------------------------------------------------------------------

    def _noting(self, topic: str) -> Any:
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

    def _on_status(self, message: String) -> None:
        status = json.loads(message.data)
        if "trials" not in status or self._finished:
            return
        self._since = time.monotonic()
        step = {key: status[key] for key in STEP_KEYS}
        if step != self._step:
            self._step = step
            self._emit("step", **step)
        for trial in status["trials"]:
            said = (trial["verdict"], trial["attempts"] if trial["reason"] else 0)
            if said != self._told.get(trial["index"], ("pending", 0)):
                self._told[trial["index"]] = said
                self._emit("trial", **trial)
                if trial["reason"]:
                    self._failures += 1
        if self._failures > self.values["max_failures"]:
            raise FingerError(
                f"{self._failures} attempts failed, the last because: {status['message'] or said[0]}; "
                "check the devices"
            )
        if status["paused"]:
            raise FingerError(f"the study was paused: {status['message'] or 'by somebody'}")
        if status["step"] == "finished":
            self._finished = True
            self._emit("finished", folder=status["folder"])
            rclpy.try_shutdown(context=self.context)

    def _watch(self) -> None:
        waited = time.monotonic() - self._since
        if waited > self.values["trial_timeout"]:
            raise FingerError(f"the study stands still for {waited:.0f} s; see the nodes' output")

    @staticmethod
    def _emit(event: str, **facts: Any) -> None:
        print(json.dumps({"event": event, "time": time.time(), **facts}), flush=True)


main = main_of(UnattendedNode)

if __name__ == "__main__":
    main()
