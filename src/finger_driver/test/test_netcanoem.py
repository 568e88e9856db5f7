# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""NETCANOEM: bytes of a real board, arithmetic of the manual, the driver on faulty buses."""

from __future__ import annotations

import os
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import can
import numpy as np
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus

from finger_common import diagnostics
from finger_common.errors import DeviceError
from finger_driver.can_bus import discard_waiting, frame, open_bus, parse_options
from finger_driver.force import GOOD, SATURATED, open_source
from finger_driver.protocols import netcanoem, units
from finger_driver.simulators.netcanoem import NetcanoemSimulator, default_calibration


def hexa(text: str) -> bytes:
    return bytes.fromhex(text)


def test_gauges_of_a_captured_reading() -> None:
    """Frames 7F0 and 7F1 of a candump of a real board at base 0x7F."""
    status, gauges = netcanoem.decode_gauges(
        hexa("40 00 00 12 FE 3A E6 A8"), hexa("04 FA FA 93 01 43")
    )
    assert status == 0x4000
    assert gauges.tolist() == [18, 1274, -454, -1389, -6488, 323]
    status, gauges = netcanoem.decode_gauges(
        hexa("40 00 00 43 FE 77 E6 EE"), hexa("05 69 FA E0 01 83")
    )
    assert gauges.tolist() == [67, 1385, -393, -1312, -6418, 387]


def test_matrix_row_of_a_captured_start_up() -> None:
    row = netcanoem.decode_matrix_row(
        (
            hexa("3F 40 25 6A C1 DA D5 F4"),
            hexa("3F F8 5F 58 C1 CC ED 0E"),
            hexa("3F 9F F9 FC C1 DD 29 AD"),
        )
    )  # fmt: skip
    expected = [0.7505709, -27.3544693, 1.9404097, -25.6157494, 1.2498164, -27.6453495]
    np.testing.assert_allclose(row, expected, rtol=1e-7)


def test_identifiers_of_the_manuals_example() -> None:
    assert netcanoem.identifier(0x20, netcanoem.READ_GAUGES) == 0x200
    assert netcanoem.identifier(0x20, netcanoem.RESET) == 0x20C
    assert netcanoem.identifier(0x7F, 1) == 0x7F1


def test_critical_bits_are_those_of_the_manual_and_bit_14_is_not_one() -> None:
    assert netcanoem.CRITICAL_MASK == 0x18FE
    assert not netcanoem.CRITICAL_MASK & 0x4000


def test_wrench_is_matrix_times_gauges_over_counts_in_si() -> None:
    matrix = np.diag([1.0, 2, 3, 4, 5, 6]) + 0.1
    gauges = np.array([10.0, -20, 30, 40, -50, 60])
    calibration = netcanoem.Calibration(matrix, 1000, 200, 1, 2)
    raw = matrix @ gauges
    expected = np.concatenate(
        (raw[:3] / 1000 * 4.4482216152605, raw[3:] / 200 * 1.3558179483314004)
    )
    np.testing.assert_allclose(calibration.wrench(gauges), expected, rtol=1e-12)
    np.testing.assert_allclose(calibration.gauges(expected), gauges, rtol=1e-9)


def test_every_unit_code_has_a_factor_and_others_are_refused() -> None:
    for code in range(1, 7):
        assert units.force_factor(code) > 0 and units.torque_factor(code) > 0
    assert units.force_factor(3) == pytest.approx(1000 * units.force_factor(1))
    assert units.torque_factor(2) == pytest.approx(12 * units.torque_factor(1))
    assert units.force_factor("mN") == pytest.approx(units.force_factor("N") / 1000)
    for code in (0, 7, 255):
        with pytest.raises(DeviceError, match="not known"):
            units.force_factor(code)


def test_a_calibration_that_cannot_be_is_refused() -> None:
    with pytest.raises(DeviceError, match="singular"):
        netcanoem.Calibration(np.zeros((6, 6)))
    with pytest.raises(DeviceError, match="finite"):
        netcanoem.Calibration(np.full((6, 6), np.nan))


def test_options_are_read_and_refused() -> None:
    assert parse_options("port=43113, fd=true,name=a") == {"port": 43113, "fd": True, "name": "a"}
    with pytest.raises(Exception, match="key=value"):
        parse_options("port")


# Driver and board on a bus within the process ----------------------------------------------------


class EchoBus(UdpMulticastBus):
    """A bus that gives each sender its own frames back, `copies` times, as udp_multicast does."""

    def __init__(self, inner: can.BusABC, copies: int) -> None:
        can.BusABC.__init__(self, "echo")
        self._inner, self._copies = inner, copies
        self._own: list[can.Message] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._own += [msg] * self._copies
        self._inner.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._own:
            return self._own.pop(0), False
        return self._inner.recv(timeout), False

    def shutdown(self) -> None:
        can.BusABC.shutdown(self)
        self._inner.shutdown()


@pytest.fixture
def channel(request: pytest.FixtureRequest) -> str:
    return request.node.name


def board(channel: str, **options: object) -> tuple[can.BusABC, NetcanoemSimulator]:
    bus = open_bus("virtual", channel)
    return bus, NetcanoemSimulator(bus, **options)  # type: ignore[arg-type]


def driver(channel: str, **settings: object) -> object:
    return open_source(
        {"can_interface": "virtual", "can_channel": channel, "response_timeout": 0.2, **settings}
    )


def test_force_and_torque_come_through_as_they_are(channel: str) -> None:
    truth = np.array([1.0, -2.0, -5.0, 0.01, 0.02, -0.03])
    bus, simulator = board(channel, force=lambda stamp: truth, noise=0.0)
    simulator.start()
    source = driver(channel)
    try:
        source.connect()
        samples = [s for s in (source.read(1.0) for _ in range(20)) if s is not None]
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()
    assert len(samples) == 20 and all(s.quality == GOOD for s in samples)
    wrench = np.concatenate((samples[-1].force, samples[-1].torque))
    # Half a count of each gauge, through the matrix.
    limit = np.abs(default_calibration().scaled).sum(axis=1) * 0.5
    assert np.all(np.abs(wrench - truth) <= limit + 1e-9)
    assert np.all(np.diff([s.stamp_ns for s in samples]) > 0)


def test_the_stamp_is_the_middle_of_the_round_trip(channel: str) -> None:
    """The board samples at some time between request and reply."""
    bus, simulator = board(channel)
    simulator.start()
    source = driver(channel)
    try:
        source.connect()
        simulator.response_time, half = 0.02, 10_000_000
        for _ in range(3):
            before = source.clock.now()
            sample = source.read(1.0)
            assert sample is not None
            assert before + half <= sample.stamp_ns <= source.clock.now() - half
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


@pytest.mark.parametrize("fault", ["duplicate", "swapped", "late", "no_second", "foreign"])
def test_frames_of_two_readings_are_never_joined(channel: str, fault: str) -> None:
    """Each reading has another magnitude in the same direction; a mixed pair points elsewhere."""
    direction = np.array([1.0, -2.0, 3.0, 0.004, 0.003, -0.002])
    count = iter(range(1, 10_000))
    bus, simulator = board(channel, force=lambda stamp: direction * (next(count) % 7), noise=0.0)
    simulator.start()
    source = driver(channel, response_timeout=0.05)
    samples = []
    try:
        source.connect()
        for _ in range(10):
            simulator.faults.set(fault, 3)
            samples += [s for s in (source.read(1.0) for _ in range(8)) if s is not None]
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()
    assert len(samples) >= 45
    limit = np.abs(default_calibration().scaled).sum(axis=1) * 0.5 + 1e-9
    for sample in samples:
        wrench = np.concatenate((sample.force, sample.torque))
        size = round(sample.force[2] / direction[2])
        assert np.all(np.abs(wrench - size * direction) <= limit), "two readings were mixed"


def test_a_slow_board_is_not_lost_with_one_poll_and_its_fence(channel: str) -> None:
    """At 3 Hz each poll comes 0.33 s after the reply to the one before; silence is 1 s."""
    bus, simulator = board(channel)
    simulator.start()
    source = driver(channel, rate=3.0, response_timeout=0.2, calibration_check_period=3600.0)
    try:
        source.connect()
        assert source.read(1.0) is not None
        simulator.faults.set("silent")
        assert source.read(1.0) is None
        simulator.faults.set("silent", 0)
        assert source.read(1.0) is not None
        simulator.faults.set("silent")
        with pytest.raises(DeviceError, match="no reply for"):
            for _ in range(4):
                source.read(1.0)
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


@pytest.mark.parametrize("slower", ["own", "other"])
@pytest.mark.parametrize("other_slot", [0, 3])
def test_a_second_board_is_named_and_nothing_is_given_whichever_answers_first(
    channel: str, slower: str, other_slot: int
) -> None:
    """The slower board's frames come when the reading is complete, before the next request."""
    bus, own = board(channel, force=lambda stamp: np.array([0, 0, -5.0, 0, 0, 0]))
    second, other = board(channel, slots={0: default_calibration(other_slot)})
    (own if slower == "own" else other).response_time = 0.5e-3
    own.start()
    source = driver(channel, rate=200.0)
    try:
        source.connect()
        while source.read(1.0) is None:
            pass
        discard_waiting(second)
        other.start()
        given = 0
        end = time.monotonic() + 2.0
        while "conflict" not in source.health.faults and time.monotonic() < end:
            given += source.read(1.0) is not None
        assert "two different replies" in source.health.faults["conflict"]
        assert given <= 20
        try:
            assert all(source.read(1.0) is None for _ in range(60))
        except DeviceError as error:
            # A matrix that is not the sensor's.
            assert other_slot == 3 and "calibration slot" in str(error)
        other.stop()
        end = time.monotonic() + 5.0
        while "conflict" in source.health.faults and time.monotonic() < end:
            try:
                source.read(1.0)
            except DeviceError:
                source.connect()
        assert "conflict" not in source.health.faults
        assert source.read(1.0) is not None
    finally:
        source.close()
        own.stop()
        other.stop()
        bus.shutdown()
        second.shutdown()


def test_replies_that_come_late_at_start_up_are_not_taken_for_other_rows(channel: str) -> None:
    """The first of two replies to one request is used; the second would fit the next request."""
    bus, simulator = board(channel)
    simulator.faults.set("delay", 130)
    simulator.start()
    prompt = threading.Timer(1.5, simulator.faults.set, ("delay", 0))
    prompt.start()
    source = driver(channel, response_timeout=0.05)
    try:
        source.connect()
        assert np.array_equal(source.calibration.matrix, default_calibration().matrix)
        assert source.health.counters["late_replies"] > 0
    finally:
        prompt.cancel()
        source.close()
        simulator.stop()
        bus.shutdown()


def test_a_board_that_answers_late_has_not_lost_its_calibration(channel: str) -> None:
    """A row that was asked for and given up comes while the next row is waited for."""
    bus, simulator = board(channel)
    simulator.start()
    source = driver(channel, response_timeout=0.02, calibration_check_period=0.05)
    samples = []
    try:
        source.connect()
        for delay in (0, 35, 0, 60, 0, 35, 0):
            simulator.faults.set("delay", delay)
            end = time.monotonic() + 0.4
            while time.monotonic() < end:
                samples.append(source.read(0.1))
        assert source.health.counters["calibration_lost"] == 0
        assert source.health.counters["late_replies"] > 0
        while source.read(0.1) is None:
            pass
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()
    assert any(samples)


def test_an_error_frame_of_the_controller_is_no_reply(channel: str) -> None:
    """Linux reports error counters as 0x204 with 8 bytes: at base 0x20 the last row's numbers."""
    bus, simulator = board(channel)
    simulator.start()
    source = driver(channel, calibration_check_period=0.05)
    error = can.Message(arbitration_id=0x204, is_extended_id=False, is_error_frame=True, dlc=8)
    error.data = bytearray(8)
    try:
        source.connect()
        for _ in range(40):
            source.read(1.0)
        for _ in range(3):
            bus.send(error)
            source.read(1.0)
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()
    assert "bus_errors" in source.health.faults
    assert source.health.counters["conflict"] == source.health.counters["late_replies"] == 0


@pytest.mark.parametrize("copies", [1, 2])
def test_a_bus_that_echoes_own_frames_is_harmless(
    channel: str, copies: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_driver import can_bus

    monkeypatch.setattr(
        can_bus, "open_bus", lambda *a, **k: EchoBus(open_bus("virtual", channel), copies)
    )
    bus = EchoBus(open_bus("virtual", channel), copies)
    simulator = NetcanoemSimulator(bus, slots={3: default_calibration(3)}).start()
    source = driver(channel, calibration_slot=3)
    try:
        source.connect()
        assert simulator.active_slot == 3
        assert all(source.read(1.0) is not None for _ in range(5))
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


class TwiceBus(EchoBus):
    """A bus that gives every other node each frame twice, the second time a moment later."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._inner.send(msg, timeout)
        if self._copies:
            time.sleep(1e-3)
        self._inner.send(msg, timeout)


@pytest.mark.parametrize("pause", [0, 1])
def test_a_bus_that_gives_every_frame_twice_mixes_no_rows_and_no_readings(
    channel: str, pause: int
) -> None:
    truth = np.array([1.0, -2.0, -5.0, 0.01, 0.02, -0.03])
    bus = TwiceBus(open_bus("virtual", channel), pause)
    simulator = NetcanoemSimulator(bus, force=lambda stamp: truth, noise=0.0).start()
    source = driver(channel)
    try:
        source.connect()
        assert np.array_equal(source.calibration.matrix, default_calibration().matrix)
        samples = [source.read(1.0) for _ in range(20)]
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()
    given = [s for s in samples if s is not None]
    assert len(given) > 10
    assert all(np.abs(s.force - truth[:3]).max() < 0.1 for s in given)


def test_on_an_echoing_bus_the_own_request_is_no_confirmation_of_the_slot(
    channel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board that ignores "set calibration" must not seem to have confirmed it."""
    from finger_driver import can_bus

    class Deaf(NetcanoemSimulator):
        def _handle(self, frame: can.Message) -> None:
            if frame.arbitration_id & 0xF != netcanoem.SET_CALIBRATION:
                super()._handle(frame)

    monkeypatch.setattr(
        can_bus, "open_bus", lambda *a, **k: EchoBus(open_bus("virtual", channel), 1)
    )
    bus = open_bus("virtual", channel)
    simulator = Deaf(bus).start()
    source = driver(channel)
    try:
        with pytest.raises(DeviceError, match="not confirmed"):
            source.connect()
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


class Asked:
    """A board on a bus that is asked by hand, and the frames that it sends back."""

    def __init__(self, channel: str, echoing: bool = False) -> None:
        bus = open_bus("virtual", channel)
        self.simulator = NetcanoemSimulator(EchoBus(bus, 2) if echoing else bus, noise=0.0)
        self._bus = open_bus("virtual", channel)

    def ask(self, *requests: tuple[int, bytes]) -> list[tuple[int, bytes]]:
        """Identifiers and data of the replies to requests that come at once."""
        for identifier, data in requests:
            self._bus.send(frame(identifier, data))
        while (request := self.simulator.request(0.0)) is not None:
            self.simulator._handle(request)
        replies = iter(lambda: self._bus.recv(0.0), None)
        return [(reply.arbitration_id, bytes(reply.data)) for reply in replies]

    def awake(self) -> None:
        """The time in which a reset board is silent is over."""
        self.simulator._asleep_until = 0.0

    def close(self) -> None:
        self.simulator.bus.shutdown()
        self._bus.shutdown()


@pytest.fixture
def asked(channel: str) -> Iterator[Asked]:
    asked = Asked(channel)
    yield asked
    asked.close()


FIRMWARE = struct.pack(">BBH", 3, 8, 12)


@pytest.mark.parametrize("way", ["opcode", "fault"])
def test_base_and_bit_rate_change_at_the_next_power_up_and_not_at_a_reset(
    asked: Asked, way: str
) -> None:
    simulator = asked.simulator
    assert asked.ask((0x20D, b"\x30"), (0x20E, b"\3")) == [(0x20D, b""), (0x20E, b"")]
    pending = "base 0x20; after power-up base 0x30, 500000 bit/s"
    assert simulator.describe().endswith(pending)
    asked.ask((0x206, b"\5"))
    if way == "opcode":
        assert asked.ask((0x20C, b"")) == []
    else:
        simulator.faults.set("reset", 1)
    assert asked.ask((0x20F, b"")) == [], "it is silent for a moment"
    asked.awake()
    assert asked.ask((0x30F, b""), (0x20F, b"")) == [(0x20F, FIRMWARE)]
    assert simulator.active_slot == 0 and simulator.describe().endswith(pending)
    simulator.power_cycle()
    asked.awake()
    assert asked.ask((0x20F, b""), (0x30F, b"")) == [(0x30F, FIRMWARE)]
    assert simulator.describe().endswith("base 0x30, 500000 bit/s")


def test_each_set_calibration_is_answered_however_soon_it_comes(asked: Asked) -> None:
    requests = [(0x206, bytes([slot])) for slot in (5, 0, 0, 3, 0)]
    assert asked.ask(*requests) == requests
    assert asked.simulator.active_slot == 0


def test_on_a_bus_that_echoes_the_echoes_of_its_own_replies_alone_are_left_out(
    channel: str,
) -> None:
    asked = Asked(channel, echoing=True)
    try:
        requests = [(0x206, bytes([slot])) for slot in (5, 0, 3)]
        assert asked.ask(*requests) == requests
        assert asked.simulator.active_slot == 3
        asked.simulator._echo_until.clear()  # 20 ms later
        assert asked.ask((0x206, b"\3")) == [(0x206, b"\3")]
    finally:
        asked.close()


def test_what_is_no_request_is_not_answered(asked: Asked) -> None:
    for kind in ("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd"):
        asked._bus.send(
            can.Message(arbitration_id=0x200, **{"is_extended_id": False} | {kind: True})
        )
        assert asked.ask() == []
    assert asked.ask((0x200, b"\0"), (0x206, b""), (0x20A, b""), (0x210, b"")) == []


@pytest.mark.parametrize(
    ("options", "settings", "message"),
    [
        ({}, {"calibration_slot": 5}, "singular|no valid calibration"),
        ({}, {"expected_serial": "FT99999"}, "FT01234"),
        ({}, {"base_identifier": 0x21}, "no answer"),
        ({"unit_codes": (9, 4)}, {}, "unit 9"),
    ],
)
def test_start_up_refuses_with_a_reason(
    channel: str, options: dict, settings: dict, message: str
) -> None:
    bus, simulator = board(channel, **options)
    simulator.start()
    source = driver(channel, **settings)
    try:
        with pytest.raises(DeviceError, match=message):
            source.connect()
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


def test_a_matrix_that_is_read_in_two_ways_is_refused(channel: str) -> None:
    """As where a late reply is taken for another row's."""

    class Mixed(NetcanoemSimulator):
        mixed = True

        def _replies(self, opcode: int, data: bytes) -> list[bytes]:
            if opcode == netcanoem.READ_MATRIX and data == b"\5" and self.mixed:
                self.mixed, data = False, b"\4"
            return super()._replies(opcode, data)

    bus = open_bus("virtual", channel)
    simulator = Mixed(bus).start()
    source = driver(channel)
    try:
        with pytest.raises(DeviceError, match="two readings of the matrix differ"):
            source.connect()
        source.connect()
        assert np.array_equal(source.calibration.matrix, default_calibration().matrix)
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


def test_another_calibration_is_another_scale_and_a_reset_is_found_in_any_row(channel: str) -> None:
    """Slots 0 and 3, of one transducer, differ in the last row only."""
    first = default_calibration()
    other = replace(first, matrix=first.matrix * np.array([[1.0]] * 5 + [[1.5]]))
    bus, simulator = board(channel, slots={0: first, 3: other})
    simulator.start()
    scales = []
    source = driver(channel)
    try:
        for slot in (0, 3, 3):
            source.close()
            source = driver(channel, calibration_slot=slot, calibration_check_period=0.05)
            source.connect()
            scales.append(source.scale_id)
        assert scales[0] != scales[1] == scales[2]
        simulator.power_cycle()
        with pytest.raises(DeviceError, match="no longer uses calibration slot 3"):
            for _ in range(500):
                source.read(1.0)
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


@pytest.mark.parametrize("end", [-1, 1])
def test_a_gauge_at_either_end_is_saturated(channel: str, end: int) -> None:
    bus, simulator = board(channel, gauge_offset=np.array([0, 0, 4e4 * end, 0, 0, 0]))
    simulator.start()
    source = driver(channel)
    try:
        source.connect()
        sample = source.read(1.0)
        assert sample is not None and sample.quality == SATURATED
        assert "gauge 2 is saturated" in source.health.faults["saturated"]
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


LBF, LBF_IN = 4.4482216152605, 0.1129848290276167


@pytest.mark.parametrize(
    ("settings", "factors", "assumed"),
    [
        ({}, (1 / LBF, 0.001 / LBF_IN), "N and N-mm"),
        ({"assumed_force_unit": "lbf"}, (1.0, 0.001 / LBF_IN), "lbf and N-mm"),
        ({"assumed_force_unit": "lbf", "assumed_torque_unit": "lbf-in"}, (1.0, 1.0), ""),
    ],
)
def test_units_that_old_firmware_does_not_tell_are_those_set_or_a_warning_stands(
    channel: str,
    settings: dict,
    factors: tuple[float, float],
    assumed: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The calibration is in lbf and lbf-in, as that of many transducers."""
    monkeypatch.setattr(diagnostics, "HOLD", 0.0)
    truth = np.array([1.0, -2.0, 3.0, 0.004, 0.005, -0.006])
    calibration = replace(default_calibration(), force_unit=1, torque_unit=1)
    bus, simulator = board(
        channel,
        firmware=(3, 6, 1),
        slots={0: calibration},
        force=lambda stamp: truth,
        noise=0.0,
    )
    simulator.start()
    source = driver(channel, **settings)
    try:
        source.connect()
        sample = source.read(1.0)
        assert sample is not None
        step = np.abs(calibration.scaled).sum(axis=1)
        expected = truth * np.repeat(factors, 3)
        assert np.all(np.abs(sample.channels - calibration.gauges(truth)) <= 0.51)
        wrench = np.concatenate([sample.force, sample.torque])
        assert np.all(np.abs(wrench - expected) <= 0.51 * step * np.repeat(factors, 3))
        told = source.health.faults.get("units_assumed", "")
        assert bool(told) is bool(assumed)
        assert not told or f"does not tell the calibration's units: {assumed} are assumed" in told
        simulator.firmware = (3, 8, 1)
        source.connect()
        assert "units_assumed" not in source.health.faults and source.serial == "FT01234"
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


class Gone(EchoBus):
    """A bus whose adapter was unplugged: python-can's slcan and socketcand raise these."""

    unplugged = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.unplugged:
            raise BrokenPipeError(32, "Broken pipe")
        super().send(msg, timeout)

    def shutdown(self) -> None:
        super().shutdown()
        if self.unplugged:
            raise can.CanOperationError("Could not close serial socket")


def test_an_adapter_that_was_unplugged_is_a_bus_error(
    channel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_driver import can_bus

    gone = Gone(open_bus("virtual", channel), 0)
    monkeypatch.setattr(can_bus, "open_bus", lambda *a, **k: gone)
    bus, simulator = board(channel)
    simulator.start()
    source = driver(channel)
    try:
        source.connect()
        assert source.read(1.0) is not None
        gone.unplugged = True
        with pytest.raises(DeviceError, match=r"bus error \(\[Errno 32\] Broken pipe\)"):
            for _ in range(10):
                source.read(1.0)
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (0x8000, "an error without a cause (status 0x8000)"),
        (0xC000, "CAN bus error (status 0x4000)"),
    ],
)
def test_an_error_bit_that_stands_alone_is_told(channel: str, status: int, said: str) -> None:
    bus, simulator = board(channel)
    simulator.faults.set("status", status)
    simulator.start()
    source = driver(channel)
    try:
        source.connect()
        sample = source.read(1.0)
        assert sample is not None and sample.quality == GOOD
        assert source.health.faults == {"status_warning": f"sensor reports: {said}"}
    finally:
        source.close()
        simulator.stop()
        bus.shutdown()


def test_no_bus_is_reported_in_one_sentence() -> None:
    with pytest.raises(Exception, match="does not exist"):
        open_bus("nonsense")
    with pytest.raises(DeviceError, match="does not open"):
        open_bus("socketcan", "can_that_is_not_there")


def test_host_multicast_bus_understands_python_cans_own(free_port: object) -> None:
    """Same datagrams as python-can's udp_multicast, both ways, and no echo of one's own frames."""
    port = free_port()  # type: ignore[operator]
    ours = open_bus("udp_multicast", options={"port": port})
    try:
        theirs = can.Bus(interface="udp_multicast", channel="239.74.163.2", port=port, hop_limit=0)
    except can.CanError:
        ours.shutdown()
        pytest.skip("this machine has no route for multicast beside the loopback")
    try:
        message = can.Message(arbitration_id=0x123, data=b"abc", is_extended_id=False)
        ours.send(message)
        got = theirs.recv(2)
        assert got is not None and bytes(got.data) == b"abc"
        assert ours.recv(0.1) is None
    finally:
        ours.shutdown()
        theirs.shutdown()


def test_an_adapter_on_a_serial_port_that_another_driver_reads_is_refused() -> None:
    """Both would take a part of what comes, and neither could say why."""
    serial = pytest.importorskip("serial")
    master, slave = os.openpty()
    name = os.ttyname(slave)
    probe = serial.Serial(name, exclusive=True)
    at_once = {"sleep_after_open": 0}
    with pytest.raises(DeviceError, match=f"slcan {name}: the port is in use by another program"):
        open_bus("slcan", name, options=at_once)
    probe.close()
    bus = open_bus("slcan", name, options=at_once)
    with pytest.raises(serial.SerialException, match="exclusively lock"):
        serial.Serial(name, exclusive=True)
    bus.shutdown()
    serial.Serial(name, exclusive=True).close()
    os.close(master)
    os.close(slave)
