# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Net F/T and DBC-described sensors: bytes, pages, averaging, drivers against simulators."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from device_process import device, netft_settings
from waiting import wait_until

from finger_common import diagnostics
from finger_common.errors import DeviceError, InputError
from finger_common.host_clock import HostClock
from finger_driver.can_bus import frame, open_bus
from finger_driver.force import (
    CRITICAL,
    GOOD,
    SATURATED,
    ForceSource,
    WrenchSample,
    netft,
    open_source,
)
from finger_driver.force.dbc import SHIPPED, DbcSettings, DbcSource
from finger_driver.force.netft import NetFtSettings, NetFtSource
from finger_driver.protocols import netft_xml, rdt
from finger_driver.protocols.dbc import SampleAssembler, SensorMapping
from finger_driver.simulators.netft import DEFAULT_CONFIGURATION, NetFtOptions, NetFtSimulator
from finger_driver.simulators.rft import RftOptions, RftSimulator

TRUTH = np.array([0.5, -0.25, -3.0, 0.01, -0.02, 0.03])
WRENCH = "--wrench=" + ",".join(map(str, TRUTH))


def test_rdt_request_and_record_are_the_manuals_bytes() -> None:
    assert rdt.encode_request(rdt.START_REALTIME) == bytes.fromhex("1234 0002 00000000")
    data = struct.pack(">III6i", 7, 98, 0x80010000, 1, -2, 3, -4, 5, -6)
    (record,) = rdt.decode_datagram(data)
    assert record == rdt.Record(7, 98, 0x80010000, (1, -2, 3, -4, 5, -6))
    assert rdt.encode_record(record) == data
    assert len(rdt.decode_datagram(data * 40)) == 40
    for bad in (b"", data[:-1], data * 41):
        with pytest.raises(DeviceError):
            rdt.decode_datagram(bad)


@pytest.mark.parametrize(("asked", "real"), [(150, 7000 / 46), (99, 100), (7000, 7000), (500, 500)])
def test_the_box_rounds_rates_up_to_a_fraction_of_7000_hz(asked: float, real: float) -> None:
    assert rdt.real_rate(asked) == pytest.approx(real)


def test_an_axia_has_another_internal_rate_and_repeats_samples_beyond_it() -> None:
    assert rdt.real_rate(500, 7812) == pytest.approx(7812 / 15)
    assert rdt.real_rate(500, 488) == 500


def test_page_gives_scales_in_si_and_counts_that_are_not_a_million() -> None:
    page = b"""<?xml version="1.0"?><netft><prodname>Net Box</prodname><cfgcpf>1</cfgcpf>
    <cfgcpt>1000</cfgcpt><scfgfu>lbf</scfgfu><scfgtu>Nmm</scfgtu><comrdtrate>500</comrdtrate></netft>"""
    configuration = netft_xml.parse(page)
    assert configuration.force_scale == pytest.approx(4.4482216152605)
    assert configuration.torque_scale == pytest.approx(1e-6)
    assert netft_xml.parse(netft_xml.render(configuration)) == configuration
    full = page.replace(b"</netft>", b"<runrate>488</runrate><cfgcalsn>FT1</cfgcalsn></netft>")
    assert netft_xml.parse(full).internal_rate == 488
    assert netft_xml.parse(full).zero != configuration.zero
    assert (configuration.serial, netft_xml.parse(full).serial) == ("", "FT1")
    assert netft_xml.parse(netft_xml.render(netft_xml.parse(full))) == netft_xml.parse(full)


@pytest.mark.parametrize(
    ("page", "message"),
    [
        (b"<html>router</html>", "cfgcpf"),
        (b"not xml", "not readable XML"),
        (b"<n><cfgcpf>0</cfgcpf></n>", "positive"),
        (
            b"<n><cfgcpf>1</cfgcpf><cfgcpt>1</cfgcpt><scfgfu>stone</scfgfu><scfgtu>Nm</scfgtu></n>",
            "stone",
        ),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><n/>', "declarations"),
    ],
)  # fmt: skip
def test_a_page_of_another_kind_is_refused_with_a_reason(page: bytes, message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        netft_xml.parse(page)


def collect(source: ForceSource, number: int) -> list[WrenchSample]:
    """Samples of a source, which is connected when it is not, as the driver does it.

    A simulator that gets no processor for a quarter of a second is as silent as a dead box.
    """
    samples: list[WrenchSample] = []
    said = ""
    end = time.monotonic() + 120
    while len(samples) < number:
        assert time.monotonic() < end, f"{len(samples)} of {number} samples; {said}"
        try:
            sample = source.read(0.5)
        except DeviceError as error:
            said = str(error)
            with contextlib.suppress(DeviceError):
                source.connect()
            continue
        if sample is not None:
            samples.append(sample)
    return samples


def test_net_ft_streams_from_another_process() -> None:
    with device("rdt", "--port", 0, "--http-port", 0, WRENCH) as box:
        source = open_source(netft_settings(box))
        try:
            samples = collect(source, 300)
        finally:
            source.close()
    mean = np.mean([s.channels for s in samples], axis=0)
    # 300 samples of 2 mN and 2 µN m noise.
    assert np.all(np.abs(mean[:3] - TRUTH[:3]) < 6e-4)
    assert np.all(np.abs(mean[3:] - TRUTH[3:]) < 6e-6)
    assert np.all(np.diff([s.stamp_ns for s in samples]) > 0)
    assert all(s.quality == GOOD for s in samples)


def of_box(box: NetFtSimulator, **settings: object) -> ForceSource:
    """Source for a box in this process."""
    return open_source(netft_settings(box, **settings))


def test_a_box_that_sends_faster_than_it_measures_repeats_samples(box: NetFtSimulator) -> None:
    box.configuration = dataclasses.replace(box.configuration, internal_rate=488.0)
    source = of_box(box)
    try:
        collect(source, 244)
        assert source.health.counters["repeated"] in range(4, 9)
        assert "stalled" not in source.health.faults
        box.faults.set("stalled")
        end = time.monotonic() + 10
        while "stalled" not in source.health.faults and time.monotonic() < end:
            try:
                source.read(0.1)
            except DeviceError:  # the box had to wait for a busy processor
                source.connect()
        assert "repeats" in source.health.faults["stalled"]
    finally:
        source.close()


@pytest.mark.parametrize("element", ["cfgcalsn", "cfgtfx", "setbias"])
def test_another_calibration_transform_or_bias_of_the_box_voids_a_tare(
    box: NetFtSimulator, element: str
) -> None:
    source = of_box(box)
    try:
        source.connect()
        before = source.scale_id
        source.connect()
        assert source.scale_id == before
        zero = tuple("1;2" if name == element else "" for name in netft_xml.ZERO)
        box.configuration = dataclasses.replace(box.configuration, zero=zero)
        source.connect()
        assert source.scale_id != before
    finally:
        source.close()


def test_a_simulator_outlasts_an_error_and_says_it(
    box: NetFtSimulator, capsys: pytest.CaptureFixture[str]
) -> None:
    for units in (("N", "N-mm", 0, 1e6), ("stone", "N-mm", 1e6, 1e6)):
        with pytest.raises(InputError, match="units"):
            box.set_units(*units)
    raised = threading.Event()

    def broken(stamp_ns: int) -> np.ndarray:
        raised.set()
        raise ValueError("no load")

    source, load = of_box(box), box._force
    try:
        collect(source, 1)
        box._force = broken
        assert raised.wait(10)
        box._force = load
        collect(source, 5)
    finally:
        source.close()
    assert capsys.readouterr().out == "rdt: ValueError: no load\n"


@contextlib.contextmanager
def client_of(box: NetFtSimulator) -> Iterator[socket.socket]:
    """A socket that sends requests to a box and receives what it sends."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
        connection.connect(("127.0.0.1", box.port))
        connection.settimeout(20.0)
        yield connection


def request(command: int, count: int) -> bytes:
    """Bytes from the manual's table."""
    return struct.pack(">HHI", 0x1234, command, count)


@pytest.mark.parametrize(
    ("command", "lost", "numbers"),
    [
        (0x0002, 0, [[1], [2], [3], [4], [5]]),
        (0x0002, 2, [[3], [4], [5]]),
        (0x0003, 0, [[*range(1, 11)], [*range(11, 21)], [*range(21, 26)]]),
    ],
    ids=["real time", "datagrams lost", "buffered"],
)
def test_a_counted_stream_has_that_many_records(
    box: NetFtSimulator, command: int, lost: int, numbers: list[list[int]]
) -> None:
    box.faults.set("gap", lost)
    with client_of(box) as client:

        def received() -> list[int]:
            data = client.recv(2048)
            return [struct.unpack_from(">I", data, at)[0] for at in range(0, len(data), 36)]

        client.send(request(command, numbers[-1][-1]))
        came = [received()]
        wait_until(lambda: box._client is None, "the end of the stream")
        # What comes before the only record of another stream is of the first one.
        client.send(request(0x0002, 1))
        came += iter(received, [1])
    assert came == numbers


def test_a_software_bias_outlasts_a_start_and_ends_with_a_reboot() -> None:
    options = NetFtOptions(port=0, http_port=0, noise=0.0, wrench="0,0,-3,0,0,0")
    with NetFtSimulator(options) as box, client_of(box) as client:

        def force() -> int:
            client.send(request(0x0002, 1))
            return struct.unpack_from(">i", client.recv(2048), 20)[0]

        assert force() == -3_000_000
        client.send(request(0x0042, 0))
        assert force() == 0
        box.faults.set("reboot", 1)
        wait_until(lambda: box._down_until > 0.0, "the outage")
        box._down_until = 0.0  # its half second is over
        assert force() == -3_000_000


def test_a_proxy_of_the_environment_does_not_hide_the_box(
    box: NetFtSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.setenv("no_proxy", "")
    source = of_box(box)
    try:
        source.connect()
    finally:
        source.close()


def test_a_port_that_refuses_is_named_when_connecting(
    box: NetFtSimulator, free_port: object
) -> None:
    port = free_port()  # type: ignore[operator]
    source = of_box(box, netft_port=port)
    with pytest.raises(DeviceError, match=f"page answers but .*refused.* UDP port {port}"):
        source.connect()
    source.close()


def test_a_faster_box_is_averaged_not_decimated() -> None:
    with device("rdt", "--port", 0, "--http-port", 0, WRENCH, "--noise", 0.05) as box:
        source = open_source(netft_settings(box, rate=50.0))
        try:
            samples = collect(source, 60)
        finally:
            source.close()
    spread = np.std([s.force for s in samples], axis=0)
    # Ten records per sample: noise falls by √10; 60 samples give it to about 10 %.
    assert np.all((spread > 0.05 / np.sqrt(10) * 0.6) & (spread < 0.05 / np.sqrt(10) * 1.5))


class Stream:
    """A driver that is given records of a box by hand, at times of receipt in s.

    sent, internal: the box's rates (Hz), as its page gives them.
    """

    START = 1_700_000_000_000_000_000

    def __init__(self, rate: float, sent: float, internal: float = 7000.0) -> None:
        self.source = NetFtSource(NetFtSettings(rate=rate))
        self._now = self.START
        self.source.clock = HostClock(lambda: self._now, lambda: self._now)
        self._step = internal / sent
        page = dataclasses.replace(DEFAULT_CONFIGURATION, rdt_rate=sent, internal_rate=internal)
        self.source._page = lambda: page  # type: ignore[method-assign]
        self.source._open = self.source._begin  # type: ignore[method-assign]
        self.source.connect()
        self.source.close()

    def feed(
        self, number: int, at: float, measured: float | None = None, status: int = 0
    ) -> list[WrenchSample]:
        """Samples once a record has come, whose force is its number in mN.

        measured: number of the internal sample over the number of records that one takes.
        """
        self._now = self.START + round(at * 1e9)
        internal = round((number if measured is None else measured) * self._step)
        record = rdt.Record(number, internal, status, (0, 0, number * 1000, 0, 0, 0))
        usable = self.source._in_order(record, self._now)
        samples = [self.source._take(*one) for one in usable]
        return [sample for sample in samples if sample is not None]

    def time_of(self, sample: WrenchSample) -> float:
        return (sample.stamp_ns - self.START) * 1e-9


@pytest.mark.parametrize(
    "lost", [lambda n: n % 7 == 6, lambda n: n % 10 in (3, 4), lambda n: False]
)
def test_a_block_of_which_records_were_lost_is_averaged(lost: Callable[[int], bool]) -> None:
    stream, samples = Stream(rate=500.0, sent=3500.0), []
    for number in range(1, 7001):
        if not lost(number):
            samples += stream.feed(number, number / 3500)
    # One sample for each seven numbers; two records at the end may be held back.
    assert len(samples) in (999, 1000, 1001)
    for sample in samples:
        # The force is that of its time.
        assert sample.force[2] == pytest.approx(3.5 * stream.time_of(sample), abs=0.002)
    share = sum(lost(n) for n in range(1, 7001)) / 7000
    told = stream.source.health.faults.get("records_lost", "")
    assert told.startswith(f"{share:.0%} of the last 100") if share else not told


@pytest.mark.parametrize(("bit", "quality"), [(rdt.SATURATION_BIT, SATURATED), (1 << 28, CRITICAL)])
def test_one_bad_record_of_a_block_spoils_its_sample_only(bit: int, quality: int) -> None:
    stream, samples = Stream(rate=500.0, sent=3500.0), []
    bad = rdt.SUMMARY_BIT | bit
    for number in range(7, 140):
        # The third of the seven records of a block.
        samples += stream.feed(number, number / 3500, status=bad if number == 72 else 0)
    spoilt = [s for s in samples if s.quality != GOOD or s.status]
    assert [(s.quality, s.status) for s in spoilt] == [(quality, bad)] and len(samples) > 15
    assert spoilt[0].force[2] == pytest.approx(0.073), "the mean of the records 70 to 76"


def test_a_summary_bit_without_a_cause_is_no_good_record() -> None:
    source = Stream(rate=500.0, sent=500.0).source
    assert source._quality(rdt.SUMMARY_BIT) == CRITICAL
    assert "summary bit without a cause" in source.health.faults["critical"]


def test_one_record_lost_of_many_is_no_warning() -> None:
    stream = Stream(rate=500.0, sent=500.0)
    for number in range(1, 3001):
        if number % 200:
            stream.feed(number, number / 500)
    assert stream.source.health.counters["lost"] == 14 and not stream.source.health.faults


def test_a_pause_that_the_box_does_not_number_leaves_the_stamps_right() -> None:
    random, stream = np.random.default_rng(1), Stream(rate=500.0, sent=500.0)
    for number in range(1, 4001):
        true = number / 500 + (0.2 if number > 3000 else 0.0)
        late = 0.0002 + random.exponential(1e-4)
        for sample in stream.feed(number, true + late, measured=true * 500):
            assert abs(stream.time_of(sample) - true) < 0.002
    faults = stream.source.health.faults
    assert stream.source.health.counters["paused"] == 1
    assert faults == {"paused": "the box sent nothing for 0.20 s"}


def test_a_box_that_sends_more_slowly_than_its_page_says_does_not_pause() -> None:
    stream = Stream(rate=1000.0, sent=1000.0)
    for number in range(1, 3001):
        stream.feed(number, number / 100, measured=number * 10)
    assert "paused" not in stream.source.health.counters
    assert "at the rate its page gives" in stream.source.health.faults["clock"]


def test_records_lost_are_no_pause() -> None:
    stream = Stream(rate=500.0, sent=500.0)
    for number in [*range(1, 1000), *range(1100, 2000)]:
        stream.feed(number, number / 500)
    assert "paused" not in stream.source.health.faults


def test_datagrams_that_come_late_do_not_end_the_connection() -> None:
    stream = Stream(rate=500.0, sent=3500.0)
    numbers = [*range(1, 500), *range(503, 600), 500, 501, 502, *range(600, 1000)]
    for index, number in enumerate(numbers):
        stream.feed(number, index / 3500)
    counters = stream.source.health.counters
    assert counters["out_of_order"] == counters["lost"] == 3


@pytest.mark.parametrize(
    ("change", "changed"),
    [
        ({"counts_per_torque": 2e6}, True),
        ({"torque_unit": "lbf-in"}, True),
        ({"rdt_rate": 250.0}, True),
        *(
            ({"zero": tuple("1;2" if name == element else "" for name in netft_xml.ZERO)}, True)
            for element in netft_xml.ZERO
        ),
        ({"internal_rate": 6999.0}, False),
    ],
)
def test_what_the_meaning_of_a_record_hangs_on_is_watched_on_the_page(
    change: dict[str, Any], changed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(netft, "_CHECK_PERIOD", 0.0)

    def page() -> netft_xml.Configuration:
        watcher.ending.set()
        return dataclasses.replace(DEFAULT_CONFIGURATION, **change)

    watcher = netft._PageWatcher(page, DEFAULT_CONFIGURATION)
    watcher.run()
    assert watcher.changed == changed


def test_a_page_that_cannot_be_read_is_told(
    box: NetFtSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(netft, "_CHECK_PERIOD", 0.01)
    monkeypatch.setattr(diagnostics, "HOLD", 0.1)
    source = of_box(box)

    def read_until(told: bool) -> None:
        end = time.monotonic() + 60
        while ("page" in source.health.faults) != told:
            assert time.monotonic() < end
            with contextlib.suppress(DeviceError):
                source.read(0.1)

    try:
        source.connect()
        box.faults.set("bad_page")
        read_until(told=True)
        assert "units changed there would not be noticed" in source.health.faults["page"]
        box.faults.clear()
        read_until(told=False)
    finally:
        source.close()


@pytest.mark.parametrize(
    ("head", "time", "told"),
    [
        (b"", 0.3, r"does not answer \(not complete within 0\.3 s\)"),
        (b"HTTP/1.0 200 OK\r\n\r\n", 0.3, r"does not answer \(not complete within 0\.3 s\)"),
        (
            b"HTTP/1.0 200 OK\r\n\r\n" + b" " * (netft_xml.MAX_BYTES + 1),
            3.0,
            f"is larger than {netft_xml.MAX_BYTES} bytes; this is not a Net F/T",
        ),
    ],
    ids=["header", "page", "without end"],
)
def test_a_page_that_comes_byte_by_byte_is_given_up(
    head: bytes, time: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(netft, "_PAGE_TIME", time)
    ending = threading.Event()

    def drip(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection, contextlib.suppress(OSError):
            connection.sendall(head)
            while not ending.wait(0.02):
                connection.sendall(b"H")

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=drip, args=(server,), daemon=True)
        thread.start()
        settings = NetFtSettings(netft_host="127.0.0.1", netft_http_port=server.getsockname()[1])
        try:
            with pytest.raises(DeviceError, match=told):
                NetFtSource(settings).connect()
        finally:
            ending.set()
            thread.join()


def test_an_error_of_the_page_is_named(box: NetFtSimulator) -> None:
    source = of_box(box)
    assert isinstance(source, NetFtSource)
    with pytest.raises(DeviceError, match=r"none\.xml does not answer \(HTTP error 404\)"):
        source._get("/none.xml")


def test_a_summary_bit_alone_is_named() -> None:
    assert rdt.status_text(rdt.SUMMARY_BIT) == "summary bit without a cause"
    assert rdt.status_text(rdt.SUMMARY_BIT | 1 << 29) == "digital board"


def rft_frames(wrench: np.ndarray, response: int = 0x0B, overload: int = 0) -> tuple[bytes, bytes]:
    counts = np.rint(wrench * np.array([50.0] * 3 + [2000.0] * 3)).astype(int)
    data = struct.pack(">B6hBH", response, *counts.tolist(), overload, 0)
    return data[:8], data[8:]


def changed_mapping(folder: Path, change: tuple[str, str]) -> Path:
    """The shipped mapping in a folder, with one text in place of another."""
    text = SHIPPED.read_text(encoding="utf-8")
    assert change[0] in text
    (folder / "robotous_rft.dbc").write_bytes(SHIPPED.with_suffix(".dbc").read_bytes())
    path = folder / "m.yaml"
    path.write_text(text.replace(*change, 1), encoding="utf-8")
    return path


@pytest.mark.parametrize("sign", [1, -1])
def test_robotous_frames_decode_with_tx_across_both(sign: int) -> None:
    """Bytes built from the manual's table, not from the DBC file."""
    mapping = SensorMapping.load(SHIPPED)
    truth = sign * np.array([10.0, -20.0, 30.02, 0.5005, -0.25, 0.1275])
    first, second = rft_frames(truth)
    assembler = SampleAssembler(mapping)
    assert assembler.add("RFT_Reply_1", first, 1000) is None
    done = assembler.add("RFT_Reply_2", second, 2000)
    assert done is not None and done[0] == 1000
    np.testing.assert_allclose(mapping.wrench(done[1]), truth, atol=1e-9)


def test_frames_of_different_samples_are_never_joined() -> None:
    mapping = SensorMapping.load(SHIPPED)
    first, second = rft_frames(np.ones(6))
    assembler = SampleAssembler(mapping)
    assert assembler.add("RFT_Reply_2", second, 0) is None
    assert assembler.add("RFT_Reply_1", first, 1_000_000) is None
    assert assembler.add("RFT_Reply_2", second, 10_000_000) is None, "later than 'within'"
    assembler.add("RFT_Reply_1", first, 11_000_000)
    assembler.add("RFT_Reply_1", first, 12_000_000)
    assert assembler.incomplete == 2
    with pytest.raises(DeviceError, match="Response"):
        assembler.add("RFT_Reply_1", rft_frames(np.ones(6), response=0x0A)[0], 0)


class Dbc:
    """A driver that is given frames by hand, at times of receipt in s."""

    START = 1_700_000_000_000_000_000

    def __init__(self, mapping: Path, rate: float = 500.0) -> None:
        self.source = DbcSource(DbcSettings(rate=rate, dbc_mapping=str(mapping)))
        self.now = self.START
        self.source.clock = HostClock(lambda: self.now, lambda: self.now)

    def feed(self, identifier: int, data: bytes, at: float) -> WrenchSample | None:
        self.now = self.START + round(at * 1e9)
        message = frame(identifier, data)
        # A float of this size has steps of 0.24 µs.
        message.timestamp = self.now * 1e-9
        return self.source._take(message)


@pytest.mark.parametrize("within", [0.001, 0.005])
def test_frames_of_two_samples_are_not_joined_when_those_between_are_lost(
    tmp_path: Path, within: float
) -> None:
    sensor = Dbc(changed_mapping(tmp_path, ("within: 0.005", f"within: {within}")))
    first, second = rft_frames(np.ones(6))
    for k in range(10):
        assert sensor.feed(1, first, 0.004 * k) is None
        assert sensor.feed(2, second, 0.004 * k + 0.0022) is None
    assert sensor.source.health.counters["lost"] == 10
    assert sensor.feed(1, first, 0.1) is None and sensor.feed(2, second, 0.1004) is not None


def test_a_sensor_whose_counter_stands_still_repeats_a_sample(tmp_path: Path) -> None:
    counter = "counter: {signal: Fz, modulus: 65536}\nsaturation:"
    sensor = Dbc(changed_mapping(tmp_path, ("saturation:", counter)))

    def feed(count: int, at: float) -> WrenchSample | None:
        first, second = rft_frames(np.array([0, 0, count / 50, 0, 0, 0]))
        sensor.feed(1, first, at)
        return sensor.feed(2, second, at + 0.0005)

    health = sensor.source.health
    # Each comes twice.
    given = [feed(k // 2, 0.002 * k) for k in range(100)]
    assert [sample is not None for sample in given] == [True, False] * 50
    assert health.counters["repeated"] == 50 and not health.faults
    assert not any(feed(49, 0.2 + 0.002 * k) for k in range(100))
    assert health.faults["stalled"] == "the sensor repeats a sample (Fz 49)"
    assert feed(52, 0.5) is not None and health.counters["lost"] == 2
    feed(32767, 0.502)
    lost = health.counters["lost"]
    # The counter begins anew, here at -32768, which is lost.
    assert feed(-32767, 0.504) is not None and health.counters["lost"] == lost + 1


def test_two_sensors_of_the_same_identifiers_are_told_and_their_mixture_is_not_good() -> None:
    """Two at 500 Hz, 1 N and 16 N, for 2 s, then the first alone."""
    sensor = Dbc(SHIPPED)
    good: dict[int, list[bool]] = {0: [], 1: [], 2: []}
    for k in range(1500):
        for delay, force in ((0.0, 1.0), (0.001, 16.0)):
            if k >= 1000 and delay:
                continue
            first, second = rft_frames(np.array([0, 0, force, 0, 0, 0]))
            sensor.feed(1, first, 0.002 * k + delay)
            sample = sensor.feed(2, second, 0.002 * k + delay + 0.0003)
            assert sample is not None
            good[k // 500].append(sample.quality == GOOD)
        if k == 999:
            told = sensor.source.health.faults["conflict"]
    assert told.startswith("1000 samples per second come, 500 are expected: does another sensor")
    assert not any(good[1][20:]) and all(good[2][300:])


def test_samples_of_one_sensor_that_waited_and_come_at_once_are_no_second_sensor() -> None:
    sensor, first_and_second = Dbc(SHIPPED), rft_frames(np.ones(6))
    for k in range(1500):
        at = max(0.002 * k, 1.4) if 500 <= k < 700 else 0.002 * k
        for identifier, data in enumerate(first_and_second, 1):
            sample = sensor.feed(identifier, data, at)
        assert sample is not None and sample.quality == GOOD
    assert not sensor.source.health.faults


POLLED = (
    "match: {Response: 0x0B}",
    """match: {Response: 0x0A}
request: {id: 0x64, data: "0A 00 00 00 00 00 00 00"}
counter: {signal: Fz, modulus: 65536}
""",
)
"""What makes the shipped mapping one of a sensor that is polled and counts what it measures."""


class AbortingBox(threading.Thread):
    """A sensor that takes `seconds` for a reply, and begins anew when it is asked meanwhile."""

    def __init__(self, channel: str, seconds: float) -> None:
        super().__init__(daemon=True)
        self._bus, self._seconds = open_bus("virtual", channel), seconds
        self.aborted = self.replies = 0
        self.ending = threading.Event()

    def run(self) -> None:
        due: float | None = None
        while not self.ending.is_set():
            left = 0.05 if due is None else max(0.0, due - time.monotonic())
            message = self._bus.recv(left)
            if message is not None and message.data[0] == 0x0A:
                self.aborted += due is not None
                due = time.monotonic() + self._seconds
            elif due is not None and time.monotonic() >= due:
                due, self.replies = None, self.replies + 1
                wrench = np.array([0.0, 0.0, 14 * self.replies / 50, 0.0, 0.0, 0.0])
                for identifier, data in enumerate(rft_frames(wrench, response=0x0A), 1):
                    self._bus.send(frame(identifier, data))
        self._bus.shutdown()


def test_a_polled_sensor_is_not_asked_while_it_replies(tmp_path: Path) -> None:
    """It needs 2.5 ms for a reply, is to be asked every 2 ms, and measures 14 times meanwhile."""
    box = AbortingBox("aborting", 0.0025)
    box.start()
    mapping = str(changed_mapping(tmp_path, POLLED))
    source = DbcSource(
        DbcSettings(
            can_interface="virtual",
            can_channel="aborting",
            dbc_mapping=mapping,
            response_timeout=1.0,
        )
    )
    try:
        source.connect()
        samples = [sample for _ in range(100) if (sample := source.read(5.0)) is not None]
        assert len(samples) == 100 and box.aborted == 0
        assert np.min(np.diff([s.stamp_ns for s in samples])) > 0
        counters = source.health.counters
        # On a busy machine the two frames of a reply may come apart. What it measured besides, 13
        # a reply, is not lost.
        assert counters["lost"] < 13 and counters["overrun"] >= 5
    finally:
        source.close()
        box.ending.set()
        box.join()


def test_a_polled_sensor_that_does_not_answer_is_told_with_the_rate(tmp_path: Path) -> None:
    mapping = str(changed_mapping(tmp_path, POLLED))
    source = DbcSource(
        DbcSettings(can_interface="virtual", can_channel="nobody", dbc_mapping=mapping, rate=250.0)
    )
    with pytest.raises(DeviceError, match="no sample within 1 s at 250 requests per second; check"):
        source.connect()
    source.close()
    assert source.health.faults["lost"] == "no complete reply within 50 ms"


def test_a_reply_that_comes_when_it_was_given_up_is_no_sample(tmp_path: Path) -> None:
    sensor = Dbc(changed_mapping(tmp_path, POLLED))
    source, request, sent = sensor.source, frame(0x64, b"\x0a"), []

    class Wire:
        def send(self, message: can.Message, timeout: float) -> None:
            sent.append(message)

    def answer(at: float) -> WrenchSample | None:
        first, second = rft_frames(np.ones(6), response=0x0A)
        sensor.feed(1, first, at)
        return sensor.feed(2, second, at + 0.001)

    def poll() -> None:
        source._poll(Wire(), request)  # type: ignore[arg-type]

    poll()
    poll()
    assert len(sent) == 1
    source._deadline = 0.0  # as if the time for a reply had passed
    poll()
    assert len(sent) == 1 and source.health.counters["lost"] == 1
    assert answer(0.1) is None and source.health.counters["late_replies"] == 2
    source._quiet_until = source._due = time.monotonic()
    poll()
    sample = answer(0.104)
    assert len(sent) == 2 and sample is not None
    # The middle between the request, at 0.101 s, and the first frame.
    assert (sample.stamp_ns - sensor.START) * 1e-9 == pytest.approx(0.1025, abs=1e-6)


def test_dbc_sensor_streams_from_another_process_through_faults(free_port: object) -> None:
    port = free_port()  # type: ignore[operator]
    with device("rft", "--options", f"port={port}", WRENCH) as sensor:
        source = open_source(
            {"device": "dbc", "can_interface": "udp_multicast", "can_options": f"port={port}"}
        )
        try:
            samples = collect(source, 200)
            assert source.health.counters["malformed"] == 0, "its answer to the start is none"
            for fault in ("no_second 5", "swapped 5", "short 5", "foreign 5"):
                sensor.say(fault)
                samples += collect(source, 50)
            counted = dict(source.health.counters)
            sensor.say("reset 1")
            with pytest.raises(DeviceError, match="no sample"):
                for _ in range(20):
                    source.read(0.5)
            collect(source, 20)
        finally:
            source.close()
    mean = np.mean([s.channels for s in samples], axis=0)
    # Half a count (10 mN) of rounding and 10 mN of noise over 400 samples.
    assert np.all(np.abs(mean[:3] - TRUTH[:3]) < 0.012)
    assert np.all(np.abs(mean[3:] - TRUTH[3:]) < 4e-4)
    worst = np.max(np.abs([s.force - TRUTH[:3] for s in samples]))
    assert worst < 0.08, "a sample was put together wrongly"
    assert counted["lost"] >= 5 and counted["malformed"] >= 5 and counted["foreign"] >= 10


@pytest.fixture
def sensor(request: pytest.FixtureRequest) -> Iterator[Callable[..., list[bytes]]]:
    """Commands to a simulated RFT with 250 N on it: the frames that the last one is answered by."""
    channel = request.node.name
    options = RftOptions(interface="virtual", channel=channel, noise=0.0, wrench="250,0,0,0,0,0")
    bus = open_bus("virtual", channel)

    def ask(*commands: can.Message) -> list[bytes]:
        for command in commands:
            bus.send(command)
        replies = [bus.recv(20.0) for _ in range(2)]
        assert [reply.arbitration_id for reply in replies if reply is not None] == [1, 2]
        return [bytes(reply.data) for reply in replies if reply is not None]

    with RftSimulator(options):
        yield ask
    bus.shutdown()


def command(*data: int) -> can.Message:
    return frame(0x64, bytes(data).ljust(8, b"\0"))


def test_the_sensor_tells_of_overload_whatever_its_bias(
    sensor: Callable[..., list[bytes]],
) -> None:
    unbiased, _ = rft_frames(np.array([250.0, 0, 0, 0, 0, 0]), response=0x0A)
    first, second = sensor(command(0x0A))
    assert first == unbiased and second[5] == 0x20
    first, second = sensor(command(0x11, 1), command(0x0A))
    assert first == bytes([0x0A, *bytes(7)]) and second[5] == 0x20


@pytest.mark.parametrize("kind", ["is_extended_id", "is_remote_frame", "is_error_frame", "is_fd"])
def test_the_sensor_takes_plain_frames_only(
    sensor: Callable[..., list[bytes]], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    model = command(0x01)
    setattr(model, kind, True)
    assert sensor(model, command(0x0A))[0][0] == 0x0A
    assert capsys.readouterr().out == ""


def test_overload_is_not_good(free_port: object) -> None:
    port = free_port()  # type: ignore[operator]
    with device("rft", "--options", f"port={port}", "--wrench=0,0,-250,0,0,0"):
        source = open_source(
            {"device": "dbc", "can_interface": "udp_multicast", "can_options": f"port={port}"}
        )
        try:
            assert all(s.quality == SATURATED for s in collect(source, 20))
        finally:
            source.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("Fx: 0.02", "Fq: 0.02"), "Fq"),
        (("frames: [RFT_Reply_1, RFT_Reply_2]", "frames: [RFT_Reply_9]"), "RFT_Reply_9"),
        (("  force_z: {Fz: 0.02}\n", ""), "force_z"),
        (("database: robotous_rft.dbc", "database: none.dbc"), "none.dbc"),
        (("0C 00", "0C 0Z"), "hexadecimal"),
        (("within: 0.005", "within: soon"), "within"),
        (("name: Robotous", "nam: Robotous"), "nam"),
    ],
)
def test_a_wrong_mapping_is_refused_by_file_and_key(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    path = changed_mapping(tmp_path, change)
    with pytest.raises(InputError, match=message) as caught:
        SensorMapping.load(path)
    assert str(tmp_path) in str(caught.value)
