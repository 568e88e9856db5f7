"""Time of one 1280×1024 frame to a ContactArea's fields, one core, plate calibration on; frames of
640×480 a second with ridges followed."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from finger_sim.ftir import AREA_PER_PIXEL, Contact, FtirRenderer, Scene
from finger_sim.skin_slip import SkinSlip
from finger_vision.area_sensor import ContactMeasurement
from finger_vision.calibration import PlateCalibration
from finger_vision.ftir import FtirSegmenter
from finger_vision.messages import contact_area_fields
from finger_vision.ridge_motion import RidgeMotion

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
import stick_errors


def _median(
    measure: Callable[[np.ndarray], ContactMeasurement], frames: list[np.ndarray], number: int
) -> float:
    """Median time in ms from a frame to a ContactArea's fields."""
    times = []
    for index in range(number):
        start = time.perf_counter()
        contact_area_fields(measure(frames[index % len(frames)]))
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def run(report: Any) -> None:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        renderer = FtirRenderer("natural", 3, Scene(tilt=math.radians(15), tilt_direction=0.4))
        calibration = PlateCalibration(
            AREA_PER_PIXEL,
            np.linalg.inv(renderer.homography),
            renderer.camera_matrix,
            np.array([-0.12, 0.15, 0.0008, -0.0005, 0.0]),
            (renderer.width, renderer.height),
        )
        contacts = [Contact(radius * 1e-3, aspect=1.3) for radius in (1.5, 2.5, 3.5, 4.5, 5.5)]
        frames = [renderer.render_frame([contact]).image for contact in contacts]
        learned = FtirSegmenter(calibration=calibration)
        for _ in range(5):
            learned.learn(renderer.empty())
        number = 50 if report.quick else 400
        _median(learned.process, frames, 20)
        report.add("vision_frame", _median(learned.process, frames, number), "ms", goal=3.0)
        guessed = FtirSegmenter(calibration=calibration)
        report.add(
            "vision_frame_without_background", _median(guessed.measure, frames, number // 4), "ms"
        )
        report.add(
            "vision_frame_empty", _median(learned.process, [renderer.empty()], number // 4), "ms"
        )
        times = []
        for contact in contacts * 8:
            start = time.perf_counter()
            renderer.render_frame([contact])
            times.append(time.perf_counter() - start)
        report.add("ftir_render_frame", 1e3 * float(np.median(times)), "ms", goal=25.0)
        _memory(report, learned, [renderer.empty(), *frames])
        report.add("flow_frames", _followed(report.quick), "1/s", goal=30.0, better="higher")
        pulls = 6 if report.quick else 60
        followed = [stick_errors.followed(stick_errors.first_pull(5000 + k)) for k in range(pulls)]
        report.add("ridge_stick_rms", stick_errors.rms(followed), "1", goal=0.05)
        report.note(f"ridge_stick_rms: of the stick ratio over {pulls} rendered pulls")
    finally:
        cv2.setNumThreads(threads)


def _followed(quick: bool) -> float:
    """Frames of 640×480 of a pulled contact of 80 mm² per second, from frame to stick ratio."""
    renderer = FtirRenderer("natural", 5, width=640, height=480)
    contact = Contact(5e-3, aspect=1.3)
    slips = [SkinSlip(ratio=r, reach=90e-6, lag=0.6) for r in np.linspace(0.0, 0.95, 15)]
    frames = [renderer.render_frame([replace(contact, slip=slip)]).image for slip in slips]
    segmenter = FtirSegmenter(calibration=renderer.calibration())
    motion = RidgeMotion(calibration=renderer.calibration())
    for _ in range(3):
        motion.track(renderer.empty(), segmenter.process(renderer.empty()))
    times = []
    for frame in frames * (2 if quick else 10):
        start = time.perf_counter()
        motion.track(frame, segmenter.process(frame))
        times.append(time.perf_counter() - start)
    return 1.0 / float(np.median(times))


def _memory(report: Any, segmenter: FtirSegmenter, frames: list[np.ndarray]) -> None:
    """Growth of the process's resident memory over many frames."""

    def resident() -> float:
        with open("/proc/self/status") as file:
            for line in file:
                if line.startswith("VmRSS"):
                    return float(line.split()[1]) / 1024
        return math.nan

    number = 300 if report.quick else 10_000
    for index in range(100):
        segmenter.process(frames[index % len(frames)])
    before = resident()
    for index in range(number):
        segmenter.process(frames[index % len(frames)])
    report.add("vision_memory_growth", resident() - before, "MB", goal=5.0)
    report.note(f"memory over {number} frames")
