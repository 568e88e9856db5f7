# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Draw docs/figures/stick_zone.png: where the skin slips in a pull, by the three-dimensional model
and by the camera.

    python scripts/stick_zone_picture.py

Left the model: a finger of 8.5 × 6.5 mm pressed to 0.52 N, friction 0.5, pulled to the right. Right
the ridges of a rendered pull at the same |Q|/(μP), as `finger_vision.ridge_motion` follows them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from finger_model.fem.equilibrium import OPEN
from finger_model.solid3d.full_order import SolidModel
from finger_model.verification.cases import CALCULIX_FINGER, elastic
from finger_model.verification.solids import SHEAR_DEPTH
from finger_sim.ftir import Contact, FtirRenderer
from finger_sim.skin_slip import SkinSlip
from finger_vision.followed_points import in_newest
from finger_vision.ftir import FtirSegmenter
from finger_vision.ridge_motion import RidgeMotion

FIGURE = Path(__file__).resolve().parent.parent / "docs" / "figures" / "stick_zone.png"
FRICTION = 0.5
SHIFTS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]) * 1e-3
SHOWN = (3, 5)
"""Steps of SHIFTS that are drawn."""
THRESHOLD = 2.5e-6
"""m, from which skin counts as slipped, as for the camera."""
STICKS, SLIPS = "#0072b2", "#e69f00"


def pulled() -> list[tuple[float, float, np.ndarray, np.ndarray]]:
    """|Q|/(μP), contact radius (m), places (n, 2) and slips (n,) in m of the touching nodes (y > 0)
    at each shift of the plate."""
    model = SolidModel(CALCULIX_FINGER, refinement=0.8)
    stepper = model.start(elastic(30.23e3, E2=1652e3, friction=FRICTION))
    for k in range(1, 6):
        stepper.step_to_position(float(k), SHEAR_DEPTH * k / 5)
    surface = model.mesh.surface

    def on_plate() -> np.ndarray:
        state = stepper.state
        return state.positions[surface, :2] - state.contact.plate[:2]

    begin, found = on_plate(), []
    touched = stepper.state.contact.status != OPEN
    for k, shift in enumerate(SHIFTS):
        point = stepper.step_to_position(6.0 + k, SHEAR_DEPTH, (float(shift), 0.0))
        ratio = math.hypot(point.tangential_x, point.tangential_y) / (FRICTION * point.force)
        both = touched & (stepper.state.contact.status != OPEN)
        here = on_plate()
        slip = np.hypot(*(here - begin)[both].T)
        center = here[both].mean(axis=0)
        found.append((ratio, point.radius, here[both] - [center[0], 0.0], slip))
    return found


def seen(ratios: list[float], radius: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Image, places (n, 2) in pixels and slips (n,) in m of the followed points at each ratio."""
    renderer = FtirRenderer("natural", 11, width=640, height=480)
    calibration = renderer.calibration()
    segmenter, motion = FtirSegmenter(calibration=calibration), RidgeMotion(calibration=calibration)
    # The plate moves to the right over the skin: seen from it the skin goes to the left.
    still = SkinSlip(direction=math.pi, reach=60e-6, lag=0.35)

    def show(image: np.ndarray) -> np.ndarray:
        motion.track(image, segmenter.process(image))
        return image

    for _ in range(3):
        show(renderer.empty())
    for part in np.linspace(0.7, 1.0, 8):
        show(renderer.render_frame([Contact(radius * part, slip=still)]).image)
    found = []
    wanted = sorted({0.0, *np.arange(0.1, max(ratios), 0.1), *ratios})
    for ratio in wanted:
        contact = Contact(radius, slip=replace(still, ratio=ratio))
        image = show(renderer.render_frame([contact]).image)
        if ratio in ratios:
            points = motion.points[in_newest(motion.points)]
            slip = np.hypot(*(points["travel"] - points["stuck"]).T) * motion.pitch
            pixels = points["place"] * image.shape[1] / motion.ridges.frame(image).shape[1]
            found.append((image, pixels, slip * points["slipped"]))
    return found


def main() -> None:
    """Draw the figure."""
    steps = pulled()
    shown = [steps[k] for k in SHOWN]
    views = seen([s[0] for s in shown], shown[0][1])
    figure, rows = plt.subplots(len(shown), 2, figsize=(7.2, 3.2 * len(shown)), layout="tight")
    for (ratio, _, places, slips), (image, pixels, seen_slip), (left, right) in zip(
        shown, views, rows
    ):
        whole = np.concatenate([places, places * [1, -1]]) * 1e3
        double = np.concatenate([slips, slips])
        sticks = double < THRESHOLD
        left.scatter(*whole[sticks].T, s=9, c=STICKS, label="sticks")
        drawn = left.scatter(*whole[~sticks].T, s=9, c=double[~sticks] * 1e6, cmap="autumn_r")
        figure.colorbar(drawn, ax=left, label="slip (µm)")
        left.set_aspect("equal")
        left.set_title(f"model, |Q| = {ratio:.2f} μP", fontsize=10)
        left.set_xlabel("along the pull (mm)")
        right.imshow(image, cmap="gray", vmin=0, vmax=255)
        sticks = seen_slip < THRESHOLD
        right.scatter(*pixels[sticks].T, s=9, c=STICKS)
        right.scatter(*pixels[~sticks].T, s=9, c=SLIPS)
        middle, reach = pixels.mean(axis=0), 1.25 * np.ptp(pixels[:, 1]) / 2
        right.set_xlim(middle[0] - reach, middle[0] + reach)
        right.set_ylim(middle[1] + reach, middle[1] - reach)
        right.set_xticks([])
        right.set_yticks([])
        right.set_title("camera: blue sticks, orange slips", fontsize=10)
    figure.savefig(FIGURE, dpi=110)


if __name__ == "__main__":
    main()
