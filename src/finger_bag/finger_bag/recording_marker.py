# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A file that names the recording that runs, so that a recorder that was killed knows of it."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from finger_common.files import make_folder
from finger_common.folder_lock import take_lock

from .bag_files import METADATA, data_files


@dataclass(frozen=True)
class BrokenOff:
    """A recording that its recorder did not close.

    session: metadata of its bag, where another recorder is to go on with it; None where not. age: s
    since something was written.
    """

    bag: Path
    session: dict[str, str] | None
    age: float


class RecordingMarker:
    """Marker of one recorder in the folder of its bags.

    name: of the recorder; recorders of other names may have their bags in the folder too.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._file = folder / f".{name.strip('/').replace('/', '.')}.recording"

    def set(self, bag: Path, session: Mapping[str, str] | None) -> None:
        """Name the bag that is being written; session: as of `BrokenOff`. Raises OSError where that
        cannot be."""
        make_folder(self._file.parent)
        content = {"bag": str(bag.absolute()), "session": session}
        self._file.write_text(json.dumps(content) + "\n", encoding="utf-8")

    def clear(self) -> None:
        """Forget it, as the bag was closed; raises OSError where that cannot be."""
        self._file.unlink(missing_ok=True)

    def broken_off(self) -> BrokenOff | None:
        """The bag that was being written when its recorder ended without closing it. None where
        there is none, it was removed or closed since, or a recorder still writes it."""
        try:
            content = json.loads(self._file.read_text(encoding="utf-8"))
            bag, session = Path(content["bag"]), content["session"]
            if not bag.is_absolute() or not bag.is_dir() or (bag / METADATA).exists():
                return None
            newest = max((file.stat().st_mtime for file in data_files(bag)), default=0.0)
            folder = os.open(bag, os.O_RDONLY)
        except (OSError, ValueError, TypeError, LookupError, RecursionError):
            return None
        try:
            found = BrokenOff(bag, session, time.time() - newest)
            return found if take_lock(folder) else None
        finally:
            os.close(folder)
