# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Camera calibration files in the format of ROS camera_info_manager, and their URLs.

No message package is imported here.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import yaml

from finger_common.errors import InputError
from finger_common.files import atomic_write, load_yaml


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

    @classmethod
    def load(cls, path: str | Path) -> CameraCalibration:
        """Read a YAML file; raises InputError naming file and key."""
        data = load_yaml(path, "camera calibration")
        where = str(path)
        try:
            return cls(
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
        except (TypeError, ValueError):
            raise InputError(
                f"{path}: image_width and image_height must be whole numbers; correct them"
            ) from None

    def save(self, path: str | Path) -> None:
        """Write the YAML file; raises InputError when it cannot be written."""
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
