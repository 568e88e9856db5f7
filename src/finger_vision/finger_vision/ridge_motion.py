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
from .followed_points import (
    POINT,
    SMOOTH,
    USUAL_ERROR,
    in_newest,
    nearest,
    smoothed,
    squares,
    taken_up,
)
from .ridge_texture import RidgeTexture, box_about
from .stick_zone import stick_ratio

DEFAULT_RIDGE_PERIOD = 0.5e-3
"""m, where no area sensor has a setting of it."""

SPACING, SITE = 0.36e-3, 0.3e-3
"""m between points that are followed, and between places near which there should be one."""

MOST = 2000
"""Most points of a contact. In a larger one they are further apart: each is compared with each. A
thumb has as many."""

NEAR = 0.8e-3
"""m; a place further from all followed points is not known."""

LEVELS = 2
"""Times that an image is halved, to find points that move far."""

TURNS, SMALL_TURN = 4, 0.002
"""Times that a rotation of a sliding contact is refined; rad that need no further time."""

NEIGHBOURS = 9
"""Points, itself included, with whose motion that of a point is compared."""

MISSES = 5
"""Images in which a point is not found, one after the other, after which it is given up."""

WORN = 0.8
"""Share of the points found below which they are compared with the newest image from then on."""

RIM = 0.15e-3
"""m within the outline in which no point is followed: there the outline itself moves."""

KEYS = 4
"""Images that points may be compared with."""

LOST = 0.45
"""Share of the points that may be lost before an image counts as not followed."""

FORGET = 3
"""Images that cannot be followed, one after the other, after which the contact begins anew."""

CHANGE = 120e-6
"""Apparent motion of the ridges, m, when the logarithm of the area changes by one: as the area
grows, ridges widen and the rim moves."""

SETTLED, GROWN = 0.01, 0.03
"""Changes of the logarithm of the area. After the first a point that sticks is compared anew. After
the second one that has slipped, and stands still now, sticks again."""

JUMP = 0.1
"""Change of the area's logarithm from image to image after which all points are taken up anew."""

UNEVEN = 0.2
"""Deviation of a point's slip from that of its surroundings, over the slip. Skin does not slip
evenly, and the slip within a patch is not one."""

STROKE = 6.0
"""Length of a stroke, in thresholds. When a fifth of the skin has moved so far, skin that stood
still meanwhile counts as sticking again."""

STANDING = 0.3
"""Share of the points that are doubted when they stand still while all others slip. They may have
been followed wrongly."""

MOVES = 0.6
"""Least motion of sliding skin from image to image, in thresholds."""

BACK, AWAY = 0.5, 3.0
"""Distances from the place where a point stuck, in thresholds. A point that is nearer than the
first and was never further than the second has not slipped: its place was not known."""

FINEST = 0.06
"""Smallest threshold, pixels of the flow."""

NOISE = 5.0
"""Least threshold, over the motion of standing skin from image to image. That motion is noise."""

FIRST_NOISE, STANDS = 0.05, 0.3
"""Noise before any skin was seen to stand, pixels of the flow: a camera with noise of 10 greys has
so much. And the least share of the points that have not slipped from which the noise may grow."""

COARSE, ROLLED = 4, 0.5
"""Pixels from one to the next that tell which skin was there when a contact began; and deviation of
the stick ratio when all of it has rolled away and other skin has come (rendered frames)."""

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
        # The area sensor has already refused invalid images.
        self._mono8 = Mono8(dark=True)
        self.reset()

    @property
    def pitch(self) -> float:
        """Size of a pixel of the flow on the plate, m; from the first image on."""
        return self._pitch

    @property
    def ridges(self) -> RidgeTexture | None:
        """The textures in which the ridges are followed; None before the first image."""
        return self._ridges

    def reset(self) -> None:
        """Forget plate and contact."""
        self._ridges: RidgeTexture | None = None
        self._forget_contact()

    def _forget_contact(self) -> None:
        self.points = np.zeros(0, POINT)
        self._keys: dict[int, np.ndarray] = {}
        self._turns: dict[int, float] = {}
        self._next_key = 0
        self._before: np.ndarray | None = None
        self._velocity = np.zeros(2, np.float32)
        self._slip, self._rotation = np.zeros(2), 0.0
        self._failed = 0
        self._area = 0.0
        self._first: np.ndarray | None = None
        self._begin = np.zeros(2)
        self._noise = FIRST_NOISE

    def track(self, image: np.ndarray, contact: ContactMeasurement) -> SkinMotion:
        """Motion of the skin up to an image (H, W), whose contact was measured.

        An image without contact shows the plate, and ends the contact; so does a contact that is
        smaller than a patch. Raises InputError for an image that cannot be used.
        """
        image = self._mono8(image)
        height, width = image.shape
        ridges = self._ridges
        if ridges is None or ridges.size != (width, height):
            self._ridges = ridges = RidgeTexture(
                (width, height), self.calibration, self.ridge_period
            )
            self._pitch, self._window = ridges.pitch, ridges.window
            self.threshold = max(self.settings.slip_threshold, FINEST * self._pitch)
            self._forget_contact()
        frame = ridges.frame(image)
        if contact.flags & AreaFlag.NO_CONTACT or len(contact.hull) < 3:
            ridges.learn(frame)
            self._forget_contact()
            return SkinMotion()
        hull = ridges.from_plate(contact.hull)
        mask = np.zeros(frame.shape, np.uint8)
        cv2.fillPoly(mask, [np.rint(hull * 16).astype(np.int32)], 255, shift=4)
        if min(cv2.boundingRect(mask)[2:]) < self._window:
            self._forget_contact()
            return SkinMotion()
        texture, strength = ridges.of(frame, mask)
        area = math.log(contact.gross_area)
        jumped = abs(area - self._area) > JUMP
        self._area = area
        if jumped or not len(self.points):
            # So fast ridges come and widen only while the normal force changes.
            self.points, self._keys, self._turns = np.zeros(0, POINT), {}, {}
            self._first, self._begin = _coarse(mask), self._slip.copy()
            self._renew(texture, strength, mask, area)
            self._before = texture
            return self._unknown()
        before = self.points["travel"].copy()
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

    # Points ----------------------------------------------------------------------------------

    def _track(self, texture: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
        """Find the points in a new image; their motion (n, 2), None when too few are found."""
        points = self.points
        place, found = self._flow(texture, points["place"] + self._velocity)
        if found.mean() < WORN and self._before is not None:
            # Faster, or otherwise, than before: ridges repeat, so both guesses are tried.
            leapt, there = self._flow(texture, points["place"] + self._leap(texture, mask))
            if there.sum() > found.sum():
                place, found = leapt, there
        if found.sum() < 4 or found.mean() < 1.0 - LOST:
            self._velocity[:] = 0.0
            return None
        self._velocity = np.median((place - points["place"])[found], axis=0)
        step = place - points["place"]
        points["place"] = place
        points["missed"] = np.where(found, 0, points["missed"] + 1)
        points["own"] += step
        points["travel"], points["noise"] = smoothed(points, SMOOTH / self._pitch)
        return step

    def _flow(self, texture: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 2) of the points in a new image, and which of them are to be trusted."""
        points = self.points
        place = guess.astype(np.float32)
        found = np.zeros(len(points), bool)
        height, width = texture.shape
        reach = 2 * self._window
        low = np.maximum(np.floor(np.minimum(points["begin"], place).min(axis=0)) - reach, 0)
        high = np.ceil(np.maximum(points["begin"], place).max(axis=0)) + reach
        left, top = low.astype(int)
        right, bottom = min(int(high[0]), width), min(int(high[1]), height)
        box = slice(top, bottom), slice(left, right)
        corner = np.array([left, top], np.float32)
        turning = bool(points["slipped"].mean() > 0.9)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 15, 0.01)
        for number, key in self._keys.items():
            mine = np.flatnonzero(points["key"] == number)
            if not len(mine):
                continue
            for _ in range(TURNS):
                image, begin = self._turned(number, key[box], points["begin"][mine] - corner)
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
                points["error"][mine[good]] = error[good, 0]
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
            found &= np.hypot(*(place - points["place"] - moved).T) < 0.35 + 0.3 * size
            place[~found] = (points["place"] + moved)[~found]
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
        square = squares(points["place"], points["place"])
        square[:, ~found] = np.inf
        count = min(NEIGHBOURS, int(found.sum())) - 1
        beside = np.argpartition(square, count, axis=1)[:, : count + 1]
        return np.median((place - points["place"])[beside], axis=1)

    def _leap(self, texture: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Shift (2,) of the whole contact since the image before, by phase correlation."""
        box = box_about(mask, max(cv2.boundingRect(mask)[2:]) // 4)
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
        at = np.rint(points["place"]).astype(int)
        inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
        inside[inside] = mask[at[inside, 1], at[inside, 0]] > 0
        points = points[inside & (points["missed"] < MISSES)]
        size = 2 * round(RIM / self._pitch) + 1
        inner = cv2.erode(
            mask,
            cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)),
            borderType=cv2.BORDER_CONSTANT,
            borderValue=0,
        )
        spacing = SPACING * self._coarser(mask)
        if len(points) > 1.2 * MOST:
            cells = np.floor(points["place"] * (self._pitch / spacing))
            thinned = np.zeros(len(points), bool)
            thinned[np.unique(cells, axis=0, return_index=True)[1]] = True
            points = points[thinned]
        sites = self._grid(inner, spacing)
        if len(points) and len(sites):
            distance, _ = nearest(sites, points["place"])
            sites = sites[distance > 0.8 * spacing / self._pitch]
        if len(sites):
            columns, rows = np.rint(sites).astype(int).T
            # Where sweat fills the furrows there is nothing to follow.
            median, strong = np.percentile(strength[mask > 0], [50, 90])
            least = max(FLAT * float(median), FLAT_OF_STRONG * float(strong))
            sites = sites[strength[rows, columns] > least]
        # Ridges that have turned or widened are found in fewer and fewer images.
        changed = len(points) > 0 and float(in_newest(points).mean()) < WORN
        if len(sites) > (0 if changed else max(3, 0.03 * len(points))):
            number = self._next_key
            self._next_key += 1
            self._keys[number] = texture
            assert self._ridges is not None
            gradients = self._ridges.gradients(texture, sites)
            points = np.concatenate([points, taken_up(sites, gradients, number, area, points)])
            counts = {k: int((points["key"] == k).sum()) for k in self._keys}
            for fewest in sorted((k for k in self._keys if k != number), key=lambda k: counts[k]):
                if len(self._keys) > KEYS or changed:
                    moved = in_newest(points) & (points["key"] == fewest)
                    points["begin"][moved], points["key"][moved] = points["place"][moved], number
                    points = points[points["key"] != fewest]
                    del self._keys[fewest]
        self._turns = {k: v for k, v in self._turns.items() if k in self._keys}
        self.points = points
        used = set(points["key"].tolist())
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
        good, travel = in_newest(points), points["travel"]
        if good.any():
            # Of the slowest skin: what moves slips. Where nearly all has slipped, all may move.
            quiet = np.hypot(*(travel - before).T) / points["noise"]
            growth = 1.1 if np.mean(~points["slipped"][good]) > STANDS else 1.0
            self._noise = min(float(np.percentile(quiet[good], 30)), growth * self._noise)
        limits = np.maximum(self.threshold / self._pitch, NOISE * self._noise * points["noise"])
        limit = float(np.median(limits[good])) if good.any() else float(np.median(limits))
        change = area - points["area"]
        far = np.hypot(*(travel - points["rest"]).T)
        goes_on = good & (far > limits + CHANGE / self._pitch * np.abs(change))
        fresh = goes_on & ~points["slipped"]
        points["slipped"] |= goes_on
        settled = good & ~goes_on & (np.abs(change) > np.where(points["slipped"], GROWN, SETTLED))
        # Skin sticks again when it stands still while the normal force grows or other skin moves.
        again = settled & (~points["slipped"] | (change > 0.0))
        moved = np.hypot(*(travel - points["mark"]).T)
        if good.any() and np.percentile(moved[good], 80) > STROKE * limit:
            again |= points["slipped"] & good & (moved < limits)
            points["mark"] = travel
        # What is back where it was, and never was far, has not slipped: its place was not known.
        from_stuck = np.hypot(*(travel - points["stuck"]).T)
        points["far"] = np.where(points["slipped"], np.maximum(points["far"], from_stuck), 0.0)
        back = (
            points["slipped"]
            & good
            & (from_stuck < BACK * limits)
            & (points["far"] < AWAY * limits)
        )
        points["slipped"] &= ~back
        points["rest"][back] = points["stuck"][back]
        new = goes_on & ~back | settled | again
        points["rest"][new], points["area"][new] = travel[new], area
        points["stuck"][again], points["slipped"][again] = travel[again], False
        points["held"][again] = points["own"][again]
        from_stuck = travel - points["stuck"]
        slid = np.where(fresh[:, None], from_stuck, step) * points["slipped"][:, None]
        self._add_motion(points["place"][good], slid[good])
        coarser = self._coarser(mask)
        sites = self._grid(mask, SITE * coarser)
        if not len(sites) or not good.any():
            return self._unknown()
        distance, _ = nearest(sites, points["place"][good])
        share = float((distance < max(NEAR, SPACING * coarser) / self._pitch).mean())
        if share < 0.3:
            return self._unknown()
        limits = limits + 0.5 * CHANGE / self._pitch * np.abs(area - points["area"])
        noise = 0.5 * limits * np.sqrt(np.clip(points["error"] / USUAL_ERROR, 0.4, 3.0))
        ratio, sd = self._stick_ratio(good, noise, mask)
        now = float(np.median(np.hypot(*(travel - before)[good].T)))
        return replace(
            self._unknown(),
            stick_ratio=round(ratio, 3),
            stick_ratio_sd=math.hypot(sd, 0.3 * (1.0 - share), ROLLED * self._exchanged(mask)),
            sliding=ratio < 0.02 and now > MOVES * limit,
        )

    def _exchanged(self, mask: np.ndarray) -> float:
        """Share of the skin in the contact that came since it began, while as much left, as when a
        finger rolls. Neither growth nor a slide of the same skin adds to it."""
        assert self._ridges is not None and self._first is not None
        now, first = _coarse(mask), self._first
        slip = np.array([self._slip - self._begin])
        shift = self._ridges.from_plate(slip) - self._ridges.from_plate(np.zeros((1, 2)))
        matrix = np.column_stack([np.eye(2), shift[0] / COARSE])
        moved = cv2.warpAffine(first, matrix, first.shape[::-1])
        smaller = min(cv2.countNonZero(first), cv2.countNonZero(now))
        return 1.0 - cv2.countNonZero(cv2.bitwise_and(moved, now)) / max(smaller, 1)

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
        places = (points["place"][good] - centre) @ axes / np.sqrt(np.maximum(values, 1.0))
        slips = (points["own"] - points["held"])[good] @ axes * self._pitch
        # Places that stand still among others that move may have been followed wrongly.
        far = np.hypot(*(points["own"] - points["held"]).T)
        far = np.maximum(far, np.hypot(*(points["travel"] - points["stuck"]).T))
        far = np.maximum(far, np.quantile(far[good], STANDING))
        noise = np.hypot(noise, UNEVEN * far)
        gxx, gxy, gyy = points["gradient"][good].T.astype(float)
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
        assert self._ridges is not None
        now = self._ridges.to_plate(place)
        step = now - self._ridges.to_plate(place - moved)
        self._slip += step.mean(axis=0)
        self._rotation += _rotation(now, step)


def _coarse(mask: np.ndarray) -> np.ndarray:
    """Every COARSE-th pixel of a mask (h, w) both ways."""
    return np.ascontiguousarray(mask[::COARSE, ::COARSE])


def _rotation(places: np.ndarray, moved: np.ndarray) -> float:
    """Angle (rad) of the rotation in a motion (n, 2) of places (n, 2), by least squares."""
    arm = places - places.mean(axis=0)
    around = arm[:, 0] * moved[:, 1] - arm[:, 1] * moved[:, 0]
    return float(around.sum() / max((arm**2).sum(), 1e-12))


def with_motion(
    contact: ContactMeasurement, image: np.ndarray, motion: RidgeMotion | None
) -> ContactMeasurement:
    """A measured contact with the motion of its skin, as `motion` has followed it to this image.

    A signal that is no image leaves it as it is.
    """
    if motion is None:
        return contact
    try:
        found = motion.track(image, contact)
    except InputError:
        return contact
    flags = contact.flags | (AreaFlag.SLIDING if found.sliding else 0)
    return replace(contact, motion=found, flags=int(flags))
