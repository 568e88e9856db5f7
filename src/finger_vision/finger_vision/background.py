# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The plate without a finger: learned from contact-free frames, or guessed from one frame.

All images here are at the segmenter's working resolution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

TILE = 16
"""Working pixels per side of a tile, about 1 mm: more than a ridge, less than a finger."""

PLATE_SHARE, ONE_RATIO = 0.3, 0.05
"""Share of the frame that is plate at least, and relative spread of its brightness."""

OTHER_LIGHT, DARK = 5.0, 10.0
"""Factor and greys by which the plate is brighter or darker than the learned one when the light was
off in one of the two."""

MOVED_LIGHT, MOVED_SHARE = 0.03, 0.03
"""Light has moved where plate tiles differ from the learned ones by this, relative; and the least
share of the plate's tiles that do."""

LEVEL, BRIGHT_LEVEL = 150.0, 60.0
"""Greys of a plate of unchanged light in a frame that was divided by the learned plate, and in one
from which it was subtracted."""

SHADE, FLOODED = 8.0, 60.0
"""Greys, after that, by which a shadow differs from the light around it at least, and by which skin
without furrows does."""

SKIN, ADDED_LIGHT = 16.0, 0.15
"""Greys up to which a pixel counts that differs from the plate, as skin does; and those by which
the learned plate with light added must differ less, in the mean, than one with another gain."""

BORDER_STEP, BORDER_GREYS, BORDER_EDGE = 1.25, 8.0, 3
"""Where a dark border ends, the image brightens by this factor and so many greys within so many
working pixels."""

BORDER_SIDE, BORDER_OFF = 0.6, 1.5
"""Share of a side of the image along which the edge of a border is straight, and working pixels by
which it is."""

BORDER_WIDEST, BORDER_INSIDE = 0.2, 16
"""Share of the image's width or height that a border may have, and working pixels of the plate
beside it with which it is compared."""

MARK_NOISE, MARK_GREYS, MARKS_RENEWED = 3.0, 2.0, 8
"""Steps from pixel to pixel of the learned plate up to so many standard deviations of noise and
greys are no marks. They are looked for in its first three frames and in every eighth."""

NOISELESS, SAME_GREY = 0.5, 2.0
"""Greys of noise below which a plate has none, and by which tiles of a plate of one grey differ at
most."""

POLARITIES = ("auto", "dark", "bright")
"""Touching ridges are darker or brighter than the plate; "auto" finds out in each frame."""


@dataclass(frozen=True)
class Background:
    """What one frame would show without the finger.

    image: (h, w) uint8. bright_ridges: whether touching ridges are brighter than the plate.
    learned: false where it was guessed from the frame itself. noise: standard deviation of a
    pixel, greys. frame: the frame, (h, w) uint8, with plate in place of a dark border. border: mask
    of that border; None without one. lit: whether the frame has the light that the learned one has.
    one_grey: whether a guessed plate has no noise and is of one grey, as where it is cut off.
    unmoved: `image` in light of the shape that was learned; None where the light has not moved.
    """

    image: np.ndarray
    bright_ridges: bool
    learned: bool
    noise: float
    frame: np.ndarray
    border: np.ndarray | None = None
    lit: bool = True
    one_grey: bool = False
    unmoved: np.ndarray | None = None


class LearnedBackground:
    """Running mean of contact-free frames.

    memory: number of frames after which an older one counts 1/e. One float image is kept, however
    many frames come. `count` is the number of frames, `noise` the standard deviation of a pixel of
    the newest one against the mean, in greys.
    """

    def __init__(self, memory: int = 50) -> None:
        self.memory = memory
        self.count = 0
        self.noise = 0.0
        self._since_touch = 0
        self._mean: np.ndarray | None = None
        self._grey: np.ndarray | None = None
        self._tiles = np.zeros((0, 0), np.float32)
        self._marks: dict[bool, np.ndarray] = {}
        """Greys of steep steps (h, w) uint8, by whether ridges are bright."""

    @property
    def image(self) -> np.ndarray | None:
        """(h, w) uint8, None before the first frame."""
        if self._grey is None and self._mean is not None:
            grey: np.ndarray = cv2.convertScaleAbs(self._mean)
            self._grey, self._tiles = grey, tile_statistics(grey)[0]
        return self._grey

    @property
    def tiles(self) -> np.ndarray:
        """Mean grey (rows, columns) of the tiles of `image`."""
        if self.image is None:
            raise ValueError("no background yet")
        return self._tiles

    def plate(self, bright_ridges: bool) -> np.ndarray:
        """`image` (h, w) uint8 with the darkest grey within a pixel in place of steep steps (the
        brightest, for bright ridges): marks show no ridges when the camera shakes by a pixel."""
        image = self.image
        if image is None:
            raise ValueError("no background yet")
        if bright_ridges not in self._marks:
            around = np.ones((3, 3), np.uint8)
            reached = cv2.dilate(image, around) if bright_ridges else cv2.erode(image, around)
            least = MARK_GREYS + MARK_NOISE * self.noise
            steps = cv2.absdiff(image, reached)
            self._marks[bright_ridges] = cv2.threshold(steps, least, 255, cv2.THRESH_TOZERO)[1]
        combined = cv2.add if bright_ridges else cv2.subtract
        return combined(image, self._marks[bright_ridges])

    def add(self, frame: np.ndarray) -> None:
        """Add a contact-free frame (h, w) uint8; one of another size replaces all before it."""
        if self._mean is None or self._mean.shape != frame.shape:
            self._mean = frame.astype(np.float32)
            self.count = self._since_touch = 1
            self.noise = float(np.percentile(tile_statistics(frame)[1], 10))
        else:
            self.count += 1
            self._since_touch += 1
            # Every fourth pixel both ways is enough for this estimate.
            rest = frame[::4, ::4] - self._mean[::4, ::4]
            self.noise = float(np.median(np.abs(rest - np.median(rest)))) * 1.4826
            cv2.accumulateWeighted(frame, self._mean, 1 / min(self._since_touch, self.memory))
        self._grey = None
        if self._since_touch <= 3 or self._since_touch % MARKS_RENEWED == 0:
            self._marks.clear()

    def touched(self) -> None:
        """Let all frames until now count as one from now on.

        A finger leaves sweat: the plate is no longer the one of before, and a fresh print counts as
        faint skin beside the next contact until the frames that show it outweigh the others.
        """
        self._since_touch = min(self._since_touch, 1)

    def clear(self) -> None:
        """Forget all frames."""
        self.count, self._since_touch, self.noise = 0, 0, 0.0
        self._mean = self._grey = None
        self._marks.clear()


def background_of(
    frame: np.ndarray, learned: LearnedBackground, polarity: str, ridge_period: float
) -> Background:
    """Background of a frame (h, w) uint8: the learned one if there is one, else a guess.

    polarity: one of POLARITIES. ridge_period: in working pixels.
    """
    mean, deviation = tile_statistics(frame)
    envelope = round(1.6 * ridge_period)
    if learned.image is not None and learned.image.shape == frame.shape:
        # Gain and exposure may drift; what was learned before the light was on tells nothing.
        reference = learned.tiles
        before = float(np.median(reference))
        # The learned plate is of whole greys.
        gain = gain_of(mean / np.maximum(reference, 1), ONE_RATIO + 1.0 / max(before, 1.0))
        now = gain * max(before, 1.0)
        if now <= OTHER_LIGHT * before + DARK:
            lit = before <= OTHER_LIGHT * now + DARK
            expected = gain * reference
            plate = plate_tiles(deviation)
            added = float(np.median((mean - reference)[plate])) if plate.any() else 0.0
            more = abs(added) > 1 and _light_was_added(frame, learned.image, gain, added)
            if more:
                expected = reference + added
            bright = polarity == "bright"
            if polarity == "auto":
                bright = _ridges_are_bright(mean - expected, deviation)

            def in_this_light(image: np.ndarray) -> np.ndarray:
                if more:
                    return cv2.add(image, np.array([added]))
                return cv2.convertScaleAbs(image, None, gain)

            image = in_this_light(learned.plate(bright))
            unmoved = None
            if _light_moved(mean, expected, plate) or _shade_fell(
                _reached(frame, deviation, bright, envelope), expected, bright
            ):
                unmoved = image
                light = _light(in_this_light(learned.image), frame, bright, envelope)
                if bright:
                    image = cv2.addWeighted(image, 1.0, light, 1.0, -BRIGHT_LEVEL)
                else:
                    image = cv2.multiply(image, light, scale=1.0 / LEVEL)
            return Background(image, bright, True, learned.noise, frame, lit=lit, unmoved=unmoved)
    border = dark_border(frame)
    if border is not None and polarity == "auto":
        mean, deviation = tile_statistics(_filled(frame, border, cv2.blur, envelope))
    bright = guess_polarity(mean, deviation) if polarity == "auto" else polarity == "bright"
    if border is not None:
        frame = _filled(frame, border, cv2.erode if bright else cv2.dilate, envelope)
        mean, deviation = tile_statistics(frame)
    image = guess_background(frame, mean, deviation, bright, envelope)
    noise = float(np.percentile(deviation, 10))
    one_grey = noise < NOISELESS and _is_of_one_grey(mean[plate_tiles(deviation)])
    return Background(image, bright, False, noise, frame, border, one_grey=one_grey)


def _is_of_one_grey(tiles: np.ndarray) -> bool:
    """Whether tiles (n,) of a plate have one grey. The light leaves several where compression or
    coarse greys have taken the noise away: their steps are no skin."""
    return len(tiles) > 0 and float(np.ptp(np.percentile(tiles, (10, 90)))) < SAME_GREY


def gain_of(ratios: np.ndarray, spread: float = ONE_RATIO) -> float:
    """Brightness of the plate over the learned one, from the ratios of all tiles.

    The median tile is plate as long as a finger covers less than half of the frame. Under a larger
    one the plate's tiles still have nearly one ratio, and the skin's many: then it is that of the
    narrowest group of PLATE_SHARE of the tiles, which differ by `spread` at most.
    """
    ordered = np.sort(ratios, axis=None)
    median = float(np.median(ratios))
    count = max(2, round(PLATE_SHARE * len(ordered)))
    widths = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    first = int(np.argmin(widths))
    group = float(ordered[first + count // 2])
    apart = abs(group - median) > spread * group
    return group if apart and widths[first] < spread * group else median


def _light_was_added(frame: np.ndarray, learned: np.ndarray, gain: float, added: float) -> bool:
    """Whether a frame shows the learned plate with `added` greys, as of room light, rather than
    with another gain: only that multiplies vignetting, dust and earlier prints.
    """
    size = (frame.shape[1] // 4, frame.shape[0] // 4)
    now, before = (cv2.resize(i, size, interpolation=cv2.INTER_AREA) for i in (frame, learned))

    def differs(plate: np.ndarray) -> float:
        return cv2.mean(cv2.min(cv2.absdiff(now, plate), np.array([SKIN])))[0]

    scaled = differs(cv2.convertScaleAbs(before, alpha=gain))
    return differs(cv2.add(before, np.array([added]))) + ADDED_LIGHT < scaled


def _ridges_are_bright(change: np.ndarray, deviation: np.ndarray) -> bool:
    """Whether the ridges in a frame are brighter than the plate.

    change (rows, columns): greys by which its tiles differ from the background. Tiles without
    structure count only where there are no others: reflections and shadows are smooth.
    """
    rough = ~smooth_tiles(deviation)
    return float(np.sum(change[rough] if rough.any() else change)) > 0


def _light_moved(mean: np.ndarray, expected: np.ndarray, plate: np.ndarray) -> bool:
    """Whether the light on the plate has another shape than `expected` (rows, columns), greys.

    plate: mask of the tiles that show it.
    """
    # Tiles of a plate of a few greys differ by rounding.
    moved = np.abs(mean - expected) > MOVED_LIGHT * expected + 1.5
    return bool(np.sum(moved & plate) > MOVED_SHARE * np.sum(plate))


def _shade_fell(reached: np.ndarray, expected: np.ndarray, bright_ridges: bool) -> bool:
    """Whether the plate seems darker (brighter, for bright ridges) than `expected` also between
    ridges, by less than skin is.

    reached (rows, columns): as of `_reached`. So shadows are seen that leave no smooth plate beside
    the contact.
    """
    short = reached - expected if bright_ridges else LEVEL * (1 - reached / np.maximum(expected, 1))
    return bool(np.mean((short > SHADE) & (short < FLOODED)) > MOVED_SHARE)


def _light(image: np.ndarray, frame: np.ndarray, bright_ridges: bool, envelope: int) -> np.ndarray:
    """Light (h, w) uint8 in a frame, of which `image` is the plate but for the light: LEVEL, or
    BRIGHT_LEVEL, where nothing has changed.

    It is guessed as the background of a plate of one grey, which varies over millimetres. The edge
    of a shadow may be sharper. So what remains of the frame where all is filled up that is narrower
    than the envelope, as ridges are, is the light, but where sweat has flooded the furrows: that
    differs more from the guess.
    """
    if bright_ridges:
        flat = cv2.addWeighted(frame, 1.0, image, -1.0, BRIGHT_LEVEL)
    else:
        flat = cv2.divide(frame, cv2.max(image, np.array([1.0])), scale=LEVEL)
    guess = guess_background(flat, *tile_statistics(flat), bright_ridges, envelope)
    half = cv2.resize(flat, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    fill = cv2.MORPH_OPEN if bright_ridges else cv2.MORPH_CLOSE
    size = max(3, envelope // 2 | 1)
    filled = cv2.resize(
        cv2.morphologyEx(half, fill, np.ones((size, size), np.uint8)), flat.shape[::-1]
    )
    flooded = cv2.subtract(filled, guess) if bright_ridges else cv2.subtract(guess, filled)
    return np.where(flooded > FLOODED, guess, filled)


def tile_means(frame: np.ndarray) -> np.ndarray:
    """Mean (rows, columns) uint8 over tiles of a frame (h, w) uint8."""
    return cv2.resize(frame, tile_grid(frame), interpolation=cv2.INTER_AREA)


def tile_grid(frame: np.ndarray) -> tuple[int, int]:
    """Columns and rows of tiles that cover a frame."""
    return max(2, round(frame.shape[1] / TILE)), max(2, round(frame.shape[0] / TILE))


def tile_statistics(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (rows, columns) float32 over tiles of a frame (h, w) uint8."""
    grid = tile_grid(frame)
    mean = cv2.resize(frame.astype(np.float32), grid, interpolation=cv2.INTER_AREA)
    square = cv2.resize(np.square(frame, dtype=np.float32), grid, interpolation=cv2.INTER_AREA)
    return mean, np.sqrt(np.maximum(square - mean * mean, 0))


def smooth_tiles(deviation: np.ndarray) -> np.ndarray:
    """Mask of tiles without structure: their deviation is near that of the quietest tiles."""
    quiet = float(np.percentile(deviation, 10))
    return deviation <= 2 * quiet + 2.0


def plate_tiles(deviation: np.ndarray) -> np.ndarray:
    """Mask (rows, columns) of tiles that are plate.

    They are smooth and connected with the image's border by sides of smooth ones. A part of a print
    that is filled with sweat is smooth too, but enclosed by ridges.
    """
    smooth = smooth_tiles(deviation).astype(np.uint8)
    _, labels = cv2.connectedComponents(
        cv2.copyMakeBorder(smooth, 1, 1, 1, 1, cv2.BORDER_REPLICATE), connectivity=4
    )
    edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    return np.isin(labels[1:-1, 1:-1], np.setdiff1d(edge, [0]))


def guess_polarity(mean: np.ndarray, deviation: np.ndarray) -> bool:
    """Whether tiles with structure are brighter than the plate tiles beside them."""
    plate = plate_tiles(deviation)
    weight = plate.astype(np.float32)
    share = cv2.blur(weight, (3, 3), borderType=cv2.BORDER_REPLICATE)
    level = cv2.blur(weight * mean, (3, 3), borderType=cv2.BORDER_REPLICATE)
    beside = ~smooth_tiles(deviation) & (share > 0)
    if not beside.any():
        return False
    step = mean[beside] - level[beside] / share[beside]
    return float(np.sum(step)) > 0


def dark_border(frame: np.ndarray) -> np.ndarray | None:
    """Mask (h, w) of the dark border around a plate: black rows or columns, the straight edge of
    the mount, a few degrees tilted at most. None without one.
    """
    border = np.zeros(frame.shape, np.uint8)
    for turns in range(4):
        side = np.ascontiguousarray(np.rot90(frame, turns))
        outside = _border_at_left(cv2.blur(side, (1, 5), borderType=cv2.BORDER_REPLICATE))
        if outside is not None:
            border |= np.rot90(outside, -turns)
    return border if border.any() else None


def _border_at_left(frame: np.ndarray) -> np.ndarray | None:
    """Mask (h, w) of the border at the left of a frame; None without one."""
    height, width = frame.shape
    widest = round(BORDER_WIDEST * width)
    frame = frame[:, : widest + BORDER_INSIDE + BORDER_EDGE + 2]
    inner, outer = frame[:, BORDER_EDGE:], frame[:, :-BORDER_EDGE].astype(np.float32)
    brightens = inner > BORDER_STEP * outer + BORDER_GREYS
    begins = brightens.argmax(axis=1)
    beyond = ~brightens & (np.arange(brightens.shape[1]) > begins[:, None])
    edge = np.where(brightens.any(axis=1), beyond.argmax(axis=1) + 1, width)
    rows = np.arange(height)
    ends = [half[edge[half] < widest] for half in np.array_split(rows, 2)]
    if min(map(len, ends)) < 8:
        return None
    (x, y), (other_x, other_y) = ((np.median(end), np.median(edge[end])) for end in ends)
    line = y + (other_y - y) / (other_x - x) * (rows - x)
    straight = rows[(np.abs(edge - line) <= BORDER_OFF) & (edge < widest)]
    # A line across the plate, or the edge of a shadow on it, has plate on both sides.
    brightest = np.maximum.accumulate(frame[straight], axis=1)
    outside = brightest[np.arange(len(straight)), np.maximum(edge[straight] - BORDER_EDGE, 1) - 1]
    beside = edge[straight, None] + np.arange(BORDER_INSIDE)
    inside = np.median(frame[straight[:, None], beside], axis=1)
    if np.sum(outside * BORDER_STEP < inside) < BORDER_SIDE * height:
        return None
    return np.where(np.arange(width) < line[:, None] + BORDER_OFF, np.uint8(255), np.uint8(0))


def _filled(
    frame: np.ndarray, border: np.ndarray, smooth: Callable[..., np.ndarray], size: int
) -> np.ndarray:
    """The frame with what lies beside a border, smoothed over `size` pixels, in place of it."""
    distance = cv2.distanceTransformWithLabels(
        border, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels, inside = distance[1], border == 0
    beside = np.zeros(int(labels.max()) + 1, np.uint8)
    beside[labels[inside]] = frame[inside]
    # First what lies beside it as it is, so that smoothing does not see the border; less its noise.
    continued = cv2.blur(beside[labels], (3, 3))
    window = (size, size) if smooth is cv2.blur else np.ones((size, size), np.uint8)
    beside[labels[inside]] = smooth(continued, window)[inside]
    return np.where(inside, frame, beside[labels])


def guess_background(
    frame: np.ndarray,
    mean: np.ndarray,
    deviation: np.ndarray,
    bright_ridges: bool,
    envelope: int,
) -> np.ndarray:
    """(h, w) uint8 background of one frame that may hold a finger.

    mean, deviation: from `tile_statistics`. Plate tiles show the background. Among ridges, the
    upper envelope (lower, for bright ridges) over `envelope` working pixels reaches the plate in
    the furrows. Where sweat fills the furrows it does not: there a cubic surface through the other
    tiles is used.
    """
    height, width = frame.shape
    sign = -1.0 if bright_ridges else 1.0
    level = _reached(frame, deviation, bright_ridges, envelope)
    plate = plate_tiles(deviation)
    level[plate] = mean[plate]
    surface = _surface(level, plate, sign) if not plate.all() else level
    flooded = smooth_tiles(deviation) & ~plate
    short = sign * (surface - level) > np.where(plate, 0.6, 0.2) * np.maximum(surface, 100)
    level = np.where(flooded | short, surface, level)
    level = cv2.blur(level.astype(np.float32), (3, 3), borderType=cv2.BORDER_REPLICATE)
    fitted = cv2.resize(level, (width, height), interpolation=cv2.INTER_LINEAR)
    return cv2.convertScaleAbs(fitted)


def _reached(
    frame: np.ndarray, deviation: np.ndarray, bright_ridges: bool, envelope: int
) -> np.ndarray:
    """Greys (rows, columns) that tiles of a frame reach within `envelope` working pixels: the plate
    in the furrows."""
    height, width = frame.shape
    half = cv2.resize(frame, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    size = max(3, envelope // 2 | 1)
    kernel = np.ones((size, size), np.uint8)
    reached = cv2.erode(half, kernel) if bright_ridges else cv2.dilate(half, kernel)
    level: np.ndarray = cv2.resize(reached, tile_grid(frame), interpolation=cv2.INTER_AREA)
    # The envelope of noise lies about 1.5 standard deviations of a half-size pixel above its mean.
    noise = 0.75 * float(np.percentile(deviation, 10))
    return level.astype(np.float32) + (noise if bright_ridges else -noise)


def _surface(level: np.ndarray, plate: np.ndarray, sign: float) -> np.ndarray:
    """Cubic surface (rows, columns) through the levels, by reweighted least squares.

    Levels on the ridges' side lose weight from step to step.
    """
    shape = level.shape
    if min(shape) >= 8:
        # A cubic needs no more than every other tile.
        level, plate = level[::2, ::2], plate[::2, ::2]
    rows, columns = level.shape
    x = np.linspace(-1, 1, columns)[None, :].repeat(rows, 0).ravel()
    y = np.linspace(-1, 1, rows)[:, None].repeat(columns, 1).ravel()
    terms = np.stack(
        [np.ones_like(x), x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1
    )
    z = level.ravel().astype(np.float64)
    known = plate.ravel().astype(float)
    weight = np.maximum(known, sign * z >= np.median(sign * z))
    surface: np.ndarray = z
    for _ in range(5):
        scaled = terms * weight[:, None]
        # Not `@`: BLAS would wake a thread that spins beside the one that waits for it.
        normal = np.einsum("ij,ik->jk", scaled, terms) + 1e-3 * np.eye(terms.shape[1])
        surface = terms @ np.linalg.solve(normal, scaled.T @ z)
        below = sign * (surface - z)
        trust = 1 / (1 + (np.maximum(below, 0) / 8) ** 4)
        trust *= 1 / (1 + (np.maximum(-below, 0) / 24) ** 4)
        weight = np.maximum(0.5 * known, trust)
    coarse = surface.reshape(rows, columns).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_LINEAR)
