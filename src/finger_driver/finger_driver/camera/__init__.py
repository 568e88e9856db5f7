"""Cameras: `open_source(settings)` makes the driver of an installed kind of camera."""

from __future__ import annotations

from ..sources import Sources
from .source import CameraSettings, CameraSource, Frame

__all__ = ["SOURCES", "CameraSettings", "CameraSource", "Frame", "open_source"]

SOURCES = Sources("finger_driver.camera", "camera", CameraSource, default="opencv")
open_source = SOURCES.open
