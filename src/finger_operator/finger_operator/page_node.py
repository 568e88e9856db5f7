# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that serves the operator's page.

It shows the streams and states of the suite, and turns the page's commands into service calls to
the protocol, the force driver and the moisture driver.
"""

from __future__ import annotations

import asyncio
import math
import queue
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

from finger_bag.cdr_layout import stamp_of_cdr
from finger_common.diagnostics import Health, node_within
from finger_common.node import (
    LATCHED_QOS,
    POLLED_DEPTH,
    ManagedNode,
    main_of,
)
from finger_common.stamps import NANOSECONDS, header_stamp, seconds
from finger_common.trial_phases import TrialPhase
from finger_msgs.msg import ContactArea, ContactState, Moisture, SessionStatus, Trial
from finger_msgs.srv import SetMoisture

from .normal_force import NormalForce
from .page.access import is_loopback
from .page.commands import COMMANDS, stale
from .page.feed import (
    ESTIMATE,
    CurveMemory,
    ForceMemory,
    HealthBoard,
    estimate_point,
    measured_point,
)
from .page.readiness import Readiness, refusal
from .page.server import PageServer
from .page.settings import PageSettings
from .status_message import status_of

POLL = 0.04
"""s between readings of force samples and estimates."""

ALIVE = 0.2
"""s between messages that say which values are fresh and what is wrong."""

Answer = Future[tuple[bool, str]]
"""Success and a sentence, for the browser that gave a command."""


def picture(message: Image) -> np.ndarray | None:
    """Image (H, W) or (H, W, 3) in OpenCV's order of colours; None for an unknown encoding."""
    channels = {"mono8": 1, "rgb8": 3, "bgr8": 3}.get(message.encoding)
    if channels is None or message.height * message.step != len(message.data):
        return None
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    rows = rows[:, : message.width * channels]
    if channels == 1:
        return rows
    image = rows.reshape(message.height, message.width, 3)
    return image[:, :, ::-1] if message.encoding == "rgb8" else image


class PageNode(ManagedNode):
    """Serves the page while active."""

    SETTINGS = (PageSettings,)
    NAME = "page"

    def configure(self) -> None:
        # The server's thread must not wait 5 ms for the thread that reads the force samples.
        sys.setswitchinterval(0.001)
        settings = self.settings(PageSettings)
        self._health = Health("page")
        self.healths = [self._health]
        self._normal_force = NormalForce(settings.normal_axis)
        self._jobs: queue.SimpleQueue[tuple[str, dict[str, Any], Answer]] = queue.SimpleQueue()
        self._job_waits = self.create_guard_condition(self._serve_jobs)
        self._server = PageServer(settings, self._command, self.sample_time)
        self._triggers: dict[str, Any] = {}
        self._parameters_client = self.create_client(SetParameters, "protocol/set_parameters")
        self._moisture_client = self.create_client(SetMoisture, "moisture/set_moisture")
        for name in COMMANDS.keys() - {"tare", "moisture", "configure", "curves"}:
            self._triggers[name] = self.create_client(Trigger, f"protocol/{name}")
        self._triggers["tare"] = self.create_client(Trigger, "force/tare")

    def activate(self) -> None:
        self._memory = ForceMemory()
        self._curves = CurveMemory()
        self._preparing: tuple[int, str, dict[str, Any]] | None = None
        self._board = HealthBoard(self.get_namespace())
        self._readiness = Readiness()
        self._status: dict[str, Any] = {"step": "closed"}
        self._last_force = self._last_state = 0
        self._image_subscription: Any = None
        self._painter = ThreadPoolExecutor(1, "pictures")
        self._painted: Future[None] | None = None
        self._server.start()
        self.get_logger().info(f"operator's page: {self._server.url}")
        other = "through a forwarded port: http://localhost:PORT"
        if not is_loopback(self.values["host"]):
            other = f"from other machines: http://ADDRESS:{self._server.port}"
        self.get_logger().info(f"the page {other}/?token={self._server.token}")
        self._health.notes["address"] = self._server.url
        qos = self.stream_qos()
        deep = self.stream_qos(max(self.values["qos_depth"], POLLED_DEPTH))
        # An executor round for each sample of two 500 Hz streams would delay the cue.
        self._wrench = self.create_polled_subscription(WrenchStamped, "wrench", deep)
        self._state = self.create_polled_subscription(ContactState, "contact_state", deep)
        self._inputs = [
            self.create_stream_subscription(ContactArea, "contact_area", self._on_area, qos),
            self.create_stream_subscription(Moisture, "moisture", self._on_moisture, qos),
            self.create_subscription(Trial, "trial", self._on_trial, LATCHED_QOS),
            self.create_subscription(
                SessionStatus, "protocol/status", self._on_status, LATCHED_QOS
            ),
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50),
            self.create_subscription(String, "heartbeat", self._on_heartbeat, 50),
        ]
        self._alive_timer = self.create_steady_timer(ALIVE, self._alive)
        self._poll_timer = self.create_steady_timer(POLL, self._poll)
        self._slow_timer = self.create_steady_timer(0.5, self._slow)

    def deactivate(self) -> None:
        for timer in (self._poll_timer, self._slow_timer, self._alive_timer):
            self.destroy_timer(timer)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        for polled in (self._wrench, self._state):
            polled.destroy()
        self._watch_images(False)
        self._painter.shutdown()
        self._server.stop()

    def cleanup(self) -> None:
        if hasattr(self, "_server"):
            self._server.stop()
        if hasattr(self, "_job_waits"):
            self.destroy_guard_condition(self._job_waits)
            for client in (
                self._parameters_client,
                self._moisture_client,
                *self._triggers.values(),
            ):
                self.destroy_client(client)
            del self._job_waits

    # What is shown ---------------------------------------------------------------------------

    def _poll(self) -> None:
        period = NANOSECONDS / self.values["display_rate"]
        for data, _ in self._wrench.take():
            stamp = stamp_of_cdr(data)
            if not 0 <= stamp - self._last_force < period:
                self._last_force = stamp
                self._show_force(stamp, deserialize_message(data, WrenchStamped))
        for data, _ in self._state.take():
            stamp = stamp_of_cdr(data)
            if not 0 <= stamp - self._last_state < 4 * period:
                self._last_state = stamp
                self._show_state(deserialize_message(data, ContactState))

    def _show_force(self, stamp: int, message: WrenchStamped) -> None:
        force = self._normal_force(message)
        self._memory.add(stamp, force)
        if math.isfinite(force):
            self._readiness.sample("force", time.monotonic())
            self._draw("force", [round(seconds(stamp), 3), round(force, 4)])
        self._health.sample()

    def _show_state(self, message: ContactState) -> None:
        self._readiness.sample("model", time.monotonic())
        # Of a force without a zero the model makes a contact that is not there.
        if message.in_contact and self._readiness.tared is not False:
            values = [getattr(message, name) for name in ESTIMATE]
            self._draw("model", estimate_point(header_stamp(message), message.normal_force, values))

    def _draw(self, kind: str, point: list[Any] | None) -> None:
        if point is not None:
            self._curves.add(kind, point)
            self._server.publish_point(kind, point)

    def _on_area(self, message: ContactArea) -> None:
        self._poll()
        self._readiness.sample("area", time.monotonic())
        stamp = header_stamp(message)
        point = measured_point(self._memory, stamp, message.gross_area, message.flags)
        self._draw("measured", point)
        contact = {"area": round(message.gross_area * 1e6, 2), "flags": message.flags}
        self._server.publish("contact", contact)

    def _on_moisture(self, message: Moisture) -> None:
        self._server.publish("moisture", {"value": message.value, "flags": message.flags})

    def _on_trial(self, message: Trial) -> None:
        phase = TrialPhase(message.phase)
        began = seconds(header_stamp(message))
        cue = {
            "phase": phase.name.lower(),
            "index": message.index,
            "time": began,
        }
        self._preparing = None
        if phase is TrialPhase.PREPARE:
            cue["preparation"] = self._preparation(message.condition)
            self._preparing = (header_stamp(message), message.condition, cue)
        self._server.publish_cue(header_stamp(message), cue)
        if phase is TrialPhase.PRESS:
            self._curves.press_begins(message.index, began)
        elif phase not in (TrialPhase.PULL, TrialPhase.LIFT):
            self._curves.press_ends(began)

    def _preparation(self, condition: str) -> str:
        """Of the finger, for the participant too."""
        return str(self._status.get("preparations", {}).get(condition, ""))

    def _on_heartbeat(self, message: String) -> None:
        self._readiness.beat(message.data, time.monotonic())

    def _alive(self) -> None:
        """Which values are fresh, and what is wrong: a browser that misses this has lost us."""
        now = time.monotonic()
        ages = {kind: self._readiness.age(kind, now) for kind in ("force", "area", "model")}
        problems = [vars(problem) for problem in self._readiness.problems(now)]
        self._server.hold_cue(any(problem["source"] == "protocol" for problem in problems))
        self._server.publish(
            "alive",
            {
                "time": round(seconds(self.sample_time()), 3),
                "ages": ages,
                "tared": self._readiness.tared,
                "problems": problems,
            },
        )

    def _on_status(self, message: SessionStatus) -> None:
        self._status = status_of(message)
        self._server.publish("status", self._status)
        if self._preparing is not None:
            # A new session's texts come after its first cue, and may be edited.
            stamp, condition, cue = self._preparing
            text = self._preparation(condition)
            if text != cue["preparation"]:
                self._preparing = stamp, condition, {**cue, "preparation": text}
                self._server.publish_cue(*self._preparing[::2])

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            node = node_within(status.name, self.get_namespace())
            if node is None:
                continue
            values = {v.key: v.value for v in status.values}
            level = status.level[0]
            self._board.add(now, status.name, level, status.message, values)
            self._readiness.report(node, status.name, level, status.message, values, now)

    def _slow(self) -> None:
        for polled in (self._wrench, self._state):
            self.check_mismatch(polled)
        now = time.monotonic()
        items = self._board.snapshot(now, self._readiness.dead(now))
        self._server.publish("health", {"items": items})
        self._watch_images(self._server.watchers > 0)
        latencies = self._server.latencies
        if latencies:
            self._health.notes["cue_latency_ms"] = f"{latencies[-1] * 1e3:.0f}"

    def _watch_images(self, wanted: bool) -> None:
        # The overlay is made only while a browser shows it.
        if wanted and self._image_subscription is None:
            self._image_subscription = self.create_stream_subscription(
                Image, "contact_image", self._on_image, self.stream_qos(1)
            )
        elif not wanted and self._image_subscription is not None:
            self.destroy_subscription(self._image_subscription)
            self._image_subscription = None

    def _on_image(self, message: Image) -> None:
        # Compressed in a thread of its own, which a cue need not wait for; one at a time.
        if self._painted is not None:
            if not self._painted.done():
                return
            self._painted.result()
        self._painted = self._painter.submit(self._paint, message)

    def _paint(self, message: Image) -> None:
        image = picture(message)
        if image is None:
            self._health.count("images_not_shown")
            return
        width = self.values["image_width"]
        if image.shape[1] > width:
            size = (width, max(round(image.shape[0] * width / image.shape[1]), 1))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        options = [cv2.IMWRITE_JPEG_QUALITY, self.values["jpeg_quality"]]
        good, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(image), options)
        if good:
            self._server.publish_image(jpeg.tobytes(), header_stamp(message))

    # Commands --------------------------------------------------------------------------------

    async def _command(self, name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
        """Runs in the server's thread; the node's own thread does the work."""
        future: Answer = Future()
        self._jobs.put((name, arguments, future))
        self._job_waits.trigger()
        return await asyncio.wrap_future(future)

    def _serve_jobs(self) -> None:
        while True:
            try:
                name, arguments, future = self._jobs.get_nowait()
            except queue.Empty:
                return
            self._begin(name, arguments, future)

    def _begin(self, name: str, arguments: dict[str, Any], future: Answer) -> None:
        step = self._status.get("step")
        reason = stale(arguments, self._status)
        if reason:
            future.set_result((False, f"{name}: not done, {reason} meanwhile; look, and try again"))
            return
        # A calibration's presses begin without a key.
        begins = name == "start" and step == "prepare" and not self._status.get("paused")
        if begins or name == "calibrate":
            reason = refusal(self._readiness.problems(time.monotonic()))
            if reason:
                future.set_result((False, reason))
                return
        if name == "curves":
            self._server.publish("curves", self._curves.snapshot())
            future.set_result((True, ""))
        elif name == "moisture":
            phase = {
                "moisture_before": Moisture.PHASE_BEFORE,
                "moisture_after": Moisture.PHASE_AFTER,
            }.get(str(step), Moisture.PHASE_UNKNOWN)
            request = SetMoisture.Request(value=arguments["value"], phase=phase)
            self._call(self._moisture_client, request, future, "the moisture node is not running")
        elif name == "configure":
            self._set_parameters(arguments, future)
        elif name == "preparation":
            line = f"{arguments['condition']}: {' '.join(arguments['text'].split())}"
            self._set_then_trigger("preparation", {"preparation": line}, future)
        elif name == "repeat":
            self._set_then_trigger("repeat", {"selected_trial": arguments["index"]}, future)
        elif name == "note":
            note = {"note": arguments["text"], "note_trial": arguments["trial"] - 1}
            self._set_then_trigger("note", note, future)
        else:
            self._trigger(name, future)

    def _trigger(self, name: str, future: Answer) -> None:
        who = "force driver" if name == "tare" else "protocol node"
        if name == "tare":
            future.add_done_callback(self._on_tared)
        self._call(self._triggers[name], Trigger.Request(), future, f"the {who} is not running")

    def _on_tared(self, done: Answer) -> None:
        """Curves of the former zero are gone for all browsers."""
        good, _ = done.result()
        if good:
            self._curves = CurveMemory()
            self._server.publish("curves", self._curves.snapshot())

    def _set_then_trigger(self, name: str, values: dict[str, Any], future: Answer) -> None:
        selected: Answer = Future()

        def then(done: Answer) -> None:
            good, reason = done.result()
            self._trigger(name, future) if good else future.set_result((False, reason))

        selected.add_done_callback(then)
        self._set_parameters(values, selected)

    def _set_parameters(self, values: dict[str, Any], future: Answer) -> None:
        request = SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )
        absent = "the protocol node is not running"
        self._call(self._parameters_client, request, future, absent)

    def _call(self, client: Any, request: Any, future: Answer, absent: str) -> None:
        if not client.service_is_ready():
            future.set_result((False, absent))
            return

        def answered(done: Any) -> None:
            if future.done():
                return
            response = done.result()
            if isinstance(response, SetParameters.Response):
                refused = [r.reason for r in response.results if not r.successful]
                future.set_result((not refused, refused[0] if refused else ""))
            else:
                future.set_result((response.success, response.message))

        client.call_async(request).add_done_callback(answered)


main = main_of(PageNode)

if __name__ == "__main__":
    main()
