"""Draw the pictures of docs/vision.md (failures) and docs/vision_method.md (steps)."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import cv2
import numpy as np

from finger_common.flags import AreaFlag, flag_names
from finger_sim.ftir import Contact, FtirRenderer, Scene
from finger_vision.ftir import FtirSegmenter

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "figures"
SIDE = 260
"""Pixels of a panel's side."""


def label(picture: np.ndarray, *lines: str) -> np.ndarray:
    """Panel with lines of text under it."""
    strip = np.full((20 * len(lines) + 6, picture.shape[1], 3), 255, np.uint8)
    for index, line in enumerate(lines):
        cv2.putText(
            strip,
            line,
            (4, 17 + 20 * index),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.42,
            (0, 0, 0),
            1,
            cv2.LINE_AA,
        )
    return np.vstack([picture, strip])


def panel(image: np.ndarray, centre: tuple[int, int], half: int) -> np.ndarray:
    """Square cut about a centre (x, y), as a BGR panel."""
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    x, y = centre
    padded = cv2.copyMakeBorder(
        image, half, half, half, half, cv2.BORDER_CONSTANT, value=(255,) * 3
    )
    cut = padded[y : y + 2 * half, x : x + 2 * half]
    return cv2.resize(cut, (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def steps_of(skin: str, seed: int) -> np.ndarray:
    """Row of panels: frame, background, contrast, ridges, region, outline."""
    scene = Scene(vignetting=0.4, latent=0.08, dust=40, tilt=math.radians(10), tilt_direction=0.5)
    renderer = FtirRenderer(skin, seed, scene)
    segmenter = FtirSegmenter()
    for _ in range(5):
        segmenter.process(renderer.empty())
    frame = renderer.render_frame([Contact(4.8e-3, (0, 0), 1.35)])
    measured = segmenter.process(frame.image)
    steps = segmenter.steps
    assert steps is not None and steps.ridges is not None
    full = {}
    for name in ("touching", "region"):
        full[name] = np.zeros_like(steps.frame)
        full[name][steps.ridges.box] = getattr(steps.ridges, name)
    centre, half = (320, 256), 130
    overlay = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
    outline = segmenter.calibration.to_pixels(measured.hull, 1280, 1024)
    cv2.polylines(overlay, [np.rint(outline).astype(np.int32)], True, (0, 170, 0), 3, cv2.LINE_AA)
    panels = [
        label(panel(steps.frame, centre, half), f"{skin}: frame"),
        label(panel(steps.background, centre, half), "learned background"),
        label(panel(cv2.convertScaleAbs(steps.contrast, alpha=1.5), centre, half), "contrast"),
        label(panel(full["touching"], centre, half), f"ridges {measured.real_area * 1e6:.1f} mm2"),
        label(panel(full["region"], centre, half), "region"),
        label(panel(overlay, (640, 512), 2 * half), f"outline {measured.gross_area * 1e6:.1f} mm2"),
    ]
    return np.hstack(panels)


def failures() -> np.ndarray:
    """Row of panels of what is still measured wrongly."""
    panels = []

    def add(title: str, renderer: FtirRenderer, contacts: list[Contact], x: int = 640) -> None:
        segmenter = FtirSegmenter()
        frame = renderer.render_frame(contacts)
        measured = segmenter.measure(frame.image)
        overlay = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
        if len(measured.hull):
            outline = segmenter.calibration.to_pixels(measured.hull, 1280, 1024)
            cv2.polylines(
                overlay, [np.rint(outline).astype(np.int32)], True, (0, 0, 220), 3, cv2.LINE_AA
            )
        error = 100 * (measured.gross_area / frame.gross_area - 1)
        names = flag_names(
            AreaFlag(measured.flags) & ~(AreaFlag.UNCALIBRATED | AreaFlag.NO_BACKGROUND)
        )
        panels.append(label(panel(overlay, (x, 512), 420), title, f"{error:+.0f} %  {names}"))
        print(f"{title}: {error:+.1f} % {names}")

    strong = Scene(latent=0.35)
    add("strong earlier print, no background", FtirRenderer("natural", 13, strong), [Contact(4e-3)])
    close = FtirRenderer("natural", 3, Scene(latent=0.0))
    add(
        "second contact 0.4 mm away",
        close,
        [Contact(4.5e-3, (0, -3e-3)), Contact(2.8e-3, (0, 4.36e-3), 1.3, 0.0)],
    )
    add("first touch, dry", FtirRenderer("dry", 4, Scene(latent=0.0)), [Contact(0.8e-3)])
    wet = FtirRenderer("moist", 5, Scene(latent=0.0))
    add("contact over the border", wet, [Contact(5e-3, (18e-3, 0))], 860)
    return np.hstack(panels)


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows = [steps_of(skin, 30 + index) for index, skin in enumerate(("dry", "natural", "moist"))]
    cv2.imwrite(str(FOLDER / "vision_steps.png"), np.vstack(rows))
    cv2.imwrite(str(FOLDER / "vision_failures.png"), failures())


if __name__ == "__main__":
    main()
