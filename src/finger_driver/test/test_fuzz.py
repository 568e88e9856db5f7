# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Random and mutated bytes through every decoder: no exception escapes, memory stays bounded.

3000 inputs per decoder here, 100 000 in the slow run. Mutations start from valid bytes, so that the
inner branches are reached.
"""

from __future__ import annotations

import random
import tracemalloc
from collections.abc import Callable, Iterator

import can
import numpy as np
import pytest

from finger_common.errors import DeviceError
from finger_driver.force.dbc import SHIPPED, DbcSettings, DbcSource
from finger_driver.force.netcanoem import NetcanoemSettings, NetcanoemSource
from finger_driver.force.netcanoem_dialog import Dialog
from finger_driver.force.netft import NetFtSettings, NetFtSource
from finger_driver.protocols import lines, netcanoem, netft_xml, rdt
from finger_driver.protocols.dbc import SampleAssembler, SensorMapping
from finger_driver.protocols.export_table import TableFormat, parse_table
from finger_driver.simulators.netcanoem import NetcanoemSimulator, default_calibration


def mutated(random_: random.Random, seeds: list[bytes], longest: int) -> bytes:
    """Random bytes, or a seed with bits flipped, bytes cut, doubled or replaced."""
    if random_.random() < 0.3:
        return random_.randbytes(random_.randrange(longest))
    data = bytearray(random_.choice(seeds))
    for _ in range(random_.randrange(1, 4)):
        kind = random_.randrange(5)
        place = random_.randrange(len(data) + 1)
        if kind == 0 and data:
            data[place % len(data)] ^= 1 << random_.randrange(8)
        elif kind == 1:
            del data[place : place + random_.randrange(1, 9)]
        elif kind == 2:
            data[place:place] = random_.randbytes(random_.randrange(1, 9))
        elif kind == 3:
            data[place:place] = data[: random_.randrange(1, 40)]
        elif data:
            data[place % len(data)] = random_.choice((0, 0xFF, 0x7F, 0x80, 0x0A, 0x2C))
    return bytes(data[:longest])


class FuzzBus(can.BusABC):
    """A bus on which anything may come: answers of a board, mutated, between random frames."""

    def __init__(self, random_: random.Random) -> None:
        super().__init__("fuzz")
        self._random = random_
        self._queue: list[can.Message] = []
        self.frames = 0
        self._board = NetcanoemSimulator(self, noise=1.0)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if msg.dlc in (0, 1) and not self._queue:
            self._board._handle(msg)
        else:
            self._queue.append(self._twist(msg))

    def _twist(self, msg: can.Message) -> can.Message:
        r = self._random
        if r.random() < 0.7:
            return msg
        data = mutated(r, [bytes(msg.data) or b"\0"], 9)[:8]
        identifier = r.choice((msg.arbitration_id, 0x200 | r.randrange(16), r.randrange(1 << 11)))
        return can.Message(
            arbitration_id=identifier,
            data=data,
            is_extended_id=r.random() < 0.1,
            is_error_frame=r.random() < 0.05,
            is_remote_frame=False,
        )

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._queue:
            self.frames += 1
            return self._queue.pop(0), False
        return None, False


def netcanoem_driver(random_: random.Random) -> Iterator[None]:
    """The driver itself against a board that answers anything; each step is at least one frame."""
    source = NetcanoemSource(
        NetcanoemSettings(rate=7000.0, response_timeout=0.001, calibration_check_period=3600.0)
    )
    source._period = 1e-6
    bus = FuzzBus(random_)
    source.calibration = default_calibration()
    source._dialog = Dialog(bus, netcanoem.DEFAULT_BASE, 0.001, source, "board")
    source._begin()
    while True:
        before = bus.frames
        try:
            sample = source.read(0.001)
            assert sample is None or np.all(np.isfinite(sample.force))
        except DeviceError:
            source._begin()
        for _ in range(max(1, bus.frames - before)):
            yield


def netcanoem_frames(random_: random.Random) -> Iterator[None]:
    seeds = [*netcanoem.encode_gauges(0, np.arange(6)), *netcanoem.encode_matrix_row(np.ones(6))]
    decoders: list[Callable[[bytes], object]] = [
        lambda d: netcanoem.decode_gauges(d, d[:6]),
        lambda d: netcanoem.decode_matrix_row((d, d, d)),
        netcanoem.decode_counts,
        netcanoem.decode_units,
        netcanoem.decode_firmware,
        netcanoem.decode_serial,
    ]
    while True:
        data = mutated(random_, seeds, 12)
        for decode in decoders:
            try:
                decode(data)
            except DeviceError:
                pass
        yield


def rdt_datagrams(random_: random.Random) -> Iterator[None]:
    """Datagrams through the decoder and the driver behind it."""
    source = NetFtSource(NetFtSettings())
    from finger_driver.clock import ClockMapper

    source._mapper, source._block = ClockMapper(500.0), 1
    source._begin()
    number = 0
    while True:
        number += random_.choice((1, 1, 1, 2, -3))
        record = rdt.Record(number & 0xFFFFFFFF, (14 * number) & 0xFFFFFFFF, 0, (1, 2, 3, 4, 5, 6))
        data = mutated(random_, [rdt.encode_record(record)], 1500)
        try:
            for decoded in rdt.decode_datagram(data):
                for in_order in source._in_order(decoded, source.clock.now()):
                    source._take(*in_order)
        except DeviceError:
            source._begin()
        try:
            rdt.decode_request(data[:8])
        except DeviceError:
            pass
        yield


def xml_pages(random_: random.Random) -> Iterator[None]:
    page = netft_xml.render(netft_xml.Configuration(1e6, 1e6, "N", "N-mm", "Net F/T", True, 500))
    while True:
        try:
            configuration = netft_xml.parse(mutated(random_, [page], 2000))
            assert np.isfinite(configuration.force_scale)
        except DeviceError:
            pass
        yield


def dbc_frames(random_: random.Random) -> Iterator[None]:
    mapping = SensorMapping.load(SHIPPED)
    assembler = SampleAssembler(mapping)
    source = DbcSource(DbcSettings())
    seeds = [bytes([0x0B, 0, 1, 0, 2, 0, 3, 0]), bytes([1, 0, 2, 0, 3, 0, 0, 0])]
    stamp = 0
    while True:
        stamp += random_.randrange(2_000_000)
        name = random_.choice(mapping.frames)
        try:
            done = assembler.add(name, mutated(random_, seeds, 10)[:8], stamp)
            if done is not None:
                assert np.all(np.isfinite(mapping.wrench(done[1])))
                source._quality(done[1])
        except DeviceError:
            pass
        yield


def serial_lines(random_: random.Random) -> Iterator[None]:
    splitter = lines.LineSplitter()
    pattern = lines.compile_pattern(lines.DEFAULT_PATTERN)
    seeds = [b"M=42.0;before\r\n", b"17,5\n", b"130\r\n"]
    while True:
        for line in splitter.feed(mutated(random_, seeds, 600)):
            parsed = None if line.text is None else lines.parse_line(line.text, pattern)
            assert parsed is None or np.isfinite(parsed.value)
        assert len(splitter._rest) <= lines.MAX_LINE + 1
        yield


def export_files(random_: random.Random) -> Iterator[None]:
    form = TableFormat(export_time_column="time", export_phase_column="phase")
    seed = b"time;value;phase\n2026-01-02 03:04:05;42,5;before\n2026-01-02 03:04:06;43,1;after\n"
    while True:
        try:
            for row in parse_table(mutated(random_, [seed], 2000), "a.csv", form)[0]:
                assert np.isfinite(row.value)
        except DeviceError:
            pass
        yield


DECODERS = [
    netcanoem_frames,
    netcanoem_driver,
    rdt_datagrams,
    xml_pages,
    dbc_frames,
    serial_lines,
    export_files,
]


def fuzz(decoder: Callable[[random.Random], Iterator[None]], number: int) -> None:
    steps = decoder(random.Random(20))
    for _ in range(number // 10):
        next(steps)
    tracemalloc.start()
    try:
        for _ in range(number // 10):
            next(steps)
        low = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        for _ in range(number * 7 // 10):
            next(steps)
        tracemalloc.start()
        for _ in range(number // 10):
            next(steps)
        high = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    # What a tenth of the inputs leaves behind must not grow with the number of inputs before it.
    assert high - low < 2_000_000


@pytest.mark.parametrize("decoder", DECODERS, ids=lambda d: d.__name__)
def test_nothing_escapes(decoder: Callable[[random.Random], Iterator[None]]) -> None:
    fuzz(decoder, 3_000)


@pytest.mark.slow
@pytest.mark.parametrize("decoder", DECODERS, ids=lambda d: d.__name__)
def test_nothing_escapes_from_100_000(decoder: Callable[[random.Random], Iterator[None]]) -> None:
    fuzz(decoder, 100_000)


def test_damaged_spreadsheets_are_refused() -> None:
    import io

    openpyxl = pytest.importorskip("openpyxl", reason="XLSX needs openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["value"])
    book.active.append([42.0])
    stream = io.BytesIO()
    book.save(stream)
    good = stream.getvalue()
    random_ = random.Random(5)
    assert parse_table(good, "a.xlsx", TableFormat())[0][0].value == 42.0
    for _ in range(150):
        try:
            parse_table(mutated(random_, [good], len(good) + 100), "a.xlsx", TableFormat())
        except DeviceError:
            pass


def test_health_counters_are_few_for_any_input() -> None:
    """Keys of counters are fixed words; a device must not be able to make new ones."""
    source = NetFtSource(NetFtSettings())
    source._quality(0xFFFFFFFF)
    source._quality(0x80020000)
    assert set(source.health.counters) <= {"critical", "saturated", "latched"}
