"""Cameras.

`open_source(settings)` makes a driver from checked parameters (`SOURCE_TABLE`). Nothing is opened before its
`connect` is called.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from finger_common.diagnostics import Health
from finger_common.errors import InputError
from finger_common.parameters import Parameter, ParameterTable

from .source import CameraSource, Frame

__all__ = ["SOURCE_TABLE", "CameraSource", "Frame", "open_source"]

SOURCE_TABLE = ParameterTable(
    Parameter(
        "device",
        "opencv",
        "Kind of camera: folder of stamped frames, OpenCV VideoCapture, IDS/Thorlabs uEye.",
        choices=("folder", "opencv", "ueye"),
    ),
    Parameter(
        "path",
        "",
        "folder: the folder of frames. opencv: number of the camera, file, image sequence or pipeline.",
    ),
    Parameter(
        "rate",
        10.0,
        "Frames per second asked for and expected.",
        unit="Hz",
        minimum=0.1,
        maximum=1000.0,
    ),
    Parameter("width", 0, "Width asked for; 0 leaves it.", unit="px", minimum=0, maximum=20000),
    Parameter("height", 0, "Height asked for; 0 leaves it.", unit="px", minimum=0, maximum=20000),
    Parameter(
        "exposure",
        0.0,
        "Exposure time asked for; 0 leaves it.",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter("gain", -1.0, "opencv: gain in the driver's own units; -1 leaves it.", minimum=-1.0),
    Parameter(
        "camera_id", 0, "ueye: number of the camera; 0 for the first.", minimum=0, maximum=254
    ),
    Parameter(
        "pixel_clock",
        0,
        "ueye: pixel clock; 0 leaves it.",
        unit="MHz",
        minimum=0,
        maximum=500,
        advice="Lower it when frames are lost on USB.",
    ),
)
"""Parameters of all camera drivers."""


def open_source(settings: Mapping[str, Any]) -> CameraSource:
    """Driver for the settings (keys of SOURCE_TABLE; others are ignored).

    Raises InputError for a setting that cannot be used.
    """
    values = SOURCE_TABLE.check({k: v for k, v in settings.items() if k in SOURCE_TABLE})
    health = Health(
        "camera", expected_rate=values["rate"], stale_after=max(1.0, 5 / values["rate"])
    )
    if values["device"] == "folder":
        from .folder import FolderSource

        if not values["path"]:
            raise InputError("parameter 'path' is empty; name the folder of frames")
        return FolderSource(values["path"], health)
    if values["device"] == "opencv":
        from .opencv import OpenCvSource

        return OpenCvSource(
            values["path"],
            health,
            values["rate"],
            values["width"],
            values["height"],
            # V4L2 counts exposure in 100 µs.
            values["exposure"] * 1e4 if values["exposure"] else -1.0,
            values["gain"],
        )
    from .ueye import UeyeSource

    return UeyeSource(
        health,
        values["camera_id"],
        values["rate"],
        values["exposure"],
        values["pixel_clock"],
        values["width"],
        values["height"],
    )
