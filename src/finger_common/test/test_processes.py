# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Processes of a pool end with the process that started them and take one core each."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from finger_common.processes import begin_worker, in_threads, worker_pool

PARENT = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from finger_common.processes import begin_worker

def work(folder):
    open(os.path.join(folder, str(os.getpid())), "w").close()
    time.sleep(600)

if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    with ProcessPoolExecutor(2, context, initializer=begin_worker) as pool:
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


def count_threads(_: int) -> list[int]:
    """Threads of each library of linear algebra in this process."""
    import scipy.linalg  # noqa: F401

    return [library["num_threads"] for library in threadpool_info()]


@pytest.mark.parametrize("start", ["spawn", "fork"])
def test_linear_algebra_takes_one_thread_in_a_worker(start: str) -> None:
    context = multiprocessing.get_context(start)
    with threadpool_limits(4), ProcessPoolExecutor(1, context, initializer=begin_worker) as pool:
        (counts,) = pool.map(count_threads, [0])
    assert counts and set(counts) == {1}


FORKED = []
"""Filled in this process alone: a fork takes it over."""


def what_is_inherited(_: int) -> list[int]:
    return FORKED


def test_a_pool_forks_no_process_that_runs_threads() -> None:
    """Python 3.12 and later warn of that: locks that another thread holds stay closed."""
    FORKED.append(1)
    with worker_pool(2) as pool:
        assert list(pool.map(what_is_inherited, range(4))) == [[]] * 4
        (counts,) = pool.map(count_threads, [0])
        assert counts and set(counts) == {1}


def test_a_script_that_uses_a_pool_needs_no_main_guard(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from finger_common.processes import worker_pool\n"
        "with worker_pool(2) as pool:\n"
        "    print(list(pool.map(abs, [-1, -2])))\n"
    )
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=60.0, check=True
    )
    assert done.stdout == "[1, 2]\n" and not done.stderr


def test_a_closed_terminal_ends_no_worker_under_nohup() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with worker_pool(1) as pool:
            assert pool.submit(signal.getsignal, signal.SIGHUP).result() == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_threads_side_by_side_leave_linear_algebra_as_it_was() -> None:
    with threadpool_limits(2):
        before = count_threads(0)
        with in_threads(2) as each:
            assert list(each(count_threads, [0, 1])) == [[1] * len(before)] * 2
        assert count_threads(0) == before
