# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A lock on a folder, so that two programs do not write into it, and folders that are written
whole. The kernel ends the lock with the process, also after SIGKILL.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from .errors import InputError
from .files import make_folder

LOCK_FILE = ".lock"


def take_lock(file: IO[str] | int) -> bool:
    """Lock an open file or folder (its descriptor) until it is closed; false when another process
    holds it. File systems without locks are not guarded."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def lock_folder(folder: str | Path, owner: str) -> IO[str]:
    """Lock a folder, which is made if need be, until the file returned is closed.

    owner: what holds it, for others to read. Raises InputError when another process holds it, and
    when the folder cannot be written to. File systems without locks are not guarded.
    """
    folder = Path(folder)
    try:
        make_folder(folder)
        file = (folder / LOCK_FILE).open("a+", encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written to ({error.strerror}); choose another folder"
        ) from None
    if not take_lock(file):
        file.seek(0)
        holder = file.read(200).strip() or "another program"
        file.close()
        raise InputError(f"{folder}: in use by {holder}; end it, or choose another folder")
    file.truncate(0)
    with suppress(OSError):  # the lock holds, whether its holder can be named or not
        file.write(f"{owner} (process {os.getpid()})")
        file.flush()
    return file


def refuse_existing(folder: Path) -> None:
    """Raise InputError where a folder that is to be made exists already; an empty one may."""
    if not os.path.lexists(folder):
        return
    if folder.is_symlink() or not folder.is_dir() or any(folder.iterdir()):
        raise InputError(f"{folder}: exists already; choose another name or remove it")


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Another folder to write into, which takes the name `folder` when the block ends without an
    error, and is removed else.

    Raises InputError where `folder` exists already, is being written by another process, or cannot
    be written.
    """
    refuse_existing(folder)
    partial = folder.with_name(f".{folder.name}.partial")
    try:
        make_folder(partial)
        handle = os.open(partial, os.O_RDONLY)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); choose another folder"
        ) from None
    try:
        # Another process that wrote it may have ended since it was opened.
        if not take_lock(handle) or not partial.exists():
            raise InputError(f"{folder}: is being written by another program; choose another name")
        try:
            for left in partial.iterdir():  # by a program that was killed
                shutil.rmtree(left, ignore_errors=True)
            yield partial
            refuse_existing(folder)
            if folder.is_dir():
                folder.rmdir()
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    finally:
        os.close(handle)
