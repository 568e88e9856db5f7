"""All nodes of several fingers in one process, for tests of what they do side by side."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from service_calls import call
from waiting import wait_until

from finger_bringup import nodes
from finger_common.namespaces import default_folder
from finger_common.node import ManagedNode

LIGHT: dict[str, dict[str, Any]] = {
    "simulated_rig": {"width": 160, "height": 128, "frame_rate": 4.0, "refinement": 0.3},
    "force": {"rate": 50.0, "response_timeout": 0.5, "connect_timeout": 60.0},
    "protocol": {"subject": "S01"},
}
"""A rig that needs little of the processor; nothing about addresses, which are the defaults."""


def node_class(entry: nodes.NodeEntry) -> type[ManagedNode]:
    """The class of an entry's node."""
    return importlib.import_module(entry.module).main.node_class  # type: ignore[no-any-return]


class Hand:
    """All nodes of the fingers, as `finger-rig up --simulated --namespace …` runs them."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.observer = rclpy.create_node("observer", context=self.context)
        self.executor.add_node(self.observer)
        self.nodes: dict[str, dict[str, Any]] = {}
        self.levels: dict[str, int] = {}
        self.observer.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 50)

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.levels[status.name] = int(status.level[0])

    def add_finger(self, namespace: str, further: Iterable[str] = ("fit",)) -> None:
        """Make the nodes of a simulated rig, in its usual folder, and further ones."""
        folder = default_folder(namespace).absolute()
        entries = nodes.settled(
            nodes.rig(folder, simulated=True, parameters=LIGHT, further=further), namespace
        )
        self.nodes[namespace] = {}
        for entry in entries:
            overrides = [Parameter(name, value=value) for name, value in entry.parameters.items()]
            node = node_class(entry)(
                context=self.context, namespace=namespace, parameter_overrides=overrides
            )
            self.nodes[namespace][entry.name] = node
            self.executor.add_node(node)

    def until(self, condition: Callable[[], Any], seconds: float = 120) -> Any:
        spin = partial(self.executor.spin_once, timeout_sec=0.05)
        return wait_until(condition, lambda: self.levels, spin=spin, seconds=seconds)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Answer of a service."""
        return call(self.observer, kind, service, request, self.until)

    def first(self, kind: Any, topic: str) -> Any:
        """First message on a topic."""
        heard: list[Any] = []
        subscription = self.observer.create_subscription(kind, topic, heard.append, 10)
        self.until(lambda: heard)
        self.observer.destroy_subscription(subscription)
        return heard[0]

    def close(self) -> None:
        for group in self.nodes.values():
            for node in reversed(list(group.values())):
                node.release()
        self.executor.shutdown()
        for group in self.nodes.values():
            for node in group.values():
                node.destroy_node()
        self.observer.destroy_node()
        rclpy.shutdown(context=self.context)
