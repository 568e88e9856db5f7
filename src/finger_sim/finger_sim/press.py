# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A human-like press: the normal force of a finger on the plate, drawn from a seed.

The participant of the paper pressed from nothing to the target force at a free speed, saw a cue and
lifted. Modelled: a ramp with a soft start, further pressing through the reaction time after the cue
(the overshoot), a release, physiological tremor at 8–12 Hz and slow fluctuation, both in proportion
to the force.

Not modelled: correction of the force by sight, tangential stroking, a second touch after the
release, learning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError
from finger_common.guided_presses import GuidedPress
from finger_model.paper import PRESS_DURATION, TARGET_FORCE

RATE = 500.0
"""Samples per s."""

LEAD, TAIL = 0.3, 0.5
"""s of rest before onset and after lift-off."""


@dataclass(frozen=True)
class PressStyle:
    """Spans (low, high) from which a press is drawn, and strengths of the fluctuations.

    ramp: s from onset to the target. shape: exponent of the ramp, 1 is linear.
    reaction: s from the cue to the first drop of force (visual reaction of adults, 0.18–0.32 s).
    release: s from full force to lift-off. hold: s of further holding before the release.
    tremor, drift: standard deviation of the fluctuation at 8–12 Hz and below 3 Hz over the force
    (isometric force fluctuates by 1–3 %).
    """

    ramp: tuple[float, float] = PRESS_DURATION
    shape: tuple[float, float] = (0.9, 1.4)
    reaction: tuple[float, float] = (0.18, 0.32)
    release: tuple[float, float] = (0.15, 0.4)
    hold: tuple[float, float] = (0.0, 0.0)
    tremor: float = 0.015
    drift: float = 0.02


@dataclass(frozen=True)
class Press:
    """One press: time (n,) in s from 0 at rest, normal force (n,) in N, and its events in s.

    onset: first touch; cue: force first reaches the target; release: force begins to fall;
    lift_off: force is zero again.
    """

    time: np.ndarray
    force: np.ndarray
    onset: float
    cue: float
    release: float
    lift_off: float

    @property
    def duration(self) -> float:
        """Length of the record in s, rest before and after included."""
        return float(self.time[-1])


def band_noise(
    rng: np.random.Generator, number: int, rate: float, low: float, high: float
) -> np.ndarray:
    """Gaussian noise (number,) of unit variance with an even spectrum from `low` to `high` Hz."""
    frequency = np.fft.rfftfreq(number, 1.0 / rate)
    inside = (frequency >= low) & (frequency <= high)
    spectrum = rng.normal(size=len(frequency)) + 1j * rng.normal(size=len(frequency))
    signal = np.fft.irfft(np.where(inside, spectrum, 0.0), number)
    deviation = signal.std()
    return signal / deviation if deviation > 0 else signal


FASTEST_RAMP = 0.1
"""s; nobody presses faster to a target."""


def guided_style(press: GuidedPress) -> PressStyle:
    """How people follow the guidance of one press: neither as fast nor as slow as they may."""
    fastest, slowest = press.rise
    ramp = (max(1.5 * fastest, FASTEST_RAMP), 0.4 * slowest)
    return PressStyle(ramp=ramp, hold=(press.hold, press.hold))


def plan_press(
    rng: np.random.Generator,
    style: PressStyle | None = None,
    target_force: float = TARGET_FORCE,
) -> Press:
    """One press to the target force in N, drawn from `style`.

    The same state of `rng` gives the same press. Raises InputError for a ramp that is not positive.
    """
    style = style or PressStyle()
    ramp = float(rng.uniform(*style.ramp))
    if not ramp > 0:
        raise InputError(f"press: ramp is {ramp:g} s, a positive number is needed")
    shape = float(rng.uniform(*style.shape))
    reaction = float(rng.uniform(*style.reaction))
    release = float(rng.uniform(*style.release))
    hold = float(rng.uniform(*style.hold))

    # Room for a cue that the fluctuation delays, cut off below.
    length = LEAD + 1.5 * ramp + reaction + hold + release + TAIL
    number = math.ceil(length * RATE) + 1
    time = np.arange(number) / RATE
    since = np.maximum(time - LEAD, 0.0)
    base = target_force * (since / ramp) ** shape
    fluctuation = 1.0 + style.tremor * band_noise(rng, number, RATE, 8.0, 12.0)
    fluctuation += style.drift * band_noise(rng, number, RATE, 0.2, 3.0)
    pressing = base * fluctuation
    at_cue = int(np.argmax(pressing >= target_force))
    if pressing[at_cue] < target_force:
        raise InputError(
            f"press: the target of {target_force:g} N is not reached; lower tremor or drift"
        )
    cue = float(time[at_cue])

    # The force rises at a falling rate between cue and reaction, then holds.
    speed = target_force * shape / ramp * max((cue - LEAD) / ramp, 1e-3) ** (shape - 1.0)
    past = np.clip(time - cue, 0.0, reaction)
    overshoot = speed * (past - 0.5 * past**2 / reaction)
    level = np.where(time < cue, base, base[at_cue] + overshoot)
    start = cue + reaction + hold
    falling = np.clip((time - start) / release, 0.0, 1.0)
    force = level * fluctuation * 0.5 * (1.0 + np.cos(np.pi * falling))
    force[(time <= LEAD) | (falling >= 1.0)] = 0.0
    force = np.maximum(force, 0.0)

    end = min(number, math.ceil((start + release + TAIL) * RATE) + 1)
    return Press(time[:end], force[:end], LEAD, cue, start, start + release)
