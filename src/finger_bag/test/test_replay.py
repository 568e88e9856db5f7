# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Replay: original spacing, rate, loop, start offset; over DDS, nodes estimate as they did live."""

from __future__ import annotations

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
from service_calls import call
from session_bags import START, wrench
from waiting import wait_until

from finger_bag.cli import command, parser
from finger_bag.reader import open_bag
from finger_bag.replay import Pause, ReplaySettings, lateness_text, replay
from finger_bag.writer import BagWriter
from finger_common.cli import EXIT_BAD_INPUT, run
from finger_common.errors import InputError


class Clock:
    """Time that passes only while a caller sleeps."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """100 wrenches, 10 ms apart, with a pause of 1 s in the middle."""
    with BagWriter(tmp_path / "short") as bag:
        for i in range(100):
            bag.write("wrench", wrench(START + i * 10_000_000 + (i >= 50) * 10**9, 0.1))
    return tmp_path / "short"


def played(path: Path, topics: Any = None, **options: Any) -> tuple[list[float], list[Any]]:
    clock = Clock()
    times, items = [], []
    with open_bag(path) as reader:
        settings = ReplaySettings(**options)
        for item in replay(reader, settings, topics, now=clock.now, sleep=clock.sleep):
            times.append(clock.time)
            items.append(item)
    return times, items


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_spacing_is_that_of_the_bag(short: Path, rate: float) -> None:
    times, items = played(short, rate=rate)
    logs = np.array([i.message.log_time_ns for i in items])
    assert np.allclose(np.diff(times), np.diff(logs) * 1e-9 / rate, atol=1e-6)
    assert len(items) == 100 and max(i.lateness for i in items) < 1e-6


def test_offset_and_duration_cut(short: Path) -> None:
    _, items = played(short, start=0.2, duration=0.1)
    logs = [(i.message.log_time_ns - START) / 1e9 for i in items]
    assert logs == pytest.approx(np.arange(0.2, 0.3, 0.01))
    with pytest.raises(InputError, match="nothing to play"):
        played(short, start=100.0)
    with pytest.raises(InputError, match="rate"):
        played(short, rate=0.0)


def test_only_the_topics_asked_for_are_given(session: Callable[..., Path]) -> None:
    path = session(trials=1)
    times, items = played(path, topics=["/finger/moisture", "/finger/trial"])
    assert {i.message.topic for i in items} == {"/finger/moisture", "/finger/trial"}
    with open_bag(path) as reader:
        counts = reader.info.topics
        assert len(items) == counts["/finger/moisture"].count + counts["/finger/trial"].count
    logs = np.array([i.message.log_time_ns for i in items])
    assert np.allclose(np.diff(times), np.diff(logs) * 1e-9, atol=1e-6)


def test_loop_continues_without_time_running_back(short: Path) -> None:
    clock = Clock()
    with open_bag(short) as reader:
        settings = ReplaySettings(loop=True, start=0.2)
        items = replay(reader, settings, now=clock.now, sleep=clock.sleep)
        found = [next(items).bag_time_ns for _ in range(250)]
    assert np.all(np.diff(found) > 0)
    rounds = np.array(found[80:160]) - np.array(found[:80])
    assert np.all(rounds == rounds[0])


def test_a_pause_stops_the_time_of_the_bag_and_a_step_gives_one_message(short: Path) -> None:
    clock, pause = Clock(), Pause()
    began = clock.time
    told: list[tuple[float, int]] = []

    def on_time(bag_time_ns: int) -> None:
        """What a user does, by the time since the begin."""
        passed = clock.time - began
        told.append((passed, bag_time_ns - START))
        if pressed and passed > pressed[0][0]:
            pressed.pop(0)[1]()

    pressed = [(0.105, pause.toggle), (3.0, pause.step), (5.0, pause.step), (9.0, pause.toggle)]
    with open_bag(short) as reader:
        times = [
            clock.time - began
            for _ in replay(reader, on_time=on_time, pause=pause, now=clock.now, sleep=clock.sleep)
        ]
    assert len(times) == 100 and not pressed
    number = next(i for i, t in enumerate(times) if t > 0.2)
    assert times[:number] == pytest.approx([i * 0.01 for i in range(number)], abs=1e-6)
    # One for each step, and the others with their spacing when it goes on.
    assert times[number : number + 2] == pytest.approx([3.0, 5.0], abs=0.12)
    assert times[number + 2] == pytest.approx(9.0, abs=0.12)
    assert np.diff(times[number + 2 : 50]) == pytest.approx(0.01, abs=1e-6)
    # A clock goes on with the time that stands still.
    assert len({bag_time for passed, bag_time in told if 5.2 < passed < 9.0}) == 1
    assert max(np.diff([passed for passed, _ in told])) < 0.051
    assert min(np.diff([bag_time for _, bag_time in told])) >= 0


IN_TERMINAL = """
import os, sys, threading, time
from finger_bag.pause_keys import pause_keys
from finger_bag.replay import Pause
pause = Pause()
seen = []
with pause_keys(pause):
    print("ready", flush=True)
    end = time.monotonic() + 50
    while time.monotonic() < end and not (pause.on and len(seen) == 2):
        if pause.on and pause.take_step():
            seen.append("step")
        time.sleep(0.005)
print("seen", len(seen), flush=True)
"""


def test_keys_pause_and_the_terminal_is_left_as_it_was() -> None:
    import os
    import pty
    import termios

    outer, inner = pty.openpty()
    before = termios.tcgetattr(inner)

    def take_terminal() -> None:
        import fcntl

        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    child = subprocess.Popen(
        [sys.executable, "-c", IN_TERMINAL],
        stdin=inner,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=take_terminal,
    )
    assert child.stdout is not None and child.stdout.readline() == "ready\n"
    assert termios.tcgetattr(inner)[3] != before[3]
    os.write(outer, b" xss")
    out, err = child.communicate(timeout=60)
    assert out == "seen 2\n" and "paused" in err
    assert termios.tcgetattr(inner) == before
    os.close(outer)
    os.close(inner)


def test_lateness_of_a_slow_reader_is_reported(short: Path) -> None:
    clock = Clock()
    late = []
    with open_bag(short) as reader:
        for item in replay(reader, now=clock.now, sleep=clock.sleep):
            late.append(item.lateness)
            clock.time += 0.02  # the reader needs twice the spacing
    assert len(late) == 100
    assert max(late) == pytest.approx(0.5, abs=0.025)
    assert lateness_text(late).startswith("100 messages; late by ")
    assert lateness_text([]) == "nothing was played"


def test_clock_follows_the_time_of_the_bag(short: Path) -> None:
    times: list[int] = []
    clock = Clock()
    with open_bag(short) as reader:
        options = {"tick": 0.01, "now": clock.now, "sleep": clock.sleep}
        list(replay(reader, on_time=times.append, **options))
    assert np.all(np.diff(times) >= 0)
    assert times[0] == START and times[-1] == START + 99 * 10_000_000 + 10**9
    assert np.diff(times).max() <= 10_000_001  # also within the pause of a second


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- 3",
        "[",
        "- durability: !!int x",
        "- durability: " + "[" * 100_000,
        "- a: &a [x, x, x, x, x, x, x, x, x, x]\n"
        + "".join(
            f"  b{i}: &b{i} [{', '.join([f'*b{i - 1}' if i else '*a'] * 10)}]\n" for i in range(9)
        )
        + "  durability: *b8",
    ],
    ids=["none", "number", "broken", "tag", "deep", "aliases"],
)
def test_any_text_may_stand_in_the_place_of_a_quality_of_service(text: str) -> None:
    pytest.importorskip("rclpy")
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    from finger_bag.play_node import qos_of

    profile = qos_of(text, "")
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert profile.durability != DurabilityPolicy.TRANSIENT_LOCAL
    stored = (
        "- history: keep_last\n  depth: 1\n  reliability: best_effort\n  durability: volatile\n"
    )
    # Recordings of before, too, reach a subscriber with the usual QoS, unless otherwise asked.
    usual = parser().parse_args(["play", "bag"]).reliability
    assert qos_of(stored, usual).reliability == ReliabilityPolicy.RELIABLE
    assert qos_of(stored, "best_effort").reliability == ReliabilityPolicy.BEST_EFFORT


def test_model_node_in_the_time_of_the_bag_estimates_as_offline(
    ros_domain: int, process: Any, tmp_path: Path, session: Callable[..., Path]
) -> None:
    """`finger-bag play --clock` and `finger-bag record` around the real model node."""
    pytest.importorskip("rclpy")
    from finger_msgs.msg import ContactState

    path = session(trials=1)
    model = process(
        "-m", "finger_model.model_node", "--ros-args", "-r", "__ns:=/finger", "-p",
        "use_sim_time:=true", "-p", "qos_reliability:=reliable", "-p", "qos_depth:=5000",
        # However busy this machine is, areas come in time.
        "-p", "fusion_delay:=1.0",
    )  # fmt: skip
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    rclpy.init(domain_id=ros_domain)
    states: list[Any] = []
    try:
        node = rclpy.create_node("observer")
        node.create_subscription(
            ContactState,
            "/finger/contact_state",
            states.append,
            QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE),
        )
        publishers = lambda: node.count_publishers("/finger/contact_state")  # noqa: E731
        end = time.monotonic() + 120
        while not publishers() and time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.1)
        player = process(
            "-m", "finger_bag.cli", "play", str(path), "--clock", "--wait", "8",
            "--duration", "7.9",
            "--reliability", "reliable", "--topics", "wrench", "contact_area", "moisture",
        )  # fmt: skip
        end = time.monotonic() + 120
        while len(states) < 1750 and time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.1)
        node.destroy_node()
    finally:
        rclpy.shutdown()
    assert player.wait(90) == 0, player.output.read_text()
    assert "late by" in player.output.read_text()
    assert model.poll() is None
    from finger_offline.process import process as run_offline
    from finger_offline.process_options import ProcessOptions

    options = ProcessOptions(estimator={"fusion_delay": 1.0})
    run_offline(path, tmp_path / "offline", options)
    with open_bag(tmp_path / "offline") as reader:
        expected = [m.message for m in reader.messages(["/finger/contact_state"])]
    assert len(states) == len(expected) == 1750
    for state, offline in zip(states, expected):
        assert state.header.stamp.nanosec == offline.header.stamp.nanosec
        assert (state.area, state.flags) == (offline.area, offline.flags)
        assert state.indentation == offline.indentation


def test_services_pause_a_replay(short: Path, ros_domain: int, process: Any) -> None:
    pytest.importorskip("rclpy")
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    player = process("-m", "finger_bag.cli", "play", str(short), "--loop")
    received: list[Any] = []
    rclpy.init(domain_id=ros_domain)
    node = rclpy.create_node("observer")

    def spin() -> None:
        assert player.poll() is None
        rclpy.spin_once(node, timeout_sec=0.05)

    until = partial(wait_until, what="what the player does", spin=spin)

    def ask(service: str) -> str:
        return str(call(node, Trigger, f"/bag_player/{service}", Trigger.Request(), until).message)

    def come() -> int:
        """How many messages came, once none has come for 0.5 s."""
        since = time.monotonic()
        while time.monotonic() - since < 0.5:
            before = len(received)
            rclpy.spin_once(node, timeout_sec=0.05)
            since = time.monotonic() if len(received) > before else since
        return len(received)

    try:
        node.create_subscription(WrenchStamped, "/finger/wrench", received.append, 1000)
        until(lambda: len(received) > 10)
        assert (ask("is_paused"), ask("pause"), ask("is_paused")) == ("plays", "paused", "paused")
        paused = come()
        assert ask("play_next") == "paused" and come() == paused + 1
        assert ask("toggle_paused") == "plays"
        until(lambda: len(received) > paused + 10)
        assert (ask("toggle_paused"), ask("resume")) == ("paused", "plays")
        player.send_signal(signal.SIGINT)
        assert player.wait(20) == 0 and "late by" in player.output.read_text()
    finally:
        node.destroy_node()
        rclpy.shutdown()


ENDED = """
import os, signal, sys
from finger_bag import play_node
from finger_bag.cli import command
from finger_common.cli import run
replay = play_node.replay

def ended(*arguments):
    for number, item in enumerate(replay(*arguments)):
        yield item
        if number == 3:
            os.kill(os.getpid(), signal.SIGTERM)

play_node.replay = ended
sys.exit(run(command, ["play", sys.argv[1], "--wait", "0"]))
"""


def test_a_replay_awaits_those_who_are_to_hear_its_first_message(
    short: Path, ros_domain: int, process: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    import rclpy
    from geometry_msgs.msg import WrenchStamped

    with open_bag(short) as reader:
        sent = [m.raw for m in reader.messages(["/finger/wrench"])]
    options = "--await", "wrench", "--wait", "0.5"
    player = process("-u", "-m", "finger_bag.cli", "play", str(short), *options)
    said = "nobody listens to /finger/wrench yet"
    wait_until(lambda: said in player.output.read_text(), said)
    rclpy.init(domain_id=ros_domain)
    node = rclpy.create_node("observer")
    received: list[bytes] = []
    try:
        node.create_subscription(WrenchStamped, "/finger/wrench", received.append, 1000, raw=True)
        wait_until(
            lambda: len(received) == len(sent) > 0,
            "the bag from its first message on",
            spin=lambda: rclpy.spin_once(node, timeout_sec=0.05),
        )
        assert player.wait(60) == 0
    finally:
        node.destroy_node()
        rclpy.shutdown()
    assert run(command, ["play", str(short), "--await", "moisture"]) == EXIT_BAD_INPUT
    assert "'moisture' is not in the bag" in capsys.readouterr().err


def test_readings_of_the_probe_are_latched_as_its_node_has_them(
    tmp_path: Path, ros_domain: int, process: Any
) -> None:
    pytest.importorskip("rclpy")
    import rclpy

    from finger_common.node import LATCHED_QOS
    from finger_msgs.msg import Moisture

    with BagWriter(tmp_path / "probed") as bag:
        bag.write("moisture", {"header": {"stamp": START}, "value": 40.0})
    rclpy.init(domain_id=ros_domain)
    node = rclpy.create_node("observer")
    received: list[Any] = []
    try:
        node.create_subscription(Moisture, "/finger/moisture", received.append, LATCHED_QOS)
        options = "--wait", "0", "--await", "moisture"
        player = process("-m", "finger_bag.cli", "play", str(tmp_path / "probed"), *options)
        spin = partial(rclpy.spin_once, node, timeout_sec=0.05)
        wait_until(lambda: received, "the reading", spin=spin)
        assert received[0].value == 40.0
        assert player.wait(60) == 0 and "incompatible QoS" not in player.output.read_text()
    finally:
        node.destroy_node()
        rclpy.shutdown()


def test_a_clock_outside_the_times_of_messages_ends_the_player(
    short: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setattr(time, "time_ns", lambda: 2**31 * 10**9)
    assert run(command, ["play", str(short)]) == EXIT_BAD_INPUT
    assert "the system clock says 2038-01-19 03:14:08 UTC" in capsys.readouterr().err


def test_sigterm_ends_the_player_as_ctrl_c_does(short: Path, ros_domain: int) -> None:
    pytest.importorskip("rclpy")
    done = subprocess.run(
        [sys.executable, "-c", ENDED, str(short)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert done.stdout.startswith("3 messages; late by") or "4 messages" in done.stdout
