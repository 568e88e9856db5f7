"""The vision node as a process: stamps, empty plate, refused frames, overlay on demand."""

from __future__ import annotations

import time

import pytest

rclpy = pytest.importorskip("rclpy")
finger_msgs = pytest.importorskip("finger_msgs.msg")

import numpy as np  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from finger_msgs.msg import ContactArea  # noqa: E402
from finger_sim.ftir import FtirRenderer, Scene  # noqa: E402

QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


def image_message(picture: np.ndarray, sec: int, encoding: str = "mono8") -> Image:
    message = Image(
        height=picture.shape[0], width=picture.shape[1], encoding=encoding, step=picture.shape[1]
    )
    message.header.stamp.sec = sec
    message.header.stamp.nanosec = 123456789
    message.data = picture.tobytes()
    return message


class Peer:
    """Publishes images and collects what the node says."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.images = self.node.create_publisher(Image, "image_raw", QOS)
        self.areas: list[ContactArea] = []
        self.node.create_subscription(ContactArea, "contact_area", self.areas.append, QOS)

    def wait(self, condition, seconds: float = 30.0) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition():
                return True
            self.executor.spin_once(timeout_sec=0.1)
        return bool(condition())

    def ask(self, message: Image) -> ContactArea:
        self.images.publish(message)
        stamp = message.header.stamp
        assert self.wait(lambda: any(a.header.stamp == stamp for a in self.areas)), "no answer"
        return next(a for a in self.areas if a.header.stamp == stamp)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def peer(ros_domain: int, process):
    child = process(
        "-m", "finger_vision.vision_node", "--ros-args", "-p", "qos_reliability:=reliable"
    )
    peer = Peer(ros_domain)
    ready = peer.wait(
        lambda: (
            peer.images.get_subscription_count() == 1
            and peer.node.count_publishers("contact_area") == 1
        )
    )
    assert ready, child.output.read_text()
    peer.child = child
    yield peer
    peer.close()


def test_areas_carry_the_images_stamp_and_bad_frames_do_not_stop_the_node(peer) -> None:
    renderer = FtirRenderer("natural", seed=4, scene=Scene(latent=0.0))
    empty = peer.ask(image_message(renderer.empty(), 1))
    assert empty.gross_area == 0.0 and empty.real_area == 0.0
    assert empty.flags & ContactArea.FLAG_NO_CONTACT
    assert not empty.hull
    pressed = peer.ask(image_message(renderer.render(4.5e-3), 2))
    assert (pressed.header.stamp.sec, pressed.header.stamp.nanosec) == (2, 123456789)
    assert pressed.header.frame_id == "plate"
    assert pressed.gross_area == pytest.approx(np.pi * 4.5e-3**2, rel=0.05)
    # The empty frame before it became the background.
    assert pressed.flags == ContactArea.FLAG_UNCALIBRATED
    assert len(pressed.hull) > 10

    peer.images.publish(image_message(renderer.empty(), 3, encoding="bayer_weird"))
    peer.images.publish(Image())
    again = peer.ask(image_message(renderer.render(4.5e-3), 5))
    assert again.gross_area == pytest.approx(pressed.gross_area, rel=0.01)
    assert {a.header.stamp.sec for a in peer.areas} == {1, 2, 5}
    assert peer.node.count_subscribers("contact_image") == 0


def test_a_burst_is_answered_with_its_newest_frame_and_the_rest_is_counted(peer) -> None:
    reports: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    renderer = FtirRenderer("natural", seed=6, scene=Scene(latent=0.0))
    peer.ask(image_message(renderer.empty(), 1))
    frames = [image_message(renderer.render(3e-3), 10 + i) for i in range(30)]

    def counted(key: str) -> int:
        values = [v for r in reports[-1:] for s in r.status for v in s.values]
        return next((int(v.value) for v in values if v.key == key), 0)

    # The middleware may leave out frames of a burst before the node sees them, so one burst need not show a count.
    sent = 1
    for burst in range(10):
        for i, frame in enumerate(frames):
            frame.header.stamp.sec = 10 + burst * len(frames) + i
            peer.images.publish(frame)
        sent += len(frames)
        newest = 9 + (burst + 1) * len(frames)
        assert peer.wait(lambda newest=newest: peer.areas[-1].header.stamp.sec == newest)
        reports.clear()
        assert peer.wait(lambda: len(reports) > 1)
        if counted("dropped"):
            break
    stamps = [a.header.stamp.sec for a in peer.areas]
    assert stamps == sorted(set(stamps)), "areas come in order, each once"
    assert counted("dropped") > 0
    assert len(stamps) + counted("dropped") <= sent


def test_overlay_is_made_when_somebody_listens(peer) -> None:
    renderer = FtirRenderer("moist", seed=5, scene=Scene(latent=0.0))
    pictures: list[Image] = []
    frame = image_message(renderer.render(4e-3), 1)
    peer.ask(frame)
    subscription = peer.node.create_subscription(Image, "contact_image", pictures.append, QOS)

    def answered() -> bool:
        peer.images.publish(frame)
        return bool(pictures)

    assert peer.wait(answered)
    assert pictures[0].header.stamp == frame.header.stamp
    assert pictures[0].encoding == "bgr8"
    assert (pictures[0].width, pictures[0].height) == (1280, 1024)
    peer.node.destroy_subscription(subscription)
