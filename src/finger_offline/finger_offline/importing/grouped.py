# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables that hold several recordings, told apart by columns: one recording after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from finger_common.errors import InputError

from .cells import is_missing
from .settings import ImportSettings
from .tables import Table, read_table

Key = tuple[str, ...]
"""Texts of the grouping columns."""

MOST_RECORDINGS = 10_000
"""Recordings of one table; more are values of a column that tells rows apart."""


def recordings(
    settings: ImportSettings,
) -> Iterator[tuple[str, ImportSettings, dict[str, Table]]]:
    """What tells each recording of the tables apart, in words; its settings; its tables by their
    files. One without words where no column is named. Raises InputError."""
    grouping = settings.grouping
    if not grouping:
        yield "", settings, {}
        return
    names = dict.fromkeys(n for n in (settings.force, settings.area, settings.indentation) if n)
    tables = {name: read_table(name) for name in names}
    rows = {name: _rows(table, grouping) for name, table in tables.items()}
    keys = rows[settings.force]
    if len(keys) > MOST_RECORDINGS:
        raise InputError(
            f"{settings.force}: {len(keys)} recordings, {MOST_RECORDINGS} at most are read; name "
            "a column with one value for each of them"
        )
    for key in keys:
        about = dict(zip(grouping, key))
        words = ", ".join(f"{grouping[name]} {value}" for name, value in about.items())
        changed: dict[str, Any] = {name: "" for name in grouping}
        for name in ("subject", "condition"):
            if f"{name}_column" in about:
                changed[name] = about[f"{name}_column"]
        chosen = {}
        for name, table in tables.items():
            if key not in rows[name]:
                raise InputError(f"{table.where}: has no row with {words}, as {settings.force} has")
            chosen[name] = table.rows(np.array(rows[name][key]))
        try:
            yield words, dataclasses.replace(settings, **changed), chosen
        except InputError as error:
            raise InputError(f"{settings.force}, {words}: {error}") from None


def _rows(table: Table, grouping: dict[str, str]) -> dict[Key, list[int]]:
    """Rows of each combination of values, in the order in which these come; rows without one of
    the values belong to none."""
    columns = [
        table.columns[table.heading(column, f"--{option.replace('_', '-')}")]
        for option, column in grouping.items()
    ]
    found: dict[Key, list[int]] = {}
    for row in range(min(map(len, columns))):
        cells = [column[row] for column in columns]
        if not any(is_missing(cell) or cell != cell for cell in cells):
            found.setdefault(tuple(map(cell_text, cells)), []).append(row)
    return found


def cell_text(cell: object) -> str:
    """Text of a cell; whole numbers of spreadsheets without '.0'."""
    if cell is None or (isinstance(cell, float) and np.isnan(cell)):
        return ""
    if isinstance(cell, (float, np.floating)) and float(cell).is_integer():
        cell = int(cell)
    return str(cell).strip()
