# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A file that names the recording that runs, so that a recorder that was killed knows of it."""

from __future__ import annotations

import os
from pathlib import Path

from finger_common.folder_lock import take_lock

from .bag_files import METADATA


class RecordingMarker:
    """Marker of one recorder in the folder of its bags.

    name: of the recorder; recorders of other names may have their bags in the folder too.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._file = folder / f".{name.strip('/').replace('/', '.')}.recording"

    def set(self, bag: Path) -> None:
        """Name the bag that is being written; raises OSError where that cannot be."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.write_text(f"{bag.absolute()}\n", encoding="utf-8", errors="surrogateescape")

    def clear(self) -> None:
        """Forget it, as the bag was closed; raises OSError where that cannot be."""
        self._file.unlink(missing_ok=True)

    def broken_off(self) -> Path | None:
        """The bag that was being written when its recorder ended without closing it. None where
        there is none, it was removed or closed since, or a recorder still writes it."""
        try:
            bag = Path(self._file.read_text(encoding="utf-8", errors="surrogateescape").strip())
            if not bag.is_absolute() or not bag.is_dir() or (bag / METADATA).exists():
                return None
            folder = os.open(bag, os.O_RDONLY)
        except (OSError, ValueError):
            return None
        try:
            return bag if take_lock(folder) else None
        finally:
            os.close(folder)
