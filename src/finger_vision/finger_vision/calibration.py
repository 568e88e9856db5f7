# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""From pixels to metres on the plate: camera matrix, lens distortion, plate homography.

Lens distortion is removed from a pixel (Zhang's camera model as in OpenCV and
sensor_msgs/CameraInfo, "plumb_bob"), then a homography maps it to the plate frame: origin where
the optical axis meets the plate, x right and y down in the rectified image, metres. In a picture
that a mirror or prism mirrors y is up, so that the frame is right-handed on the plate. A plain area
per pixel is the same without tilt, lens and mirror; areas measured with it are flagged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from finger_common.errors import InputError
from finger_common.files import atomic_write, number, parse_yaml, read_text
from finger_common.settings import Settings, setting

FILE_VERSION = 1
PAPER_AREA_PER_PIXEL = 0.000986e-6
"""m²; Nam and Kuchenbecker, IEEE Trans. Haptics 14(2), 2021."""

PIXEL_AREAS = (1e-12, 1e-4)
"""m², of a pixel: of a micrometre a side, and a centimetre."""

_CORNERS = 250_000  # of pixels that are mapped to the plate at once


def apply_homography(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map points (n, 2) by a homography (3, 3); gives (n, 2)."""
    w = points @ homography[2, :2] + homography[2, 2]
    return (points @ homography[:2, :2].T + homography[:2, 2]) / w[:, None]


@dataclass(frozen=True)
class PlateCalibration:
    """Mapping of the pixels of one camera to the plate.

    plate_from_pixel: (3, 3) homography from undistorted pixels to metres, None where only the area
    is known. camera_matrix: (3, 3), pixels. distortion: (5,) k1 k2 p1 p2 k3. image_size: (width,
    height) it holds for, None for any. area_per_pixel: m² of a pixel of the rectified image.
    reprojection_error: root mean square, in pixels, over the board's corners, NaN where nothing
    was measured. plate_error: the same on the plate, in m.
    """

    area_per_pixel: float = PAPER_AREA_PER_PIXEL
    plate_from_pixel: np.ndarray | None = None
    camera_matrix: np.ndarray | None = None
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))
    image_size: tuple[int, int] | None = None
    reprojection_error: float = math.nan
    plate_error: float = math.nan
    camera_name: str = ""
    date: str = ""

    def __post_init__(self) -> None:
        smallest, largest = PIXEL_AREAS
        if not smallest <= self.area_per_pixel < largest:
            raise InputError(
                f"area per pixel is {self.area_per_pixel:g} m², a number above 0, from "
                f"{smallest:g} to {largest:g}, is needed"
            )

    @classmethod
    def from_area_per_pixel(cls, area: float) -> PlateCalibration:
        """A camera that looks squarely at the plate; `area` in m² of a pixel."""
        return cls(float(area))

    @classmethod
    def given(cls, file: str | Path | None, area_per_pixel: float) -> PlateCalibration:
        """The one of a file, or of an area of a pixel (m²) where no file is named."""
        return cls.load(file) if file else cls.from_area_per_pixel(area_per_pixel)

    @property
    def calibrated(self) -> bool:
        """Whether the plate's homography is known."""
        return self.plate_from_pixel is not None

    @property
    def mirrored(self) -> bool:
        """Whether the picture shows the plate mirrored: its y is up then."""
        if self.plate_from_pixel is None or self.image_size is None:
            return False
        middle = np.array(self.image_size) / 2 + np.array([[0, 0], [1, 0], [0, 1]])
        origin, right, below = apply_homography(self.plate_from_pixel, middle)
        return bool(np.linalg.det([right - origin, below - origin]) < 0)

    # Geometry --------------------------------------------------------------------------------

    def check_size(self, width: int, height: int) -> None:
        """Raises InputError when an image of that size does not belong to this calibration."""
        if self.image_size is not None and (width, height) != self.image_size:
            raise InputError(
                f"image is {width}×{height}, the plate calibration is for {self.image_size[0]}×"
                f"{self.image_size[1]}; calibrate again or set the camera's size"
            )

    def homography_for(self, width: int, height: int) -> np.ndarray:
        """(3, 3) from undistorted pixels to metres for images of that size."""
        self.check_size(width, height)
        if self.plate_from_pixel is not None:
            return self.plate_from_pixel
        pitch = math.sqrt(self.area_per_pixel)
        return np.array(
            [[pitch, 0, -pitch * (width - 1) / 2], [0, pitch, -pitch * (height - 1) / 2], [0, 0, 1]]
        )

    def undistort(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 2) pixels without lens distortion."""
        if self.camera_matrix is None or not np.any(self.distortion):
            return np.asarray(pixels, float)
        return cv2.undistortPoints(
            np.asarray(pixels, np.float64).reshape(-1, 1, 2),
            self.camera_matrix,
            self.distortion,
            P=self.camera_matrix,
        ).reshape(-1, 2)

    def to_plate(self, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
        """(n, 2) metres on the plate from (n, 2) pixels of an image of that size."""
        return apply_homography(self.homography_for(width, height), self.undistort(pixels))

    def to_pixels(self, plate: np.ndarray, width: int, height: int) -> np.ndarray:
        """(n, 2) pixels from (n, 2) metres on the plate; the inverse of `to_plate`."""
        pixel_from_plate = np.linalg.inv(self.homography_for(width, height))
        points = apply_homography(pixel_from_plate, np.asarray(plate, float).reshape(-1, 2))
        if self.camera_matrix is None or not np.any(self.distortion):
            return points
        k = self.camera_matrix
        rays = np.column_stack(
            [
                (points[:, 0] - k[0, 2]) / k[0, 0],
                (points[:, 1] - k[1, 2]) / k[1, 1],
                np.ones(len(points)),
            ]
        )
        zero = np.zeros(3)
        return cv2.projectPoints(rays, zero, zero, k, self.distortion)[0].reshape(-1, 2)

    def pitch(self, width: int, height: int) -> float:
        """Width (m) on the plate of a pixel in the middle of an image of that size."""
        middle = np.array([[width / 2, height / 2], [width / 2 + 1, height / 2]])
        plate = self.to_plate(middle, width, height)
        return float(np.hypot(*(plate[1] - plate[0])))

    def pixel_areas(self, width: int, height: int, step: int = 1) -> np.ndarray:
        """Area (m²) on the plate of one pixel at the centre of each step × step block, float32."""
        columns, rows = width // step, height // step
        areas = np.empty((rows, columns), np.float32)
        u = np.arange(columns + 1) * step - 0.5
        at_once = max(1, _CORNERS // (columns + 1))  # rows: the corners of all take 100 B a pixel
        for first in range(0, rows, at_once):
            last = min(first + at_once, rows)
            # Corners of the blocks, mapped once; areas by the shoelace formula.
            v = np.arange(first, last + 1) * step - 0.5
            grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
            corner = self.to_plate(grid, width, height).reshape(last - first + 1, columns + 1, 2)
            diagonal = corner[1:, 1:] - corner[:-1, :-1]
            other = corner[1:, :-1] - corner[:-1, 1:]
            double = diagonal[..., 0] * other[..., 1] - diagonal[..., 1] * other[..., 0]
            areas[first:last] = 0.5 * np.abs(double) / step**2
        return areas

    # Files -----------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the YAML file."""
        with atomic_write(path) as file:
            file.write(self.to_yaml())

    def to_yaml(self) -> str:
        """Text of the YAML file; its camera part is that of ROS's camera_calibration."""
        data: dict[str, Any] = {
            "version": FILE_VERSION,
            "camera_name": self.camera_name,
            "date": self.date or datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "area_per_pixel": float(self.area_per_pixel),
        }
        if self.image_size is not None:
            data["image_width"], data["image_height"] = map(int, self.image_size)
        if self.camera_matrix is not None:
            projection = np.column_stack([self.camera_matrix, np.zeros(3)])
            data["camera_matrix"] = _matrix(self.camera_matrix)
            data["distortion_model"] = "plumb_bob"
            data["distortion_coefficients"] = _matrix(self.distortion)
            data["rectification_matrix"] = _matrix(np.eye(3))
            data["projection_matrix"] = _matrix(projection)
        if self.plate_from_pixel is not None:
            data["plate_homography"] = _matrix(self.plate_from_pixel)
        for key in ("reprojection_error", "plate_error"):
            if math.isfinite(getattr(self, key)):
                data[key] = float(getattr(self, key))
        mirrored = "# The picture is mirrored: the plate's y points up in it.\n"
        return (
            "# Plate calibration. area_per_pixel: m^2 of a rectified pixel. plate_homography:\n"
            "# undistorted pixels to m on the plate. reprojection_error: px, plate_error: m; RMS.\n"
            + (mirrored if self.mirrored else "")
            + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
        )

    @classmethod
    def load(cls, path: str | Path) -> PlateCalibration:
        """Read a YAML file; raises InputError naming file and key."""
        return cls.from_yaml(read_text(path, "plate calibration"), str(path))

    @classmethod
    def from_yaml(cls, text: str, where: str) -> PlateCalibration:
        """From the text of a YAML file; raises InputError naming `where` and the key."""
        data = parse_yaml(text, where)
        version = data.get("version", FILE_VERSION)
        if version != FILE_VERSION:
            raise InputError(
                f"{where}: version {version!r} is not known, {FILE_VERSION} is; calibrate again"
            )
        size = None
        if "image_width" in data or "image_height" in data:
            width, height = (int(number(data, f"image_{n}", where)) for n in ("width", "height"))
            if min(width, height) <= 0:
                raise InputError(f"{where}: image size {width}×{height} is not above zero")
            size = (width, height)
        distortion = _read_matrix(data, "distortion_coefficients", (1, 5), where)
        homography = _read_matrix(data, "plate_homography", (3, 3), where)
        if homography is not None and abs(np.linalg.det(homography)) < 1e-30:
            raise InputError(f"{where}: 'plate_homography' is singular; calibrate again")
        if homography is not None and size is None:
            raise InputError(f"{where}: 'image_width' and 'image_height' are missing; add them")
        errors = {
            key: number(data, key, where)
            for key in ("reprojection_error", "plate_error")
            if key in data
        }
        area_per_pixel = number(data, "area_per_pixel", where)
        try:
            return cls(
                area_per_pixel=area_per_pixel,
                plate_from_pixel=homography,
                camera_matrix=_read_matrix(data, "camera_matrix", (3, 3), where),
                distortion=np.zeros(5) if distortion is None else distortion[0],
                image_size=size,
                camera_name=str(data.get("camera_name", "")),
                date=str(data.get("date", "")),
                **errors,
            )
        except InputError as error:
            raise InputError(f"{where}: {str(error).removeprefix(where + ': ')}") from None


def _matrix(values: np.ndarray) -> dict[str, Any]:
    """A matrix as ROS's camera_calibration writes it."""
    rows, columns = np.atleast_2d(values).shape
    return {"rows": rows, "cols": columns, "data": [float(v) for v in np.ravel(values)]}


def _read_matrix(
    data: dict[str, Any], key: str, shape: tuple[int, int], where: str
) -> np.ndarray | None:
    """The matrix under a key, None where absent; raises InputError for another shape."""
    if key not in data:
        return None
    try:
        values = np.array(data[key]["data"], dtype=float)
        size = (int(data[key]["rows"]), int(data[key]["cols"]))
    except (TypeError, KeyError, ValueError):
        raise InputError(f"{where}: '{key}' needs rows, cols and data") from None
    if size != shape or values.size != shape[0] * shape[1] or not np.isfinite(values).all():
        raise InputError(
            f"{where}: '{key}' must be {shape[0]}×{shape[1]} finite numbers; correct it"
        )
    return values.reshape(shape)


@dataclass(frozen=True)
class CalibrationSettings(Settings):
    """Where the plate calibration comes from."""

    calibration_file: str = setting(
        "",
        "Plate calibration (YAML) made by `finger-vision calibrate`; empty for none.",
    )
    area_per_pixel: float = setting(
        PAPER_AREA_PER_PIXEL,
        "Area on the plate of one pixel, used without a calibration file and flagged; default: "
        "the paper's.",
        unit="m²",
        minimum=1e-14,
        maximum=1e-6,
    )

    def load(self) -> PlateCalibration:
        """The calibration; raises InputError for a file that cannot be used."""
        return PlateCalibration.given(self.calibration_file, self.area_per_pixel)
