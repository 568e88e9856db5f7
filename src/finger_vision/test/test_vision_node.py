# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The vision node as a process: stamps, empty plate, refused frames, overlay on demand."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import Trigger
from waiting import wait_until

from finger_msgs.msg import ContactArea
from finger_sim.ftir import FtirRenderer, Scene


@pytest.fixture
def peer(vision_node):
    return vision_node()


def test_areas_carry_the_images_stamp_and_bad_frames_do_not_stop_the_node(peer) -> None:
    renderer = FtirRenderer("natural", seed=4, scene=Scene(latent=0.0))
    empty = peer.ask(peer.image(renderer.empty(), 1))
    assert empty.gross_area == 0.0 and empty.real_area == 0.0
    assert empty.flags & ContactArea.FLAG_NO_CONTACT
    assert not empty.hull
    pressed = peer.ask(peer.image(renderer.render(4.5e-3), 2))
    assert (pressed.header.stamp.sec, pressed.header.stamp.nanosec) == (2, 123456789)
    assert pressed.header.frame_id == "plate"
    assert pressed.gross_area == pytest.approx(np.pi * 4.5e-3**2, rel=0.05)
    # The empty frame before it became the background.
    assert pressed.flags == ContactArea.FLAG_UNCALIBRATED
    assert len(pressed.hull) > 10

    peer.images.publish(peer.image(renderer.empty(), 3, encoding="bayer_weird"))
    peer.images.publish(Image())
    reports: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    peer.images.publish(peer.image(np.full_like(renderer.empty(), 3), 4))
    assert peer.wait(
        lambda: any(
            s.level == DiagnosticStatus.ERROR and "the plate is dark" in s.message
            for report in reports
            for s in report.status
        )
    )
    again = peer.ask(peer.image(renderer.render(4.5e-3), 5))
    assert again.gross_area == pytest.approx(pressed.gross_area, rel=0.01)
    assert {a.header.stamp.sec for a in peer.areas} == {1, 2, 5}
    assert peer.node.count_subscribers("contact_image") == 0


def told(peer, words: str, reports: list[DiagnosticArray]) -> Callable[[], bool]:
    """Whether the newest of the reports, which are collected from now on, has these words."""
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    return lambda: any(words in s.message for report in reports[-1:] for s in report.status)


def paled(renderer: FtirRenderer, share: float) -> np.ndarray:
    """Frame (H, W) of a print of this share of a contact's contrast."""
    plate, pressed = (a.astype(float) for a in (renderer.empty(), renderer.render(4.5e-3)))
    return np.rint(plate + share * (pressed - plate)).astype(np.uint8)


def test_a_print_too_pale_to_be_measured_is_said(peer) -> None:
    said = told(peer, "too pale", [])
    renderer = FtirRenderer("natural", seed=8, scene=Scene(latent=0.0))
    pale = paled(renderer, 0.25)
    seen = peer.ask(peer.image(pale, 1))
    doubt = ContactArea.FLAG_NO_CONTACT | ContactArea.FLAG_LOW_CONTRAST
    assert seen.flags & doubt == doubt
    assert peer.wait(said)
    peer.ask(peer.image(renderer.empty(), 2))
    assert peer.wait(lambda: not said())


def test_a_pale_contact_that_does_not_change_is_said_to_be_sweat(peer) -> None:
    """A strong print that was left before the background was learned from a clean plate."""
    reports: list[DiagnosticArray] = []
    said = told(peer, "not changed for 6 s; where no finger presses, sweat", reports)
    renderer = FtirRenderer("natural", seed=8, scene=Scene(latent=0.0))
    sweat = paled(renderer, 0.35)
    peer.ask(peer.image(renderer.empty(), 1))
    for second in (2, 7):
        seen = peer.ask(peer.image(sweat, second))
        assert seen.flags & ContactArea.FLAG_LOW_CONTRAST and seen.gross_area > 50e-6
    reports.clear()
    assert peer.wait(lambda: len(reports) > 1)
    assert not said()
    peer.ask(peer.image(sweat, 8))
    assert peer.wait(said)
    peer.ask(peer.image(renderer.render(4.5e-3), 9))
    assert peer.wait(lambda: not said())


def said_here(node: Any, picture: np.ndarray, second: int, words: str) -> bool:
    """Whether a node in this process warns with these words after a picture (H, W) uint8."""
    height, width = picture.shape
    image = Image(height=height, width=width, encoding="mono8", step=width, data=picture.tobytes())
    image.header.stamp.sec = second
    node._measure(image)
    return any(words in text for text in node.health.faults.values())


def test_a_print_that_stands_still_right_after_a_pale_one_is_logged_too(ros_domain: int) -> None:
    renderer = FtirRenderer("natural", seed=8, scene=Scene(latent=0.0))
    logged: list[str] = []
    with node_here(ros_domain) as node:
        assert node.bring_up()
        node.log = lambda level, text: logged.append(text)
        # Both within the time for which a fault that comes and goes is held.
        node.health._clock = lambda: 0.0
        pale, still = "a print is too pale", "of low contrast has not changed"
        assert said_here(node, paled(renderer, 0.25), 1, pale)
        said_here(node, renderer.empty(), 2, "")
        for second in (3, 8, 9):
            said_here(node, paled(renderer, 0.35), second, still)
        assert [[words in text for words in (pale, still)] for text in logged] == [
            [True, False],
            [False, True],
        ]
        node._on_reset(Trigger.Request(), Trigger.Response())
        assert not node.health.faults


@pytest.mark.parametrize("mark", ["round mask", "line"])
def test_marks_on_the_plate_are_said_and_a_reset_takes_them_as_the_plate(
    ros_domain: int, mark: str
) -> None:
    renderer = FtirRenderer("natural", seed=3, scene=Scene(noise=3.0))
    marks = np.zeros((1024, 1280), np.uint8)
    if mark == "line":
        cv2.line(marks, (640, 60), (790, 960), 255, 2, cv2.LINE_AA)
    else:
        marks = 255 - cv2.circle(marks, (640, 512), 500, 255, -1)

    with node_here(ros_domain) as node:
        assert node.bring_up()
        areas: list[ContactArea] = []
        node._areas = SimpleNamespace(publish=areas.append)

        def said(picture: np.ndarray, second: int) -> bool:
            shown = np.where(marks > 127, np.uint8(20), picture)
            return said_here(node, shown, second, "marks on the plate")

        def reset() -> str:
            return str(node._on_reset(Trigger.Request(), Trigger.Response()).message)

        assert [said(renderer.empty(), s) for s in (0, 3, 5, 6)] == [False, False, False, True]
        assert areas[-1].gross_area > 5e-6
        assert "from the next image" in reset()
        assert not said(renderer.empty(), 7)
        assert areas[-1].gross_area == 0.0
        assert not areas[-1].flags & ContactArea.FLAG_NO_BACKGROUND
        assert not said(renderer.render(4e-3), 8)
        assert areas[-1].gross_area == pytest.approx(np.pi * 4e-3**2, rel=0.05)
        assert "from frames without contact" in reset()


def test_a_finger_that_is_on_the_plate_from_the_start_is_not_taken_for_marks(
    ros_domain: int,
) -> None:
    """A fingerpad spreads on under a constant force, here by 0.8 % per second."""
    renderer = FtirRenderer("natural", seed=3, scene=Scene())
    with node_here(ros_domain) as node:
        assert node.bring_up()
        for second in range(0, 20, 2):
            finger = renderer.render(4e-3 * 1.004**second)
            assert not said_here(node, finger, second, "not changed")
        node._on_reset(Trigger.Request(), Trigger.Response())
        said_here(node, renderer.render(4e-3), 20, "")
        assert node.sensor.learned == 0


@pytest.mark.parametrize("jump", [-3 * 3600, 3 * 3600, None, 4])
def test_a_finger_is_not_said_to_stand_still_over_a_jump_of_the_clock(
    ros_domain: int, jump: int | None
) -> None:
    """Stamps of 2 s, those of another clock (None: none), and the first ones again."""
    renderer = FtirRenderer("natural", seed=3, scene=Scene(), width=640, height=480)

    with node_here(ros_domain) as node:
        assert node.bring_up()

        def said(stamp_ns: int) -> bool:
            node._measure(stamped(renderer.render(2e-3), stamp_ns))
            return "not changed" in node.health.faults.get("still", "")

        steps = [10**12 + number * 10**8 for number in range(60)]
        other = [0 if jump is None else stamp + jump * 10**9 for stamp in steps]
        for stamp in steps[:20] + other[20:40] + steps[40:]:
            assert not said(stamp), stamp
        node._on_reset(Trigger.Request(), Trigger.Response())
        assert not said(steps[-1] + 10**8)
        assert node.sensor.learned == 0, "the finger was taken as plate"
        # Without a jump it is said, also where the camera is slow.
        slow = [steps[-1] + second * 10**9 for second in (3, 6, 9, 12)]
        assert [said(stamp) for stamp in slow] == [False, False, True, True]


def test_images_in_the_lower_bits_are_said_where_a_dark_plate_is_allowed(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_vision import vision_node

    monkeypatch.setattr(vision_node, "DARK_IMAGES", 3)
    scene = Scene(background=25, bright_ridges=True, latent=0.0)
    renderer = FtirRenderer("natural", seed=8, scene=scene)
    deep = (renderer.empty().astype(np.uint16) << 4) + 5
    with node_here(ros_domain, polarity="bright") as node:
        assert node.bring_up()

        def said(picture: np.ndarray) -> bool:
            height, width = picture.shape
            image = Image(height=height, width=width, encoding="mono16", step=2 * width)
            image.data = picture.tobytes()
            node._measure(image)
            return "10- or 12-bit" in node.health.faults.get("bits", "")

        assert [said(deep) for _ in range(4)] == [False, False, False, True]
        assert not said(deep << 4)


def test_eight_bits_in_the_middle_of_16_are_said(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """8-bit values times 16: neither the lowest nor the highest four bits are used."""
    from finger_vision import vision_node

    monkeypatch.setattr(vision_node, "DARK_IMAGES", 3)
    renderer = FtirRenderer("natural", seed=8, scene=Scene(latent=0.0), width=640, height=480)
    with node_here(ros_domain) as node:
        assert node.bring_up()
        for _ in range(4):
            assert "bits" not in node.health.faults
            deep = renderer.empty().astype(np.uint16) << 4
            node._measure(stamped(deep, 1, "mono16"))
        assert "in the lower bits" in node.health.faults["bits"]
        assert "too dark" in node.health.faults["contrast"]


def stamped(picture: np.ndarray, stamp_ns: int, encoding: str = "mono8") -> Image:
    """Image message of a picture (h, w), stamped."""
    height, width = picture.shape
    image = Image(height=height, width=width, encoding=encoding, step=picture.strides[0])
    image.header.stamp.sec, image.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    image.data = picture.tobytes()
    return image


def test_a_frozen_camera_gives_the_same_areas_live_and_offline_and_is_told(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """New stamps on the same pixels are no new areas."""
    from finger_common.image_size import PixelBudget
    from finger_offline.image_areas import ImageAreas
    from finger_vision.ftir import FtirSegmenter

    renderer = FtirRenderer("natural", seed=3, scene=Scene(), width=640, height=480)
    renderer.calibration().save(tmp_path / "plate.yaml")
    pictures = [renderer.empty() for _ in range(5)]
    pictures += [renderer.render(1e-3 * radius) for radius in (2, 3, 4)]
    pictures += pictures[-1:] * 20
    images = [stamped(p, 10**12 + k * 10**8) for k, p in enumerate(pictures)]
    offline = ImageAreas(FtirSegmenter(calibration=renderer.calibration()), PixelBudget(1 << 30))
    for image in images:
        stamp = image.header.stamp.sec * 10**9 + image.header.stamp.nanosec
        offline.add(SimpleNamespace(message=image, log_time_ns=stamp), stamp)
    with node_here(ros_domain, calibration_file=str(tmp_path / "plate.yaml")) as node:
        assert node.bring_up()
        areas: list[ContactArea] = []
        node._areas = SimpleNamespace(publish=areas.append)

        def work(images: list[Image]) -> None:
            waiting: queue.Queue[Image | None] = queue.Queue()
            for image in [*images, None]:
                waiting.put(image)
            node._work(waiting)

        work(images[:9])
        assert "frozen" not in node.health.faults
        work(images[9:])
        report = node.health.report()
        assert report.level == 2 and "repeats the same image" in report.message
        assert report.values["repeated"] == "20"
        live = [(a.gross_area, a.area_stddev, a.flags) for a in areas]
        found = offline.table()
        assert live == list(zip(found["area"], found["sd"], found["flags"]))
        assert len(live) == 8
        monkeypatch.setattr("finger_common.diagnostics.HOLD", 0.0)
        work([stamped(renderer.render(4e-3), 10**12 + 10**10)])
        assert "frozen" not in node.health.faults and len(areas) == 9


@pytest.mark.parametrize("bad", ["of another size", "cut short", "overexposed", "a failure"])
def test_every_second_image_that_cannot_be_used_is_told_once_and_until_none_comes(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch, bad: str
) -> None:
    renderer = FtirRenderer("natural", seed=3, scene=Scene(), width=640, height=480)
    empty = renderer.empty()
    with node_here(ros_domain) as node:
        assert node.bring_up()
        seconds, said = 100.0, []
        node.health._clock = lambda: seconds
        monkeypatch.setattr(node, "log", lambda level, text: said.append(text))
        measure = node._stream.measure

        def fail_at_times(image: np.ndarray, learn: bool) -> Any:
            if bad == "a failure" and round(10 * seconds) % 2:
                raise ValueError("a defect")
            return measure(image, learn)

        monkeypatch.setattr(node._stream, "measure", fail_at_times)
        levels = []
        for number in range(60):
            seconds = 100.0 + 0.1 * number
            image = stamped(empty + np.uint8(number % 3), 10**12 + number * 10**8)
            if number % 2 and number < 30:
                if bad == "of another size":
                    image = stamped(empty[::2, ::2].copy(), 10**12 + number * 10**8)
                elif bad == "cut short":
                    image.data = image.data[:-1000]
                elif bad == "overexposed":
                    image.data = bytes(255 - (k % 100 == number) for k in range(empty.size))
            elif number >= 30:
                bad = ""
            waiting: queue.Queue[Image | None] = queue.Queue()
            waiting.put(image)
            waiting.put(None)
            node._work(waiting)
            levels.append(node.health.report().level > 0)
        # The last bad image is number 29.
        assert levels == [False] + [True] * 49 + [False] * 10
        assert len(said) == 1, said


def test_compressed_images_give_the_areas_of_the_raw_ones(ros_domain: int, tmp_path: Path) -> None:
    renderer = FtirRenderer("natural", seed=3, scene=Scene(), width=640, height=480)
    renderer.calibration().save(tmp_path / "plate.yaml")
    pictures = [renderer.empty(), renderer.render(3e-3)]
    images = [stamped(p, 10**12 + k * 10**8) for k, p in enumerate(pictures)]
    found = []
    for transport, topic in (("raw", "/image_raw"), ("compressed", "/image_raw/compressed")):
        sent: list[Image | CompressedImage] = []
        for image, picture in zip(images, pictures):
            data = cv2.imencode(".png", picture)[1].tobytes()
            packed = CompressedImage(header=image.header, format="mono8; png compressed ")
            packed.data = data
            sent.append(image if transport == "raw" else packed)
        plate = str(tmp_path / "plate.yaml")
        with node_here(ros_domain, calibration_file=plate, image_transport=transport) as node:
            areas: list[ContactArea] = []
            assert node.bring_up()
            (stream,) = (s for s in node.subscriptions if "image" in s.topic_name)
            assert stream.topic_name == topic and stream.msg_type is type(sent[0])
            node._areas = SimpleNamespace(publish=areas.append)
            camera = node.create_publisher(type(sent[0]), topic, 3)
            executor = SingleThreadedExecutor(context=node.context)
            executor.add_node(node)
            for number, image in enumerate(sent, 1):
                camera.publish(image)
                end = time.monotonic() + 60
                while len(areas) < number and time.monotonic() < end:
                    executor.spin_once(timeout_sec=0.1)
            executor.shutdown()
            found.append([(a.header.stamp, a.gross_area, a.flags) for a in areas])
    assert len(found[0]) == 2 and found[0] == found[1]


def test_stamps_that_are_not_in_order_are_dropped_and_told(ros_domain: int) -> None:
    picture = FtirRenderer("natural", seed=3, width=640, height=480).empty()
    with node_here(ros_domain) as node:
        assert node.bring_up()
        taken: list[int] = []
        node._replace = lambda image: image and taken.append(image.header.stamp.sec)
        for second in (1000, 1001, 1001, 1000, 1002, 10, 11, 0, 12):
            node._on_image(stamped(picture, second * 10**9))
        assert taken == [1000, 1001, 1002, 10, 11, 0, 12]
        node.publish_diagnostics()
        assert "not after those before" in node.health.faults["stamps"]
        assert "no stamp (zero)" in node.health.faults["no_stamp"]
        assert node.health.report().values["out_of_order"] == "2"
        node.publish_diagnostics()
        assert not {"stamps", "no_stamp"} & set(node.health.faults)


def test_two_cameras_on_a_topic_are_told_however_far_their_clocks_are_apart(
    ros_domain: int,
) -> None:
    from finger_common.diagnostics import MIXED_INPUT

    with node_here(ros_domain) as node:
        assert node.bring_up()
        cameras = [rclpy.create_node(name, context=node.context) for name in ("left", "right")]

        def told() -> str:
            node.publish_diagnostics()
            return str(node.health.faults.get(MIXED_INPUT, ""))

        cameras[0].create_publisher(Image, "image_raw", 3)
        wait_until(lambda: node.count_publishers("image_raw") == 1, "the first camera")
        assert not told()
        second = cameras[1].create_publisher(Image, "image_raw", 3)
        wait_until(lambda: "image_raw is published by /left and /right: this" in told(), "both")
        cameras[1].destroy_publisher(second)
        wait_until(lambda: not told(), "the first one alone")
        for camera in cameras:
            camera.destroy_node()


def test_a_burst_is_answered_with_its_newest_frame_and_the_rest_is_counted(peer) -> None:
    reports: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    renderer = FtirRenderer("natural", seed=6, scene=Scene(latent=0.0))
    peer.ask(peer.image(renderer.empty(), 1))
    frames = [peer.image(renderer.render(3e-3), 10 + i) for i in range(30)]

    def counted(key: str) -> int:
        values = [v for r in reports[-1:] for s in r.status for v in s.values]
        return next((int(v.value) for v in values if v.key == key), 0)

    # The middleware may leave out frames of a burst before the node receives them, so one burst
    # need not show a count.
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


def test_overlay_is_drawn_while_it_has_subscribers(peer) -> None:
    renderer = FtirRenderer("moist", seed=5, scene=Scene(latent=0.0))
    pictures: list[Image] = []
    frame = peer.image(renderer.render(4e-3), 1)
    peer.ask(frame)
    stamped = [frame.header.stamp.sec]
    subscription = peer.node.create_subscription(Image, "contact_image", pictures.append, peer.qos)

    def answered() -> bool:
        frame.header.stamp.sec += 1
        stamped.append(frame.header.stamp.sec)
        peer.images.publish(frame)
        return bool(pictures)

    assert peer.wait(answered)
    assert pictures[0].header.stamp.sec in stamped
    assert pictures[0].header.stamp.nanosec == frame.header.stamp.nanosec
    assert pictures[0].encoding == "bgr8"
    assert (pictures[0].width, pictures[0].height) == (1280, 1024)
    peer.node.destroy_subscription(subscription)


@contextmanager
def node_here(ros_domain: int, **values: Any) -> Iterator[Any]:
    """The node in this process, unconfigured."""
    from rclpy.parameter import Parameter

    from finger_vision.vision_node import VisionNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    node = VisionNode(context=context, parameter_overrides=overrides)
    try:
        yield node
    finally:
        node.release()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_it_waits_for_a_calibration_that_is_being_written(ros_domain: int, tmp_path: Path) -> None:
    from rclpy.lifecycle import TransitionCallbackReturn
    from rclpy.parameter import Parameter

    from finger_vision.calibration import PlateCalibration

    path = tmp_path / "plate.yaml"
    calibration = PlateCalibration.from_area_per_pixel(1e-9)
    written = threading.Timer(0.5, calibration.save, (path,))
    values = {"calibration_file": str(path), "frame_prefix": "thumb/"}
    with node_here(ros_domain, **values) as node:
        written.start()
        assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
        assert node.frame == "thumb/plate"
        node.trigger_cleanup()
        path.unlink()
        node.set_parameters_atomically([Parameter("calibration_timeout", value=0.2)])
        assert node.trigger_configure() is TransitionCallbackReturn.FAILURE
    written.join()


def test_a_camera_that_is_not_active_is_told_from_images_that_do_not_come(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.lifecycle import LifecycleNode

    from finger_vision import vision_node

    monkeypatch.setattr(vision_node, "SILENCE", 0.0)
    with node_here(ros_domain) as node:
        executor = SingleThreadedExecutor(context=node.context)
        camera = LifecycleNode("camera", namespace="rig", context=node.context)
        camera.create_publisher(Image, "/image_raw", 3)
        for one in (node, camera):
            executor.add_node(one)
        assert node.bring_up()

        def until(said: str) -> None:
            end = time.monotonic() + 60
            while said not in node.health.faults.get("no_image", ""):
                assert time.monotonic() < end, node.health.faults
                node.publish_diagnostics()
                for _ in range(20):
                    executor.spin_once(timeout_sec=0.01)

        camera.trigger_configure()
        until("; /rig/camera is inactive; activate it")
        camera.trigger_activate()
        until("; large images need the profile")
        executor.shutdown()
        camera.destroy_node()


def test_images_that_are_published_and_do_not_come_are_told(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rclpy.event_handler import QoSSubscriptionEventType

    now = time.monotonic()
    with node_here(ros_domain) as node:
        assert node.bring_up()
        camera = rclpy.create_node("camera", context=node.context)
        images = camera.create_publisher(Image, "image_raw", 3)
        end = now + 60
        while not node.count_publishers("image_raw"):
            assert time.monotonic() < end
        with monkeypatch.context() as patched:
            patched.setattr(time, "monotonic", lambda: now)
            node._on_image(Image())

            def said(after: float) -> str:
                nonlocal now
                now += after
                node.publish_diagnostics()
                return str(node.health.faults.get("no_image", ""))

            assert not said(1.9)
            assert said(1.1).startswith("no image for 3 s; large images need the profile of docs/")
            assert node.health.report().level == 1
            node._on_image(Image())
            assert not said(1.0)
            assert said(5.0)
            node._on_image(Image())
            slow = "an image comes only every 3 s; check the rate of the camera"
            assert said(1.0) == said(4.0) == slow
            assert said(4.0).startswith("no image for 9 s")
            # Those that the middleware has lost it tells by an event.
            (stream,) = (s for s in node.subscriptions if s.topic_name == "/image_raw")
            kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
            (lost,) = (h.callback for h in stream.event_handlers if h.event_type == kind)
            lost(SimpleNamespace(total_count_change=4))
            assert node.health.report().values["lost"] == "4"
            # A camera that is not there is nobody's loss.
            monkeypatch.setattr(node, "count_publishers", lambda topic: 0)
            assert not said(100.0)
        camera.destroy_publisher(images)
        camera.destroy_node()
