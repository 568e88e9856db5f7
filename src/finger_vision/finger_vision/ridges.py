# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which pixels are ridges of the pressing finger: contrast, local threshold, region.

Images here are at working resolution; masks are uint8, 0 or 255.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from .background import Background
from .regions import SPECK, Followed, match_region
from .working_grid import Box, WorkingGrid

STRONG_SHARE = 0.25
"""Contrast above this share of the frame's typical ridge contrast is certainly skin."""

FAINT_SHARE, FAINT_SHARE_GUESSED = 0.12, 0.25
"""Skin beside it counts down to this share. Without a learned background it might be the print of
an earlier press, hence the higher figure."""

FAINT_CONTRAST = 0.05
"""… and down to this contrast, fraction of the grey range."""

NOISE_FLOOR = 2.0
"""Certain skin has this many standard deviations of a pixel's noise, twice as many of the mean of
four pixels."""

SMOOTHED, SMOOTHED_NOISE = 0.7, 1.6
"""Working pixels (standard deviation of a Gaussian) by which contrast is smoothed where specks of
noise would count as faint skin; and how far above zero specks then reach, in standard deviations of
a pixel's noise before."""

RIDGE_LEVEL, RIM_LEVEL = 0.5, 0.35
"""A ridge ends for the real area where the contrast has fallen to half of its local height; the
outline of the gross contact goes through the outermost trace, somewhat further out."""

REACH = 2.5e-3
"""Faint skin further than this (m) from certain skin does not count."""

DENSITY = 0.06
"""Share of ridge pixels about a point that makes it part of a region."""

SPIKE, SPREAD = 3.0, 5.0
"""Contrast of a pixel over that of all beside it above which it is a dead pixel of the camera; and
working pixels of a ridge period from which on light spreads over more than one."""

OTHER_REGION = 2e-6
"""m², smallest region beside the finger's that is reported."""

HAIR = 0.95
"""Share of certain skin in a long and narrow part of a region above which it is a hair."""

DARKEST = 80.0
"""Grey below which a plate counts as dark: noise on it is not contrast."""

SOBEL_NOISE = 12 / 64
"""Variance of a Sobel gradient (greys a pixel) over that of a pixel's noise."""

GUESSED_CAUTION = 1.3
"""Factor on the contrast of certain skin where no background was learned: an earlier print may be
there."""


@dataclass(frozen=True)
class Ridges:
    """Ridges of the pressing finger: masks of the working pixels inside `box`.

    touching: down to half of the local contrast. outermost: down to the outermost trace. region:
    what belongs to the finger. other_regions: whether other regions were left out. doubtful: the
    outermost trace in those so near that they may be the same finger's, and in parts of the region
    that may be a hair; None without any. contrast: mean of the touching ones, 0…255. followed: what
    the next frame needs to follow the finger.
    """

    box: Box
    touching: np.ndarray
    outermost: np.ndarray
    region: np.ndarray
    other_regions: bool
    doubtful: np.ndarray | None
    contrast: float
    followed: Followed


def contrast_of(background: Background) -> tuple[np.ndarray, float]:
    """Contrast (h, w) uint8 of touching skin in a frame, 255 for all of the light, and noise in
    that unit."""
    frame = background.frame
    if background.bright_ridges:
        return cv2.subtract(frame, background.image), background.noise
    # Relative to the light that falls there, so that vignetting does not matter.
    light = cv2.max(background.image, np.array([DARKEST]))
    contrast = cv2.divide(cv2.subtract(background.image, frame), light, scale=255)
    return contrast, background.noise * 255 / float(cv2.mean(light[::8, ::8])[0])


def find_ridges(
    contrast: np.ndarray,
    noise: float,
    learned: bool,
    minimum_contrast: float,
    grid: WorkingGrid,
    past: Followed | None = None,
    one_grey: bool = False,
) -> Ridges | None:
    """Ridges of the pressing finger in a contrast image (h, w) uint8; None without contact.

    noise: standard deviation of the contrast. learned: whether the background was learned.
    minimum_contrast: fraction of the grey range. past: `followed` of the frame before, None after
    one without contact. one_grey: whether the plate is, as of `Background`.
    """
    # Certain skin, at a quarter of the working resolution, selects the part to examine further.
    columns, rows = contrast.shape[1] // 2, contrast.shape[0] // 2
    half = cv2.resize(contrast, (columns, rows), interpolation=cv2.INTER_AREA)
    floor = minimum_contrast * 255 * (1.0 if learned else GUESSED_CAUTION)
    if learned:
        # A frame full of ridges has no tile that tells the noise.
        floor = max(floor, NOISE_FLOOR * noise)
    typical = _typical_contrast(half, floor)
    if typical == 0:
        return None
    strong = max(floor, STRONG_SHARE * typical)
    core = _density(_above(half, strong), 2, grid)
    box = _box(core, grid)
    if box is None:
        return None
    # A plate of one grey is clipped to white: no earlier print could show on it.
    share = FAINT_SHARE if learned or one_grey else FAINT_SHARE_GUESSED
    part, above_noise = contrast[box], 5 * noise
    if above_noise > 0.6 * strong:
        part = cv2.GaussianBlur(part, (0, 0), SMOOTHED)
        above_noise = SMOOTHED_NOISE * noise
    faint = max(FAINT_CONTRAST * 255, share * typical, above_noise)
    touching, outermost = _threshold(part, faint, grid)
    found = _region(core, box, touching, grid, past)
    if found is None:
        return None
    region, other_regions, near, followed = found
    doubtful = None if near is None else outermost & near
    touching &= region
    outermost &= region
    if grid.period > SPREAD:
        # Even the end of a ridge shows in the pixels beside it.
        beside = cv2.dilate(part, np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8))
        outermost &= cv2.compare(part, cv2.convertScaleAbs(beside, alpha=SPIKE), cv2.CMP_LE)
    mean = cv2.mean(contrast[box], touching)[0]
    if not learned and mean < floor:
        return None
    return Ridges(box, touching, outermost, region, other_regions, doubtful, mean, followed)


def fine_structure(background: Background, ridges: Ridges, period: float) -> tuple[float, float]:
    """How much structure as fine as ridges a contact shows, in the direction that has least of it,
    and in that which has most.

    It is the root mean square that a wave of the ridge period (working pixels) has with gradients
    as in the region, over the contrast of the ridges. Light that was assumed to have moved does not
    count: what it takes away from a smooth patch leaves edges.
    """
    plate = background.image if background.unmoved is None else background.unmoved
    left, top, width, height = cv2.boundingRect(ridges.region)
    part = slice(top, top + height), slice(left, left + width)
    inside = ridges.region[part]
    frame, plate = (image[ridges.box][part] for image in (background.frame, plate))
    difference = cv2.subtract(frame, plate, dtype=cv2.CV_16S)
    slopes: list[np.ndarray] = [
        cv2.Sobel(difference, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1))
    ]
    along, down = slopes
    xx, yy, xy = (cv2.mean(a * b, inside)[0] for a, b in ((along,) * 2, (down,) * 2, (along, down)))
    mean = (xx + yy) / 2 - SOBEL_NOISE * background.noise**2
    apart = math.hypot((xx - yy) / 2, xy)
    # Differences of pixels two apart, as Sobel's, see a wave of few pixels flatter than it is.
    unit = 1 / (math.sin(2 * math.pi / period) * ridges.contrast)
    if not background.bright_ridges:
        unit *= 255 / max(cv2.mean(plate, inside)[0], DARKEST)
    least, most = (unit * math.sqrt(max(square, 0.0)) for square in (mean - apart, mean + apart))
    return least, most


def _above(image: np.ndarray, limit: float) -> np.ndarray:
    """Mask of pixels above a limit."""
    return cv2.threshold(image, limit, 255, cv2.THRESH_BINARY)[1]


def _typical_contrast(contrast: np.ndarray, floor: float) -> float:
    """Median contrast of what is above the floor; 0 without any."""
    histogram = cv2.calcHist([contrast], [0], None, [256], [0, 256]).ravel()
    histogram[: int(floor) + 1] = 0
    total = histogram.sum()
    return float(np.searchsorted(np.cumsum(histogram), 0.5 * total)) if total > 0 else 0.0


def _window(grid: WorkingGrid) -> int:
    """2.5 ridge periods on a grid four times coarser; odd."""
    return max(3, round(2.5 * grid.period / 4) | 1)


def _density(mask: np.ndarray, step: int, grid: WorkingGrid) -> np.ndarray:
    """Share (0…255) of a mask within 2.5 ridge periods, `step` times coarser than the mask."""
    size = (-(-mask.shape[1] // step), -(-mask.shape[0] // step))
    coarse = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    window = _window(grid)
    return cv2.blur(coarse, (window, window), borderType=cv2.BORDER_REPLICATE)


def _box(core: np.ndarray, grid: WorkingGrid) -> Box | None:
    """Rows and columns, multiples of 4, of all skin with the reach around it; None without any."""
    left, top, width, height = cv2.boundingRect(_above(core, DENSITY * 255))
    if width == 0:
        return None
    margin = math.ceil((REACH / grid.pitch + 2 * grid.period) / 4)
    rows, columns = grid.shape
    return (
        slice(4 * max(top - margin, 0), min(4 * (top + height + margin), rows)),
        slice(4 * max(left - margin, 0), min(4 * (left + width + margin), columns)),
    )


def _quarter(box: Box) -> Box:
    """The box on a grid four times coarser."""
    rows, columns = box
    return (
        slice(rows.start // 4, -(-rows.stop // 4)),
        slice(columns.start // 4, -(-columns.stop // 4)),
    )


def _threshold(
    contrast: np.ndarray, faint: float, grid: WorkingGrid
) -> tuple[np.ndarray, np.ndarray]:
    """Masks of pixels above RIDGE_LEVEL and RIM_LEVEL of the local contrast, and above `faint`."""
    height, width = contrast.shape
    half = cv2.resize(contrast, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    reach = max(3, round(0.5 * grid.period) | 1)
    local = cv2.dilate(half, np.ones((reach, reach), np.uint8))
    local = cv2.resize(
        cv2.blur(local, (reach, reach)), (width, height), interpolation=cv2.INTER_LINEAR
    )
    lowest = np.array([faint])
    touching, outermost = (
        cv2.compare(contrast, cv2.max(cv2.convertScaleAbs(local, alpha=share), lowest), cv2.CMP_GT)
        for share in (RIDGE_LEVEL, RIM_LEVEL)
    )
    return touching, outermost


def _region(
    core: np.ndarray, box: Box, ridges: np.ndarray, grid: WorkingGrid, past: Followed | None
) -> tuple[np.ndarray, bool, np.ndarray | None, Followed] | None:
    """Mask of the pressing finger's region in the box, whether other regions were left out, a mask
    of what is in doubt (those within 2.5 ridge periods of it, and narrow parts of it), and what the
    next frame needs; None without a region.

    Regions are connected by the density of ridges; `match_region` tells which is the pressing
    finger's.
    """
    part = _quarter(box)
    certain = _above(core[part], DENSITY * 255)
    size = round(REACH / (2 * grid.pitch)) | 1
    near = cv2.dilate(certain, np.ones((size, size), np.uint8))
    dense = cv2.bitwise_and(_above(_density(ridges, 4, grid), DENSITY * 255), near)
    count, labels = cv2.connectedComponents(dense, connectivity=8)
    weight = np.bincount(labels[certain > 0].astype(np.intp), minlength=count)
    weight[0] = 0
    if not weight.any():
        return None
    best, followed = match_region(labels, weight, part, core.shape, past)
    others = weight > max(SPECK * weight[best], OTHER_REGION / (4 * grid.pitch) ** 2)
    others[best] = False
    main = _mask(labels == best)
    # A hair across the rim is no wider than the density of a line, and certain all along; a narrow
    # part that is not may be a rim, too. A first touch may be as narrow as a whole.
    window = _window(grid)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (window + 2, window + 2))
    wide = cv2.dilate(cv2.morphologyEx(main, cv2.MORPH_OPEN, disc), np.ones((3, 3), np.uint8))
    doubtful = np.zeros_like(main)
    if wide.any():
        _, parts, boxes, _ = cv2.connectedComponentsWithStats(cv2.subtract(main, wide))
        light = np.bincount(parts.ravel().astype(np.intp), certain.ravel())
        sure = light > HAIR * 255 * boxes[:, cv2.CC_STAT_AREA]
        long = boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) > window
        long[0] = False
        main[(long & sure)[parts]] = 0
        doubtful = _mask((long & ~sure)[parts])
    if others.any():
        around = cv2.dilate(main, np.ones((2 * window + 1, 2 * window + 1), np.uint8))
        beside = np.zeros(count, bool)
        beside[np.unique(labels[around > 0])] = True
        doubtful |= _mask((others & beside)[labels])
    shown = _enlarged(doubtful, ridges) if doubtful.any() else None
    return _enlarged(main, ridges), bool(others.any()), shown, followed


def _mask(inside: np.ndarray) -> np.ndarray:
    """Mask, 0 or 255, of an array of bool."""
    return np.where(inside, np.uint8(255), np.uint8(0))


def _enlarged(mask: np.ndarray, like: np.ndarray) -> np.ndarray:
    """A mask in the size of a finer one."""
    return cv2.resize(mask, like.shape[::-1], interpolation=cv2.INTER_NEAREST)
