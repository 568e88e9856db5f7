"""Many contact estimates at once: to serialized ContactState messages and CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from finger_bag.cdr_layout import serialized, set_stamps, zero_messages
from finger_bag.schema import TOPICS
from finger_common.errors import InputError
from finger_common.files import atomic_write
from finger_common.stamps import seconds
from finger_model.estimator import EstimateBlock
from finger_model.estimator.estimate import CSV_FIELDS, ESTIMATE_FIELDS

STATE_TYPE = TOPICS["contact_state"].type

_COLUMN_FIELDS = {f.column: f for name in CSV_FIELDS for f in ESTIMATE_FIELDS if f.name == name}

COLUMNS = ("time_s", *_COLUMN_FIELDS)
"""Columns of the tables, first those of `finger-model simulate`; time_s is 0 in the first row."""


def serialize(block: EstimateBlock, frame_id: str = "") -> list[bytes]:
    """Each estimate of a block as a serialized ContactState; equal to encoding them one by one."""
    out: list[bytes] = [b""] * len(block)
    names = block.column("parameter_set")
    for name in np.unique(names):
        places = np.flatnonzero(names == name)
        rows = block.rows[places]
        texts = {"header.frame_id": frame_id, "parameter_set": str(name)}
        table = zero_messages(STATE_TYPE, len(rows), texts)
        for field in ESTIMATE_FIELDS:
            if field.type == "time":
                set_stamps(table, field.message, rows[field.name])
            elif field.type != "string":
                table[field.message] = rows[field.name]
        for place, message in zip(places.tolist(), serialized(table)):
            out[place] = message
    return out


def columns(block: EstimateBlock, start_ns: int) -> dict[str, np.ndarray]:
    """Values (n,) of COLUMNS for a block."""
    found = {"time_s": seconds(block.column("stamp_ns") - start_ns)}
    for name, field in _COLUMN_FIELDS.items():
        values = block.column(field.name)
        if field.type == "float64":
            values = values * field.scale
        elif field.type != "string":
            values = values.astype(np.int64)
        found[name] = values
    return found


@contextmanager
def open_table(path: str) -> Iterator[Callable[[EstimateBlock], None]]:
    """Function that appends a block of estimates to a CSV file.

    The file takes its name only when the `with` ends without an error. Raises InputError for
    another suffix, or when the file cannot be written.
    """
    if Path(path).suffix != ".csv":
        raise InputError(f"{path}: name a .csv file")
    start: list[int] = []
    with atomic_write(path) as file:

        def append(block: EstimateBlock) -> None:
            if len(block):
                start[:] = start or [int(block.column("stamp_ns")[0])]
                rows = zip(*(column.tolist() for column in columns(block, start[0]).values()))
                file.writelines(",".join(map(_text, row)) + "\n" for row in rows)

        file.write(",".join(COLUMNS) + "\n")
        yield append


def _text(value: float | int | str) -> str:
    """Shortest text that reads back to the same number to 10 digits."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)
