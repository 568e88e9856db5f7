# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force and torque sensors: `open_source(settings)` makes the driver of an installed sensor."""

from __future__ import annotations

from finger_common.plugins import PluginKind

from .source import CRITICAL, GOOD, SATURATED, ForceSettings, ForceSource, WrenchSample

__all__ = [
    "CRITICAL",
    "GOOD",
    "SATURATED",
    "SOURCES",
    "ForceSettings",
    "ForceSource",
    "WrenchSample",
    "open_source",
]

SOURCES = PluginKind(
    "finger_driver.force", "force sensor", ForceSource, "device", default="netcanoem"
)
open_source = SOURCES.open
