"""Moisture readings: `open_source(settings)` makes the driver of an installed source."""

from __future__ import annotations

from ..sources import Sources
from .source import MoistureSettings, MoistureSource, Reading

__all__ = ["SOURCES", "MoistureSettings", "MoistureSource", "Reading", "open_source"]

SOURCES = Sources("finger_driver.moisture", "moisture source", MoistureSource, default="manual")
open_source = SOURCES.open
