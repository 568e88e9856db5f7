"""From one FTIR frame to the contact's areas, shape and quality.

Steps: reduce to about 60 µm a pixel; background (learned, or guessed from the frame); contrast against it; ridges
by a threshold that follows the local contrast; the pressing finger's region by the density of ridges; its convex
hull (gross area, as in Nam and Kuchenbecker, IEEE Trans. Haptics 14(2), 2021) or closed outline; ridge pixels times
their area on the plate (real area). `docs/vision.md` shows each step in pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from finger_common.errors import InputError

from .background import (
    LearnedBackground,
    guess_background,
    guess_polarity,
    tile_means,
    tile_statistics,
)
from .calibration import PAPER_AREA_PER_PIXEL, PlateCalibration
from .flags import ContactFlag
from .images import as_mono8
from .outline import Shape, closed_outline, convex_corners, shifted, widened

STRONG_SHARE = 0.25
"""Skin is beyond doubt above this share of the frame's typical ridge contrast."""
FAINT_SHARE, FAINT_SHARE_GUESSED = 0.12, 0.25
"""Skin beside it counts down to this share. Without a learned background it might be an earlier press's print,
hence the higher figure."""
FAINT_CONTRAST = 0.05
"""… and down to this contrast, fraction of the grey range."""
RIDGE_LEVEL, RIM_LEVEL = 0.5, 0.35
"""A ridge ends for the real area where the contrast has fallen to half of its local height; the outline of the gross
contact goes through the outermost trace, somewhat further out."""
REACH = 2.5e-3
"""Faint skin further than this (m) from skin beyond doubt does not count."""
FURROW = 0.26
"""Skin outside the outermost ridge, in ridge periods times the squared share of the contact that does not touch. Half
a furrow would be 0.5 where ridges run along the rim, 0 where they meet it."""
DENSITY = 0.06
"""Share of ridge pixels about a point that makes it part of a region."""
OTHER_REGION = 2e-6
"""m², smallest region beside the finger's that is reported."""
DARKEST = 80.0
"""Grey below which a plate counts as dark: noise on it is not contrast."""
GUESSED_CAUTION = 1.3
"""Where no background was learned, skin beyond doubt needs so much more contrast: an earlier print may be there."""
GUESSED_MINIMUM = 0.5e-6
"""m² of ridges below which a region is dust where no background was learned."""


@dataclass(frozen=True)
class SegmenterSettings:
    """Settings of `ContactSegmenter`; lengths in m, areas in m², contrasts as fractions of the grey range.

    outline: "convex" (the paper's hull) or "concave" (follows the ridges; does not bridge gaps).
    polarity: of the ridges against the plate, "auto", "dark" or "bright". Raises InputError for values without sense.
    """

    outline: str = "convex"
    polarity: str = "auto"
    ridge_period: float = 0.5e-3
    minimum_contrast: float = 0.15
    minimum_area: float = 0.5e-6
    working_pixel: float = 60e-6
    learn_background: bool = True
    background_frames: int = 50

    def __post_init__(self) -> None:
        for name, choices in (
            ("outline", ("convex", "concave")),
            ("polarity", ("auto", "dark", "bright")),
        ):
            if getattr(self, name) not in choices:
                raise InputError(
                    f"'{name}' is {getattr(self, name)!r}, choose one of {', '.join(choices)}"
                )
        for name in ("ridge_period", "minimum_contrast", "minimum_area", "working_pixel"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"'{name}' is {value}, a number above 0 is needed")


@dataclass(frozen=True)
class ContactMeasurement:
    """One frame's contact, SI units, plate frame; every area is exactly zero without contact.

    gross_area, real_area, area_sd: m². centroid: (x, y) m. ellipse_major, ellipse_minor: full axes, m, of the
    ellipse with the contact's second moments. ellipse_angle: rad in (−π/2, π/2], from +x towards +y.
    hull: (n, 2) m, outline of the gross contact. flags: `ContactFlag` bits.
    """

    gross_area: float = 0.0
    real_area: float = 0.0
    area_sd: float = 0.0
    centroid: tuple[float, float] = (0.0, 0.0)
    ellipse_major: float = 0.0
    ellipse_minor: float = 0.0
    ellipse_angle: float = 0.0
    hull: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    flags: int = 0


@dataclass
class Steps:
    """Pictures (h, w) uint8 of the last frame's steps at working resolution, for documentation and inspection.

    `ridges`, `rim` and `region` are masks inside `box` (rows, columns), None without contact.
    """

    frame: np.ndarray
    background: np.ndarray
    contrast: np.ndarray
    box: tuple[slice, slice] | None = None
    ridges: np.ndarray | None = None
    rim: np.ndarray | None = None
    region: np.ndarray | None = None


class _Geometry:
    """What follows from image size and calibration alone. Lengths in working pixels but for `pitch` (m)."""

    def __init__(
        self, width: int, height: int, calibration: PlateCalibration, settings: SegmenterSettings
    ) -> None:
        calibration.check_size(width, height)
        self.size = (width, height)
        self.calibration = calibration
        middle = np.array([[width / 2, height / 2], [width / 2 + 1, height / 2]])
        plate = calibration.to_plate(middle, width, height)
        pitch = float(np.hypot(*(plate[1] - plate[0])))
        self.step = max(1, round(settings.working_pixel / pitch))
        self.pitch = pitch * self.step
        # Multiples of 4, so that coarser grids fit; up to three working pixels at the far borders are left out.
        self.shape = (height // self.step // 4 * 4, width // self.step // 4 * 4)
        if min(self.shape) < 32:
            raise InputError(
                f"image of {width}×{height} pixels is too small at {pitch * 1e6:.0f} µm a pixel; "
                f"{32 * self.step} pixels a side are needed"
            )
        areas = calibration.pixel_areas(width, height, self.step)
        self.areas = areas[: self.shape[0], : self.shape[1]] * np.float32(self.step**2)
        self.period = settings.ridge_period / self.pitch

    def to_plate(self, working: np.ndarray, box: tuple[slice, slice]) -> np.ndarray:
        """(n, 2) m from working pixels of a box; pixel centres are at integers."""
        pixels = (working + [box[1].start, box[0].start] + 0.5) * self.step - 0.5
        return self.calibration.to_plate(pixels, *self.size)


class ContactSegmenter:
    """Measures frames of one camera, one after the other.

    The background is learned from frames without contact as they pass (`settings.learn_background`), so that the
    same frames in the same order give the same results, live or from a bag. Memory does not grow.
    """

    def __init__(
        self,
        settings: SegmenterSettings | None = None,
        calibration: PlateCalibration | None = None,
    ) -> None:
        self.settings = settings or SegmenterSettings()
        self.calibration = calibration or PlateCalibration.from_area_per_pixel(PAPER_AREA_PER_PIXEL)
        self.background = LearnedBackground(self.settings.background_frames)
        self.steps: Steps | None = None
        self._geometry: _Geometry | None = None

    # Public ----------------------------------------------------------------------------------

    def learn(self, image: np.ndarray) -> None:
        """Take a frame (H, W) as contact-free."""
        image = as_mono8(image)
        self.background.add(self._reduce(image, self._prepare(image)))

    def reset(self) -> None:
        """Forget the background."""
        self.background.clear()

    def process(self, image: np.ndarray) -> ContactMeasurement:
        """Measure one frame (H, W) uint8; raises InputError for an image that cannot be used."""
        image = as_mono8(image)
        geometry = self._prepare(image)
        frame = self._reduce(image, geometry)
        measurement = self._measure(frame, geometry)
        if self.settings.learn_background and measurement.flags & ContactFlag.NO_CONTACT:
            self.background.add(frame)
        return measurement

    def overlay(self, image: np.ndarray, measurement: ContactMeasurement) -> np.ndarray:
        """(H, W, 3) uint8 BGR: the frame with outline, ellipse and areas drawn in."""
        image = as_mono8(image)
        height, width = image.shape
        picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        if len(measurement.hull):
            t = np.linspace(0, 2 * math.pi, 72)
            c, s = math.cos(measurement.ellipse_angle), math.sin(measurement.ellipse_angle)
            u = measurement.ellipse_major / 2 * np.cos(t)
            v = measurement.ellipse_minor / 2 * np.sin(t)
            x, y = measurement.centroid
            ellipse = np.column_stack([x + c * u - s * v, y + s * u + c * v])
            for points, colour in ((ellipse, (255, 160, 0)), (measurement.hull, (0, 200, 0))):
                points = self.calibration.to_pixels(points, width, height)
                points = np.rint(np.clip(points, -1e4, 1e4)).astype(np.int32)
                cv2.polylines(picture, [points], True, colour, 2, cv2.LINE_AA)
        flags = [f.name for f in ContactFlag if measurement.flags & f and f.name]
        lines = [
            f"gross {measurement.gross_area * 1e6:.1f} mm2, real {measurement.real_area * 1e6:.1f} mm2",
            ", ".join(flags).lower().replace("_", " "),
        ]
        # Text on a dark bar: drawn twice, thick and thin, letters of OpenCV 5 are of different width.
        scale = max(width / 1100, 0.4)
        line_height = round(38 * scale)
        for index, line in enumerate(filter(None, lines)):
            (text_width, _), _ = cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
            top = index * line_height
            corner = (text_width + round(24 * scale), top + line_height)
            cv2.rectangle(picture, (0, top), corner, (0, 0, 0), cv2.FILLED)
            where = (round(12 * scale), top + round(27 * scale))
            cv2.putText(
                picture, line, where, cv2.FONT_HERSHEY_SIMPLEX, scale, (255,) * 3, 1, cv2.LINE_AA
            )
        return picture

    # Steps -----------------------------------------------------------------------------------

    def _prepare(self, image: np.ndarray) -> _Geometry:
        size = (image.shape[1], image.shape[0])
        if self._geometry is None or self._geometry.size != size:
            self._geometry = _Geometry(*size, self.calibration, self.settings)
        return self._geometry

    @staticmethod
    def _reduce(image: np.ndarray, geometry: _Geometry) -> np.ndarray:
        rows, columns = geometry.shape
        cut = image[: rows * geometry.step, : columns * geometry.step]
        if geometry.step == 1:
            return cut
        return cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)

    def _measure(self, frame: np.ndarray, geometry: _Geometry) -> ContactMeasurement:
        settings = self.settings
        plate, bright_ridges, learned, noise = self._plate(frame, geometry)
        flags = ContactFlag(0)
        if not learned:
            flags |= ContactFlag.NO_BACKGROUND
        if not self.calibration.calibrated:
            flags |= ContactFlag.UNCALIBRATED
        contrast, noise = _contrast(frame, plate, bright_ridges, noise)
        self.steps = Steps(frame, plate, contrast)
        nothing = ContactMeasurement(flags=int(flags | ContactFlag.NO_CONTACT))

        # Skin beyond doubt, at a quarter of the working resolution: where to look closer.
        columns, rows = contrast.shape[1] // 2, contrast.shape[0] // 2
        half = cv2.resize(contrast, (columns, rows), interpolation=cv2.INTER_AREA)
        floor = settings.minimum_contrast * 255 * (1.0 if learned else GUESSED_CAUTION)
        level = _typical_contrast(half, floor)
        if level == 0:
            return nothing
        strong = max(floor, STRONG_SHARE * level)
        core = _density(_above(half, strong), 2, geometry)
        box = _box(core, geometry)
        if box is None:
            return nothing

        certain = learned or noise < 0.5
        # A plate so even that its noise is gone is clipped to white: no earlier print could show on it.
        faint = max(
            FAINT_CONTRAST * 255,
            (FAINT_SHARE if certain else FAINT_SHARE_GUESSED) * level,
            min(5 * noise, 0.6 * strong),
        )
        ridges, rim = _ridges(contrast[box], faint, geometry)
        region, several = self._region(core[_quarter(box)], ridges, geometry)
        if region is None:
            return nothing
        ridges &= region
        rim &= region
        self.steps = Steps(frame, plate, contrast, box, ridges, rim, region)
        if not learned and cv2.mean(contrast[box], ridges)[0] < floor:
            return nothing

        outline = self._outline(rim, ridges, geometry, box)
        if outline is None:
            return nothing
        shape, real, hull = outline
        if shape.area < settings.minimum_area or (not learned and real < GUESSED_MINIMUM):
            return nothing
        if several:
            flags |= ContactFlag.MULTIPLE_REGIONS
        flags |= self._quality(frame, contrast[box], ridges, shape, real, hull, geometry, box)
        return ContactMeasurement(
            gross_area=shape.area,
            real_area=min(real, shape.area),
            area_sd=self._deviation(shape),
            centroid=shape.centroid,
            ellipse_major=shape.major,
            ellipse_minor=shape.minor,
            ellipse_angle=shape.angle,
            hull=hull,
            flags=int(flags),
        )

    def _plate(
        self, frame: np.ndarray, geometry: _Geometry
    ) -> tuple[np.ndarray, bool, bool, float]:
        """Background (h, w) uint8, whether ridges are bright, whether it was learned, noise in greys."""
        learned = self.background.image
        if learned is not None and learned.shape == frame.shape:
            # Gain and exposure may drift: the median tile is plate as long as a finger covers less than half.
            reference = self.background.tiles.astype(np.float32)
            tiles = tile_means(frame).astype(np.float32)
            gain = float(np.median(tiles / np.maximum(reference, 1)))
            plate = cv2.convertScaleAbs(learned, alpha=gain)
            bright = float(np.sum(tiles - gain * reference)) > 0
            return plate, self._bright(bright), True, self.background.noise
        mean, deviation = tile_statistics(frame)
        bright = self._bright(guess_polarity(mean, deviation))
        envelope = round(1.6 * geometry.period)
        plate = guess_background(frame, mean, deviation, bright, envelope)
        return plate, bright, False, float(np.percentile(deviation, 10))

    def _bright(self, guess: bool) -> bool:
        return guess if self.settings.polarity == "auto" else self.settings.polarity == "bright"

    def _region(
        self, core: np.ndarray, ridges: np.ndarray, geometry: _Geometry
    ) -> tuple[np.ndarray | None, bool]:
        """Mask of the pressing finger's region in the box, and whether others were left out.

        Regions hang together by the density of ridges; the one with most skin beyond doubt is the pressing finger.
        """
        beyond = _above(core, DENSITY * 255)
        size = round(REACH / (2 * geometry.pitch)) | 1
        near = cv2.dilate(beyond, np.ones((size, size), np.uint8))
        dense = _above(_density(ridges, 4, geometry), DENSITY * 255)
        dense = cv2.bitwise_and(dense, near)
        count, labels = cv2.connectedComponents(dense, connectivity=8)
        if count < 2:
            return None, False
        weight = np.bincount(labels[beyond > 0], minlength=count)
        weight[0] = 0
        best = int(np.argmax(weight))
        if weight[best] == 0:
            return None, False
        other = max(0.05 * weight[best], OTHER_REGION / (4 * geometry.pitch) ** 2)
        several = int(np.sum(weight > other)) > 1
        main = np.where(labels == best, np.uint8(255), np.uint8(0))
        rows, columns = ridges.shape
        return cv2.resize(main, (columns, rows), interpolation=cv2.INTER_NEAREST), several

    def _outline(
        self,
        rim: np.ndarray,
        ridges: np.ndarray,
        geometry: _Geometry,
        box: tuple[slice, slice],
    ) -> tuple[Shape, float, np.ndarray] | None:
        """Shape, real area (m²) and outline (n, 2) m; None where nothing is left."""
        convex = self.settings.outline == "convex"
        corners = (
            convex_corners(rim) if convex else closed_outline(rim, round(1.6 * geometry.period))
        )
        if len(corners) < 3:
            return None
        outline = geometry.to_plate(corners, box)
        shape = Shape(outline)
        if shape.area <= 0:
            return None
        real = float(cv2.mean(geometry.areas[box], ridges)[0]) * cv2.countNonZero(ridges)
        touching = min(1.0, real / shape.area)
        margin = FURROW * self.settings.ridge_period * (1 - touching) ** 2
        outline = widened(outline, margin) if convex else shifted(outline, margin)
        return Shape(outline), real, outline

    def _quality(
        self,
        frame: np.ndarray,
        contrast: np.ndarray,
        ridges: np.ndarray,
        shape: Shape,
        real: float,
        hull: np.ndarray,
        geometry: _Geometry,
        box: tuple[slice, slice],
    ) -> ContactFlag:
        flags = ContactFlag(0)
        width, height = geometry.size
        pixels = self.calibration.to_pixels(hull, width, height)
        # Skin beyond the last ridge may lie outside the image.
        margin = geometry.period * geometry.step
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        if low.min() < margin or high[0] > width - 1 - margin or high[1] > height - 1 - margin:
            flags |= ContactFlag.CLIPPED
        if real < 0.2 * shape.area or shape.area < 5e-6:
            flags |= ContactFlag.SPARSE
        if cv2.mean(contrast, ridges)[0] < 1.7 * self.settings.minimum_contrast * 255:
            flags |= ContactFlag.LOW_CONTRAST
        inside = cv2.inRange(frame[box], 1, 254)
        tiles = tile_means(frame)
        plate_ends = np.mean((tiles >= 254) | (tiles <= 1)) > 0.2
        if plate_ends or cv2.mean(inside, ridges)[0] < 0.8 * 255:
            flags |= ContactFlag.SATURATED
        return flags

    def _deviation(self, shape: Shape) -> float:
        """Standard deviation (m²): independent errors of the outline, one per ridge period along it, and a common
        relative one. Both sizes from rendered frames (docs/vision.md)."""
        period = self.settings.ridge_period
        edge = 0.25 * period * math.sqrt(period * shape.perimeter)
        return math.hypot(edge, 0.015 * shape.area)


def _contrast(
    frame: np.ndarray, plate: np.ndarray, bright_ridges: bool, noise: float
) -> tuple[np.ndarray, float]:
    """Contrast (h, w) uint8 of touching skin, 255 for all of the light, and the noise in the same unit."""
    if bright_ridges:
        return cv2.subtract(frame, plate), noise
    # Relative to the light that falls there, so that vignetting does not matter.
    light = cv2.max(plate, np.array([DARKEST]))
    contrast = cv2.divide(cv2.subtract(plate, frame), light, scale=255)
    return contrast, noise * 255 / float(cv2.mean(light[::8, ::8])[0])


def _above(image: np.ndarray, limit: float) -> np.ndarray:
    """Mask of pixels above a limit."""
    return cv2.threshold(image, limit, 255, cv2.THRESH_BINARY)[1]


def _typical_contrast(contrast: np.ndarray, floor: float) -> float:
    """Median contrast of what is above the floor; 0 without any."""
    histogram = cv2.calcHist([contrast], [0], None, [256], [0, 256]).ravel()
    histogram[: int(floor) + 1] = 0
    total = histogram.sum()
    return float(np.searchsorted(np.cumsum(histogram), 0.5 * total)) if total > 0 else 0.0


def _density(mask: np.ndarray, step: int, geometry: _Geometry) -> np.ndarray:
    """Share (0…255) of a mask within 2.5 ridge periods, `step` times coarser than the mask."""
    size = (-(-mask.shape[1] // step), -(-mask.shape[0] // step))
    coarse = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    window = max(3, round(2.5 * geometry.period / 4) | 1)
    return cv2.blur(coarse, (window, window), borderType=cv2.BORDER_REPLICATE)


def _box(core: np.ndarray, geometry: _Geometry) -> tuple[slice, slice] | None:
    """Rows and columns, multiples of 4, that hold all skin with the reach around it; None without any."""
    mask = _above(core, DENSITY * 255)
    left, top, width, height = cv2.boundingRect(mask)
    if width == 0:
        return None
    margin = math.ceil((REACH / geometry.pitch + 2 * geometry.period) / 4)
    rows, columns = geometry.shape
    return (
        slice(4 * max(top - margin, 0), min(4 * (top + height + margin), rows)),
        slice(4 * max(left - margin, 0), min(4 * (left + width + margin), columns)),
    )


def _quarter(box: tuple[slice, slice]) -> tuple[slice, slice]:
    """The box on a grid four times coarser."""
    rows, columns = box
    return (
        slice(rows.start // 4, -(-rows.stop // 4)),
        slice(columns.start // 4, -(-columns.stop // 4)),
    )


def _ridges(
    contrast: np.ndarray, faint: float, geometry: _Geometry
) -> tuple[np.ndarray, np.ndarray]:
    """Masks of ridge pixels: down to half their local contrast, and down to the outermost trace."""
    height, width = contrast.shape
    half = cv2.resize(contrast, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    reach = max(3, round(0.5 * geometry.period) | 1)
    local = cv2.dilate(half, np.ones((reach, reach), np.uint8))
    local = cv2.resize(
        cv2.blur(local, (reach, reach)), (width, height), interpolation=cv2.INTER_LINEAR
    )
    lowest = np.array([faint])
    ridges, rim = (
        cv2.compare(contrast, cv2.max(cv2.convertScaleAbs(local, alpha=share), lowest), cv2.CMP_GT)
        for share in (RIDGE_LEVEL, RIM_LEVEL)
    )
    return ridges, rim
