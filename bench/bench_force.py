"""The force driver at 500 Hz against a NETCANOEM board on a simulated bus in another process.

Figures: polls without a sample, interval jitter, share of one core. Five minutes, with `--quick`
ten seconds.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from typing import Any

import numpy as np

from finger_driver.force import GOOD, open_source

RATE = 500.0
EDGES_MS = (0.0, 1.0, 1.8, 1.9, 1.95, 2.05, 2.1, 2.2, 3.0, 5.0, 10.0, 20.0, np.inf)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def measure(seconds: float, report: Any) -> None:
    port = free_port()
    board = subprocess.Popen(
        [sys.executable, "-m", "finger_driver.simulators.cli", "netcanoem", "--press", "1.35",
         "--options", f"port={port}"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert board.stdout is not None
        while "ready" not in board.stdout.readline():
            if board.poll() is not None:
                raise RuntimeError("the simulated board did not start")
        source = open_source(
            {"can_interface": "udp_multicast", "can_options": f"port={port}", "rate": RATE}
        )
        source.connect()
        source.flush()
        stamps, bad = [], 0
        cpu, start = time.process_time(), time.monotonic()
        while time.monotonic() - start < seconds:
            sample = source.read(0.1)
            if sample is not None:
                stamps.append(sample.stamp_ns)
                bad += sample.quality != GOOD
        elapsed = time.monotonic() - start
        cpu = time.process_time() - cpu
        counters = dict(source.health.counters)
        source.close()
    finally:
        board.terminate()
        board.wait(10)
    intervals = np.diff(stamps) * 1e-6
    report.add("force_lost", counters.get("lost", 0) + bad, "count", goal=0)
    report.add("force_slots_skipped", counters.get("overrun", 0), "count")
    report.add("force_rate", len(stamps) / elapsed, "Hz", goal=499, better="higher")
    report.add("force_interval_sd", float(intervals.std()), "ms")
    report.add("force_interval_p99", float(np.percentile(intervals, 99)), "ms")
    report.add("force_interval_max", float(intervals.max()), "ms")
    report.add("force_cpu", 100 * cpu / elapsed, "%")
    numbers, _ = np.histogram(intervals, EDGES_MS)
    for low, high, number in zip(EDGES_MS, EDGES_MS[1:], numbers):
        report.note(f"interval {low:5.2f} … {high:5.2f} ms: {number}")
    report.note(f"{len(stamps)} samples in {elapsed:.1f} s; counters {counters}")


def run(report: Any) -> None:
    """Called by bench/run.py."""
    measure(10.0 if report.quick else 300.0, report)
