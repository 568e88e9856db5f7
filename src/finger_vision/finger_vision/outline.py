# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Outlines of a mask of ridges: convex hull, closed outline, and their moments."""

from __future__ import annotations

import math

import cv2
import numpy as np


def convex_corners(mask: np.ndarray, half: float = 0.5) -> np.ndarray:
    """(n, 2) corners of the convex hull of a mask's pixels; (0, 2) for an empty mask.

    Pixels count as squares with sides of twice `half`: their centres would leave out half a pixel
    all round.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return np.zeros((0, 2))
    found = mask[rows] > 0
    left = found.argmax(axis=1) - half
    right = found.shape[1] - 1 - found[:, ::-1].argmax(axis=1) + half
    corners = np.concatenate(
        [np.column_stack([x, rows + side]) for x in (left, right) for side in (-half, half)]
    )
    return cv2.convexHull(corners.astype(np.float32)).reshape(-1, 2).astype(float)


def closed_outline(mask: np.ndarray, gap: int, half: float = 0.5) -> np.ndarray:
    """(n, 2) outer contour of a mask whose gaps up to `gap` pixels are closed; (0, 2) for none.

    It lies `half` a pixel outside the centres of the outermost ones. Parts further apart are joined
    by a line, so that the contour bounds all of them.
    """
    size = gap | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    padded = cv2.copyMakeBorder(mask, size, size, size, size, cv2.BORDER_CONSTANT, value=0)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)
    parts = sorted(_contours(closed), key=len, reverse=True)
    if not parts:
        return np.zeros((0, 2))
    joined = parts[0]
    for part in parts[1:]:
        # Every fourth point is near enough to the nearest one.
        ends, starts = joined[::4], part[::4]
        apart = np.sum((ends[:, None] - starts) ** 2, axis=2)
        end, start = np.unravel_index(np.argmin(apart), apart.shape)
        cv2.line(closed, ends[end].tolist(), starts[start].tolist(), 255)
        joined = np.concatenate([joined, part])
    contour = _contours(closed)[0].astype(float) - size
    return shifted(contour, half) if len(contour) > 8 else np.zeros((0, 2))


def filled(mask: np.ndarray, gap: float, coarser: int) -> np.ndarray:
    """Mask, `coarser` times coarser, of a mask whose gaps up to `gap` pixels are closed and whose
    holes are filled; with an empty border."""
    size = max(3, round(gap / coarser) | 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    shape = (-(-mask.shape[1] // coarser), -(-mask.shape[0] // coarser))
    coarse = cv2.resize(mask, shape, interpolation=cv2.INTER_AREA)
    coarse = cv2.threshold(coarse, 0, 255, cv2.THRESH_BINARY)[1]
    padded = cv2.copyMakeBorder(coarse, size, size, size, size, cv2.BORDER_CONSTANT, value=0)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)
    cv2.drawContours(closed, _contours(closed), -1, 255, cv2.FILLED)
    return closed


def empty_share(mask: np.ndarray) -> float:
    """Share of the convex hull of a mask that the mask leaves empty."""
    parts = _contours(mask)
    if not parts:
        return 0.0
    hull = cv2.contourArea(cv2.convexHull(np.concatenate(parts)))
    return 1 - sum(map(cv2.contourArea, parts)) / hull if hull > 0 else 0.0


def has_lobes(mask: np.ndarray, share: float) -> bool:
    """Whether a mask with an empty border has two discs of `share` of its widest disc that are
    joined by something narrower."""
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    cores = np.where(inside > share * inside.max(), np.uint8(1), np.uint8(0))
    return cv2.connectedComponents(cores)[0] > 2


def _contours(mask: np.ndarray) -> list[np.ndarray]:
    """Outer contours (n, 2) of the parts of a mask."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [contour.reshape(-1, 2) for contour in contours]


def widened(hull: np.ndarray, by: float) -> np.ndarray:
    """Convex outline (n, 2) in m moved outwards by `by` m: its Minkowski sum with a disc."""
    corners = 16
    t = np.linspace(0, 2 * math.pi, corners, endpoint=False)
    # Polygon of the disc's area.
    radius = by * math.sqrt(2 * math.pi / corners / math.sin(2 * math.pi / corners))
    disc = radius * np.column_stack([np.cos(t), np.sin(t)])
    points = ((hull[:, None] + disc) * 1e3).astype(np.float32).reshape(-1, 2)
    return cv2.convexHull(points).reshape(-1, 2).astype(float) * 1e-3


def shifted(contour: np.ndarray, by: float) -> np.ndarray:
    """Closed contour (n, 2) moved outwards by `by` along its smoothed normal."""
    tangent = np.roll(contour, -3, axis=0) - np.roll(contour, 3, axis=0)
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    normal /= np.maximum(np.hypot(normal[:, 0], normal[:, 1]), 1e-12)[:, None]
    following = np.roll(contour, -1, axis=0)
    turn = np.sum(contour[:, 0] * following[:, 1] - contour[:, 1] * following[:, 0])
    return contour + math.copysign(by, turn) * normal


class Shape:
    """Area (m²), perimeter (m), centroid (m) and moment ellipse of a closed outline (n, 2) in m."""

    def __init__(self, outline: np.ndarray) -> None:
        # In mm, within float32's comfort.
        points = (outline * 1e3).astype(np.float32)
        moments = cv2.moments(points)
        self.area = moments["m00"] * 1e-6
        self.perimeter = float(cv2.arcLength(points, True)) * 1e-3
        self.centroid = (0.0, 0.0)
        self.major = self.minor = self.angle = 0.0
        if self.area > 0:
            m00 = moments["m00"]
            self.centroid = (moments["m10"] / m00 * 1e-3, moments["m01"] / m00 * 1e-3)
            xx, yy, xy = (moments[key] / m00 for key in ("mu20", "mu02", "mu11"))
            half, root = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
            # An ellipse with semi-axis a has the second moment a²/4 along it.
            self.major = 4e-3 * math.sqrt(max(half + root, 0))
            self.minor = 4e-3 * math.sqrt(max(half - root, 0))
            angle = 0.5 * math.atan2(2 * xy, xx - yy)
            self.angle = angle if angle > -math.pi / 2 else angle + math.pi
