# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A lock on a folder, so that two programs do not write into it. The kernel ends it with the
process, also after SIGKILL.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import IO

from .errors import InputError

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
        folder.mkdir(parents=True, exist_ok=True)
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
