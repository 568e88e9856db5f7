# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Cameras: `open_source(settings)` makes the driver of an installed kind of camera."""

from __future__ import annotations

from finger_common.plugins import PluginKind

from .source import CameraSettings, CameraSource, Frame

__all__ = ["SOURCES", "CameraSettings", "CameraSource", "Frame", "open_source"]

SOURCES = PluginKind(
    "finger_driver.camera", "camera", CameraSource, choice="device", default="opencv"
)
open_source = SOURCES.open
