"""Node that serves the operator's page: thin shell over `page.server` and `page.feed`.

Listens to the suite, shows it, and turns the page's commands into services of the protocol, the force driver and the
moisture driver.
"""

from __future__ import annotations

import asyncio
import json
import queue
import sys
import time
from concurrent.futures import Future
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

from finger_bag.cdr_layout import stamp_of_cdr
from finger_common.diagnostics import Health
from finger_common.node import (
    LATCHED_QOS,
    POLLED_DEPTH,
    ManagedNode,
    PolledSubscription,
    main_of,
)
from finger_common.parameters import Parameter, ParameterTable
from finger_msgs.msg import ContactArea, ContactState, Moisture, Trial
from finger_msgs.srv import SetMoisture

from .page.feed import ForceMemory, HealthBoard, measured_point, model_point
from .page.server import PageServer, PageSettings, is_loopback

PARAMETERS = ParameterTable(
    Parameter(
        "host",
        "127.0.0.1",
        "Address to serve on; 0.0.0.0 for all networks of this machine.",
        advice="For a tablet set 0.0.0.0 and open the address with the token from the log.",
    ),
    Parameter(
        "port",
        8080,
        "TCP port of the page; 0 takes a free one and logs it.",
        minimum=0,
        maximum=65535,
    ),
    Parameter(
        "token",
        "",
        "Secret that commands must carry; empty: a new one at each start, shown in the log.",
        advice="Set one to keep a tablet's bookmark valid; other people on the network must not know it.",
    ),
    Parameter(
        "share_images",
        False,
        "Send live images beyond this machine. Prints are biometric data.",
    ),
    Parameter(
        "allowed_hosts",
        [""],
        "Further host names under which the page may be opened (a reverse proxy's, say).",
    ),
    Parameter(
        "normal_axis",
        "-z",
        "Sensor axis along which the force is positive under a press; the model's parameter of the same name.",
        choices=("+x", "-x", "+y", "-y", "+z", "-z"),
        advice="If the curve goes down under a press, try the opposite sign.",
    ),
    Parameter(
        "display_rate",
        100.0,
        "Force samples a second that the page shows; a quarter as many of the model's areas.",
        "Hz",
        5.0,
        1000.0,
        advice="Lower it when the page node needs too much of the processor.",
    ),
    Parameter("image_width", 640, "Width of the live image.", "pixel", 64, 4096, runtime=True),
    Parameter("jpeg_quality", 80, "Quality of the live image.", "", 10, 100, runtime=True),
)


POLL = 0.04
"""s between looks for force samples and estimates."""


def stamp_of(header: Any) -> int:
    """Stamp of a header in ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def picture(message: Image) -> np.ndarray | None:
    """Image (H, W) or (H, W, 3) in OpenCV's order of colours; None for an encoding the page does not show."""
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

    TABLE = PARAMETERS
    NAME = "page"

    def configure(self) -> None:
        # The server's thread must not wait 5 ms for each turn of the thread that takes the force samples.
        sys.setswitchinterval(0.001)
        values = self.values
        self._health = Health("page")
        self.healths = [self._health]
        axis = values["normal_axis"]
        self._axis, self._sign = axis[1], -1.0 if axis[0] == "-" else 1.0
        self._jobs: queue.SimpleQueue[tuple[str, dict[str, Any], Future[tuple[bool, str]]]] = (
            queue.SimpleQueue()
        )
        self._job_waits = self.create_guard_condition(self._serve_jobs)
        self._server = PageServer(
            PageSettings(
                host=values["host"],
                port=values["port"],
                token=values["token"],
                share_images=values["share_images"],
                allowed_hosts=tuple(name for name in values["allowed_hosts"] if name),
            ),
            self._command,
        )
        self._triggers: dict[str, Any] = {}
        self._parameters_client = self.create_client(SetParameters, "protocol/set_parameters")
        self._moisture_client = self.create_client(SetMoisture, "moisture/set_moisture")
        for name in ("start", "pause", "resume", "redo", "repeat", "skip", "close"):
            self._triggers[name] = self.create_client(Trigger, f"protocol/{name}")
        self._triggers["tare"] = self.create_client(Trigger, "force/tare")

    def activate(self) -> None:
        self._memory = ForceMemory()
        self._board = HealthBoard()
        self._status: dict[str, Any] = {"step": "closed"}
        self._last_force = self._last_state = 0
        self._image_subscription: Any = None
        self._server.start()
        local = is_loopback(self.values["host"])
        address = self._server.url if local else f"{self._server.url}?token={self._server.token}"
        self.get_logger().info(f"operator's page: {address}")
        self._health.notes["address"] = self._server.url
        qos = self.stream_qos()
        deep = self.stream_qos(max(self.values["qos_depth"], POLLED_DEPTH))
        # Two streams of 500 Hz would leave the cue waiting for the processor if the executor went round for each sample.
        self._wrench = PolledSubscription(self, WrenchStamped, "wrench", deep)
        self._state = PolledSubscription(self, ContactState, "contact_state", deep)
        self._inputs = [
            self.create_stream_subscription(ContactArea, "contact_area", self._on_area, qos),
            self.create_stream_subscription(Moisture, "moisture", self._on_moisture, qos),
            self.create_subscription(Trial, "trial", self._on_trial, LATCHED_QOS),
            self.create_subscription(String, "protocol/status", self._on_status, LATCHED_QOS),
            self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50),
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._poll_timer = self.create_timer(POLL, self._poll, clock=steady)
        self._slow_timer = self.create_timer(0.5, self._slow, clock=steady)

    def deactivate(self) -> None:
        for timer in (self._poll_timer, self._slow_timer):
            self.destroy_timer(timer)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        for polled in (self._wrench, self._state):
            polled.destroy()
        self._watch_images(False)
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
        period = 1e9 / self.values["display_rate"]
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
        force = self._sign * getattr(message.wrench.force, self._axis)
        self._memory.add(stamp, force)
        if force == force:
            self._server.publish_force(stamp * 1e-9, force)
        self._health.sample()

    def _show_state(self, message: ContactState) -> None:
        point = (
            model_point(message.normal_force, message.model_area) if message.in_contact else None
        )
        if point:
            self._server.publish_point("model", point)

    def _on_area(self, message: ContactArea) -> None:
        self._poll()
        point = measured_point(
            self._memory, stamp_of(message.header), message.gross_area, message.flags
        )
        if point:
            self._server.publish_point("measured", point)
        self._server.publish("contact", {"area": round(message.gross_area * 1e6, 2)})

    def _on_moisture(self, message: Moisture) -> None:
        self._server.publish("moisture", {"value": message.value, "flags": message.flags})

    def _on_trial(self, message: Trial) -> None:
        self._server.publish_cue(
            stamp_of(message.header),
            {"phase": message.phase, "index": message.index, "note": message.note},
        )

    def _on_status(self, message: String) -> None:
        self._status = json.loads(message.data)
        self._server.publish("status", self._status)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            self._board.add(now, status.name, status.level[0], status.message, values)

    def _slow(self) -> None:
        for polled in (self._wrench, self._state):
            self.look_for_mismatch(polled)
        self._server.publish("health", {"items": self._board.snapshot(time.monotonic())})
        self._watch_images(self._server.watchers > 0)
        latencies = self._server.latencies
        if latencies:
            self._health.notes["cue_latency_ms"] = f"{latencies[-1] * 1e3:.0f}"

    def _watch_images(self, wanted: bool) -> None:
        # The overlay is made only while somebody looks.
        if wanted and self._image_subscription is None:
            self._image_subscription = self.create_stream_subscription(
                Image, "contact_image", self._on_image, self.stream_qos(1)
            )
        elif not wanted and self._image_subscription is not None:
            self.destroy_subscription(self._image_subscription)
            self._image_subscription = None

    def _on_image(self, message: Image) -> None:
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
            self._server.publish_image(jpeg.tobytes(), stamp_of(message.header))

    # Commands --------------------------------------------------------------------------------

    async def _command(self, name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
        """Runs in the server's thread; the node's own thread does the work."""
        future: Future[tuple[bool, str]] = Future()
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

    def _begin(
        self, name: str, arguments: dict[str, Any], future: Future[tuple[bool, str]]
    ) -> None:
        if name == "moisture":
            step = self._status.get("step")
            phase = {
                "moisture_before": Moisture.PHASE_BEFORE,
                "moisture_after": Moisture.PHASE_AFTER,
            }.get(str(step), Moisture.PHASE_UNKNOWN)
            request = SetMoisture.Request(value=arguments["value"], phase=phase)
            self._call(self._moisture_client, request, future, "the moisture node is not running")
        elif name == "configure":
            self._set_parameters(arguments, future)
        elif name == "preparation":
            texts = {
                **self._status.get("preparations", {}),
                arguments["condition"]: arguments["text"],
            }
            lines = [f"{condition}: {' '.join(text.split())}" for condition, text in texts.items()]
            self._set_parameters({"preparations": lines}, future)
        elif name == "repeat":
            selected: Future[tuple[bool, str]] = Future()

            def then(done: Future[tuple[bool, str]]) -> None:
                good, reason = done.result()
                self._trigger("repeat", future) if good else future.set_result((False, reason))

            selected.add_done_callback(then)
            self._set_parameters({"selected_trial": arguments["index"]}, selected)
        else:
            self._trigger(name, future)

    def _trigger(self, name: str, future: Future[tuple[bool, str]]) -> None:
        who = "force driver" if name == "tare" else "protocol node"
        self._call(self._triggers[name], Trigger.Request(), future, f"the {who} is not running")

    def _set_parameters(self, values: dict[str, Any], future: Future[tuple[bool, str]]) -> None:
        request = SetParameters.Request(
            parameters=[
                ParameterMessage(name=k, value=parameter_value(v)) for k, v in values.items()
            ]
        )
        absent = "the protocol node is not running"
        self._call(self._parameters_client, request, future, absent)

    def _call(
        self, client: Any, request: Any, future: Future[tuple[bool, str]], absent: str
    ) -> None:
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


def parameter_value(value: Any) -> ParameterValue:
    """A value as a parameter message."""
    if isinstance(value, float):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    if isinstance(value, int):
        return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    if isinstance(value, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    return ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=list(value))


main = main_of(PageNode)

if __name__ == "__main__":
    main()
