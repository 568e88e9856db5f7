# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A plan of presses, and the trials that it would record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, put_once
from finger_common.files import load_yaml
from finger_common.settings import Settings, setting
from finger_common.usable_press import FEWEST_FRAMES, TYPICAL_AREA_NOISE
from finger_model.paper import PRESS_DURATION, TARGET_FORCE, TRIALS_PER_CONDITION

from ..api import Trial
from ..fingers import KnownLengths
from ..options import FitOptions
from ..problem import FitProblem, batch_areas, batch_contacts, force_limit_of, prepare_all

REST, REST_AFTER = 0.6, 0.3
"""s of unloaded plate before and after a planned press."""

LARGEST_ZERO = 5e-3
"""m; the zeros of simulated displacement sensors lie within."""

FORCE_RATE = 500.0
"""Hz of the planned force."""

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class Plan(Settings):
    """One plan; raises InputError for a bad value."""

    presses: int = setting(
        TRIALS_PER_CONDITION, "Presses of one finger in one condition.", "", 3, 500
    )
    shortest: float = setting(PRESS_DURATION[0], "Shortest loading.", "s", 0.1, 60.0)
    longest: float = setting(
        PRESS_DURATION[1], "Longest loading; the others lie between, evenly in the logarithm.",
        "s", 0.1, 60.0,
    )  # fmt: skip
    peak: float = setting(TARGET_FORCE, "Force at the end of the loading.", "N", 0.2, 10.0)
    hold: float = setting(0.0, "Time at that force.", "s", 0.0, 60.0)
    release: float = setting(0.3, "Duration of the release.", "s", 0.05, 60.0)
    window: str = setting(
        "loading", "Frames that count, as in a fit.", choices=("loading", "contact")
    )
    frame_rate: float = setting(10.0, "Images.", "Hz", 1.0, 1000.0)
    area_noise: float = setting(TYPICAL_AREA_NOISE, "Noise of a frame's area.", "m^2", 1e-8, 1e-4)
    scatter: float = setting(0.03, "Scatter of whole presses' areas (logarithm).", "", 0.0, 1.0)
    indentation_sd: float = setting(
        0.0, "Noise of a measured indentation; 0: none is measured.", "m", 0.0, 1e-3
    )

    def validate(self) -> None:
        """The shortest loading is no longer than the longest, and has enough frames."""
        if self.shortest > self.longest:
            raise InputError(
                f"plan: shortest is {self.shortest:g} s, longer than longest ({self.longest:g} s); "
                "exchange them"
            )
        counted = self.shortest
        if self.window == "contact":
            counted += self.hold + self.release
        if counted * self.frame_rate < FEWEST_FRAMES:
            raise InputError(
                f"plan: the shortest press has fewer than {FEWEST_FRAMES} frames that count, in "
                f"{counted:g} s at frame_rate {self.frame_rate:g} Hz; give longer presses or more "
                "images"
            )

    def force(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Time (n,) in s and force (n,) in N of one press, with the unloaded plate on both
        sides."""
        place = index / max(self.presses - 1, 1)
        rise = self.shortest * (self.longest / self.shortest) ** place
        length = REST + rise + self.hold + self.release + REST_AFTER
        time = np.arange(0.0, length, 1.0 / FORCE_RATE)
        up = np.clip((time - REST) / rise, 0.0, 1.0)
        down = np.clip(1.0 - (time - REST - rise - self.hold) / self.release, 0.0, 1.0)
        return time, self.peak * np.minimum(up, down)

    def frames(self, index: int, end: float) -> np.ndarray:
        """Times (k,) in s of the images of one press; their phase differs from press to press."""
        return np.arange((index * _GOLDEN) % 1.0 / self.frame_rate, end, 1.0 / self.frame_rate)

    def problem(
        self,
        model: Any,
        parameters: np.ndarray,
        options: FitOptions,
        noise: np.random.Generator | None = None,
        known: KnownLengths | None = None,
    ) -> FitProblem:
        """The fit's problem of these presses by a finger of parameters (N,), with what is known of
        its lengths.

        noise: draws the noise of frames, the gains of presses, and noise and zeros of
        indentations; none without. Raises InputError for a plan with a measured indentation and a
        model without, and for a force beyond the model's limit.
        """
        limit = force_limit_of(model, parameters)
        if self.peak > limit:
            raise InputError(
                f"plan: peak is {self.peak:g} N, beyond the {limit:.3g} N for which the model of "
                "this finger is made; lower it"
            )
        records = []
        for index in range(self.presses):
            time, force = self.force(index)
            frames = self.frames(index, float(time[-1]))
            knots = np.union1d(time[::5], frames)
            drive = (knots, np.interp(knots, time, force), np.searchsorted(knots, frames))
            indentation = None
            if self.indentation_sd:
                (found,) = batch_contacts(model, parameters[None], [drive])
                area, indentation = found[:, 0]
            else:
                area = batch_areas(model, parameters[None], [drive])[0][0]
            if not np.isfinite(area).all():
                raise InputError(
                    f"plan: the model cannot follow a press of {time[-1] - REST - REST_AFTER:.2g} "
                    f"s to {self.peak:g} N with these parameters; lower peak, or guess stiffer "
                    "tissue"
                )
            touched = np.interp(frames, time, force) > 0
            if noise is not None:
                area = area * np.exp(self.scatter * noise.normal())
                area = area + self.area_noise * noise.normal(size=len(area))
                if indentation is not None:
                    zero = noise.uniform(-LARGEST_ZERO, LARGEST_ZERO)
                    error = self.indentation_sd * noise.normal(size=len(area))
                    indentation = indentation + zero + error
            area = np.where(touched, np.maximum(area, 1e-9), 0.0)
            trial = Trial(
                time, force, area, frames, "plan", target_force=0.98 * self.peak,
                indentation=indentation, indentation_time=frames,
            )  # fmt: skip
            records += trial.records(index, index)
        chosen = replace(options, window=self.window, indentation_sd=self.indentation_sd)
        trials, excluded = prepare_all(records, chosen)
        if len(trials) < self.presses:
            raise InputError(
                f"plan: {excluded[0].reason}; give longer presses, a higher peak or more images"
            )
        problem = FitProblem(trials, model, chosen, known)
        problem.weigh(self.area_noise)
        return problem


def plans_of(text: str) -> list[tuple[str, Plan]]:
    """Names and plans of NAME:SETTING=VALUE,… or of a YAML file.

    A file has the settings of one plan, named as the file is, or those of several by their names.
    Raises InputError that quotes the text.
    """
    path = Path(text)
    if path.suffix not in (".yaml", ".yml"):
        return [_plan_of(text)]
    found = load_yaml(path, "plan")
    if not any(isinstance(value, dict) for value in found.values()):
        return [(path.stem, Plan.from_mapping(found, text))]
    for name, values in found.items():
        if not isinstance(values, dict):
            raise InputError(
                f"{text}: '{name}' is no plan; give each plan its settings below its name"
            )
    return [(str(k), Plan.from_mapping(v, f"{text}: {k}")) for k, v in found.items()]


def _plan_of(text: str) -> tuple[str, Plan]:
    """Name and plan of NAME:SETTING=VALUE,…"""
    name, colon, rest = text.partition(":")
    values: dict[str, Any] = {}
    known = {p.name: p for p in Plan.parameters()}
    for part in filter(None, rest.split(",")) if colon else ():
        key, _, value = part.partition("=")
        found = known.get(key.strip())
        if found is None:
            raise InputError(
                f"plan '{text}': '{key.strip()}' is no setting of a plan; there are "
                f"{', '.join(known)}"
            )
        try:
            number = type(found.default)(value.strip())
        except ValueError:
            raise InputError(
                f"plan '{text}': {found.name} is '{value.strip()}'; give a "
                f"{'whole number' if isinstance(found.default, int) else 'number'}"
                f"{f' in {found.unit}, without the unit' if found.unit else ''}"
            ) from None
        put_once(values, found.name, number, f"plan '{text}'")
    if not name.strip():
        raise InputError(f"plan '{text}': a name is needed, as in slow:shortest=2,longest=8")
    return name.strip(), Plan(**values)
