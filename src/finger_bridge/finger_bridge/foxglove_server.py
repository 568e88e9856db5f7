# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The WebSocket server that Foxglove connects to, over `foxglove-sdk`; no ROS here.

The server announces topics, services and parameters of a `Source` and asks it for what a client
wants. A topic is read only while a client shows it.
"""

from __future__ import annotations

import ipaddress
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Protocol

from finger_common.errors import FingerError, InputError
from finger_common.settings import Settings, setting

try:
    import foxglove
    from foxglove import websocket
except ImportError:  # the optional dependency is absent
    foxglove = websocket = None  # type: ignore[assignment]

NEEDS = "the live view in Foxglove needs the package foxglove-sdk: pip install foxglove-sdk"

DEFAULT_PORT = 8765
"""Port that Foxglove's dialog proposes."""

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


@dataclass(frozen=True)
class FoxgloveSettings(Settings):
    """Parameters of the Foxglove server."""

    host: str = setting(
        "127.0.0.1",
        "Address to serve on; 0.0.0.0 for all networks of this machine.",
        advice="The protocol has no password: beyond this machine, serve only on a network of "
        "your own.",
    )
    port: int = setting(
        DEFAULT_PORT,
        "TCP port of the server; 0 selects a free one, which the log names.",
        minimum=0,
        maximum=65535,
    )
    topics: list[str] = setting(
        ["*"], "Topics to offer, as patterns of full names such as /finger/*."
    )
    control: str = setting(
        "local",
        "Whether clients may call services and set parameters; local: while the server is reached "
        "from this machine only.",
        choices=("local", "always", "never"),
    )
    share_images: bool = setting(
        False, "Offer images beyond this machine. Prints are biometric data."
    )

    @property
    def is_local(self) -> bool:
        """Whether only programs of this machine can connect."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    @property
    def allows_control(self) -> bool:
        """Whether clients may call services and set parameters."""
        return self.control == "always" or (self.control == "local" and self.is_local)

    def offers(self, topic: str, message_type: str) -> bool:
        """Whether a topic is offered to clients."""
        if message_type in IMAGE_TYPES and not (self.is_local or self.share_images):
            return False
        return any(fnmatchcase(topic, pattern) for pattern in self.topics)


class Source(Protocol):
    """What a server shows. All methods but `watch` are called in threads of the server, may block
    and raise FingerError.
    """

    def watch(self, topic: str) -> None:
        """Clients of a topic have come or gone; `Server.watched` says which topics have any."""

    def parameters_named(self, names: list[str]) -> dict[str, Any]:
        """Values by full name, "/finger/model.fusion_delay"; of all nodes when `names` is empty."""

    def change_parameters(self, values: Mapping[str, Any]) -> list[str]:
        """Set parameters by full name; gives a sentence for each one that was refused."""

    def call(self, service: str, request: bytes) -> bytes:
        """Call a service with a serialized request; gives the serialized response."""


@dataclass(frozen=True)
class Interface:
    """Name of a message type and its definition in the form "ros2msg"."""

    name: str
    text: str


class Server:
    """Serves a source until `stop`.

    Raises InputError without foxglove-sdk, and for an address that cannot be served on.
    """

    def __init__(self, settings: FoxgloveSettings, source: Source) -> None:
        require()
        self._settings = settings
        self._source = source
        self._lock = threading.Lock()
        self._clients: dict[str, set[int]] = {}
        self._channels: dict[str, Any] = {}
        self._services: set[str] = set()
        self._context = foxglove.Context()
        capabilities = [websocket.Capability.Parameters]
        if settings.allows_control:
            capabilities.append(websocket.Capability.Services)
        try:
            self._server = foxglove.start_server(
                name="finger contact suite",
                host=settings.host,
                port=settings.port,
                capabilities=capabilities,
                server_listener=self,  # type: ignore[arg-type]
                supported_encodings=["cdr"],
                context=self._context,
            )
        except RuntimeError as error:
            reason = str(error).rpartition(": ")[2]
            raise InputError(
                f"Foxglove cannot be served on {settings.host}:{settings.port} ({reason}); "
                "choose another 'host' or 'port'"
            ) from None

    @property
    def port(self) -> int:
        """TCP port that it serves on."""
        return int(self._server.port)

    def stop(self) -> None:
        """Disconnect all clients."""
        self._server.stop()

    # What the source offers ------------------------------------------------------------------

    @property
    def topics(self) -> set[str]:
        """Topics that are announced."""
        return set(self._channels)

    @property
    def services(self) -> set[str]:
        """Services that are announced."""
        return set(self._services)

    def add_topic(self, topic: str, message: Interface) -> None:
        """Announce a topic."""
        self._channels[topic] = foxglove.Channel(
            topic, message_encoding="cdr", schema=_schema(message), context=self._context
        )

    def add_service(
        self, name: str, service_type: str, request: Interface, response: Interface
    ) -> None:
        """Announce a service; none are when clients may not call any."""
        if not self._settings.allows_control:
            return
        schema = foxglove.ServiceSchema(
            service_type,
            request=foxglove.MessageSchema(encoding="cdr", schema=_schema(request)),
            response=foxglove.MessageSchema(encoding="cdr", schema=_schema(response)),
        )
        service = foxglove.Service(name, schema=schema, handler=self._on_call)
        self._server.add_services([service])
        self._services.add(name)

    def remove_services(self, names: set[str]) -> None:
        """Withdraw services."""
        self._server.remove_services(sorted(names))
        self._services -= names

    @property
    def watched(self) -> set[str]:
        """Topics that at least one client shows."""
        with self._lock:
            return {topic for topic, clients in self._clients.items() if clients}

    def send(self, topic: str, message: bytes, received_ns: int) -> None:
        """Send a serialized message to the clients that show its topic.

        received_ns: time of arrival on this machine, which Foxglove orders messages by.
        """
        self._channels[topic].log(message, log_time=received_ns)

    def parameters_changed(self, values: Mapping[str, Any]) -> None:
        """Tell clients new values by full name."""
        self._server.publish_parameter_values(_parameters(values))

    def warn(self, text: str) -> None:
        """Show a sentence to all clients."""
        self._server.publish_status(text, websocket.StatusLevel.Warning)

    # Called by the SDK in its threads --------------------------------------------------------

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """A client shows a topic."""
        with self._lock:
            self._clients.setdefault(channel.topic, set()).add(client.id)
        self._source.watch(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """A client no longer shows a topic, or has gone."""
        with self._lock:
            self._clients.get(channel.topic, set()).discard(client.id)
        self._source.watch(channel.topic)

    def on_get_parameters(
        self, client: Any, param_names: list[str], request_id: str | None = None
    ) -> list[Any]:
        """Values of parameters, of all without names."""
        return self._told(lambda: _parameters(self._source.parameters_named(param_names)))

    def on_set_parameters(
        self, client: Any, parameters: list[Any], request_id: str | None = None
    ) -> list[Any]:
        """Set parameters; a refusal is told, and the values in force go back."""

        def change() -> list[Any]:
            if self._settings.allows_control:
                values = {p.name: p.get_value() for p in parameters}
                for refusal in self._source.change_parameters(values):
                    self.warn(refusal)
            else:
                self.warn("parameters cannot be set from here: 'control' of the node forbids it")
            return _parameters(self._source.parameters_named([p.name for p in parameters]))

        return self._told(change)

    def on_parameters_subscribe(self, param_names: list[str]) -> None:
        """All changes are told to whoever subscribed; the SDK filters."""

    def on_parameters_unsubscribe(self, param_names: list[str]) -> None:
        """See `on_parameters_subscribe`."""

    def _on_call(self, request: Any) -> bytes:
        return self._source.call(request.service_name, request.payload)

    def _told(self, action: Callable[[], list[Any]]) -> list[Any]:
        try:
            return action()
        except FingerError as error:
            self.warn(str(error))
            return []


def require() -> None:
    """Raise InputError when foxglove-sdk is not installed."""
    if foxglove is None:
        raise InputError(NEEDS)


def _schema(interface: Interface) -> Any:
    return foxglove.Schema(
        name=interface.name, encoding="ros2msg", data=interface.text.encode("utf-8")
    )


def _parameters(values: Mapping[str, Any]) -> list[Any]:
    return [foxglove.Parameter(name, value=value) for name, value in values.items()]
