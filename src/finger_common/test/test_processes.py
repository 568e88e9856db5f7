# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Processes of a pool end with the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PARENT = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from finger_common.processes import end_with_parent

def work(folder):
    open(os.path.join(folder, str(os.getpid())), "w").close()
    time.sleep(600)

if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    with ProcessPoolExecutor(2, context, initializer=end_with_parent) as pool:
        list(pool.map(work, [sys.argv[2]] * 8))
"""


def is_running(pid: int) -> bool:
    """Whether a process runs; one that ended and that nobody asked for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("start", ["spawn", "fork"])
def test_workers_end_when_their_parent_is_killed(start: str, tmp_path: Path) -> None:
    script, folder = tmp_path / "parent.py", tmp_path / "workers"
    script.write_text(PARENT)
    folder.mkdir()
    parent = subprocess.Popen([sys.executable, str(script), start, str(folder)])
    until = time.monotonic() + 60.0
    while len(list(folder.iterdir())) < 2 and time.monotonic() < until:
        time.sleep(0.02)
    workers = [int(file.name) for file in folder.iterdir()]
    try:
        assert len(workers) == 2 and all(map(is_running, workers))
        parent.send_signal(signal.SIGKILL)
        parent.wait(10.0)
        until = time.monotonic() + 30.0
        while any(map(is_running, workers)) and time.monotonic() < until:
            time.sleep(0.02)
        assert not any(map(is_running, workers))
    finally:
        parent.kill()
        for pid in filter(is_running, workers):
            os.kill(pid, signal.SIGKILL)
