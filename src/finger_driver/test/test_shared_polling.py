# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Several boards polled by one thread: none suffers from another one's fault."""

from __future__ import annotations

import os
import socket
import threading
import time
from itertools import pairwise

import pytest

from finger_common.errors import DeviceError
from finger_common.retry import Pauses
from finger_driver import shared_polling
from finger_driver.can_bus import HostMulticastBus
from finger_driver.device import DeviceThread
from finger_driver.force.netcanoem import NetcanoemSettings, NetcanoemSource
from finger_driver.shared_polling import SharedPolling
from finger_driver.simulators.netcanoem import NetcanoemSimulator

CHANNEL = "239.74.163.2"


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Finger:
    """A simulated board, its driver and the samples that come."""

    def __init__(self, rate: float = 200.0, check_period: float = 1.0) -> None:
        port = free_port()
        self.bus = HostMulticastBus(CHANNEL, port)
        self.board = NetcanoemSimulator(self.bus).start()
        self.source = NetcanoemSource(
            NetcanoemSettings(
                can_interface="udp_multicast",
                can_channel=CHANNEL,
                can_options=f"port={port}",
                rate=rate,
                calibration_check_period=check_period,
            )
        )
        self.stamps: list[int] = []
        self.threads: set[str] = set()
        self.raising: Exception | None = None
        self.thread = DeviceThread(self.source, self.take, Pauses(0.05, 0.1))
        self.thread.connect(5.0)

    def take(self, sample) -> None:
        if self.raising is not None:
            raise self.raising
        self.stamps.append(sample.stamp_ns)
        self.threads.add(threading.current_thread().name)

    def close(self) -> None:
        self.thread.stop()
        self.source.close()
        self.board.stop()
        self.bus.shutdown()


@pytest.fixture
def hand():
    fingers = [Finger() for _ in range(3)]
    for finger in fingers:
        finger.thread.start()
    yield fingers
    for finger in fingers:
        finger.close()


def came(finger: Finger, number: int, seconds: float = 60.0) -> bool:
    """Whether so many further samples come."""
    goal, end = len(finger.stamps) + number, time.monotonic() + seconds
    while len(finger.stamps) < goal and time.monotonic() < end:
        time.sleep(0.01)
    return len(finger.stamps) >= goal


def test_one_thread_polls_all_boards_and_asks_them_together(hand):
    assert all(came(finger, 200) for finger in hand)
    assert all("polling" in finger.threads for finger in hand)
    first, *others = [sorted(finger.stamps)[-100:] for finger in hand]
    period = int(1e9 / 200)
    for other in others:
        apart = [min(abs(a - b) for b in other) for a in first[20:80]]
        assert sorted(apart)[len(apart) // 2] < period // 4


@pytest.mark.parametrize("beside", ["alone", "a silent board"])
def test_a_check_of_the_calibration_leaves_no_gap(beside):
    fingers = [Finger(check_period=0.1)]
    if beside != "alone":
        fingers.append(Finger())
        fingers[1].board.faults.set("silent")
    try:
        for finger in fingers:
            finger.thread.start()
        assert came(fingers[0], 600)
        stamps = fingers[0].stamps
        gaps = sorted((b - a) / 1e9 for a, b in pairwise(stamps[-500:]))
        # 25 checks: a rule that costs a gap at each of them is seen, pauses of the machine are not.
        assert gaps[-12] < 0.03
    finally:
        for finger in fingers:
            finger.close()


def test_a_silent_board_costs_the_others_nothing(hand):
    silent, *others = hand
    assert all(came(finger, 50) for finger in hand)
    lost = [finger.source.health.counters.get("lost", 0) for finger in others]
    silent.board.faults.set("silent")
    assert all(came(finger, 200) for finger in others)
    assert lost == [finger.source.health.counters.get("lost", 0) for finger in others]
    assert silent.source.health.counters["lost"] > 0
    silent.board.faults.set("silent", 0)
    assert came(silent, 50)


def test_a_conflict_and_a_lost_frame_are_resolved_by_the_board_s_own_thread(hand):
    finger = hand[0]
    for fault, counter in (("rival", "conflict"), ("no_second", "half_replies")):
        assert came(finger, 20)
        finger.board.faults.set(fault, 2)
        end = time.monotonic() + 10.0
        while not finger.source.health.counters.get(counter) and time.monotonic() < end:
            time.sleep(0.01)
        assert finger.source.health.counters[counter] >= 1
    assert came(finger, 50)


def test_an_error_of_who_takes_the_samples_stays_with_its_device(hand):
    failing, other = hand[:2]
    assert came(failing, 20)
    failing.raising = DeviceError("not to be used")
    assert came(other, 100)
    assert failing.source.health.counters["connection"] > 0
    failing.raising = None
    assert came(failing, 20)


def test_a_device_closed_under_the_thread_is_connected_again(hand):
    closed, other = hand[:2]
    assert came(closed, 20)
    closed.source.close()
    assert came(other, 50)
    assert came(closed, 20)


def test_a_stopped_device_gives_no_more_samples_and_can_start_again(hand):
    finger, other = hand[:2]
    assert came(finger, 20)
    assert finger.thread.stop()
    number = len(finger.stamps)
    assert came(other, 50)
    assert len(finger.stamps) == number
    finger.thread.start()
    assert came(finger, 20)


def test_the_thread_ends_without_devices(monkeypatch):
    monkeypatch.setattr(shared_polling, "_IDLE", 0.1)
    finger = Finger()
    try:
        finger.thread.start()
        assert came(finger, 20)
        assert finger.thread.stop()
        time.sleep(0.5)
        assert "polling" not in {thread.name for thread in threading.enumerate()}
        finger.thread.start()
        assert came(finger, 20)
    finally:
        finger.close()


class PipeDevice:
    """A device that is always due, and whose reply is there as soon as it is asked."""

    period, due, deadline = 0.0, 0.0, float("inf")

    def __init__(self, name: str) -> None:
        self.name, self.asked = name, False
        self._reader, self._writer = os.pipe()

    def fileno(self) -> int:
        return self._reader

    def needs_own_thread(self, now: float) -> bool:
        return False

    def request(self) -> None:
        self.asked = True
        os.write(self._writer, b"\0")

    def reply(self) -> str:
        self.asked = False
        os.read(self._reader, 1)
        return self.name

    def close(self) -> None:
        os.close(self._reader)
        os.close(self._writer)


@pytest.mark.parametrize("fails", [False, True])
def test_what_can_wait_is_done_when_all_that_replied_were_served(fails):
    done: list[str] = []
    errors: list[str] = []

    def deliver(name: str):
        done.append(f"state {name}")

        def rest() -> None:
            done.append(f"rest {name}")
            if fails and name == "b":
                raise DeviceError("not to be published")

        return rest

    def ended() -> bool:
        after = done[done.index("rest b") :] if "rest b" in done else []
        return after.count("rest a") >= 5

    polling, devices = SharedPolling(), [PipeDevice("a"), PipeDevice("b")]

    def serve(device: PipeDevice) -> None:
        try:
            polling.serve(device, deliver, ended)
        except DeviceError as error:
            errors.append(str(error))

    threads = [threading.Thread(target=serve, args=(d,), daemon=True) for d in devices]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
        assert not thread.is_alive()
    for device in devices:
        device.close()
    assert errors == (["not to be published"] if fails else [])
    if fails:
        assert "state b" not in done[done.index("rest b") :]
        return
    first = done.index("state b")
    turns = done[first - 1 :] if done[first - 1 : first] == ["state a"] else done[first:]
    assert len(turns) >= 16
    for begin in range(0, 16, 4):
        assert sorted(turns[begin : begin + 2]) == ["state a", "state b"]
        assert sorted(turns[begin + 2 : begin + 4]) == ["rest a", "rest b"]


class LateDevice(PipeDevice):
    """One whose reply comes when `arrive` is called."""

    def request(self) -> None:
        self.asked = True

    def arrive(self) -> None:
        if self.asked:
            os.write(self._writer, b"\0")


def test_a_reply_that_comes_meanwhile_goes_before_what_can_wait():
    done: list[str] = []
    first, late = PipeDevice("first"), LateDevice("late")

    def deliver(name: str):
        done.append(f"state {name}")
        if name == "first" and late.asked:
            late.arrive()
            done[-1] += ", late arrives"
        return lambda: done.append(f"rest {name}")

    def ended() -> bool:
        return done.count("state late") > 20

    polling = SharedPolling()
    threads = [
        threading.Thread(target=polling.serve, args=(d, deliver, ended), daemon=True)
        for d in (first, late)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
        assert not thread.is_alive()
    for device in (first, late):
        device.close()
    arrivals = [i for i, what in enumerate(done) if what.endswith("arrives")]
    assert len(arrivals) > 15
    for i in arrivals[:15]:
        assert done[i + 1 : i + 3] == ["state late", "rest first"]
