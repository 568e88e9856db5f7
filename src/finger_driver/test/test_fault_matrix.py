# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Every fault a device can show, against the real nodes and simulators in other processes.

For each: what is published, the level and message of diagnostics, how long until good data come
again. Each test records its row as the property "fault"; `scripts/faults.py` writes
docs/faults.md from recorded ones.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from device_process import DeviceProcess, device, netft_settings
from waiting import wait_until

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import WrenchStamped  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402

from finger_common import diagnostics  # noqa: E402
from finger_common.stamps import header_stamp  # noqa: E402
from finger_driver import can_bus  # noqa: E402
from finger_driver.protocols.netcanoem import CRITICAL_BITS  # noqa: E402
from finger_driver.simulators.export import ExportFileSimulator, ExportOptions  # noqa: E402

pytestmark = pytest.mark.alone

TRUE_FORCE = np.array([0.1, 0.2, -1.5])
LEVELS = ("OK", "WARN", "ERROR")
Record = Callable[[str, object], None]

BUSY = re.compile("rate |no sample|no complete reply|no reply for|no record for|connected again")
"""Faults that a machine which stops for a while adds to any other."""
BUSY_BESIDE = re.compile("no sample for [0-9.]+ s: ")


@dataclass
class Topic:
    """Stands where a publisher was and keeps what the node published."""

    messages: list[tuple[float, Any]] = field(default_factory=list)

    def publish(self, message: Any) -> None:
        now = time.monotonic()
        if isinstance(message, bytes):  # as the force node publishes
            message = deserialize_message(message, WrenchStamped)
        self.messages.append((now, message))

    def present(self) -> bool:
        """Somebody always listens."""
        return True

    def since(self, start: float, end: float = math.inf) -> list[Any]:
        return [m for t, m in list(self.messages) if start <= t < end]


class NodeUnderTest:
    """A real node in this process, its output kept, its health recorded twenty times a second."""

    def __init__(self, domain: int, node_class: Any, topic: str, **parameters: Any) -> None:
        from rclpy.parameter import Parameter

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        overrides = [Parameter(k, value=v) for k, v in parameters.items()]
        self.node = node_class(context=self.context, parameter_overrides=overrides)
        assert self.node.bring_up()
        if hasattr(self.node, "_note_tare"):
            # That the sensor has no zero yet is no fault of a device.
            self.node._note_tare = lambda: None
            self.node.device.health.recovered("tare_needed")
        self.topic = Topic()
        setattr(self.node, topic, self.topic)
        if hasattr(self.node, f"{topic}_listeners"):
            setattr(self.node, f"{topic}_listeners", self.topic)
        self.reports: list[tuple[float, int, str, dict[str, str]]] = []
        self.watch()

    def watch(self) -> None:
        """Begin to record the health."""
        self._ending = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def unwatch(self) -> None:
        """Record the health no more."""
        self._ending.set()
        self._watcher.join()

    def _watch(self) -> None:
        while not self._ending.wait(0.05):
            report = self.node.device.health.report()
            self.reports.append((time.monotonic(), report.level, report.message, report.values))

    @property
    def counters(self) -> dict[str, int]:
        return dict(self.node.device.health.counters)

    def worst(self, start: float, says: str, publishes: bool = False) -> tuple[int, str]:
        """Highest level since `start` and its last message, of those that contain `says`.

        With an empty `says` of all messages but those of a busy machine. publishes: the fault
        leaves samples, so that an error "no sample" beside a warning is the machine's, too.
        """
        reports = list(self.reports)
        if publishes:
            reports = [
                (t, 1, text.partition(": ")[2], values)
                if BUSY_BESIDE.match(text)
                else (t, level, text, values)
                for t, level, text, values in reports
            ]
        seen = [
            (level, message)
            for t, level, message, _ in reports
            if t >= start and (says in message if says else not BUSY.match(message))
        ]
        level = max((level for level, _ in seen), default=0)
        return level, next((m for lv, m in reversed(seen) if lv == level), "active")

    def close(self) -> None:
        self.unwatch()
        # The publishers were taken out; the node must not be asked to destroy them twice.
        self.node.release()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(scope="module")
def domain(free_ros_domain: Callable[[], int]) -> Iterator[int]:
    """A ROS domain of this module's own, with faults shown for a shorter time."""
    number = free_ros_domain()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        # A fault that has passed is shown for two seconds; here the next test waits for its end.
        patch.setattr(diagnostics, "HOLD", 0.3)
        yield number


def row(
    record: Record, device: str, fault: str, published: str, level: int, message: str, time: float
) -> None:
    """Record a row of the table; time until good data in s."""
    diagnostics = f"{LEVELS[level]}: {message}"
    cells = (device, fault, published, diagnostics, f"{max(time, 0):.2f} s")
    record("fault", json.dumps([clean(cell) for cell in cells], ensure_ascii=False))


def clean(cell: str) -> str:
    """A cell without the paths, names and ports of this run."""
    cell = re.sub(r"/[\w./-]*pytest[\w./-]*", "PATH", cell.replace("|", "/"))
    cell = re.sub(r"127\.0\.0\.1(:\d+)?", "HOST", cell)
    return re.sub(r"\b\d{19}_\d{8}\b", "STAMP_NUMBER", cell)


def settle(good: Callable[[], Any], fault_gone: Callable[[], bool]) -> None:
    wait_until(good, "good data before the fault")
    wait_until(fault_gone, "the last fault to be over")


def free_udp_port() -> int:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


FAST_RECONNECT: dict[str, Any] = {"reconnect_first_pause": 0.1, "reconnect_longest_pause": 0.5}

# NETCANOEM ---------------------------------------------------------------------------------------


class BusOff(can.BusABC):
    """Passes on to a bus; sending fails while the controller is off the bus."""

    off = False

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__("wrapped")
        self._inner = bus
        self._can_protocol = bus.protocol

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if BusOff.off:
            raise can.CanOperationError("bus off")
        self._inner.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self._inner.recv(timeout), False

    def shutdown(self) -> None:
        super().shutdown()
        self._inner.shutdown()


@pytest.fixture(scope="module")
def board(domain: int) -> Iterator[tuple[DeviceProcess, NodeUnderTest]]:
    from finger_driver.force_node import ForceNode

    port = free_udp_port()
    real = can_bus.open_bus
    wrench = ",".join(map(str, [*TRUE_FORCE, 0.001, 0.002, 0]))
    with device(
        "netcanoem", "--options", f"port={port}", "--slots", "0,3", f"--wrench={wrench}"
    ) as simulator:
        can_bus.open_bus = lambda *a, **k: BusOff(real(*a, **k))  # type: ignore[assignment]
        under_test = NodeUnderTest(
            domain,
            ForceNode,
            "_tared",
            can_interface="udp_multicast",
            can_options=f"port={port}",
            calibration_slot=3,
            response_timeout=0.05,
            rate=250.0,
            **FAST_RECONNECT,
        )
        yield simulator, under_test
        under_test.close()
        can_bus.open_bus = real


def force_of(message: Any) -> np.ndarray:
    f = message.wrench.force
    return np.array([f.x, f.y, f.z])


def run_force_fault(
    record: Record,
    test: NodeUnderTest,
    label: tuple[str, str],
    begin: Callable[[], Any],
    end: Callable[[], Any],
    duration: float,
    stops: bool,
    level: int,
    says: str,
    momentary: bool = False,
) -> None:
    """Show a fault for a while; then good data must come back.

    stops: nothing may be published meanwhile. level, says: of diagnostics. momentary: the fault
    ends by itself.
    """
    topic = test.topic
    settle(
        lambda: len(topic.since(time.monotonic() - 0.2)) > 5,
        lambda: not test.node.device.health.faults,
    )
    start = time.monotonic()
    begin()
    # What was on its way when the fault began is published first.
    if stops:
        silence = 0.15 if momentary else 0.3
        wait_until(lambda: not topic.since(time.monotonic() - silence), "silence")
    quiet_from = time.monotonic() + (0.0 if stops else 0.1)
    if not (stops and momentary):
        time.sleep(duration)
    if says and not momentary:
        wait_until(lambda: test.worst(start, says, not stops)[0] == level, "the report")
    quiet_to = time.monotonic()
    end()
    over = time.monotonic()
    first = wait_until(
        lambda: next((t for t, _ in list(topic.messages) if t > over), None), "recovery"
    )
    wait_until(lambda: len(topic.since(over)) > 10, "a stream again")
    during = topic.since(quiet_from, quiet_to)
    if stops:
        assert not during
    published = topic.since(start)
    stamps = np.array([header_stamp(m) for m in published])
    assert np.all(np.diff(stamps) > 0), "stamps went back"
    ages = [t - header_stamp(m) * 1e-9 for t, m in topic.messages]
    shift = min(ages)
    assert max(a - shift for a in ages[-len(published) :]) < 1.5, "something old was published"
    errors = np.abs([force_of(m) - TRUE_FORCE for m in published])
    assert errors.max() < 0.05, "a wrong force was published"
    worst, message = test.worst(start, says, not stops)
    assert worst == level and says in message, (worst, message)
    rate = len(during) / max(quiet_to - quiet_from, 1e-9)
    what = f"good samples, {rate:.0f} per s" if during else "nothing"
    row(record, *label, what, worst, message, first - over)


NETCANOEM_FAULTS = [
    # fault, commands to begin, commands to end, s, nothing published, level, message
    ("unplugged and back", ["silent -1", "power"], ["silent 0"], 0.8, True, 2, "no "),
    ("silent device", ["silent -1"], ["silent 0"], 0.6, True, 2, "no "),
    ("foreign frames in between", ["foreign -1"], ["foreign 0"], 0.3, False, 0, ""),
    ("29-bit frames of the same number", ["extended -1"], ["extended 0"], 0.3, False, 0, ""),
    ("frames swapped", ["swapped -1"], ["swapped 0"], 0.3, False, 0, ""),
    (
        "frames sent twice",
        ["duplicate -1"],
        ["duplicate 0"],
        0.3,
        False,
        1,
        "does not belong to a reading",
    ),
    ("second frame lost, three times", ["no_second 3"], [], 0.3, False, 1, "no complete reply"),
    ("second frame always lost", ["no_second -1"], ["no_second 0"], 0.4, True, 2, "no complete"),
    ("late reply of the previous poll", ["late 3"], [], 0.5, False, 1, "no complete reply"),
    ("replies 10 ms late", ["delay 10"], ["delay 0"], 0.4, False, 0, ""),
    ("wrong length", ["wrong_length -1"], ["wrong_length 0"], 0.3, True, 2, "with 7 bytes"),
    ("error frames", ["error_frame -1"], ["error_frame 0"], 0.3, False, 1, "error frames"),
    ("saturated gauge", ["saturated -1"], ["saturated 0"], 0.3, True, 2, "gauge 3 is saturated"),
    ("reset to slot 0 in mid-stream", ["reset 1"], [], 0.3, False, 2, "calibration slot 3"),
    (
        "another device answers, too",
        ["rival -1"],
        ["rival 0"],
        0.4,
        True,
        2,
        "two different replies",
    ),
    ("bus full of other frames", ["flood -1"], ["flood 0"], 0.3, False, 1, "with 5 bytes"),
    ("unknown unit code", ["units 9 9", "power"], ["units 2 4"], 0.5, True, 2, "unit 9 is not"),
]


@pytest.mark.parametrize(
    ("name", "begin", "end", "duration", "stops", "level", "says"),
    NETCANOEM_FAULTS,
    ids=[f[0] for f in NETCANOEM_FAULTS],
)
def test_netcanoem_fault(
    record_property: Record,
    board: tuple[DeviceProcess, NodeUnderTest],
    name: str,
    begin: list[str],
    end: list[str],
    duration: float,
    stops: bool,
    level: int,
    says: str,
) -> None:
    simulator, test = board
    before = test.counters
    run_force_fault(
        record_property,
        test,
        ("NETCANOEM", name),
        lambda: [simulator.say(c) for c in begin],
        lambda: [simulator.say(c) for c in end],
        duration,
        stops,
        level,
        says,
        not end,
    )
    counted = {k: v - before.get(k, 0) for k, v in test.counters.items()}
    expected = {
        "foreign frames in between": "foreign",
        "29-bit frames of the same number": "foreign",
        "second frame lost, three times": "half_replies",
        "late reply of the previous poll": "late_replies",
        "replies 10 ms late": "late",
        "wrong length": "malformed",
        "saturated gauge": "saturated",
        "reset to slot 0 in mid-stream": "reconnects",
    }.get(name)
    if expected is not None:
        assert counted.get(expected, 0) >= 1, counted
    if name == "reset to slot 0 in mid-stream":
        assert counted["calibration_lost"] >= 1 or counted["connection"] >= 1, counted


@pytest.mark.parametrize("bit", CRITICAL_BITS)
def test_netcanoem_critical_status_bit(
    record_property: Record, board: tuple[DeviceProcess, NodeUnderTest], bit: int
) -> None:
    from finger_driver.protocols.netcanoem import STATUS_BITS

    simulator, test = board
    run_force_fault(
        record_property,
        test,
        ("NETCANOEM", f"status bit {bit}"),
        lambda: simulator.say(f"status {1 << bit}"),
        lambda: simulator.say("status 0"),
        0.15,
        True,
        2,
        STATUS_BITS[bit],
    )


@pytest.mark.parametrize(
    ("bit", "meaning"), [(14, "CAN bus error"), (15, "an error without a cause")]
)
def test_netcanoem_status_that_is_not_critical_does_not_stop_the_data(
    record_property: Record, board: tuple[DeviceProcess, NodeUnderTest], bit: int, meaning: str
) -> None:
    simulator, test = board
    run_force_fault(
        record_property,
        test,
        ("NETCANOEM", f"status bit {bit} ({meaning})"),
        lambda: simulator.say(f"status {1 << bit}"),
        lambda: simulator.say("status 0"),
        0.3,
        False,
        1,
        meaning,
    )
    assert len(test.topic.messages) > 0


def test_netcanoem_bus_off(
    record_property: Record, board: tuple[DeviceProcess, NodeUnderTest]
) -> None:
    def off(value: bool) -> None:
        BusOff.off = value

    run_force_fault(
        record_property,
        board[1],
        ("NETCANOEM", "bus off"),
        lambda: off(True),
        lambda: off(False),
        0.4,
        True,
        2,
        "bus off",
    )


# Net F/T -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def box(domain: int) -> Iterator[tuple[DeviceProcess, NodeUnderTest]]:
    from finger_driver.force_node import ForceNode

    wrench = ",".join(map(str, [*TRUE_FORCE, 0.001, 0.002, 0]))
    with device("rdt", "--port", 0, "--http-port", 0, f"--wrench={wrench}") as simulator:
        under_test = NodeUnderTest(
            domain,
            ForceNode,
            "_tared",
            **netft_settings(simulator),
            **FAST_RECONNECT,
        )
        yield simulator, under_test
        under_test.close()


NETFT_FAULTS = [
    ("unplugged and back", ["silent -1"], ["silent 0"], 0.6, True, 2, "no "),
    ("one record missing", ["gap 1"], [], 0.2, False, 0, "", "lost"),
    ("records twice", ["duplicate 50"], [], 0.2, False, 0, "", "out_of_order"),
    ("records out of order", ["reordered 5"], [], 0.2, False, 0, "", "out_of_order"),
    ("numbering restarts", ["restart 1"], [], 0.3, False, 2, "numbering restarted"),
    ("box rebooted", ["reboot 1"], [], 0.3, False, 2, ""),
    ("internal sample stands still", ["stalled -1"], ["stalled 0"], 0.3, True, 2, "repeats"),
    ("datagram cut short", ["short 5"], [], 0.3, False, 1, "20 bytes"),
    ("transducer saturated", ["status 0x80020000"], ["status 0"], 0.3, True, 2, "saturation"),
    ("digital board fault", ["status 0xA0000000"], ["status 0"], 0.3, True, 2, "digital board"),
    ("monitor latched", ["status 0x80010000"], ["status 0"], 0.3, False, 1, "latched"),
    ("a forged record 1000 ahead", ["jump 5"], [], 0.3, False, 1, "left out", "jump"),
    (
        "counts per newton 1e-2", ["reboot 1", "units N N-mm 0.01 1000000"],
        ["units N N-mm 1000000 1000000"], 0.8, True, 2, "check counts per unit",
    ),
    ("page cut off after a reboot", ["bad_page 2", "reboot 1"], [], 0.5, True, 2, ""),
    (
        "other units after a reboot", ["reboot 1", "units lbf lbf-in 1000 1000"], [],
        0.4, True, 2, "",
    ),
]  # fmt: skip


@pytest.mark.parametrize("case", NETFT_FAULTS, ids=[f[0] for f in NETFT_FAULTS])
def test_netft_fault(
    record_property: Record, box: tuple[DeviceProcess, NodeUnderTest], case: Any
) -> None:
    name, begin, end, duration, stops, level, says, *counter = case
    simulator, test = box
    before = test.counters
    run_force_fault(
        record_property,
        test,
        ("Net F/T", name),
        lambda: [simulator.say(c) for c in begin],
        lambda: [simulator.say(c) for c in end],
        duration,
        stops,
        level,
        says,
        not end,
    )
    for key in counter:
        assert test.counters.get(key, 0) > before.get(key, 0)


def test_netft_units_changed_on_the_page_while_it_streams(
    record_property: Record,
    box: tuple[DeviceProcess, NodeUnderTest],
) -> None:
    simulator, test = box
    reconnects = test.counters["reconnects"]
    start = time.monotonic()
    simulator.say("units N N-mm 1000000 1000000")
    changed = "units or counts were changed"
    wait_until(lambda: test.worst(start, changed)[0] == 2, "the change to be reported")
    wait_until(lambda: test.counters["reconnects"] > reconnects, "the page to be read again")
    took = time.monotonic() - start
    time.sleep(0.3)
    errors = [np.abs(force_of(m) - TRUE_FORCE).max() for _, m in test.topic.messages[-20:]]
    assert max(errors) < 0.05
    during = test.topic.since(start, start + took)
    wrong = sum(np.abs(force_of(m) - TRUE_FORCE).max() > 0.05 for m in during)
    level, message = test.worst(start, changed)
    row(
        record_property,
        "Net F/T",
        "units changed on its page while it streams",
        f"{wrong} samples in the old units",
        level,
        message,
        took,
    )


# Camera ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def camera(
    domain: int, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[DeviceProcess, NodeUnderTest]]:
    from finger_driver.camera_node import CameraNode

    folder = tmp_path_factory.mktemp("frames")
    with device("images", folder, "--size", "160x120", "--rate", 25) as simulator:
        under_test = NodeUnderTest(
            domain, CameraNode, "_image", device="folder", path=str(folder), rate=25.0,
            frozen_after=4, **FAST_RECONNECT,
        )  # fmt: skip
        yield simulator, under_test
        under_test.close()


CAMERA_FAULTS = [
    ("no frames", ["silent -1"], ["silent 0"], 1.5, "none", 2, "no sample"),
    ("frozen: the same image again", ["frozen -1"], ["frozen 0"], 0.8, "few", 2, "same image"),
    ("slower than asked", ["rate 10"], ["rate 25"], 1.5, "some", 1, "rate"),
    ("frames missing", ["lost 3"], [], 0.5, "some", 0, ""),
    ("file damaged", ["damaged 3"], [], 0.5, "some", 1, "not an image"),
]


@pytest.mark.parametrize("case", CAMERA_FAULTS, ids=[f[0] for f in CAMERA_FAULTS])
def test_camera_fault(
    record_property: Record, camera: tuple[DeviceProcess, NodeUnderTest], case: Any
) -> None:
    name, begin, end, duration, published, level, says = case
    simulator, test = camera
    topic = test.topic
    settle(
        lambda: len(topic.since(time.monotonic() - 0.5)) > 5,
        lambda: not test.node.device.health.faults,
    )
    before = test.counters
    start = time.monotonic()
    for command in begin:
        simulator.say(command)
    time.sleep(duration)
    if published == "some":
        wait_until(lambda: topic.since(start + 0.3), "images meanwhile")
    during = topic.since(start + 0.3)
    # The rate is judged over a second, as the node's timer does.
    time.sleep(0.1)
    if name == "slower than asked":
        health = test.node.device.health
        test.unwatch()
        health.report()
        time.sleep(1.0)
        report = health.report()
        worst, message = report.level, report.message
        test.watch()
    else:
        worst, message = test.worst(start, says)
    assert worst == level and says in message, (worst, message)
    for command in end:
        simulator.say(command)
    over = time.monotonic()
    first = wait_until(
        lambda: next((t for t, _ in list(topic.messages) if t > over), None), "recovery"
    )
    if published == "none":
        assert not during
    elif published == "few":
        assert len(during) <= 4
    if name == "frames missing":
        assert test.counters["lost"] - before.get("lost", 0) == 3
    text = {
        "none": "nothing",
        "few": "nothing after 4 equal images",
        "some": "the frames that came",
    }
    row(record_property, "camera", name, text[published], worst, message, first - over)


# Moisture ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def probe(
    domain: int, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[DeviceProcess, NodeUnderTest]]:
    from finger_driver.moisture_node import MoistureNode

    link = tmp_path_factory.mktemp("serial") / "port"
    with device("serial", "--link", link) as simulator:
        under_test = NodeUnderTest(
            domain, MoistureNode, "_publisher", device="serial", path=str(link), **FAST_RECONNECT
        )
        yield simulator, under_test
        under_test.close()


class ExportCommands:
    """The commands of the export's rows: "send VALUE", or a fault for the next reading."""

    def __init__(self, path: Path) -> None:
        self._file = ExportFileSimulator(ExportOptions(path=str(path)))

    def say(self, command: str) -> None:
        word, _, value = command.partition(" ")
        if word == "send":
            self._file.send(float(value))
        else:
            self._file.faults.set(word, 1)


@pytest.fixture(scope="module")
def export(
    domain: int, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[ExportCommands, NodeUnderTest]]:
    from finger_driver.moisture_node import MoistureNode

    path = tmp_path_factory.mktemp("export") / "readings.csv"
    table = ExportCommands(path)
    table.say("send 99")
    under_test = NodeUnderTest(
        domain,
        MoistureNode,
        "_publisher",
        device="export",
        path=str(path),
        export_phase_column="phase",
        export_period=0.15,
        **FAST_RECONNECT,
    )
    yield table, under_test
    under_test.close()


SERIAL_FAULTS = [
    # fault, commands, values published, level, message
    ("half a line", ["half_line 1", "send 41.0", "wait 0.7", "send 42.0"], [42.0], 1, "broke off"),
    ("bytes that are not text", ["garbage 1", "send 1", "send 43.0"], [43.0], 1, "not ASCII"),
    ("no end of line", ["no_end 1", "send 1", "wait 0.7", "send 44.0"], [44.0], 1, "broke off"),
    (
        "unplugged and back", ["unplug", "wait 0.5", "plug", "reconnect", "wait 0.2", "send 45.0"],
        [45.0], 2, "port",
    ),
    ("two readings in one piece", ["held 1", "send 47.0", "send 48.0"], [47.0, 48.0], 0, ""),
    ("reading 131", ["send 131", "send 46.0"], [131.0, 46.0], 1, "131 a.u. is outside"),
]  # fmt: skip
EXPORT_FAULTS = [
    ("file rewritten in place", ["send 50", "rewrite", "send 51"], [50.0, 51.0], 0, ""),
    ("row written in two halves", ["half_row", "send 52"], [52.0], 0, ""),
    (
        "column missing", ["wrong_header", "send 53", "wait 0.6", "rewrite", "send 54"],
        [53.0, 54.0], 2, "no column 'value'",
    ),
    (
        "not a table", ["garbage", "send 55", "wait 0.6", "rewrite", "send 56"],
        [55.0, 56.0], 2, "not utf-8",
    ),
    ("reading 131", ["send 131"], [131.0], 1, "131 a.u. is outside"),
]  # fmt: skip


def run_moisture_fault(record: Record, rig: tuple[Any, NodeUnderTest], who: str, case: Any) -> None:
    name, commands, values, level, says = case
    simulator, test = rig
    test.node.device.health.recovered()
    start = time.monotonic()
    reconnects = test.counters.get("reconnects", 0)
    for command in commands:
        word, _, number = command.partition(" ")
        if word == "wait":
            time.sleep(float(number))
        elif word == "reconnect":
            wait_until(lambda: test.counters.get("reconnects", 0) > reconnects, "reconnection")
        else:
            simulator.say(command)
    sent = time.monotonic()
    wait_until(lambda: len(test.topic.since(start)) >= len(values), f"{name}: {values}")
    arrived = test.topic.messages[-1][0]
    time.sleep(0.15)
    messages = test.topic.since(start)
    assert [m.value for m in messages] == values
    assert [m.flags & 1 for m in messages] == [int(v > 130) for v in values]
    stamps = [header_stamp(m) for m in messages]
    assert stamps == sorted(set(stamps)), "stamps that do not increase"
    worst, message = test.worst(start, says)
    assert worst == level and says in message, (worst, message)
    text = ", ".join(f"{v:g}" + (" (flagged)" if v > 130 else "") for v in values)
    row(record, who, name, text, worst, message, arrived - sent)


@pytest.mark.parametrize("case", SERIAL_FAULTS, ids=[f[0] for f in SERIAL_FAULTS])
def test_serial_moisture_fault(
    record_property: Record, probe: tuple[DeviceProcess, NodeUnderTest], case: Any
) -> None:
    run_moisture_fault(record_property, probe, "moisture, serial", case)


@pytest.mark.parametrize("case", EXPORT_FAULTS, ids=[f[0] for f in EXPORT_FAULTS])
def test_export_moisture_fault(
    record_property: Record, export: tuple[ExportCommands, NodeUnderTest], case: Any
) -> None:
    run_moisture_fault(record_property, export, "moisture, export", case)


def test_readings_keep_counting_through_all_faults(
    probe: tuple[DeviceProcess, NodeUnderTest],
) -> None:
    _, test = probe
    indices = [m.index for _, m in test.topic.messages]
    assert indices == list(range(len(indices)))


def test_the_page_holds_the_recorded_results(project_root: Path) -> None:
    script = project_root / "scripts" / "faults.py"
    done = subprocess.run(
        [sys.executable, script, "--check"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads((Path(__file__).with_name("recorded_faults.json")).read_text())
    tested = [case[0] for case in [*NETCANOEM_FAULTS, *NETFT_FAULTS, *CAMERA_FAULTS]]
    tested += [case[0] for case in [*SERIAL_FAULTS, *EXPORT_FAULTS]]
    assert set(tested) <= {row[1] for row in rows}
