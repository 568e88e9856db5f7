"""Two fingers on one machine and one ROS domain: nothing of one reaches the other."""

from __future__ import annotations

import importlib
import inspect
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from finger_bringup import nodes  # noqa: E402
from finger_common.namespaces import default_folder  # noqa: E402
from finger_common.node import ManagedNode  # noqa: E402
from finger_msgs.msg import ContactArea  # noqa: E402

FINGERS = ("thumb", "hand/index")
SHARED_TOPICS = {"/diagnostics", "/rosout", "/parameter_events"}
LIGHT: dict[str, dict[str, Any]] = {
    "simulated_rig": {"width": 160, "height": 128, "frame_rate": 4.0, "refinement": 0.3},
    "force": {"rate": 50.0, "response_timeout": 0.5, "connect_timeout": 60.0},
    "protocol": {"subject": "S01"},
}
"""A rig that needs little of the processor; nothing about addresses, which are the defaults."""


def node_class(entry: nodes.NodeEntry) -> type[ManagedNode]:
    """The class of an entry's node."""
    module = importlib.import_module(entry.module)
    found = [
        member
        for member in vars(module).values()
        if inspect.isclass(member)
        and issubclass(member, ManagedNode)
        and member.__module__ == module.__name__
    ]
    assert len(found) == 1, entry.module
    return found[0]


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

    def add_finger(self, namespace: str) -> None:
        folder = default_folder(namespace).absolute()
        entries = nodes.settled(
            nodes.rig(folder, simulated=True, parameters=LIGHT), namespace, None
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
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
            found = condition()
            if found:
                return found
        raise AssertionError(f"nothing came in time; {self.levels}")

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


@pytest.fixture
def hand(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_port: Any
) -> Iterator[Hand]:
    monkeypatch.chdir(tmp_path)
    # The usual port belongs to whoever uses this machine.
    monkeypatch.setattr("finger_operator.page.server.USUAL_PORT", free_port())
    hand = Hand(ros_domain)
    yield hand
    hand.close()


@pytest.mark.timeout(600)
def test_two_fingers_meet_in_no_topic_service_file_port_frame_or_diagnostic(
    hand: Hand, tmp_path: Path
) -> None:
    for finger in FINGERS:
        hand.add_finger(finger)
        for name, node in hand.nodes[finger].items():
            if name != "bring_up":
                assert node.bring_up(), (finger, name)
    thumb, index = (hand.nodes[finger] for finger in FINGERS)

    # Frames: each stream bears its own finger's.
    for finger in FINGERS:
        for kind, topic in ((WrenchStamped, "wrench"), (Image, "image_raw")):
            assert hand.first(kind, f"/{finger}/{topic}").header.frame_id.startswith(f"{finger}/")
        area = hand.first(ContactArea, f"/{finger}/contact_area")
        assert area.header.frame_id == f"{finger}/plate"

    # Topics: whoever publishes or reads one lives in its namespace.
    own = {f"/{finger}" for finger in FINGERS}
    for topic, _ in hand.observer.get_topic_names_and_types():
        if topic in SHARED_TOPICS:
            continue
        home = next((space for space in own if topic.startswith(f"{space}/")), None)
        assert home is not None, topic
        ends = hand.observer.get_publishers_info_by_topic(topic)
        ends += hand.observer.get_subscriptions_info_by_topic(topic)
        assert {end.node_namespace for end in ends} <= {home}, topic

    # Services and actions.
    services = [name for name, _ in hand.observer.get_service_names_and_types()]
    lonely = [s for s in services if not any(s.startswith(f"{space}/") for space in own)]
    assert all(s.startswith("/observer/") for s in lonely), lonely
    for space in own:
        assert f"{space}/force/tare" in services and f"{space}/protocol/start" in services

    # Files: everything written lies in the finger's folder, and both wrote something.
    folders = {default_folder(finger).absolute() for finger in FINGERS}
    written = {path for path in tmp_path.rglob("*") if path.is_file()}
    for folder in folders:
        assert {path for path in written if folder in path.parents}
    assert all(folders & set(path.parents) for path in written), written
    assert not any({*folders} <= set(path.parents) for path in written)

    # Ports.
    buses = {node["simulated_rig"].values["can_port"] for node in (thumb, index)}
    groups = {node["simulated_rig"].values["can_channel"] for node in (thumb, index)}
    assert len(buses) == len(groups) == 2
    pages = {node["page"].values["port"]: node["page"]._server.port for node in (thumb, index)}
    assert set(pages) == {0}
    assert thumb["page"]._server.port != index["page"]._server.port

    # Diagnostics: full names; the broken sensor of one finger is nothing to the other.
    def level(finger: str) -> int | None:
        return hand.levels.get(f"{finger}/force: force")

    hand.until(lambda: level("thumb") == 1 and level("hand/index") == 1)  # both want a tare
    for finger in FINGERS:
        assert {n.split("/force")[0] for n in hand.levels if f"{finger}/force" in n} == {finger}
    hand.nodes["thumb"]["protocol"]._start()
    hand.nodes["hand/index"]["protocol"]._start()
    faults = Parameter("faults", value=["force silent"])
    assert thumb["simulated_rig"].set_parameters_atomically([faults]).successful
    hand.until(lambda: level("thumb") == 2)

    def noted(node: dict[str, Any]) -> list[str]:
        events = node["protocol"]._protocol.log.events
        return [event.text for event in events if event.kind == "fault"]

    hand.until(lambda: noted(thumb))
    assert level("hand/index") == 1
    assert not [text for text in noted(index) if text.startswith("force")]
    shown = {item["name"].split(":")[0] for item in index["page"]._board.snapshot(time.monotonic())}
    assert shown and all(name.startswith("hand/index/") for name in shown)
