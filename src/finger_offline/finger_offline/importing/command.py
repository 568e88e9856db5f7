# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The subcommand `finger-bag import`."""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from finger_bag.cli import EXIT_CHECK_FAILS, AddCommand
from finger_common.cli import add_settings, plain, settings_from
from finger_common.condition_name import SPELLING_ALONE, check_condition_name, same_but_for_spelling
from finger_common.errors import InputError, known_names
from finger_common.files import exists, sha256_of_file
from finger_common.folder_lock import whole_folder
from finger_common.progress import Stages

from .grouped import Part, cell_text, recordings
from .settings import PATHS, ImportSettings
from .tables import read_table

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
        "finger-bag import -o study --trials trials.csv --area-per-pixel 9.86e-10\n"
        "finger-bag import -o study --force all.csv --area all.csv --subject-column Subject "
        "--condition-column Skin --trial-column Trial",
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        help="bag to write; with --trials, --trial-column, --subject-column or --condition-column "
        "the folder of the bags",
    )
    parser.add_argument(
        "--trials",
        metavar="FILE",
        help="table with one recording per row. Its columns have the names of these options, with "
        "_ for -. Paths are relative to the table. The other options hold for every row",
    )
    add_settings(parser, ImportSettings)


def run(args: argparse.Namespace) -> int:
    """Import what the arguments name; gives the exit code."""
    from .trial import Imported, import_trial

    output = Path(args.output)
    output = output if output.name else output.resolve()
    done: list[Imported] = []
    with Stages() as stages:
        settings = None if args.trials else settings_from(args, ImportSettings)
        if settings is not None:  # rows of a table may need what others do not
            settings.check_used()
        if settings is not None and not settings.grouping:
            done.append(import_trial(settings, output, stages.update))
        else:
            rows = list(rows_of(args) if settings is None else named_recordings(settings))
            with whole_folder(output) as partial:
                for row in stages.track(rows, "recordings", len(rows)):
                    try:
                        found = import_trial(
                            row.settings,
                            partial / row.name,
                            tables=row.part.tables,
                            before=row.part.before,
                        )
                    except InputError as error:
                        raise InputError(f"{row.where}: {error}") from None
                    done.append(found)
            for result in done:
                result.path = output / result.path.name
    return _report(done)


@dataclass(frozen=True)
class Recording:
    """What becomes one bag: where it is described, its name, settings, and its part of the
    files."""

    where: str
    name: str
    settings: ImportSettings
    part: Part


class _Names:
    """Numbers and names of the bags of one folder."""

    def __init__(self) -> None:
        self.numbers: Counter[tuple[str, str]] = Counter()
        self.names: set[str] = set()
        self.named: dict[str, None] = {}

    def add(
        self, where: str, settings: ImportSettings, name: str = "", numbered: bool = False
    ) -> tuple[str, ImportSettings]:
        """Name of a bag and its settings, with the next number of its subject and condition unless
        they are `numbered`; raises InputError."""
        group = (settings.subject, settings.condition)
        for text in group:
            self.named[text] = None
            if twins := same_but_for_spelling(self.named):
                raise InputError(f"{where}: '{twins[1]}' and '{twins[0]}' {SPELLING_ALONE}")
        if not numbered:
            settings = dataclasses.replace(settings, index=settings.index + self.numbers[group])
        self.numbers[group] += 1
        name = name or f"{group[0]}_{group[1]}_{settings.index:02d}".replace(" ", "_")
        check_condition_name(name, f"{where}: bag")
        if name.casefold() in self.names:
            raise InputError(f"{where}: bag {name!r} is there twice; give each bag a name")
        self.names.add(name.casefold())
        return name, settings


def named_recordings(settings: ImportSettings) -> Iterator[Recording]:
    """The recordings that columns of the tables tell apart; raises InputError."""
    names = _Names()
    for part in recordings(settings):
        where = f"{settings.force}, {part.words}"
        yield Recording(where, *names.add(where, part.settings), part)


def rows_of(args: argparse.Namespace) -> Iterator[Recording]:
    """The recordings of the rows of the table of trials; raises InputError."""
    table = read_table(args.trials)
    folder = Path(args.trials.partition("::")[0]).parent
    known = {p.name: p for p in ImportSettings.parameters()}
    headings: dict[str, str] = {}
    for heading in table.columns:
        name = re.sub(r"[ -]+", "_", heading.strip().casefold())
        if name.startswith("_"):
            continue
        if name not in known and name != NAME:
            raise InputError(
                f"{table.where}: column '{heading}' is no option; {known_names(name, known)}; "
                "begin the heading of a remark with _"
            )
        headings[name] = heading
    common = {name: getattr(args, name) for name in known}
    names = _Names()
    seen: dict[str, int] = {}
    for row in range(len(next(iter(table.columns.values())))):
        where = f"{table.where}, row {row + table.first_row}"
        cells = {n: cell_text(table.columns[h][row]) for n, h in headings.items()}
        values = dict(common)
        for name, text in cells.items():
            if text and name in known:
                values[name] = _value(known[name].default, text, f"{where}, {headings[name]}")
        for name in PATHS:
            if cells.get(name):
                values[name] = _path(folder, values[name], f"{where}, {headings[name]}")
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
        if settings.grouping and cells.get(NAME):
            raise InputError(f"{where}: gives several bags; leave '{NAME}' empty")
        for part in recordings(settings):
            named = names.add(where, part.settings, cells.get(NAME, ""), bool(cells.get("index")))
            yield Recording(f"{where}{part.words and ', '}{part.words}", *named, part)


def _path(folder: Path, text: str, where: str) -> str:
    """A path of a table, relative to its folder; raises InputError where there is nothing."""
    name, separator, part = text.partition("::")
    for spelling in (name, name.replace("\\", "/")):  # as Windows writes it
        if exists(folder / spelling):
            return f"{folder / spelling}{separator}{part}"
    raise InputError(f"{where}: {folder / name} does not exist; paths are relative to the table")


def _value(default: Any, text: str, where: str) -> Any:
    """Text in the type of an option's default; raises InputError."""
    if isinstance(default, bool):
        if text.lower() not in ("yes", "no", "true", "false", "1", "0"):
            raise InputError(f"{where}: '{text}' is neither yes nor no; correct it")
        return text.lower() in ("yes", "true", "1")
    if isinstance(default, list):
        return _list(text, where)
    try:
        return type(default)(text.replace(",", ".") if isinstance(default, float) else text)
    except ValueError:
        raise InputError(f"{where}: '{text}' is no number; correct it") from None


def _list(text: str, where: str) -> list[str]:
    """Texts between blanks or semicolons, or between commas; raises InputError for one comma, which
    may be a decimal one."""
    if re.search(r"[;\s]", text.strip()):
        parts = re.split(r"[;\s]+", text.strip(" ;"))
        return [part.rstrip(",").replace(",", ".") for part in parts]
    if re.fullmatch(r"\d+,\d+", text):
        raise InputError(f"{where}: '{text}' may be one number or two; separate readings by blanks")
    return [part for part in text.split(",") if part]


def _report(done: list[Any]) -> int:
    """Print what each bag holds and what a check found; gives the exit code."""
    from finger_bag.validate import FAIL, OK, validate

    good = 0
    for result in done:
        peaks = [peak for _, _, peak in result.presses]
        touching = [1e6 * area for area in result.areas if area > 0]
        forces = " … ".join(dict.fromkeys(f"{peak:.2f}" for peak in (min(peaks), max(peaks))))
        presses = f"{len(peaks)} press{'es' if len(peaks) > 1 else ''} to {forces} N"
        checked = validate(result.path)
        fit = checked.fit and not result.problems
        good += fit
        print(
            f"{plain(result.path)}: {presses}, {len(result.areas)} areas "
            f"({min(touching):.3g} to {max(touching):.3g} mm²): "
            + ("fit for use" if fit else "NOT fit for use")
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
