# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""FTIR area sensor: from one frame of a finger on lit glass to the contact's areas and shape.

Steps: reduce to about 60 µm a pixel; background (learned, or guessed from the frame); contrast
against it; ridges by a threshold that follows the local contrast; the pressing finger's region by
the density of ridges; its convex hull (gross area, as in Nam and Kuchenbecker, IEEE Trans. Haptics
14(2), 2021) or closed outline; ridge pixels times their area on the plate (real area).
`docs/vision_method.md` shows each step in pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_common.mono8 import Mono8, OneChannel
from finger_common.settings import Settings, setting

from .area_sensor import AreaSensor, ContactMeasurement, NoLight
from .background import POLARITIES, Background, LearnedBackground, background_of, tile_means
from .calibration import PlateCalibration
from .lost_pixels import has_lost_pixels
from .outline import (
    Shape,
    closed_outline,
    convex_corners,
    empty_share,
    filled,
    has_lobes,
    shifted,
    widened,
)
from .regions import Followed
from .ridges import Ridges, contrast_of, find_ridges, fine_structure
from .working_grid import WorkingGrid

GUESSED_MINIMUM = 1.0e-6
"""m², gross area below which a region is dust where no background was learned."""

COARSEST = 2.3
"""Working pixels a ridge period below which ridges run into one another."""

IN_NOISE = 5.0
"""Contrast of the ridges over a pixel's noise below which the faint rim is lost in it."""

LEAST_STRUCTURE, SMEARED = 0.085, 0.24
"""Fine structure below which no ridges are seen, and share of that of another direction below which
the finger has moved. Sharp rendered contacts have 0.093 or more, and 0.26; real prints 0.13 and
0.40. Out of focus by a third of a ridge period contacts have 0.075 at most, and a smooth patch, as
of a shadow, 0.06; of those moved by two periods five in six have less than one of both."""

PALE, PALE_AREA = 2 / 3, 5e-6
"""Share of `minimum_contrast` at which a frame without contact is looked at again where no
background was learned, and size (m²) of a region that is then taken for a print too pale."""

CUT_OFF = 5.0, 250.0
"""Greys down to and from which a plate of one grey was certainly cut off."""

GREYS = 0.6
"""Between these it counts as cut off where the ridges show more than this share of the greys beyond
it: 0.60 or more in real prints that were darkened later, up to 0.75 in rendered frames, under 0.35
in drawn ones."""

DIM = 30.0
"""Greys of a plate below which dark ridges are lost in noise: of dry skin at 25, not at 30."""

WHITE = 0.9
"""Share of white pixels above which a picture is overexposed, where the learned plate was not."""

UNSURE = 1.2
"""Deviation where it is not known whether a plate was cut off, over that of one that was."""

ONE_GREY = 0.2
"""Standard deviation of the saturated share of the plate above which the area is in doubt."""

SHARP_RIM, BLUR = 20e-6, 1.4
"""Width (m) from half of the contrast out to the outermost trace in a sharp picture; and what a
blurred one's outline is too far out, in widths above that (rendered frames)."""


EMPTY, EMPTY_SD = 0.05, 2.0
"""Share of the hull without ridges up to which a contact is convex, and standard deviation of the
area for what is beyond it: something is joined with the contact."""

LOBES = 0.6
"""Two discs of this share of the widest one, joined by something narrower, are two contacts."""

FINE, OUTSIDE, OUTSIDE_SD = 50e-6, 0.5, 0.75
"""A camera's pixels (m) up to which outlines are as in rendered frames of 31 µm; and pixels by
which the hull of larger ones lies outside a contact, with the standard deviation: edges along the
pixels and across them, sharp and faint ones differ."""


@dataclass(frozen=True)
class FtirSettings(Settings):
    """Settings of the FTIR segmentation."""

    outline: str = setting(
        "convex",
        "Outline that bounds the gross area: the convex hull of the ridges, as in the paper, or a "
        "closed outline that does not bridge gaps.",
        choices=("convex", "concave"),
    )
    polarity: str = setting(
        "auto",
        "Whether touching ridges are darker or brighter than the plate.",
        choices=POLARITIES,
        advice="Set it where frames are very noisy or the finger fills the image.",
    )
    ridge_period: float = setting(
        0.5e-3,
        "Distance from ridge to ridge; 0.4 to 0.6 mm in adults.",
        unit="m",
        minimum=0.2e-3,
        maximum=1.5e-3,
    )
    minimum_contrast: float = setting(
        0.15,
        "Weakest ridge that counts, as a fraction of the plate's brightness (dark ridges) or of "
        "the grey range.",
        minimum=0.02,
        maximum=0.9,
        advice="Raise it when latent prints count; lower it when dry rims are lost.",
    )
    minimum_area: float = setting(
        0.5e-6,
        "Smallest gross area that counts as a contact.",
        unit="m²",
        minimum=0.0,
        maximum=1e-4,
    )
    furrow_margin: float = setting(
        0.26,
        "Skin outside the outermost ridge that counts as contact, in ridge periods times the "
        "squared share of the contact that does not touch.",
        minimum=0.0,
        maximum=2.0,
        advice="0 gives the hull of the ridges alone; docs/vision_method.md has the effect.",
    )
    furrow_margin_saturated: float = setting(
        0.85,
        "The same, if the plate around the contact is saturated, which hides the faint rim.",
        minimum=0.0,
        maximum=2.0,
        advice="Set it to furrow_margin for the outline of what is visible.",
    )
    working_pixel: float = setting(
        60e-6,
        "Frames are reduced to pixels of about this size before they are measured.",
        unit="m",
        minimum=10e-6,
        maximum=150e-6,
        advice="Larger is faster and less accurate.",
    )
    background_frames: int = setting(
        50,
        "Contact-free frames after which an older one counts 1/e in the background.",
        minimum=1,
        maximum=10000,
    )


@dataclass
class Steps:
    """Pictures (h, w) uint8 of the last frame's steps at working resolution, for documentation.

    ridges: None without contact.
    """

    frame: np.ndarray
    background: np.ndarray
    contrast: np.ndarray
    ridges: Ridges | None


class FtirSegmenter(AreaSensor):
    """Ridges on an FTIR plate. Frames of one camera are measured one after the other."""

    SETTINGS = FtirSettings

    def __init__(
        self,
        settings: FtirSettings | None = None,
        calibration: PlateCalibration | None = None,
    ) -> None:
        self.settings = settings or FtirSettings()
        self.calibration = calibration or PlateCalibration()
        self.steps: Steps | None = None
        self._background = LearnedBackground(self.settings.background_frames)
        self._mono8 = Mono8(dark=self.settings.polarity == "bright")
        self._grid: WorkingGrid | None = None
        self._followed: Followed | None = None
        self._pale = False
        """Whether the last frame without contact shows a print that is too pale."""
        self._size: tuple[int, int] | None = None
        """(width, height) of the frames since the last reset."""

    @property
    def learned(self) -> int:  # type: ignore[override]
        """Number of contact-free frames in the background."""
        return self._background.count

    def learn(self, signal: np.ndarray) -> None:
        """Add a contact-free frame (H, W) to the background."""
        self._background.add(self._reduced(signal)[0])
        self._followed = None

    def reset(self) -> None:
        """Forget the background, the finger that is followed, the size of the frames and the
        channel of a colour camera."""
        self._background.clear()
        self._mono8.colour = OneChannel()
        self._followed = self._size = None

    def measure(self, signal: np.ndarray) -> ContactMeasurement:
        """The contact in a frame (H, W); raises InputError for one that cannot be used, NoLight for
        one much darker than the background, blank or overexposed.
        """
        return self._measure(*self._reduced(signal))[0]

    def process(self, signal: np.ndarray) -> ContactMeasurement:
        """Measure a frame and learn the background from it if it shows no contact."""
        frame, grid = self._reduced(signal)
        measurement, bright_ridges = self._measure(frame, grid)
        if measurement.flags & AreaFlag.NO_CONTACT:
            if measurement.flags & AreaFlag.NO_BACKGROUND or self._learned_one_grey(frame):
                # There was none, or one that was learned before the light was on, or no picture.
                self._background.clear()
            if not self._pale:
                self._background.add(frame)
        elif not bright_ridges or self.settings.polarity == "bright":
            # Sweat that was learned and then wiped off is dark: among bright ridges that are not
            # set, it would be taken for dark ones.
            self._background.touched()
        return measurement

    def _reduced(self, signal: np.ndarray) -> tuple[np.ndarray, WorkingGrid]:
        channel = self._mono8.colour.channel
        image = self._mono8(signal)
        if channel not in (None, self._mono8.colour.channel):
            self._background.clear()
            self._followed = None
        size = (image.shape[1], image.shape[0])
        self.calibration.check_size(*size)
        if self._size is not None and self._size != size:
            raise InputError(
                f"image is {size[0]}×{size[1]}, earlier ones were {self._size[0]}×{self._size[1]}, "
                "and a plain area per pixel may not hold for both; set the camera's size, reset "
                "where a pixel still covers that area, or give a calibration of the plate"
            )
        if self._grid is None or self._grid.size != size:
            self._grid = WorkingGrid(
                size, self.calibration, self.settings.working_pixel, self.settings.ridge_period
            )
        self._size = size
        plate = self._background.image
        if plate is not None and plate.shape != self._grid.shape:
            plate = None
        if has_lost_pixels(image, plate, self._grid):
            raise InputError(
                "the image is incomplete: rows, or long parts of them, are exactly black; look for "
                "lost packets (network, USB bandwidth), or lower the rate of the camera"
            )
        return self._grid.reduce(image), self._grid

    def _measure(self, frame: np.ndarray, grid: WorkingGrid) -> tuple[ContactMeasurement, bool]:
        """The contact in a working image, and whether ridges are brighter than the plate."""
        settings = self.settings
        background = background_of(frame, self._background, settings.polarity, grid.period)
        if not background.lit:
            raise NoLight(
                "the plate is dark, and contacts are not seen; check light, lens and exposure"
            )
        if background.learned and self._is_blank(frame):
            raise NoLight(
                "the picture is blank or overexposed, and contacts are not seen; check camera, "
                "light and exposure"
            )
        frame = background.frame
        contrast, noise = contrast_of(background)
        ridges = find_ridges(
            contrast,
            noise,
            background.learned,
            settings.minimum_contrast,
            grid,
            self._followed,
            background.one_grey,
        )
        self.steps = Steps(frame, background.image, contrast, ridges)
        flags = AreaFlag(0)
        if not background.learned:
            flags |= AreaFlag.NO_BACKGROUND
        if not self.calibration.calibrated:
            flags |= AreaFlag.UNCALIBRATED
        outlined = None
        if ridges is not None:
            saturated, in_doubt = _saturated_share(frame, ridges, background.bright_ridges)
            outlined = self._outline(ridges, grid, saturated, in_doubt)
        smallest = max(settings.minimum_area, 0.0 if background.learned else GUESSED_MINIMUM)
        if ridges is None or outlined is None or outlined[0].area < smallest:
            flags |= AreaFlag.NO_CONTACT
            self._pale = not background.learned and self._is_pale(contrast, noise, grid)
            if not self._pale:
                self._followed = None
            dim = float(np.median(tile_means(background.image))) < DIM
            if self._pale or (dim and settings.polarity != "bright"):
                flags |= AreaFlag.LOW_CONTRAST
            return ContactMeasurement(flags=int(flags)), background.bright_ridges
        self._followed = ridges.followed
        shape, real_area, hull, doubt, lobes = outlined
        if ridges.other_regions:
            flags |= AreaFlag.MULTIPLE_REGIONS
        cut = self._is_clipped(hull, grid) or _reaches(ridges, background.border, grid)
        if cut or lobes or ridges.followed.open:
            flags |= AreaFlag.CLIPPED
        if real_area < 0.2 * shape.area or shape.area < 5e-6:
            flags |= AreaFlag.SPARSE
        lost = background.learned and ridges.contrast < IN_NOISE * noise
        pale = ridges.contrast < 1.7 * settings.minimum_contrast * 255
        coarse = grid.period < COARSEST
        if lost or pale or coarse or _lacks_ridges(background, ridges, grid):
            flags |= AreaFlag.LOW_CONTRAST
        if in_doubt > ONE_GREY or _is_saturated(frame, ridges):
            flags |= AreaFlag.SATURATED
        area_sd, rim = self._standard_deviation(shape, doubt), self._rim_deviation(shape)
        # How much of a contact lies outside the picture is not known.
        centroid_sd, major_sd, minor_sd, angle_sd = (
            (math.nan,) * 4 if flags & AreaFlag.CLIPPED else ellipse_deviations(shape, area_sd, rim)
        )
        measurement = ContactMeasurement(
            gross_area=shape.area,
            real_area=min(real_area, shape.area),
            area_sd=area_sd,
            centroid=shape.centroid,
            ellipse_major=shape.major,
            ellipse_minor=shape.minor,
            ellipse_angle=shape.angle,
            hull=hull,
            flags=int(flags),
            centroid_sd=centroid_sd,
            ellipse_major_sd=major_sd,
            ellipse_minor_sd=minor_sd,
            ellipse_angle_sd=angle_sd,
        )
        return measurement, background.bright_ridges

    def _outline(
        self, ridges: Ridges, grid: WorkingGrid, saturated: float, in_doubt: float
    ) -> tuple[Shape, float, np.ndarray, float, bool] | None:
        """Shape, real area (m²), outline (n, 2) m, the standard deviation of the area (m²) that
        saturation, blur, coarse pixels, doubtful parts and an empty part of the hull add, and
        whether there are two contacts.

        saturated, in_doubt: as of `_saturated_share`. None where nothing is left.
        """
        # The mean width of a square is 4 / π times its side.
        coarse = max(0.0, 1 - FINE * grid.step / grid.pitch)
        half = 0.5 - coarse * OUTSIDE * math.pi / 4
        hull = convex_corners(ridges.outermost, half)
        convex = self.settings.outline == "convex"
        gap = round(1.6 * grid.period)
        corners = hull if convex else closed_outline(ridges.outermost, gap, half)
        if len(corners) < 3:
            return None
        outline = grid.to_plate(corners, ridges.box)
        shape = Shape(outline)
        if shape.area <= 0:
            return None
        pixel_area = float(cv2.mean(grid.areas[ridges.box], ridges.touching)[0])
        real_area = pixel_area * cv2.countNonZero(ridges.touching)
        settings = self.settings
        touching_share = min(1.0, real_area / shape.area)
        furrow = settings.ridge_period * (1 - touching_share) ** 2
        extra = settings.furrow_margin_saturated - settings.furrow_margin
        margin = max((settings.furrow_margin + saturated * extra) * furrow, 0.0)
        outline = widened(outline, margin) if convex else shifted(outline, margin)
        shape = Shape(outline)
        traced = _pixels_in(hull)
        touched = _pixels_in(convex_corners(ridges.touching, half))
        rim = (traced - touched) * grid.pitch**2 / shape.perimeter
        blurred = BLUR * max(rim - SHARP_RIM, 0.0)
        apart = 0.0
        if ridges.doubtful is not None:
            most = convex_corners(cv2.bitwise_or(ridges.outermost, ridges.doubtful))
            least = convex_corners(cv2.subtract(ridges.outermost, ridges.doubtful))
            apart = (_pixels_in(most) - _pixels_in(least)) * grid.pitch**2
        hidden = in_doubt * extra * furrow
        rough = coarse * OUTSIDE_SD * grid.pitch
        covered = filled(ridges.outermost, 2.5 * grid.period, 4)
        empty = max(empty_share(covered) - EMPTY, 0.0) if convex else 0.0
        doubt = math.hypot(
            *(x * shape.perimeter for x in (hidden, blurred, rough)),
            apart,
            EMPTY_SD * empty * shape.area,
        )
        return shape, real_area, outline, doubt, has_lobes(covered, LOBES)

    def _is_pale(self, contrast: np.ndarray, noise: float, grid: WorkingGrid) -> bool:
        """Whether a frame without contact shows a print that is too pale to count."""
        contrast_needed = PALE * self.settings.minimum_contrast
        ridges = find_ridges(contrast, noise, False, contrast_needed, grid)
        return ridges is not None and (cv2.countNonZero(ridges.region) * grid.pitch**2 > PALE_AREA)

    def _is_blank(self, frame: np.ndarray) -> bool:
        """Whether a working image shows nothing of the learned plate: it is of one grey, or nearly
        all white, and the plate is not."""
        plate = self._background.image
        assert plate is not None
        if cv2.countNonZero(cv2.inRange(frame, 255, 255)) > WHITE * frame.size:
            return float(np.median(plate)) < 255
        return _is_of_one_grey(frame) and not _is_of_one_grey(plate)

    def _learned_one_grey(self, frame: np.ndarray) -> bool:
        """Whether pictures of one grey alone were learned, and a working image is another."""
        plate = self._background.image
        return plate is not None and _is_of_one_grey(plate) and not _is_of_one_grey(frame)

    def _is_clipped(self, hull: np.ndarray, grid: WorkingGrid) -> bool:
        """Whether the outline comes within a ridge period of the image's border.

        Skin beyond the last ridge may lie outside the image.
        """
        width, height = grid.size
        pixels = self.calibration.to_pixels(hull, width, height)
        margin = grid.period * grid.step
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        return bool(
            low.min() < margin or high[0] > width - 1 - margin or high[1] > height - 1 - margin
        )

    def _standard_deviation(self, shape: Shape, doubt: float) -> float:
        """Standard deviation of the gross area, m².

        Independent errors of the outline, one per ridge period along it; a common relative error;
        `doubt` (m²), as of `_outline`. The first two sizes come from rendered frames
        (docs/vision_method.md).
        """
        return math.hypot(self._rim_deviation(shape), 0.015 * shape.area, doubt)

    def _rim_deviation(self, shape: Shape) -> float:
        """Part of the standard deviation (m²) that is of independent errors along the outline."""
        period = self.settings.ridge_period
        return 0.25 * period * math.sqrt(period * shape.perimeter)


def ellipse_deviations(
    shape: Shape, area_sd: float, rim: float
) -> tuple[float, float, float, float]:
    """Standard deviations of centroid (each coordinate), major and minor axis (m), and angle (rad).

    area_sd: of the area, m². rim: the part of it that is of independent errors along the outline;
    they move the moments of an ellipse as integrals along its rim say. All else is common: it moves
    the whole outline outwards by one width, of which the minor axis has the larger share. The
    errors along the outline make an ellipse of a circle, too: by what they add on average to
    (a² − b²)² the contact is rounder than it looks.
    """
    share = rim / shape.area
    width = math.sqrt(max(area_sd**2 - rim**2, 0.0)) / shape.perimeter
    a, b = shape.major / 2, shape.minor / 2
    noise = math.sqrt(8) * share * a * b  # of the two components of a² − b²
    longer = math.sqrt(max((a * a - b * b) ** 2 - 2 * noise**2, 0.0))
    major_sd, minor_sd = (
        math.hypot(math.sqrt(0.75) * share * axis, 2 * width) for axis in (shape.major, shape.minor)
    )
    # No direction is known of a circle.
    angle = min(noise / 2 / max(longer, 1e-12), math.pi / math.sqrt(12))
    return share * math.sqrt(a * b / 2), major_sd, minor_sd, angle


def _lacks_ridges(background: Background, ridges: Ridges, grid: WorkingGrid) -> bool:
    """Whether a contact of some contrast may be a shadow, or is blurred too much."""
    least, most = fine_structure(background, ridges, grid.period)
    return least < max(LEAST_STRUCTURE, SMEARED * most)


def _is_of_one_grey(image: np.ndarray) -> bool:
    low, high = cv2.minMaxLoc(image)[:2]
    return bool(low == high)


def _pixels_in(corners: np.ndarray) -> float:
    """Area of a hull (n, 2) in pixels, pixels²."""
    return cv2.contourArea(corners.astype(np.float32)) if len(corners) else 0.0


def _reaches(ridges: Ridges, border: np.ndarray | None, grid: WorkingGrid) -> bool:
    """Whether ridges lie within a ridge period of a dark border."""
    if border is None:
        return False
    size = 2 * math.ceil(grid.period) + 1
    near = cv2.dilate(ridges.outermost, np.ones((size, size), np.uint8))
    return bool(cv2.bitwise_and(near, border[ridges.box]).any())


def _saturated_share(frame: np.ndarray, ridges: Ridges, bright_ridges: bool) -> tuple[float, float]:
    """Share of the plate around the contact that is saturated, and standard deviation of it.

    Noise and vignetting leave next to no pixel at the plate's end of the greys; saturation leaves
    most of them there, also after a later change of gain or gamma. A drawn plate, or one whose
    noise was removed, is of one grey as well.
    """
    around = cv2.bitwise_not(ridges.region)
    pixels = cv2.countNonZero(around)
    if pixels == 0:
        return 0.0, 0.0
    part = frame[ridges.box]
    # Hot pixels and reflections may be brighter than the plate.
    below = np.cumsum(cv2.calcHist([part], [0], around, [256], [0, 256]))
    end = float(np.searchsorted(below, (0.005 if bright_ridges else 0.995) * pixels))
    at_end = cv2.bitwise_and(cv2.compare(part, np.array([end]), cv2.CMP_EQ), around)
    share = cv2.countNonZero(at_end) / pixels
    # What was hidden differs from print to print by as much as the margin for it.
    if not CUT_OFF[0] < end < CUT_OFF[1]:
        return share, share
    greys = cv2.countNonZero(cv2.calcHist([part], [0], ridges.touching, [256], [0, 256]))
    return (share if greys > GREYS * abs(end - 255 * bright_ridges) else 0.0), UNSURE * share


def _is_saturated(frame: np.ndarray, ridges: Ridges) -> bool:
    """Whether a fifth of the plate, or of the ridges, is at an end of the grey scale."""
    tiles = tile_means(frame)
    if np.mean((tiles >= 254) | (tiles <= 1)) > 0.2:
        return True
    inside = cv2.inRange(frame[ridges.box], 1, 254)
    return bool(cv2.mean(inside, ridges.touching)[0] < 0.8 * 255)
