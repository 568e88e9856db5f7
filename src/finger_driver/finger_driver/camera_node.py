# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node `camera`: publishes `image_raw` and `camera_info` of one shot with one stamp.

It offers `~/set_camera_info`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR
from finger_common.errors import FingerError, InputError
from finger_common.files import await_file
from finger_common.node import main_of
from finger_common.settings import setting
from finger_common.stamps import nanoseconds

from .camera import SOURCES, CameraSource, Frame
from .camera.freeze import FreezeDetector
from .camera.info import CameraCalibration, resolve_url
from .device_node import DeviceNode, DeviceNodeSettings
from .messages import calibration_of, fill_camera_info, fill_image


@dataclass(frozen=True)
class CameraNodeSettings(DeviceNodeSettings):
    """Parameters of the camera node for every camera."""

    frame_id: str = setting("camera_optical", "Optical frame of the camera.")
    camera_name: str = setting("camera", "Name of the camera in its calibration file.")
    camera_info_url: str = setting(
        "", "Calibration: file:///… or package://…; empty for ${ROS_HOME}/camera_info/${NAME}.yaml."
    )
    image_time_offset: float = setting(
        0.0,
        "Added to the driver's stamp to give mid-exposure, as calibrated at the rig.",
        unit="s",
        minimum=-10.0,
        maximum=10.0,
        runtime=True,
    )
    frozen_after: int = setting(
        10,
        "Equal images in a row after which the camera counts as frozen and they are left out; "
        "0 never.",
        minimum=0,
        maximum=100000,
    )


_IMAGE_DEPTH = 10
"""Frames kept for a slow reader; more would only make it slower."""


class CameraNode(DeviceNode):
    """Node around a CameraSource."""

    NAME = "camera"
    SETTINGS = (CameraNodeSettings,)
    PLUGINS = SOURCES

    device: CameraSource

    def create_interfaces(self) -> None:
        self._info_path = resolve_url(self.values["camera_info_url"], self.values["camera_name"])
        self._calibration = self._load_calibration()
        self._shape: tuple[int, ...] | None = None
        self._freeze = FreezeDetector(self.values["frozen_after"])
        qos = self.stream_qos(min(_IMAGE_DEPTH, self.values["qos_depth"]), publisher=True)
        self._image = self.create_stream_publisher(Image, "image_raw", qos)
        self._info = self.create_stream_publisher(CameraInfo, "camera_info", qos)
        self.create_service(SetCameraInfo, "~/set_camera_info", self._on_set_camera_info)

    def _load_calibration(self) -> CameraCalibration:
        name = self.values["camera_name"]
        if not self._info_path.exists() and not self.values["camera_info_url"]:
            self.get_logger().warning(
                f"{self._info_path}: no calibration there; camera_info is marked as not calibrated"
            )
            return CameraCalibration(name=name)
        # At a rig that starts, whoever writes the file may start at the same time.
        await_file(self._info_path, self.values["connect_timeout"])
        calibration = CameraCalibration.load(self._info_path)
        if calibration.name != name:
            self.get_logger().warning(
                f"{self._info_path} is for camera '{calibration.name}', this is '{name}'"
            )
        return calibration

    def on_sample(self, frame: Frame) -> None:
        health = self.device.health
        stamp = frame.stamp_ns + nanoseconds(self.values["image_time_offset"])
        if not self.accept_stamp(stamp):
            return
        self._shape = frame.image.shape
        if self._freeze.add(frame.image):
            self.device.note("frozen", "the camera repeats the same image; restart it", ERROR)
            return
        self.device.cleared("frozen")
        calibration, shape = self._calibration, frame.image.shape
        other = calibration.calibrated and (calibration.height, calibration.width) != shape
        self.device.note_if(
            other,
            "calibration_size",
            f"images are {shape[1]}×{shape[0]}, the calibration is for {calibration.width}×"
            f"{calibration.height}; camera_info is marked as not calibrated",
        )
        if other:
            calibration = CameraCalibration(name=calibration.name)
        health.sample()
        frame_id = self.frame
        self._info.publish(fill_camera_info(CameraInfo(), stamp, frame_id, calibration, shape))
        self._image.publish(fill_image(Image(), stamp, frame_id, frame.image))

    def _on_set_camera_info(self, request: Any, response: Any) -> Any:
        calibration = calibration_of(request.camera_info, self.values["camera_name"])
        size, shape = (calibration.height, calibration.width), self._shape
        try:
            calibration.check("camera_info")
            if shape not in (None, size):
                raise InputError(
                    f"camera_info: it is for {size[1]}×{size[0]}, images are "
                    f"{shape[1]}×{shape[0]}; calibrate the camera at that size"
                )
            calibration.save(self._info_path)
        except (FingerError, OSError) as error:
            response.success, response.status_message = False, one_line(error)
            return response
        self._calibration = calibration
        self.device.health.recovered("calibration_size")
        response.success = True
        response.status_message = f"written to {self._info_path}"
        return response


main = main_of(CameraNode)

if __name__ == "__main__":
    main()
