# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""numba's `njit` and `prange`, or plain Python in their place where numba is not installed.

Kernels work on arrays of records with named fields. Compiled code has the fields as attributes of
a record. numpy's own records do not, so kernels get thin views of the arrays here.

numba keeps compiled kernels beside their sources, and compiles one anew when its own file changes,
but not when a file does whose kernels or constants it holds. `forget_stale_kernels` mends that.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from finger_common import contact_threshold, flags
from finger_common.files import atomic_write

WITHOUT_KERNELS = ("commands", "verification")
"""Folders that no kernel is in."""


def forget_stale_kernels(package: Path, *others: str) -> None:
    """Remove a package's compiled kernels when a source that may be in them has changed since.

    Any in the package's folders may be, but for commands and verification, and the files `others`.
    They are compared with a list that is kept of them, not with the age of the kernels: a rig may
    start without knowing the time. Kernels that numba keeps elsewhere, since the package's folder
    is read-only, are left, and a process that runs since before the change may still add old ones.
    """
    kept = package / "__pycache__" / "sources_of_kernels.txt"
    # A folder may be read-only, and another process do the same.
    with contextlib.suppress(OSError):
        files = [f for f in package.glob("*/*.py") if f.parent.name not in WITHOUT_KERNELS]
        names = sorted([*map(str, files), *others])
        stats = map(os.stat, names)
        text = "\n".join(f"{f} {s.st_mtime_ns} {s.st_size}" for f, s in zip(names, stats))
        sources = os.fsencode(text)
        if not kept.exists() or kept.read_bytes() != sources:
            for kernel in package.glob("*/__pycache__/*.nb[ic]"):
                kernel.unlink(missing_ok=True)
            kept.parent.mkdir(exist_ok=True)
            with atomic_write(kept, "wb") as file:
                file.write(sources)


try:
    from numba import njit, prange

    forget_stale_kernels(Path(__file__).parent, contact_threshold.__file__, flags.__file__)
except ImportError:
    print(
        "finger_model: numba is not installed; computing in plain Python, thousands of times "
        "slower (pip install numba)",
        file=sys.stderr,
    )
    prange = range  # type: ignore[assignment,misc]

    class _Record:
        """One record: its fields as attributes, over the memory of its array."""

        __slots__ = ("_memory",)

        def __init__(self, memory: np.ndarray | np.void) -> None:
            object.__setattr__(self, "_memory", memory)

        def __getattr__(self, name: str) -> Any:
            field = self._memory[name]
            if field.dtype.names:
                return _Records(field) if field.shape else _Record(field)
            return field if field.shape else field.item()

        def __setattr__(self, name: str, value: Any) -> None:
            self._memory[name] = value

    class _Records:
        """An array (n, …) of records."""

        def __init__(self, memory: np.ndarray) -> None:
            self.memory = memory
            self.shape = memory.shape

        def __len__(self) -> int:
            return len(self.memory)

        def __getitem__(self, index: Any) -> Any:
            part = self.memory[(index if isinstance(index, tuple) else (index,)) + (...,)]
            return _Records(part) if part.shape else _Record(part)

        def __setitem__(self, index: int, record: _Record) -> None:
            self.memory[index] = record._memory

    def _with_attributes(value: Any) -> Any:
        if isinstance(value, np.void):
            return _Record(value)
        structured = isinstance(value, np.ndarray) and value.dtype.names
        return _Records(value) if structured else value

    def njit(*functions: Callable[..., Any], **options: Any) -> Any:  # type: ignore[no-redef]
        """The function itself, on records with attributes; options are those of numba."""
        if not functions:
            return njit
        function = functions[0]

        @functools.wraps(function)
        def plain(*arguments: Any) -> Any:
            return function(*map(_with_attributes, arguments))

        return plain


__all__ = ["njit", "prange"]
