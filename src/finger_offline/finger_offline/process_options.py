# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What `finger-bag process` runs and writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from finger_bag.read_settings import ReadSettings
from finger_common.settings import setting

from .image_settings import ImageSettings


@dataclass(frozen=True)
class ProcessOptions(ImageSettings, ReadSettings):
    """What to run and to write.

    estimator: settings of the estimator by name that replace those recorded. parameter_file,
    model_file, geometry_file: for the model, empty for those of the recording or else of the suite.
    tables: CSV and Parquet files of the estimates.
    """

    images: str = setting(
        "auto",
        "Measure areas in the images; auto: if contact_area is absent.",
        choices=("auto", "yes", "no"),
    )
    keep_images: bool = setting(False, "Copy images to the new bag.")
    slip: bool = setting(False, "Estimate stick, slip and friction: writes contact_slip.")
    shape: bool = setting(False, "Estimate ellipse and tilt of the contact: writes contact_shape.")
    estimator: Mapping[str, Any] = field(default_factory=dict)
    pose: Mapping[str, Any] = field(default_factory=dict)
    parameter_file: str = ""
    model_file: str = ""
    geometry_file: str = ""
    tables: tuple[str, ...] = ()

    def is_own(self) -> bool:
        """Whether an axis, files or settings are given, which replace those of recorded events."""
        files = (self.parameter_file, self.model_file, self.geometry_file)
        own = (self.estimator, *files, self.normal_axis)
        return any(own)
