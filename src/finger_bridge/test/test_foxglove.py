# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Live view in Foxglove: a client of its WebSocket protocol shows topics, sets parameters and calls
services of nodes in other processes.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from foxglove_client import FoxgloveClient, with_client

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")

from geometry_msgs.msg import WrenchStamped  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from finger_bridge import foxglove_server  # noqa: E402
from finger_bridge.foxglove_server import FoxgloveSettings, Server  # noqa: E402
from finger_common.errors import InputError  # noqa: E402


class Nothing:
    """A source without topics, services and parameters."""

    def watch(self, topic: str) -> None: ...

    def parameters_named(self, names: list[str]) -> dict[str, Any]:
        return {"/node.gain": 2.0}

    def change_parameters(self, values: Any) -> list[str]:
        raise AssertionError("must not be reached")

    def call(self, service: str, request: bytes) -> bytes:
        raise AssertionError("must not be reached")


class Sensor:
    """A node of this process that publishes forces at 20 Hz, best effort, and one picture each."""

    def __init__(self) -> None:
        rclpy.init()
        self._node = rclpy.create_node("sensor")
        self._wrench = self._node.create_publisher(
            WrenchStamped, "tip/wrench", qos_profile_sensor_data
        )
        self._image = self._node.create_publisher(Image, "tip/image_raw", qos_profile_sensor_data)
        self._node.create_timer(0.05, self._publish)
        self._number = 0
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        while not self._ending.is_set():
            self._executor.spin_once(0.1)

    def _publish(self) -> None:
        self._number += 1
        message = WrenchStamped()
        message.header.stamp.sec = self._number
        message.wrench.force.z = -self._number / 8
        self._wrench.publish(message)
        self._image.publish(Image(height=1, width=2, step=2, encoding="mono8", data=[7, 9]))

    def readers(self, topic: str) -> int:
        return int(self._node.count_subscribers(topic))

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._executor.shutdown()
        rclpy.try_shutdown()


@pytest.fixture
def sensor(ros_domain: int) -> Iterator[Sensor]:
    sensor = Sensor()
    yield sensor
    sensor.close()


def test_a_client_sees_topics_sets_parameters_and_calls_services(
    sensor: Sensor, process: Any, free_port: Callable[[], int], tmp_path: Path
) -> None:
    port = free_port()
    node = process("-m", "finger_bridge.foxglove_node", "--ros-args", "-p", f"port:={port}")
    arguments = (f"output:={tmp_path}", "need_recorder:=false")
    flags = [flag for argument in arguments for flag in ("-p", argument)]
    process("-m", "finger_operator.protocol_node", "--ros-args", *flags)

    async def look(client: FoxgloveClient) -> None:
        # A stream of best effort, and pictures.
        await client.until(lambda: "/tip/wrench" in client.channels)
        assert sensor.readers("/tip/wrench") == 0, "nobody shows it yet"
        number = await client.subscribe("/tip/wrench")
        first, second = await client.next_of("/tip/wrench"), await client.next_of("/tip/wrench")
        assert second.header.stamp.sec > first.header.stamp.sec
        assert first.wrench.force.z == -first.header.stamp.sec / 8
        await client.subscribe("/tip/image_raw")
        assert list((await client.next_of("/tip/image_raw")).data) == [7, 9]
        await client.unsubscribe(number)
        while sensor.readers("/tip/wrench"):
            await asyncio.sleep(0.05)

        # A latched topic reaches each client, also after another one.
        await client.subscribe("/protocol/status")
        assert (await client.next_of("/protocol/status")).step == "closed"

        async def second_client(other: FoxgloveClient) -> None:
            await other.subscribe("/protocol/status")
            await other.next_of("/protocol/status")

        await with_client(port, second_client)

        # Parameters: all, one changed, one refused with the reason.
        values: dict[str, Any] = {}
        while not {"/foxglove.port", "/protocol.trials"} <= set(values):
            values = await client.parameters()  # of the nodes discovered so far
        assert values["/foxglove.port"] == port and values["/protocol.trials"] == 15
        assert await client.set_parameters(protocol__trials=3, protocol__target_force=1) == {
            "/protocol.trials": 3,
            "/protocol.target_force": 1.0,
        }
        assert await client.set_parameters(protocol__trials=0) == {"/protocol.trials": 3}
        said = await client.until(lambda: [m for m in client.told if m["op"] == "status"])
        assert "trials" in said[0]["message"] and "1 … 1000" in said[0]["message"]
        await client.set_parameters(protocol__trials="many", protocol__nothing=1)
        said = await client.until(
            lambda: [m["message"] for m in client.told if m["op"] == "status"][1:] or None
        )
        assert said[0] == "parameter '/protocol.trials' cannot be 'many'; its type does not fit"

        # Services: one that succeeds, one that answers why not; none for parameters.
        refused = await client.call("/protocol/start")
        assert not refused.success and "subject" in refused.message
        await client.set_parameters(protocol__subject="S01", protocol__conditions=["dry"])
        started = await client.call("/protocol/start")
        assert started.success, started
        await client.until(
            lambda: any(
                topic == "/protocol/status" and message.step == "prepare"
                for topic, _, message in client.received
            )
        )
        assert not any("parameters" in name for name in client.services)

    asyncio.run(with_client(port, look))
    assert f"ws://localhost:{port}" in node.output.read_text()


def test_beyond_this_machine_it_shows_but_is_not_commanded_and_gives_no_pictures() -> None:
    everywhere = FoxgloveSettings(host="0.0.0.0", port=0)
    assert not everywhere.allows_control
    assert not everywhere.offers("/finger/image_raw", "sensor_msgs/msg/Image")
    assert everywhere.offers("/finger/wrench", "geometry_msgs/msg/WrenchStamped")
    assert FoxgloveSettings(host="0.0.0.0", control="always").allows_control
    shared = FoxgloveSettings(host="0.0.0.0", share_images=True)
    assert shared.offers("/finger/image_raw", "sensor_msgs/msg/Image")
    assert FoxgloveSettings().host == "127.0.0.1" and FoxgloveSettings().allows_control
    assert not FoxgloveSettings(control="never").allows_control
    server = Server(everywhere, Nothing())

    async def look(client: FoxgloveClient) -> None:
        info = await client.until(lambda: client.told and client.told[0])
        assert "services" not in info["capabilities"]
        assert await client.set_parameters(node__gain=3.0) == {"/node.gain": 2.0}
        assert any("'control'" in m.get("message", "") for m in client.told)

    try:
        asyncio.run(with_client(server.port, look))
    finally:
        server.stop()


def test_topics_are_chosen_by_pattern() -> None:
    settings = FoxgloveSettings(topics=["/left/*", "/diagnostics"])
    offered = [
        t for t in ("/left/wrench", "/right/wrench", "/diagnostics") if settings.offers(t, "")
    ]
    assert offered == ["/left/wrench", "/diagnostics"]


def test_a_port_in_use_and_an_absent_package_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    server = Server(FoxgloveSettings(port=0), Nothing())
    try:
        with pytest.raises(InputError, match=rf"127.0.0.1:{server.port} \(.*choose another"):
            Server(FoxgloveSettings(port=server.port), Nothing())
    finally:
        server.stop()
    monkeypatch.setattr(foxglove_server, "foxglove", None)
    with pytest.raises(InputError, match="pip install foxglove-sdk"):
        Server(FoxgloveSettings(), Nothing())
