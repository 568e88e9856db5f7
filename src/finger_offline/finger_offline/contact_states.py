# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Many estimates at once: to serialized messages, CSV and Parquet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.cdr_layout import serialized, set_stamps, zero_messages
from finger_bag.definitions import encode
from finger_bag.schema import TOPICS
from finger_common.errors import InputError
from finger_common.files import atomic_write
from finger_common.stamps import seconds
from finger_model.estimator import EstimateBlock
from finger_model.estimator.estimate import CSV_FIELDS, ESTIMATE_FIELDS
from finger_model.messages import shape_fields
from finger_model.shape.estimate import ShapeEstimate

STATE_TYPE = TOPICS["contact_state"].type
SLIP_TYPE = TOPICS["contact_slip"].type
SHAPE_TYPE = TOPICS["contact_shape"].type

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


def serialize_slips(rows: np.ndarray, axes: tuple[int, int], frame_id: str = "") -> list[bytes]:
    """Rows (n,) of the slip estimator as serialized ContactSlip; axes: its `lateral_axes`."""
    table = zero_messages(SLIP_TYPE, len(rows), {"header.frame_id": frame_id})
    for name in rows.dtype.names or ():
        if name == "stamp_ns":
            set_stamps(table, "header.stamp", rows[name])
        elif rows.dtype[name].shape:
            for k, axis in enumerate(axes):
                table[f"{name}.{'xyz'[axis]}"] = rows[name][:, k]
        else:
            table[name] = rows[name]
    return serialized(table)


def serialize_shapes(
    shapes: Iterable[tuple[int, ShapeEstimate]], frame_at: Callable[[int], str]
) -> Iterator[tuple[int, bytes]]:
    """Shapes as serialized ContactShape, each with the log time (ns) that it came with; frame_at:
    frame by log time."""
    for log_ns, shape in shapes:
        yield log_ns, encode(SHAPE_TYPE, shape_fields(shape, frame_at(log_ns)))


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
    """Function that appends a block of estimates to a table: CSV or Parquet, by the suffix.

    The file takes its name only when the `with` ends without an error. Raises InputError for
    another suffix, when the file cannot be written, or for Parquet without pyarrow.
    """
    suffix = Path(path).suffix
    if suffix not in (".csv", ".parquet"):
        raise InputError(f"{path}: name a .csv or .parquet file")
    start: list[int] = []
    with _open_csv(path) if suffix == ".csv" else _open_parquet(path) as write:

        def append(block: EstimateBlock) -> None:
            if len(block):
                start[:] = start or [int(block.column("stamp_ns")[0])]
                write(columns(block, start[0]))

        yield append


@contextmanager
def _open_csv(path: str) -> Iterator[Callable[[dict[str, np.ndarray]], None]]:
    with atomic_write(path) as file:

        def write(table: dict[str, np.ndarray]) -> None:
            rows = zip(*(column.tolist() for column in table.values()))
            file.writelines(",".join(map(_text, row)) + "\n" for row in rows)

        file.write(",".join(COLUMNS) + "\n")
        yield write


@contextmanager
def _open_parquet(path: str) -> Iterator[Callable[[dict[str, np.ndarray]], None]]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise InputError("Parquet needs pyarrow; install it, or name a .csv file") from None
    types = {"float64": pyarrow.float64(), "string": pyarrow.string()}
    fields = [(n, types.get(f.type, pyarrow.int64())) for n, f in _COLUMN_FIELDS.items()]
    schema = pyarrow.schema([("time_s", pyarrow.float64()), *fields])
    with atomic_write(path, "wb") as file, parquet.ParquetWriter(file, schema) as writer:

        def write(table: dict[str, Any]) -> None:
            writer.write_table(pyarrow.table(table, schema=schema))

        yield write


def _text(value: float | int | str) -> str:
    """Shortest text that reads back to the same number to 10 digits."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)
