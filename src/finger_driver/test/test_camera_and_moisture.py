# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Cameras, calibration files, moisture lines and tables."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from finger_common import diagnostics
from finger_common.errors import DeviceError, InputError
from finger_common.host_clock import HostClock
from finger_driver import camera, moisture
from finger_driver.camera import opencv
from finger_driver.camera.folder import FolderSettings, FolderSource
from finger_driver.camera.freeze import FreezeDetector
from finger_driver.camera.info import CameraCalibration, resolve_url
from finger_driver.camera.opencv import OpenCvSettings, OpenCvSource
from finger_driver.camera.ueye import UeyeSettings, UeyeSource
from finger_driver.moisture import Reading
from finger_driver.moisture.export import ExportSettings, ExportSource
from finger_driver.moisture.serial import SerialSettings, SerialSource
from finger_driver.protocols import lines
from finger_driver.protocols.export_table import Row, TableFormat, new_rows, parse_table
from finger_driver.simulators import FrameFolderWriter, SerialMoistureSimulator
from finger_driver.simulators.export import ExportFileSimulator, ExportOptions


def picture(seed: int = 0, shape: tuple[int, int] = (24, 32)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


# Camera ------------------------------------------------------------------------------------------


def test_frames_arrive_as_written_with_their_stamps_and_older_ones_do_not(tmp_path: Path) -> None:
    writer = FrameFolderWriter(tmp_path / "f", keep=3)
    writer.write(time.time_ns() - 10**9, picture(9))
    source = FolderSource(FolderSettings(path=str(tmp_path / "f")))
    source.connect()
    assert source.read(0.05) is None, "a frame from before the connection was taken as new"
    stamps = []
    for index in range(6):
        stamp = time.time_ns()
        writer.write(stamp, picture(index))
        frame = source.read(1.0)
        assert frame is not None
        np.testing.assert_array_equal(frame.image, picture(index))
        assert frame.sequence == index + 1
        stamps.append((stamp, frame.stamp_ns))
    assert all(a == b for a, b in stamps)
    assert len(list((tmp_path / "f").iterdir())) == 3


def test_a_frame_of_the_future_does_not_hide_those_of_today(tmp_path: Path) -> None:
    writer = FrameFolderWriter(tmp_path / "f", keep=10)
    source = FolderSource(FolderSettings(path=str(tmp_path / "f")))
    source.connect()
    writer.write(time.time_ns() + 3600 * 10**9, picture(0))
    assert source.read(0.05) is None
    assert "stamped in the future" in source.health.faults["ahead"]
    for index in range(1, 4):
        writer.write(time.time_ns(), picture(index))
        frame = source.read(1.0)
        assert frame is not None and frame.sequence == index


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("{ms}_1.pgm", "ns since the epoch"),
        ("{us}_1.pgm", "ns since the epoch"),
        ("{hour_ago}_1.pgm", "before the last frame or the start"),
        ("{ns}_1.jpg", "name frames STAMP_NUMBER.pgm"),
        ("frame_001.png", "name frames STAMP_NUMBER.pgm"),
    ],
)
def test_new_files_that_are_no_new_frames_are_named(tmp_path: Path, name: str, why: str) -> None:
    FrameFolderWriter(tmp_path).write(time.time_ns(), picture())
    source = FolderSource(FolderSettings(path=str(tmp_path)))
    source.connect()
    (tmp_path / ".next.part").touch()
    source._heard -= 2.0
    assert source.read(0.01) is None and not source.health.faults
    ns = time.time_ns()
    times = {"ns": ns, "us": ns // 1000, "ms": ns // 10**6, "hour_ago": ns - 3600 * 10**9}
    path = tmp_path / name.format(**times)
    path.touch()
    for _ in range(2):
        assert source.read(0.01) is None
    assert source.health.faults["left_out"].startswith(f"{path.name} is left out")
    assert why in source.health.faults["left_out"] and source.health.counters["left_out"] == 1


def test_frames_that_come_late_are_told(tmp_path: Path) -> None:
    """A program behind, or the clock of another computer."""
    source = FolderSource(FolderSettings(path=str(tmp_path)))
    source.connect()
    path = FrameFolderWriter(tmp_path).write(time.time_ns(), picture())
    source.clock = HostClock(
        lambda: time.time_ns() + 4 * 10**9, lambda: time.monotonic_ns() + 4 * 10**9
    )
    assert path is not None and source.read(0.1) is not None
    assert source.health.faults["late"].startswith("frames come 4.0 s after their stamp")


@pytest.mark.parametrize("step", [0.3, -0.3, 3600.0, -3600.0])
@pytest.mark.parametrize("follows", [True, False])
def test_frames_follow_the_clock_of_the_node_over_a_step(
    tmp_path: Path, step: float, follows: bool
) -> None:
    """Of the system clock, which the writer's stamps follow or not; all frames stay in the
    folder."""
    stepped = 0.0

    def wall() -> int:
        return time.time_ns() + round(stepped * 1e9)

    writer = FrameFolderWriter(tmp_path, keep=50)
    source = FolderSource(FolderSettings(path=str(tmp_path)))
    source.clock = HostClock(wall)
    source.connect()
    for number in range(20):
        if number == 10:
            stepped = step
        taken = source.clock.now()
        writer.write(wall() if follows else taken, picture(number))
        frame = source.read(1.0)
        assert frame is not None and frame.sequence == number
        assert abs(frame.stamp_ns - taken) < 20e6
        assert source.read(0.0) is None
    assert not source.health.faults and not source.health.counters["lost"]


def test_missing_frames_are_counted_and_a_missing_folder_is_reported(tmp_path: Path) -> None:
    writer = FrameFolderWriter(tmp_path)
    source = FolderSource(FolderSettings(path=str(tmp_path)))
    source.connect()
    writer.write(time.time_ns(), picture())
    assert source.read(1.0) is not None
    writer.faults.set("lost", 2)
    for _ in range(3):
        writer.write(time.time_ns(), picture())
    assert source.read(1.0) is not None
    assert source.health.counters["lost"] == 2
    with pytest.raises(DeviceError, match="no such folder"):
        FolderSource(FolderSettings(path=str(tmp_path / "none"))).connect()


def test_an_image_sequence_is_played_at_the_rate_asked_for_and_again(tmp_path: Path) -> None:
    for index in range(3):
        cv2.imwrite(str(tmp_path / f"f_{index:03d}.png"), picture(index))
    source = camera.open_source(
        {"device": "opencv", "path": str(tmp_path / "f_%03d.png"), "rate": 20.0}
    )
    source.connect()
    frames = []
    while len(frames) < 5:
        frame = source.read(0.5)
        if frame is not None:
            frames.append(frame)
    source.close()
    for frame, seed in zip(frames, (0, 1, 2, 0, 1)):
        np.testing.assert_array_equal(frame.image, picture(seed))
    intervals = np.diff([f.stamp_ns for f in frames]) * 1e-9
    # Never faster; slower where this machine is busy.
    assert 0.04 < np.median(intervals) < 0.3


def test_a_fixed_name_by_udev_is_the_camera_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[int] = []

    class Capture:
        def __init__(self, number: int, backend: int) -> None:
            opened.append(number)

        def isOpened(self) -> bool:
            return True

    monkeypatch.setattr(opencv.cv2, "VideoCapture", Capture)
    links = {"/dev/finger-camera": "/dev/video4"}
    monkeypatch.setattr(opencv.os.path, "realpath", lambda path: links.get(path, path))
    for path in ("/dev/finger-camera", "/dev/video2", "3"):
        assert opencv.capture_of(path)[1]
    assert opened == [4, 2, 3]


class FakeCapture:
    """A live camera: a new frame every 20 ms, queued as a driver does, until it is unplugged."""

    def __init__(self) -> None:
        self.unplugged = False
        self.released = False
        self._number = 0

    def grab(self) -> bool:
        time.sleep(0.02)
        self._number += 1
        return not self.unplugged

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.full((4, 4, 3), self._number % 256, dtype=np.uint8)

    def get(self, key: int) -> float:
        return 30.0 if key == cv2.CAP_PROP_FPS else -1.0

    def set(self, key: int, value: float) -> bool:
        return True

    def release(self) -> None:
        self.released = True


class Exposed(FakeCapture):
    """A camera on V4L2 that chooses its exposure (ms × 10) itself until it is told not to."""

    def __init__(self) -> None:
        super().__init__()
        self.values = {
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
            cv2.CAP_PROP_EXPOSURE: 157.0,
            cv2.CAP_PROP_FPS: 50.0,
        }

    def get(self, key: int) -> float:
        return self.values.get(key, -1.0)

    def set(self, key: int, value: float) -> bool:
        self.values[key] = value
        return True


@pytest.mark.parametrize(("exposure", "first"), [(0.0, "157"), (0.02, "200")])
def test_an_exposure_that_may_change_or_has_changed_is_told(
    exposure: float, first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opencv, "_WATCHED", 0.02)
    monkeypatch.setattr(diagnostics, "HOLD", 0.05)
    capture = Exposed()
    settings = OpenCvSettings(path="0", rate=50.0, exposure=exposure)
    source = OpenCvSource(settings, opener=lambda path: (capture, True))
    auto = "on" if exposure == 0.0 else "off"

    def read_until(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 20
        while not condition():
            assert time.monotonic() < end, source.health.faults
            source.read(0.1)

    try:
        source.connect()
        health = source.health
        assert health.notes["camera_auto_exposure"] == auto
        assert health.notes["camera_exposure"] == first
        assert ("auto_exposure" in health.faults) is (auto == "on")
        assert "exposure_changed" not in health.faults
        capture.values[cv2.CAP_PROP_EXPOSURE] = 2000.0
        read_until(lambda: "exposure_changed" in health.faults)
        assert f"exposure is 2000, it was {first}" in health.faults["exposure_changed"]
        capture.values[cv2.CAP_PROP_EXPOSURE] = float(first)
        read_until(lambda: "exposure_changed" not in health.faults)
        capture.values[cv2.CAP_PROP_AUTO_EXPOSURE] = 3.0  # by another program
        read_until(lambda: "auto exposure is on" in health.faults.get("auto_exposure", ""))
    finally:
        source.close()


def test_a_slow_reader_gets_the_newest_frame_and_unplugging_is_reported() -> None:
    capture = FakeCapture()
    source = OpenCvSource(OpenCvSettings(path="0", rate=50.0), opener=lambda path: (capture, True))
    source.connect()
    assert "setting_rate" in source.health.faults, "the camera makes 30 Hz of 50 Hz and must say so"
    time.sleep(0.5)
    start = time.time_ns()
    first = source.read(1.0)
    assert first is not None and start - first.stamp_ns < 0.4e9, "an old frame was given out"
    time.sleep(0.3)
    second = source.read(1.0)
    assert second is not None and second.sequence - first.sequence > 5
    assert source.health.counters["skipped"] >= 5
    capture.unplugged = True
    with pytest.raises(DeviceError, match="no frames any more"):
        for _ in range(20):
            source.read(0.3)
    source.close()
    assert capture.released


@pytest.mark.parametrize(
    ("path", "kind", "message"),
    [
        ("", InputError, "path"),
        ("/none.avi", DeviceError, "no such file"),
        ("97", DeviceError, "does not open"),
    ],
)
def test_a_missing_camera_is_reported(path: str, kind: type, message: str) -> None:
    with pytest.raises(kind, match=message):
        camera.open_source({"device": "opencv", "path": path}).connect()


@pytest.mark.parametrize(
    ("image", "grey"),
    [
        (np.full((2, 3, 3), [77, 9, 0], np.uint8), 77),
        (np.full((2, 3), 0x4D12, np.uint16), 0x4D),
        (np.full((2, 3), 0x0412, np.uint16), None),
    ],
    ids=["blue light", "16 bits", "12 bits in the lower ones"],
)
def test_pictures_become_grey_or_are_named(image: np.ndarray, grey: int | None) -> None:
    capture = FakeCapture()
    capture.retrieve = lambda: (True, image)  # type: ignore[method-assign]
    source = OpenCvSource(OpenCvSettings(path="0"), opener=lambda path: (capture, True))
    source.connect()
    frame = source.read(1.0)
    source.close()
    if grey is None:
        assert frame is None and "10- or 12-bit" in source.health.faults["malformed"]
    else:
        assert frame is not None and frame.image.tolist() == [[grey] * 3] * 2


def test_a_size_counts_once_both_sides_are_set() -> None:
    """V4L2 changes the size when its second side is set."""

    class Sized(FakeCapture):
        size: ClassVar[dict[int, float]] = {}

        def get(self, key: int) -> float:
            sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
            whole = all(side in self.size for side in sides)
            return self.size[key] if whole and key in sides else super().get(key)

        def set(self, key: int, value: float) -> bool:
            self.size[key] = value
            return True

    settings = OpenCvSettings(path="0", rate=30.0, width=1280, height=1024)
    source = OpenCvSource(settings, opener=lambda path: (Sized(), True))
    source.connect()
    source.close()
    assert not source.health.faults and source.health.notes["camera_width"] == "1280"


def test_a_folder_of_deep_images_is_scaled_or_refused(tmp_path: Path) -> None:
    source = FolderSource(FolderSettings(path=str(tmp_path)))
    source.connect()
    deep = picture().astype(np.uint16)
    stamp = time.time_ns()
    pgm = tmp_path / f"{stamp}_0.pgm"
    pgm.write_bytes(b"P5\n%d %d\n4095\n" % deep.shape[::-1] + (deep * 16).astype(">u2").tobytes())
    cv2.imwrite(str(tmp_path / f"{stamp + 1}_1.png"), deep * 256)
    for frame in (source.read(1.0), source.read(1.0)):
        assert frame is not None
        np.testing.assert_array_equal(frame.image, picture())
    fresh = FolderSource(FolderSettings(path=str(tmp_path)))
    fresh.connect()
    cv2.imwrite(str(tmp_path / f"{time.time_ns()}_2.png"), deep * 16 + 1)
    assert fresh.read(0.2) is None and "10- or 12-bit" in fresh.health.faults["malformed"]


class FakeUeye:
    """The part of pyueye.ueye that the driver uses, with the types of ctypes; records its calls."""

    HIDS = c_uint = ctypes.c_uint
    int = ctypes.c_int
    double = ctypes.c_double
    c_mem_p = ctypes.c_void_p
    IS_SET_DM_DIB, IS_CM_MONO8, IS_AOI_IMAGE_SET_AOI, IS_DONT_WAIT = 1, 6, 1, 0
    IS_STARTER_FW_UPLOAD_NEEDED, IS_ALLOW_STARTER_FW_UPLOAD = 18, 0x10000
    IS_PIXELCLOCK_CMD_SET, IS_EXPOSURE_CMD_SET_EXPOSURE, IS_FORCE_VIDEO_STOP = 6, 12, 0x4000
    sizeof = staticmethod(ctypes.sizeof)

    class IS_RECT(ctypes.Structure):
        _fields_ = [(n, ctypes.c_int) for n in ("s32X", "s32Y", "s32Width", "s32Height")]

    class UEYEIMAGEINFO(ctypes.Structure):
        _fields_ = [
            ("u64TimestampDevice", ctypes.c_longlong),
            ("u64FrameNumber", ctypes.c_longlong),
        ]

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.result: dict[str, Any] = {}
        self.number = 0
        self.starter_firmware_missing = False
        self.started = time.time()
        self.now: Callable[[], float] = time.time

    def SENSORINFO(self) -> Any:
        return SimpleNamespace(nMaxWidth=6, nMaxHeight=4, strSensorName=b"DCC3240M\0\0")

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("is_"):
            raise AttributeError(name)

        def call(*arguments: Any) -> Any:
            self.calls.append(name)
            if name == "is_InitCamera" and self.starter_firmware_missing:
                allowed = arguments[0].value & self.IS_ALLOW_STARTER_FW_UPLOAD
                self.starter_firmware_missing = not allowed
                return 0 if allowed else self.IS_STARTER_FW_UPLOAD_NEEDED
            if name == "is_SetFrameRate":
                arguments[2].value = arguments[1].value
            if name == "is_InquireImageMem":
                arguments[6].value = 8
            if name == "is_WaitForNextImage" and not self.result.get(name):
                time.sleep(0.005)
                self.number += 1
            if name == "is_GetImageInfo":
                arguments[2].u64TimestampDevice = round((self.now() - self.started) * 1e7)
                arguments[2].u64FrameNumber = self.number
            return self.result.get(name, 0)

        return call

    def get_data(self, memory: Any, x: int, y: int, bits: int, pitch: int, copy: bool) -> Any:
        return (np.arange(y)[:, None] * 10 + np.arange(pitch)[None, :]).astype(np.uint8).ravel()


def test_ueye_calls_come_in_the_makers_order_and_the_pitch_is_cut_off() -> None:
    sdk = FakeUeye()
    source = UeyeSource(UeyeSettings(rate=10.0, exposure=0.01, pixel_clock=30), sdk=sdk)
    source.connect()
    order = [sdk.calls.index(f"is_{n}") for n in (
        "InitCamera", "SetDisplayMode", "SetColorMode", "AOI", "AllocImageMem", "AddToSequence",
        "InitImageQueue", "PixelClock", "SetFrameRate", "Exposure", "CaptureVideo")]  # fmt: skip
    assert order == sorted(order)
    frame = source.read(1.0)
    assert frame is not None and frame.image.tolist() == [
        [10 * r + c for c in range(6)] for r in range(4)
    ]
    assert abs(frame.stamp_ns - time.time_ns()) < 0.5e9
    sdk.number += 3
    assert source.read(1.0) is not None
    assert source.health.counters["lost"] == 3
    assert sdk.calls.count("is_UnlockSeqBuf") == 2
    sdk.result["is_WaitForNextImage"] = 178
    assert source.read(0.1) is None and "transfer" in source.health.faults
    source.close()
    assert sdk.calls[-1] == "is_ExitCamera"
    assert sdk.calls.count("is_FreeImageMem") == sdk.calls.count("is_AllocImageMem")


def test_ueye_frames_that_waited_before_reading_began_tell_nothing() -> None:
    """Stamps of those that waited in the queue since connecting would bend the clock's line."""
    source = UeyeSource(UeyeSettings(rate=10.0), sdk=FakeUeye())
    source.connect()
    for _ in range(20):
        assert source.read(0.1) is not None
    source._sdk.number += 500
    source.flush()
    frame = source.read(0.1)
    assert frame is not None and source.health.counters["lost"] == 0
    assert source._mapper._minima.maxlen and not source._mapper._minima


def test_ueye_frames_that_are_handed_out_twice_are_one_frame_with_the_stamp_of_the_first() -> None:
    sdk = FakeUeye()
    source = UeyeSource(UeyeSettings(rate=10.0), sdk=sdk)
    source.connect()
    sdk.started, host, taken = 0.0, 0.0, 0.0
    source.clock.now = lambda: round((1e9 + host) * 1e9)  # type: ignore[method-assign]
    sdk.now = lambda: 100.0 + taken
    errors = []
    for number in range(60):
        taken = 0.1 * number
        # Every seventh receipt is 80 ms late; the mapping takes that out of the stamp.
        host = taken + (0.1 if number % 7 == 3 else 0.02)
        sdk.number = number
        frame = source.read(0.1)
        assert frame is not None
        errors.append(frame.stamp_ns * 1e-9 - 1e9 - taken - 0.02)
        host, sdk.number = host + 0.04, number
        assert source.read(0.1) is None
    assert max(map(abs, errors)) < 1e-3
    assert source.health.counters["repeated"] == 60 and "repeated" in source.health.faults
    assert not source.health.counters["lost"]


def test_ueye_that_hands_out_the_same_frame_for_ever_is_lost() -> None:
    sdk = FakeUeye()
    source = UeyeSource(UeyeSettings(rate=10.0), sdk=sdk)
    source.connect()
    sdk.now = lambda: 100.0
    assert source.read(0.1) is not None
    begin, reads, number = time.monotonic(), 0, sdk.number - 1
    with pytest.raises(DeviceError, match=r"no frame for 2\.0 s; check USB"):
        while time.monotonic() < begin + 4.0:
            sdk.number = number
            assert source.read(0.1) is None
            reads += 1
    assert 10 < reads < 500, "it waits between them"


@pytest.mark.parametrize("rate", [1.0, 0.99])
def test_ueye_whose_clock_has_another_rate_is_told(rate: float) -> None:
    sdk = FakeUeye()
    source = UeyeSource(UeyeSettings(rate=10.0), sdk=sdk)
    source.connect()
    sdk.started, seconds = 0.0, 0.0
    source.clock.now = lambda: round((1e9 + seconds) * 1e9)  # type: ignore[method-assign]
    sdk.now = lambda: 100.0 + seconds * rate
    for _ in range(100):
        seconds += 0.1
        frame = source.read(0.1)
        assert frame is not None
    assert abs(frame.stamp_ns * 1e-9 - 1e9 - seconds) < 1e-3
    assert list(source.health.faults) == ([] if rate == 1.0 else ["clock"])


def test_ueye_that_needs_its_starter_firmware_gets_it() -> None:
    sdk, said = FakeUeye(), []
    sdk.starter_firmware_missing = True
    source = UeyeSource(UeyeSettings(camera_id=2), sdk=sdk)
    source.log = lambda level, text: said.append(text)
    source.connect()
    source.close()
    assert sdk.calls.count("is_InitCamera") == 2 and not sdk.starter_firmware_missing
    assert len(said) == 1 and "about 25 s" in said[0]


def test_ueye_open_elsewhere_or_without_its_library_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sdk = FakeUeye()
    sdk.result["is_InitCamera"] = 3
    with pytest.raises(DeviceError, match="another program"):
        UeyeSource(UeyeSettings(), sdk=sdk).connect()
    monkeypatch.setitem(__import__("sys").modules, "pyueye.ueye", None)
    with pytest.raises(InputError, match="pip install pyueye"):
        camera.open_source({"device": "ueye"}).connect()


class Holding(FakeUeye):
    """A camera that can be opened only when nobody holds it, by the handles 7, 8, …; `stuck` is
    what closing it gives where it fails."""

    def __init__(self) -> None:
        super().__init__()
        self.stuck, self.held, self.next = 0, 0, 7

    def is_InitCamera(self, camera: Any, window: Any) -> Any:
        if self.held:
            return 3
        camera.value = self.held = self.next
        self.next += 1
        return 0

    def is_ExitCamera(self, camera: Any) -> Any:
        if self.stuck:
            return self.stuck
        if camera.value != self.held:
            return 1
        self.held = 0
        return 0


def test_ueye_that_could_not_be_closed_is_closed_before_it_is_opened_again() -> None:
    sdk = Holding()
    source = UeyeSource(UeyeSettings(rate=10.0), sdk=sdk)
    source.connect()
    sdk.stuck = -1
    source.close()
    for _ in range(3):
        with pytest.raises(DeviceError, match=r"this node still holds it.* restart the node$"):
            source.connect()
    sdk.stuck = 0
    source.connect()
    assert source.read(1.0) is not None and sdk.held == 8
    # Plugged out: the library knows the handle no more. Another program may have it then.
    sdk.held = 99
    source.close()
    with pytest.raises(DeviceError, match="another program"):
        source.connect()
    sdk.held = 0
    source.connect()
    # Closing it again releases it, too, when the node ends.
    sdk.stuck = -1
    source.close()
    sdk.stuck = 0
    source.close()
    assert not sdk.held
    # A camera that can be opened all the same is held no more.
    source.connect()
    sdk.stuck, before = -1, sdk.held
    source.close()
    sdk.held = 0
    source.connect()
    assert sdk.held == before + 1 and source.read(1.0) is not None
    sdk.stuck = 0
    source.close()
    assert not sdk.held


def test_frozen_is_distinguished_from_dark() -> None:
    detector = FreezeDetector(3)
    assert [detector.add(picture()) for _ in range(4)] == [False, False, True, True]
    assert not detector.add(picture(1))
    detector = FreezeDetector(3)
    assert not any(detector.add(np.zeros((4, 4), np.uint8)) for _ in range(10))


@pytest.mark.parametrize("ring", [2, 4, 8])
def test_a_ring_of_buffers_that_comes_again_is_frozen(ring: int) -> None:
    detector = FreezeDetector(10)
    frozen = [detector.add(picture(k % ring)) for k in range(40)]
    assert not any(frozen[: ring + 8]) and all(frozen[ring + 8 :])
    # An image without noise of something that moves there and back is not.
    there = [*range(20), 19, 19]
    assert not any(detector.add(picture(100 + k)) for k in there + there[::-1])


def test_a_covered_lens_with_pixels_that_flicker_is_not_frozen():
    detector, random = FreezeDetector(10), np.random.default_rng(0)
    dark = np.zeros((4, 300, 8, 8), dtype=np.uint8).reshape(-1, 8, 8)[:300]
    dark[:, 0, :2] = random.integers(0, 2, (300, 2))
    frozen = [detector.add(image) for image in dark]
    assert np.mean(frozen) < 0.02


def test_calibration_comes_back_as_saved_and_a_wrong_one_is_refused(tmp_path: Path) -> None:
    calibration = CameraCalibration(
        1280, 1024, "ftir", d=[0.1, -0.2, 0, 0, 0], k=[1000.0, 0, 640, 0, 1000, 512, 0, 0, 1],
        r=[1.0, 0, 0, 0, 1, 0, 0, 0, 1], p=[1000.0, 0, 640, 0, 0, 1000, 512, 0, 0, 0, 1, 0],
    )  # fmt: skip
    path = tmp_path / "ftir.yaml"
    calibration.save(path)
    assert CameraCalibration.load(path) == calibration and calibration.calibrated
    path.write_text(path.read_text().replace("camera_matrix", "matrix"))
    with pytest.raises(InputError, match="camera_matrix"):
        CameraCalibration.load(path)


def lens(**changes: Any) -> CameraCalibration:
    """A calibration that can be used, but for the changes."""
    values: dict[str, Any] = {
        "width": 1280, "height": 1024, "name": "ftir", "d": [0.1, -0.2, 0.0, 0.0, 0.0],
        "k": [1000.0, 0.0, 640.0, 0.0, 1000.0, 512.0, 0.0, 0.0, 1.0],
    }  # fmt: skip
    return CameraCalibration(**values | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0}, "image size 0×1024 is not above zero"),
        ({"height": -1}, "image size 1280×-1 is not above zero"),
        ({"k": [-1.0, 0, 0, 0, 1.0, 0, 0, 0, 1]}, r"focal lengths -1 and 1 \(K\)"),
        ({"k": [1.0, 0, 0, 0, 0.0, 0, 0, 0, 1]}, r"focal lengths 1 and 0 \(K\)"),
        ({"k": [1.0, 0, np.inf, 0, 1.0, 0, 0, 0, 1]}, "not a finite number"),
        ({"k": [np.nan, 0, 0, 0, 1.0, 0, 0, 0, 1]}, "not a finite number"),
        ({"d": [np.nan] * 5}, "not a finite number"),
        ({"p": [np.inf] * 12}, "not a finite number"),
        ({"distortion_model": "fisheye"}, "'fisheye' is not known, plumb_bob, "),
        ({"d": [0.1, 0.2, 0.0, 0.0]}, "plumb_bob has 5 coefficients, not 4"),
        ({"distortion_model": "equidistant"}, "equidistant has 4 coefficients, not 5"),
    ],
)
def test_a_calibration_that_no_camera_can_have_is_refused_also_in_a_file(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    calibration, path = lens(**changes), tmp_path / "ftir.yaml"
    with pytest.raises(InputError, match=f"^request: .*{message}.*; calibrate the camera again$"):
        calibration.check("request")
    calibration.save(path)
    with pytest.raises(InputError, match=f"{message}.*; calibrate the camera again$") as caught:
        CameraCalibration.load(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_every_distortion_model_of_ros_and_none_are_taken(tmp_path: Path) -> None:
    for model, number in (("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)):
        for coefficients in ([0.01] * number, []):
            calibration = lens(distortion_model=model, d=coefficients)
            calibration.save(tmp_path / "a.yaml")
            assert CameraCalibration.load(tmp_path / "a.yaml") == calibration


@pytest.mark.parametrize("key", ["plate_homography", "area_per_pixel"])
def test_a_lens_is_not_written_over_a_plate_calibration(tmp_path: Path, key: str) -> None:
    path = tmp_path / "plate.yaml"
    lens().save(path)
    path.write_text(path.read_text() + f"{key}: 1.0e-9\n")
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"is a plate calibration.*; let camera_info_url "):
        lens(d=[]).save(path)
    assert path.read_bytes() == before


def test_urls_of_calibrations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    assert resolve_url("", "a") == tmp_path / "camera_info" / "a.yaml"
    assert resolve_url("file:///x/${NAME}.yaml", "a") == Path("/x/a.yaml")
    spaced = tmp_path / "rig här" / "a.yaml"
    assert resolve_url(spaced.as_uri(), "a") == spaced
    for bad in (
        "/x/a.yaml",
        "http://x/a.yaml",
        "package://no_such_package_/a.yaml",
        "file:///${NO}",
    ):
        with pytest.raises(InputError, match="camera_info_url"):
            resolve_url(bad, "a")


# Moisture ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "value", "phase"),
    [("42.5", 42.5, ""), ("42,5", 42.5, ""), ("M=17.0;after", 17.0, "after"), (" M 8 ", 8.0, "")],
)
def test_lines_that_are_readings(line: str, value: float, phase: str) -> None:
    parsed = lines.parse_line(line, lines.compile_pattern(lines.DEFAULT_PATTERN))
    assert parsed is not None and (parsed.value, parsed.phase) == (value, phase)


@pytest.mark.parametrize("line", ["", "ERR 5", "42.5 a.u.", "4 2", "nan", "1e3", "M=;before"])
def test_lines_that_are_none(line: str) -> None:
    assert lines.parse_line(line, lines.compile_pattern(lines.DEFAULT_PATTERN)) is None


def test_a_pattern_without_a_value_is_refused() -> None:
    for pattern, message in ((r"\d+", "named value"), (r"(", "regular expression")):
        with pytest.raises(InputError, match=message):
            lines.compile_pattern(pattern)


def test_serial_readings_arrive_with_phase_and_time_of_arrival() -> None:
    with SerialMoistureSimulator() as simulator:
        source = moisture.open_source({"device": "serial", "path": simulator.port})
        simulator.send(99.0)
        time.sleep(0.1)
        source.connect()
        assert source.read(0.2) is None, "a reading from before the connection was taken as new"
        sent = []
        for value, phase in ((41.0, "before"), (42.5, "after"), (131.0, "")):
            threading.Timer(0.05, simulator.send, (value, phase)).start()
            before = time.time_ns()
            reading = source.read(2.0)
            assert reading is not None and before < reading.stamp_ns < time.time_ns()
            sent.append((reading.value, reading.phase, reading.flags))
        source.close()
    assert sent == [(41.0, 1, 0), (42.5, 2, 0), (131.0, 0, 1)]


def test_the_rest_of_a_line_is_no_reading() -> None:
    """The port is opened in the middle of a line, or this process stands still within one."""
    with SerialMoistureSimulator() as simulator:
        source = moisture.open_source({"device": "serial", "path": simulator.port})

        def write(data: bytes) -> None:
            simulator._write(data)
            end = time.monotonic() + 10
            while not source._waiting():
                assert time.monotonic() < end

        simulator._write(b"M=4")
        source.connect()
        write(b"2.0;before\r\n")
        assert source.read(0.2) is None and source.health.counters["partial"] == 1
        write(b"M=4")
        assert source.read(0.1) is None
        write(b"7.5\r\n")
        source._last_byte -= 0.7
        reading = source.read(2.0)
        source.close()
    assert reading is not None and reading.value == 47.5


@pytest.fixture
def adapter() -> Iterator[tuple[SerialSource, Callable[..., Reading | None]]]:
    """A serial source after a silence since connecting, and a function that sends it bytes, `later`
    s after those before, and reads."""
    with SerialMoistureSimulator() as simulator:
        source = SerialSource(SerialSettings(path=simulator.port))
        source.connect()
        source._last_byte -= 1.0
        assert source.read(0.01) is None

        def send(data: bytes, later: float = 0.0) -> Reading | None:
            source._last_byte -= later
            source._line_began -= later
            if later:
                assert source.read(0.01) is None
            simulator._write(data)
            end = time.monotonic() + 10
            while not source._waiting():
                assert time.monotonic() < end
            return source.read(0.05)

        yield source, send
        source.close()


def test_the_rest_of_a_line_that_broke_off_is_no_reading(adapter: Any) -> None:
    source, send = adapter
    assert send(b"4") is None
    assert send(b"2.0\r\n", later=0.7) is None, "2.0 is the end of 42.0"
    assert "broke off" in source.health.faults["malformed"]
    assert send(b"43.0\r\n").value == 43.0
    # A line that shows its beginning is whole, also after half of another one.
    assert send(b"M=4") is None
    assert send(b"M=41.0;before\r\n", later=0.7).value == 41.0
    # In three pieces, and with nothing but its end missing.
    assert send(b"4") is None and send(b"4", later=0.7) is None
    assert send(b".0\n", later=0.7) is None and send(b"42.0") is None
    assert send(b"\n", later=0.7) is None and send(b"44.0\n").value == 44.0


@pytest.mark.parametrize("data", [b"42.0;", b"42.0\0", b"\x80\xe0\xf8\x1c"])
def test_bytes_without_an_end_of_line_are_told(adapter: Any, data: bytes) -> None:
    """Another end of line than CR or LF, or a wrong baud rate."""
    source, send = adapter
    for _ in range(2):
        assert send(data) is None and not source.health.faults
    source._line_began -= 5.0
    assert send(data) is None
    assert "without an end of line" in source.health.faults["malformed"]
    assert send(b"\n") is None and send(b"42.0\n", later=0.1).value == 42.0


def all_sent(source: SerialSource, send: Callable[..., Reading | None], data: bytes) -> list[float]:
    """Values of the readings in bytes that come at once."""
    found, reading = [], send(data)
    while reading is not None:
        found.append(reading.value)
        reading = source.read(0.01)
    return found


@pytest.mark.parametrize(
    ("data", "values"),
    [
        # A wrong baud rate, or a loose contact.
        (b"\x00\x1e3\xfe7\r3\r\x80\x00\r9\r7\n", []),
        (b"\x00\x1e\x06\r3\r", []),
        (b"1" * 300 + b"\r\n3\r\n", []),
        # A letter before the number shows that the line is one.
        (b"\xfe7\r\nM=41.0;before\r\n43.0\r\n", [41.0, 43.0]),
        # One byte was disturbed in a stream without silences.
        (b"41\r\n4\xb2\r\n43\r\n44\r\n45\r\n46\r\n47\r\n", [41.0, 46.0, 47.0]),
        # Text that is none of the probe's readings is no garbage.
        (b"adapter ready\ttime 0\r\n42.0\r\n", [42.0]),
    ],
)
def test_numbers_right_after_garbage_are_no_readings(
    adapter: Any, data: bytes, values: list[float]
) -> None:
    source, send = adapter
    assert all_sent(source, send, data) == values
    assert "malformed" in source.health.faults
    # A probe that sends one number now and then loses none.
    for value in (44.0, 45.0):
        assert send(b"%.1f\r\n" % value, later=1.0).value == value


def test_numbers_that_are_left_out_after_garbage_are_told(adapter: Any) -> None:
    source, send = adapter
    assert all_sent(source, send, b"\x80\x00\r\n3\r\n") == []
    assert source.health.faults["malformed"] == (
        "numbers right after a line that is not text are left out; check cable, baud rate and what "
        "the probe sends"
    )


@pytest.mark.parametrize(
    "other",
    [
        "T 25.1 °C".encode("latin-1"),
        "T 25.1 °C".encode(),
        "5 °C".encode(),
        "Y 3 µS".encode(),
        b"\f",
        b"\x03",
        b"\x02time 0\x03",
    ],
)
def test_foreign_letters_and_control_characters_in_each_record_cost_no_reading(
    adapter: Any, other: bytes
) -> None:
    """A probe whose records hold a number and a line of another quantity, without silences."""
    source, send = adapter
    values = [41.0, 42.0, 43.0, 44.0, 45.0, 46.0]
    records = b"".join(b"%s\r\n%.1f\r\n" % (other, value) for value in values)
    assert all_sent(source, send, records) == values


def test_exports_in_the_forms_that_spreadsheets_write() -> None:
    form = TableFormat(
        export_value_column="Wert",
        export_time_column="Zeit",
        export_phase_column="Phase",
        export_encoding="cp1252",
        export_time_format="%d.%m.%Y %H:%M",
    )
    text = "Gerät;;\nZeit;Wert;Phase\n02.01.2026 10:30;1.042,5;vor\n02.01.2026 10:31;43;after\n;;\n"
    rows, malformed = parse_table(
        (text + "02.01.2026 10:32;abc;\n").encode("cp1252"), "e.csv", form
    )
    assert [r.value for r in rows] == [1042.5, 43.0] and malformed.rows == 1
    assert malformed.first.startswith("column 'Wert' has 'abc', which is not a number")
    assert rows[1].time_ns == rows[0].time_ns + 60_000_000_000
    with pytest.raises(DeviceError, match="export_encoding"):
        parse_table(text.encode("cp1252"), "e.csv", TableFormat(export_value_column="Wert"))
    with pytest.raises(DeviceError, match="no column 'value'"):
        parse_table(text.encode(), "e.csv", TableFormat())
    for name, data in (("e.xls", b"value\n42"), ("e.csv", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" * 9)):
        with pytest.raises(DeviceError, match="save it as XLSX or CSV"):
            parse_table(data, name, TableFormat())
    with pytest.raises(InputError, match="export_encoding"):
        TableFormat(export_encoding="latin-99")


def test_rows_of_a_rewritten_table_are_new_only_when_they_were_not_there() -> None:
    form = TableFormat(export_decimal_comma=False)

    def rows(*values: float) -> tuple:
        return parse_table(("value\n" + "\n".join(map(str, values))).encode(), "e.csv", form)[0]

    def new(old: tuple, now: tuple) -> tuple[list[float], bool]:
        fresh, in_doubt = new_rows(old, now)
        return [row.value for row in fresh], in_doubt

    assert new(rows(1, 2), rows(1, 2, 2)) == ([2], False)
    assert new(rows(1, 2), rows(2, 1, 3, 1)) == ([3, 1], False)
    assert new(rows(1, 2), rows(1)) == ([], False)
    # Written over by the table of the next readings.
    assert new(rows(42, 43, 41), rows(43, 44, 42)) == ([43, 44, 42], False)
    assert new(rows(42, 43, 41), rows(42, 44)) == ([44], True)
    assert new(rows(42, 43, 41), rows(50, 51, 52, 53)) == ([50, 51, 52, 53], False)
    timed = [Row(v, t) for t, v in enumerate((42, 43, 41, 43))]
    assert new_rows(timed[:3], timed[1:]) == ([timed[3]], False)


def test_a_time_of_another_format_is_named_with_its_column(tmp_path: Path) -> None:
    table = tmp_path / "e.csv"
    table.write_text("Datum;value\n27.11.2026 09:00:00;42,5\n27.11.2026 09:01:00;43,5\n")
    source = ExportSource(ExportSettings(path=str(table), export_time_column="Datum"))
    source.connect()
    assert source.health.faults["malformed"] == (
        "e.csv: 2 of 2 rows cannot be read; in the first of them column 'Datum' has '27.11.2026 "
        "09:00:00', which is not a time of the form '%Y-%m-%d %H:%M:%S'; set export_time_format"
    )


def test_rows_of_an_export_that_could_not_be_read_at_first_are_not_new(tmp_path: Path) -> None:
    """A program has the file open, or is just writing it."""
    path = tmp_path / "e.csv"
    options = {"device": "export", "path": str(path), "export_period": 0.05}
    path.write_bytes(b"\xff\xfe\x00broken")
    source = moisture.open_source(options)
    source.connect()
    table = ExportFileSimulator(ExportOptions(path=str(path)))
    table.send(50.0)
    table.send(51.0)
    assert source.read(1.0) is None
    table.send(42.5)
    reading = source.read(5.0)
    assert reading is not None and reading.value == 42.5


@pytest.mark.parametrize("name", ["e.csv", "e.xlsx"])
def test_export_readings_carry_their_own_time(tmp_path: Path, name: str) -> None:
    table = ExportFileSimulator(ExportOptions(path=str(tmp_path / name)))
    table.send(50.0)
    source = moisture.open_source(
        {
            "device": "export",
            "path": str(table.path),
            "export_time_column": "time",
            "export_phase_column": "phase",
            "export_period": 0.05,
        }
    )
    source.connect()
    assert source.read(0.3) is None, "a row from before the connection was taken as new"
    table.send(42.5, "after")
    sent = time.time_ns()
    reading = source.read(5.0)
    assert reading is not None
    assert (reading.value, reading.phase) == (42.5, 2)
    # The table has whole seconds.
    assert abs(reading.stamp_ns - sent) < 2e9 and reading.stamp_ns % 10**9 == 0


def test_a_table_is_read_when_nobody_writes_it_and_its_rows_come_in_order(tmp_path: Path) -> None:
    path = tmp_path / "e.csv"
    path.write_text("time;value\n")
    source = moisture.open_source(
        {"device": "export", "path": str(path), "export_time_column": "time", "export_period": 0.1}
    )
    source.connect()
    # The newest row is the first one, and half of the last one is there.
    path.write_text("time;value\n2026-05-04 10:00:09;51\n2026-05-04 10:00:03;4")
    assert source.read(0.0) is None
    with path.open("a") as file:
        file.write("2,5\n")
    readings = [source.read(5.0), source.read(5.0)]
    assert [r.value for r in readings if r is not None] == [42.5, 51.0]


@pytest.mark.parametrize("column", ["time", ""])
@pytest.mark.parametrize("step", [3600.4, -3600.4])
def test_export_readings_follow_the_clock_of_the_node_over_a_step(
    tmp_path: Path, step: float, column: str
) -> None:
    """Of the system clock, or a suspend, after the node was started."""
    table = ExportFileSimulator(ExportOptions(path=str(tmp_path / "e.csv")))
    options = {"device": "export", "path": str(table.path), "export_period": 0.02}
    source = moisture.open_source({**options, "export_time_column": column})
    source.connect()
    before = [round(step * 1e9)]
    source.clock = HostClock(wall=lambda: time.time_ns() - before[0])
    before[0] = 0
    table.send(42.5)
    reading = source.read(5.0)
    assert reading is not None
    assert abs(reading.stamp_ns - source.clock.now()) < 2e9
    # Whole seconds show that the table knows no more.
    assert (reading.stamp_ns % 10**9 == 0) == bool(column)
