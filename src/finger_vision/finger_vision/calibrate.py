# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Plate calibration from views of a board: lens by Zhang's method, plate by a homography.

Z. Zhang, "A flexible new technique for camera calibration", IEEE Trans. PAMI 22(11), 2000, as in
OpenCV's calibrateCamera. All views give the lens; those in which the board lies flat on the plate
give the plate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from typing import Any

import cv2
import numpy as np

from finger_common.errors import InputError

from .board import View
from .calibration import PlateCalibration, apply_homography

MINIMUM_VIEWS = 6
MAXIMUM_ERROR = 1.0
"""px, RMS of reprojection; a sharp board gives 0.05 to 0.3."""
MINIMUM_TILT = math.radians(15)
"""Largest angle between two views' board planes; parallel boards do not determine the lens."""
MINIMUM_COVER, MINIMUM_PLATE_COVER = 0.3, 0.1
"""Shares of the image that all corners together, and those on the plate alone, must span."""
FOCAL_DEVIATION = 0.05
"""Largest relative standard deviation of the focal length."""


@dataclass(frozen=True)
class CalibrationReport:
    """The calibration, and the RMS error (px) of each view by name."""

    calibration: PlateCalibration
    view_errors: dict[str, float]


def calibrate_plate(
    views: Sequence[View],
    plate_views: Sequence[View],
    camera_name: str = "",
    lens: bool = True,
    mirrored: bool = False,
) -> CalibrationReport:
    """Calibrate from all `views` and those of the board on the plate.

    lens: False for the homography alone, from `plate_views`, without lens distortion. mirrored:
    whether the camera's pictures are mirrored, for boards that do not tell it. Raises InputError
    with the reason for views that do not determine the calibration.
    """
    if not plate_views:
        raise InputError(
            "no view shows the board lying on the plate; give one with --on-plate, sharp and "
            "complete"
        )
    size = plate_views[0].size
    for view in [*views, *plate_views]:
        if view.size != size:
            raise InputError(
                f"{view.name}: image is {view.size[0]}×{view.size[1]}, others are "
                f"{size[0]}×{size[1]}; use images of one camera setting"
            )
    camera, errors = _lens(views, size) if lens else (PlateCalibration(image_size=size), {})
    calibration = replace(
        _plate(camera, plate_views, size, _mirrored([*views, *plate_views], mirrored)),
        camera_name=camera_name,
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )
    return CalibrationReport(calibration, errors)


def _mirrored(views: Sequence[View], given: bool) -> bool:
    """Whether the pictures are mirrored, as the boards tell or else as `given`; raises InputError
    where boards contradict one another, or what is given."""
    told = {view.mirrored: view.name for view in views if view.mirrored is not None}
    if len(told) > 1:
        raise InputError(
            f"{told[True]} shows the board mirrored, {told[False]} as it is printed; turn the "
            "printed side to the camera in all views, and use views of one camera"
        )
    if given and False in told:
        raise InputError(
            f"{told[False]} shows the board as it is printed, so the picture is not mirrored; "
            "leave out --mirrored"
        )
    return given or True in told


def _lens(
    views: Sequence[View], size: tuple[int, int]
) -> tuple[PlateCalibration, dict[str, float]]:
    """Camera matrix and distortion, and the RMS error (px) of each view."""
    if len(views) < MINIMUM_VIEWS:
        raise InputError(
            f"the board was found in {len(views)} views, {MINIMUM_VIEWS} at different angles are "
            "needed; take more, or calibrate the plate alone with --no-lens"
        )
    cover = _cover(views, size)
    if cover < MINIMUM_COVER:
        raise InputError(
            f"the boards cover {100 * cover:.0f} % of the image, {100 * MINIMUM_COVER:.0f} % are "
            "needed; bring the board to all sides and closer"
        )
    points = [v.points.astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32).reshape(-1, 1, 2) for v in views]
    # None: OpenCV's own start values, which its type hints do not allow.
    start: Any = None
    try:
        error, camera, distortion, rotations, _, deviations, _, per_view = (
            cv2.calibrateCameraExtended(points, pixels, size, start, start, flags=cv2.CALIB_FIX_K3)
        )
    except cv2.error as problem:
        raise InputError(
            "the views do not determine the camera; take views at clearly different angles "
            f"(OpenCV: {problem.err})"
        ) from None
    normals = np.array([cv2.Rodrigues(r)[0][:, 2] for r in rotations])
    cosines = np.clip(np.abs(normals @ normals.T), 0, 1)
    span = float(np.arccos(cosines.min()))
    if span < MINIMUM_TILT:
        raise InputError(
            f"the boards are tilted against each other by {math.degrees(span):.0f}° at most, "
            f"{math.degrees(MINIMUM_TILT):.0f}° are needed; tilt the board, or use --no-lens"
        )
    errors = {v.name: float(e) for v, e in zip(views, np.ravel(per_view))}
    if not math.isfinite(error) or error > MAXIMUM_ERROR:
        worst = max(errors, key=lambda name: errors[name])
        raise InputError(
            f"reprojection error is {error:.2f} px, at most {MAXIMUM_ERROR:g} px are accepted; "
            f"leave out blurred or bent views, first of all {worst} ({errors[worst]:.2f} px)"
        )
    focal = float(np.max(np.ravel(deviations)[:2] / np.array([camera[0, 0], camera[1, 1]])))
    if focal > FOCAL_DEVIATION:
        raise InputError(
            f"the focal length is uncertain by {100 * focal:.0f} %, {100 * FOCAL_DEVIATION:.0f} % "
            "are accepted; take more views with more tilt, or use --no-lens"
        )
    calibration = PlateCalibration(
        camera_matrix=camera,
        distortion=np.ravel(distortion)[:5],
        image_size=size,
        reprojection_error=float(error),
    )
    return calibration, errors


def _cover(views: Sequence[View], size: tuple[int, int]) -> float:
    """Share of the image that the corners of all views together span."""
    spans = np.ptp(np.concatenate([v.pixels for v in views]), axis=0)
    return float(np.prod(spans)) / (size[0] * size[1])


def _plate(
    base: PlateCalibration, views: Sequence[View], size: tuple[int, int], mirrored: bool
) -> PlateCalibration:
    """The homography from undistorted pixels to the plate, averaged over the views."""
    cover = _cover(views, size)
    if cover < MINIMUM_PLATE_COVER:
        raise InputError(
            f"the boards on the plate cover {100 * cover:.0f} % of the image, "
            f"{100 * MINIMUM_PLATE_COVER:.0f} % are needed; use a larger board, or give more views "
            "with --on-plate in which it lies elsewhere"
        )
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    if base.camera_matrix is not None:
        centre = base.camera_matrix[:2, 2]
    # Each view has its own board frame: bring them to one plate frame, then fit all together.
    sources, targets = [], []
    for view in views:
        undistorted = base.undistort(view.pixels)
        sources.append(undistorted)
        targets.append(_in_plate_frame(undistorted, view, centre, mirrored))
    homography = _fit(np.concatenate(sources), np.concatenate(targets), "plate views")
    residual = apply_homography(homography, np.concatenate(sources)) - np.concatenate(targets)
    plate_error = float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
    extent = float(np.ptp(np.concatenate(targets), axis=0).max())
    if plate_error > 0.01 * extent:
        raise InputError(
            f"the plate views differ by {plate_error * 1e6:.0f} µm; lay the board flat on the "
            "plate in each, and do not move the camera"
        )
    probe = centre + np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corner = apply_homography(homography, probe)
    area = cv2.contourArea(((corner - corner[0]) * 1e6).astype(np.float32)) * 1e-12
    error = base.reprojection_error
    if math.isnan(error):
        back = apply_homography(
            np.linalg.inv(homography), np.concatenate(targets)
        ) - np.concatenate(sources)
        error = float(np.sqrt(np.mean(np.sum(back**2, axis=1))))
        if error > MAXIMUM_ERROR:
            raise InputError(
                f"reprojection error is {error:.2f} px, at most {MAXIMUM_ERROR:g} px are accepted; "
                "the board is not flat or the lens distorts: calibrate with the lens"
            )
    return replace(
        base,
        plate_from_pixel=homography,
        area_per_pixel=float(area),
        plate_error=plate_error,
        reprojection_error=error,
    )


def _in_plate_frame(
    pixels: np.ndarray, view: View, centre: np.ndarray, mirrored: bool
) -> np.ndarray:
    """Board points (n, 2) m in the plate frame: origin at the optical axis, x along the image's x.

    y points down in the image, and up in a mirrored one: with z away from the camera the frame is
    right-handed on the plate itself.
    """
    board = view.points[:, :2]
    homography = _fit(pixels, board, view.name)
    origin, right, below = apply_homography(homography, centre + np.array([[0, 0], [1, 0], [0, 1]]))
    along = (right - origin) / np.linalg.norm(right - origin)
    across = np.array([-along[1], along[0]])
    if (across @ (below - origin) < 0) != mirrored:
        across = -across
    return (board - origin) @ np.column_stack([along, across])


def _fit(pixels: np.ndarray, plane: np.ndarray, name: str) -> np.ndarray:
    # In units of about 1 for a well-conditioned fit.
    scale = float(np.abs(plane).max()) or 1.0
    homography, _ = cv2.findHomography(pixels.astype(np.float64), plane.astype(np.float64) / scale)
    if homography is None or not np.isfinite(homography).all():
        raise InputError(f"{name}: the corners found do not form a plane; leave this view out")
    return np.diag([scale, scale, 1.0]) @ homography
