# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""numba's `njit` and `prange`, or plain Python in their place where numba is not installed.

Kernels work on arrays of records with named fields. Compiled code has the fields as attributes of
a record. numpy's own records do not, so kernels get thin views of the arrays here.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

try:
    from numba import njit, prange
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

        def __init__(self, memory: np.ndarray) -> None:
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
