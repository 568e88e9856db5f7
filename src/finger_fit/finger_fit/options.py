# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Options of a fit: one described class for the command line, the action goal and the report."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_common.contact_threshold import ONSET_FORCE
from finger_common.errors import InputError, put_once
from finger_common.settings import setting
from finger_common.units import MODULUS_UNITS, TIME_UNITS, unit_named
from finger_model.geometry import Geometry
from finger_model.laws import ConstitutiveLaw, ParameterSpace, ParameterSpec
from finger_model.paper import TARGET_FORCE

from .nuisance_priors import NUISANCE, NuisancePriors

FRAMES = "frames and forces"
SEARCH = "cost and search"
CHECK = "check with the full-order model"
UNCERTAINTY = "uncertainty"
RUN = "run"
"""Headings of the options in the help of the command."""

UNITS = {"Pa": MODULUS_UNITS, "s": TIME_UNITS}
"""Unit of a parameter -> units that its bounds may be given in."""

NUISANCE_PRIORS = tuple(
    p.name for p in NuisancePriors.parameters() if p.group == NUISANCE and p.name != "nuisances"
)
"""Options of a fit with nuisance parameters."""

MEMORY = 5.0
"""Creep times after which tissue is at rest: it keeps exp(−5) of the strain."""

_END = re.compile(r"\s*([-+.\deE]*[.\d])\s*([^\d\s]*)\s*")


@dataclass(frozen=True)
class FitOptions(NuisancePriors):
    """Checked options; each field states its unit, range and meaning. Raises InputError for a bad
    value."""

    target_force: float = setting(
        0.0,
        "Normal force that ends the loading; 0: the target force of each trial in its bag.",
        "N",
        0.0,
        50.0,
        group=FRAMES,
    )
    onset_force: float = setting(
        ONSET_FORCE, "Normal force from which frames count.", "N", 0.001, 5.0, group=FRAMES
    )
    window: str = setting(
        "loading",
        "Frames that count: from onset to the first frame at or after the target force "
        "(loading), or to the end of the contact (contact).",
        choices=("loading", "contact"),
        group=FRAMES,
    )
    force: str = setting(
        "full",
        "Force that drives the model: at its full rate (full), or low-passed and sampled at the "
        "frames as in the paper (paper).",
        choices=("full", "paper"),
        group=FRAMES,
    )
    force_cutoff: float = setting(
        25.0,
        "Cut-off of the zero-phase low-pass filter of the force in mode full. It removes sensor "
        "noise and keeps hand tremor (8–12 Hz).",
        "Hz",
        1.0,
        1000.0,
        group=FRAMES,
    )
    step: float = setting(
        0.02, "Largest time step of the model in force mode full.", "s", 1e-4, 0.1, group=FRAMES
    )
    low_force: float = setting(
        0.2, "Force below which frames get low_force_weight.", "N", 0.0, 10.0, group=FRAMES
    )
    low_force_weight: float = setting(
        1.0,
        "Weight of frames below low_force, where a convex hull underestimates the gross area.",
        "",
        0.0,
        1.0,
        group=FRAMES,
    )
    loss: str = setting(
        "squares", "Loss of a frame's residual.", choices=("squares", "huber"), group=SEARCH
    )
    huber_scale: float = setting(
        3e-6, "Residual beyond which the Huber loss is linear.", "m^2", 1e-9, 1e-3, group=SEARCH
    )
    bounds: list[str] = setting(
        [],
        "Limits of the search box that replace those of the law, as NAME=LOW:HIGH with units, "
        "such as E2=500kPa:3MPa; numbers without a unit are SI.",
        group=SEARCH,
    )
    grid: int = setting(
        5,
        "Points per parameter of the brute-force grid, evenly spaced in the logarithm.",
        "",
        2,
        20,
        group=SEARCH,
    )
    particles: int = setting(5, "Candidates of one PSO round.", "", 2, 1000, group=SEARCH)
    rounds: int = setting(60, "PSO rounds.", "", 1, 100000, group=SEARCH)
    optimizer: list[str] = setting(
        ["pso"],
        "Searches to run from the grid. PSO gives the fit; the others cross-check it.",
        choices=("pso", "cmaes", "de"),
        group=SEARCH,
    )
    polish: bool = setting(
        True, "Bounded local least squares from the best candidates after the search.", group=SEARCH
    )
    top: int = setting(
        5,
        "Candidates reported and simulated again with the full-order model.",
        "",
        1,
        50,
        group=CHECK,
    )
    full_order: bool = setting(
        True, "Simulate the top candidates again with the full-order model.", group=CHECK
    )
    correct: bool = setting(
        True,
        "With full_order: correct the reduced model's areas to full order at the best candidate "
        "and polish again.",
        group=CHECK,
    )
    profiles: bool = setting(
        True,
        "Profile likelihood of each parameter and of the quantities derived from them.",
        group=UNCERTAINTY,
    )
    bias_pairs: int = setting(
        20,
        "Pairs of synthetic data sets that measure the bias of the polished estimate; 0 for none.",
        "",
        0,
        10000,
        group=UNCERTAINTY,
    )
    bootstrap: int = setting(
        200, "Bootstrap samples over trials; 0 for none.", "", 0, 100000, group=UNCERTAINTY
    )
    shared: list[str] = setting(
        [], "Parameters held equal across conditions in an additional, joint fit.", group=SEARCH
    )
    extra: str = setting(
        "none",
        "An additional fitted parameter: the epidermis thickness (slow: full-order runs).",
        choices=("none", "epidermis_thickness"),
        group=SEARCH,
    )
    clusters: int = setting(
        3,
        "Largest number of moisture clusters for trials without a condition; fewer if the "
        "readings do not lie far enough apart.",
        "",
        1,
        9,
        group=FRAMES,
    )
    moisture_required: bool = setting(
        False, "Exclude trials without a moisture reading.", group=FRAMES
    )
    pool: bool = setting(
        False, "Fit the presses of all subjects as if they came from one finger.", group=FRAMES
    )
    seed: int = setting(0, "Seed of every random choice.", "", 0, 2**31 - 1, group=SEARCH)
    vision: bool = setting(
        False,
        "Measure areas again from image_raw, even where contact_area is recorded.",
        group=FRAMES,
    )
    resume: bool = setting(False, "Continue from the checkpoints in the output folder.", group=RUN)
    dask: str = setting(
        "",
        "Address of a Dask scheduler that runs profiles, bias, bootstrap and full order, or the "
        "whole fits of several subjects; empty: this machine.",
        group=RUN,
    )

    def validate(self) -> None:
        """Onset below target; PSO is always among the searches."""
        target = self.target_force or TARGET_FORCE
        if self.onset_force >= target:
            raise InputError(
                f"onset_force is {self.onset_force:g} N, not below target_force ({target:g} N); "
                "lower one or raise the other"
            )
        if "pso" not in self.optimizer:
            object.__setattr__(self, "optimizer", ["pso", *self.optimizer])

    def without_effect(self) -> list[str]:
        """Say which options are given that another one makes useless."""
        useless = {
            "loss 'squares'": ("huber_scale",) if self.loss == "squares" else (),
            "nuisances off": NUISANCE_PRIORS if not self.nuisances else (),
            "indentation_sd 0": ("indentation_gain_sd",) if self.indentation_sd == 0 else (),
            "low_force 0": ("low_force_weight",) if self.low_force == 0 else (),
        }
        table = self.parameters()
        return [
            f"with {reason}, {', '.join(given)} has no effect"
            for reason, names in useless.items()
            if (given := [n for n in names if getattr(self, n) != table[n].default])
        ]

    def box(self, space: ParameterSpace) -> np.ndarray:
        """Search box (D, 2) in SI units: the space's own, with `bounds` in its place.

        Raises InputError for bounds of an unknown parameter or without width.
        """
        box = np.array(space.box, dtype=float)
        given: dict[str, str] = {}
        for text in self.bounds:
            name, _, span = text.partition("=")
            if name not in space.names:
                raise InputError(
                    f"bounds '{text}': NAME=LOW:HIGH is needed, NAME one of "
                    f"{', '.join(space.names)}, as in E0=50kPa:160kPa"
                )
            put_once(given, name, span, "bounds")
            box[space.index(name)] = _span(text, span, space[name])
        return box

    def memory(self, space: ParameterSpace, law: ConstitutiveLaw | None) -> float:
        """Time (s) before a press beyond which a force has no effect on it, for any parameters in
        the box.

        law: of the parameters; None where a model states none: the creep time is its longest time.
        """
        box = self.box(space)
        if law is not None:
            return MEMORY * law.longest_creep_time(box)
        times = (float(end[1]) for end, spec in zip(box, space) if spec.unit == "s")
        return MEMORY * max(times, default=0.0)

    def target_of(self, record: Any) -> float:
        """Normal force (N) that ends the loading of a recorded trial: its own, where none is
        set."""
        own = float(getattr(record, "target_force", 0.0))
        return self.target_force or (own if own > 0.0 else TARGET_FORCE)

    def check_names(
        self, space: ParameterSpace, geometries: Sequence[Geometry | None] = ()
    ) -> None:
        """Raise InputError for `bounds`, `shared` or lengths that name nothing known, and for a
        length that is 0 in the geometry of a finger."""
        self.box(space)
        for name in self.lengths({}):
            if any(g is not None and getattr(g, name) == 0.0 for g in geometries):
                raise InputError(
                    f"geometry_sd '{name}': this length of the finger is 0, and so is any relative "
                    "deviation of it; leave it out, or give the length in the geometry"
                )
        for name in self.shared:
            space.index(name)


def value_of(text: str, parameter: ParameterSpec) -> float:
    """A value (SI) of a parameter with or without unit, as "140kPa" or "140e3"; NaN for none."""
    units = UNITS.get(parameter.unit, {parameter.unit: 1.0})
    found = _END.fullmatch(text)
    if found is None:
        return math.nan
    unit = unit_named(found[2], units) if found[2] else parameter.unit
    return math.nan if unit is None else _number(found[1]) * units.get(unit, 1.0)


def _span(text: str, span: str, parameter: ParameterSpec) -> tuple[float, float]:
    """LOW and HIGH (SI) of bounds; raises InputError that quotes them."""
    units = UNITS.get(parameter.unit, {parameter.unit: 1.0})
    found = [_END.fullmatch(part) for part in span.split(":")]
    ends = [(m[1], unit_named(m[2], units) if m[2] else "") for m in found if m]
    if len(ends) != 2 or len(found) != 2 or None in (ends[0][1], ends[1][1]):
        raise InputError(
            f"bounds '{text}': {parameter.name}=LOW:HIGH is needed, with units "
            f"{', '.join(units)}, as in E2=500kPa:3MPa"
        )
    if bool(ends[0][1]) != bool(ends[1][1]):
        raise InputError(f"bounds '{text}': one end has a unit, the other none; give both")
    low, high = (_number(value) * units.get(unit or parameter.unit, 1.0) for value, unit in ends)
    if not (0 < low if parameter.log_offset == 0 else 0 <= low) or not low < high < math.inf:
        least = "0 <" if parameter.log_offset == 0 else "0 ≤"
        raise InputError(f"bounds '{text}': {least} LOW < HIGH is needed; correct them")
    first, last = parameter.range
    if high < first or low > last:
        factor, unit = parameter.display_factor, parameter.display_unit
        meant = [
            f"{parameter.name}={ends[0][0]}{u}:{ends[1][0]}{u}"
            for u, scale in units.items()
            if not ends[0][1]
            and _number(ends[0][0]) * scale <= parameter.bounds[1]
            and _number(ends[1][0]) * scale >= parameter.bounds[0]
        ]
        remedy = f"did you mean '{meant[0]}'?" if meant else "give the units, as in E2=500kPa:3MPa"
        raise InputError(
            f"bounds '{text}': {low:g} to {high:g} {parameter.unit} lies outside "
            f"{first * factor:g} to {last * factor:g} {unit}, for which the model is made; {remedy}"
        )
    return low, high


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
