# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading and writing small files so that nothing half-written is left and every error names
the file.

Files come from other people too: what a file can claim is bounded before memory is taken for it
(aliases of YAML that multiply, arrays of terabytes, nesting without end, numbers of a thousand
digits).
"""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import json
import math
import os
import re
import stat
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np
import yaml

from .errors import TWICE, InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")

MAXIMUM_FILE = 1 << 30
"""Bytes above which a file is not read into memory."""

MAXIMUM_PIPE = 128 << 20
"""The same for what is no plain file, such as a pipe or a device: some of them never end."""

MAXIMUM_TEXT = 16 << 20
"""Bytes of a text (YAML, JSON, DBC; not a table) above which it is not parsed."""

MAXIMUM_VALUES = 100_000
"""Values of a YAML file, aliases counted as what they stand for."""

MAXIMUM_DEPTH = 64
"""Levels of nesting of YAML or JSON."""

MAXIMUM_DIGITS = 100
"""Characters of a number in YAML."""

FREE_ARRAYS, ARRAYS_PER_BYTE = 64 << 20, 20
"""Bytes that the arrays of any NPZ file may have, and further ones for each of its bytes."""

FREE_MEMORY, MEMORY_PER_BYTE = 160 << 20, 50
"""Bytes that another library may take to read any file, and further ones for each of its bytes."""

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Errors of a disk that is full."""

_PIECE = 1 << 20

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the same, ten times as fast
_JSON_TOKEN = re.compile(r'(?P<text>"(?:[^"\\]|\\.)*")\s*(?P<colon>:)?|(?P<brace>[{}])', re.DOTALL)
_NUMBER = re.compile(r"[-+.]?[0-9][-+0-9a-zA-Z_.:]*")


def _sync_folder(folder: Path) -> None:
    """Wait until the disk has the names in a folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # file systems of networks may not know this
            os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(folder: str | Path) -> None:
    """Make a folder and those above it that are missing; raises OSError.

    `Path.mkdir` calls itself once a level: a path of a thousand levels ends it.
    """
    levels = [Path(folder)]
    while not levels[-1].parent.exists():
        levels.append(levels[-1].parent)
    for level in reversed(levels):
        level.mkdir(exist_ok=True)


@contextmanager
def atomic_write(
    path: str | Path, mode: str = "w", *, durable: bool = False, **options: Any
) -> Iterator[IO[Any]]:
    """Open a file for writing that takes its name only when the block ends without an error.

    What is no plain file, such as a device or a pipe, is written to and stays what it is.
    `mode` is "w" or "wb"; `options` go to `open`. durable: wait until the disk has it, which takes
    milliseconds, so that it survives a crash of the computer. Raises InputError when the folder
    cannot be written to and when the disk is full.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if "b" not in mode:
        options.setdefault("encoding", "utf-8")
        options.setdefault("newline", "")
    try:
        os.fsencode(path)
        target = Path(os.path.realpath(path))  # a link stays one
    except ValueError:  # a null byte, a lone surrogate
        raise InputError(f"{str(path)!r}: not a file name; choose another") from None
    # What is no file, such as /dev/null, is written to: root could replace it by a file.
    device = exists(target) and not target.is_file()
    written = str(target)
    try:
        make_folder(target.parent)
        if not device:
            handle, written = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
            os.close(handle)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a writable folder"
        ) from None
    try:
        with open(written, mode, **options) as file:
            yield file
            if durable and not device:
                file.flush()
                os.fsync(file.fileno())
        if device:
            return
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(written, 0o666 & ~umask)
        os.replace(written, target)
        if durable:
            _sync_folder(target.parent)
    except BaseException as error:
        if not device:
            with suppress(OSError):
                Path(written).unlink()
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); make room or choose another folder"
            ) from None
        raise


def check_outputs(
    outputs: Iterable[str | Path | None], inputs: Iterable[str | Path | None]
) -> None:
    """Raise InputError for an output that is one of the files a command reads, or is or lies in
    another output; None and "" are none, devices may take several."""
    read = [path for path in inputs if path and exists(path)]
    written: dict[Path, str | Path] = {}
    for output in [path for path in outputs if path]:
        if exists(output) and any(os.path.samefile(path, output) for path in read):
            raise InputError(f"{output}: is an input too and would be lost; name another output")
        try:
            real = Path(os.path.realpath(output))
        except ValueError:  # refused when it is opened
            continue
        if exists(real) and not real.is_file() and not real.is_dir():
            continue
        for other, name in written.items():
            if real == other:
                raise InputError(f"{output}: is named for two outputs; give each its own name")
            if other in real.parents or real in other.parents:
                inner, outer = (output, name) if other in real.parents else (name, output)
                raise InputError(f"{inner}: lies in the output {outer}; name another folder")
        written[real] = output


def user_path(path: str | Path) -> Path:
    """A path that a user gave, with the home folder for ~; raises InputError where there is none,
    as of a user who does not exist."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise InputError(
            f"{path}: '{Path(path).parts[0]}' is no home folder here; give the whole path"
        ) from None


def exists(path: str | Path) -> bool:
    """Whether there is such a file or folder; False also for what cannot be a name of one."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def read_bytes(path: str | Path, what: str = "file", maximum: int = MAXIMUM_FILE) -> bytes:
    """Content of a file of `maximum` bytes at most; raises InputError naming it when it cannot be
    read.
    """
    try:
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                maximum = min(maximum, MAXIMUM_PIPE)
            data = file.read(min(maximum, status.st_size) + 1)
            parts, size = [data], len(data)
            # What is no plain file, such as a pipe, has no size.
            while size <= maximum and (data := file.read(min(_PIECE, maximum + 1 - size))):
                parts.append(data)
                size += len(data)
    except FileNotFoundError:
        raise InputError(f"{path}: no such {what}; check the path") from None
    except OSError as error:
        raise InputError(f"{path}: {what} cannot be read ({error.strerror})") from None
    except ValueError:
        raise InputError(f"{str(path)!r}: not a file name; check the path") from None
    if size > maximum:
        raise InputError(f"{path}: {what} has more than {maximum} bytes; not read")
    return b"".join(parts) if len(parts) > 1 else parts[0]


@contextmanager
def bounded_memory(path: str | Path) -> Iterator[None]:
    """Refuse a file for which a library of others takes more memory than the file's size explains.

    For libraries that believe what a file claims. Within the block the process gets no further
    data than `FREE_MEMORY` and `MEMORY_PER_BYTE` for each byte of the file; a MemoryError becomes
    an InputError that names it. Linux alone can limit it.
    """
    if sys.platform != "linux":
        yield
        return
    import resource

    allowed = FREE_MEMORY + MEMORY_PER_BYTE * os.stat(path).st_size
    before = resource.getrlimit(resource.RLIMIT_DATA)
    pages = int(Path("/proc/self/statm").read_text().split()[5])
    limit = pages * resource.getpagesize() + allowed
    if before[0] != resource.RLIM_INFINITY:
        limit = min(limit, before[0])
    resource.setrlimit(resource.RLIMIT_DATA, (limit, before[1]))
    try:
        yield
    except MemoryError:
        raise InputError(
            f"{path}: holds more than {allowed >> 20} MB of values, which its size does not "
            "explain; not read"
        ) from None
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def read_text(path: str | Path, what: str = "file", maximum: int = MAXIMUM_TEXT) -> str:
    """Text (UTF-8) of a file; raises InputError naming it when it cannot be read."""
    try:
        return read_bytes(path, what, maximum).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: {what} is not UTF-8 text; save it as UTF-8") from None


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Mapping from YAML text; raises InputError naming `where` and the line."""
    if len(text) > MAXIMUM_TEXT:
        raise InputError(f"{where}: more than {MAXIMUM_TEXT} characters; not read")
    try:
        _check_events(text, where)
        data = yaml.load(text, Loader=_LOADER)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "syntax error"
        if mark and text[mark.index : mark.index + 1] == "\t":
            problem = "a tab; indent with blanks"
        raise InputError(f"{where}{line}: not valid YAML ({problem}); correct the syntax") from None
    except InputError:
        raise
    except (ValueError, LookupError, AttributeError, TypeError, ArithmeticError) as error:
        # A tag that does not fit its value, such as `!!int x`.
        raise InputError(f"{where}: a value cannot be read ({error}); correct it") from None
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise InputError(
            f"{where}: expected 'key: value' lines, found {type(data).__name__}; "
            "see the documentation"
        )
    _check_values(data, where)
    return data


def _check_events(text: str, where: str) -> None:
    """Refuse YAML that has a key twice, or is too deep or too large once its aliases are
    followed."""
    sizes: dict[str, int] = {}  # values below an anchor; absent while it is open
    opened: list[tuple[str | None, int]] = []  # anchor, values before it
    keys: list[set[str] | None] = []  # of what is open; None for a sequence
    key_next: list[bool] = []
    values = 0

    def refuse(event: Any, reason: str) -> NoReturn:
        raise InputError(f"{where}, line {event.start_mark.line + 1}: {reason}")

    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            del keys[-1], key_next[-1]
            if anchor:
                sizes[anchor] = values - before
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        before, values = values, values + 1
        if keys and (known := keys[-1]) is not None:
            if key_next[-1] and isinstance(event, yaml.ScalarEvent):
                # Of several '<<', the merge of YAML, none replaces another.
                if event.value in known and event.value != "<<":
                    refuse(event, TWICE.format(event.value))
                known.add(event.value)
            key_next[-1] = not key_next[-1]
        if isinstance(event, yaml.AliasEvent):
            if event.anchor is None or event.anchor not in sizes:
                refuse(event, f"alias '{event.anchor}' refers to itself or to nothing; remove it")
            values += sizes[event.anchor]
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, before))
            keys.append(set() if isinstance(event, yaml.MappingStartEvent) else None)
            key_next.append(True)
            if len(opened) > MAXIMUM_DEPTH:
                refuse(event, "YAML nested too deeply; flatten it")
        elif isinstance(event, yaml.ScalarEvent):
            if event.anchor:
                sizes[event.anchor] = 1
            long = len(event.value) > MAXIMUM_DIGITS
            if long and event.implicit[0] and _NUMBER.fullmatch(event.value):
                refuse(event, f"number of {len(event.value)} characters; shorten it")
        if values > MAXIMUM_VALUES:
            refuse(event, f"more than {MAXIMUM_VALUES} values, aliases followed; not read")


def parse_json(text: str, where: str) -> Any:
    """Value from JSON text; raises InputError naming `where` and, for a key that an object has
    twice, the line."""
    if len(text) > MAXIMUM_TEXT:
        raise InputError(f"{where}: more than {MAXIMUM_TEXT} characters; not read")

    def of_pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(found := dict(pairs)) < len(pairs):
            raise _KeyTwice
        return found

    try:
        data = json.loads(text, object_pairs_hook=of_pairs)
    except _KeyTwice:
        key, line = _key_twice(text)
        raise InputError(f"{where}, line {line}: {TWICE.format(key)}") from None
    except RecursionError:
        raise InputError(f"{where}: JSON nested too deeply; flatten it") from None
    except ValueError as error:
        raise InputError(f"{where}: not valid JSON ({error}); correct it") from None
    _check_values(data, where)
    return data


class _KeyTwice(Exception):
    pass


def _key_twice(text: str) -> tuple[str, int]:
    """The first key that an object of JSON text has twice, and the line where it comes again."""
    opened: list[set[str]] = []
    for token in _JSON_TOKEN.finditer(text):
        if token["brace"] == "{":
            opened.append(set())
        elif token["brace"]:
            opened.pop()
        elif token["colon"]:
            key = json.loads(token["text"])
            if key in opened[-1]:
                return key, text.count("\n", 0, token.start()) + 1
            opened[-1].add(key)
    raise AssertionError("no key is there twice")


def _check_values(data: Any, where: str) -> None:
    """Refuse integers of more than 64 bits, lone surrogates and nesting beyond the limit."""
    level, depth = [data], 0
    while level:
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                below += value
                below += value.values()
            elif isinstance(value, (list, tuple, set)):
                below += value
            elif isinstance(value, int) and value.bit_length() > 64:
                raise InputError(f"{where}: an integer has more than 64 bits; shorten it")
            elif isinstance(value, str):
                check_text(value, where)
        level, depth = below, depth + 1
        if depth > MAXIMUM_DEPTH + 1:
            raise InputError(f"{where}: nested too deeply; flatten it")


def check_text(text: str, where: str) -> None:
    """Raise InputError, naming `where`, for text that no file can hold (a lone surrogate)."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(f"{where}: {text[:40]!r} is not valid text; correct it") from None


def await_file(path: str | Path, seconds: float) -> bool:
    """Wait until a file is there, at most so long; whether it is."""
    end = time.monotonic() + seconds
    while not Path(path).exists():
        if time.monotonic() >= end:
            return False
        time.sleep(0.1)
    return True


def load_yaml(path: str | Path, what: str = "YAML file") -> dict[str, Any]:
    """Mapping from a YAML file; raises InputError naming file and line.

    So does an empty file, which more likely lost its content than means all defaults.
    """
    found = parse_yaml(read_text(path, what), str(path))
    if not found:
        raise InputError(f"{path}: the {what} is empty; write it again, or leave it out")
    return found


def load_json(path: str | Path, what: str = "JSON file") -> Any:
    """Value of a JSON file; raises InputError naming the file."""
    return parse_json(read_text(path, what), str(path))


def parse_npz(data: bytes, where: str) -> dict[str, np.ndarray]:
    """Arrays by name of an NPZ file; raises InputError naming `where`.

    Before an array is read, the size that its header claims is compared with its bytes.
    """
    allowed = FREE_ARRAYS + ARRAYS_PER_BYTE * len(data)
    arrays: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > allowed:
                raise InputError(f"{where}: claims more than {allowed} bytes of arrays; not read")
            for member in members:
                content = archive.read(member)
                arrays[member.filename.removesuffix(".npy")] = _parse_npy(content)
    except InputError:
        raise
    except Exception as error:
        # A damaged archive makes zipfile and NumPy raise almost anything.
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"{where}: not an NPZ file that can be read ({reason})") from None
    return arrays


def _parse_npy(content: bytes) -> np.ndarray:
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise ValueError("an array's header does not fit its bytes")
    values = np.frombuffer(content, dtype, offset=stream.tell())
    return values.reshape(shape, order="F" if fortran else "C").copy()


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


def read_csv(
    path: str | Path, columns: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Numeric columns (n,) of a comma-separated file with a header line.

    `optional` columns are read where the header has them. Further columns are ignored, lines
    starting with '#' and blank lines too. Raises InputError naming file, line and column for a
    missing column, a cell that is not a finite number, or a file without rows.
    """
    text = read_text(path, "CSV file", MAXIMUM_FILE)
    rows = _csv_rows(csv.reader(text.splitlines()), str(path))
    header: list[str] | None = None
    where: list[int] = []
    values: list[list[float]] = []
    for line, row in rows:
        if not row or not any(cell.strip() for cell in row) or row[0].lstrip().startswith("#"):
            continue
        if header is None:
            header = [cell.strip() for cell in row]
            missing = [c for c in columns if c not in header]
            if missing:
                joined = len(header) == 1 and ";" in header[0]
                remedy = "; separate columns by commas, not by semicolons" if joined else ""
                raise InputError(
                    f"{path}, line {line}: column '{missing[0]}' is missing; "
                    f"the header must contain {','.join(columns)}{remedy}"
                )
            columns = [*columns, *(c for c in optional if c in header)]
            twice = [c for c in columns if header.count(c) > 1]
            if twice:
                raise InputError(
                    f"{path}, line {line}: column '{twice[0]}' is there twice; rename one"
                )
            where = [header.index(c) for c in columns]
            continue
        if any(cell.strip() for cell in row[len(header) :]):
            raise InputError(
                f"{path}, line {line}: {len(row)} cells below a header of {len(header)}; use a "
                "decimal point and one comma between cells"
            )
        numbers = []
        for column, index in zip(columns, where):
            cell = row[index].strip() if index < len(row) else ""
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise InputError(
                    f"{path}, line {line}: '{cell[:40]}' in column '{column}' is not a finite "
                    "number; correct or remove the row"
                )
            numbers.append(value)
        values.append(numbers)
    if header is None:
        raise InputError(f"{path}: file is empty; a header {','.join(columns)} is needed")
    if not values:
        raise InputError(f"{path}: no rows below the header; add data")
    table = np.array(values, dtype=float)
    return {column: table[:, i].copy() for i, column in enumerate(columns)}


def _csv_rows(reader: Any, where: str) -> Iterator[tuple[int, list[str]]]:
    """Lines with their numbers; raises InputError for a cell that is no table's."""
    try:
        for row in reader:
            yield reader.line_num, row
    except csv.Error as error:
        raise InputError(f"{where}, line {reader.line_num}: {error}; correct the file") from None


def sha256_of_file(path: str | Path, what: str = "file") -> str:
    """Hash (hexadecimal) of a file, read in blocks; raises InputError when it cannot be read."""
    sha = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while block := file.read(1 << 20):
                sha.update(block)
    except OSError as error:
        raise InputError(f"{path}: {what} cannot be read ({error.strerror})") from None
    return sha.hexdigest()


def sha256_of(value: Any) -> str:
    """Hash (hexadecimal) of bytes or of anything JSON can hold, independent of the order of
    keys.
    """
    if not isinstance(value, bytes):
        value = json.dumps(value, sort_keys=True, separators=(",", ":")).encode()
    return hashlib.sha256(value).hexdigest()
