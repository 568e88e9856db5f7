# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Camera calibration files in the format of ROS camera_info_manager, and their URLs.

No message package is imported here.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import yaml

from finger_common.errors import InputError
from finger_common.files import atomic_write, exists, load_yaml

COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Coefficients of each distortion model of sensor_msgs; none are no distortion."""

_OF_THE_PLATE = ("plate_homography", "area_per_pixel")
"""Keys by which a file is a plate calibration, made for the lens that is in it."""


@dataclass
class CameraCalibration:
    """Intrinsic calibration.

    Matrices row by row as in sensor_msgs/CameraInfo, all zero when not calibrated.
    """

    width: int = 0
    height: int = 0
    name: str = "camera"
    distortion_model: str = "plumb_bob"
    d: list[float] = field(default_factory=list)
    k: list[float] = field(default_factory=lambda: [0.0] * 9)
    r: list[float] = field(default_factory=lambda: [0.0] * 9)
    p: list[float] = field(default_factory=lambda: [0.0] * 12)

    @property
    def calibrated(self) -> bool:
        """Whether there is a focal length: zero means uncalibrated (sensor_msgs/CameraInfo)."""
        return self.k[0] != 0.0

    def check(self, where: str) -> None:
        """Raise InputError, naming `where`, for a calibration that no camera can have."""
        numbers = self.k + self.d + self.r + self.p
        known = COEFFICIENTS.get(self.distortion_model)
        if min(self.width, self.height) <= 0:
            wrong = f"image size {self.width}×{self.height} is not above zero"
        elif not all(map(math.isfinite, numbers)):
            wrong = "a matrix or coefficient is not a finite number"
        elif min(self.k[0], self.k[4]) <= 0:
            wrong = f"focal lengths {self.k[0]:g} and {self.k[4]:g} (K) are not above zero"
        elif known is None:
            wrong = (
                f"distortion model '{self.distortion_model}' is not known, "
                f"{', '.join(COEFFICIENTS)} are"
            )
        elif len(self.d) not in (0, known):
            wrong = f"{self.distortion_model} has {known} coefficients, not {len(self.d)}"
        else:
            return
        raise InputError(f"{where}: {wrong}; calibrate the camera again")

    @classmethod
    def load(cls, path: str | Path) -> CameraCalibration:
        """Read a YAML file; raises InputError naming file and key."""
        data = load_yaml(path, "camera calibration")
        where = str(path)
        try:
            calibration = cls(
                width=int(data["image_width"]),
                height=int(data["image_height"]),
                name=str(data.get("camera_name", "camera")),
                distortion_model=str(data.get("distortion_model", "plumb_bob")),
                d=_matrix(data, "distortion_coefficients", None, where),
                k=_matrix(data, "camera_matrix", 9, where),
                r=_matrix(data, "rectification_matrix", 9, where),
                p=_matrix(data, "projection_matrix", 12, where),
            )
        except KeyError as error:
            raise InputError(f"{path}: key {error} is missing; add it") from None
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"{path}: image_width and image_height must be whole numbers; correct them"
            ) from None
        if calibration.calibrated:
            calibration.check(where)
        return calibration

    def save(self, path: str | Path) -> None:
        """Write the YAML file; raises InputError when it cannot be written.

        So it does for the file of a plate calibration, which holds for the lens in it alone.
        """
        if exists(path) and any(
            key in load_yaml(path, "camera calibration") for key in _OF_THE_PLATE
        ):
            raise InputError(
                f"{path}: is a plate calibration, which another lens would make wrong; let "
                "camera_info_url name a file of the lens alone, or '' for its usual one, then "
                "calibrate the plate again"
            )
        data: dict[str, Any] = {
            "image_width": self.width,
            "image_height": self.height,
            "camera_name": self.name,
            "camera_matrix": {"rows": 3, "cols": 3, "data": list(self.k)},
            "distortion_model": self.distortion_model,
            "distortion_coefficients": {"rows": 1, "cols": len(self.d), "data": list(self.d)},
            "rectification_matrix": {"rows": 3, "cols": 3, "data": list(self.r)},
            "projection_matrix": {"rows": 3, "cols": 4, "data": list(self.p)},
        }
        with atomic_write(path) as file:
            yaml.safe_dump(data, file, sort_keys=False)


def _matrix(data: dict[str, Any], key: str, size: int | None, where: str) -> list[float]:
    try:
        values = [float(v) for v in data[key]["data"]]
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{where}: '{key}' needs a list of numbers under 'data'") from None
    if size is not None and len(values) != size:
        raise InputError(f"{where}: '{key}' has {len(values)} numbers, {size} are needed")
    return values


def resolve_url(url: str, name: str) -> Path:
    """Path of a `camera_info_url`.

    Schemes `file:///…` and `package://PACKAGE/…`; `${NAME}`, `${ROS_HOME}` and environment
    variables are replaced; empty means `file://${ROS_HOME}/camera_info/${NAME}.yaml`. Raises
    InputError for anything else.
    """
    home = os.environ.get("ROS_HOME") or str(Path.home() / ".ros")
    url = url or "file://${ROS_HOME}/camera_info/${NAME}.yaml"

    def replace(match: re.Match[str]) -> str:
        known = {"NAME": name, "ROS_HOME": home}.get(match[1], os.environ.get(match[1]))
        if known is None:
            raise InputError(f"camera_info_url: variable '{match[1]}' is not set in '{url}'")
        return known

    plain = re.sub(r"\$\{(\w+)\}", replace, url)
    if plain.startswith("file:///"):
        return Path(unquote(plain[len("file://") :]))
    if plain.startswith("package://"):
        package, _, rest = plain[len("package://") :].partition("/")
        return _package_share(package, url) / rest
    raise InputError(
        f"camera_info_url '{url}' is not a URL; write file:///folder/camera.yaml or package://…"
    )


def _package_share(package: str, url: str) -> Path:
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory(package))
    except (ImportError, LookupError, ValueError, OSError):
        raise InputError(f"camera_info_url '{url}': package '{package}' is not installed") from None
