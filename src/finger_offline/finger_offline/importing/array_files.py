# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables of the arrays in HDF5, MATLAB and NumPy files.

A part is a path as in HDF5 ("S1/trial3") or as in MATLAB ("data.camera", "trial(3)").
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, known_names
from finger_common.files import parse_npz, read_bytes

from .table import Table

MOST_PARTS = 50
"""Parts of a file that are looked for, to name them."""


def no_part(path: Path, part: str) -> None:
    """Raise InputError for a part of a file of a kind that has none."""
    if part:
        raise InputError(f"{path}::{part}: a file of this kind has no parts; leave out '::{part}'")


def of_arrays(where: str, arrays: Mapping[str, Any]) -> Table:
    """Table of the arrays that are columns: one dimension of more than one value. A matrix alone
    gives columns "1", "2", … along its shorter side."""
    found = {str(name): np.squeeze(np.asarray(value)) for name, value in arrays.items()}
    if len(found) == 1:
        (only,) = found.values()
        if only.dtype.names:  # a table of records
            found = {name: only[name] for name in only.dtype.names}
        elif only.ndim == 2:  # MATLAB's own HDF5 files have rows as columns
            columns = only.T if only.shape[0] >= only.shape[1] else only
            found = {str(i): column for i, column in enumerate(columns, 1)}
    return Table(
        where,
        {
            name: array.astype(str) if array.dtype.kind == "S" else array
            for name, array in found.items()
            if array.ndim == 1 and array.dtype.kind in "biufSUOMm" and not _is_cell(array)
        },
    )


def _steps(part: str) -> list[str | int]:
    """Names and indices (from 0) of a path such as "data.trial(3)/force"."""
    found: list[str | int] = []
    for name, index in re.findall(r"([^./(){}]+)|[({](\d{1,9})[)}]", part):
        found.append(name if name else int(index) - 1)
    return found


def _unknown(path: Path, part: str, names: list[str]) -> InputError:
    return InputError(f"{path}: '{part}' does not exist; {known_names(part, names)}")


# NumPy ---------------------------------------------------------------------------------------


def read_npz(path: Path, part: str) -> Table:
    """Arrays of a .npz by their names."""
    no_part(path, part)
    return of_arrays(str(path), parse_npz(read_bytes(path, "NPZ file"), str(path)))


def read_npy(path: Path, part: str) -> Table:
    """Columns "1", "2", … of a .npy."""
    no_part(path, part)
    try:
        array = np.load(io.BytesIO(read_bytes(path, "NumPy file")), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"{path}: not a NumPy file that can be read ({error})") from None
    return of_arrays(str(path), {"1": array})


# HDF5 ----------------------------------------------------------------------------------------


def read_hdf5(path: Path, part: str) -> Table:
    """Datasets of a group, or one dataset."""
    try:
        import h5py
    except ImportError:
        raise InputError(f"{path}: HDF5 needs h5py; pip install h5py") from None
    try:
        with h5py.File(path, "r") as file:
            node = _hdf5_node(path, file, part)
            if isinstance(node, dict):
                arrays = {n: v[()] for n, v in node.items() if isinstance(v, h5py.Dataset)}
            elif isinstance(node, h5py.Group):
                arrays = {_text(n): v[()] for n, v in node.items() if _is_column(v)}
            else:
                arrays = {part: node[()]} if _is_column(node) else {}
            parts = list(_hdf5_parts(file)) if not part else []
    except InputError:
        raise
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"{path}: not an HDF5 file that can be read ({error})") from None
    if len(arrays) > 1 and not any(np.squeeze(a).ndim == 1 for a in arrays.values()):
        arrays = {}  # matrices: each is a table of its own
    where = f"{path}::{part}" if part else str(path)
    if not arrays:
        shown = ", ".join(parts[:8]) + (", …" if len(parts) > 8 else "")
        hint = f" ({shown})" if parts else ""
        raise InputError(
            f"{where}: holds no columns of numbers itself; name the part that does as "
            f"{path}::PART{hint}"
        )
    found = of_arrays(where, arrays)
    return Table(where, found.columns, parts=tuple(parts))


def _is_column(node: Any) -> bool:
    """Whether a node is an array of values; MATLAB's references to other arrays are none."""
    dtype = getattr(node, "dtype", None)
    return dtype is not None and bool(node.shape) and not _is_reference(dtype)


def _is_reference(dtype: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dtype) is not None


def _hdf5_node(path: Path, file: Any, part: str) -> Any:
    """Group, dataset, or a mapping of datasets: the element of an array of MATLAB structs."""
    key = part.strip("/") or "/"
    for name in (key, key.encode("latin-1", "replace")):
        with suppress(KeyError):
            return file[name]
    node: Any = file
    for step in _steps(part):
        if isinstance(step, str):
            if isinstance(node, dict):
                child = node.get(step)
            else:
                child = node.get(step) if hasattr(node, "get") else None
        elif hasattr(node, "items"):  # a struct array: references in each of its members
            child = {
                name: file[member[()].flat[step]]
                for name, member in node.items()
                if _is_references(member) and 0 <= step < member.size
            } or None
        else:
            known = _is_references(node) and 0 <= step < node.size
            child = file[node[()].flat[step]] if known else None
        if child is None:
            raise _unknown(path, part, list(_hdf5_parts(file)))
        node = child
    return node


def _is_references(node: Any) -> bool:
    return hasattr(node, "dtype") and _is_reference(node.dtype)


def _hdf5_parts(file: Any) -> Iterator[str]:
    """Names of groups with columns, of matrices, and of MATLAB's cells and arrays of structs."""
    names: list[str] = []

    def look(name: str | bytes, node: Any) -> bool | None:
        name = _text(name)
        if name.startswith("#"):
            return None
        if hasattr(node, "items"):
            members = list(node.values())
            if members and all(map(_is_references, members)):
                names.append(f"{name}(1)")
            elif any(_is_column(m) and _longest_side(m) for m in members):
                names.append(name)
        elif _is_references(node) and "/" not in name:
            names.append(f"{name}{{1}}")
        elif len(node.shape) == 2 and min(node.shape) > 1 and _is_column(node):
            names.append(name)
        return True if len(names) >= MOST_PARTS else None

    file.visititems(look)
    return iter(names)


def _text(name: str | bytes) -> str:
    """A name in an HDF5 file; h5py gives one that is no UTF-8 as bytes."""
    return name.decode("latin-1") if isinstance(name, bytes) else name


def _longest_side(node: Any) -> bool:
    """Whether an array has one side longer than 1."""
    return sum(side > 1 for side in node.shape) == 1


# MATLAB --------------------------------------------------------------------------------------


def read_matlab(path: Path, part: str) -> Table:
    """Variables of a MATLAB file, or the fields of a struct in it."""
    content = read_bytes(path, "MATLAB file")
    if content.startswith(b"MATLAB 7.3"):
        return read_hdf5(path, part)
    from scipy.io import loadmat

    try:
        found = loadmat(io.BytesIO(content), squeeze_me=True, struct_as_record=True)
    except MemoryError:
        raise
    except Exception as error:
        # A damaged file makes loadmat raise almost anything.
        raise InputError(f"{path}: not a MATLAB file that can be read ({error})") from None
    variables = {name: value for name, value in found.items() if not name.startswith("__")}
    node: Any = variables
    for step in _steps(part):
        node = _matlab_step(node, step)
        if node is None:
            raise _unknown(path, part, list(_matlab_parts(variables)))
    where = f"{path}::{part}" if part else str(path)
    fields = _fields(node)
    parts = () if part else tuple(_matlab_parts(variables))
    table = of_arrays(where, {part: node} if fields is None else fields)
    if not table.columns and np.size(node) > 1 and fields is None:
        raise InputError(f"{where}: holds several structs; name one as {where}(1)")
    return Table(where, table.columns, parts=parts)


def _matlab_step(node: Any, step: str | int) -> Any:
    """The field or element of a struct, None where there is none."""
    if isinstance(step, str):
        fields = _fields(node)
        return fields.get(step) if fields else None
    array = np.atleast_1d(node)
    return array.reshape(-1)[step] if 0 <= step < array.size else None


def _fields(node: Any) -> dict[str, Any] | None:
    """Fields of one struct; None for what is none."""
    if isinstance(node, dict):
        return node
    if not _is_struct(node) or np.size(node) != 1:
        return None
    record = node.reshape(-1)[0] if isinstance(node, np.ndarray) else node
    return {name: record[name] for name in node.dtype.names}


def _is_struct(value: Any) -> bool:
    return bool(getattr(getattr(value, "dtype", None), "names", None))


def _is_cell(value: Any) -> bool:
    """Whether an array holds arrays or structs, as MATLAB's cells do."""
    if not isinstance(value, np.ndarray) or value.dtype != object or not value.size:
        return False
    first = value.reshape(-1)[0]
    return _is_struct(first) or isinstance(first, np.ndarray)


def _matlab_parts(variables: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Names of structs, and of the first of each array of structs."""
    for name, value in variables.items():
        if isinstance(value, np.ndarray) and value.shape == () and value.dtype == object:
            value = value.item()
        if _is_struct(value) or _is_cell(value):
            several = np.size(value) != 1
            yield f"{prefix}{name}" + ("(1)" if several else "")
            fields = _fields(value)
            if fields:
                yield from _matlab_parts(fields, f"{prefix}{name}.")
        elif not prefix and np.ndim(value) == 2:
            yield name
