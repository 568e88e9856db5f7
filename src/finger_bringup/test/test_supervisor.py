# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The supervisor restarts what ends by itself, ends in order, and leaves nothing behind."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from waiting import wait_until

from finger_bringup.cli import run_until_interrupted
from finger_bringup.supervisor import ProcessSpec, Supervisor

FOREVER = "import time; print('alive', flush=True)\nwhile True: time.sleep(0.05)"
STUBBORN = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); " + FOREVER


def python(code: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code)


class Log:
    """Collects lines and lets a test wait for one."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []
        self._new = threading.Condition()

    def __call__(self, name: str, text: str) -> None:
        with self._new:
            self.lines.append((name, text))
            self._new.notify_all()

    def wait_for(self, text: str, count: int = 1, timeout: float = 60.0) -> None:
        def seen() -> bool:
            return sum(text in line for _, line in self.lines) >= count

        with self._new:
            assert self._new.wait_for(seen, timeout), (text, self.lines)


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_process_that_ends_is_started_again_and_reported() -> None:
    log = Log()
    with Supervisor([ProcessSpec("node", python(FOREVER))], line=log, first_delay=0.05) as all_:
        log.wait_for("alive")
        first = all_.process_id("node")
        assert first is not None
        os.kill(first, signal.SIGKILL)
        log.wait_for("was ended by signal 9")
        log.wait_for("alive", count=2)
        assert all_.restarts() == {"node": 1}
        second = all_.process_id("node")
        assert second is not None and second != first
    assert gone(second)


def test_a_log_that_cannot_be_written_stops_nothing(tmp_path: Path) -> None:
    """The terminal closed, or the disk is full."""
    done = tmp_path / "done"

    def line(name: str, text: str) -> None:
        raise BrokenPipeError

    talk = f"for i in range(20000): print('x' * 80)\nopen({str(done)!r}, 'w')\n" + FOREVER
    with Supervisor([ProcessSpec("node", python(talk))], line=line, first_delay=0.05) as all_:
        wait_until(done.exists, "the file")
        first = all_.process_id("node")
        assert first is not None
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: all_.restarts() == {"node": 1} and all_.alive()["node"], "the restart")
        second = all_.process_id("node")
    assert second is not None and gone(second)


def test_a_start_that_fails_is_tried_again(monkeypatch: Any) -> None:
    """The machine has no process or no memory left for a while."""
    log = Log()
    popen, failures = subprocess.Popen, [1, 2]

    def short_of_memory(*arguments: Any, **options: Any) -> Any:
        if log.lines and failures:
            failures.pop()
            raise BlockingIOError(11, "Resource temporarily unavailable")
        return popen(*arguments, **options)

    monkeypatch.setattr("finger_bringup.supervisor.subprocess.Popen", short_of_memory)
    with Supervisor([ProcessSpec("node", python(FOREVER))], line=log, first_delay=0.05) as all_:
        log.wait_for("alive")
        process = all_.process_id("node")
        assert process is not None
        os.kill(process, signal.SIGKILL)
        log.wait_for("cannot be started", count=2)
        log.wait_for("alive", count=2)
        assert all_.restarts() == {"node": 1}


def test_stop_ends_even_what_ignores_interrupts_and_its_children() -> None:
    parent = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {FOREVER!r}]); "
    log = Log()
    specs = [
        ProcessSpec("stubborn", python(STUBBORN)),
        ProcessSpec("parent", python(parent + FOREVER)),
    ]
    supervisor = Supervisor(specs, line=log)
    supervisor.start()
    log.wait_for("alive", count=3)
    pids = [supervisor.process_id(name) for name in ("stubborn", "parent")]
    supervisor.stop(patience=0.5)
    assert all(pid is not None and gone(pid) for pid in pids)
    assert any("sent SIGTERM" in text for name, text in log.lines if name == "stubborn")


def test_what_a_killed_supervisor_leaves_ends_by_itself(tmp_path: Path) -> None:
    pids = [tmp_path / "first", tmp_path / "again"]
    again = f"import os, signal, pathlib; first = not pathlib.Path({str(pids[0])!r}).exists(); "
    again += f"path = pathlib.Path([{str(pids[1])!r}, {str(pids[0])!r}][first]); "
    again += (
        "part = path.with_suffix('.part'); part.write_text(str(os.getpid())); part.rename(path); "
    )
    again += "first and os.kill(os.getpid(), signal.SIGKILL); " + FOREVER
    code = (
        "import sys, time\n"
        "from finger_bringup.supervisor import ProcessSpec, Supervisor\n"
        f"spec = ProcessSpec('node', (sys.executable, '-c', {again!r}))\n"
        "Supervisor([spec], first_delay=0.05).start()\n"
        "time.sleep(600)\n"
    )
    parent = subprocess.Popen(python(code), stdout=subprocess.DEVNULL)
    try:
        wait_until(pids[1].exists, "the grandchild")
    finally:
        parent.kill()
        parent.wait()
    wait_until(lambda: gone(int(pids[1].read_text())), "the grandchild's end")


def test_the_end_of_an_essential_process_ends_all_with_its_exit_code() -> None:
    log = Log()
    specs = [
        ProcessSpec("node", python(FOREVER)),
        ProcessSpec("session", python("import sys; sys.exit(3)"), essential=True),
    ]
    supervisor = Supervisor(specs, line=log)
    supervisor.start()
    assert supervisor.wait(60)
    supervisor.stop()
    assert supervisor.exit_code == 3
    assert not any(supervisor.alive().values())


def test_an_essential_process_that_a_signal_ended_is_no_success() -> None:
    log = Log()
    code = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    with Supervisor([ProcessSpec("session", python(code), essential=True)], line=log) as all_:
        assert all_.wait(60)
    assert all_.exit_code == 1
    log.wait_for("was ended by signal 9; ending all")


def test_processes_of_a_higher_rank_end_first() -> None:
    code = "import time\ntry:\n    print('alive', flush=True)\n"
    code += "    while True: time.sleep(0.05)\n"
    code += "except KeyboardInterrupt:\n    print('ends', flush=True)"
    log = Log()
    specs = [ProcessSpec(name, python(code), rank) for name, rank in (("a", 1), ("b", 2))]
    with Supervisor(specs, line=log):
        log.wait_for("alive", count=2)
    assert [name for name, text in log.lines if text == "ends"] == ["b", "a"]


def test_who_ran_a_supervisor_to_its_end_still_has_its_signal_handlers() -> None:
    """Or all processes that it starts later ignore Ctrl-C."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = [signal.getsignal(number) for number in numbers]
    for code, interrupted in (("raise SystemExit(3)", False), (FOREVER, True)):
        log = Log()
        supervisor = Supervisor([ProcessSpec("node", python(code), essential=True)], line=log)
        if interrupted:
            thread = threading.Thread(
                target=lambda log=log: (log.wait_for("alive"), os.kill(os.getpid(), signal.SIGTERM))
            )
            thread.start()
        assert run_until_interrupted(supervisor) == interrupted
        assert [signal.getsignal(number) for number in numbers] == before


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_does_not_cut_the_end_of_the_processes_short(
    second: signal.Signals,
) -> None:
    # Short sleeps: a signal just before a sleep is seen when the sleep ends.
    code = "import time\ntry:\n    print('alive', flush=True)\n"
    code += "    for _ in range(6000):\n        time.sleep(0.01)\n"
    code += "except KeyboardInterrupt:\n    print('ends', flush=True)\n    time.sleep(0.5)\n"
    code += "    print('done', flush=True)"
    log = Log()
    supervisor = Supervisor([ProcessSpec("node", python(code))], line=log)

    def end() -> None:
        log.wait_for("alive")
        os.kill(os.getpid(), signal.SIGINT)
        log.wait_for("ends")
        os.kill(os.getpid(), second)

    thread = threading.Thread(target=end)
    thread.start()
    assert run_until_interrupted(supervisor)
    thread.join()
    assert ("node", "done") in log.lines


def test_what_cannot_begin_is_not_started_again_and_ends_all_when_nothing_is_left() -> None:
    """As all nodes where ROS cannot write its logs."""
    log = Log()
    refusing = python("raise SystemExit(2)")
    specs = [ProcessSpec(name, refusing) for name in ("a", "b")]
    supervisor = Supervisor(specs, line=log, first_delay=0.05)
    supervisor.start()
    assert supervisor.wait(60)
    supervisor.stop()
    assert supervisor.exit_code == 2 and supervisor.restarts() == {"a": 0, "b": 0}
    told = [text for _, text in log.lines]
    assert sum("exit code 2; it is not started again" in text for text in told) == 2


def test_what_has_run_is_started_again_whatever_its_exit_code(tmp_path: Path) -> None:
    """As where the disk is full for a while."""
    log, ran = Log(), tmp_path / "ran"
    code = f"import pathlib, sys; path = pathlib.Path({str(ran)!r}); first = not path.exists(); "
    code += "path.touch(); sys.exit(1 if first else 2)"
    with Supervisor([ProcessSpec("node", python(code))], line=log, first_delay=0.05):
        log.wait_for("exit code 2; starting it again", count=2)


def test_restarts_slow_down_for_what_cannot_run() -> None:
    log = Log()
    specs = [ProcessSpec("broken", python("raise SystemExit(1)"))]
    with Supervisor(specs, line=log, first_delay=0.05, longest_delay=0.2):
        log.wait_for("starting it again", count=4)
    delays = [text.split(" in ")[1] for _, text in log.lines if "starting it again" in text]
    assert delays[:4] == ["0.05 s", "0.1 s", "0.2 s", "0.2 s"]
