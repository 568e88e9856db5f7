# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Every source of OpenCV's VideoCapture: V4L2 camera, file, image sequence, GStreamer pipeline.

A camera is read by a thread without pause that keeps only the newest frame: V4L2 queues up to four
frames, and a slower reader would get ever older ones. Files and sequences are played at `rate`
instead.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from finger_common.errors import DeviceError, InputError
from finger_common.host_clock import HostClock
from finger_common.settings import setting
from finger_common.stamps import nanoseconds

from .source import CameraSettings, CameraSource, Frame

_WATCHED = 3.0
"""s between two looks at the exposure of a camera."""
_AUTO_EXPOSURE, _MANUAL_EXPOSURE = (0, 3), 1
"""V4L2's modes in which the camera chooses the exposure time, and in which it does not."""


def exposure_of(capture: Any) -> tuple[bool, float]:
    """Whether a camera chooses its exposure time itself, and that time in the units of its driver;
    0 where the driver does not tell it."""
    time = capture.get(cv2.CAP_PROP_EXPOSURE)
    return capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) in _AUTO_EXPOSURE, max(time, 0.0)


def capture_of(path: str) -> tuple[Any, bool]:
    """VideoCapture for a path and whether it is live (camera or pipeline).

    "0": camera 0, also as "/dev/video0" or a link to it. Text with "!": GStreamer pipeline.
    "frames/f_%03d.png": image sequence. Else a file. Raises InputError for a path that cannot mean
    anything, DeviceError when it does not open.
    """
    if not path:
        raise InputError("parameter 'path' is empty; give a camera number, a file or a sequence")
    device = os.path.realpath(path) if path.startswith("/dev/") else path
    number = device.removeprefix("/dev/video")
    if number.isdecimal():
        backend = cv2.CAP_V4L2 if sys.platform.startswith("linux") else cv2.CAP_ANY
        capture, live = cv2.VideoCapture(int(number), backend), True
        advice = "check the cable, `v4l2-ctl --list-devices` and the group 'video'"
    elif "!" in path:
        if "GStreamer:                   NO" in cv2.getBuildInformation():
            raise InputError(
                "path is a GStreamer pipeline, but this OpenCV is built without GStreamer; install "
                "one that has it, such as apt's python3-opencv"
            )
        capture, live = cv2.VideoCapture(path, cv2.CAP_GSTREAMER), True
        advice = "try the pipeline with gst-launch-1.0"
    else:
        sequence = "%" in Path(path).name
        if not sequence and not Path(path).is_file():
            raise DeviceError(f"{path}: no such file or camera; correct 'path'")
        backend = cv2.CAP_IMAGES if sequence else cv2.CAP_ANY
        capture, live = cv2.VideoCapture(path, backend), False
        advice = "check the name and the format"
    if not capture.isOpened():
        capture.release()
        raise DeviceError(f"camera '{path}' does not open; {advice}")
    return capture, live


@dataclass(frozen=True)
class OpenCvSettings(CameraSettings):
    """Settings of a VideoCapture."""

    gain: float = setting(
        -1.0, "opencv: gain in the driver's own units; -1 leaves it as it is.", minimum=-1.0
    )


class OpenCvSource(CameraSource):
    """OpenCV VideoCapture: camera, file, image sequence, pipeline."""

    SETTINGS = OpenCvSettings

    settings: OpenCvSettings

    def __init__(
        self,
        settings: OpenCvSettings,
        opener: Callable[[str], tuple[Any, bool]] = capture_of,
    ) -> None:
        super().__init__(settings)
        self._path = settings.path
        self._period = 1.0 / settings.rate
        self._opener = opener
        self._silence = max(2.0, 5 * self._period)
        self._capture: Any = None
        self._grabber: _Grabber | None = None

    def connect(self) -> None:
        self.close()
        self._capture, live = self._opener(self._path)
        self.health.hardware_id = f"OpenCV {self._path}"
        if live:
            self._configure()
            self._grabber = _Grabber(self._capture, self.clock)
            self._first_exposure = self._grabber.exposure[1]
            self._tell_exposure(*self._grabber.exposure)
            self._grabber.start()
        self.flush()

    def flush(self) -> None:
        self._last_frame = self._due = time.monotonic()
        self._sequence = -1
        if self._grabber is not None:
            self._grabber.take(0.0)

    def _configure(self) -> None:
        """Set what was requested and report what the camera made of it.

        Drivers ignore settings without an error.
        """
        wanted = self.settings
        requests = [("rate", cv2.CAP_PROP_FPS, wanted.rate)]
        if wanted.width:
            requests.append(("width", cv2.CAP_PROP_FRAME_WIDTH, wanted.width))
        if wanted.height:
            requests.append(("height", cv2.CAP_PROP_FRAME_HEIGHT, wanted.height))
        if wanted.exposure:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
            # V4L2 counts exposure in 100 µs.
            requests.append(("exposure", cv2.CAP_PROP_EXPOSURE, wanted.exposure * 1e4))
        if wanted.gain >= 0:
            requests.append(("gain", cv2.CAP_PROP_GAIN, wanted.gain))
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        # V4L2 takes a size when its second side is set.
        for _, key, value in requests:
            self._capture.set(key, value)
        for name, key, value in requests:
            got = self._capture.get(key)
            self.health.notes[f"camera_{name}"] = f"{got:g}"
            self.note_if(
                abs(got - value) > 0.01 * abs(value),
                f"setting_{name}",
                f"camera '{self._path}': {name} is {got:g}, not {value:g}",
            )

    def _tell_exposure(self, auto: bool, exposure: float) -> None:
        """Report an exposure that has changed, and one that may: the images' brightness is another
        one then."""
        if not exposure:
            return
        first, camera = self._first_exposure, f"camera '{self._path}'"
        self.health.notes["camera_exposure"] = f"{exposure:g}"
        self.health.notes["camera_auto_exposure"] = "on" if auto else "off"
        self.note_if(
            auto,
            "auto_exposure",
            f"{camera}: auto exposure is on: the brightness of the images may change while a "
            "finger presses; set 'exposure'",
        )
        self.note_if(
            abs(exposure - first) > 0.01 * first,
            "exposure_changed",
            f"{camera}: exposure is {exposure:g}, it was {first:g} when the camera was opened; "
            + ("auto exposure is on" if auto else "does another program change it?"),
        )

    def close(self) -> None:
        grabber, self._grabber = self._grabber, None
        capture, self._capture = self._capture, None
        # A capture whose read blocks cannot be released from outside; it is left to its thread.
        if (grabber is None or grabber.stop()) and capture is not None:
            capture.release()

    def read(self, timeout: float = 1.0) -> Frame | None:
        if self._capture is None:
            raise DeviceError(f"camera '{self._path}': not connected")
        if self._grabber is None:
            return self._play(timeout)
        taken = self._grabber.take(timeout)
        if (exposure := self._grabber.take_exposure()) is not None:
            self._tell_exposure(*exposure)
        now = time.monotonic()
        if taken is None:
            if self._grabber.failed or now - self._last_frame > self._silence:
                raise DeviceError(
                    f"camera '{self._path}' gives no frames any more; check cable and power"
                )
            return None
        stamp, image, sequence = taken
        if self._sequence >= 0 and sequence > self._sequence + 1:
            self.health.count("skipped", sequence - self._sequence - 1)
        self._sequence, self._last_frame = sequence, now
        return self.frame(stamp, image, sequence, f"camera '{self._path}'")

    def _play(self, timeout: float) -> Frame | None:
        """Next frame of a file when its time has come."""
        wait = self._due - time.monotonic()
        if wait > timeout:
            time.sleep(timeout)
            return None
        time.sleep(max(wait, 0.0))
        self._due = max(self._due + self._period, time.monotonic() - self._period)
        good, image = self._capture.read()
        if not good or image is None:
            # The end: from the start again.
            self._capture.release()
            self._capture, _ = self._opener(self._path)
            self.health.count("played")
            good, image = self._capture.read()
        if not good or image is None:
            raise DeviceError(f"{self._path}: no frame can be read; check the format")
        self._sequence += 1
        return self.frame(self.clock.now(), image, self._sequence, self._path)


class _Grabber(threading.Thread):
    """Reads a live capture without pause and keeps the newest frame."""

    def __init__(self, capture: Any, clock: HostClock) -> None:
        super().__init__(name="camera-grabber", daemon=True)
        self._capture = capture
        self._clock = clock
        self._condition = threading.Condition()
        self._newest: tuple[int, np.ndarray, int] | None = None
        self.exposure = self._told = exposure_of(capture)
        """As it was at the last look. Once the thread runs, it alone uses the capture."""
        self._ending = threading.Event()
        self.failed = False

    def run(self) -> None:
        sequence = failures = 0
        look = time.monotonic() + _WATCHED
        while not self._ending.is_set():
            good = self._capture.grab()
            stamp = self._stamp()
            image = None
            if good:
                good, image = self._capture.retrieve()
            if not good or image is None:
                failures += 1
                if failures >= 10:
                    self.failed = True
                    return
                self._ending.wait(0.02)
                continue
            failures = 0
            if time.monotonic() >= look:
                self.exposure, look = exposure_of(self._capture), time.monotonic() + _WATCHED
            with self._condition:
                self._newest = (stamp, image, sequence)
                self._condition.notify()
            sequence += 1

    def _stamp(self) -> int:
        """Time of the frame: the kernel's (V4L2: steady clock, ms) where it is recent, else now."""
        now, steady = self._clock.now(), time.monotonic()
        age = steady - self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        return now - nanoseconds(age) if 0 <= age < 1 else now

    def take_exposure(self) -> tuple[bool, float] | None:
        """What the last look gave, None when that was taken before."""
        exposure, told = self.exposure, self._told
        self._told = exposure
        return None if exposure is told else exposure

    def take(self, timeout: float) -> tuple[int, np.ndarray, int] | None:
        """The newest frame not yet taken, or None after `timeout` s."""
        with self._condition:
            if self._newest is None and timeout > 0:
                self._condition.wait(timeout)
            newest, self._newest = self._newest, None
            return newest

    def stop(self) -> bool:
        """End the thread; false when it is blocked in the driver."""
        self._ending.set()
        self.join(2)
        return not self.is_alive()
