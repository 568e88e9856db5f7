# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Moisture readings: `open_source(settings)` makes the driver of an installed source."""

from __future__ import annotations

from finger_common.plugins import PluginKind

from .source import MoistureSettings, MoistureSource, Reading

__all__ = ["SOURCES", "MoistureSettings", "MoistureSource", "Reading", "open_source"]

SOURCES = PluginKind(
    "finger_driver.moisture", "moisture source", MoistureSource, "device", default="manual"
)
open_source = SOURCES.open
