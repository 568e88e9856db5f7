# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bags of images, and a running vision node with its peer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from service_calls import call

from finger_bag.writer import BagWriter


@pytest.fixture
def write_image_bag() -> Callable[..., None]:
    """Function that writes pictures, `period` s apart, as /finger/image_raw of a bag."""

    def write(path: Path, pictures: Iterable[np.ndarray], period: float) -> None:
        with BagWriter(path, {"session": "images"}) as bag:
            for index, picture in enumerate(pictures):
                stamp = 100_000_000_000 + round(index * period * 1e9)
                bag.write(
                    "image_raw",
                    {
                        "header": {"stamp": stamp, "frame_id": "camera"},
                        "height": picture.shape[0],
                        "width": picture.shape[1],
                        "encoding": "mono8" if picture.dtype == np.uint8 else "mono16",
                        "step": picture.shape[1] * picture.itemsize,
                        "data": np.ascontiguousarray(picture).view(np.uint8).reshape(-1),
                    },
                )

    return write


class Peer:
    """Publishes images to a vision node and collects its areas."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import Image

        from finger_msgs.msg import ContactArea

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self.images = self.node.create_publisher(Image, "image_raw", self.qos)
        self.areas: list[ContactArea] = []
        self.node.create_subscription(ContactArea, "contact_area", self.areas.append, self.qos)

    @staticmethod
    def image(picture: np.ndarray, sec: int, encoding: str = "mono8") -> Any:
        """Image message of a picture (h, w), stamped with `sec` and 123456789 ns."""
        from sensor_msgs.msg import Image

        height, width = picture.shape
        step = width * picture.itemsize
        message = Image(height=height, width=width, encoding=encoding, step=step)
        message.header.stamp.sec = sec
        message.header.stamp.nanosec = 123456789
        message.data = picture.tobytes()
        return message

    def wait(self, condition: Callable[[], Any], seconds: float = 90.0) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition():
                return True
            self.executor.spin_once(timeout_sec=0.1)
        return bool(condition())

    def ask(self, message: Any) -> Any:
        """The area that the node publishes for an image."""
        self.images.publish(message)
        stamp = message.header.stamp
        assert self.wait(lambda: any(a.header.stamp == stamp for a in self.areas)), "no answer"
        return next(a for a in self.areas if a.header.stamp == stamp)

    def parameters(self, node: str) -> list[str]:
        """Names of a node's parameters."""
        from rcl_interfaces.srv import ListParameters

        def until(condition: Callable[[], Any]) -> None:
            assert self.wait(condition)

        name, request = f"/{node}/list_parameters", ListParameters.Request()
        return list(call(self.node, ListParameters, name, request, until).result.names)

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def vision_node(ros_domain: int, process: Any) -> Iterator[Callable[..., Peer]]:
    """Function that starts the vision node with parameters and gives its peer."""
    peers: list[Peer] = []

    def start(env: dict[str, str] | None = None, **parameters: object) -> Peer:
        given = [f"{name}:={value}" for name, value in parameters.items()]
        child = process(
            *("-m", "finger_vision.vision_node", "--ros-args"),
            *("-p", "qos_reliability:=reliable"),
            *(part for text in given for part in ("-p", text)),
            env=env,
        )
        peer = Peer(ros_domain)
        peers.append(peer)
        ready = peer.wait(
            lambda: (
                peer.images.get_subscription_count() == 1
                and peer.node.count_publishers("contact_area") == 1
            )
        )
        assert ready, child.output.read_text()
        return peer

    yield start
    for peer in peers:
        peer.close()
