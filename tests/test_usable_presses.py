"""The guided protocol keeps no press that a fit leaves out: both get the same streams."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_bag.schema import SessionMetadata
from finger_bag.streams import (
    AREA,
    IMAGE,
    INDENTATION,
    MoistureReading,
    SessionStreams,
    TrialEvent,
    Wrenches,
)
from finger_common.flags import AreaFlag
from finger_fit.options import FitOptions
from finger_fit.problem import prepare_all
from finger_offline.trial_split import TrialSettings, split

Disturb = Callable[["Presses"], None]


class Presses:
    """A trial on the simulated rig of the protocol's tests, and all that a bag would hold of it.

    force: of a sample, from the true one and the stamp. frames: numbers of the frames with a
    contact -> None to lose them, or flags to add.
    """

    def __init__(self, study_rig: Any, folder: Path) -> None:
        self.rig = study_rig.Rig(folder, conditions=("natural",), trials=1)
        self.force: Callable[[float, int], float] = lambda true, stamp: true
        self.frames: dict[int, int | None] = {}
        self.press: Callable[[], None] = self.rig.press
        self._forces: list[tuple[int, float]] = []
        self._areas: list[tuple[int, float, int]] = []
        self._readings: list[MoistureReading] = []
        self._seen = 0
        protocol = self.rig.protocol
        self._to_protocol = protocol.wrench, protocol.area, protocol.moisture
        protocol.wrench, protocol.area = self._wrench, self._area
        protocol.moisture = self._moisture

    def _wrench(self, stamp: int, true: float) -> None:
        force = self.force(true, stamp)
        self._forces.append((stamp, force))
        self._to_protocol[0](stamp, force)

    def _area(self, stamp: int, area: float, flags: int) -> None:
        if area > 0.0:
            self._seen += 1
            more = self.frames.get(self._seen, 0)
            if more is None:
                return
            flags |= more
        self._areas.append((stamp, area, flags))
        self._to_protocol[1](stamp, area, flags)

    def _moisture(self, stamp: int, value: float) -> None:
        self._readings.append(MoistureReading(stamp, value))
        self._to_protocol[2](stamp, value)

    def run(self) -> None:
        """One trial to its end, kept or not."""
        rig = self.rig
        rig.protocol.start(rig.now)
        rig.run(0.2)
        rig.protocol.start(rig.now)
        rig.readings(37.0, 38.0, 39.0)
        rig.run(1.0)
        self.press()
        rig.readings(36.0, 37.0, 38.0)
        rig.run(0.3)

    @property
    def verdict(self) -> tuple[str, str]:
        """Of the protocol, and its reason."""
        attempt = self.rig.protocol.trials[0].attempts[0]
        return attempt.verdict, attempt.reason

    def fitted(self, window: str = "loading") -> str:
        """What a fit of the recorded streams says against the trial; empty where it takes it."""
        stamps = np.array([stamp for stamp, _ in self._forces])
        force = np.zeros((len(stamps), 3))
        force[:, 2] = [-value for _, value in self._forces]
        areas = np.zeros(len(self._areas), AREA)
        for name, column in zip(("stamp_ns", "area", "flags"), zip(*self._areas)):
            areas[name] = column
        areas["sd"] = 0.03 * areas["area"] + 0.5e-6
        events = [e for e in self.rig.effects if isinstance(e, TrialEvent)]
        streams = SessionStreams(
            Wrenches(stamps, stamps, force, np.zeros_like(force)),
            areas,
            np.zeros(0, IMAGE),
            np.zeros(0, INDENTATION),
            self._readings,
            [e for e in events if e.attempt == 0 and e.phase != e.phase.FAILED],
        )
        found = split(streams, SessionMetadata(), TrialSettings(), "bag")
        trials, left_out = prepare_all(found.trials, FitOptions(window=window))
        return "" if trials else "; ".join(e.reason for e in [*found.exclusions, *left_out])


@pytest.fixture
def presses(module_of: Callable[[str], Any], tmp_path: Path) -> Presses:
    return Presses(module_of("src/finger_operator/test/study_rig.py"), tmp_path)


def lost(*numbers: int) -> Disturb:
    return lambda p: p.frames.update(dict.fromkeys(numbers))


def clipped(*numbers: int) -> Disturb:
    return lambda p: p.frames.update(dict.fromkeys(numbers, int(AreaFlag.CLIPPED)))


def quick(p: Presses) -> None:
    """Two frames before the target."""

    def press() -> None:
        p.rig.run(0.15, 1.45, ramp=True)
        p.rig.run(0.5)
        p.rig.run(0.2, 0.0, ramp=True)
        p.rig.run(0.7)

    p.press = press


def touched_before(p: Presses) -> None:
    """A slow touch that goes, and a press with too few frames."""
    again = p.press

    def press() -> None:
        p.rig.run(0.4, 0.6, ramp=True)
        p.rig.run(0.1, 0.0, ramp=True)
        p.rig.run(0.2)
        again()

    quick(p)
    again = p.press
    p.press = press


def pressed_again(p: Presses) -> None:
    """A second press, harder and too short for the camera, before the finger is off."""

    def press() -> None:
        p.rig.run(1.0, 1.45, ramp=True)
        p.rig.run(0.2, 0.0, ramp=True)
        p.rig.run(0.1)
        p.rig.run(0.15, 1.8, ramp=True)
        p.rig.run(0.15, 0.0, ramp=True)
        p.rig.run(0.7)

    p.press = press


def spike(p: Presses) -> None:
    """One sample over the target, in a press that is held below it and lifted at the cue."""

    def press() -> None:
        p.rig.run(1.0, 1.3, ramp=True)
        p.force = lambda true, stamp: 1.4
        p.rig.run(0.002)
        p.force = lambda true, stamp: true
        p.rig.run(0.3)
        p.rig.run(0.2, 0.0, ramp=True)
        p.rig.run(0.7)

    p.press = press


def offset(p: Presses) -> None:
    """A zero that is off, within the limit of a free plate: the press itself ends at 1.33 N."""
    p.force = lambda true, stamp: true + 0.025
    p.press = lambda: p.rig.press(1.33)


@pytest.mark.parametrize(
    ("disturb", "said"),
    [
        (lost(4), "1 frame was dropped"),
        (lost(4, 5), "2 frames in a row were dropped"),
        (clipped(5), "over the image border in 1 frames"),
        (clipped(*range(40)), "over the image border"),
        (quick, "frames in the contact, at least 3 are needed"),
        (touched_before, "frames in the contact, at least 3 are needed"),
        (pressed_again, "pressed again"),
        (spike, "of 1.35 N where single samples"),
        (offset, "1.33 of 1.35 N"),
    ],
)
def test_what_a_fit_leaves_out_is_failed_at_once(
    presses: Presses, disturb: Disturb, said: str
) -> None:
    disturb(presses)
    presses.run()
    assert presses.fitted(), "a fit takes it"
    verdict, reason = presses.verdict
    assert verdict == "failed" and said in reason


@pytest.mark.parametrize("window", ["loading", "contact"])
def test_a_good_press_is_kept_and_taken(presses: Presses, window: str) -> None:
    presses.run()
    assert presses.verdict == ("done", "") and presses.fitted(window) == ""


@pytest.mark.parametrize("disturb", [lost(12), clipped(13)])
def test_a_press_is_kept_for_a_fit_of_the_whole_contact(presses: Presses, disturb: Disturb) -> None:
    disturb(presses)
    presses.run()
    assert presses.fitted("contact")
    assert presses.verdict[0] == "failed"


def test_random_presses_that_are_kept_are_taken(
    module_of: Callable[[str], Any], tmp_path: Path
) -> None:
    """Noise, speed, overshoot, zero and lost frames as they come."""
    study_rig = module_of("src/finger_operator/test/study_rig.py")
    rng = np.random.default_rng(7)
    kept = 0
    for number in range(60):
        presses = Presses(study_rig, tmp_path / str(number))
        rig, zero = presses.rig, rng.uniform(-0.02, 0.02)
        rig.run(rng.uniform(0.0, 0.1))
        noise = rng.choice([0.0, 0.003, 0.01])
        presses.force = lambda true, stamp, z=zero, n=noise: true + z + n * rng.standard_normal()
        presses.frames = {k: None for k in range(1, 20) if rng.random() < 0.02}
        rise, peak = rng.uniform(0.2, 2.0), rng.uniform(1.34, 1.6)
        hold, fall = rng.uniform(0.0, 0.3), rng.uniform(0.05, 0.4)

        def press(rig=rig, rise=rise, peak=peak, hold=hold, fall=fall) -> None:
            rig.run(rise, peak, ramp=True)
            rig.run(hold)
            rig.run(fall, 0.0, ramp=True)
            rig.run(0.8)

        presses.press = press
        presses.run()
        verdict, _ = presses.verdict
        if verdict == "done":
            kept += 1
            for window in ("loading", "contact"):
                assert presses.fitted(window) == "", (number, window)
    assert 15 <= kept <= 50
