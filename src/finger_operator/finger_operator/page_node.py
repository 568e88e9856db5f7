# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that serves the operator's page.

It shows the streams and states of the suite, and turns the page's commands into service calls to
the protocol, the force driver and the moisture driver.
"""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager, nullcontext
from typing import Any, TypeVar

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

from finger_bag.cdr_layout import stamp_of_cdr
from finger_common.diagnostics import Health, node_within
from finger_common.errors import DeviceError, InputError
from finger_common.node import (
    LATCHED_QOS,
    POLLED_DEPTH,
    Jobs,
    ManagedNode,
    PolledSubscription,
    main_of,
    refusal_of,
    set_request,
)
from finger_common.stamps import NANOSECONDS, header_stamp, seconds
from finger_common.trial_phases import TrialPhase
from finger_msgs.msg import ContactArea, ContactState, Moisture, SessionStatus, Trial
from finger_msgs.srv import SetMoisture

from .normal_force import NormalForce
from .page.access import is_loopback
from .page.commands import COMMANDS, PARAMETERS, SUBJECT, readings_of, stale
from .page.feed import (
    AREA_DOUBTS,
    ESTIMATE,
    ESTIMATE_DOUBTS,
    CurveMemory,
    ForceMemory,
    HealthBoard,
    doubt,
    estimate_point,
    measured_point,
)
from .page.server import PageServer
from .page.settings import PageSettings
from .readiness import Problem, Readiness, refusal
from .status_message import status_of
from .steps import PRESSING

T = TypeVar("T")

POLL = 0.04
"""s between readings of force samples and estimates."""

ALIVE = 0.2
"""s between messages that say which values are fresh and what is wrong."""

TOLD = 1.0
"""s at most in which the protocol tells what became of a reading."""

PLANNED = "protocol/get_parameters"
"""Service that tells the plan of the next session."""

NOT_RUNNING = {
    "protocol": "the protocol node is not running",
    "force": "the force driver is not running",
    "moisture": "the moisture node is not running; start it, or skip this trial and begin a "
    "session with Readings 0",
}
"""What is answered while the node that carries out a command is not running."""


def picture(message: Image) -> np.ndarray | None:
    """Image (H, W) or (H, W, 3) in OpenCV's order of colours; None for an unknown encoding."""
    channels = {"mono8": 1, "rgb8": 3, "bgr8": 3}.get(message.encoding)
    if channels is None or message.height * message.step != len(message.data):
        return None
    rows: np.ndarray = np.frombuffer(message.data, np.uint8)
    rows = rows.reshape(message.height, message.step)
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
        namespace = self.get_namespace()
        self._server = PageServer(settings, self._command, self.sample_time, namespace)
        self.closing.callback(self._server.stop)
        kinds: dict[str, Any] = {c.service: Trigger for c in COMMANDS.values() if c.service}
        kinds |= {PARAMETERS: SetParameters, PLANNED: GetParameters}
        kinds |= {COMMANDS["moisture"].service: SetMoisture}
        self._callers = {name: self.create_client(kind, name) for name, kind in kinds.items()}

    def activate(self) -> None:
        self._jobs = Jobs(self)
        self._turn, self._turn_of_readings = asyncio.Lock(), asyncio.Lock()
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
        self._wrench = self.create_polled_subscription(
            WrenchStamped, self.values["wrench_topic"], deep
        )
        self._state = self.create_polled_subscription(ContactState, "contact_state", deep)
        self.create_stream_subscription(ContactArea, "contact_area", self._on_area, qos)
        self._moisture = self.create_stream_subscription(
            Moisture, "moisture", self._on_moisture, qos
        )
        self.create_subscription(Trial, "trial", self._on_trial, LATCHED_QOS)
        self.create_subscription(SessionStatus, "protocol/status", self._on_status, LATCHED_QOS)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.create_subscription(String, "heartbeat", self._on_heartbeat, 50)
        self.create_steady_timer(ALIVE, self._alive)
        self.create_steady_timer(POLL, self._poll)
        self.create_steady_timer(0.5, self._slow)

    def deactivate(self) -> None:
        self.destroy_active_interfaces()
        self._painter.shutdown()
        self._jobs.close()
        self._server.stop()

    # What is shown ---------------------------------------------------------------------------

    def _poll(self) -> None:
        period = NANOSECONDS / self.values["display_rate"]
        self._last_force = self._show(self._wrench, self._last_force, period, self._show_force)
        self._last_state = self._show(self._state, self._last_state, 4 * period, self._show_state)

    @staticmethod
    def _show(
        polled: PolledSubscription, last: int, period: float, show: Callable[[Any], None]
    ) -> int:
        """Show what has come, one message in each period (ns); stamp (ns) of the last one shown."""
        for raw, _ in polled.take():
            stamp = polled.read(raw, stamp_of_cdr)
            if stamp is None or 0 <= stamp - last < period:
                continue
            last = stamp
            if (message := polled.read(raw)) is not None:
                show(message)
        return last

    def _show_force(self, message: WrenchStamped) -> None:
        stamp, force = header_stamp(message), self._normal_force(message)
        self._memory.add(stamp, force)
        if math.isfinite(force):
            self._readiness.sample("force", time.monotonic())
            self._draw("force", [round(seconds(stamp), 3), round(force, 4)])
        self._health.sample()

    def _show_state(self, message: ContactState) -> None:
        self._readiness.sample("model", time.monotonic())
        estimate = {
            "contact": message.in_contact,
            "known": math.isfinite(message.area),
            "doubt": doubt(message.flags, ESTIMATE_DOUBTS),
        }
        self._server.publish("estimate", estimate)
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
        area = round(message.gross_area * 1e6, 2)
        doubtful = doubt(message.flags, AREA_DOUBTS)
        self._server.publish("contact", {"area": area, "doubt": doubtful})

    def _on_moisture(self, message: Moisture) -> None:
        came = round(seconds(self.sample_time()), 3)
        self._server.publish("moisture", {"value": round(message.value, 3), "time": came})

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
        problems = [vars(problem) for problem in self._problems(now)]
        self._server.hold_cue(any(problem["source"] == "protocol" for problem in problems))
        self._server.publish(
            "alive",
            {
                "time": round(seconds(self.sample_time()), 3),
                "ages": ages,
                "tared": self._readiness.tared,
                "problems": problems,
                "probe": self._readiness.warning("moisture"),
            },
        )

    def _problems(self, now: float) -> list[Problem]:
        """What is wrong now, by what the open session needs."""
        readings = self._status.get("readings", 0)
        # A probe of another make than the suite's has no heartbeat: its publisher is enough.
        needs_node = readings and not self.count_publishers(self._moisture.topic_name)
        return self._readiness.problems(now, ["moisture"] if needs_node else [])

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
        """Success and a sentence, for the browser that gave a command; in the server's thread."""
        if COMMANDS[name].service.startswith("protocol/"):
            # What one command sets there must not change before that one has been carried out.
            turn: AbstractAsyncContextManager[Any] = self._turn
        else:
            turn = self._turn_of_readings if name == "moisture" else nullcontext()
        async with turn:
            return await self._carry_out(name, arguments)

    async def _carry_out(self, name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
        command = COMMANDS[name]
        request = await self._in_node(lambda: self._begin(name, arguments))
        if SUBJECT in arguments:
            await self._refuse_another(arguments[SUBJECT])
        if values := command.sets(arguments):
            reason = refusal_of(await self._call(PARAMETERS, set_request(values)))
            if reason:
                return False, reason
        if command.service in ("", PARAMETERS):
            return True, command.answer(arguments, self._status)
        status = self._status
        response = await self._call(command.service, request)
        if name == "tare" and response.success:
            await self._in_node(self._forget_curves)
        message = response.message
        in_session = name == "moisture" and status["step"] != "closed"
        if in_session and response.success:
            if request.phase == Moisture.PHASE_UNKNOWN:
                return False, f"{message}; it does not count: no reading is asked for now"
            await self._await_reading(status)
        return response.success, message

    async def _await_reading(self, before: dict[str, Any]) -> None:
        """Wait until the status shows what became of a reading, but not for long: what comes next
        is compared with it."""

        def shown(status: dict[str, Any]) -> tuple[Any, ...]:
            return (status.get("step"), status.get("message"), readings_of(status))

        end = time.monotonic() + TOLD
        while shown(self._status) == shown(before) and time.monotonic() < end:
            await asyncio.sleep(0.01)

    def _begin(self, name: str, arguments: dict[str, Any]) -> Any:
        """Request of the command's service; raises InputError where it is not to be carried out.

        Takes SEEN and SEEN_READINGS out of the arguments.
        """
        step = self._status.get("step")
        if reason := stale(arguments, self._status):
            raise InputError(f"{name}: not done, {reason} meanwhile; look, and try again")
        # A calibration's presses begin without a key.
        begins = name == "start" and step == "prepare" and not self._status.get("paused")
        if begins or name == "calibrate":
            if reason := refusal(self._problems(time.monotonic())):
                raise InputError(reason)
        if name == "curves":
            self._publish_curves()
        if name == "tare" and step in PRESSING and self._readiness.tared:
            raise InputError("not tared: a press is under way; tare when it is over")
        if name == "moisture":
            phase = {
                "moisture_before": Moisture.PHASE_BEFORE,
                "moisture_after": Moisture.PHASE_AFTER,
            }.get("" if self._status.get("paused") else str(step), Moisture.PHASE_UNKNOWN)
            return SetMoisture.Request(value=arguments["value"], phase=phase)
        return Trigger.Request()

    async def _refuse_another(self, subject: str) -> None:
        """Raise InputError where the next session is of another subject than its dialog has set."""
        answer = await self._call(PLANNED, GetParameters.Request(names=["subject"]))
        planned = answer.values[0].string_value
        if planned != subject:
            raise InputError(
                f"not begun: the session would be of {planned}, which another dialog has set "
                f"meanwhile, and not of {subject}; begin again when the other one is done"
            )

    def _publish_curves(self) -> None:
        self._server.publish("curves", self._curves.snapshot())

    def _forget_curves(self) -> None:
        """Curves of the former zero are gone for all browsers."""
        self._curves = CurveMemory()
        self._publish_curves()

    def _in_node(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Do something in the node's own thread."""
        return asyncio.wrap_future(self._jobs.call(action))

    async def _call(self, service: str, request: Any) -> Any:
        """Response of a service; raises DeviceError where its node is not running."""
        client = self._callers[service]
        if not client.service_is_ready():
            raise DeviceError(NOT_RUNNING[service.partition("/")[0]])
        answer: Future[Any] = Future()

        def answered(done: Any) -> None:
            if answer.set_running_or_notify_cancel():  # else nobody waits any longer
                answer.set_result(done.result())

        client.call_async(request).add_done_callback(answered)
        return await asyncio.wrap_future(answer)


main = main_of(PageNode)

if __name__ == "__main__":
    main()
