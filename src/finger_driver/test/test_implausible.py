# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Wrong scales, impossible values, forged and foreign messages: none becomes a good sample."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import can
import numpy as np
import pytest
from device_process import device, netft_settings

from finger_common.errors import DeviceError, InputError
from finger_driver.can_bus import frame, open_bus
from finger_driver.force import (
    CRITICAL,
    GOOD,
    ForceSettings,
    ForceSource,
    WrenchSample,
    open_source,
)
from finger_driver.force.netcanoem import NetcanoemSource
from finger_driver.force.netft import NetFtSettings, NetFtSource
from finger_driver.protocols import netcanoem, rdt
from finger_driver.protocols.rdt_order import RecordOrder
from finger_driver.simulators.netcanoem import NetcanoemSimulator, default_calibration
from finger_driver.simulators.netft import DEFAULT_CONFIGURATION, NetFtSimulator


@pytest.mark.parametrize("counts", [1e-300, 1e-2, 5.0, 1e12, 1e300])
@pytest.mark.parametrize("kind", ["counts_per_force", "counts_per_torque"])
def test_implausible_counts_per_unit_are_refused(
    box: NetFtSimulator, counts: float, kind: str
) -> None:
    box.configuration = replace(DEFAULT_CONFIGURATION, torque_unit="N-m", **{kind: counts})
    source = open_source(netft_settings(box))
    limit = "force_range 100 N" if kind == "counts_per_force" else "torque_range 10 N m"
    with pytest.raises(DeviceError, match=f"{limit}.*check counts per unit"):
        source.connect()
    source.close()


@pytest.mark.parametrize("counts", [1, 2**32 - 1])
def test_a_board_of_implausible_counts_is_refused(counts: int) -> None:
    calibration = replace(default_calibration(), counts_per_force=counts)
    channel = f"implausible {counts}"
    with open_bus("virtual", channel) as bus:
        board = NetcanoemSimulator(bus, slots={0: calibration}).start()
        source = open_source({"can_interface": "virtual", "can_channel": channel})
        try:
            with pytest.raises(DeviceError, match="force_range 100 N"):
                source.connect()
        finally:
            source.close()
            board.stop()


@pytest.mark.parametrize(
    "value", [-1e306, 101.0, np.nan, np.inf], ids=["huge", "above", "nan", "infinite"]
)
@pytest.mark.parametrize("axis", range(6))
def test_a_value_beyond_the_sensors_range_is_not_good(value: float, axis: int) -> None:
    source = ForceSource(ForceSettings())
    wrench = np.zeros(6)
    assert source.checked(WrenchSample.of_wrench(0, wrench)).quality == GOOD
    wrench[axis] = value
    assert source.checked(WrenchSample.of_wrench(0, wrench)).quality == CRITICAL
    assert "beyond force_range 100 N" in source.health.faults["implausible"]


def feed_equal(source: ForceSource, wrench: np.ndarray, rate: float, number: int) -> list[int]:
    """Qualities of so many equal samples."""
    return [
        source.checked(WrenchSample.of_wrench(round(k / rate * 1e9), wrench)).quality
        for k in range(number)
    ]


@pytest.mark.parametrize("rate", [500.0, 10.0])
def test_a_sensor_whose_values_stand_still_is_told(rate: float) -> None:
    source = ForceSource(ForceSettings(rate=rate))
    frozen = np.array([0.1, 0.0, -1.5, 0.0, 0.0, 0.0])
    assert set(feed_equal(source, frozen, rate, max(20, round(rate)))) == {GOOD}
    assert not source.health.faults
    assert set(feed_equal(source, frozen, rate, 2 * max(20, round(rate)))) == {GOOD}
    assert "no channel has changed" in source.health.faults["still"]


def test_a_sensor_that_was_away_is_not_taken_for_frozen() -> None:
    """Its coarse values at rest may be those from before."""
    source = ForceSource(ForceSettings())
    for stamp in (0, 2_000_000, 600_000_000_000, 601_500_000_000):
        source.checked(WrenchSample.of_wrench(stamp, np.array([0.1, 0.0, -1.5, 0.0, 0.0, 0.0])))
    assert not source.health.faults


def test_a_sensor_without_noise_or_load_is_not_taken_for_frozen() -> None:
    source = ForceSource(ForceSettings())
    feed_equal(source, np.zeros(6), 500.0, 5000)
    for k in range(5000):
        # The least channel of six alone moves.
        wrench = np.array([0.1, 0.0, -1.5, 0.0, 0.0, 1e-5 * (k // 400)])
        source.checked(WrenchSample.of_wrench(k * 2_000_000, wrench))
    assert not source.health.faults


def test_a_sample_of_another_form_is_told_in_the_words_of_the_driver() -> None:
    sample = WrenchSample.of_wrench(np.int64(7), [0, 0, -1, 0, 0, 0])
    assert sample.stamp_ns == 7 and sample.force.tolist() == [0.0, 0.0, -1.0]
    assert sample.torque.dtype == float
    for wrench in (np.zeros(3), np.zeros(7), np.zeros((6, 1)), 1.0):
        with pytest.raises(DeviceError, match=r"has shape \(.*\); the driver must give \(6,\)"):
            WrenchSample.of_wrench(7, wrench)
    with pytest.raises(InputError, match=r"round\(seconds \* 1e9\)"):
        WrenchSample.of_wrench(1.7e9, np.zeros(6))


# Numbering of RDT --------------------------------------------------------------------------------


def test_what_is_wrong_with_the_numbering_is_counted_and_told() -> None:
    source = NetFtSource(NetFtSettings())
    source._order = RecordOrder()

    def feed(*numbers: int, force: int = 0) -> list[int]:
        records = [rdt.Record(n, 14 * n, 0, (force, 0, 0, 0, 0, 0)) for n in numbers]
        return [used.rdt_sequence for r in records for used, _ in source._in_order(r, 0)]

    counters = source.health.counters
    assert feed(110, 111, 5111, 112, 102, 120, 121) == [110, 111, 112, 120, 121]
    assert counters["jump"] == 1 and counters["lost"] == 7
    assert feed(123, 122) == [122, 123] and counters["out_of_order"] == 2
    assert feed(123, force=5) == [] and "another sender" in source.health.faults["conflict"]
    assert counters["out_of_order"] == 3 and counters["conflict"] == 1
    with pytest.raises(DeviceError, match="numbering restarted"):
        feed(1, 2)


def test_datagrams_of_another_sender_are_not_read(box: NetFtSimulator) -> None:
    """The kernel gives those of the box's address and port only."""
    import socket

    source = open_source(netft_settings(box))
    source.connect()
    assert isinstance(source, NetFtSource) and source._socket is not None
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    forged = rdt.encode_record(rdt.Record(2**31, 2**31, 0, (90_000_000,) * 6))
    samples = []
    try:
        for _ in range(100):
            stranger.sendto(forged, source._socket.getsockname())
            if (sample := source.read(0.5)) is not None:
                samples.append(sample)
    finally:
        source.close()
        stranger.close()
    assert len(samples) > 50 and max(np.abs(s.force).max() for s in samples) < 1
    assert not source.health.faults and not source.health.counters["malformed"]


# CAN ---------------------------------------------------------------------------------------------


class SecondBoard(can.BusABC):
    """A bus on which another device answers each reading, too, before or after the board."""

    def __init__(self, before: bool) -> None:
        super().__init__("two boards")
        self._queue: list[can.Message] = []
        self._before = before
        self.answers = False
        self._board = NetcanoemSimulator(self, noise=0.0)
        self._serving = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self._serving:
            self._queue.append(msg)
            return
        self._serving = True
        forged = frame(0x200, netcanoem.encode_gauges(0, np.full(6, 999))[0])
        reading = self.answers and msg.arbitration_id == 0x200
        if reading and self._before:
            self._queue.append(forged)
        self._board._handle(msg)
        if reading and not self._before:
            self._queue.insert(1, forged)
        self._serving = False

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self._queue.pop(0) if self._queue else None), False


@pytest.mark.parametrize("before", [True, False])
def test_two_different_replies_are_both_left_out(
    monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    bus = SecondBoard(before)
    source = open_source({"device": "netcanoem", "response_timeout": 0.05})
    monkeypatch.setattr("finger_driver.can_bus.open_bus", lambda *a: bus)
    source.connect()
    bus.answers = True
    assert [source.read(0.1) for _ in range(10)] == [None] * 10
    assert "another device" in source.health.faults["conflict"]
    bus.answers = False
    # The sensor is read again once the other board has been silent for a while.
    end = time.monotonic() + 10.0
    while (sample := source.read(0.1)) is None:
        assert time.monotonic() < end
    assert np.all(sample.force == 0)


def flood(port: int, ending: threading.Event, sent: list[int], rate: float) -> None:
    """So many frames per second: foreign, long, short, remote."""
    with open_bus("udp_multicast", options={"port": port}) as bus:
        kinds = [
            frame(0x701, bytes(8)),
            frame(0x000, bytes(8)),
            frame(0x2F0, bytes(8)),
            frame(0x200, bytes(5)),
            frame(0x20F, bytes(3)),
            frame(0x00000200, bytes(8), extended=True),
            can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True),
        ]
        start = time.monotonic()
        while not ending.wait(0.001):
            while sent[0] < rate * (time.monotonic() - start):
                bus.send(kinds[sent[0] % len(kinds)])
                sent[0] += 1


@pytest.mark.alone
@pytest.mark.parametrize("rate", [3000, pytest.param(8000, marks=pytest.mark.slow)])
def test_a_board_is_read_on_a_bus_full_of_others_frames(free_port: object, rate: float) -> None:
    """A bus of 1 Mbit/s carries 8000 frames per second."""
    port = free_port()  # type: ignore[operator]
    ending, sent = threading.Event(), [0]
    wrench = "--wrench=0.5,-0.25,-3,0.001,0.002,0"
    with device("netcanoem", "--options", f"port={port}", wrench):
        source = open_source(
            {
                "can_interface": "udp_multicast",
                "can_options": f"port={port}",
                "rate": 100.0,
                # A busy machine unpacks this many frames slowly.
                "response_timeout": 1.0,
            }
        )
        assert isinstance(source, NetcanoemSource)
        flooding = threading.Thread(target=flood, args=(port, ending, sent, rate), daemon=True)
        flooding.start()
        samples = []
        try:
            source.connect()
            end = time.monotonic() + 60
            while len(samples) < 100 and time.monotonic() < end:
                if (sample := source.read(0.5)) is not None:
                    samples.append(source.checked(sample))
        finally:
            source.close()
            ending.set()
            flooding.join()
    assert len(samples) == 100 and sent[0] > 1000
    assert all(s.quality == GOOD for s in samples)
    errors = np.abs([s.force - (0.5, -0.25, -3) for s in samples])
    assert errors.max() < 0.05, "a frame of another device became part of a reading"
    assert source.health.counters["foreign"] > 100
    assert "does not belong" in source.health.faults["malformed"]
