# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Signals that end finger-fit: what was found is written, and a line says so at once."""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import finger_fit.report as fit_report
from finger_common.cli import DROPPED_AGAIN, run
from finger_fit import cli
from finger_fit.fingers import Fingers
from finger_fit.interruption import found_something, kept, signals_taken
from finger_fit.study import bags, condition, study

OPTIONS = [
    *("--no-full-order", "--no-profiles", "--no-nuisances", "--bias-pairs", "0"),
    *("--bootstrap", "3", "--grid", "3", "--rounds", "4"),
]
LINE = "interrupted: writing the results so far; Ctrl-C again gives them up"
REPORT = "results and parameters are written, the report is not"
WHOLE, CUT = "not checked", "interrupted"


class Fit:
    """The command with the stand-in and trials of one subject; `at` has what is sent where."""

    def __init__(self, double: Any, folder: Path, patch: pytest.MonkeyPatch) -> None:
        records = [double.make_record(i, 0.7 + 0.2 * i, 1e-6) for i in range(3)]
        self.loaded = bags.Loaded(records)
        patch.setattr(study, "load", lambda *_: self.loaded)
        patch.setattr(Fingers, "load", lambda *_: Fingers.of(double.HereditaryModel()))
        self.bag, self.folder, self.patch = folder, folder / "fit", patch
        self.page = self.folder / "report.html"

    def run(self, *more: str) -> int:
        return run(cli.command, [str(self.bag), "-o", str(self.folder), *OPTIONS, *more])

    def earlier(self) -> None:
        """Stands in for the report of an earlier fit."""
        for path in (self.page, self.page.with_suffix(".pdf")):
            path.parent.mkdir(exist_ok=True)
            path.write_text("of before")
        (self.folder / "figures").mkdir()
        (self.folder / "figures" / "profiles.png").write_text("of before")

    def before(self, place: Any, name: str, *numbers: int) -> None:
        """Let signals come when a function is called."""
        usual = getattr(place, name)

        def called(*arguments: Any, **options: Any) -> Any:
            for number in numbers:
                signal.raise_signal(number)
            return usual(*arguments, **options)

        self.patch.setattr(place, name, called)

    @property
    def status(self) -> str:
        found = json.loads((self.folder / "fit.json").read_text())
        return found["conditions"]["natural"]["status"]


@pytest.fixture
def fit(double, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fit:
    # Drawing is tested elsewhere.
    def write(result: Any, folder: Path) -> None:
        (folder / "report.html").write_text("new")

    monkeypatch.setattr(fit_report, "write_report", write)
    return Fit(double, tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("place", "name", "status", "lacking"),
    [
        (condition, "refine", CUT, "not fitted to the end: natural"),
        (condition, "goodness", WHOLE, "what the report does not show"),
        (study, "judge", WHOLE, "what the report does not show"),
        (study, "provenance", WHOLE, REPORT),
        (study.results, "write", WHOLE, REPORT),
        (fit_report, "remove_figures", WHOLE, REPORT),
        (fit_report, "write_report", WHOLE, REPORT),
    ],
)
def test_ctrl_c_keeps_what_was_found_wherever_it_comes(
    fit: Fit, capfd, place: Any, name: str, status: str, lacking: str
) -> None:
    """In a stage, between two, and after the last one; no report of an earlier fit stays."""
    fit.earlier()
    fit.before(place, name, signal.SIGINT)
    assert fit.run() == 130
    out, err = capfd.readouterr()
    assert err.splitlines().count(LINE) == 1
    assert f"note: interrupted: {lacking}" in out or f"; {lacking}" in out
    assert fit.status == status
    written = fit.page.read_text() if fit.page.exists() else ""
    assert written == ("" if lacking == REPORT else "new")
    assert (f"report: {fit.page}" in out) == bool(written)
    assert not (fit.folder / "report.pdf").exists()
    assert not (fit.folder / "figures" / "profiles.png").exists()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_gives_up_the_results(fit: Fit, capfd) -> None:
    fit.before(study.results, "write", signal.SIGINT, signal.SIGINT)
    assert fit.run() == 130
    err = capfd.readouterr().err.splitlines()
    assert LINE in err and err[-1].endswith("interrupted")
    assert not (fit.folder / "fit.json").exists()


@pytest.mark.parametrize(
    ("place", "name"), [(study, "load"), (study, "prepare_all"), (condition, "search_grid")]
)
def test_ctrl_c_before_anything_was_found_promises_nothing(
    fit: Fit, capfd, place: Any, name: str
) -> None:
    fit.before(place, name, signal.SIGINT)
    assert fit.run() == 130
    assert "writing" not in capfd.readouterr().err and not fit.folder.exists()


def test_a_second_ctrl_c_in_the_report_of_a_cut_fit_promises_no_parameters(fit: Fit, capfd) -> None:
    fit.before(condition, "refine", signal.SIGINT)
    fit.before(fit_report, "write_report", signal.SIGINT)
    assert fit.run() == 130
    out = capfd.readouterr().out
    assert "note: interrupted: results are written, the report is not" in out
    assert fit.status == CUT and not (fit.folder / "parameters.yaml").exists()


def test_ctrl_c_in_a_cross_check_ends_the_fit(fit: Fit, capfd) -> None:
    searches: list[str] = []
    usual = condition.search

    def search(name: str, *arguments: Any) -> Any:
        searches.append(name)
        if name == "de":
            cost = arguments[0]
            calls = iter(range(100))

            def interrupted(points: Any) -> Any:
                if next(calls) == 1:
                    signal.raise_signal(signal.SIGINT)
                return cost(points)

            arguments = (interrupted, *arguments[1:])
        return usual(name, *arguments)

    fit.patch.setattr(condition, "search", search)
    assert fit.run("--optimizer", "pso", "de") == 130
    assert searches == ["pso", "de"] and fit.status == CUT


def test_an_interruption_that_compiled_code_drops_is_no_second_one(fit: Fit, capfd) -> None:
    """It comes again when the last stage is over."""

    class Dropping:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    drops = [Dropping()]
    sample, goodness = condition.bootstrap_sample, condition.goodness

    def dropping(*arguments: Any) -> Any:
        drops.clear()
        return sample(*arguments)

    def slow(*arguments: Any) -> Any:
        time.sleep(3 * DROPPED_AGAIN)
        return goodness(*arguments)

    fit.patch.setattr(condition, "bootstrap_sample", dropping)
    fit.patch.setattr(condition, "goodness", slow)
    assert fit.run() == 130
    out, err = capfd.readouterr()
    assert err.splitlines().count(LINE) == 1 and fit.status == WHOLE
    assert "what the report does not show was not computed" in out
    assert fit.page.read_text() == "new"


END = {signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.fixture
def signals_that_end(monkeypatch: pytest.MonkeyPatch) -> Any:
    """SIGHUP may be ignored where the tests run, as under nohup."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in END}
    yield
    for number, usual in before.items():
        signal.signal(number, usual)


@pytest.mark.parametrize(("number", "code"), END.items())
@pytest.mark.parametrize(("place", "name"), [(condition, "refine"), (study, "provenance")])
def test_signals_of_batch_systems_and_terminals_keep_what_was_found(
    fit: Fit, capfd, signals_that_end: None, number: int, code: int, place: Any, name: str
) -> None:
    """They may come in pairs."""
    fit.before(place, name, number, number)
    assert fit.run() == code
    err = capfd.readouterr().err
    assert f"{signal.Signals(number).name}: writing the results so far" in err
    assert fit.status == (CUT if name == "refine" else WHOLE)
    assert signal.getsignal(number) is signal.SIG_DFL


def test_ctrl_c_after_another_signal_gives_up_the_results(
    fit: Fit, capfd, signals_that_end: None
) -> None:
    fit.before(study.results, "write", signal.SIGTERM, signal.SIGINT)
    assert fit.run() == 143
    assert capfd.readouterr().err.endswith("ended by SIGTERM\n")
    assert not (fit.folder / "fit.json").exists()


def test_a_dropped_sigterm_comes_again_where_ctrl_c_is_ignored(
    fit: Fit, capfd, signals_that_end: None
) -> None:
    """As in a job in the background."""
    usual = condition.polish
    drops = iter([lambda: signal.raise_signal(signal.SIGTERM)])

    def polish(*arguments: Any) -> Any:
        for drop in drops:
            ctypes.CFUNCTYPE(None)(drop)()
        time.sleep(3 * DROPPED_AGAIN)
        return usual(*arguments)

    fit.patch.setattr(condition, "polish", polish)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert fit.run() == 143
    finally:
        signal.signal(signal.SIGINT, before)
    err = capfd.readouterr().err
    assert err.count("SIGTERM: writing the results so far") == 1 and fit.status == CUT


def test_fits_of_other_threads_do_not_meddle_with_the_signals_of_a_fit(fit: Fit, capfd) -> None:
    ends = [threading.Event(), threading.Event()]

    def keep(begun: threading.Event, end: threading.Event) -> None:
        with signals_taken(print), kept():
            found_something()
            begun.set()
            end.wait()

    hook, threads = sys.unraisablehook, []
    for end in ends:
        threads.append(threading.Thread(target=keep, args=(begun := threading.Event(), end)))
        threads[-1].start()
        begun.wait()
    for thread, end in zip(threads, ends, strict=True):
        end.set()
        thread.join()
    assert sys.unraisablehook is hook
    fit.before(study, "load", signal.SIGINT)
    assert fit.run() == 130 and "writing" not in capfd.readouterr().err


@pytest.mark.parametrize("place", [condition, study])
def test_a_closed_pipe_does_not_keep_results_from_being_written(
    fit: Fit, signals_that_end: None, place: Any
) -> None:
    """As of `finger-fit … 2>&1 | tee log` in a terminal that is closed."""
    name, status = {condition: ("refine", CUT), study: ("provenance", WHOLE)}[place]
    fit.before(place, name, signal.SIGHUP)
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w") as pipe, fit.patch.context() as patch:
        patch.setattr(sys, "stdout", pipe)
        patch.setattr(sys, "stderr", pipe)
        code = fit.run()
    assert code == 129 and fit.status == status


def test_of_subjects_the_fitted_ones_are_written(fit: Fit, signals_that_end: None) -> None:
    more = [replace(r, subject="S02", bag=f"S02_{r.index}", force=1.01 * r.force)
            for r in fit.loaded.records]  # fmt: skip
    fit.loaded.records += more
    usual = study.fit_condition

    def begin(problem: Any, name: str, engine: Any, folder: Path, report: Any) -> Any:
        if folder.name == "S02":
            signal.raise_signal(signal.SIGTERM)
        return usual(problem, name, engine, folder, report)

    fit.patch.setattr(study, "fit_condition", begin)
    assert fit.run() == 143
    found = json.loads((fit.folder / "fit.json").read_text())
    assert list(found["subjects"]) == ["S01"]
    assert found["notes"] == ["interrupted: not fitted: subjects S02"]
    assert (fit.folder / "S01" / "fit.json").is_file()


CLOSED = """\
import sys, time
from pathlib import Path
from finger_common.cli import run
from finger_fit.interruption import found_something, interruptible, kept, signals_taken
def command(argv):
    with signals_taken(print) as taken, kept():
        found_something()
        try:
            with interruptible():
                print("begun", flush=True)
                for _ in range(6000):  # a signal just before a sleep is seen when the sleep ends
                    time.sleep(0.01)
        except KeyboardInterrupt:
            print("written", flush=True)
            Path(argv[0]).write_text("results")
        return 128 + taken[0]
sys.exit(run(command, sys.argv[1:]))
"""


def test_a_closed_terminal_does_not_keep_results_from_being_written(tmp_path: Path) -> None:
    """To print to it would fail."""
    terminal, inside = os.openpty()

    def lead() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        os.setsid()
        fcntl.ioctl(inside, termios.TIOCSCTTY, 0)

    file = tmp_path / "results"
    child = subprocess.Popen(
        [sys.executable, "-c", CLOSED, str(file)],
        stdin=inside, stdout=inside, stderr=inside, preexec_fn=lead,
    )  # fmt: skip
    os.close(inside)
    said = b""
    while b"begun" not in said:
        said += os.read(terminal, 1000)
    os.close(terminal)
    assert child.wait(timeout=30) == 129 and file.read_text() == "results"
