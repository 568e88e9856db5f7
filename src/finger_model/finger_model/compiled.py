# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""numba's `njit` and `prange`, or plain Python in their place where numba is not installed.

Kernels work on arrays of records with named fields. Compiled code has the fields as attributes of
a record. numpy's own records do not, so kernels get thin views of the arrays here.

numba keeps compiled kernels beside their sources, or in another folder where it cannot. It compiles
one anew when its own file changes, but not when a file does whose kernels or constants it holds.
`keep_kernels` mends that for both. Nor does it tell options apart: a function that is compiled both
for one core and for several (parallel=True) must be written as two, or one is taken for the other.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from finger_common import contact_threshold, flags, trial_phases
from finger_common.files import atomic_write, make_folder

WITHOUT_KERNELS = ("commands", "verification")
"""Folders that no kernel is in."""
KEPT, RECENT = 3, 86400.0
"""Folders of kernels that are kept, each of other sources: the most recently used, and those that a
program was started with so many seconds ago or less."""
_HASH = re.compile("[0-9a-f]{64}")


def keep_kernels(package: Path, *others: str) -> bool:
    """Choose the folder of a package's compiled kernels, and leave no stale ones in it; false where
    no folder can be written.

    Kernels may hold what any source of the package says, but for commands and verification, and
    what the files `others` say. They are kept beside the sources. Where that is impossible, or
    NUMBA_CACHE_DIR names a folder, they are kept in a folder named by the contents of the sources,
    so that kernels of other sources are never found there; a few such folders are kept. Contents
    count, not times: a rig may start without knowing the time. A process that runs since before a
    change of sources may still add old kernels beside them.
    """
    found = (f for f in package.rglob("*.py") if f.parent.name not in WITHOUT_KERNELS)
    files = sorted(f for f in [*found, *map(Path, others)] if f.is_file())
    sources = hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()
    chosen = config.CACHE_DIR  # type: ignore[attr-defined]
    if not chosen and all(writable(f / "__pycache__") for f in {f.parent for f in files}):
        _forget_stale_kernels(package, sources)
        return True
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if chosen and not writable(Path(chosen, sources)):
        print(f"finger_model: NUMBA_CACHE_DIR={chosen} cannot be written", file=sys.stderr)
    for folder in (chosen, os.path.join(cache, "finger_model")):
        # "~" stays where the user has no home.
        if folder and not folder.startswith("~") and writable(Path(folder, sources)):
            _forget_old_folders(Path(folder), sources)
            break
    else:
        folder = ""
        with contextlib.suppress(OSError):
            folder = tempfile.mkdtemp(prefix="finger_model-")
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
        if not folder or not writable(Path(folder)):
            print(
                "finger_model: no folder can be written, not even a temporary one, so each process "
                "compiles kernels anew, for a minute; NUMBA_CACHE_DIR names another folder",
                file=sys.stderr,
            )
            return False
        os.environ["NUMBA_CACHE_DIR"] = folder  # of child processes, too
        config.reload_config()
        print(
            f"finger_model: neither {package} nor {cache} can be written, so kernels are "
            "compiled anew, for a minute, and not kept; NUMBA_CACHE_DIR names another folder",
            file=sys.stderr,
        )
    config.CACHE_DIR = os.path.join(folder, sources)  # type: ignore[attr-defined]
    return True


def writable(folder: Path) -> bool:
    """Whether files can be made in a folder, which is made where it is missing."""
    try:
        make_folder(folder)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(2**16))  # what a full disk refuses
    except OSError:
        return False
    return True


def _forget_stale_kernels(package: Path, sources: str) -> None:
    kept = package / "__pycache__" / "sources_of_kernels.txt"
    with contextlib.suppress(OSError):  # another process may do the same
        if not kept.exists() or kept.read_bytes() != sources.encode():
            for kernel in package.rglob("*.nb[ic]"):
                kernel.unlink(missing_ok=True)
            with atomic_write(kept) as file:
                file.write(sources)


def _forget_old_folders(cache: Path, sources: str) -> None:
    """Note that the folder of these sources is used now, and remove those that were not for long.

    A process that still uses one of them compiles again what it misses.
    """
    with contextlib.suppress(OSError):  # another process may do the same
        os.utime(cache / sources)
        others = [f for f in cache.iterdir() if _HASH.fullmatch(f.name) and f.name != sources]
        used = sorted(((f.stat().st_mtime, f) for f in others), reverse=True)
        for last, folder in used[KEPT - 1 :]:
            if last < time.time() - RECENT:
                shutil.rmtree(folder, ignore_errors=True)


try:
    from numba import config, njit, prange

    _others = (contact_threshold.__file__, flags.__file__, trial_phases.__file__)
    if not keep_kernels(Path(__file__).parent, *_others):
        compiling: Any = njit

        def njit(*functions: Callable[..., Any], **options: Any) -> Any:  # type: ignore[no-redef]
            """numba's, but keeping nothing."""
            return compiling(*functions, **{**options, "cache": False})

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
        if isinstance(value, tuple) and hasattr(value, "_make"):  # a named tuple
            return value._make(map(_with_attributes, value))
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
