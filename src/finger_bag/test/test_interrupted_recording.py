# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A recording that ends by itself: said aloud, every message accounted for, resumed when it can."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_messages import serialized
from waiting import wait_until

from finger_bag.copying import recover
from finger_bag.definitions import encode
from finger_bag.reader import open_bag
from finger_bag.recorder import Recorder, RecorderSettings
from finger_bag.recording_marker import RecordingMarker
from finger_common.errors import InputError

QUICK = RecorderSettings(flush_interval=0.05, minimum_free=0, compression="none")


class Feed:
    """Puts numbered messages into a recorder and counts them."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder, self.number = recorder, 0

    def __call__(self, number: int = 1) -> None:
        for _ in range(number):
            self.recorder.put(serialized(self.number))
            self.number += 1

    def slowly(self, number: int = 1) -> None:
        """The same, and a pause."""
        self(number)
        time.sleep(0.005)


def read(path: Path) -> list[int]:
    with open_bag(path) as reader:
        return [m.sequence for m in reader.messages(["/finger/wrench"])]


def test_a_disk_that_was_pulled_out_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(QUICK)
    feed = Feed(recorder)
    recorder.start(tmp_path / "a" / "bag")
    feed(100)
    shutil.rmtree(tmp_path / "a")
    wait_until(lambda: recorder.interrupted, "the interruption", spin=feed.slowly)

    def gone(path: Path) -> bool:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    (tmp_path / "a").mkdir()
    with monkeypatch.context() as patched:
        patched.setattr(Path, "exists", gone)
        with pytest.raises(InputError, match="cannot be reached"):
            recorder.resume()
    assert recorder.resume() == tmp_path / "a" / "bag_part2"
    recorder.stop()


def recording(
    bag: Path, metadata: dict[str, str] | None = None
) -> tuple[Recorder, Feed, list[str]]:
    """A recorder with messages in its file, what feeds it, and the errors that it tells."""
    errors: list[str] = []
    recorder = Recorder(QUICK, errors.append)
    feed = Feed(recorder)
    recorder.start(bag, metadata)
    feed(100)
    wait_until(lambda: recorder.counts, "messages in the file")
    return recorder, feed, errors


def test_a_removed_folder_is_noticed_and_the_recording_goes_on_beside_it(tmp_path: Path) -> None:
    recorder, feed, errors = recording(tmp_path / "a" / "bag", {"subject": "S01"})
    shutil.rmtree(tmp_path / "a")
    wait_until(lambda: errors, "the error", spin=feed.slowly)
    assert "removed or renamed" in errors[0] and not recorder.recording
    feed(20)
    # Where a disk was pulled out, its folder would be made anew on another one.
    for _ in range(2):
        with pytest.raises(InputError, match=r"a: the folder is gone; is its disk connected\?"):
            recorder.resume()
    assert "is its disk connected?" in recorder.interrupted and not (tmp_path / "a").exists()
    (tmp_path / "a").mkdir()
    assert recorder.resume() == tmp_path / "a" / "bag_part2" and recorder.recording
    resumed_at = feed.number
    feed(300)
    result = recorder.stop()
    assert "removed or renamed" in result.error and "continues in bag_part2" in result.error
    assert result.message_count + result.lost_count == feed.number
    assert read(tmp_path / "a" / "bag_part2") == list(range(resumed_at, feed.number))
    with open_bag(tmp_path / "a" / "bag_part2") as reader:
        assert reader.info.complete and reader.info.metadata.subject == "S01"


def test_nothing_is_written_where_a_disk_was_mounted_until_it_is_there_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The empty folder that is left is of another disk; the disk comes back by another number."""
    place = tmp_path / "disk"
    recorder, feed, errors = recording(place / "bag")
    place.rename(tmp_path / "pulled")
    place.mkdir()
    wait_until(lambda: errors, "the error", spin=feed.slowly)
    monkeypatch.setattr(recorder, "_device", -1)
    with pytest.raises(InputError, match=r"is its disk connected\?"):
        recorder.resume()
    assert not list(place.iterdir())
    place.rmdir()
    (tmp_path / "pulled").rename(place)
    assert recorder.resume() == place / "bag_part2"
    recorder.stop()


def test_what_a_removed_folder_held_is_lost_although_it_was_flushed(tmp_path: Path) -> None:
    recorder, feed, errors = recording(tmp_path / "bag")
    flushed = recorder.last_flush
    wait_until(lambda: recorder.last_flush > flushed, "the next flush", spin=feed.slowly)
    shutil.rmtree(tmp_path / "bag")
    wait_until(lambda: errors, "the error", spin=feed.slowly)
    result = recorder.stop()
    assert result.counts == {} and result.lost_count == feed.number


def test_a_renamed_folder_keeps_its_messages(tmp_path: Path) -> None:
    recorder, feed, errors = recording(tmp_path / "bag")
    (tmp_path / "bag").rename(tmp_path / "moved")
    wait_until(lambda: errors, "the error", spin=feed.slowly)
    result = recorder.stop()
    assert result.message_count + result.lost_count == feed.number
    recover(tmp_path / "moved", tmp_path / "whole")
    assert len(read(tmp_path / "whole")) >= 100


def test_it_resumes_only_when_there_is_room_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [1 << 40]
    monkeypatch.setattr(
        "finger_bag.recorder.shutil.disk_usage", lambda path: type("Usage", (), {"free": free[0]})
    )
    errors: list[str] = []
    recorder = Recorder(RecorderSettings(flush_interval=0.05, minimum_free=1 << 20), errors.append)
    feed = Feed(recorder)
    recorder.start(tmp_path / "bag")
    with pytest.raises(InputError, match="no recording was interrupted"):
        recorder.resume()
    free[0] = 1000
    wait_until(lambda: errors, "the error", spin=feed.slowly)
    feed(10)
    for room in (1000, 1 << 20):
        free[0] = room
        with pytest.raises(InputError, match="make room"):
            recorder.resume()
    assert "nearly full" in recorder.interrupted
    free[0] = 1 << 30
    recorder.resume()
    feed(50)
    result = recorder.stop()
    parts = [tmp_path / "bag", tmp_path / "bag_part2"]
    assert recorder.parts == parts and "nearly full" in result.error
    assert sum(len(read(p)) for p in parts) == result.message_count
    assert result.message_count + result.lost_count == feed.number and result.lost_count >= 10
    for path in parts:
        with open_bag(path) as reader:
            assert reader.info.complete
    recorder.start(tmp_path / "next")
    assert recorder.stop().error == ""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)]
    if os.geteuid() or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("a tmpfs can be mounted by root only")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_full_tmpfs_interrupts_and_room_resumes(small_disk: Path) -> None:
    errors: list[str] = []
    recorder = Recorder(QUICK, errors.append)
    feed = Feed(recorder)
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(700_000))
    recorder.start(small_disk / "bag")
    wait_until(lambda: errors, "the error", spin=lambda: feed.slowly(50))
    assert "No space left" in errors[0]
    ballast.unlink()
    feed(10)
    recorder.resume()
    feed(100)
    result = recorder.stop()
    assert result.message_count + result.lost_count == feed.number and result.lost_count >= 10
    whole = small_disk.parent / "whole"
    recover(small_disk / "bag", whole)
    found = len(read(whole)) + len(read(small_disk / "bag_part2"))
    assert found == result.message_count


LIMITED = """
import resource, signal, sys, time
sys.path.insert(0, sys.argv[2])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
from finger_bag.recorder import Recorder, RecorderSettings
from recorded_messages import serialized
recorder = Recorder(RecorderSettings(flush_interval=0.05, compression="none", minimum_free=0))
recorder.start(sys.argv[1])
for i in range(4000):
    recorder.put(serialized(i))
    if i % 100 == 0:
        time.sleep(0.01)
        if recorder.interrupted:
            recorder.resume()
result = recorder.stop()
print(len(recorder.parts), result.message_count, result.lost_count)
"""


def test_after_the_limit_of_a_file_it_goes_on_in_the_next(tmp_path: Path) -> None:
    out = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path / "bag"), str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    parts, recorded, lost = map(int, out.stdout.split())
    assert parts > 1 and recorded + lost == 4000, out.stderr
    found = 0
    for number, path in enumerate(sorted(tmp_path.glob("bag*"))):
        recover(path, tmp_path / f"whole{number}")
        found += len(read(tmp_path / f"whole{number}"))
    assert found == recorded > 1000


@pytest.mark.parametrize("name", ["/proc/bag", "/sys/a/bag", "x" * 300, "a\0b"])
def test_a_place_that_cannot_be_written_is_refused_in_one_sentence(
    tmp_path: Path, name: str
) -> None:
    with pytest.raises(InputError) as refused:
        Recorder(QUICK).start(tmp_path / name)
    assert "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_refused_and_left_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "note.txt").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        Recorder(QUICK).start(tmp_path / "bag")
    assert (tmp_path / "bag" / "note.txt").read_text() == "mine"


# The node ----------------------------------------------------------------------------------------


@pytest.fixture
def node(ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    with running_node(ros_domain, tmp_path, monkeypatch) as node:
        yield node


@contextmanager
def running_node(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **parameters: Any
) -> Iterator[Any]:
    rclpy = pytest.importorskip("rclpy")
    from rclpy.parameter import Parameter

    from finger_bag.recorder_node import RecorderNode

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    values = {
        "folder": str(tmp_path), "record_at_start": True, "minimum_free": 1, "flush_interval": 0.05,
        **parameters,
    }  # fmt: skip
    node = RecorderNode(
        context=context, parameter_overrides=[Parameter(k, value=v) for k, v in values.items()]
    )
    assert node.bring_up()
    try:
        yield node
    finally:
        node.release()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_the_node_says_so_until_it_records_again(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    assert rclpy.ok(context=node.context)
    health, recorder = node.healths[0], node._recorder

    def spin() -> None:
        executor.spin_once(timeout_sec=0.05)

    monkeypatch.setattr("finger_bag.recorder_node._REMINDER", 0.5)
    with monkeypatch.context() as full:
        full.setattr(
            "finger_bag.recorder.shutil.disk_usage", lambda path: type("Usage", (), {"free": 0})
        )
        shutil.rmtree(recorder.path)
        wait_until(lambda: recorder.interrupted, "the interruption", spin=spin)
        report = health.report()
        assert report.level == 2 and report.message.startswith("NOT RECORDING")
        wait_until(
            lambda: capfd.readouterr().err.count("NOT RECORDING") >= 1, "a reminder", spin=spin
        )
        wait_until(lambda: capfd.readouterr().err.count("NOT RECORDING") >= 1, "another", spin=spin)
    wait_until(lambda: recorder.recording, "the continuation", spin=spin)
    report = health.report()
    assert report.level == 1 and "it continues in" in report.message
    result = node._finish()
    assert result.error and node.exit_code == 1
    assert recorder.parts[1].is_dir() and recorder.parts[1].name.endswith("_part2")
    executor.shutdown()


def test_a_recording_that_was_ended_while_interrupted_forbids_no_other(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk was full; whoever reads an error would not begin the next bag, which ends it."""
    health, recorder = node.healths[0], node._recorder
    with monkeypatch.context() as full:
        full.setattr(
            "finger_bag.recorder.shutil.disk_usage", lambda path: type("Usage", (), {"free": 0})
        )
        shutil.rmtree(recorder.path)
        wait_until(lambda: recorder.interrupted, "the interruption")
        node._watch_interruption()
        assert health.report().level == 2
        assert node._finish().error
        report = health.report()
        assert report.level == 1 and "the recording is not complete" in report.message
        assert report.values["recording"] == "no"
    started = node._start(str(tmp_path / "next"), None)
    report = health.report()
    assert (report.level, report.values["recording"]) == (0, str(started))


def test_an_interruption_that_can_be_resumed_at_once_is_reported_first(
    node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    published: list[tuple[int, str]] = []

    def publish() -> None:
        report = node.healths[0].report()
        published.append((report.level, report.message))

    monkeypatch.setattr(node, "publish_diagnostics", publish)
    shutil.rmtree(node._recorder.path)
    wait_until(
        lambda: len(node._recorder.parts) == 2,
        "the continuation",
        spin=lambda: executor.spin_once(timeout_sec=0.05),
    )
    assert any(level == 2 and text.startswith("NOT RECORDING") for level, text in published)
    executor.shutdown()


FOREIGN: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda raw: raw[:6],
    "empty": lambda raw: b"",
    "another representation": lambda raw: b"\x00\x07" + raw[2:],
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_a_message_of_another_format_is_named_and_the_recording_goes_on(
    node: Any, kind: str
) -> None:
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.serialization import serialize_message

    talker = rclpy.create_node("talker", context=node.context)
    publisher = talker.create_publisher(WrenchStamped, "/wrench", 10)
    path = node._recorder.path
    wait_until(publisher.get_subscription_count, "the recorder")
    good = serialize_message(WrenchStamped())
    for raw in (good, FOREIGN[kind](good), good):
        publisher.publish(raw)
        time.sleep(0.1)
        node._poll()
    node.publish_diagnostics()
    report = node.healths[0].report()
    assert report.level == 1 and "messages on '/wrench' cannot be read (1 " in report.message
    assert report.values["unreadable"] == "/wrench 1"
    # Whatever can be in a bag is kept as it came.
    assert node._finish().counts["/wrench"] == (2 if kind == "empty" else 3)
    with open_bag(path) as reader:
        assert [m.raw for m in reader.messages()].count(good) == 2 and reader.info.complete
    talker.destroy_node()


def test_a_bag_is_closed_although_its_last_messages_cannot_be_taken(
    node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise RuntimeError("the middleware")

    path = node._recorder.path
    monkeypatch.setattr(node, "_poll", fail)
    node.trigger_deactivate()
    with open_bag(path) as reader:
        assert reader.info.complete and (path / "metadata.yaml").is_file()


KILLED = """
import os, signal, sys, time
import rclpy
from rclpy.parameter import Parameter
from finger_bag.definitions import encode
from finger_bag.recorder_node import RecorderNode
from finger_msgs.msg import Trial
rclpy.init()
node = RecorderNode(parameter_overrides=[Parameter("folder", value=sys.argv[1])])
assert node.bring_up()
node._start("trial", Trial(session=sys.argv[2], subject="S01"))
raw = encode("geometry_msgs/msg/WrenchStamped", {})
for number in range(100):
    node._take(node._topics["/wrench"], raw, {})
while node._recorder.counts.get("/wrench", 0) < 100:
    time.sleep(0.01)
node._recorder._writer.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_recorder(folder: Path, domain: int, session: str = "") -> Path:
    """The bag of a recorder that was killed after 100 wrenches. session: of a guided trial."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    call = [sys.executable, "-c", KILLED, str(folder), session]
    subprocess.run(call, env=environment, timeout=120)
    return folder / "trial"


@pytest.mark.parametrize("at_start", [False, True])
def test_a_recording_that_a_kill_broke_off_goes_on_in_the_same_bag(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_start: bool
) -> None:
    bag = kill_recorder(tmp_path, ros_domain)
    raw = encode("geometry_msgs/msg/WrenchStamped", {})
    named = {"bag_name": "trial"} if at_start else {}
    given = {"folder": str(tmp_path), "record_at_start": at_start, **named}
    for number in (1, 2):  # also after a second crash
        with running_node(ros_domain, tmp_path, monkeypatch, **given) as node:
            assert node._recorder.path == bag
            report = node.healths[0].report()
            assert report.level == 1 and "goes on in a further file" in report.message
            for _ in range(100):
                node._take(node._topics["/wrench"], raw, {})
            assert node._finish().counts["/wrench"] == 100
            node._mark(bag)  # as if it had not been closed
        files = [f"trial_{n}.mcap" for n in range(number + 1)]
        assert sorted(p.name for p in bag.iterdir()) == files
        with open_bag(bag) as reader:
            times = [m.log_time_ns for m in reader.messages("/wrench")]
            assert len(times) == 100 * (number + 1) and times == sorted(times)
            assert reader.info.metadata.subject == "S01" and not reader.lost
    recover(bag, tmp_path / "whole")
    with open_bag(tmp_path / "whole") as reader:
        assert reader.info.complete and reader.info.topics["/wrench"].count == 300
        assert reader.all_problems() == []


def test_another_bag_that_is_wanted_is_not_put_into_a_broken_one(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = kill_recorder(tmp_path, ros_domain)
    given = {"folder": str(tmp_path), "bag_name": "other"}
    with running_node(ros_domain, tmp_path, monkeypatch, **given) as node:
        assert node._recorder.path == tmp_path / "other"
        assert f"into {bag} was broken off" in node.healths[0].report().message


def test_a_recording_that_a_kill_broke_off_is_told_until_the_next_one(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def state() -> tuple[int, str]:
        report = node.healths[0].report()
        return report.level, report.message

    def kill(name: str) -> Path:
        kill_recorder(tmp_path / name, ros_domain, session="one" if name == "guided" else "")
        for file in (tmp_path / name / "trial").iterdir():  # long ago
            os.utime(file, (0, 0) if name != "guided" else None)
        return tmp_path / name

    def recorder(folder: Path, **parameters: Any) -> Any:
        given = {"folder": str(folder), "record_at_start": False, **parameters}
        return running_node(ros_domain, folder, monkeypatch, **given)

    folder = kill("killed")
    for _ in range(2):  # also after a further restart
        with recorder(folder) as node:
            level, text = state()
            assert level == 2 and text.startswith("NOT RECORDING")
            assert f"into {folder / 'trial'} was broken off; 'finger-bag recover'" in text
    with recorder(folder) as node:
        with pytest.raises(InputError, match="exists already"):
            node._start("trial", None)
        assert state()[0] == 2  # still nothing is recorded
        node._start("next", None)
        assert state()[0] == 0
        assert node._finish().error == ""
    with recorder(folder) as node:
        assert state()[0] == 0
    # Each attempt at a guided trial has its own bag, and the next one must be possible.
    folder = kill("guided")
    with recorder(folder) as node:
        level, text = state()
        assert level == 1 and "broken off" in text and "its trial is repeated" in text
        node._start("next", None)
        assert state()[0] == 0
        assert node._finish().error == ""
    # One that begins by itself again says which bag to look after.
    folder = kill("again")
    with recorder(folder, record_at_start=True) as node:
        level, text = state()
        assert level == 1 and f"into {folder / 'trial'} was broken off" in text
    # What was closed or removed since, or runs in another recorder, is not told of.
    folder = kill("removed")
    shutil.rmtree(folder / "trial")
    with recorder(folder) as node:
        assert state()[0] == 0
        node._start("trial", None)
        assert RecordingMarker(folder, node._marker_name).broken_off() is None


def test_a_place_without_a_marker_only_warns(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    (tmp_path / "file").touch()
    given = {"folder": str(tmp_path / "file" / "below"), "record_at_start": False}
    with running_node(ros_domain, tmp_path, monkeypatch, **given) as node:
        node._start(str(tmp_path / "bag"), None)
        assert node._finish().error == ""
    assert "cannot be noted in 'folder'" in capfd.readouterr().err


def test_bags_without_a_name_never_meet_and_stay_in_the_folder(node: Any, tmp_path: Path) -> None:
    session = {"condition": "../../evil/" + "x" * 300}
    names = set()
    for _ in range(3):
        name = node._free_name(tmp_path, session)
        assert name.parent == tmp_path
        name.mkdir()
        names.add(name)
    assert len(names) == 3


def test_log_times_do_not_follow_a_step_of_the_system_clock(node: Any) -> None:
    from finger_common.host_clock import HostClock

    wall, steady = [10**18], [0]
    node.host_clock = HostClock(lambda: wall[0], lambda: steady[0])
    taken: list[Any] = []
    node._recorder = type("Taking", (), {"put": lambda self, m: taken.append(m) or False})()
    topic = next(topic for topic in node._topics.values() if not topic.is_latched)
    for number in range(10):
        steady[0] += 2_000_000
        wall[0] += 2_000_000
        if number == 5:
            wall[0] -= 3600 * 10**9
        node._take(
            topic, bytes(20),
            {"received_timestamp": wall[0] - 1000, "source_timestamp": wall[0] - 2000},
        )  # fmt: skip
    times = [m.log_time_ns - 10**18 for m in taken]
    assert times == [2_000_000 * n - 1000 for n in range(1, 11)]
    node._recorder = Recorder()


def test_a_step_of_the_system_clock_is_named_until_it_is_taken_back(node: Any) -> None:
    from finger_common.host_clock import HostClock

    wall = [10**18]
    node.host_clock = HostClock(lambda: wall[0], lambda: 0)
    for step, named in ((0, False), (3600, True), (0, False)):
        wall[0] = 10**18 + step * 10**9
        node._each_second()
        assert ("clock_step" in node._health.faults) == named
        assert ("stepped by +3600.000 s" in node._health.report().message) == named


@pytest.mark.parametrize("character", ["\n", "\r", "\x1b", "\x85", "\u2028"])
def test_a_bag_name_that_breaks_lines_is_refused_in_one_sentence(
    node: Any, tmp_path: Path, character: str
) -> None:
    from finger_msgs.srv import Record

    node._finish()
    before = set(tmp_path.rglob("*"))
    for name in (f"a{character}b", f"sub/bag{character}", str(tmp_path / f"{character}x")):
        request = Record.Request(command=Record.Request.COMMAND_START, path=name)
        answer = node._on_record(request, Record.Response())
        assert not answer.success and answer.message.isprintable()
        assert "its name has a line feed or another control character" in answer.message
    assert set(tmp_path.rglob("*")) == before and not node._recorder.started
    assert node._start("Prüfung 1, größer\u3000試験", None).is_dir()


def test_a_home_folder_of_nobody_is_refused_and_the_recording_goes_on(node: Any) -> None:
    from rclpy.parameter import Parameter

    from finger_msgs.srv import Record

    def asked(path: str) -> Any:
        request = Record.Request(command=Record.Request.COMMAND_START, path=path)
        return node._on_record(request, Record.Response())

    says = "'~nobody-here' is no home folder here; give the whole path"
    answer = asked("~nobody-here/bag")
    assert not answer.success and answer.message.endswith(says)
    assert node._recorder.recording
    node._finish()
    assert node.set_parameters([Parameter("folder", value="~nobody-here")])[0].successful
    answer = asked("bag")
    assert not answer.success and answer.message.endswith(says)


def test_a_recording_that_is_stopped_at_once_is_not_called_empty(
    node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first message of a stream may be on its way."""
    now = time.monotonic()
    result = node._recorder.stop()
    for seconds, said in ((0.05, False), (1.9, False), (2.1, True)):
        with monkeypatch.context() as later:
            later.setattr(time, "monotonic", lambda seconds=seconds: now + seconds)
            node._started = now
            assert bool(node._doubts(result)) is said
            assert node.exit_code == int(said)


def test_a_refused_start_leaves_the_accounts_of_the_recording_that_runs(node: Any) -> None:
    gaps = [topic.gaps for topic in node._topics.values()]
    node._health.fault("lost", "messages lost: wrench 3", 1)
    with pytest.raises(InputError, match="stop it first"):
        node._start("second", None)
    assert gaps == [topic.gaps for topic in node._topics.values()]
    assert "wrench 3" in node._health.report().message


def test_an_inactive_node_refuses_to_record_and_its_cleanup_finishes_a_bag(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_msgs.srv import Record

    with running_node(ros_domain, tmp_path, monkeypatch, bag_name="bag") as node:
        node.trigger_deactivate()
        request = Record.Request(command=Record.Request.COMMAND_START, path="other")
        answer = node._on_record(request, Record.Response())
        assert not answer.success and "not active; activate it first" in answer.message
        assert not (tmp_path / "other").exists()
        # A bag that was begun by an activation that then failed.
        shutil.rmtree(tmp_path / "bag")

        def refuse(*arguments: Any) -> Any:
            raise InputError("no timer is left")

        monkeypatch.setattr(node, "create_steady_timer", refuse)
        assert node.trigger_activate().name == "FAILURE" and node._recorder.started
        node.trigger_cleanup()
        with open_bag(tmp_path / "bag") as reader:
            assert reader.info.complete


def test_a_publisher_that_does_not_fit_is_named_with_its_remedy_until_it_is_gone(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from finger_msgs.msg import Trial

    reliable = QoSProfile(depth=5)
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)

    def look() -> None:
        node._each_second()
        node.publish_diagnostics()
        time.sleep(0.005)

    def said() -> str:
        return str(node.healths[0].faults.get("qos_mismatch", ""))

    with running_node(ros_domain, tmp_path, monkeypatch, record_at_start=False) as node:
        other = rclpy.create_node("other", context=node.context)
        trial = other.create_publisher(Trial, "/trial", reliable)
        wait_until(said, "the warning", spin=look)
        assert "'/trial' has another durability" in said()
        assert said().endswith("publish it transient local")
        node._start("bag", None)
        look()
        assert "'/trial'" in said(), "a new bag does not mend it"
        node._finish()
        # The recorder reads reliably where all publish so, and with best effort again after that.
        other.create_publisher(WrenchStamped, "/wrench", reliable)
        wait_until(lambda: node._topics["/wrench"].reliable, "the reliable reader", spin=look)
        node._start("while", None)
        other.create_publisher(WrenchStamped, "/wrench", best_effort)
        wait_until(lambda: "'/wrench'" in said(), "the second warning", spin=look)
        assert "'/wrench' has another reliability" in said() and "'/trial'" in said()
        assert "set qos_reliability alike on both sides" in said()
        node._finish()
        wait_until(lambda: "'/wrench'" not in said(), "its end", spin=look)
        other.destroy_publisher(trial)
        wait_until(lambda: not said(), "the end", spin=look)
        other.destroy_node()


def test_attachments_keep_their_names_and_two_of_one_name_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    from finger_bag.recorder_node import RecordingSettings, _attached

    plate, other = (tmp_path / name / "plate_calibration.yaml" for name in ("one", "two"))
    alone = _attached(RecordingSettings(attachments=[str(plate)]))
    assert alone == {"plate_calibration.yaml": plate}
    twice = RecordingSettings(attachments=[str(plate)], calibration_file=str(other))
    with pytest.raises(InputError, match=r"would both be attached as 'plate_calibration\.yaml'"):
        _attached(twice)


def test_messages_of_any_installed_type_are_recorded(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    (tmp_path / "lab_msgs").mkdir()
    (tmp_path / "lab_msgs/__init__.py").touch()
    (tmp_path / "lab_msgs/msg.py").write_text("from std_msgs.msg import String as Skin\n")
    (tmp_path / "share/lab_msgs/msg").mkdir(parents=True)
    (tmp_path / "share/lab_msgs/msg/Skin.msg").write_text("string data\n")
    monkeypatch.syspath_prepend(tmp_path)
    topics = ["wrench", "skin=lab_msgs/msg/Skin"]
    with running_node(ros_domain, tmp_path, monkeypatch, topics=topics) as node:
        raw = encode("std_msgs/msg/String", {"data": "soft"})
        node._take(node._topics["/skin"], raw, {})
        path = node._finish().path
    with open_bag(path) as reader:
        assert [(m.type, m.message.data) for m in reader] == [("lab_msgs/msg/Skin", "soft")]


def test_latched_topics_of_several_namespaces_are_repeated_at_the_head(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile

    from finger_msgs.msg import ModelEvent

    names = [f"/hand/{finger}/model_events" for finger in ("thumb", "index")]
    topics = [f"{names[0]}=finger_msgs/msg/ModelEvent", names[1]]
    topics.append("/other/model_events=std_msgs/msg/String")
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    values = {"topics": topics, "record_at_start": False}
    with running_node(ros_domain, tmp_path, monkeypatch, **values) as node:
        assert not node._topics["/other/model_events"].is_latched, "a type of another kind"
        other = rclpy.create_node("other", context=node.context)
        for name in names:
            other.create_publisher(ModelEvent, name, latched).publish(ModelEvent(reason="start"))

        def come() -> bool:
            node._poll()
            return all(node._topics[name].latched for name in names)

        wait_until(come, "the events")
        node._start("bag", None)
        path = node._finish().path
        other.destroy_node()
    with open_bag(path) as reader:
        assert {(m.topic, m.message.reason) for m in reader} == {(n, "start") for n in names}


def test_states_recorded_without_their_force_are_told_until_it_comes(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    states = encode("finger_msgs/msg/ContactState", {})
    forces = encode("geometry_msgs/msg/WrenchStamped", {})

    def said() -> str:
        node._each_second()
        return str(node.healths[0].faults.get("force", ""))

    with running_node(ros_domain, tmp_path, monkeypatch) as node:
        assert not said(), "nothing has come"
        node._take(node._topics["/contact_state"], states, {})
        wait_until(said, "the warning")
        assert "nothing came on '/wrench'" in said() and "'wrench_topic'" in said()
        node._finish()
        assert "nothing came on '/wrench'" in capfd.readouterr().err
        node._start("whole", None)
        for topic, raw in (("/wrench", forces), ("/contact_state", states)):
            node._take(node._topics[topic], raw, {})
        wait_until(lambda: sum(node._recorder.counts.values()) == 2, "both")
        assert not said()


def test_a_disk_that_is_too_slow_is_told_before_messages_are_lost(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_bag.writer import BagWriter

    held = threading.Event()
    write = BagWriter.write_raw

    def slowly(self: BagWriter, *arguments: Any, **options: Any) -> None:
        held.wait(60)
        write(self, *arguments, **options)

    monkeypatch.setattr(BagWriter, "write_raw", slowly)
    image = encode("sensor_msgs/msg/Image", {"data": np.zeros(200_000, np.uint8)})

    def said() -> str:
        node._each_second()
        return str(node.healths[0].faults.get("disk", ""))

    with running_node(ros_domain, tmp_path, monkeypatch, queue_limit=1 << 20) as node:
        node._take(node._topics["/image_raw"], image, {})
        assert not said()
        for _ in range(3):
            node._take(node._topics["/image_raw"], image, {})
        assert "too slow: 1 MB wait" in said() and not node._recorder.lost
        assert node.healths[0].report().level == 1
        held.set()
        wait_until(lambda: not said(), "the end of the warning")
        assert node._finish().lost_count == 0


def test_a_recording_to_which_nothing_comes_names_where_there_are_streams(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    import rclpy
    from geometry_msgs.msg import WrenchStamped

    for patience in ("_PATIENCE", "_SHORT"):
        monkeypatch.setattr(f"finger_bag.recorder_node.{patience}", -1.0)

    def said() -> str:
        node._each_second()
        return str(node.healths[0].faults.get("nothing", ""))

    with running_node(ros_domain, tmp_path, monkeypatch) as node:
        assert "nothing came on /wrench, " in said() and "start the rig" in said()
        node.healths[0].fault("other_type", "'/wrench' is published as another type", 1)
        assert "nothing came on /wrench, " in said() and said().endswith("another type")
        node.healths[0].recovered("other_type")
        rig = rclpy.create_node("rig", context=node.context)
        for finger in ("thumb", "index"):
            rig.create_publisher(WrenchStamped, f"/hand/{finger}/wrench", 10)
        wait_until(lambda: "published in /hand/index, /hand/thumb; record there" in said(), "both")
        # Neither health nor what was kept of a trial is a stream of the finger.
        node._take(
            node._topics["/diagnostics"], encode("diagnostic_msgs/msg/DiagnosticArray", {}), {}
        )
        wait_until(lambda: node._recorder.counts.get("/diagnostics"), "the health")
        assert said()
        capfd.readouterr()
        assert node._finish().message_count == 1 and node.exit_code == 1
        assert "published in /hand/index, /hand/thumb" in capfd.readouterr().err
        assert not said(), "nothing is being recorded"
        node._start("whole", None)
        node._take(node._topics["/wrench"], encode("geometry_msgs/msg/WrenchStamped", {}), {})
        wait_until(lambda: node._recorder.counts.get("/wrench"), "the force")
        assert not said() and "nothing came" not in node._doubts(node._finish())
        rig.destroy_node()


def test_a_recorder_without_topics_is_refused_before_it_records_nothing(node: Any) -> None:
    from rclpy.parameter import Parameter

    node.trigger_deactivate()
    node.trigger_cleanup()
    empty = Parameter("topics", Parameter.Type.STRING_ARRAY, [])
    assert node.set_parameters_atomically([empty]).successful
    assert not node.bring_up()
    assert "'topics' is empty" in str(node.refused)
