# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What stands around a model node in tests: publishers of its inputs, and its events."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from service_calls import call
from waiting import wait_until

from finger_common.node import LATCHED_QOS
from finger_msgs.msg import ContactArea, ModelEvent

RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)


P = TypeVar("P", bound="ModelNodePeer")


class ModelNodePeer:
    """Sends to one model node in namespace /finger; keeps the events that it publishes.

    A context manager that starts and ends ROS in this process.
    """

    patience = 60.0
    """s, longest wait."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("peer")
        self.events: list[ModelEvent] = []
        self.wrench = self.node.create_publisher(WrenchStamped, "/finger/wrench", RELIABLE)
        self.area = self.node.create_publisher(ContactArea, "/finger/contact_area", RELIABLE)
        self.node.create_subscription(
            ModelEvent, "/finger/model_events", self.events.append, LATCHED_QOS
        )

    def __enter__(self: P) -> P:
        return self

    def __exit__(self, *failure: object) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()

    def until(self, condition: Callable[[], Any], what: str = "an answer of the model node") -> Any:
        """Spin until the condition holds."""
        spin = partial(rclpy.spin_once, self.node, timeout_sec=0.02)
        return wait_until(condition, what, spin=spin, seconds=self.patience)

    def spin(self, seconds: float = 0.5) -> None:
        """Receive for a time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Response of a service."""
        return call(self.node, kind, name, request, self.until)
