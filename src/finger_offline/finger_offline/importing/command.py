# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The subcommand `finger-bag import`."""

from __future__ import annotations

import argparse
import dataclasses
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.cli import EXIT_CHECK_FAILS, AddCommand
from finger_common.cli import add_settings, plain, settings_from
from finger_common.errors import InputError, known_names
from finger_common.files import sha256_of_file
from finger_common.progress import Stages

from ..trial_split import CONDITION
from .settings import PATHS, ImportSettings

NAME = "name"
"""Column of a table of trials with the name of the bag."""


def add_command(add: AddCommand) -> None:
    """Add `import` to the command `finger-bag`."""
    parser = add(
        "import",
        run,
        "Make a session bag from files of your own: force, and areas, a video or images. Exit code "
        "0 fit for use, 1 written but a check fails, 2 refused.",
        "finger-bag import -o S01_dry --force force.csv --area area.csv --subject S01 "
        "--condition dry\n"
        "finger-bag import -o S01_wet --force log.xlsx::Press2 --force-column 'Fz [N]' --video "
        "press2.mp4 --calibration plate.yaml --subject S01 --condition wet\n"
        "finger-bag import -o S01_dry --force force.csv --area area.csv --indentation laser.csv "
        "--subject S01 --condition dry\n"
        "finger-bag import -o study --trials trials.csv --area-per-pixel 9.86e-10",
    )
    parser.add_argument(
        "-o", "--output", required=True, help="bag to write; with --trials, the folder of bags"
    )
    parser.add_argument(
        "--trials",
        metavar="FILE",
        help="table with one recording per row; its columns are named as these options, with _ "
        "for -, and paths are relative to it; the other options hold for every row",
    )
    add_settings(parser, ImportSettings)


def run(args: argparse.Namespace) -> int:
    """Import what the arguments name; gives the exit code."""
    from .trial import Imported, import_trial

    output = Path(args.output)
    done: list[Imported] = []
    with Stages() as stages:
        if not args.trials:
            done.append(import_trial(settings_from(args, ImportSettings), output, stages.update))
        else:
            rows = list(rows_of(args))
            if output.exists() and (output.is_file() or any(output.iterdir())):
                raise InputError(f"{output}: exists already; choose another name or remove it")
            # Nothing half-written is left: the folder takes its name when all bags are complete.
            partial = output.with_name(f".{output.name}.partial")
            shutil.rmtree(partial, ignore_errors=True)
            try:
                for name, settings in stages.track(rows, "recordings", len(rows)):
                    try:
                        done.append(import_trial(settings, partial / name))
                    except InputError as error:
                        raise InputError(f"{args.trials}, {name}: {error}") from None
                if output.exists():
                    output.rmdir()
                partial.rename(output)
            finally:
                shutil.rmtree(partial, ignore_errors=True)
            for result in done:
                result.path = output / result.path.name
    return _report(done)


def rows_of(args: argparse.Namespace) -> Iterator[tuple[str, ImportSettings]]:
    """Name and settings of every row of the table of trials; raises InputError."""
    from .tables import read_table

    table = read_table(args.trials)
    folder = Path(args.trials.partition("::")[0]).parent
    known = {p.name: p for p in ImportSettings.parameters()}
    for heading in table.columns:
        if heading not in known and heading != NAME:
            raise InputError(
                f"{table.where}: column '{heading}' is no option; {known_names(heading, known)}"
            )
    common = {name: getattr(args, name) for name in known}
    numbers: Counter[tuple[str, str]] = Counter()
    names: set[str] = set()
    seen: dict[str, int] = {}
    for row in range(len(next(iter(table.columns.values())))):
        where = f"{table.where}, row {row + table.first_row}"
        cells = {h: _text(column[row]) for h, column in table.columns.items()}
        values = dict(common)
        for heading, text in cells.items():
            if text and heading in known:
                values[heading] = _value(known[heading].default, text, f"{where}, {heading}")
        for name in PATHS:
            if cells.get(name):
                values[name] = str(folder / values[name])
        try:
            settings = ImportSettings(**values)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        force = Path(settings.force.partition("::")[0])
        if force.is_file():
            content = sha256_of_file(force) + settings.force.partition("::")[2]
            content += settings.force_column
            if seen.setdefault(content, row) != row:
                raise InputError(
                    f"{where}: the force is that of row {seen[content] + table.first_row} once "
                    "more; one recording counts once"
                )
        group = (settings.subject, settings.condition)
        if not cells.get("index"):
            settings = dataclasses.replace(settings, index=settings.index + numbers[group])
        numbers[group] += 1
        name = cells.get(NAME) or f"{group[0]}_{group[1]}_{settings.index:02d}".replace(" ", "_")
        if name in names or not CONDITION.fullmatch(name):
            raise InputError(
                f"{where}: '{name}' is no name for a bag (letters, digits, blanks and .,+()%-), or "
                "is there twice"
            )
        names.add(name)
        yield name, settings


def _text(cell: Any) -> str:
    """Text of a cell; whole numbers of spreadsheets without '.0'."""
    if cell is None or (isinstance(cell, float) and np.isnan(cell)):
        return ""
    if isinstance(cell, float) and cell.is_integer():
        cell = int(cell)
    return str(cell).strip()


def _value(default: Any, text: str, where: str) -> Any:
    """Text in the type of an option's default; raises InputError."""
    if isinstance(default, bool):
        if text.lower() not in ("yes", "no", "true", "false", "1", "0"):
            raise InputError(f"{where}: '{text}' is neither yes nor no; correct it")
        return text.lower() in ("yes", "true", "1")
    if isinstance(default, list):
        return text.replace(";", " ").replace(",", " ").split()
    try:
        return type(default)(text)
    except ValueError:
        raise InputError(f"{where}: '{text}' is no number; correct it") from None


def _report(done: list[Any]) -> int:
    """Print what each bag holds and what a check found; gives the exit code."""
    from finger_bag.validate import FAIL, OK, validate

    good = 0
    for result in done:
        peaks = [peak for _, _, peak in result.presses]
        touching = [1e6 * area for area in result.areas if area > 0]
        forces = f"{peaks[0]:.2f} N" if len(peaks) == 1 else f"{min(peaks):.2f} to {max(peaks):.2f}"
        presses = f"1 press to {forces}" if len(peaks) == 1 else f"{len(peaks)} presses to {forces}"
        checked = validate(result.path)
        good += checked.fit and not result.problems
        print(
            f"{plain(result.path)}: {presses}, {len(result.areas)} areas "
            f"({min(touching):.3g} to {max(touching):.3g} mm²): "
            + ("fit for use" if checked.fit else "NOT fit for use")
        )
        for problem in result.problems:
            print(f"  problem: {plain(problem)}")
        for note in result.notes:
            print(f"  note: {plain(note)}")
        for check in checked.checks:
            if check.status != OK and (check.status == FAIL or len(done) == 1):
                print(f"  {check.status}: {plain(check.name)}: {plain(check.detail)}")
    if len(done) > 1:
        print(f"{good} of {len(done)} bags are fit for use")
    return 0 if good == len(done) else EXIT_CHECK_FAILS
