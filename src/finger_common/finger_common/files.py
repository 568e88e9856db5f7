"""Reading and writing small files so that nothing half-written is left and every error names
the file.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar

import numpy as np
import yaml

from .errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")


@contextmanager
def atomic_write(path: str | Path, mode: str = "w", **options: Any) -> Iterator[IO[Any]]:
    """Open a file for writing that takes its name only when the block ends without an error.

    `mode` is "w" or "wb"; `options` go to `open`. Raises InputError when the folder cannot be
    written to.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if "b" not in mode:
        options.setdefault("encoding", "utf-8")
        options.setdefault("newline", "")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a writable folder"
        ) from None
    try:
        with open(temporary, mode, **options) as file:
            yield file
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def read_bytes(path: str | Path, what: str = "file") -> bytes:
    """Content of a file; raises InputError naming it when it cannot be read."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such {what}; check the path") from None
    except OSError as error:
        raise InputError(f"{path}: {what} cannot be read ({error.strerror})") from None


def read_text(path: str | Path, what: str = "file") -> str:
    """Text (UTF-8) of a file; raises InputError naming it when it cannot be read."""
    try:
        return read_bytes(path, what).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: {what} is not UTF-8 text; save it as UTF-8") from None


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Mapping from YAML text; raises InputError naming `where` and the line."""
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "syntax error"
        raise InputError(f"{where}{line}: not valid YAML ({problem}); correct the syntax") from None
    except RecursionError:
        raise InputError(f"{where}: YAML nested too deeply; flatten it") from None
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise InputError(
            f"{where}: expected 'key: value' lines, found {type(data).__name__}; "
            "see the documentation"
        )
    return data


def load_yaml(path: str | Path, what: str = "YAML file") -> dict[str, Any]:
    """Mapping from a YAML file; raises InputError naming file and line."""
    return parse_yaml(read_text(path, what), str(path))


def number(data: dict[str, Any], key: str, where: str) -> float:
    """Finite number under a key of a mapping; raises InputError naming key and place.

    Text such as "1e5", which YAML 1.1 reads as a string, counts as a number.
    """
    if key not in data:
        raise InputError(f"{where}: key '{key}' is missing; add it")
    value = data[key]
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            pass
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{where}: '{key}' is {value!r}, a finite number is needed")
    return float(value)


def from_numbers(cls: type[Record], data: dict[str, Any], where: str) -> Record:
    """Dataclass of numbers from a mapping; keys left out keep their default.

    Raises InputError for unknown keys and for what the class itself refuses, naming `where` instead
    of the class.
    """
    known = [field.name for field in fields(cls)]
    for key in data:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}'; the keys are {', '.join(known)}")
    values = {key: number(data, key, where) for key in data}
    try:
        return cls(**values)
    except InputError as error:
        raise InputError(str(error).replace(f"{cls.__name__.lower()}:", f"{where}:", 1)) from None


def read_csv(path: str | Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Numeric columns (n,) of a comma-separated file with a header line.

    Further columns are ignored, lines starting with '#' and blank lines too. Raises InputError
    naming file, line and column for a missing column, a cell that is not a finite number, or a file
    without rows.
    """
    text = read_text(path, "CSV file")
    rows = csv.reader(text.splitlines())
    header: list[str] | None = None
    where: list[int] = []
    values: list[list[float]] = []
    for row in rows:
        if not row or not any(cell.strip() for cell in row) or row[0].lstrip().startswith("#"):
            continue
        line = rows.line_num
        if header is None:
            header = [cell.strip() for cell in row]
            missing = [c for c in columns if c not in header]
            if missing:
                raise InputError(
                    f"{path}, line {line}: column '{missing[0]}' is missing; "
                    f"the header must contain {','.join(columns)}"
                )
            where = [header.index(c) for c in columns]
            continue
        numbers = []
        for column, index in zip(columns, where):
            cell = row[index].strip() if index < len(row) else ""
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise InputError(
                    f"{path}, line {line}: '{cell}' in column '{column}' is not a finite number; "
                    "correct or remove the row"
                )
            numbers.append(value)
        values.append(numbers)
    if header is None:
        raise InputError(f"{path}: file is empty; a header {','.join(columns)} is needed")
    if not values:
        raise InputError(f"{path}: no rows below the header; add data")
    table = np.array(values, dtype=float)
    return {column: table[:, i].copy() for i, column in enumerate(columns)}


def sha256_of(value: Any) -> str:
    """Hash (hexadecimal) of bytes or of anything JSON can hold, independent of the order of
    keys.
    """
    if not isinstance(value, bytes):
        value = json.dumps(value, sort_keys=True, separators=(",", ":")).encode()
    return hashlib.sha256(value).hexdigest()
