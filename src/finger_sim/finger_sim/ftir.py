# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""FTIR renderer: a known contact on the plate becomes a camera frame.

A print is touched where the distance from a ridge's crest is below a width that grows with the
local pressure (Hertz-like, zero at the rim of the gross contact). The appearance of the skin says
how wide, how broken and how dark the ridges are. The plate carries illumination with vignetting, a
background texture, dust and the latent print of an earlier press; the camera adds perspective,
blur, noise and quantisation.

The width of a touching ridge and all appearances are assumptions of this project.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_vision.calibration import PAPER_AREA_PER_PIXEL, PlateCalibration

from .fingerprint import Fingerprint, smooth_noise
from .skin_slip import SkinSlip

IMAGE_WIDTH, IMAGE_HEIGHT = 1280, 1024
AREA_PER_PIXEL = PAPER_AREA_PER_PIXEL
"""m², of one pixel of a camera that looks squarely at the plate."""

NOT_MODELLED = (
    "skin that stretches or folds: without `SkinSlip` the same print is uncovered and covered",
    "a rim of the gross contact other than an ellipse, and a pressure other than Hertz-like",
    "change of the print with time: sweat that spreads, ridges that grow under hold",
    "light through the prism: stray reflections, lens distortion, defocus over the tilted plate",
    "noise that grows with brightness, dead pixels, motion blur and the camera's gamma",
)
"""What a user of rendered frames must not expect from them."""


@dataclass(frozen=True)
class SkinAppearance:
    """How skin of one moisture appears in FTIR. Lengths relative to the ridge period.

    ridge_width: fraction of the period that touches at the centre of the contact.
    rim_exponent: the width falls towards the rim as (1 − ρ²) to this power. 1/4 follows from a
    Hertz-like pressure, p ~ (1 − ρ²)^(1/2), and round ridges, whose width in contact grows as
    p^(1/2) (line contact of cylinders); sweat softens ridges and fills the wedge beside them, so
    that moist ones lose less.
    roughness: standard deviation of the fine relief that breaks ridges, fraction of half a period.
    contrast: of a touching ridge, fraction of the background (dark polarity) or of the grey range
    (bright).
    patchiness: relative standard deviation of the contrast over the contact.
    flooding: share of the contact in which sweat fills the furrows.
    """

    ridge_width: float
    rim_exponent: float
    roughness: float
    contrast: float
    patchiness: float
    flooding: float = 0.0


SKINS = {
    "dry": SkinAppearance(0.50, 0.25, 0.22, 0.45, 0.25),
    "natural": SkinAppearance(0.62, 0.25, 0.08, 0.65, 0.15),
    "moist": SkinAppearance(0.82, 0.15, 0.04, 0.85, 0.05, flooding=0.25),
}
"""Skin by condition. Assumptions, chosen after pictures of optical prints."""


@dataclass(frozen=True)
class Scene:
    """All of a frame but contact and skin. Lengths in m, angles in rad, greys 0…255.

    tilt: of the optical axis against the plate's normal, 0…20° by design; tilt_direction: of the
    tilt, in the image plane. distance: of the camera from the plate along the optical axis (an
    assumption). vignetting: relative loss of light in the corners. gradient: relative change of
    light over the width. texture: relative standard deviation of the plate's own texture. noise:
    standard deviation of the sensor. dust: number of specks. latent: contrast of an earlier
    press's print relative to a true one.
    """

    ridge_period: float = 0.5e-3
    background: float = 190.0
    bright_ridges: bool = False
    vignetting: float = 0.25
    gradient: float = 0.05
    texture: float = 0.01
    noise: float = 2.5
    blur: float = 0.7
    dust: int = 20
    latent: float = 0.05
    tilt: float = 0.0
    tilt_direction: float = 0.0
    distance: float = 0.15


@dataclass(frozen=True)
class Contact:
    """An elliptical contact of gross area π radius².

    radius, centre: m, plate frame. aspect: ratio of the axes, ≥ 1. angle: rad, of the major axis
    from +x towards +y. slip: how the skin has moved over the plate; None: not at all, and the
    print's centre is the contact's.
    """

    radius: float
    centre: tuple[float, float] = (0.0, 0.0)
    aspect: float = 1.0
    angle: float = math.pi / 2
    slip: SkinSlip | None = None

    @property
    def semi_axes(self) -> tuple[float, float]:
        """Major and minor semi-axis, m."""
        root = math.sqrt(self.aspect)
        return self.radius * root, self.radius / root

    def outline(self, points: int = 96) -> np.ndarray:
        """Points (points, 2) on the rim, m."""
        t = np.linspace(0, 2 * math.pi, points, endpoint=False)
        major, minor = self.semi_axes
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y = major * np.cos(t), minor * np.sin(t)
        return np.stack([self.centre[0] + c * x - s * y, self.centre[1] + s * x + c * y], axis=1)


@dataclass(frozen=True)
class RenderedFrame:
    """A frame and the true areas (m²) of its first contact.

    gross_area: of the whole contact. real_area: of the visible ridges. clipped: whether the
    contact runs over the border of the frame.
    """

    image: np.ndarray
    gross_area: float
    real_area: float
    clipped: bool


@dataclass
class FtirRenderer:
    """Renders contacts of one finger as frames of 1280×1024 mono8.

    skin: "dry", "natural", "moist" or a `SkinAppearance`. seed: print, plate and noise follow from
    it and the order of calls alone. Construction takes about a second, a frame of a 60 mm² contact
    about 10 ms. Plate frame: origin on the optical axis, x right, y down, m. Raises InputError for
    an unknown skin or a tilt out of range.
    """

    skin: str | SkinAppearance = "natural"
    seed: int = 0
    scene: Scene = field(default_factory=Scene)
    width: int = IMAGE_WIDTH
    height: int = IMAGE_HEIGHT

    def __post_init__(self) -> None:
        if isinstance(self.skin, SkinAppearance):
            self._appearance = self.skin
        elif self.skin in SKINS:
            self._appearance = SKINS[self.skin]
        else:
            raise InputError(f"skin '{self.skin}' does not exist; choose {', '.join(SKINS)}")
        if not 0 <= self.scene.tilt < math.radians(60):
            raise InputError(f"tilt {self.scene.tilt:g} rad is outside 0 … 1.04; correct it")
        rng = np.random.default_rng(self.seed)
        self._layers = self._layers_of(Fingerprint.draw(rng, self.scene.ridge_period))
        self.camera_matrix, self.homography = self._camera()
        self._to_plate = np.linalg.inv(self.homography)
        self._x, self._y, self._pixel_area = self._plate_grid()
        self._plate, self._touched = self._paint_plate(rng)
        self._empty = np.clip(np.rint(self._plate), 0, 255).astype(np.uint8)
        self._rng = np.random.default_rng(rng.integers(2**63))
        margin = 128
        self._noise = np.clip(
            np.rint(
                self._rng.standard_normal((self.height + margin, self.width + margin), np.float32)
                * self.scene.noise
            ),
            -127,
            127,
        ).astype(np.int8)
        self._margin = margin

    # Public ----------------------------------------------------------------------------------

    def restart_noise(self, rng: np.random.Generator) -> None:
        """Take the noise of the frames that follow from `rng`, whatever was rendered before."""
        self._rng = rng

    def empty(self) -> np.ndarray:
        """Frame (height, width) uint8 of the plate without a finger."""
        return self._with_noise(self._empty)

    def render(
        self,
        radius: float,
        centre: tuple[float, float] = (0.0, 0.0),
        aspect: float = 1.0,
    ) -> np.ndarray:
        """Frame (height, width) uint8 of one `Contact`; a radius ≤ 0 is no contact."""
        return self.render_frame([Contact(radius, centre, aspect)]).image

    def render_frame(self, contacts: Iterable[Contact]) -> RenderedFrame:
        """Frame of several contacts of the same finger, with the true areas of the first one."""
        frame = self._empty
        gross = real = 0.0
        clipped = False
        for index, contact in enumerate(contacts):
            if not contact.radius > 0:
                continue
            if contact.aspect < 1:
                raise InputError(f"aspect {contact.aspect:g} is below 1; swap the axes")
            if frame is self._empty:
                frame = self._empty.copy()
            area, over = self._press(frame, contact)
            if index == 0:
                gross, real, clipped = math.pi * contact.radius**2, area, over
        return RenderedFrame(self._with_noise(frame), gross, real, clipped)

    def calibration(self) -> PlateCalibration:
        """Plate calibration of the simulated camera, without error."""
        return PlateCalibration(
            AREA_PER_PIXEL,
            np.linalg.inv(self.homography),
            self.camera_matrix,
            image_size=(self.width, self.height),
            camera_name="camera",
        )

    # Parts -----------------------------------------------------------------------------------

    def _camera(self) -> tuple[np.ndarray, np.ndarray]:
        """Camera matrix (3, 3) and homography (3, 3) from the plate (m) to pixels."""
        scene = self.scene
        focal = scene.distance / math.sqrt(AREA_PER_PIXEL)
        camera = np.array(
            [[focal, 0, (self.width - 1) / 2], [0, focal, (self.height - 1) / 2], [0, 0, 1]]
        )
        c, s = math.cos(scene.tilt_direction), math.sin(scene.tilt_direction)
        axis = np.array([-s, c, 0.0]) * scene.tilt
        rotation, _ = cv2.Rodrigues(axis)
        pose = np.column_stack([rotation[:, 0], rotation[:, 1], [0, 0, scene.distance]])
        homography = camera @ pose
        return camera, homography / homography[2, 2]

    def _plate_grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Plate coordinates (m) and area (m²) of each pixel, float32."""
        u, v = np.arange(self.width, dtype=float), np.arange(self.height, dtype=float)[:, None]
        g = self._to_plate
        x, y, w = (row[0] * u + (row[1] * v + row[2]) for row in g)
        x /= w
        y /= w
        # Jacobian of a homography: det(G) / w³.
        area = abs(np.linalg.det(g)) / np.abs(w * w * w)
        return x.astype(np.float32), y.astype(np.float32), area.astype(np.float32)

    def _paint_plate(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Greys of the bare plate and of a fully touched plate, float32."""
        scene, skin = self.scene, self._appearance
        x = np.linspace(-1, 1, self.width, dtype=np.float32)[None, :]
        y = np.linspace(-1, 1, self.height, dtype=np.float32)[:, None]
        light = (1 - scene.vignetting * (x * x + y * y) / 2) * (1 + scene.gradient * x / 2)
        grain = smooth_noise(rng, max(self.width, self.height), 3.0)[: self.height, : self.width]
        cloud = smooth_noise(rng, max(self.width, self.height), 60.0)[: self.height, : self.width]
        plate = scene.background * light * (1 + scene.texture * (0.7 * grain + 0.7 * cloud))
        if scene.bright_ridges:
            touched = plate + 255 * skin.contrast * light
        else:
            touched = plate * (1 - skin.contrast)
        if scene.latent > 0:
            earlier = Contact(
                rng.uniform(3e-3, 6e-3),
                (rng.uniform(-6e-3, 6e-3), rng.uniform(-4e-3, 4e-3)),
                rng.uniform(1, 1.6),
                rng.uniform(-math.pi, math.pi),
            )
            coverage, patches, box = self._coverage(
                earlier, self._layers_of(Fingerprint.draw(rng, scene.ridge_period))
            )
            plate[box] += scene.latent * coverage * patches * (touched[box] - plate[box])
        specks: np.ndarray = np.zeros((self.height, self.width), np.float32)
        for _ in range(scene.dust):
            centre = (int(rng.integers(self.width)), int(rng.integers(self.height)))
            radius = max(1, int(rng.exponential(60e-6) / math.sqrt(AREA_PER_PIXEL)))
            cv2.circle(specks, centre, radius, float(rng.uniform(-0.7, 0.7)), -1, cv2.LINE_AA)
        specks = cv2.GaussianBlur(specks, (0, 0), 1.0)
        scale = 120.0 if scene.bright_ridges else scene.background
        return (plate + specks * scale).astype(np.float32), touched.astype(np.float32)

    def _coverage(
        self, contact: Contact, layers: tuple[np.ndarray, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, tuple[slice, slice]]:
        """Touched fraction and relative contrast (float32) of each pixel in a box, and the box."""
        skin = self._appearance
        rim = cv2.perspectiveTransform(contact.outline()[None], self.homography)[0]
        left, top = np.floor(rim.min(axis=0)).astype(int) - 4
        right, bottom = np.ceil(rim.max(axis=0)).astype(int) + 5
        left, top = max(left, 0), max(top, 0)
        right, bottom = min(right, self.width), min(bottom, self.height)
        if right <= left or bottom <= top:
            nothing = np.zeros((0, 0), np.float32)
            return nothing, nothing, (slice(0, 0), slice(0, 0))
        box = (slice(top, bottom), slice(left, right))
        # Finger frame: x across, y along the finger; the major axis is the finger's y axis.
        along = contact.angle - math.pi / 2
        c, s = math.cos(along), math.sin(along)
        major, minor = contact.semi_axes
        dx = self._x[box] - np.float32(contact.centre[0])
        dy = self._y[box] - np.float32(contact.centre[1])
        u = (dx * np.float32(-s) + dy * np.float32(c)) * np.float32(1 / major)
        v = (dx * np.float32(c) + dy * np.float32(s)) * np.float32(1 / minor)
        if contact.slip is not None:
            dx, dy = self._touched_at(contact.slip, box, u, v, contact.angle)
        half = np.float32((Fingerprint.SIZE - 1) / 2)
        c_print, s_print = np.float32(c / Fingerprint.PITCH), np.float32(s / Fingerprint.PITCH)
        place = half + c_print * dx + s_print * dy, half + c_print * dy - s_print * dx
        touch, patches = (
            cv2.remap(layer, *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
            for layer in layers
        )
        inside = 1 - (u * u + v * v)
        pixel = math.sqrt(AREA_PER_PIXEL)
        width = np.maximum(inside, 0)
        cv2.pow(width, skin.rim_exponent, width)
        width *= np.float32(skin.ridge_width)
        # Distance from the edge of the touching strip in pixels, turned into a covered fraction.
        touch = np.subtract(width, touch, out=touch)
        touch *= np.float32(self.scene.ridge_period / 2 / pixel)
        touch += np.float32(0.5)
        np.clip(touch, 0, 1, out=touch)
        # 1 − ρ² ≈ 2 (distance from the rim) / radius near the rim.
        inside *= np.float32(contact.radius / 2 / pixel)
        inside += np.float32(0.5)
        np.clip(inside, 0, 1, out=inside)
        touch *= inside
        return touch, patches, box

    def _touched_at(
        self, slip: SkinSlip, box: tuple[slice, slice], u: np.ndarray, v: np.ndarray, angle: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Places in the print, m from its centre, of the skin at the box's pixels.

        u, v: along the major and minor axis, 1 at the rim. angle: of the major axis, rad.
        """
        turn = slip.direction - angle
        # The minor axis points 90° back from the major one.
        c, s = math.cos(turn), -math.sin(turn)
        rho = np.stack([c * u + s * v, c * v - s * u], axis=-1)
        x, y = slip.touched_at(self._x[box], self._y[box], rho)
        return (
            np.asarray(x - slip.origin[0], np.float32),
            np.asarray(y - slip.origin[1], np.float32),
        )

    def _layers_of(self, finger: Fingerprint) -> tuple[np.ndarray, np.ndarray]:
        """Crest distance with the skin's relief, and relative contrast, on the print's grid."""
        skin = self._appearance
        distance = finger.crest_distance + skin.roughness * finger.relief
        if skin.flooding > 0:
            # Sweat fills furrows where the coarse relief is in its upper share.
            level = np.quantile(finger.patches, 1 - skin.flooding)
            wet = np.clip((finger.patches - level) * 4, 0, 1)
            distance = distance * (1 - wet)
        patches = np.clip(1 + skin.patchiness * np.roll(finger.patches, 301, axis=0), 0.3, 1.4)
        return distance.astype(np.float32), patches.astype(np.float32)

    def _press(self, frame: np.ndarray, contact: Contact) -> tuple[float, bool]:
        """Paint a contact into a frame; real area (m²), and whether the border cuts it."""
        touch, patches, box = self._coverage(contact, self._layers)
        if touch.size == 0:
            return 0.0, True
        real = float(np.vdot(touch, self._pixel_area[box]))
        touch *= patches
        if self.scene.blur > 0:
            touch = cv2.GaussianBlur(touch, (0, 0), self.scene.blur)
        painted = self._touched[box] - self._plate[box]
        painted *= touch
        painted += self._plate[box]
        frame[box] = cv2.convertScaleAbs(np.maximum(painted, 0, out=painted))
        top, left = box[0].start, box[1].start
        clipped = top == 0 or left == 0 or box[0].stop == self.height or box[1].stop == self.width
        return real, clipped

    def _with_noise(self, frame: np.ndarray) -> np.ndarray:
        row, column = self._rng.integers(self._margin, size=2)
        noise = self._noise[row : row + self.height, column : column + self.width]
        return cv2.add(frame, noise, dtype=cv2.CV_8U)
