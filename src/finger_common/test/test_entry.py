# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Ctrl-C at any moment of a command, also while its modules load or when it has ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

SCRIPT = "import sys; from finger_common.entry import slow; sys.exit(slow.part.main())"
"""As an installed script does."""

MODULE = """\
import atexit, sys, time
def reach(place):
    if place == sys.argv[1]:
        print(place, flush=True)
        for _ in range(3000):  # a signal just before a sleep is seen when the sleep ends
            time.sleep(0.01)
try:
    reach("load")
except BaseException as error:
    raise ImportError("as compiled modules say it") from error
def main():
    reach("run")
    atexit.register(reach, "exit")
    return 3
"""


def test_a_command_is_found_by_the_name_of_its_function() -> None:
    named = EntryPoint("finger-x", "finger_common.entry:finger_common.cli.integer", "x")
    assert callable(named.load())


@pytest.mark.parametrize("place", ["load", "run", "exit"])
@pytest.mark.parametrize(
    "call", [["-c", SCRIPT], ["-m", "finger_common.entry", "slow.part"]], ids=["script", "module"]
)
def test_ctrl_c_leaves_no_traceback(tmp_path: Path, call: list[str], place: str) -> None:
    (tmp_path / "slow").mkdir()
    (tmp_path / "slow" / "part.py").write_text(MODULE)
    child = subprocess.Popen(
        [sys.executable, *call, place],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        # A shell may have started the tests with SIGINT ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert child.stdout is not None
    assert child.stdout.readline() == f"{place}\n".encode()
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=20)
    assert (child.returncode, said) == (130, b"")


def test_an_ignored_ctrl_c_stays_ignored(tmp_path: Path) -> None:
    (tmp_path / "slow").mkdir()
    (tmp_path / "slow" / "part.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
        "def main():\n    os.kill(os.getpid(), signal.SIGINT)\n    return 3\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
        timeout=20,
    )
    assert (done.returncode, done.stderr) == (3, b"")
