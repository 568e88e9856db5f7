# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Thresholds and times that a guided trial must keep."""

from __future__ import annotations

from dataclasses import dataclass

from finger_common.contact_threshold import LIFTOFF_FORCE, ONSET_FORCE, check_thresholds
from finger_common.moisture import MOISTURE_RANGE
from finger_common.settings import Settings, setting
from finger_common.usable_press import FEWEST_FRAMES, LONGEST_GAP, LONGEST_HOLE


@dataclass(frozen=True)
class Limits(Settings):
    """Limits of the protocol, parameters of its node (N, s)."""

    confirm_preparation: bool = setting(
        True, "Wait for the operator before each trial; false: trials begin without it."
    )
    need_camera: bool = setting(
        True, "A trial needs contact areas; false for a rig without camera."
    )
    need_recorder: bool = setting(True, "Every trial is recorded; false for rehearsals.")
    onset_force: float = setting(
        ONSET_FORCE,
        "Force from which the finger counts as on the plate.",
        "N",
        0.001,
        1.0,
        runtime=True,
    )
    liftoff_force: float = setting(
        LIFTOFF_FORCE,
        "Force below which the finger counts as off the plate.",
        "N",
        0.0,
        1.0,
        runtime=True,
    )
    clear_time: float = setting(
        0.5,
        "How long the frame must be empty before the cue to press.",
        "s",
        0.0,
        60.0,
        runtime=True,
    )
    release_time: float = setting(
        0.5,
        "How long the finger must be off the plate to end the press.",
        "s",
        0.05,
        60.0,
        runtime=True,
    )
    press_timeout: float = setting(
        30.0, "Longest wait for the finger after the cue to press.", "s", 1.0, 600.0, runtime=True
    )
    target_timeout: float = setting(
        10.0, "Longest time from first touch to the target.", "s", 0.5, 600.0, runtime=True
    )
    pull_timeout: float = setting(
        10.0, "Longest time from the cue to pull to the slip.", "s", 0.5, 600.0, runtime=True
    )
    lift_timeout: float = setting(
        10.0, "Longest time from the cue to lift-off.", "s", 0.5, 600.0, runtime=True
    )
    gap_limit: float = setting(
        LONGEST_GAP,
        "Gap between two force samples that makes a trial invalid.",
        "s",
        0.002,
        10.0,
        runtime=True,
        advice="Raise it above the sample period of a slow sensor.",
    )
    frame_gap_limit: float = setting(
        0.0,
        "Gap between two contact areas that makes a trial invalid; 0: the one for which a fit "
        f"leaves the trial out, {LONGEST_HOLE:g} periods of the camera.",
        "s",
        0.0,
        10.0,
        runtime=True,
        advice="Set it only for rehearsals on a machine that is too slow.",
    )
    zero_limit: float = setting(
        0.05,
        "Difference of the free plate's force before and after a press that makes a trial invalid.",
        "N",
        0.001,
        10.0,
        runtime=True,
    )
    stale_after: float = setting(
        0.5,
        "Age of the newest force or area from which its source counts as silent.",
        "s",
        0.05,
        60.0,
        runtime=True,
        advice="Raise it when the clock of a device lags.",
    )
    minimum_frames: int = setting(
        FEWEST_FRAMES,
        "Frames with contact that a valid press needs up to the target.",
        minimum=0,
        maximum=1000,
        runtime=True,
    )
    least_moisture: float = setting(
        1.0,
        "Least moisture reading that counts; a probe in the air reads 0.",
        "a.u.",
        *MOISTURE_RANGE,
        runtime=True,
        advice="Lower it for a source that reads less on dry skin.",
    )
    moisture_spread: float = setting(
        20.0,
        "Range of the readings of one step beyond which a warning is given; three times the "
        "largest deviation within a condition of the paper.",
        "a.u.",
        *MOISTURE_RANGE,
        runtime=True,
    )
    verdict_time: float = setting(
        1.5, "How long a verdict is shown before the next trial.", "s", 0.1, 60.0, runtime=True
    )
    record_timeout: float = setting(
        10.0, "Longest wait for the recorder's answer.", "s", 0.5, 120.0, runtime=True
    )
    lost_limit: int = setting(
        0,
        "Messages the recorder may lose in a valid trial.",
        minimum=0,
        maximum=100000,
        runtime=True,
        advice="Raise it only for rehearsals on a machine that is too slow.",
    )
    max_attempts: int = setting(
        5,
        "Failures of one trial after which the session pauses.",
        minimum=1,
        maximum=100,
        runtime=True,
    )

    def validate(self) -> None:
        check_thresholds(self.onset_force, self.liftoff_force)
