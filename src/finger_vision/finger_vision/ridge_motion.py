# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Stick area, slip and rotation from the motion of the ridges in the images of a contact.

The camera is fixed to the plate, so skin that sticks stands still in its image. Points on a grid in
the contact are followed by pyramidal Lucas–Kanade flow (B. D. Lucas and T. Kanade 1981; J.-Y.
Bouguet 2001), each against the image in which it was taken up, not against the one before, so that
small slips add up and errors do not. A point has slipped when it is further than a threshold
from where it last stuck.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_common.mono8 import Mono8
from finger_common.settings import Settings, setting

from .area_sensor import ContactMeasurement, SkinMotion
from .calibration import PlateCalibration
from .stick_zone import stick_ratio

DEFAULT_RIDGE_PERIOD = 0.5e-3
"""m, where no area sensor has a setting of it."""

FLOW_PIXEL = 28e-6
"""m; finer images are reduced as far as pixels stay below twice this size."""

SPACING, SITE = 0.36e-3, 0.3e-3
"""m between points that are followed, and between places near which there should be one."""

MOST = 2000
"""Points of a contact above which they are further apart: each is compared with each. A thumb has
as many."""

NEAR = 0.8e-3
"""m; a place further from all followed points is not known."""

WINDOW = 1.1
"""Side of the compared patches, in ridge periods: an odd number of pixels."""

LEVELS = 2
TURNS, SMALL_TURN = 4, 0.002
"""Times that a rotation of a sliding contact is refined; rad that need no further time."""

NEIGHBOURS = 9
"""Points, itself included, with whose motion that of a point is compared."""

MISSES = 5
"""Images in which a point is not found, one after the other, after which it is given up."""

WORN = 0.8
"""Share of the points found below which they are compared with the newest image from then on."""

TAPER = 0.07e-3
"""m from the outline inwards over which the texture fades."""

RIM = 0.15e-3
"""m within the outline in which no point is followed: there the outline itself moves."""

KEYS = 4
"""Images that points may be compared with."""

LOST = 0.45
"""Share of the points that may be lost before an image counts as not followed."""

FORGET = 3
"""Images that cannot be followed, one after the other, after which the contact begins anew."""

CHANGE = 120e-6
"""m by which ridges seem to move for each unit of the logarithm of the area, as their widths and
the rim change."""

SETTLED, GROWN = 0.01, 0.03
"""Change of that logarithm after which a point that sticks is compared anew, and after which one
that has slipped and stands still now sticks again."""

JUMP = 0.1
"""Change of the area's logarithm from image to image after which all points are taken up anew."""

SMOOTH = 0.3e-3
"""m, standard deviation of the distance over which neighbouring points are taken together."""

UNEVEN = 0.2
"""Deviation of a slip from that of its surroundings, over the slip: by the patches' own width, and
of the skin."""

STROKE = 6.0
"""Thresholds by which a fifth of the skin moves before standing skin counts as sticking again."""

STANDING = 0.3
"""Share of the places of which, when all others move, none is believed to stand still."""

MOVES = 0.6
"""Thresholds by which the skin of a sliding contact moves from image to image, at least."""

BACK, AWAY = 0.5, 3.0
"""Of its threshold: how near a point must be to where it stuck, and how far away at most it was,
to be taken for one that has not slipped."""

FINEST = 0.06
"""Smallest threshold, pixels of the flow."""

NOISE = 5.0
"""Threshold over the motion of standing skin from image to image, which is noise."""

USUAL_ERROR = 4.0
"""Mean difference of a patch from itself in another image, before it was measured."""

NOISIER = 0.5, 10.0
"""Smallest and largest noise of a point's travel over that of the usual one."""

FLAT, FLAT_OF_STRONG = 0.5, 0.35
"""Shares of the median strength of a contact's texture, and of that of its strongest tenth, below
which a patch has too little to be followed."""


@dataclass(frozen=True)
class RidgeMotionSettings(Settings):
    """Settings of the following of ridges."""

    ridge_motion: bool = setting(
        False,
        "Follow the ridges of a contact from image to image: stick ratio, slip and rotation.",
        advice="An area comes 10 to 20 ms later then.",
    )
    slip_threshold: float = setting(
        2.5e-6,
        "Travel over the plate from which skin counts as slipped.",
        unit="m",
        minimum=0.5e-6,
        maximum=1e-3,
        advice="Noisy or coarse images raise it by themselves.",
    )


@dataclass
class _Points:
    """Followed points (n,), in flow pixels.

    begin (n, 2): in the image `key` (n,), with the mean products gxx, gxy, gyy (n, 3) of the
    gradients of the patch there; place (n, 2): in the newest image; missed: images since it was
    found. own (n, 2): travel of the point itself, from that of its neighbours when it was taken up;
    travel (n, 2): the same smoothed over neighbours; stuck, held (n, 2): travel and own travel when
    it last stuck, or those of its neighbours when it was taken up; rest (n, 2): when it last stuck
    or went on slipping, area (n,): logarithm of the contact's area then; mark (n, 2): travel at the
    last stroke; slipped: whether it has left `stuck`; far: how far (flow pixels) since. error: mean
    difference of its patch from that of its key; noise: of its travel, over that of the usual
    point.
    """

    begin: np.ndarray
    gradient: np.ndarray
    key: np.ndarray
    place: np.ndarray
    missed: np.ndarray
    own: np.ndarray
    travel: np.ndarray
    stuck: np.ndarray
    held: np.ndarray
    rest: np.ndarray
    area: np.ndarray
    mark: np.ndarray
    slipped: np.ndarray
    far: np.ndarray
    error: np.ndarray
    noise: np.ndarray

    @classmethod
    def at(
        cls,
        places: np.ndarray,
        travel: np.ndarray,
        stuck: np.ndarray,
        mark: np.ndarray,
        slipped: np.ndarray,
        gradient: np.ndarray,
        key: int,
        area: float,
    ) -> _Points:
        """Points (n, 2) that are taken up in an image; area: logarithm of the contact's."""
        number = len(places)
        places = places.astype(np.float32)
        return cls(
            begin=places,
            gradient=gradient,
            key=np.full(number, key),
            place=places,
            missed=np.zeros(number, int),
            own=travel,
            travel=travel,
            stuck=stuck,
            held=stuck,
            rest=travel.copy(),
            area=np.full(number, area),
            mark=mark,
            slipped=slipped,
            far=np.zeros(number),
            error=np.full(number, USUAL_ERROR),
            noise=np.ones(number),
        )

    @property
    def good(self) -> np.ndarray:
        """Which points (n,) were found in the newest image."""
        return self.missed == 0

    @classmethod
    def none(cls) -> _Points:
        """No points."""
        no = np.zeros((0, 2))
        return cls.at(no, no, no, no, np.zeros(0, bool), np.zeros((0, 3)), 0, 0.0)

    def __len__(self) -> int:
        return len(self.begin)

    def compare_with(self, key: int, which: np.ndarray) -> None:
        """Compare points from now on with another image, in which they are at `place`."""
        self.begin = np.where(which[:, None], self.place, self.begin)
        self.key = np.where(which, key, self.key)

    def keep(self, which: np.ndarray) -> None:
        for name, value in vars(self).items():
            setattr(self, name, value[which])

    def add(self, new: _Points) -> None:
        for name, value in vars(new).items():
            setattr(self, name, np.concatenate([getattr(self, name), value]))


class RidgeMotion:
    """Follows the ridges of one contact after the other, in the images of one camera.

    calibration: of the plate. ridge_period: m. The same images in the same order give the same
    results; memory does not grow with them.
    """

    def __init__(
        self,
        settings: RidgeMotionSettings | None = None,
        calibration: PlateCalibration | None = None,
        ridge_period: float = DEFAULT_RIDGE_PERIOD,
    ) -> None:
        self.settings = settings or RidgeMotionSettings()
        self.calibration = calibration or PlateCalibration()
        self.ridge_period = ridge_period
        # What no picture is, the area sensor has refused.
        self._mono8 = Mono8(dark=True)
        self._size: tuple[int, int] | None = None
        self.reset()

    def reset(self) -> None:
        """Forget plate and contact."""
        self._plate: np.ndarray | None = None
        self._forget_contact()

    def _forget_contact(self) -> None:
        self.points = _Points.none()
        self._keys: dict[int, np.ndarray] = {}
        self._turns: dict[int, float] = {}
        self._next_key = 0
        self._before: np.ndarray | None = None
        self._velocity = np.zeros(2, np.float32)
        self._slip, self._rotation = np.zeros(2), 0.0
        self._failed = 0
        self._area = 0.0
        self._noise = math.inf

    def follow(self, image: np.ndarray, contact: ContactMeasurement) -> SkinMotion:
        """Motion of the skin up to an image (H, W), whose contact was measured.

        An image without contact shows the plate, and ends the contact; so does a contact that is
        smaller than a patch. Raises InputError for an image that cannot be used.
        """
        frame = self._reduced(self._mono8(image))
        if contact.flags & AreaFlag.NO_CONTACT or len(contact.hull) < 3:
            self._learn(frame)
            self._forget_contact()
            return SkinMotion()
        height, width = image.shape[:2]
        hull = self._to_flow(self.calibration.to_pixels(contact.hull, width, height))
        mask = np.zeros(frame.shape, np.uint8)
        cv2.fillPoly(mask, [np.rint(hull * 16).astype(np.int32)], 255, shift=4)
        if min(cv2.boundingRect(mask)[2:]) < self._window:
            self._forget_contact()
            return SkinMotion()
        texture, strength = self._texture(frame, mask)
        area = math.log(contact.gross_area)
        jumped = abs(area - self._area) > JUMP
        self._area = area
        if jumped or not len(self.points):
            # So fast ridges come and widen only while the normal force changes.
            self.points, self._keys, self._turns = _Points.none(), {}, {}
            self._renew(texture, strength, mask, area)
            self._before = texture
            return self._unknown()
        before = self.points.travel
        step = self._track(texture, mask)
        if step is None:
            self._failed += 1
            if self._failed >= FORGET:
                self._forget_contact()
            return self._unknown()
        self._failed = 0
        self._before = texture
        result = self._judge(step, before, mask, area)
        self._renew(texture, strength, mask, area)
        return result

    # Images ----------------------------------------------------------------------------------

    def _reduced(self, image: np.ndarray) -> np.ndarray:
        height, width = image.shape
        if self._size != (width, height):
            self._size = (width, height)
            middle = np.array([[width / 2, height / 2], [width / 2 + 1, height / 2]])
            plate = self.calibration.to_plate(middle, width, height)
            pitch = float(np.hypot(*(plate[1] - plate[0])))
            self._step = max(1, int(FLOW_PIXEL / pitch))
            self._pitch = pitch * self._step
            self._window = max(9, round(WINDOW * self.ridge_period / self._pitch) | 1)
            self.threshold = max(self.settings.slip_threshold, FINEST * self._pitch)
            self._plate = None
            self._forget_contact()
        if self._step == 1:
            return image
        size = (width // self._step, height // self._step)
        cut = image[: size[1] * self._step, : size[0] * self._step]
        return cv2.resize(cut, size, interpolation=cv2.INTER_AREA)

    def _to_flow(self, pixels: np.ndarray) -> np.ndarray:
        return (pixels + 0.5) / self._step - 0.5

    def _to_plate(self, points: np.ndarray) -> np.ndarray:
        assert self._size is not None
        return self.calibration.to_plate((points + 0.5) * self._step - 0.5, *self._size)

    def _learn(self, frame: np.ndarray) -> None:
        """Mean of the last images of the plate: what it carries does not move with the skin."""
        if self._plate is None:
            self._plate = frame.astype(np.float32)
        else:
            cv2.accumulateWeighted(frame, self._plate, 0.1)

    def _texture(self, frame: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ridges alone about a contact, (h, w) uint8 about 128, and their strength (h, w) before.

        Without the plate's own texture, light that varies slowly, and contrast.
        """
        size = max(3, round(2.0 * self.ridge_period / self._pitch) | 1)
        box = _box(mask, 2 * size)
        picture = frame[box].astype(np.float32)
        if self._plate is not None:
            light = cv2.max(self._plate[box], np.array([40.0]))
            cv2.divide(picture, light, picture, 128.0)
        # Of the skin alone: its outline stands still.
        taper = 2 * round(TAPER / self._pitch) + 1
        inside = cv2.erode(mask[box], np.ones((taper, taper), np.uint8)).astype(np.float32) / 255
        inside = np.asarray(cv2.blur(inside, (taper, taper)), np.float32)
        share = cv2.blur(inside, (size, size)) + 1e-3
        mean = cv2.divide(cv2.blur(cv2.multiply(picture, inside), (size, size)), share)
        picture = np.asarray(cv2.multiply(cv2.subtract(picture, mean), inside), np.float32)
        square = cv2.blur(cv2.multiply(picture, picture), (size, size))
        spread = np.sqrt(np.maximum(square, 0.0) / share)
        strength = np.zeros(frame.shape, np.float32)
        strength[box] = spread
        floor = max(0.25 * float(np.percentile(spread[::8, ::8], 98)), 2.0)
        scaled = cv2.divide(picture, cv2.max(spread, np.array([floor])), scale=42.0)
        texture = np.full(frame.shape, 128, np.uint8)
        texture[box] = cv2.add(scaled, np.array([128.0]), dtype=cv2.CV_8U)
        return texture, strength

    def _gradients(self, texture: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Mean products gxx, gxy, gyy (n, 3) of a texture's gradient over patches at (n, 2)."""
        low = np.maximum(np.floor(places.min(axis=0)).astype(int) - self._window, 0)
        high = np.ceil(places.max(axis=0)).astype(int) + self._window
        gx, gy = cv2.spatialGradient(
            np.ascontiguousarray(texture[low[1] : high[1], low[0] : high[0]])
        )
        gx, gy = gx.astype(np.float32), gy.astype(np.float32)
        size = (self._window, self._window)
        columns, rows = (np.rint(places).astype(int) - low).T
        products = (gx * gx, gx * gy, gy * gy)
        return np.column_stack([cv2.blur(a, size)[rows, columns] for a in products])

    # Points ----------------------------------------------------------------------------------

    def _track(self, texture: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
        """Find the points in a new image; their motion (n, 2), None when too few are found."""
        points = self.points
        place, found = self._flow(texture, points.place + self._velocity)
        if found.mean() < WORN and self._before is not None:
            # Faster, or otherwise, than before: ridges repeat, so both guesses are tried.
            leapt, there = self._flow(texture, points.place + self._leap(texture, mask))
            if there.sum() > found.sum():
                place, found = leapt, there
        if found.sum() < 4 or found.mean() < 1.0 - LOST:
            self._velocity[:] = 0.0
            return None
        self._velocity = np.median((place - points.place)[found], axis=0)
        step = place - points.place
        points.place = place.astype(np.float32)
        points.missed = np.where(found, 0, points.missed + 1)
        points.own = points.own + step
        points.travel, points.noise = self._smoothed(points.own)
        return step

    def _smoothed(self, travel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Travel (n, 2) of points and their neighbours together, and its noise (n,) in the
        direction in which it is known worst, over that of the usual point.

        Each counts across its ridges, where it is known, not along them.
        """
        points = self.points
        reach = SMOOTH / self._pitch
        square = _squares(points.place, points.place)
        weight = np.exp(square * (-0.5 / reach**2)) * points.good
        xx, xy, yy = points.gradient.T.astype(float)
        x, y = travel.T
        rows = np.column_stack([xx, xy, yy, xx * x + xy * y, xy * x + yy * y])
        xx, xy, yy, bx, by = (weight @ rows).T
        root = np.maximum(xx * yy - xy * xy, 1e-3 * (xx + yy) ** 2) + 1e-9
        smoothed = np.column_stack([yy * bx - xy * by, xx * by - xy * bx]) / root[:, None]
        error = (weight @ points.error) / np.maximum(weight.sum(axis=1), 1e-9)
        noise = error * np.sqrt((xx + yy) / root)
        usual = float(np.median(noise[points.good])) if points.good.any() else 0.0
        return smoothed, np.clip(noise / max(usual, 1e-9), *NOISIER)

    def _flow(self, texture: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 2) of the points in a new image, and which of them are to be trusted."""
        points = self.points
        place = guess.astype(np.float32)
        found = np.zeros(len(points), bool)
        height, width = texture.shape
        reach = 2 * self._window
        low = np.maximum(np.floor(np.minimum(points.begin, place).min(axis=0)) - reach, 0)
        high = np.ceil(np.maximum(points.begin, place).max(axis=0)) + reach
        left, top = low.astype(int)
        right, bottom = min(int(high[0]), width), min(int(high[1]), height)
        box = slice(top, bottom), slice(left, right)
        corner = np.array([left, top], np.float32)
        turning = bool(points.slipped.mean() > 0.9)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 15, 0.01)
        for number, key in self._keys.items():
            mine = np.flatnonzero(points.key == number)
            if not len(mine):
                continue
            for _ in range(TURNS):
                image, begin = self._turned(number, key[box], points.begin[mine] - corner)
                there, status, error = cv2.calcOpticalFlowPyrLK(
                    image,
                    texture[box],
                    begin.reshape(-1, 1, 2),
                    (place[mine] - corner).reshape(-1, 1, 2),
                    winSize=(self._window, self._window),
                    maxLevel=LEVELS,
                    criteria=criteria,
                    flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
                    minEigThreshold=1e-3,
                )
                place[mine] = there[:, 0] + corner
                # Mean difference of the patches, of textures whose own is about 42.
                found[mine] = (status[:, 0] > 0) & (error[:, 0] < 22.0)
                good = found[mine]
                points.error[mine[good]] = error[good, 0]
                if not turning or good.sum() < 4:
                    break
                turn = _rotation(there[good, 0], there[good, 0] - begin[good])
                self._turns[number] = self._turns.get(number, 0.0) + turn
                if abs(turn) < SMALL_TURN:
                    break
        if found.any():
            moved = self._around(place, found)
            # Around the centre of a rotation neighbours move by little, and differently.
            size = np.maximum(np.hypot(*moved.T), np.median(np.hypot(*moved[found].T)))
            found &= np.hypot(*(place - points.place - moved).T) < 0.35 + 0.3 * size
            place[~found] = (points.place + moved)[~found]
        return place, found

    def _turned(
        self, number: int, image: np.ndarray, begin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """A key's image and its points (n, 2) turned as far as the contact has turned since.

        Ridges in rings turn into themselves: patches that only shift would not see it.
        """
        angle = self._turns.get(number, 0.0)
        if abs(angle) < SMALL_TURN:
            return image, begin
        x, y = begin.mean(axis=0)
        matrix = cv2.getRotationMatrix2D((float(x), float(y)), -math.degrees(angle), 1.0)
        height, width = image.shape
        turned = cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
        return turned, (begin @ matrix[:, :2].T + matrix[:, 2]).astype(np.float32)

    def _around(self, place: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Median motion (n, 2) since the image before of the found points nearest to each."""
        points = self.points
        square = _squares(points.place, points.place)
        square[:, ~found] = np.inf
        count = min(NEIGHBOURS, int(found.sum())) - 1
        nearest = np.argpartition(square, count, axis=1)[:, : count + 1]
        return np.median((place - points.place)[nearest], axis=1)

    def _leap(self, texture: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Shift (2,) of the whole contact since the image before, by phase correlation."""
        box = _box(mask, max(cv2.boundingRect(mask)[2:]) // 4)
        assert self._before is not None
        pair = [
            cv2.resize(t[box], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            for t in (self._before, texture)
        ]
        first, second = (p.astype(np.float32) - 128.0 for p in pair)
        (dx, dy), _ = cv2.phaseCorrelate(first, second)
        return np.array([2 * dx, 2 * dy], np.float32)

    def _renew(
        self, texture: np.ndarray, strength: np.ndarray, mask: np.ndarray, area: float
    ) -> None:
        """Drop points that left the contact, and take up new ones where there are none."""
        points = self.points
        height, width = mask.shape
        at = np.rint(points.place).astype(int)
        inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
        inside[inside] = mask[at[inside, 1], at[inside, 0]] > 0
        points.keep(inside & (points.missed < MISSES))
        size = 2 * round(RIM / self._pitch) + 1
        inner = cv2.erode(
            mask,
            cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)),
            borderType=cv2.BORDER_CONSTANT,
            borderValue=0,
        )
        spacing = SPACING * self._coarser(mask)
        if len(points) > 1.2 * MOST:
            cells = np.floor(points.place * (self._pitch / spacing))
            thinned = np.zeros(len(points), bool)
            thinned[np.unique(cells, axis=0, return_index=True)[1]] = True
            points.keep(thinned)
        sites = self._grid(inner, spacing)
        if len(points) and len(sites):
            distance, _ = _nearest(sites, points.place)
            sites = sites[distance > 0.8 * spacing / self._pitch]
        if len(sites):
            columns, rows = np.rint(sites).astype(int).T
            # Where sweat fills the furrows there is nothing to follow.
            median, strong = np.percentile(strength[mask > 0], [50, 90])
            least = max(FLAT * float(median), FLAT_OF_STRONG * float(strong))
            sites = sites[strength[rows, columns] > least]
        # Ridges that have turned or widened are found in fewer and fewer images.
        changed = len(points) > 0 and float(points.good.mean()) < WORN
        if len(sites) > (0 if changed else max(3, 0.03 * len(points))):
            number = self._next_key
            self._next_key += 1
            self._keys[number] = texture
            travel = stuck = mark = np.zeros((len(sites), 2))
            slipped = np.zeros(len(sites), bool)
            if points.good.any():
                nearest = np.flatnonzero(points.good)[_nearest(sites, points.place[points.good])[1]]
                travel, stuck = points.travel[nearest], points.stuck[nearest]
                mark, slipped = points.mark[nearest], points.slipped[nearest]
            gradient = self._gradients(texture, sites)
            points.add(_Points.at(sites, travel, stuck, mark, slipped, gradient, number, area))
            counts = {k: int((points.key == k).sum()) for k in self._keys}
            for fewest in sorted((k for k in self._keys if k != number), key=lambda k: counts[k]):
                if len(self._keys) > KEYS or changed:
                    points.compare_with(number, points.good & (points.key == fewest))
                    points.keep(points.key != fewest)
                    del self._keys[fewest]
        self._turns = {k: v for k, v in self._turns.items() if k in self._keys}
        used = set(points.key.tolist())
        self._keys = {k: v for k, v in self._keys.items() if k in used}

    def _coarser(self, mask: np.ndarray) -> float:
        """Factor on distances between points, so that a contact has at most MOST of them."""
        area = cv2.countNonZero(mask) * self._pitch**2
        return max(1.0, math.sqrt(area / MOST) / SPACING)

    def _grid(self, mask: np.ndarray, spacing: float) -> np.ndarray:
        """Places (n, 2) inside a mask on a grid of a spacing (m), whole numbers of pixels."""
        step = max(2, round(spacing / self._pitch))
        half = step // 2
        rows, columns = np.nonzero(mask[half::step, half::step])
        return np.column_stack([columns, rows]).astype(np.float32) * step + half

    # Judgement -------------------------------------------------------------------------------

    def _judge(
        self, step: np.ndarray, before: np.ndarray, mask: np.ndarray, area: float
    ) -> SkinMotion:
        """Stick ratio, slip and rotation.

        step (n, 2): motion of the points themselves since the image before; before (n, 2): their
        smoothed travel then, flow pixels. area: logarithm of the contact's.
        """
        points = self.points
        good, travel = points.good, points.travel
        if good.any():
            # Of the slowest skin: what moves slips.
            quiet = np.hypot(*(travel - before).T) / points.noise
            self._noise = min(float(np.percentile(quiet[good], 30)), 1.1 * self._noise)
        limits = np.maximum(self.threshold / self._pitch, NOISE * self._noise * points.noise)
        limit = float(np.median(limits[good])) if good.any() else float(np.median(limits))
        change = area - points.area
        far = np.hypot(*(travel - points.rest).T)
        goes_on = good & (far > limits + CHANGE / self._pitch * np.abs(change))
        fresh = goes_on & ~points.slipped
        points.slipped = points.slipped | goes_on
        settled = good & ~goes_on & (np.abs(change) > np.where(points.slipped, GROWN, SETTLED))
        # Skin sticks again when it stands still while the normal force grows or other skin moves.
        again = settled & (~points.slipped | (change > 0.0))
        moved = np.hypot(*(travel - points.mark).T)
        if good.any() and np.percentile(moved[good], 80) > STROKE * limit:
            again |= points.slipped & good & (moved < limits)
            points.mark = travel.copy()
        # What is back where it was, and never was far, has not slipped: its place was not known.
        from_stuck = np.hypot(*(travel - points.stuck).T)
        points.far = np.where(points.slipped, np.maximum(points.far, from_stuck), 0.0)
        back = points.slipped & good & (from_stuck < BACK * limits) & (points.far < AWAY * limits)
        points.slipped &= ~back
        points.rest[back] = points.stuck[back]
        new = goes_on & ~back | settled | again
        points.rest[new], points.area[new] = travel[new], area
        points.stuck[again], points.slipped[again] = travel[again], False
        points.held[again] = points.own[again]
        from_stuck = travel - points.stuck
        slid = np.where(fresh[:, None], from_stuck, step) * points.slipped[:, None]
        self._add_motion(points.place[good], slid[good])
        coarser = self._coarser(mask)
        sites = self._grid(mask, SITE * coarser)
        if not len(sites) or not good.any():
            return self._unknown()
        distance, _ = _nearest(sites, points.place[good])
        share = float((distance < max(NEAR, SPACING * coarser) / self._pitch).mean())
        if share < 0.3:
            return self._unknown()
        limits = limits + 0.5 * CHANGE / self._pitch * np.abs(area - points.area)
        noise = 0.5 * limits * np.sqrt(np.clip(points.error / USUAL_ERROR, 0.4, 3.0))
        ratio, sd = self._stick_ratio(good, noise, mask)
        now = float(np.median(np.hypot(*(travel - before)[good].T)))
        return replace(
            self._unknown(),
            stick_ratio=round(ratio, 3),
            stick_ratio_sd=math.hypot(sd, 0.3 * (1.0 - share)),
            sliding=ratio < 0.02 and now > MOVES * limit,
        )

    def _stick_ratio(
        self, good: np.ndarray, noise: np.ndarray, mask: np.ndarray
    ) -> tuple[float, float]:
        """Stick ratio and its deviation; noise (n,): of the points' own travels, flow pixels."""
        points = self.points
        moments = cv2.moments(mask, binaryImage=True)
        area = moments["m00"]
        centre = np.array([moments["m10"], moments["m01"]]) / area
        xx, xy, yy = (moments[name] / area for name in ("mu20", "mu11", "mu02"))
        # A uniform ellipse has a quarter of its squared semi-axes as second moments.
        values, axes = np.linalg.eigh(4.0 * np.array([[xx, xy], [xy, yy]]))
        places = (points.place[good] - centre) @ axes / np.sqrt(np.maximum(values, 1.0))
        slips = (points.own - points.held)[good] @ axes * self._pitch
        # Places that stand still among others that move may have been followed wrongly.
        far = np.hypot(*(points.own - points.held).T)
        far = np.maximum(far, np.hypot(*(points.travel - points.stuck).T))
        far = np.maximum(far, np.quantile(far[good], STANDING))
        noise = np.hypot(noise, UNEVEN * far)
        gxx, gxy, gyy = points.gradient[good].T.astype(float)
        tensor = axes.T @ np.stack([[gxx, gxy], [gxy, gyy]]).transpose(2, 0, 1) @ axes
        return stick_ratio(
            places,
            slips,
            noise[good] * self._pitch,
            np.stack([tensor[:, 0, 0], tensor[:, 0, 1], tensor[:, 1, 1]], axis=-1),
            math.sqrt(area / math.pi) * self._pitch,
        )

    def _unknown(self) -> SkinMotion:
        """What has been seen of this contact, without a stick ratio."""
        x, y = self._slip
        return SkinMotion(slip=(float(x), float(y)), rotation=self._rotation)

    def _add_motion(self, place: np.ndarray, moved: np.ndarray) -> None:
        """Add the motion since the image before of points at (n, 2) by (n, 2) flow pixels."""
        if len(place) < 4:
            return
        now = self._to_plate(place)
        step = now - self._to_plate(place - moved)
        self._slip += step.mean(axis=0)
        self._rotation += _rotation(now, step)


def _rotation(places: np.ndarray, moved: np.ndarray) -> float:
    """Angle (rad) of the rotation in a motion (n, 2) of places (n, 2), by least squares."""
    arm = places - places.mean(axis=0)
    around = arm[:, 0] * moved[:, 1] - arm[:, 1] * moved[:, 0]
    return float(around.sum() / max((arm**2).sum(), 1e-12))


def _box(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Rows and columns of a mask with a margin about it."""
    x, y, width, height = cv2.boundingRect(mask)
    return (
        slice(max(y - margin, 0), y + height + margin),
        slice(max(x - margin, 0), x + width + margin),
    )


def _nearest(places: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) of places (n, 2) from the nearest of points (m, 2), and which one it is."""
    square = _squares(places, points)
    index = np.argmin(square, axis=1)
    return np.sqrt(square[np.arange(len(places)), index]), index


def _squares(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Squared distances (n, m) of places (n, 2) from points (m, 2)."""
    square = (places[:, None, 0] - points[None, :, 0]) ** 2
    square += (places[:, None, 1] - points[None, :, 1]) ** 2
    return square


def with_motion(
    contact: ContactMeasurement, image: np.ndarray, motion: RidgeMotion | None
) -> ContactMeasurement:
    """A measured contact with the motion of its skin, as `motion` has followed it to this image.

    A signal that is no image leaves it as it is.
    """
    if motion is None:
        return contact
    try:
        found = motion.follow(image, contact)
    except InputError:
        return contact
    flags = contact.flags | (AreaFlag.SLIDING if found.sliding else 0)
    return replace(contact, motion=found, flags=int(flags))
