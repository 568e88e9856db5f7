# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frames as files in a folder, from the simulated rig or another program that owns the camera.

A frame is a file `<stamp>_<sequence>.pgm` (or .png, .tif, .bmp): the acquisition time in ns since
the epoch and the frame's number, in decimal. Files appear whole, by renaming. The writer keeps only
the newest ones. A step of the system clock is taken out, whether the stamps follow it or not.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from finger_common.errors import DeviceError, InputError
from finger_common.image_files import decode_image
from finger_common.stamps import nanoseconds, seconds

from .source import CameraSettings, CameraSource, Frame

_NAME = re.compile(r"(\d{1,19})_(\d{1,18})\.(?:pgm|png|tif|tiff|bmp)")
_POLL = 0.004
_AHEAD = 1.0
"""s by which a frame may be stamped ahead of this machine's clock."""
_BACKLOG = 8
"""Frames that may wait; of more, the oldest are skipped and counted."""


def file_name(stamp_ns: int, sequence: int) -> str:
    """Name of a frame's file; names sort by time."""
    return f"{stamp_ns:019d}_{sequence:08d}.pgm"


def parse_name(name: str) -> tuple[int, int] | None:
    """Stamp (ns) and sequence of a frame's file, None for any other file."""
    match = _NAME.fullmatch(name)
    return (int(match[1]), int(match[2])) if match else None


@dataclass(frozen=True)
class FolderSettings(CameraSettings):
    """Settings of a folder of frames."""

    def validate(self) -> None:
        if not self.path:
            raise InputError("parameter 'path' is empty; name the folder of frames")


class FolderSource(CameraSource):
    """Folder of stamped frames.

    Frames taken before `connect` are not new and are left out. When no frame comes, new files that
    are none are named.
    """

    SETTINGS = FolderSettings
    SIMULATOR = "finger_driver.simulators.images:ImageSimulator"

    def __init__(self, settings: FolderSettings) -> None:
        super().__init__(settings)
        self._folder = Path(settings.path)
        self._connected = False
        self._last = (0, -1)
        self._done: set[str] = set()
        """Files of frames that were taken or are too old: a step of the clock makes none new."""

    def connect(self) -> None:
        if not self._folder.is_dir():
            raise DeviceError(
                f"{self._folder}: no such folder of frames; start what writes it or correct 'path'"
            )
        self.flush()
        self._connected = True
        self.health.hardware_id = str(self._folder)

    def flush(self) -> None:
        self._last = (self.clock.now(), -1)
        self._next_number = None
        self._heard = time.monotonic()
        self._known = self._names()

    def close(self) -> None:
        self._connected = False

    def read(self, timeout: float = 1.0) -> Frame | None:
        end = time.monotonic() + timeout
        while True:
            waiting = self._look()
            if waiting:
                if len(waiting) > _BACKLOG:
                    self.health.count("skipped", len(waiting) - _BACKLOG)
                    self._done.update(name for _, name in waiting[:-_BACKLOG])
                    waiting = waiting[-_BACKLOG:]
                    # Skipped is not lost.
                    self._next_number = waiting[0][0][1]
                key, name = waiting[0]
                self._last = key
                self._done.add(name)
                frame = self._load(key, name)
                if frame is not None:
                    return frame
                continue
            if time.monotonic() >= end:
                return None
            time.sleep(_POLL)

    def _look(self) -> list[tuple[tuple[int, int], str]]:
        """Look into the folder; its new frames, the oldest first: stamp on the node's clock and
        number, name of the file."""
        if not self._connected:
            raise DeviceError(f"{self._folder}: not connected")
        now, names, shift = self.clock.now(), self._names(), self.clock.of_wall(0)
        found, ahead = [], 0
        self._done &= names
        for name in names - self._done:
            if (stamped := parse_name(name)) is None:
                continue
            # A writer may follow a step of the system clock or not.
            either = stamped[0], stamped[0] + shift
            key = min(either, key=lambda stamp: abs(now - stamp)), stamped[1]
            if key <= self._last:
                self._done.add(name)
            elif key[0] > now + nanoseconds(_AHEAD):
                ahead += 1
            else:
                found.append((key, name))
        self.note_if(
            ahead > 0,
            "ahead",
            f"{ahead} frames are stamped in the future and left out; check the clock that stamps "
            "them",
        )
        found.sort()
        if found:
            late = seconds(now - found[-1][0][0])
            self.note_if(
                late > self.stale_after,
                "late",
                f"frames come {late:.1f} s after their stamp; check the clock that stamps them, or "
                "what delays them",
            )
            self.cleared("left_out")
            self._heard, self._known = time.monotonic(), names
        elif time.monotonic() - self._heard > self.stale_after:
            self._note_left_out(names)
        return found

    def _names(self) -> set[str]:
        """Names of the files in the folder."""
        try:
            return set(os.listdir(self._folder))
        except OSError as error:
            raise DeviceError(
                f"{self._folder}: cannot be read ({error.strerror}); start what writes it"
            ) from None

    def _note_left_out(self, names: set[str]) -> None:
        """Name a file that is new and yet no new frame."""
        fresh = {name for name in names - self._known if not name.startswith(".")}
        old = fresh & self._done
        other = {name for name in fresh if parse_name(name) is None}
        if old:
            self.note(
                "left_out",
                f"{max(old)} is left out: it came now, but its stamp is before the last frame or "
                "the start; the stamp is in ns since the epoch, by this computer's clock",
            )
        elif other:
            self.note(
                "left_out",
                f"{max(other)} is left out: name frames STAMP_NUMBER.pgm (png, tif, bmp), the "
                "stamp in ns since the epoch",
            )
        self._known = names

    def _load(self, key: tuple[int, int], name: str) -> Frame | None:
        stamp, sequence = key
        self.count_lost(sequence)
        try:
            data = np.fromfile(self._folder / name, dtype=np.uint8)
        except OSError:
            self.health.count("skipped")
            return None
        try:
            image = decode_image(data, name)
        except InputError:
            self.note("malformed", f"{name}: not an image that can be read")
            return None
        return self.frame(stamp, image, sequence, name)
