"""Many ContactState messages at once: estimates as columns to CDR bytes, CSV and Parquet."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from finger_bag.closing import Closing
from finger_common.errors import InputError
from finger_common.stamps import NANOSECONDS
from finger_model.estimator import EstimateBlock
from finger_model.estimator.estimate import CSV_FIELDS, ESTIMATE_FIELDS, Field

_CDR_TYPES = {"float64": ("<f8", 8), "bool": ("u1", 1), "uint32": ("<u4", 4)}
"""Format and alignment in bytes."""


def serialize(block: EstimateBlock, frame_id: str = "") -> list[bytes]:
    """CDR bytes of each estimate of a block, as ContactState; equal to encoding them one by one."""
    out: list[bytes] = [b""] * len(block)
    names = block.column("parameter_set")
    for name in np.unique(names):
        places = np.flatnonzero(names == name)
        data = _serialize_rows(block.rows[places], frame_id.encode(), str(name).encode())
        for place, message in zip(places.tolist(), data):
            out[place] = message
    return out


def _serialize_rows(rows: np.ndarray, frame_id: bytes, parameter_set: bytes) -> list[bytes]:
    """CDR bytes of estimates of one parameter set: all of one length and layout."""
    texts = {"frame_id": frame_id + b"\x00", "parameter_set": parameter_set + b"\x00"}
    stamp, *others = ESTIMATE_FIELDS
    fields = (stamp, Field("string", name="frame_id"), *others)
    layout = _cdr_layout(fields, texts)
    table = np.zeros(len(rows), layout)
    table["encapsulation"] = np.void(b"\x00\x01\x00\x00")
    for field in fields:
        name = field.name
        if field.type == "string":
            table[f"{name}_length"], table[name] = len(texts[name]), texts[name]
        elif field.type == "time":
            seconds, nanoseconds = np.divmod(rows[name], NANOSECONDS)
            table[f"{name}_sec"], table[f"{name}_nanosec"] = seconds, nanoseconds
        else:
            table[name] = rows[name]
    data, size = table.tobytes(), layout.itemsize
    return [data[begin : begin + size] for begin in range(0, len(data), size)]


def _cdr_layout(fields: Sequence[Field], texts: dict[str, bytes]) -> np.dtype:
    """Structured dtype of a message in CDR; the lengths of its strings are fixed by `texts`."""
    places: dict[str, tuple[str, int]] = {"encapsulation": ("V4", 0)}
    end = 4

    def place(name: str, form: str, alignment: int) -> None:
        nonlocal end
        begin = 4 + -(-(end - 4) // alignment) * alignment
        places[name] = (form, begin)
        end = begin + np.dtype(form).itemsize

    for field in fields:
        if field.type == "time":
            place(f"{field.name}_sec", "<i4", 4)
            place(f"{field.name}_nanosec", "<u4", 4)
        elif field.type == "string":
            place(f"{field.name}_length", "<u4", 4)
            place(field.name, f"S{len(texts[field.name])}", 1)
        else:
            place(field.name, *_CDR_TYPES[field.type])
    formats, offsets = zip(*places.values())
    return np.dtype(
        {"names": list(places), "formats": formats, "offsets": offsets, "itemsize": end}
    )


_COLUMN_FIELDS = tuple(next(f for f in ESTIMATE_FIELDS if f.name == name) for name in CSV_FIELDS)

COLUMNS = ("time_s", *(field.column for field in _COLUMN_FIELDS))
"""Columns of the exports. The first six are those of `finger-model simulate`; time_s counts from the first row."""


def columns(block: EstimateBlock, start_ns: int) -> list[Any]:
    """Values of COLUMNS for a block."""
    found: list[Any] = [(block.column("stamp_ns") - start_ns) * 1e-9]
    for field in _COLUMN_FIELDS:
        values = block.column(field.name)
        if field.type == "float64":
            values = values * field.scale
        elif field.type != "string":
            values = values.astype(np.int64)
        found.append(values)
    return found


class TableExport(Closing):
    """Writes estimates as CSV or Parquet (by the file's suffix) block by block; takes its name when it closes."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._start: int | None = None
        self._temporary = self.path.with_name(f".{self.path.name}.partial")
        self._csv: IO[str] | None = None
        self._parquet: Any = None
        if self.path.suffix not in (".csv", ".parquet"):
            raise InputError(f"{path}: name a .csv or .parquet file")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self.path.suffix == ".csv":
                self._csv = open(self._temporary, "w", encoding="utf-8")
                self._csv.write(",".join(COLUMNS) + "\n")
            else:
                self._parquet = _parquet_writer(self._temporary)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None

    def add(self, block: EstimateBlock) -> None:
        """Append the rows of a block."""
        if not len(block):
            return
        if self._start is None:
            self._start = int(block.column("stamp_ns")[0])
        table = columns(block, self._start)
        if self._csv is not None:
            numbers = [column.tolist() for column in table]
            lines = (",".join(map(_text, row)) for row in zip(*numbers))
            self._csv.write("\n".join(lines) + "\n")
        else:
            import pyarrow

            self._parquet.write_table(
                pyarrow.Table.from_arrays(
                    [pyarrow.array(c) for c in table], schema=self._parquet.schema
                )
            )

    def close(self) -> None:
        """Finish the file."""
        for part in (self._csv, self._parquet):
            if part is not None:
                part.close()
        self._temporary.replace(self.path)

    def abandon(self) -> None:
        """Leave no file."""
        for part in (self._csv, self._parquet):
            if part is not None:
                part.close()
        self._temporary.unlink(missing_ok=True)


def _text(value: float | int | str) -> str:
    """Shortest text that reads back to the same number to 10 digits."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _parquet_writer(path: Path) -> Any:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise InputError("Parquet needs pyarrow; install it, or name a .csv file") from None
    types = {"float64": pyarrow.float64(), "string": pyarrow.string()}
    schema = pyarrow.schema(
        [("time_s", pyarrow.float64())]
        + [(f.column, types.get(f.type, pyarrow.int64())) for f in _COLUMN_FIELDS]
    )
    return parquet.ParquetWriter(path, schema)


def first_frame_id(raws: Sequence[bytes]) -> str:
    """frame_id of the first of some serialized messages that begin with a header; "" when it cannot be read."""
    for raw in raws:
        try:
            (length,) = struct.unpack_from("<I" if raw[1] == 1 else ">I", raw, 12)
            return raw[16 : 16 + max(length - 1, 0)].decode()
        except (struct.error, UnicodeDecodeError, IndexError):
            continue
    return ""
