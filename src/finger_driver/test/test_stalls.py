# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A computer that stands still for 100 ms loses no sample: the driver's process is stopped."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from device_process import device, netft_settings

pytestmark = pytest.mark.alone

READER = """
import json, sys, time
from finger_driver.force import open_source
source = open_source(json.loads(sys.argv[1]))
source.connect()
source.flush()
print("reading", flush=True)
stamps, longest, before = [], 0.0, time.monotonic()
while len(stamps) < 1500:
    sample = source.read(0.1)
    now = time.monotonic()
    longest, before = max(longest, now - before), now
    if sample is not None:
        stamps.append(sample.stamp_ns)
source.close()
found = {"counters": source.health.counters, "stamps": stamps, "longest": longest}
print(json.dumps(found), flush=True)
"""

STALLS = 5


def stop(*pids: int) -> None:
    """Stop processes for 100 ms, as a machine that stands still."""
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(0.1)
    for pid in pids:
        os.kill(pid, signal.SIGCONT)


@pytest.fixture
def read(process: Callable[..., Any]) -> Iterator[Callable[..., Any]]:
    """Function that reads 1500 samples, is stopped on the way, and gives counters, stamps and the
    longest pause of the reader in s, which a busy machine makes longer.
    """

    def run(settings: dict[str, Any], *others: int) -> tuple[dict[str, int], np.ndarray, float]:
        child = process("-c", READER, json.dumps(settings))
        end = time.monotonic() + 60
        while "reading" not in child.output.read_text():
            assert time.monotonic() < end, child.output.read_text()
            time.sleep(0.02)
        for _ in range(STALLS):
            time.sleep(0.25)
            stop(child.pid, *others)
        assert child.wait(90) == 0, child.output.read_text()
        found = json.loads(child.output.read_text().splitlines()[-1])
        return found["counters"], np.array(found["stamps"]), found["longest"]

    yield run


def test_a_polled_board_loses_no_reply_when_driver_or_machine_stand_still(
    read: Callable[..., Any], free_port: Callable[[], int]
) -> None:
    port = free_port()
    settings = {"can_interface": "udp_multicast", "can_options": f"port={port}"}
    with device("netcanoem", "--options", f"port={port}") as board:
        for stopped in ((), (board.pid,)):
            counters, stamps, _ = read(settings, *stopped)
            assert not {"lost", "half_replies", "late_replies"} & counters.keys(), counters
            assert (np.diff(stamps) > 0).all()
            # What was not polled has no reading; it is counted and not made up for.
            assert counters["overrun"] >= STALLS


def test_a_streaming_box_loses_no_record_when_the_driver_stands_still(
    read: Callable[..., Any],
) -> None:
    with device("rdt", "--port", 0, "--http-port", 0) as box:
        settings = netft_settings(box)
        for _ in range(4):
            counters, stamps, longest = read(settings)
            # Records are numbered: none is missing between the first and the last one.
            assert not counters.keys() & {"lost", "out_of_order", "jump"}, counters
            assert len(stamps) == 1500 and longest > 0.09
            if longest < 0.4:
                assert "skipped" not in counters
                return
    pytest.skip(f"skipped records not tested: the machine itself stood still for {longest:.1f} s")
