"""Many ContactState messages at once: estimates as columns to CDR bytes, CSV and Parquet."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from finger_bag.closing import Closing
from finger_common.errors import InputError
from finger_model.estimator import EstimateBlock


def serialize(block: EstimateBlock, frame_id: str = "") -> list[bytes]:
    """CDR bytes of each estimate of a block; equal to encoding them one by one.

    Layout: geometry of finger_msgs/ContactState in CDR, which is fixed once the lengths of frame_id and of the
    parameter set's name are known.
    """
    out: list[bytes] = [b""] * len(block)
    names = block.parameter_set
    frame = frame_id.encode() + b"\x00"
    for name in dict.fromkeys(names):
        rows = np.array([i for i, n in enumerate(names) if n == name])
        text = name.encode() + b"\x00"
        begin = 4 + -(-(12 + len(frame)) // 8) * 8
        contact = begin + 16
        onset = contact + 4
        # sec and nanosec of onset end on a multiple of 4; float64 needs 8.
        values = 4 + -(-(onset + 8 - 4) // 8) * 8
        string = values + 12 * 8
        flags = 4 + -(-(string + 4 + len(text) - 4) // 4) * 4
        fields: list[tuple[str, Any, int]] = [
            ("head", "V4", 0),
            ("sec", "<i4", 4),
            ("nanosec", "<u4", 8),
            ("frame_length", "<u4", 12),
            ("frame", f"S{len(frame)}", 16),
            ("forces", ("<f8", 2), begin),
            ("contact", "u1", contact),
            ("onset_sec", "<i4", onset),
            ("onset_nanosec", "<u4", onset + 4),
            ("values", ("<f8", 12), values),
            ("name_length", "<u4", string),
            ("name", f"S{len(text)}", string + 4),
            ("flags", "<u4", flags),
        ]
        keys, formats, offsets = zip(*fields)
        layout = np.dtype(
            {"names": keys, "formats": formats, "offsets": offsets, "itemsize": flags + 4}
        )
        table = np.zeros(len(rows), layout)
        stamp, onset_ns = block.whole[rows, 0], block.whole[rows, 3]
        table["head"] = np.void(b"\x00\x01\x00\x00")
        table["sec"], table["nanosec"] = np.divmod(stamp, 1_000_000_000)
        table["frame_length"], table["frame"] = len(frame), frame
        table["forces"] = block.values[rows, :2]
        table["contact"] = block.whole[rows, 2]
        table["onset_sec"], table["onset_nanosec"] = np.divmod(onset_ns, 1_000_000_000)
        table["values"] = block.values[rows, 2:]
        table["name_length"], table["name"] = len(text), text
        table["flags"] = block.whole[rows, 1]
        data, size = table.tobytes(), layout.itemsize
        for place, row in enumerate(rows.tolist()):
            out[row] = data[place * size : (place + 1) * size]
    return out


COLUMNS = (
    "time_s",
    "force_n",
    "area_mm2",
    "radius_mm",
    "indentation_mm",
    "peak_pressure_kpa",
    "mean_pressure_kpa",
    "area_sd_mm2",
    "model_area_mm2",
    "measured_area_mm2",
    "measured_area_age_s",
    "area_force_slope_mm2_per_n",
    "lateral_force_n",
    "moisture_au",
    "in_contact",
    "flags",
    "stamp_ns",
    "parameter_set",
)
"""Columns of the exports. The first six are those of `finger-model simulate`; time_s counts from the first row."""

_SOURCES: tuple[tuple[str, float], ...] = (
    ("normal_force", 1.0),
    ("area", 1e6),
    ("radius", 1e3),
    ("indentation", 1e3),
    ("peak_pressure", 1e-3),
    ("mean_pressure", 1e-3),
    ("area_stddev", 1e6),
    ("model_area", 1e6),
    ("measured_area", 1e6),
    ("measured_area_age", 1.0),
    ("area_force_slope", 1e6),
    ("lateral_force", 1.0),
    ("moisture", 1.0),
)


def columns(block: EstimateBlock, start_ns: int) -> list[Any]:
    """Values of COLUMNS for a block."""
    whole = block.whole
    found: list[Any] = [(whole[:, 0] - start_ns) * 1e-9]
    found += [block.column(name) * scale for name, scale in _SOURCES]
    return [*found, whole[:, 2], whole[:, 1], whole[:, 0], block.parameter_set]


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
            self._start = int(block.whole[0, 0])
        table = columns(block, self._start)
        if self._csv is not None:
            numbers = [column.tolist() for column in table[:-1]]
            lines = (
                ",".join([*map(_text, row), name]) for row, name in zip(zip(*numbers), table[-1])
            )
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


def _text(value: float | int) -> str:
    """Shortest text that reads back to the same number to 10 digits."""
    return str(value) if isinstance(value, int) else f"{value:.10g}"


def _parquet_writer(path: Path) -> Any:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise InputError("Parquet needs pyarrow; install it, or name a .csv file") from None
    whole = {"in_contact": pyarrow.int64(), "flags": pyarrow.int64(), "stamp_ns": pyarrow.int64()}
    schema = pyarrow.schema(
        [
            (n, pyarrow.string() if n == "parameter_set" else whole.get(n, pyarrow.float64()))
            for n in COLUMNS
        ]
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
