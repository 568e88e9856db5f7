# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Conventions of commands: names that were meant, help, completion, progress, folder locks."""

from __future__ import annotations

import ctypes
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from finger_common.cli import DROPPED_AGAIN, Parser, add_settings, run, settings_from
from finger_common.errors import InputError, known_names, listed
from finger_common.files import atomic_write
from finger_common.folder_lock import lock_folder
from finger_common.progress import Stages, duration_text
from finger_common.settings import Settings, setting

COMMAND = """\
from finger_common.cli import Parser
top = Parser(prog="tool")
commands = top.add_subparsers(dest="command", parser_class=Parser)
up = commands.add_parser("up")
up.add_argument("--simulated", action="store_true")
commands.add_parser("down").add_argument("--window-size")
up.add_argument("--window", choices=("loading", "contact"))
top.parse_args()
"""


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["up", "--simulate"], "did you mean '--simulated'?"),
        (["up", "--window", "loadin"], "did you mean 'loading'?"),
        (["upp"], "did you mean 'up'?"),
    ],
)
def test_misspelt_options_and_names_get_the_one_that_was_meant(
    arguments: list[str], says: str
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2 and done.stderr.strip().endswith(says), done.stderr


PRINTING = """\
import sys
from finger_common.cli import Parser, run
from finger_common.console import Console
def command(argv):
    Parser(prog="tool").parse_args(argv[1:])
    print("a line") if argv[0] == "line" else Console().print("a table")
    if argv[0] != "check":
        return 0
    print("written", file=sys.stderr)
    return 1
sys.exit(run(command, sys.argv[1:]))
"""


@pytest.mark.parametrize("arguments", [["table"], ["line"], ["line", "--help"], ["check"]])
def test_a_pipe_that_nobody_reads_any_more_is_no_error(arguments: list[str]) -> None:
    """As in `finger-bag info BAG | head -1`."""
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w") as pipe:
        done = subprocess.run(
            [sys.executable, "-c", PRINTING, *arguments],
            stdout=pipe,
            stderr=subprocess.PIPE,
            timeout=60,
        )
    # What the command does after its table is done, and its own exit code is kept.
    expected = (1, b"written\n") if arguments == ["check"] else (0, b"")
    assert (done.returncode, done.stderr) == expected


def test_an_option_like_no_other_gets_no_guess(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="tool")
    parser.add_argument("--simulated", action="store_true")
    with pytest.raises(SystemExit):
        parser.parse_args(["--qqq"])
    assert "did you mean" not in capsys.readouterr().err


def test_an_option_of_another_subcommand_is_not_proposed() -> None:
    for arguments in (["down", "--window", "x"], ["down", "--simulated"], ["down", "--simulate"]):
        done = subprocess.run(
            [sys.executable, "-c", COMMAND, *arguments], capture_output=True, text=True, timeout=60
        )
        said = done.stderr.strip().splitlines()[-1]
        assert done.returncode == 2 and arguments[1] in said, done.stderr
        proposed = said.partition("did you mean ")[2]
        assert proposed in ("", "'--window-size'?"), said
        assert bool(proposed) == (arguments[1] == "--window"), said


def test_a_misspelt_option_is_named_before_what_is_missing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    parser = Parser(prog="tool")
    parser.add_argument("bag")
    with pytest.raises(SystemExit):
        parser.parse_args(["--hlep"])
    assert "did you mean '--help'?" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        parser.parse_args([])
    assert "required: bag" in capsys.readouterr().err


def test_a_list_that_is_cut_says_how_many_more_there_are() -> None:
    assert listed([]) == "" and listed([1, 2]) == "1, 2" and listed("abc", 3, "; ") == "a; b; c"
    assert listed(range(8)) == "0, 1, 2, 3, 4 and 3 more"
    assert listed("abcd", 3, "; ") == "a; b; c; and 1 more"


def test_known_names_in_a_sentence() -> None:
    assert known_names("cam", ["camera", "x"]) == "did you mean 'camera'? Known are camera, x"
    assert known_names("zz", ["camera"]) == "known are camera"
    assert known_names("x", []) == "known are none"


def test_usage_names_what_must_be_given_and_leaves_the_options_to_the_list() -> None:
    parser = Parser(prog="tool", description="word " * 40, example="tool a.bag")
    parser.add_argument("bag", nargs="+")
    parser.add_argument("-o", "--output", required=True)
    for number in range(12):
        parser.add_argument(f"--option-{number}")
    text = parser.format_help()
    assert text.splitlines()[0] == "usage: tool [options] -o OUTPUT bag [bag ...]"
    assert "--option-11" in text and text.endswith("example:\n  tool a.bag\n")
    assert max(map(len, text.splitlines())) <= int(os.environ.get("COLUMNS", "80"))


ENDED = """\
import sys, time
from concurrent.futures import ProcessPoolExecutor
from finger_common.cli import run
from finger_common.files import atomic_write
from finger_common.processes import begin_worker
def command(argv):
    with atomic_write(argv[0]) as file, ProcessPoolExecutor(1, initializer=begin_worker) as pool:
        file.write("half")
        wait = pool.submit(time.sleep, 60)
        while not wait.running():
            time.sleep(0.01)
        time.sleep(0.5)  # until the worker has begun
        print("begun", flush=True)
        wait.result()
if __name__ == "__main__":
    sys.exit(run(command, sys.argv[1:]))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_command_that_is_ended_leaves_no_half_written_file(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    """As by timeout, Slurm and docker stop, which end the processes of its pool too."""
    child = subprocess.Popen(
        [sys.executable, "-c", ENDED, str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # nohup ignores SIGHUP
    )
    assert child.stdout is not None and child.stdout.readline() == "begun\n"
    assert len(list(tmp_path.iterdir())) == 1
    began = time.monotonic()
    child.send_signal(number)
    _, says = child.communicate(timeout=30)
    assert child.returncode == code and says.endswith(f"ended by {number.name}\n")
    assert time.monotonic() - began < 20.0 and not list(tmp_path.iterdir())


CANCELLED = """
import os, signal, sys, time
from concurrent.futures import ProcessPoolExecutor
from finger_common.cli import run
from finger_common.processes import begin_worker
def command(argv):
    with ProcessPoolExecutor(2, initializer=begin_worker) as pool:
        for _ in pool.map(time.sleep, [0.1, *([600.0] * 2000)]):
            os.kill(os.getpid(), signal.SIGTERM)
if __name__ == "__main__":
    sys.exit(run(command))
"""


def test_a_signal_shows_no_error_of_a_pool_whose_work_it_cancels() -> None:
    for _ in range(5):
        ended = subprocess.run(
            [sys.executable, "-c", CANCELLED], capture_output=True, text=True, timeout=60
        )
        assert ended.returncode == 143
        assert ended.stderr.splitlines() == ["-c: ended by SIGTERM"]


def test_other_errors_of_threads_are_shown() -> None:
    seen: list[type[BaseException]] = []

    def command(argv: object) -> int:
        thread = threading.Thread(target=lambda: 1 / 0)
        thread.start()
        thread.join()
        return 0

    usual, threading.excepthook = threading.excepthook, lambda args: seen.append(args.exc_type)
    try:
        assert run(command) == 0
    finally:
        threading.excepthook = usual
    assert seen == [ZeroDivisionError]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_a_callback_of_compiled_code_ends_the_command(
    number: signal.Signals, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Python drops the exception there, as in those of numba while it loads kernels."""
    calls: list[int] = []

    def callback() -> None:
        calls.append(1)
        if len(calls) < 3:  # the second one comes in another callback
            signal.raise_signal(number)

    def command(argv: object) -> int:
        with atomic_write(tmp_path / "out"):
            for _ in range(2):
                ctypes.CFUNCTYPE(None)(callback)()
            time.sleep(20.0)
        return 0

    before = signal.signal(number, signal.default_int_handler if number == 2 else signal.SIG_DFL)
    try:
        assert run(command) == 128 + number
        assert signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler)
    finally:
        signal.signal(number, before)
    said = capfd.readouterr().err
    assert len(said.splitlines()) == 1 and ("interrupted" if number == 2 else number.name) in said
    assert len(calls) == 2 and not list(tmp_path.iterdir())


def test_a_dropped_signal_never_comes_after_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = os.kill

    def kill(process: int, number: int) -> None:
        time.sleep(3 * DROPPED_AGAIN)
        usual(process, number)

    def command(argv: object) -> int:
        ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGTERM))()
        time.sleep(2 * DROPPED_AGAIN)
        return 0

    monkeypatch.setattr(os, "kill", kill)
    late: list[int] = []
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        code = run(command)
        signal.signal(signal.SIGTERM, lambda number, _: late.append(number))
        time.sleep(4 * DROPPED_AGAIN)
        assert (code, late) == (143, [])
    finally:
        signal.signal(signal.SIGTERM, before)


def test_commands_in_threads_leave_no_hooks_behind() -> None:
    hooks = sys.unraisablehook, threading.excepthook
    ends = [threading.Event(), threading.Event()]
    threads = []
    for end in ends:
        begun = threading.Event()

        def command(argv: object, begun: Any = begun, end: Any = end) -> None:
            begun.set()
            end.wait()

        threads.append(threading.Thread(target=run, args=(command,)))
        threads[-1].start()
        begun.wait()
    for thread, end in zip(threads, ends, strict=True):
        end.set()
        thread.join()
    assert (sys.unraisablehook, threading.excepthook) == hooks


def test_a_signal_that_is_ignored_stays_so() -> None:
    """As SIGHUP under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        seen = run(lambda argv: int(signal.getsignal(signal.SIGHUP) == signal.SIG_IGN))
        assert seen == 1 and signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@pytest.mark.parametrize(("closed", "code"), [(">&-", 0), ("2>&-", 0), (">/dev/full", 2)])
def test_a_closed_or_full_output_is_no_traceback(closed: str, code: int) -> None:
    words = [sys.executable, "-c", PRINTING, "line"]
    done = subprocess.run(
        f"{shlex.join(words)} {closed}", shell=True, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == code and "Traceback" not in done.stderr
    assert ("standard output: No space left" in done.stderr) == (code == 2)


@pytest.mark.parametrize("given", [["", "-o", "x"], ["a", "-o", ""], ["a", "--table="]])
def test_an_empty_name_is_refused(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="tool")
    parser.add_argument("bags", nargs="+", metavar="BAG")
    parser.add_argument("-o", "--output")
    parser.add_argument("--table", metavar="CSV")
    parser.add_argument("--namespace")
    assert parser.parse_args(["a", "--namespace", ""]).namespace == ""
    with pytest.raises(SystemExit) as end:
        parser.parse_args(given)
    assert end.value.code == 2 and "the name is empty; give one" in capsys.readouterr().err


@dataclass(frozen=True)
class Lists(Settings):
    bounds: list[str] = setting([], "Bounds.")
    optimizer: list[str] = setting(["pso"], "Searches.", choices=("pso", "de"))


@pytest.mark.parametrize(
    ("arguments", "bounds", "optimizer"),
    [
        ([], [], ["pso"]),
        (["--bounds", "A", "B", "--bounds", "C"], ["A", "B", "C"], ["pso"]),
        (["--optimizer", "de", "--bounds=A", "--bounds=B"], ["A", "B"], ["de"]),
        (["--optimizer"], [], []),
    ],
)
def test_a_list_given_twice_is_one_in_place_of_the_default(
    arguments: list[str], bounds: list[str], optimizer: list[str]
) -> None:
    parser = Parser(prog="tool")
    add_settings(parser, Lists)
    for _ in range(2):  # a default stays what it was
        found = settings_from(parser.parse_args(arguments), Lists)
        assert (found.bounds, found.optimizer) == (bounds, optimizer)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["--rate", "0,4"], "'0,4' is no number; write it with a decimal point"),
        (["--rate", "5Hz"], "'5Hz' is no number; write it with a decimal point and without a unit"),
        (["--count", "2.5"], "'2.5' is no whole number; write it with digits alone"),
    ],
)
def test_a_number_in_another_spelling_is_told_how_to_write_it(
    given: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    @dataclass(frozen=True)
    class Rates(Settings):
        rate: float = setting(1.0, "Rate.", "Hz")
        count: int = setting(1, "Count.")

    parser = Parser(prog="tool")
    add_settings(parser, Rates)
    with pytest.raises(SystemExit) as ended:
        parser.parse_args(given)
    assert ended.value.code == 2
    assert says in capsys.readouterr().err


def test_the_shell_completes_options(tmp_path: Path) -> None:
    pytest.importorskip("argcomplete", reason="argcomplete is not installed")
    answer = tmp_path / "answer"
    line = "tool up --si"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run([sys.executable, "-c", COMMAND], env=environment, timeout=60, check=False)
    assert answer.read_text().strip() == "--simulated"


def test_plain_lines_tell_the_time_left_every_few_seconds_when_redirected() -> None:
    now = [0.0]
    lines: list[str] = []
    with Stages(terminal=False, line=lines.append, clock=lambda: now[0]) as stages:
        for done in range(101):
            now[0] = float(done)
            stages.update("dry search", done, 100, "J = 41.2 mm⁴")
        stages.update("dry search", 100, 100)
    assert lines[0] == "dry search: 5 %, 1:35 min left, J = 41.2 mm⁴"
    assert lines[-1] == "dry search: done in 1:40 min, J = 41.2 mm⁴"
    assert len(lines) == 20
    assert duration_text(59.4) == "59 s" and duration_text(7500) == "2:05 h"


def test_a_stage_that_is_done_once_more_tells_it_again() -> None:
    now = [0.0]
    lines: list[str] = []
    stages = Stages(terminal=False, line=lines.append, clock=lambda: now[0])
    for _ in range(2):
        for done in range(1, 4):
            stages.update("dry full order", done, 3)
            now[0] += 6.0
    once = ["dry full order: 67 %, 6 s left", "dry full order: done in 12 s"]
    assert lines == once + once


def test_what_tells_nothing_is_said_to_be_running() -> None:
    now = [0.0]
    lines: list[str] = []
    stages = Stages(terminal=False, line=lines.append, clock=lambda: now[0])

    def wait() -> None:
        for _ in range(6):
            now[0] += 5.0
            stages.beat()

    wait()
    stages.update("dry search", 0, 2)
    wait()
    stages.update("dry search", 1, 2)
    wait()
    stages.update("dry search", 2, 2)
    wait()
    assert lines == [
        "still running, 15 s after the start",
        "still running, 30 s after the start",
        "dry search: still running after 15 s",
        "dry search: still running after 30 s",
        "dry search: 50 %, 30 s left",
        "dry search: still running after 45 s",
        "dry search: still running after 1:00 min",
        "dry search: done in 1:00 min",
        "still running, 15 s after the end of dry search",
        "still running, 30 s after the end of dry search",
    ]


@pytest.mark.parametrize(("step", "lines"), [(0.1, 0), (6.0, 2)])
def test_brief_progress_tells_of_long_stages_only(step: float, lines: int) -> None:
    now = [0.0]
    told: list[str] = []
    stages = Stages(terminal=False, line=told.append, clock=lambda: now[0], brief=True)
    for _ in stages.track("ab", "full-order model", 2):
        now[0] += step
    assert len(told) == lines, told


def test_quiet_progress_writes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Stages(quiet=True) as stages:
        assert list(stages.track("ab", "letters", 2)) == ["a", "b"]
    assert capsys.readouterr().err == ""


def test_a_folder_is_locked_until_its_holder_ends_however_it_ends(tmp_path: Path) -> None:
    code = (
        "import sys, time; from finger_common.folder_lock import lock_folder; "
        f"lock = lock_folder({str(tmp_path)!r}, 'a rig'); print('held', flush=True); time.sleep(60)"
    )
    holder = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None and holder.stdout.readline() == "held\n"
    with pytest.raises(InputError, match=rf"in use by a rig \(process {holder.pid}\)"):
        lock_folder(tmp_path, "a second rig")
    holder.kill()
    holder.wait()
    lock_folder(tmp_path, "a second rig").close()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written to"):
        lock_folder(tmp_path / "file", "a rig")
