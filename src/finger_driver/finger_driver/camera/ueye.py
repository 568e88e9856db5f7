# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""IDS uEye cameras, also sold by Thorlabs as DCx, through IDS's `pyueye`.

`pyueye` and the uEye library are needed only when such a camera is opened. Order of calls and of
timing settings (pixel clock, frame rate, exposure: each changes the range of the next) after the
DCx manual. The camera's clock ticks every 0.1 µs; its PC time is local time and is not used.
"""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_common.diagnostics import WARN
from finger_common.errors import DeviceError, InputError
from finger_common.settings import setting

from ..clock import ClockMapper
from .source import CameraSettings, CameraSource, Frame

_TICKS = 1e7
_BUFFERS = 4
_ERRORS = {
    1: "invalid handle",
    3: "cannot be opened; another program may use it",
    122: "timed out",
    178: "transfer error",
}
_SUCCESS, _INVALID_HANDLE, _TIMED_OUT, _TRANSFER_ERROR = 0, 1, 122, 178
_PAUSE = 0.005
"""s after a frame that was handed out again: the next one may be so at once."""
_UPLOAD_TIME = 25
"""s for which a camera takes in its starter firmware, which it may need after an update of the
driver (DCx manual)."""


def load_sdk() -> Any:
    """Module pyueye.ueye; raises InputError saying what to install."""
    try:
        return importlib.import_module("pyueye.ueye")
    except (ImportError, OSError) as error:
        raise InputError(
            f"uEye cameras need the IDS driver and `pip install pyueye` ({error}); PYUEYE_DLL_PATH "
            "names the folder of libueye_api.so"
        ) from None


@dataclass(frozen=True)
class UeyeSettings(CameraSettings):
    """Settings of a uEye camera."""

    camera_id: int = setting(
        0, "ueye: number of the camera; 0 for the first.", minimum=0, maximum=254
    )
    pixel_clock: int = setting(
        0,
        "ueye: pixel clock; 0 leaves it as it is.",
        unit="MHz",
        minimum=0,
        maximum=500,
        advice="Lower it when frames are lost on USB.",
    )

    def address(self) -> str:
        return f"camera_id {self.camera_id}"


class UeyeSource(CameraSource):
    """IDS or Thorlabs uEye camera."""

    SETTINGS = UeyeSettings

    settings: UeyeSettings

    def __init__(self, settings: UeyeSettings, sdk: Any = None) -> None:
        super().__init__(settings)
        self._id = settings.camera_id
        self._sdk = sdk
        self._camera: Any = None
        self._unclosed: Any = None
        """Handle of a camera that could not be closed, and is closed before it is opened again."""
        self._memories: list[tuple[Any, Any]] = []
        self._mapper = ClockMapper(_TICKS)
        self._newest: tuple[int, int] | None = None
        """Number and device time of the last frame."""

    def _check(self, code: Any, what: str) -> None:
        code = int(code)
        if code != _SUCCESS:
            reason = _ERRORS.get(code, f"error {code}")
            raise DeviceError(f"uEye camera {self._id}: {what}: {reason}; check USB and power")

    def connect(self) -> None:
        self.close()
        u = self._sdk = self._sdk or load_sdk()
        self._camera = u.HIDS(self._id)
        try:
            code = int(u.is_InitCamera(self._camera, None))
            if code == u.IS_STARTER_FW_UPLOAD_NEEDED:
                self.log(
                    WARN,
                    f"uEye camera {self._id} takes in its starter firmware: about "
                    f"{_UPLOAD_TIME} s; do not unplug it",
                )
                self._camera = u.HIDS(self._id | u.IS_ALLOW_STARTER_FW_UPLOAD)
                code = int(u.is_InitCamera(self._camera, None))
            self._check(code, "opening")
        except DeviceError:
            self._camera = None
            if self._unclosed is not None:
                raise DeviceError(
                    f"uEye camera {self._id}: this node still holds it, as it could not be closed; "
                    "unplug it and plug it in again, or restart the node"
                ) from None
            raise
        self._unclosed = None
        self._set_up(u)

    def _set_up(self, u: Any) -> None:
        camera = self._camera
        self._check(u.is_SetDisplayMode(camera, u.IS_SET_DM_DIB), "display mode")
        info = u.SENSORINFO()
        self._check(u.is_GetSensorInfo(camera, info), "sensor information")
        self._check(u.is_SetColorMode(camera, u.IS_CM_MONO8), "mono 8 bit")
        width = self.settings.width or int(info.nMaxWidth)
        height = self.settings.height or int(info.nMaxHeight)
        area = u.IS_RECT()
        area.s32X, area.s32Y = u.int(0), u.int(0)
        area.s32Width, area.s32Height = u.int(width), u.int(height)
        self._check(
            u.is_AOI(camera, u.IS_AOI_IMAGE_SET_AOI, area, u.sizeof(area)), "area of interest"
        )
        for _ in range(_BUFFERS):
            memory, number = u.c_mem_p(), u.int()
            self._check(u.is_AllocImageMem(camera, width, height, 8, memory, number), "memory")
            self._memories.append((memory, number))
            self._check(u.is_AddToSequence(camera, memory, number), "memory")
        self._check(u.is_InitImageQueue(camera, 0), "queue")
        self._set_timing(u)
        self._check(u.is_CaptureVideo(camera, u.IS_DONT_WAIT), "start of capture")
        self._width, self._height = width, height
        self._pitch = self._inquire_pitch(u, width)
        self._mapper.restart()
        self._newest = None
        self._last_frame = time.monotonic()
        self._next_number = None
        name = bytes(info.strSensorName).split(b"\0")[0].decode("ascii", "replace")
        self.health.hardware_id = f"uEye {self._id} {name}".strip()

    def _set_timing(self, u: Any) -> None:
        camera, wanted = self._camera, self.settings
        if wanted.pixel_clock:
            clock = u.c_uint(wanted.pixel_clock)
            self._check(
                u.is_PixelClock(camera, u.IS_PIXELCLOCK_CMD_SET, clock, u.sizeof(clock)),
                "pixel clock",
            )
        rate = u.double()
        self._check(u.is_SetFrameRate(camera, u.double(wanted.rate), rate), "frame rate")
        self.health.notes["camera_rate"] = f"{float(rate.value):g}"
        self.note_if(
            abs(float(rate.value) - wanted.rate) > 0.01 * wanted.rate,
            "setting_rate",
            f"the camera runs at {float(rate.value):g} Hz, not {wanted.rate:g} Hz",
        )
        if wanted.exposure:
            exposure = u.double(wanted.exposure * 1e3)
            self._check(
                u.is_Exposure(camera, u.IS_EXPOSURE_CMD_SET_EXPOSURE, exposure, u.sizeof(exposure)),
                "exposure",
            )
            self.health.notes["camera_exposure_s"] = f"{float(exposure.value) * 1e-3:g}"

    def _inquire_pitch(self, u: Any, width: int) -> int:
        """Bytes per line in memory, which may be more than the width."""
        memory, number = self._memories[0]
        x, y, bits, pitch = u.int(), u.int(), u.int(), u.int()
        self._check(u.is_InquireImageMem(self._camera, memory, number, x, y, bits, pitch), "memory")
        return max(int(pitch.value), width)

    def flush(self) -> None:
        """Release what waits in the queue."""
        self._next_number = None
        for _ in range(_BUFFERS):
            if self._camera is not None:
                self.read(0.0)
        # They waited: their receipt tells nothing of the clock, and those between were not wanted.
        self._mapper.restart()
        self._next_number = None
        self._last_frame = time.monotonic()

    def read(self, timeout: float = 1.0) -> Frame | None:
        u = self._sdk
        if self._camera is None:
            raise DeviceError(f"uEye camera {self._id}: not connected")
        memory, number = u.c_mem_p(), u.int()
        code = int(u.is_WaitForNextImage(self._camera, round(timeout * 1e3), memory, number))
        received = self.clock.now()
        if code == _TRANSFER_ERROR:
            self.note(
                "transfer", "a frame was lost on USB; use another port or a lower pixel clock"
            )
            return None
        if code == _TIMED_OUT:
            self._check_silence()
            return None
        self._check(code, "waiting for a frame")
        try:
            info = u.UEYEIMAGEINFO()
            self._check(
                u.is_GetImageInfo(self._camera, number, info, u.sizeof(info)), "image information"
            )
            data = u.get_data(memory, self._width, self._height, 8, self._pitch, copy=True)
        finally:
            u.is_UnlockSeqBuf(self._camera, number, memory)
        image = np.asarray(data, dtype=np.uint8).reshape(self._height, self._pitch)
        sequence, ticks = int(info.u64FrameNumber), int(info.u64TimestampDevice)
        repeated, self._newest = self._newest == (sequence, ticks), (sequence, ticks)
        self.note_if(
            repeated, "repeated", "a frame was handed out again, and left out; update the driver"
        )
        if repeated:
            self._check_silence()
            time.sleep(_PAUSE)
            return None
        self._last_frame = time.monotonic()
        self.cleared("transfer")
        self.count_lost(sequence)
        stamp = self._mapper.update(ticks, received)
        self.health.notes.update(self._mapper.notes())
        self.note_if(
            self._mapper.another_rate,
            "clock",
            "the camera's clock does not run at the rate it states; stamps are times of receipt",
        )
        return Frame(stamp, np.ascontiguousarray(image[:, : self._width]), sequence)

    def _check_silence(self) -> None:
        silent = time.monotonic() - self._last_frame
        if silent > max(2.0, 5 / self.settings.rate):
            raise DeviceError(f"uEye camera {self._id}: no frame for {silent:.1f} s; check USB")

    def close(self) -> None:
        camera, self._camera = self._camera, None
        memories, self._memories = self._memories, []
        u = self._sdk
        if camera is not None:
            u.is_StopLiveVideo(camera, u.IS_FORCE_VIDEO_STOP)
            u.is_ExitImageQueue(camera)
            u.is_ClearSequence(camera)
            for memory, number in memories:
                u.is_FreeImageMem(camera, memory, number)
            self._unclosed = camera
        if self._unclosed is not None:
            # An invalid handle is closed already; its number may be that of another camera soon.
            if int(u.is_ExitCamera(self._unclosed)) in (_SUCCESS, _INVALID_HANDLE):
                self._unclosed = None
