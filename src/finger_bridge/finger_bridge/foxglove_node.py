# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that serves the live view in Foxglove, without `foxglove_bridge`.

It offers every topic, service and parameter that it sees over Foxglove's WebSocket protocol: in
Foxglove, *Open connection*, `ws://localhost:8765`. A topic is subscribed to only while a client
shows it, with the quality of service of its publishers. Needs `pip install foxglove-sdk`.
"""

from __future__ import annotations

import importlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, TypeVar

from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from finger_common.diagnostics import WARN, Health
from finger_common.errors import DeviceError, FingerError, InputError
from finger_common.interface_text import message_text, service_texts
from finger_common.node import POLLED_DEPTH, Jobs, ManagedNode, main_of

from .foxglove_server import IMAGE_TYPES, FoxgloveSettings, Interface, Server

T = TypeVar("T")

POLL = 0.02
"""s between readings of the topics that clients show."""

FOUND = 5.0
"""s within which a service that exists is found."""

ANSWER = 5.0
"""s that a node may take to answer a service call."""

PARAMETER_SERVICES = "rcl_interfaces/srv/"
"""Types of services that are offered as parameters instead."""


def interface_class(interface_type: str) -> Any:
    """Class of "package/msg/Name" or "package/srv/Name"; raises InputError when not installed."""
    package, kind, name = interface_type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError):
        raise InputError(
            f"type '{interface_type}' is not installed; source its workspace"
        ) from None


def is_hidden(name: str) -> bool:
    """Whether a topic or service is hidden by its name, such as those behind an action."""
    return "/_" in name


def split_name(name: str) -> tuple[str, str]:
    """Node and parameter of "/finger/model.fusion_delay"; raises InputError for another form."""
    node, dot, parameter = name.partition(".")
    if not (dot and node.startswith("/")):
        raise InputError(f"parameter '{name}' is not understood; give '/node.parameter'")
    return node, parameter


def parameter_message(name: str, value: Any, kind: int) -> Parameter:
    """A parameter of the type that it has on its node; a whole number may stand for a float."""
    message = Parameter(name=name, value=ParameterValue(type=kind))
    fields: dict[int, tuple[str, Any]] = {
        ParameterType.PARAMETER_BOOL: ("bool_value", bool),
        ParameterType.PARAMETER_INTEGER: ("integer_value", int),
        ParameterType.PARAMETER_DOUBLE: ("double_value", (int, float)),
        ParameterType.PARAMETER_STRING: ("string_value", str),
        ParameterType.PARAMETER_BOOL_ARRAY: ("bool_array_value", bool),
        ParameterType.PARAMETER_INTEGER_ARRAY: ("integer_array_value", int),
        ParameterType.PARAMETER_DOUBLE_ARRAY: ("double_array_value", (int, float)),
        ParameterType.PARAMETER_STRING_ARRAY: ("string_array_value", str),
    }
    if kind not in fields:
        raise InputError(f"parameter '{name}' cannot be set from Foxglove")
    field, expected = fields[kind]
    array = field.endswith("array_value")
    items = value if array and isinstance(value, list) else [value]
    fits = array == isinstance(value, list) and all(
        isinstance(item, expected) and isinstance(item, bool) == (expected is bool)
        for item in items
    )
    if not fits:
        raise InputError(f"parameter '{name}' cannot be {value!r}; its type does not fit")
    floats = isinstance(expected, tuple)
    typed = [float(item) for item in items] if floats else items
    setattr(message.value, field, typed if array else typed[0])
    return message


class Shown:
    """A topic that at least one client shows."""

    def __init__(self, node: ManagedNode, topic: str, kind: str, qos: QoSProfile) -> None:
        self.qos = qos
        latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self.last: deque[tuple[bytes, int]] = deque(maxlen=1 if latched else 0)
        """The newest message of a latched topic, for clients that come later."""
        self.subscription = node.create_polled_subscription(
            interface_class(kind), topic, qos, overridable=False
        )


class FoxgloveNode(ManagedNode):
    """Serves Foxglove while active."""

    SETTINGS = (FoxgloveSettings,)
    NAME = "foxglove"

    def configure(self) -> None:
        self._settings = self.settings(FoxgloveSettings)
        self._health = Health("foxglove")
        self.healths = [self._health]
        self._callers: dict[str, Any] = {}
        self._service_types: dict[str, str] = {}
        self._topic_types: dict[str, str] = {}
        self._shown: dict[str, Shown] = {}
        self._unknown: set[str] = set()

    def activate(self) -> None:
        self._jobs = Jobs(self)
        self._server = Server(self._settings, self)
        where = "localhost" if self._settings.is_local else self._settings.host
        address = f"ws://{where}:{self._server.port}"
        self._health.notes["address"] = address
        control = "" if self._settings.allows_control else "; services and parameters read-only"
        self.get_logger().info(f"Foxglove: open a connection to {address}{control}")
        self.create_subscription(ParameterEvent, "/parameter_events", self._on_parameter_event, 100)
        self.create_steady_timer(POLL, self._poll)
        self.create_steady_timer(1.0, self._look_around)
        self._look_around()

    def deactivate(self) -> None:
        self._jobs.close()
        self._server.stop()
        self.destroy_active_interfaces()
        self._shown.clear()
        self._callers.clear()

    # Topics and services that there are ------------------------------------------------------

    def _look_around(self) -> None:
        self._offer_topics()
        if self._settings.allows_control:
            self._offer_services()
        for topic, shown in list(self._shown.items()):
            if shown.qos != self._qos_of(topic):
                shown.subscription.destroy()
                del self._shown[topic]
        self._watch()
        self._health.notes["topics"] = str(len(self._server.topics))
        self._health.notes["topics_shown"] = str(len(self._shown))
        self._health.notes["services"] = str(len(self._server.services))

    def _offer_topics(self) -> None:
        offered = self._server.topics
        for topic, types in self.get_topic_names_and_types():
            kind = types[0]
            known = topic in offered or is_hidden(topic)
            if known or not self._settings.offers(topic, kind) or not self.count_publishers(topic):
                continue

            def offer(topic: str = topic, kind: str = kind) -> None:
                interface_class(kind)
                self._server.add_topic(topic, Interface(kind, message_text(kind)))
                self._topic_types[topic] = kind

            self._unless_unknown(topic, offer)

    def _offer_services(self) -> None:
        offered = self._server.services
        present = {
            name: types[0]
            for name, types in self.get_service_names_and_types()
            if not types[0].startswith(PARAMETER_SERVICES) and not is_hidden(name)
        }
        if gone := offered - present.keys():
            self._server.remove_services(gone)
        for name in present.keys() - offered:

            def offer(name: str = name, kind: str = present[name]) -> None:
                interface_class(kind)
                request, response = service_texts(kind)
                self._service_types[name] = kind
                self._server.add_service(
                    name,
                    kind,
                    Interface(f"{kind}_Request", request),
                    Interface(f"{kind}_Response", response),
                )

            self._unless_unknown(name, offer)

    def _unless_unknown(self, name: str, offer: Callable[[], None]) -> None:
        if name in self._unknown:
            return
        try:
            offer()
        except FingerError as error:
            self._unknown.add(name)
            self.get_logger().warning(f"'{name}' is not offered to Foxglove: {error}")

    # Messages --------------------------------------------------------------------------------

    def _qos_of(self, topic: str) -> QoSProfile:
        """What all publishers of a topic offer."""
        found = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        latched = bool(found) and all(
            qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in found
        )
        reliable = bool(found) and all(
            qos.reliability == ReliabilityPolicy.RELIABLE for qos in found
        )
        return QoSProfile(
            depth=10 if self._topic_types[topic] in IMAGE_TYPES else POLLED_DEPTH,
            history=HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
        )

    def watch(self, topic: str) -> None:
        """Clients of a topic have come or gone; in a thread of the server."""

        def look() -> None:
            for message, received in self._shown[topic].last if topic in self._shown else ():
                self._server.send(topic, message, received)
            self._watch()

        self._in_node(look)

    def _watch(self) -> None:
        wanted = self._server.watched
        for topic in self._shown.keys() - wanted:
            self._shown.pop(topic).subscription.destroy()
        for topic in wanted - self._shown.keys():
            qos = self._qos_of(topic)
            self._shown[topic] = Shown(self, topic, self._topic_types[topic], qos)

    def _poll(self) -> None:
        for topic, shown in self._shown.items():
            for message, info in shown.subscription.take():
                received = info["received_timestamp"]
                self._server.send(topic, message, received)
                shown.last.append((message, received))
                self._health.sample()
            lost = shown.subscription.newly_lost()
            if lost:
                self._health.count("lost", lost)

    # Parameters ------------------------------------------------------------------------------

    def parameters_named(self, names: list[str]) -> dict[str, Any]:
        """Values by full name; in a thread of the server."""
        return {
            name: parameter_value_to_python(value)
            for name, value in self._values(names).items()
            if value.type != ParameterType.PARAMETER_NOT_SET
        }

    def change_parameters(self, values: Mapping[str, Any]) -> list[str]:
        """Set parameters by full name; gives a sentence for each refused one."""
        refused = []
        present = self._values(list(values))
        for name, value in values.items():
            try:
                node, parameter = split_name(name)
                if name not in present:
                    raise InputError(f"parameter '{name}' does not exist")
                message = parameter_message(name, value, present[name].type)
                message.name = parameter
                request = SetParameters.Request(parameters=[message])
                result = self._ask(SetParameters, f"{node}/set_parameters", request).results[0]
                if not result.successful:
                    refused.append(f"{name}: {result.reason}")
            except FingerError as error:
                refused.append(str(error))
        return refused

    def _values(self, names: list[str]) -> dict[str, ParameterValue]:
        wanted: dict[str, list[str]] = {}
        for name in names:
            node, parameter = split_name(name)
            wanted.setdefault(node, []).append(parameter)
        if not names:
            everything = self._in_node(self.get_service_names_and_types).result(ANSWER)
            ending = "/list_parameters"
            wanted = {n.removesuffix(ending): [] for n, _ in everything if n.endswith(ending)}
        found: dict[str, ParameterValue] = {}
        for node, parameters in sorted(wanted.items()):
            try:
                listed = self._ask(
                    ListParameters, f"{node}/list_parameters", ListParameters.Request()
                )
                # One name that does not exist would leave all of them without an answer.
                known = sorted(listed.result.names)
                parameters = [p for p in parameters if p in known] if parameters else known
                request = GetParameters.Request(names=parameters)
                answer = self._ask(GetParameters, f"{node}/get_parameters", request)
            except DeviceError:
                if names:
                    raise
                continue  # one node that hangs must not hide the parameters of the others
            found.update(
                (f"{node}.{name}", value) for name, value in zip(parameters, answer.values)
            )
        return found

    def _on_parameter_event(self, event: ParameterEvent) -> None:
        self._server.parameters_changed(
            {
                f"{event.node}.{parameter.name}": parameter_value_to_python(parameter.value)
                for parameter in [*event.new_parameters, *event.changed_parameters]
            }
        )

    # Services --------------------------------------------------------------------------------

    def call(self, service: str, request: bytes) -> bytes:
        """Call a service with a serialized request; in a thread of the server."""
        kind = interface_class(self._service_types[service])
        # A request without fields may come without its one byte of padding.
        message = deserialize_message(
            request if len(request) > 4 else request + b"\0", kind.Request
        )
        return bytes(serialize_message(self._ask(kind, service, message)))

    def _ask(self, kind: Any, service: str, request: Any) -> Any:
        """Answer of a service; raises DeviceError without one. In a thread of the server."""
        client = self._in_node(lambda: self._client(kind, service)).result(ANSWER)
        until = time.monotonic() + FOUND
        while not client.service_is_ready():
            if time.monotonic() > until:
                raise DeviceError(f"service '{service}' is not there; start its node")
            time.sleep(0.005)  # rclpy's own wait looks four times a second
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(ANSWER):
            client.remove_pending_request(future)
            raise DeviceError(f"service '{service}' did not answer within {ANSWER:g} s")
        return future.result()

    def _client(self, kind: Any, service: str) -> Any:
        if service not in self._callers:
            self._callers[service] = self.create_client(kind, service)
        return self._callers[service]

    # Threads ---------------------------------------------------------------------------------

    def _in_node(self, action: Callable[[], T]) -> Future[T]:
        """Do something in the node's own thread."""

        def do() -> T:
            try:
                return action()
            except Exception as error:
                self.log_fault(self._health, "failed", f"Foxglove: {error}", WARN)
                raise

        return self._jobs.call(do)


main = main_of(FoxgloveNode)

if __name__ == "__main__":
    main()
