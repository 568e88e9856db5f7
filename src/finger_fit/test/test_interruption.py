# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Signals that end finger-fit: what was found is written, and a line says so at once."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest

import finger_fit.report as fit_report
from finger_common.cli import run
from finger_fit import cli
from finger_fit.fingers import Fingers
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
        patch.setattr(study, "load", lambda *_: bags.Loaded(list(records)))
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


def test_ctrl_c_before_anything_was_found_promises_nothing(fit: Fit, capfd) -> None:
    fit.before(study, "load", signal.SIGINT)
    assert fit.run() == 130
    assert "writing" not in capfd.readouterr().err and not fit.folder.exists()


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
