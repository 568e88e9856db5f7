# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The nodes as processes over DDS, simulators in processes of their own."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device_process import Observer, device
from waiting import wait_until

from finger_common.stamps import header_stamp

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")


def test_force_node_streams_tares_when_asked_and_follows_its_lifecycle(
    observer: Observer, process: Any, free_port: Any
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from std_srvs.srv import Trigger

    port = free_port()
    raw = observer.listen(WrenchStamped, "wrench_raw")
    tared = observer.listen(WrenchStamped, "wrench")
    diagnostics = observer.listen(DiagnosticArray, "/diagnostics", 10, True)
    with device(
        "netcanoem", "--options", f"port={port}", "--wrench=0.1,0.2,-1.5,0.001,0.002,0"
    ) as board:
        child = process(
            "-m", "finger_driver.force_node", "--ros-args",
            "-p", "can_interface:=udp_multicast", "-p", f"can_options:='port={port}'",
            "-p", "response_timeout:=0.2",
        )  # fmt: skip
        observer.until(lambda: len(raw) > 200 and tared, what="wrench_raw and wrench")
        stamps = np.array([header_stamp(m) for m in raw[-200:]])
        assert np.all(np.diff(stamps) > 0)
        assert abs(stamps[-1] - time.time_ns()) < 5e9
        assert tared[-1].wrench.force.z == pytest.approx(-1.5, abs=0.03), "tared unasked"
        assert raw[-1].header.frame_id == "force_sensor"

        def health(wanted: str) -> bool:
            """Whether the diagnostics say that the force has a zero, or that it needs one."""
            newest = [s for a in diagnostics for s in a.status if "force: force" in s.name][-1:]
            values = {v.key: v.value for s in newest for v in s.values}
            return values.get("tared") == wanted

        observer.until(lambda: health("no"), what="tare needed")

        def tare() -> str | None:
            answer = observer.call(Trigger, "/force/tare", Trigger.Request())
            # A busy machine may deliver too few samples for one.
            assert answer.success or "samples came" in answer.message, answer.message
            return str(answer.message) if answer.success else None

        # The normal axis is -z: what was shown before is 1.50 N.
        told = re.fullmatch(r"Zero set \(was (.*) N\)", observer.until(tare, what="tare"))
        assert told and float(told[1]) == pytest.approx(1.5, abs=0.03)
        observer.until(lambda: health("yes"), what="the end of the need")
        count = len(tared)
        observer.until(lambda: len(tared) > count + 300, what="tared wrench")
        assert np.mean([m.wrench.force.z for m in tared[-100:]]) == pytest.approx(0, abs=0.005)
        assert raw[-1].wrench.force.z == pytest.approx(-1.5, abs=0.03)

        answer = observer.call(Trigger, "/force/reset_tare", Trigger.Request())
        assert answer.success
        observer.until(lambda: health("no"), what="tare needed again")
        count = len(tared)
        observer.until(lambda: len(tared) > count + 300, what="wrench without tare")
        assert tared[-1].wrench.force.z == pytest.approx(-1.5, abs=0.03)

        board.say("saturated -1")
        time.sleep(0.2)
        answer = observer.call(Trigger, "/force/tare", Trigger.Request())
        assert not answer.success and "faults" in answer.message
        board.say("clear")

        status = observer.until(
            lambda: [
                s
                for a in diagnostics
                for s in a.status
                if "force: force" in s.name and "FT01234" in s.hardware_id
            ],
            what="diagnostics",
        )[-1]  # fmt: skip
        keys = {v.key for v in status.values}
        assert {"measured_rate_hz", "expected_rate_hz", "last_error", "interval_jitter_ms"} <= keys

        def change(transition: int) -> bool:
            request = ChangeState.Request(transition=Transition(id=transition))
            return bool(observer.call(ChangeState, "/force/change_state", request).success)

        assert change(Transition.TRANSITION_DEACTIVATE)
        observer.until(lambda: True)
        time.sleep(0.3)
        for _ in range(500):
            observer._executor.spin_once(timeout_sec=0.0)
        count = len(raw)
        end = time.monotonic() + 0.5
        observer.until(lambda: time.monotonic() > end)
        assert len(raw) == count, "an inactive node published"
        answer = observer.call(Trigger, "/force/tare", Trigger.Request())
        assert not answer.success and "not active" in answer.message
        assert change(Transition.TRANSITION_CLEANUP)
        assert change(Transition.TRANSITION_CONFIGURE)
        assert change(Transition.TRANSITION_ACTIVATE)
        observer.until(lambda: len(raw) > count + 50, what="wrench after cleanup and new start")
    assert child.poll() is None, child.output.read_text()


def test_force_node_refuses_a_tare_while_something_is_held(
    observer: Observer, process: Any, free_port: Any
) -> None:
    """In place of the board with an empty plate comes the same board with 1 N on it."""
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    port = free_port()
    tared = observer.listen(WrenchStamped, "wrench")
    process(
        "-m", "finger_driver.force_node", "--ros-args",
        "-p", "can_interface:=udp_multicast", "-p", f"can_options:='port={port}'",
        "-p", "response_timeout:=0.2",
    )  # fmt: skip

    def tare() -> tuple[bool, str] | None:
        answer = observer.call(Trigger, "/force/tare", Trigger.Request())
        # A busy machine may deliver too few samples for one.
        told = None if "samples came" in answer.message else (answer.success, answer.message)
        return told

    for force, words in (
        (-0.4, ["Zero set"]),
        (-1.4, ["not tared: the force moved by 1.0", "was"]),
    ):
        with device("netcanoem", "--options", f"port={port}", f"--wrench=0,0,{force},0,0,0"):
            count = len(tared)
            observer.until(lambda count=count: len(tared) > count + 300, what="wrench")
            for said in words:
                success, message = observer.until(tare, what="tare")
                assert said in message and success is ("not tared" not in said), message
    assert "was 1.0" in message


@contextmanager
def force_node(domain: int, load: np.ndarray) -> Iterator[tuple[Any, Any]]:
    """A node in this process, and the board that it reads, with this wrench (6,) on it."""
    from finger_driver.can_bus import open_bus
    from finger_driver.simulators.netcanoem import NetcanoemSimulator

    channel = f"domain {domain}"
    bus = open_bus("virtual", channel)
    simulator = NetcanoemSimulator(bus, force=lambda stamp: load)
    simulator.owns_bus = True
    with node_of(domain, simulator, channel, calibration_check_period=0.05) as node:
        yield node, simulator


@contextmanager
def node_of(domain: int, simulator: Any, channel: str, **parameters: Any) -> Iterator[Any]:
    """A node in this process for a simulated sensor on a bus within it."""
    from rclpy.parameter import Parameter

    from finger_driver.force_node import ForceNode

    with simulator:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        parameters |= {"can_interface": "virtual", "can_channel": channel}
        overrides = [Parameter(k, value=v) for k, v in parameters.items()]
        node = ForceNode(context=context, parameter_overrides=overrides)
        try:
            assert node.bring_up()
            yield node
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)


def test_a_tare_ends_with_the_calibration_that_it_was_made_in(ros_domain: int) -> None:
    """In place of the board comes one with another transducer, 1 N on it as before."""
    from std_srvs.srv import Trigger

    from finger_driver.simulators.netcanoem import default_calibration

    with force_node(ros_domain, np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])) as (node, simulator):
        wait_until(lambda: node._on_tare(Trigger.Request(), Trigger.Response()).success, "a tare")
        wait_until(lambda: abs(node._newest[2]) < 0.02, "a tared force")
        simulator.slots[0] = default_calibration(1)
        simulator.power_cycle()
        wait_until(lambda: "tare_void" in node.device.health.faults, "the end of the tare")
        wait_until(lambda: abs(node._newest[2] + 1.0) < 0.02, "a force without tare")
        assert node.device.health.notes["tared"] == "no"


@pytest.mark.parametrize(
    ("before", "after", "kept"),
    [(-0.4, -3.4, False), (-1.4, -1.35, True), (-1.4, -0.4, True), (-1.4, -0.9, False)],
    ids=["another sensor", "loose plug", "finger lifted meanwhile", "finger pressed less"],
)
def test_a_lost_connection_ends_a_zero_that_the_force_does_not_confirm(
    ros_domain: int, before: float, after: float, kept: bool
) -> None:
    """A Robotous RFT, which tells no serial number; its zero is at -0.4 N."""
    from std_srvs.srv import Trigger

    from finger_driver.simulators.rft import RftOptions, RftSimulator

    channel = f"domain {ros_domain}"
    sensor = RftSimulator(RftOptions(interface="virtual", channel=channel))

    def load(force: float) -> None:
        sensor._force = lambda stamp: np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])

    load(-0.4)
    with node_of(ros_domain, sensor, channel, device="dbc") as node:
        health, sent, send = node.device.health, [], node._local.send

        def keep(stamp: int, force: tuple[float, ...], *rest: Any) -> Any:
            sent.append(force[2])
            return send(stamp, force, *rest)

        node._local.send = keep
        wait_until(lambda: node._on_tare(Trigger.Request(), Trigger.Response()).success, "a tare")
        load(before)
        wait_until(lambda: abs(node._newest[2] - before - 0.4) < 0.06, "the step of the force")
        sensor.faults.set("silent")
        wait_until(lambda: "connection" in health.faults, "the lost connection")
        number = len(sent)
        load(after)
        sensor.faults.clear()
        wait_until(
            lambda: health.counters["reconnects"] and len(sent) > number + 50, "samples again"
        )
        zero = 0.4 if kept else 0.0
        # Not one sample is given with a zero that turned out to be wrong.
        assert np.abs(np.array(sent[number:]) - after - zero).max() < 0.06
        assert health.notes["tared"] == ("yes" if kept else "no")
        told = health.faults.get("tare_void", "")
        assert (f"reads {abs(after + 0.4):.1f}" in told) is not kept


def test_a_force_beyond_the_sensors_range_is_not_published(ros_domain: int) -> None:
    with force_node(ros_domain, np.array([0.0, 0.0, -150.0, 0.0, 0.0, 0.0])) as (node, _):
        wait_until(lambda: "implausible" in node.device.health.faults, "the fault")
        assert not node._newest


def test_camera_node_publishes_every_frame_with_its_calibration(
    observer: Observer, process: Any, tmp_path: Path
) -> None:
    """1280×1024 at 10 Hz, best effort: too small a shared memory lost two in three images."""
    from sensor_msgs.msg import CameraInfo, Image
    from sensor_msgs.srv import SetCameraInfo

    images = observer.listen(Image, "image_raw", 50)
    infos = observer.listen(CameraInfo, "camera_info", 200)
    frames, url = tmp_path / "frames", tmp_path / "ftir.yaml"
    with device("images", frames, "--keep", 300):
        process(
            "-m", "finger_driver.camera_node", "--ros-args",
            "-p", "device:=folder", "-p", f"path:={frames}", "-p", "camera_name:=ftir",
            "-p", "image_time_offset:=-0.25",
            env={"ROS_HOME": str(tmp_path)},
        )  # fmt: skip
        observer.until(lambda: images and infos, what="image_raw")
        images.clear()
        infos.clear()
        observer.until(lambda: len(infos) >= 20, what="twenty frames")
        observer.until(
            lambda: images and header_stamp(images[-1]) >= header_stamp(infos[19]),
            what="their images",
        )
        assert images[0].encoding == "mono8" and images[0].step == 1280
        assert (images[0].height, images[0].width, len(images[0].data)) == (1024, 1280, 1280 * 1024)
        received = [header_stamp(m) + 250_000_000 for m in images]
        written = {int(p.name.split("_")[0]) for p in frames.glob("*.pgm")}
        assert set(received) <= written, "stamp is not acquisition plus offset"
        # Each image goes with a small message of the same stamp; a skipped one is not sent.
        sent = {header_stamp(m) for m in infos}
        arrived = sent & {header_stamp(m) for m in images}
        assert len(arrived) >= 0.8 * len(sent), f"{len(sent) - len(arrived)} images were lost"
        assert infos[-1].k[0] == 0.0 and infos[-1].width == 1280

        request = SetCameraInfo.Request()
        request.camera_info.width, request.camera_info.height = 1280, 1024
        request.camera_info.k = [1000.0, 0.0, 640.0, 0.0, 1000.0, 512.0, 0.0, 0.0, 1.0]
        request.camera_info.distortion_model = "plumb_bob"
        answer = observer.call(SetCameraInfo, "/camera/set_camera_info", request)
        assert answer.success, answer.status_message
        assert (tmp_path / "camera_info" / "ftir.yaml").exists() and not url.exists()
        infos.clear()
        observer.until(lambda: infos and infos[-1].k[0] == 1000.0, what="the new calibration")


def test_moisture_node_publishes_readings_and_what_the_operator_enters(
    observer: Observer, process: Any, tmp_path: Path
) -> None:
    from std_msgs.msg import Float64

    from finger_msgs.msg import Moisture
    from finger_msgs.srv import SetMoisture

    readings = observer.listen(Moisture, "moisture", latched=True)
    link = tmp_path / "port"
    with device("serial", "--link", link) as probe:
        process(
            "-m", "finger_driver.moisture_node", "--ros-args",
            "-p", "device:=serial", "-p", f"path:={link}",
        )  # fmt: skip
        client = observer.node.create_client(SetMoisture, "/moisture/set_moisture")
        observer.until(client.service_is_ready, what="the node")

        def enter(value: float) -> Any:
            request = SetMoisture.Request(value=value, phase=Moisture.PHASE_AFTER)
            return observer.call(SetMoisture, "/moisture/set_moisture", request)

        observer.until(lambda: enter(55.0).success, what="an active node")
        observer.until(lambda: readings, what="the entered reading")
        connected = time.monotonic()
        # Sooner it could be the rest of a line.
        observer.until(lambda: time.monotonic() > connected + 0.2)
        probe.say("send 42 before")
        observer.until(lambda: len(readings) == 2, what="the serial reading")
        refused = enter(140.0)
        assert not refused.success and "0 … 130" in refused.message
        publisher = observer.node.create_publisher(Float64, "/moisture/entered", 10)
        observer.until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(Float64(data=60.0))
        observer.until(lambda: len(readings) == 3, what="the reading from the topic")
    assert [(m.value, m.index, m.source) for m in readings] == [
        (55.0, 0, "manual"), (42.0, 1, "serial"), (60.0, 2, "manual"),
    ]  # fmt: skip
    assert readings[0].flags == Moisture.FLAG_MANUAL and readings[1].flags == 0
    assert [m.phase for m in readings] == [2, 1, 0]


def test_a_reading_that_is_not_published_is_not_confirmed(ros_domain: int) -> None:
    """One of a table written by a computer whose clock is ahead does not keep later ones out."""
    from finger_driver.moisture import Reading
    from finger_driver.moisture_node import MoistureNode
    from finger_msgs.srv import SetMoisture

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = MoistureNode(context=context)
    try:
        assert node.bring_up()

        def enter() -> Any:
            return node._on_set_moisture(SetMoisture.Request(value=64.0), SetMoisture.Response())

        node.on_sample(Reading(time.time_ns() + 31 * 86400 * 10**9, 42.0, 0))
        assert "42 a.u. is stamped 26784" in node.device.health.faults["ahead"]
        assert enter().success
        node._stamps.accept(time.time_ns() + 60 * 10**9)
        refused = enter()
        assert not refused.success and "older than the one of this source before" in refused.message
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_readings_of_a_table_saved_after_one_was_entered_are_not_lost(
    ros_domain: int, tmp_path: Path
) -> None:
    from rclpy.parameter import Parameter

    from finger_driver.moisture import Reading
    from finger_driver.moisture_node import MoistureNode
    from finger_msgs.srv import SetMoisture

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    parameters = {"device": "export", "path": str(tmp_path / "readings.csv")}
    overrides = [Parameter(k, value=v) for k, v in parameters.items()]
    node = MoistureNode(context=context, parameter_overrides=overrides)
    try:
        assert node.bring_up()
        response = SetMoisture.Response()
        assert node._on_set_moisture(SetMoisture.Request(value=44.0), response).success
        for age, value in ((20, 41.0), (12, 43.0), (30, 40.0)):
            node.on_sample(Reading(time.time_ns() - age * 10**9, value, 0))
        assert node.device.health.report().values["samples"] == "3"
        assert "40 a.u. is older than the one of this" in node.device.health.faults["backwards"]
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"can_interface": "nonsense"}, "can_interface 'nonsense'"),
        ({"can_interface": "virtual", "connect_timeout": 0.1}, "no answer"),
        ({"device": "dbc", "dbc_mapping": "/none.yaml"}, "/none.yaml"),
        ({"rate": -1.0}, "'rate'"),
    ],
)
def test_a_node_that_cannot_be_configured_names_the_reason_and_stays(
    ros_domain: int, parameters: dict[str, Any], message: str, capfd: Any
) -> None:
    from rclpy.parameter import Parameter

    from finger_driver.force_node import ForceNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    try:
        overrides = [Parameter(k, value=v) for k, v in parameters.items()]
        node = ForceNode(context=context, parameter_overrides=overrides)
        assert not node.bring_up()
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    errors = [line for line in capfd.readouterr().err.splitlines() if "configure failed" in line]
    assert len(errors) == 1 and message in errors[0]


def test_the_command_has_an_example_and_refuses_in_one_line(tmp_path: Path, capsys: Any) -> None:
    from finger_common import cli
    from finger_driver.simulators.cli import _main

    with pytest.raises(SystemExit):
        cli.run(_main, ["--help"])
    told = capsys.readouterr().out
    assert "Run one simulated device. DEVICE is one of the installed simulators:" in told
    assert "example:" in told and "`" not in told
    (tmp_path / "bad.csv").write_text("time_s,force_n\n0,1\n0,2\n")
    for arguments in (
        ("netcanoem", "--wrench", "1,2"),
        ("netcanoem", "--csv", tmp_path / "bad.csv"),
        ("netcanoem", "--csv", tmp_path / "bad.csv", "--press", "1"),
        ("netcanoem", "--base", "0x80"),
        ("images", tmp_path / "f", "--size", "huge"),
        ("netcanoem", "--interface", "nonsense"),
    ):
        assert cli.run(_main, [str(a) for a in arguments]) == 2
        error = capsys.readouterr().err
        assert len(error.strip().splitlines()) == 1, error


@contextmanager
def camera_node(domain: int, folder: Path) -> Iterator[tuple[Any, Path]]:
    """A node in this process that is not yet configured, and its calibration file."""
    from rclpy.parameter import Parameter

    from finger_driver.camera_node import CameraNode

    path = folder / "camera.yaml"
    (folder / "spool").mkdir()
    values = {
        "device": "folder",
        "path": str(folder / "spool"),
        "camera_info_url": path.as_uri(),
        "frame_prefix": "thumb/",
    }
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    node = CameraNode(context=context, parameter_overrides=overrides)
    try:
        yield node, path
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_the_camera_waits_for_a_calibration_that_is_being_written(
    ros_domain: int, tmp_path: Path
) -> None:
    import threading

    from rclpy.lifecycle import TransitionCallbackReturn

    from finger_driver.camera.info import CameraCalibration

    with camera_node(ros_domain, tmp_path) as (node, path):
        written = threading.Timer(0.5, CameraCalibration(640, 480).save, (path,))
        written.start()
        assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
        written.join()
        assert node.frame == "thumb/camera_optical"
        node.trigger_cleanup()


def test_set_camera_info_refuses_what_would_spoil_the_calibration_and_keeps_the_file(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno

    from sensor_msgs.srv import SetCameraInfo

    from finger_common import files
    from finger_driver.camera import Frame
    from finger_driver.camera.info import CameraCalibration

    with camera_node(ros_domain, tmp_path) as (node, path):
        CameraCalibration(32, 24).save(path)
        node.trigger_configure()

        def ask(width: int, height: int, focal_length: float) -> tuple[bool, str]:
            request = SetCameraInfo.Request()
            info = request.camera_info
            info.width, info.height, info.distortion_model = width, height, "plumb_bob"
            info.k[0] = info.k[4] = focal_length
            response = node._on_set_camera_info(request, SetCameraInfo.Response())
            return response.success, response.status_message

        def refuse(*request: Any, why: str) -> None:
            before = path.read_bytes()
            success, message = ask(*request)
            assert not success and why in message and "\n" not in message, message
            assert path.read_bytes() == before and list(tmp_path.glob(".camera*")) == []

        refuse(0, 0, 0.0, why="camera_info: image size 0×0 is not above zero")
        refuse(32, 24, 0.0, why="camera_info: focal lengths 0 and 0 (K) are not above zero")
        assert ask(64, 48, 100.0)[0], "no image has come whose size could differ"
        node.on_sample(Frame(time.time_ns(), np.zeros((24, 32), np.uint8), 1))
        refuse(64, 48, 100.0, why="it is for 64×48, images are 32×24")
        assert ask(32, 24, 100.0) == (True, f"written to {path}")
        assert CameraCalibration.load(path).k[0] == 100.0

        def fail(*names: Any) -> None:
            raise OSError(errno.EIO, "Input/output error")

        with monkeypatch.context() as broken:
            broken.setattr(files.os, "replace", fail)
            refuse(32, 24, 200.0, why="Input/output error")
        path.write_text(path.read_text() + "area_per_pixel: 1.0e-9\n")
        refuse(32, 24, 200.0, why="is a plate calibration")
        node.trigger_cleanup()


def test_a_simulated_press_is_a_press_to_the_nodes() -> None:
    """Simulator and nodes agree on the axis, so that a newcomer's first try shows contacts."""
    from finger_common.axes import normal_force
    from finger_driver.force_node import ForceNodeSettings
    from finger_driver.simulators.values import LoadOptions

    load = LoadOptions(press=1.35).load()
    wrenches = np.array([load(round(t * 1e9)) for t in np.linspace(0, 4, 81)])
    force = normal_force(wrenches[:, :3], ForceNodeSettings().normal_axis)
    assert force.max() == pytest.approx(1.35, rel=1e-3) and force.min() >= 0.0
