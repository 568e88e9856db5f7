# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The thread that reads a device, whatever device and node do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
from waiting import wait_until

from finger_common import diagnostics
from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import DeviceError
from finger_common.retry import Pauses
from finger_common.settings import Settings
from finger_driver.device import Device, DeviceThread
from finger_driver.force.source import ForceSettings, ForceSource


class Counting(Device[int]):
    """Gives numbers; `lost` once: the device was lost since it was connected."""

    def __init__(self) -> None:
        super().__init__(Settings(), Health("counting"))
        self.number, self.lost = 0, False

    def connect(self) -> None:
        self.lost = False

    def read(self, timeout: float) -> int | None:
        time.sleep(0.005)
        self.number += 1
        return self.number

    def close(self) -> None:
        pass

    def flush(self) -> None:
        if self.lost:
            raise DeviceError("no answer")


@pytest.fixture
def read() -> Iterator[Callable[..., DeviceThread]]:
    threads: list[DeviceThread] = []

    def start(device: Counting, on_sample: Callable[[int], None]) -> DeviceThread:
        threads.append(DeviceThread(device, on_sample, Pauses(0.01, 0.02)))
        threads[-1].start()
        return threads[-1]

    yield start
    for thread in threads:
        assert thread.stop()


@pytest.mark.parametrize(("rate", "silence"), [(500.0, 0.25), (3.0, 1.0)])
def test_a_slow_sensor_is_not_taken_for_silent(rate: float, silence: float) -> None:
    source = ForceSource(ForceSettings(rate=rate))
    assert source.longest_silence == pytest.approx(silence)
    assert source.health.stale_after is not None
    assert source.health.stale_after > source.longest_silence


def test_a_device_lost_before_reading_begins_is_connected_again(
    read: Callable[..., DeviceThread], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnostics, "HOLD", 0.2)
    device, samples = Counting(), []
    device.lost = True
    thread = read(device, samples.append)
    wait_until(lambda: len(samples) > 3, "samples")
    wait_until(lambda: not device.health.faults, "no fault")
    assert thread.running and device.health.counters["reconnects"] == 1


def test_a_short_loss_is_still_told_as_a_warning_when_it_is_over(
    read: Callable[..., DeviceThread],
) -> None:
    """Diagnostics are sent once a second; the loss ends within hundredths of one."""
    device, samples, now = Counting(), [], [100.0]
    device.health._clock = lambda: now[0]
    device.lost = True
    read(device, samples.append)
    while len(samples) < 3:
        time.sleep(0.005)
    for age, shown in ((-2.0, True), (-0.1, True), (0.1, False)):
        now[0] = 100.0 + diagnostics.HOLD + age
        report = device.health.report()
        assert (report.level == WARN) is shown and report.level <= WARN
        assert ("connected again after: no answer" in report.message) is shown


@pytest.mark.parametrize("kind", ["silent camera", "broken port"])
def test_a_device_that_connects_and_does_not_work_is_not_called_connected_again(
    read: Callable[..., DeviceThread], kind: str
) -> None:
    """A camera that opens and sends nothing, a port that opens and cannot be read: while it lasts,
    longer than a fault that has passed is shown, one line says so."""

    class Broken(Counting):
        broken = False

        def read(self, timeout: float) -> int | None:
            sample = super().read(timeout)
            if not self.broken:
                return sample
            now[0] += 3.0
            if kind == "silent camera" and self.number % 2:
                return None
            raise (DeviceError if self.number % 3 else OSError)("nothing comes")

    device, samples, said, now = Broken(), [], [], [100.0]
    device.health._clock = lambda: now[0]
    if kind == "silent camera":
        device.health.stale_after = 1e9
    device.log = lambda level, text: said.append(text)
    read(device, samples.append)
    wait_until(lambda: samples, "samples")
    device.broken = True
    wait_until(lambda: device.health.counters["reconnects"] > 9, "attempts")
    assert sorted(said) == ["OSError: nothing comes", "nothing comes"]
    assert device.health.report().level == ERROR
    samples.clear()
    device.broken = False
    wait_until(lambda: samples, "samples")
    wait_until(lambda: len(said) > 2, "the end")
    assert said[2:] == ["counting: connected again"]
    assert "connected again after: " in device.health.faults["connection"]


def test_a_probe_is_connected_again_before_its_next_reading(
    read: Callable[..., DeviceThread],
) -> None:
    class Probe(Counting):
        def read(self, timeout: float) -> int | None:
            super().read(timeout)
            return None

    device, said = Probe(), []
    device.log = lambda level, text: said.append(text)
    device.lost = True
    read(device, lambda sample: None)
    wait_until(lambda: len(said) > 1, "the end of the loss")
    assert said == ["no answer", "counting: connected again"]
    assert device.health.report().level == WARN


def test_a_device_that_fails_while_it_is_closed_is_connected_again(
    read: Callable[..., DeviceThread],
) -> None:
    """As of an adapter that was unplugged."""

    class Unplugged(Counting):
        def read(self, timeout: float) -> int | None:
            if self.number == 5:
                raise DeviceError("unplugged")
            return super().read(timeout)

        def close(self) -> None:
            if self.number == 5:
                self.number += 1
                raise OSError(5, "Input/output error")

    device, samples = Unplugged(), []
    thread = read(device, samples.append)
    wait_until(lambda: len(samples) > 8, "samples")
    assert thread.running and device.health.counters["reconnects"] == 1
    assert device.health.counters["close"] == 1
    assert device.health.last_error == "closing it failed (OSError: [Errno 5] Input/output error)"


def test_a_device_whose_driver_has_a_defect_is_connected_again(
    read: Callable[..., DeviceThread],
) -> None:
    class Stuck(Counting):
        """Raises until it is closed, as a socket whose other end is gone."""

        broken = False

        def read(self, timeout: float) -> int | None:
            self.broken |= self.number == 5
            if self.broken:
                raise BrokenPipeError("Broken pipe")
            return super().read(timeout)

        def close(self) -> None:
            self.number, self.broken = 10, False

    device, samples = Stuck(), []
    read(device, samples.append)
    wait_until(lambda: len(samples) > 8, "samples")
    assert device.health.counters["internal"] == device.health.counters["reconnects"] == 1


def test_an_error_in_the_node_is_forgotten_when_samples_are_taken_again(
    read: Callable[..., DeviceThread], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnostics, "HOLD", 0.2)
    device, samples = Counting(), []

    def take(sample: int) -> None:
        if sample < 3:
            raise KeyError("a defect")
        samples.append(sample)

    read(device, take)
    wait_until(lambda: "internal" in device.health.faults, "the fault")
    wait_until(lambda: samples and not device.health.faults, "samples without a fault")


def test_a_fault_ends_though_nothing_comes_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a probe whose next reading is minutes away."""
    monkeypatch.setattr(diagnostics, "HOLD", 0.1)
    device = Counting()
    device.note("malformed", "a bad line")
    device.cleared("malformed")
    assert device.health.faults
    wait_until(lambda: not device.health.faults, "no fault")
    device.note("malformed", "a bad line")
    time.sleep(0.15)
    assert device.health.faults, "it was not absent since"
