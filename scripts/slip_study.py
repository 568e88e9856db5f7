# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How well slip is foretold: simulated pulls of random fingers on a plate, friction not known.

    python scripts/slip_study.py --fingers 120 [--alarm 0.05 0.15 0.4] [--tilt 3] [-o slip.json]

A finger presses, the plate moves sideways at a constant speed until the finger slips after 0.1 to
2 s, or it stops before and is held; then it goes back and the finger lifts off; six such pulls for
each finger. Truth differs from what the estimator assumes: its stick ratio runs at another
|Q|/(μP) (up to 15 %), the tissue creeps under the tangential load, the normal force trembles,
friction wanders by 2 % from pull to pull and by 1 % while sliding.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from finger_model.slip import SlipEstimator, SlipSettings, backbone

RATE = 500.0
FRAMES = 30.0
CAMERA_LATENCY = 0.06
CAMERA = np.array(
    [
        [0.02, 0.009, 0.072, 0.052],
        [0.10, 0.038, 0.039, 0.073],
        [0.21, 0.027, 0.032, 0.067],
        [0.30, 0.021, 0.037, 0.067],
        [0.40, 0.012, 0.046, 0.070],
        [0.50, -0.011, 0.051, 0.091],
        [0.59, -0.006, 0.046, 0.097],
        [0.70, 0.006, 0.084, 0.104],
        [0.80, 0.013, 0.074, 0.128],
        [0.90, 0.048, 0.043, 0.105],
        [0.99, -0.023, 0.014, 0.086],
    ]
)
"""How a camera errs: true stick ratio, mean error, its standard deviation, and the one that is
stated, as scripts/stick_errors.py prints them."""
CAMERA_MEMORY = 0.53
"""Correlation of its errors from image to image there."""
ALARM = 0.15
AHEAD = 0.02
FALSE_TIME, FALSE_RATIO = 0.25, 0.85
"""An alarm is false when, were the pull to go on as it does, slip would be further away (s), and
less of the friction is used; and so it would have been FORGIVEN (s) before."""
FORGIVEN = 0.03
PULLS = 6
FRICTIONS = 0.15, 1.2
"""Least and largest μ of a finger."""
RISES = 0.1, 2.0
"""s, in which a pull reaches the slip: shortest and longest."""
SLIPS, STOPS = 0.6, (0.2, 0.85)
"""Share of the pulls that slip; share of the way to the slip at which the others stop."""


@dataclass(frozen=True)
class Finger:
    """friction μ; stiffness (N/m) of the tissue to tangential load; bend: exponent of r in s(r);
    creep: share by which Q falls while a pull is held."""

    friction: float
    stiffness: float
    bend: float
    creep: float


@dataclass(frozen=True)
class Pull:
    """Samples (n,) of a pull.

    time (s), normal (N), lateral (n, 2) in N with noise; ratio: |Q|/(μP); stick: stick ratio; left:
    time (s) until the slip if the plate goes on as it does; slip: time (s) of it, NaN without one.
    """

    time: np.ndarray
    normal: np.ndarray
    lateral: np.ndarray
    ratio: np.ndarray
    stick: np.ndarray
    left: np.ndarray
    slip: float


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def random_finger(rng: np.random.Generator) -> Finger:
    """A finger with friction in FRICTIONS."""
    return Finger(
        _log_uniform(rng, *FRICTIONS),
        _log_uniform(rng, 250.0, 1200.0),
        rng.uniform(0.85, 1.15),
        rng.uniform(0.02, 0.08),
    )


def pull(rng: np.random.Generator, finger: Finger, slips: bool) -> Pull:
    """One press, pull and lift-off."""
    load = rng.uniform(0.3, 3.0)
    friction = finger.friction * math.exp(rng.normal(0.0, 0.02))
    reach = friction * load / finger.stiffness
    begin = 0.6 + rng.uniform(0.0, 0.3)
    rise = _log_uniform(rng, *RISES)
    speed = reach / rise
    goal = rise + rng.uniform(0.15, 0.5) if slips else rise * rng.uniform(*STOPS)
    hold = rng.uniform(0.1, 0.5)
    back = 0.2
    end = begin + goal + hold + back + 0.4
    time = np.arange(0.0, end, 1.0 / RATE)
    phase = rng.uniform(0.0, 2.0 * math.pi, 2)
    tremor = 1.0 + 0.015 * np.sin(2 * math.pi * 8.5 * time + phase[0])
    tremor += 0.03 * np.sin(2 * math.pi * 1.1 * time + phase[1])
    press = np.interp(time, [0.0, 0.3, end - 0.2, end - 0.02, end], [0.0, 1.0, 1.0, 0.0, 0.0])
    normal = load * press * tremor
    # The plate against the bone; after a slip the skin lags behind by what it slid.
    plate = np.interp(
        time,
        [0, begin, begin + goal, begin + goal + hold, end - 0.4, end],
        [0, 0, speed * goal, speed * goal, 0.0, 0.0],
    )
    tangential = np.zeros(len(time))
    slid, crept = 0.0, 0.0
    slip_at = math.nan
    scatter = 0.0
    for i in range(1, len(time)):
        scatter = 0.98 * scatter + rng.normal(0.0, 0.01 * 0.2)
        most = friction * (1.0 + scatter) * normal[i]
        crept += (finger.creep * (plate[i] - slid) - crept) / RATE / 0.15
        force = finger.stiffness * (plate[i] - slid - crept)
        if abs(force) > most:
            slid = plate[i] - crept - math.copysign(most, force) / finger.stiffness
            force = math.copysign(most, force)
            if math.isnan(slip_at) and begin < time[i] < begin + goal and normal[i] > 0.2:
                slip_at = float(time[i])
        tangential[i] = force
    ratio = np.abs(tangential) / np.maximum(friction * normal, 1e-6)
    stick = backbone.stick_ratio(np.clip(ratio, 0.0, 1.0) ** finger.bend)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    noise = rng.normal(0.0, 0.005, (len(time), 3))
    lateral = tangential[:, None] * [math.cos(angle), math.sin(angle)] + noise[:, :2]
    pulled = (time > begin) & (time < begin + goal)
    if not slips:
        slip_at = math.nan
    stick = np.where(pulled, stick, np.nan)
    left = np.where(pulled, (1.0 - ratio) * friction * normal / finger.stiffness / speed, np.inf)
    # A plate that has just stopped is forgiven.
    left = np.min(
        [
            np.concatenate([np.full(k, np.inf), left[: len(left) - k]])
            for k in range(int(FORGIVEN * RATE))
        ],
        axis=0,
    )
    return Pull(time, normal + noise[:, 2], lateral, ratio, stick, left, slip_at)


def tilted(one: Pull, degrees: float, toward: float) -> Pull:
    """A pull as a force sensor sees it whose normal axis leans by these degrees in a lateral
    direction (rad)."""
    lean, axis = math.radians(degrees), np.array([math.cos(toward), math.sin(toward)])
    along = one.lateral @ axis
    seen = math.cos(lean) * along + math.sin(lean) * one.normal
    return replace(
        one,
        normal=math.cos(lean) * one.normal - math.sin(lean) * along,
        lateral=one.lateral + np.outer(seen - along, axis),
    )


def study(fingers: int, seed: int, camera: bool, alarm_at: float = ALARM) -> dict[str, float]:
    """Figures over fingers of PULLS pulls each; `camera`: stick ratios at FRAMES come in late."""
    return trade_off(fingers, seed, camera, (alarm_at,))[0]


def trade_off(
    fingers: int, seed: int, camera: bool, alarms: tuple[float, ...], tilt: float = 0.0
) -> list[dict[str, float]]:
    """The figures of `study` for each probability that alarms, by a sensor that leans by `tilt`
    (degrees) in a direction of each finger's own."""
    runs = list(followed(fingers, seed, camera, tilt))
    return [figures(runs, alarm_at) for alarm_at in alarms]


def followed(
    fingers: int, seed: int, camera: bool, tilt: float = 0.0
) -> Iterator[tuple[Finger, list]]:
    """Each finger with its pulls and what the estimator says of them, rows (n,)."""
    for number in range(fingers):
        rng = np.random.default_rng([seed, number])
        finger = random_finger(rng)
        toward = np.random.default_rng([seed, number, 1]).uniform(0.0, 2.0 * math.pi)
        estimator = SlipEstimator(SlipSettings(tangential_noise=0.005))
        start, found = 0, []
        for _ in range(PULLS):
            one = pull(rng, finger, bool(rng.random() < SLIPS))
            if tilt:
                one = tilted(one, tilt, toward)
            stamps = start + (one.time * 1e9).astype(np.int64)
            start = int(stamps[-1]) + 500_000_000
            touching = one.normal > 0.03
            depth = np.maximum(one.normal, 0.0) ** 0.5 * 1.2e-3
            if camera:
                rows = with_camera(rng, estimator, one, stamps, touching, depth)
            else:
                rows = estimator.add_many(stamps, one.normal, one.lateral, touching, depth)
            found.append((one, rows))
        yield finger, found


def figures(runs: list[tuple[Finger, list]], alarm_at: float) -> dict[str, float]:
    """Figures of what `followed` gives."""
    announced: dict[str, list[bool]] = {"first": [], "later": []}
    false_alarms: dict[str, list[bool]] = {"first": [], "later": []}
    held: list[bool] = []
    leads: list[float] = []
    errors: dict[str, list[float]] = {"first": [], "later": []}
    friction_errors: list[float] = []
    friction_scores: list[float] = []
    covered: list[float] = []
    for finger, pulls in runs:
        slips = 0
        for one, rows in pulls:
            alarm = (rows["slip_probability"] >= alarm_at) & (one.time > 0.45)
            pulled = ~np.isnan(one.stick)
            if math.isnan(one.slip):
                stop = one.time[pulled][-1] + FORGIVEN
                stands = (one.time > stop) & (one.time < stop + 0.1) & (one.ratio < FALSE_RATIO)
                held.append(bool((alarm & stands).any()))
            alarm &= pulled
            first = float(one.time[np.argmax(alarm)]) if alarm.any() else math.inf
            early = alarm & (one.left > FALSE_TIME) & (one.ratio < FALSE_RATIO)
            known = slips > 0
            false_alarms["later" if known else "first"].append(bool(early.any()))
            if not math.isnan(one.slip):
                kind = "first" if slips == 0 else "later"
                announced[kind].append(first <= one.slip - AHEAD)
                leads.append(one.slip - first)
                slips += 1
                if slips >= 2:
                    last = rows[np.searchsorted(one.time, one.time[pulled][-1])]
                    error = last["friction"] - finger.friction
                    friction_errors.append(error / finger.friction)
                    friction_scores.append(error / last["friction_stddev"])
            before = pulled & ~(one.time >= one.slip)
            found = rows["stick_ratio"][before] - one.stick[before]
            errors["later" if known else "first"].append(np.mean(found**2))
            covered.append(np.mean(np.abs(found) < 1.96 * rows["stick_ratio_stddev"][before]))
    both = announced["first"] + announced["later"]
    false = false_alarms["first"] + false_alarms["later"]
    return {
        "slips": len(both),
        "announced_percent": 100.0 * float(np.mean(both)),
        "announced_first_percent": 100.0 * float(np.mean(announced["first"])),
        "announced_later_percent": 100.0 * float(np.mean(announced["later"])),
        "false_alarms_percent": 100.0 * float(np.mean(false)),
        "false_alarms_first_percent": 100.0 * float(np.mean(false_alarms["first"])),
        "false_alarms_later_percent": 100.0 * float(np.mean(false_alarms["later"])),
        "alarms_while_held_percent": 100.0 * float(np.mean(held)),
        "lead_median_ms": 1e3 * float(np.median(leads)),
        "stick_ratio_rms_before_a_slip": math.sqrt(np.mean(errors["first"])),
        "stick_ratio_rms_later": math.sqrt(np.mean(errors["later"])),
        "stick_ratio_coverage_percent": 100.0 * float(np.mean(covered)),
        "friction_within_10_percent": 100.0 * float(np.mean(np.abs(friction_errors) < 0.1)),
        "friction_within_2_sd_percent": 100.0 * float(np.mean(np.abs(friction_scores) < 2.0)),
    }


def with_camera(
    rng: np.random.Generator,
    estimator: SlipEstimator,
    one: Pull,
    stamps: np.ndarray,
    touching: np.ndarray,
    depth: np.ndarray,
) -> np.ndarray:
    """Rows of a pull with stick ratios of frames, each known CAMERA_LATENCY after its exposure."""
    rows = []
    error = rng.normal()
    frames = np.arange(0.0, one.time[-1], 1.0 / FRAMES)
    ends = np.searchsorted(one.time, frames + CAMERA_LATENCY)
    at = 0
    for frame, end in zip(frames, ends):
        rows.append(
            estimator.add_many(
                stamps[at:end],
                one.normal[at:end],
                one.lateral[at:end],
                touching[at:end],
                depth[at:end],
            )
        )
        at = end
        index = min(int(np.searchsorted(one.time, frame)), len(one.time) - 1)
        if end < len(one.time) and not np.isnan(one.stick[index]):
            error = CAMERA_MEMORY * error + math.sqrt(1.0 - CAMERA_MEMORY**2) * rng.normal()
            true = one.stick[index]
            mean, sd, stated = (np.interp(true, CAMERA[:, 0], column) for column in CAMERA.T[1:])
            seen = float(np.clip(true + mean + sd * error, 0.0, 1.0))
            estimator.add_stick_ratio(int(stamps[index]), seen, float(stated))
    rows.append(
        estimator.add_many(
            stamps[at:], one.normal[at:], one.lateral[at:], touching[at:], depth[at:]
        )
    )
    return np.concatenate(rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fingers", type=int, default=120, help="fingers, of six pulls each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--alarm",
        type=float,
        nargs="+",
        default=[ALARM],
        metavar="P",
        help="probabilities that alarm: several give the trade-off (default: %(default)s)",
    )
    parser.add_argument(
        "--tilt", type=float, default=0.0, metavar="DEG", help="angle of a sensor that is not level"
    )
    parser.add_argument("-o", "--output", type=Path, help="JSON file of the figures")
    values = parser.parse_args()
    found = {}
    for name, camera in (("force alone", False), ("with camera", True)):
        alarms = tuple(values.alarm)
        table = trade_off(values.fingers, values.seed, camera, alarms, values.tilt)
        print(f"{name + ', alarm at':32s}", *(f"{alarm:8.3g}" for alarm in values.alarm))
        for key in table[0]:
            print(f"  {key:30s}", *(f"{column[key]:8.3g}" for column in table))
        found[name] = [
            {"alarm": alarm, **column} for alarm, column in zip(values.alarm, table, strict=True)
        ]
    if values.output:
        values.output.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
