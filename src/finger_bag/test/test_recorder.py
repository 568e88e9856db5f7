# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recording: nothing lost, nothing re-encoded, complete files after every fault."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_messages import IMAGE, WRENCH, serialized
from service_calls import answer
from session_bags import START, image

from finger_bag.copying import recover
from finger_bag.definitions import encode
from finger_bag.reader import open_bag
from finger_bag.recorder import Recorder, RecorderSettings, Serialized
from finger_common.errors import InputError


def test_everything_put_in_is_in_the_bag_as_it_came(tmp_path: Path) -> None:
    recorder = Recorder()
    messages = [serialized(i) for i in range(5000)]
    recorder.start(tmp_path / "bag", {"subject": "S01"}, {"/finger/wrench": WRENCH})
    assert all(recorder.put(m) for m in messages)
    result = recorder.stop()
    assert (result.message_count, result.lost_count, result.error) == (5000, 0, "")
    with open_bag(tmp_path / "bag") as reader:
        found = [(m.raw, m.log_time_ns, m.publish_time_ns, m.sequence) for m in reader.messages()]
        assert reader.info.complete and reader.info.metadata.subject == "S01"
    assert found == [(m.cdr, m.log_time_ns, m.publish_time_ns, m.sequence) for m in messages]


def test_recordings_follow_one_another_and_refuse_to_overlap(tmp_path: Path) -> None:
    recorder = Recorder()
    with pytest.raises(InputError, match="nothing is being recorded"):
        recorder.stop()
    for name in ("a", "b"):
        recorder.start(tmp_path / name)
        with pytest.raises(InputError, match="stop it first"):
            recorder.start(tmp_path / "c")
        recorder.put(serialized(1))
        assert recorder.stop().message_count == 1
    with pytest.raises(InputError, match="exists already"):
        recorder.start(tmp_path / "a")
    assert not recorder.put(serialized(2))


def test_what_does_not_fit_the_queue_is_counted_as_lost(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="queue_limit"):
        RecorderSettings(queue_limit=0)
    settings = RecorderSettings()
    object.__setattr__(settings, "queue_limit", 0)
    recorder = Recorder(settings)
    recorder.start(tmp_path / "bag")
    taken = sum(recorder.put(serialized(i)) for i in range(2000))
    result = recorder.stop()
    assert result.message_count == taken
    assert result.lost == {"/finger/wrench": 2000 - taken} and taken < 2000


def test_a_message_that_is_not_cdr_is_counted_as_lost(tmp_path: Path) -> None:
    recorder = Recorder()
    recorder.start(tmp_path / "bag")
    for number in range(3):
        recorder.put(serialized(number))
        recorder.put(serialized(number, "/finger/odd")._replace(cdr=b"\x01\x00\x00\x00"))
    result = recorder.stop()
    assert result.lost == {"/finger/odd": 3} and not result.error
    assert result.message_count == 3
    with open_bag(tmp_path / "bag") as reader:
        assert [m.sequence for m in reader.messages()] == [0, 1, 2]


def test_images_are_stored_as_png_without_loss(tmp_path: Path) -> None:
    from finger_vision.messages import image_of

    recorder = Recorder(RecorderSettings(png=True))
    recorder.start(tmp_path / "bag")
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64), dtype=np.uint8)
    fields = {**image(START, 0.0), "height": 48, "width": 64, "step": 64, "data": pixels.ravel()}
    recorder.put(Serialized("/finger/image_raw", IMAGE, encode(IMAGE, fields), START, START))
    colour = {**fields, "encoding": "bgr8", "step": 192, "data": np.zeros(9216, np.uint8)}
    recorder.put(Serialized("/finger/image_raw", IMAGE, encode(IMAGE, colour), START, START))
    assert recorder.stop().lost_count == 0
    with open_bag(tmp_path / "bag") as reader:
        png, raw = sorted(reader.messages(), key=lambda m: m.topic, reverse=True)
        assert png.topic == "/finger/image_raw/compressed" and "png" in png.message.format
        assert png.message.header.frame_id == "camera"
        assert np.array_equal(image_of(png.message), pixels)
        # What is not mono8 is kept as it came.
        assert raw.topic == "/finger/image_raw" and raw.message.encoding == "bgr8"


def test_nearly_full_disk_closes_the_bag_cleanly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors: list[str] = []
    recorder = Recorder(RecorderSettings(flush_interval=0.05, minimum_free=1 << 20), errors.append)
    recorder.start(tmp_path / "bag")
    recorder.put(serialized(0))
    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr("finger_bag.recorder.shutil.disk_usage", lambda path: usage)
    end = time.monotonic() + 20
    number = 1
    while not errors and time.monotonic() < end:
        recorder.put(serialized(number))
        number += 1
        time.sleep(0.002)
    assert "nearly full" in errors[0] and not recorder.recording
    assert not recorder.put(serialized(number))
    result = recorder.stop()
    assert "nearly full" in result.error and result.lost_count >= 1
    with open_bag(tmp_path / "bag") as reader:
        assert reader.info.complete
        assert len(list(reader.messages())) == result.message_count > 0
    with pytest.raises(InputError, match="make room"):
        recorder.start(tmp_path / "other")


LIMITED = """
import resource, signal, sys
sys.path.insert(0, sys.argv[2])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
import time
from finger_bag.recorder import Recorder, RecorderSettings
from recorded_messages import serialized
recorder = Recorder(RecorderSettings(flush_interval=0.05, compression="none"))
recorder.start(sys.argv[1])
for i in range(20000):
    recorder.put(serialized(i))
    if i % 200 == 0:
        time.sleep(0.01)
print(recorder.stop().error)
"""


def test_failing_disk_leaves_whole_records(tmp_path: Path) -> None:
    """A file that cannot grow beyond 200 kB stands for a disk that is full at once."""
    out = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path / "bag"), str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "recording ended" in out.stdout, out.stderr
    made = recover(tmp_path / "bag", tmp_path / "whole")
    assert made.message_count > 500
    assert made.problems and all("not closed" in p or "metadata" in p for p in made.problems)


KILLED = """
import mmap, sys, time
sys.path.insert(0, sys.argv[2])
from finger_bag.recorder import Recorder
from finger_bag.definitions import encode
from finger_bag.recorder import Serialized
from session_bags import image
from recorded_messages import serialized, IMAGE
recorder = Recorder()
recorder.start(sys.argv[1])
with open(sys.argv[3], "r+b") as file:
    last = mmap.mmap(file.fileno(), 8)
number, begin = 0, time.monotonic()
picture = encode(IMAGE, image(0, 1e-4, 512))
while True:
    while number < (time.monotonic() - begin) * 500:
        now = time.time_ns()
        recorder.put(serialized(number)._replace(log_time_ns=now))
        last[:] = now.to_bytes(8, "little")
        if number % 50 == 0:
            now = time.time_ns()
            recorder.put(Serialized("/finger/image_raw", IMAGE, picture, now, now))
        number += 1
        if number == 200:
            print("running", flush=True)
    time.sleep(0.001)
"""


@pytest.mark.parametrize("after", [0.3, 0.77, 1.41])
def test_killed_recorder_loses_at_most_a_second_and_recover_completes_the_bag(
    tmp_path: Path, after: float
) -> None:
    path, last = tmp_path / "bag", tmp_path / "last"
    last.write_bytes(bytes(8))
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path), str(Path(__file__).parent), str(last)],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert child.stdout is not None and child.stdout.readline() == "running\n"
        time.sleep(after)
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
    with open_bag(path) as reader:
        assert not reader.info.complete
        before = list(reader.messages(["/finger/wrench"]))
        assert any("not closed" in p for p in reader.all_problems())
    made = recover(path, tmp_path / "whole")
    with open_bag(tmp_path / "whole") as reader:
        assert reader.info.complete and reader.all_problems() == []
        found = list(reader.messages(["/finger/wrench"]))
        assert reader.info.topics["/finger/wrench"].count == len(found) == len(before)
    numbers = [m.sequence for m in found]
    assert numbers == list(range(len(numbers)))  # nothing but the end is missing
    last_ns = int.from_bytes(last.read_bytes(), "little")
    assert last_ns - found[-1].log_time_ns < 1_000_000_000
    assert made.message_count > len(found)
    # The repaired bag opens in an independent reader.
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "whole"]) as theirs:
        assert theirs.message_count == made.message_count == len(list(theirs.messages()))


def spin_until(condition: Callable[[], Any], node: Any, seconds: float = 90.0) -> Any:
    import rclpy

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        rclpy.spin_once(node, timeout_sec=0.02)
    raise AssertionError("nothing came in time")


def test_recorder_node_records_serialized_messages_over_dds(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    rclpy = pytest.importorskip("rclpy")
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile
    from rclpy.serialization import serialize_message

    from finger_common.node import STATE_QOS
    from finger_msgs.msg import Trial
    from finger_msgs.srv import Record

    calibration = tmp_path / "plate.yaml"
    calibration.write_text("a: 1\n")
    child = process(
        "-m",
        "finger_bag.recorder_node",
        "--ros-args",
        "-r",
        "__ns:=/finger",
        "-p",
        f"folder:={tmp_path}",
        "-p",
        f"calibration_file:={calibration}",
        "-p",
        # Nothing may be lost between here and there, however busy the machine is.
        "qos_reliability:=reliable",
    )
    rclpy.init(domain_id=ros_domain)
    try:
        node = rclpy.create_node("rig", namespace="/finger")
        forces = node.create_publisher(WrenchStamped, "wrench", QoSProfile(depth=1000))
        trials = node.create_publisher(Trial, "trial", STATE_QOS)
        written: list[int] = []
        sent: list[bytes] = []

        def on_diagnostics(array: DiagnosticArray) -> None:
            values = {v.key: v.value for status in array.status for v in status.values}
            written.append(int(values.get("messages", 0)))

        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        trials.publish(Trial(subject="S07", phase=3))
        client = node.create_client(Record, "recorder/record")
        spin_until(lambda: forces.get_subscription_count() == 1, node)
        spin_until(lambda: trials.get_subscription_count() == 1, node)

        def ask(command: int, path: str = "") -> Any:
            request = Record.Request(command=command, path=path)
            request.trial.subject, request.trial.condition = "S07", "dry"
            # Ending what does not run may be asked twice.
            repeat = not sent and command == 0
            return answer(client, request, lambda met: spin_until(met, node), repeat=repeat)

        assert not ask(0).success
        # The latched trial came before the recording: it is repeated at its head.
        assert trials.wait_for_all_acked(Duration(seconds=60))
        started = ask(1, "one")
        assert started.success and started.path == str(tmp_path / "one")
        assert "stop it first" in ask(1, "two").message
        for i in range(300):
            message = WrenchStamped()
            message.header.stamp.sec, message.header.stamp.nanosec = 100 + i // 500, i * 2_000_000
            message.wrench.force.z = -0.01 * i
            sent.append(serialize_message(message))
            forces.publish(message)
            time.sleep(0.001)
        spin_until(lambda: written and written[-1] >= 301, node)
        stopped = ask(0)
        assert stopped.success and stopped.lost_count == 0, stopped.message
        assert ask(1, "one").success is False  # never overwritten
        node.destroy_node()
    finally:
        rclpy.shutdown()
    child.send_signal(signal.SIGINT)
    assert child.wait(60) == 0, child.output.read_text()
    with open_bag(tmp_path / "one") as reader:
        found = list(reader.messages(["/finger/wrench"]))
        assert [m.message.wrench.force.z for m in found] == [-0.01 * i for i in range(300)]
        assert stopped.message_count == len(list(reader.messages()))
        assert [m.message.subject for m in reader.messages(["/finger/trial"])] == ["S07"]
        metadata = reader.info.metadata
        assert (metadata.subject, metadata.condition) == ("S07", "dry")
        assert reader.attachment("plate_calibration.yaml") == b"a: 1\n"


def test_a_recording_that_cannot_begin_ends_at_once_with_one_sentence(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    """A node of its own would wait to be corrected: nobody would see that nothing is recorded."""
    pytest.importorskip("rclpy")
    said = {
        ("--topics", "nosuch"): "'nosuch' is not in the bag schema",
        ("--topics", "wrench", "x=nosuch_msgs/msg/Y"): "'nosuch_msgs/msg/Y' is not installed",
        ("--topics", "a b=std_msgs/msg/Header"): "'a b' is not a topic name",
        ("--calibration", "missing.yaml"): "missing.yaml: no such file to attach",
        ("--minimum-free", str(1 << 60)): "make room or choose another disk",
        ("--namespace", "a b"): "namespace 'a b' is not one of ROS",
    }
    record = ("-m", "finger_common.entry", "finger_bag.cli", "record", "-o")
    children = {
        text: process(*record, str(tmp_path / str(number)), *options)
        for number, (options, text) in enumerate(said.items())
    }
    for text, child in children.items():
        assert child.wait(60) == 2
        output = child.output.read_text()
        assert text in output and output.count("\n") == 1 and output.startswith("finger")
    assert not any((tmp_path / str(number)).exists() for number in range(len(said)))


@pytest.mark.parametrize("main", ["finger_bag.recorder_node", "finger_bringup.composed_node"])
def test_a_terminal_that_is_closed_ends_a_recorder_with_its_bag_closed(
    ros_domain: int, process: Any, tmp_path: Path, main: str
) -> None:
    """Alone and among composed nodes; under nohup it records on."""
    pytest.importorskip("rclpy")
    member = ("/hand=finger_bag.recorder_node",) if "composed" in main else ()

    def recorder(name: str, **options: Any) -> Any:
        given = {"record_at_start": "true", "folder": tmp_path, "bag_name": name}
        parameters = (f"-p {key}:={value}" for key, value in given.items())
        words = " ".join(parameters).split()
        return process("-m", main, *member, "--ros-args", *words, **options)

    on_close = {"closed": signal.SIG_DFL, "nohup": signal.SIG_IGN}
    children = [
        recorder(name, preexec_fn=partial(signal.signal, signal.SIGHUP, action))
        for name, action in on_close.items()
    ]
    for child in children:
        while "recording into" not in child.output.read_text():
            assert child.poll() is None
            time.sleep(0.05)
        child.send_signal(signal.SIGHUP)
    assert children[0].wait(60) >= 0
    assert (tmp_path / "closed" / "metadata.yaml").is_file()
    assert "recorded 0 messages" in children[0].output.read_text()
    time.sleep(0.5)
    assert children[1].poll() is None
    children[1].send_signal(signal.SIGTERM)
    children[1].wait(60)
    assert (tmp_path / "nohup" / "metadata.yaml").is_file()
