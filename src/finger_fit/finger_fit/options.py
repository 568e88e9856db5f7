"""Options of a fit: one described table for the command line, the action goal and the report."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.parameters import Parameter, ParameterTable
from finger_model.parameter_sets import PARAMETER_NAMES

PAPER_BOUNDS = {
    "E0": (50e3, 160e3),
    "E1": (15e3, 60e3),
    "tau1": (0.01, 0.80),
    "E2": (700e3, 2200e3),
}
"""Search box in Pa, Pa, s, Pa (Nam and Kuchenbecker 2021)."""

UNITS = {"E0": "Pa", "E1": "Pa", "tau1": "s", "E2": "Pa", "composite_E": "Pa"}

FIT_PARAMETERS = ParameterTable(
    Parameter("target_force", 1.35, "Normal force that ends the loading.", "N", 0.1, 50.0),
    Parameter("onset_force", 0.05, "Normal force from which frames count.", "N", 0.001, 5.0),
    Parameter(
        "window",
        "loading",
        "Frames that count: onset to the first frame at or after the target force, or the whole contact.",
        choices=("loading", "contact"),
    ),
    Parameter(
        "force",
        "full",
        "Force that drives the model: at its full rate, or low-passed and down-sampled to the frames as in "
        "the paper.",
        choices=("full", "paper"),
    ),
    Parameter(
        "force_cutoff",
        25.0,
        "Corner of the zero-phase low-pass that keeps the sensor's noise, but not hand tremor (8–12 Hz), "
        "from the model in force mode full.",
        "Hz",
        1.0,
        1000.0,
    ),
    Parameter("step", 0.02, "Largest time step of the model in force mode full.", "s", 1e-4, 0.1),
    Parameter("low_force", 0.2, "Force below which frames get low_force_weight.", "N", 0.0, 10.0),
    Parameter(
        "low_force_weight",
        1.0,
        "Weight of frames below low_force, where a hull underestimates the gross area.",
        "",
        0.0,
        1.0,
    ),
    Parameter("loss", "squares", "Loss of a frame's residual.", choices=("squares", "huber")),
    Parameter(
        "huber_scale", 3e-6, "Residual beyond which the Huber loss is linear.", "m^2", 1e-9, 1e-3
    ),
    Parameter(
        "bounds", [], "Search box where it differs from the paper's, as NAME=LOW:HIGH in SI units."
    ),
    Parameter(
        "grid",
        5,
        "Points of the brute-force grid per parameter, spaced evenly in logarithm.",
        "",
        2,
        20,
    ),
    Parameter("particles", 5, "Candidates of one PSO round.", "", 2, 1000),
    Parameter("rounds", 60, "PSO rounds.", "", 1, 100000),
    Parameter(
        "optimizer",
        ["pso"],
        "Searches to run from the grid: PSO gives the fit, the others are referees.",
        choices=("pso", "cmaes", "de"),
    ),
    Parameter(
        "polish", True, "Bounded local least squares from the best candidates after the search."
    ),
    Parameter(
        "top", 5, "Candidates reported and simulated again with the full-order model.", "", 1, 50
    ),
    Parameter("full_order", True, "Simulate the top candidates again with the full-order model."),
    Parameter(
        "correct",
        True,
        "With full_order: correct the reduced model's areas to full order at the best candidate and polish again.",
    ),
    Parameter(
        "profiles", True, "Profile likelihood of each parameter and of the composite modulus."
    ),
    Parameter(
        "bias_pairs",
        20,
        "Pairs of synthetic data sets that measure the bias of the polished estimate; 0 for none.",
        "",
        0,
        10000,
    ),
    Parameter("bootstrap", 200, "Bootstrap samples over trials; 0 for none.", "", 0, 100000),
    Parameter(
        "shared",
        [],
        "Parameters held equal across conditions in a further, joint fit.",
        choices=PARAMETER_NAMES,
    ),
    Parameter(
        "extra",
        "none",
        "A fifth parameter of the fit: the epidermis thickness (slow: full-order runs).",
        choices=("none", "epidermis_thickness"),
    ),
    Parameter(
        "clusters",
        3,
        "Moisture clusters to form when trials carry no condition.",
        "",
        1,
        9,
    ),
    Parameter("moisture_required", True, "Exclude trials without a moisture reading."),
    Parameter("seed", 0, "Seed of every random choice.", "", 0, 2**31 - 1),
    Parameter(
        "vision", False, "Measure areas anew from image_raw, even where contact_area is recorded."
    ),
    Parameter("resume", False, "Go on from the checkpoints in the output folder."),
    Parameter(
        "dask",
        "",
        "Address of a Dask scheduler that runs profiles, bias, bootstrap and full order; empty: this process.",
    ),
)
"""Every option, with unit, range and meaning."""


@dataclass(frozen=True)
class FitOptions:
    """Checked options; names, units and meanings as in FIT_PARAMETERS. Raises InputError for a bad value."""

    target_force: float = 1.35
    onset_force: float = 0.05
    window: str = "loading"
    force: str = "full"
    force_cutoff: float = 25.0
    step: float = 0.02
    low_force: float = 0.2
    low_force_weight: float = 1.0
    loss: str = "squares"
    huber_scale: float = 3e-6
    bounds: list[str] = field(default_factory=list)
    grid: int = 5
    particles: int = 5
    rounds: int = 60
    optimizer: list[str] = field(default_factory=lambda: ["pso"])
    polish: bool = True
    top: int = 5
    full_order: bool = True
    correct: bool = True
    profiles: bool = True
    bias_pairs: int = 20
    bootstrap: int = 200
    shared: list[str] = field(default_factory=list)
    extra: str = "none"
    clusters: int = 3
    moisture_required: bool = True
    seed: int = 0
    vision: bool = False
    resume: bool = False
    dask: str = ""

    def __post_init__(self) -> None:
        for name, value in FIT_PARAMETERS.check(asdict(self)).items():
            object.__setattr__(self, name, value)
        if self.onset_force >= self.target_force:
            raise InputError(
                f"onset_force is {self.onset_force:g} N, not below target_force "
                f"({self.target_force:g} N); lower one or raise the other"
            )
        if "pso" not in self.optimizer:
            object.__setattr__(self, "optimizer", ["pso", *self.optimizer])
        self.box()

    def box(self) -> np.ndarray:
        """Search box (4, 2): low and high of E0, E1 (Pa), tau1 (s), E2 (Pa)."""
        bounds = {name: tuple(map(float, span)) for name, span in PAPER_BOUNDS.items()}
        for text in self.bounds:
            name, _, span = text.partition("=")
            low, _, high = span.partition(":")
            try:
                values = (float(low), float(high))
            except ValueError:
                values = (math.nan, math.nan)
            if name not in bounds or not 0 < values[0] < values[1] < math.inf:
                raise InputError(
                    f"bounds '{text}': NAME=LOW:HIGH with 0 < LOW < HIGH in SI units is needed, NAME one of "
                    f"{', '.join(bounds)}, as in E0=50e3:160e3"
                )
            bounds[name] = values
        return np.array([bounds[name] for name in PARAMETER_NAMES])

    def to_dict(self) -> dict[str, Any]:
        """Plain mapping of all options."""
        return asdict(self)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], where: str = "options") -> FitOptions:
        """From a mapping; raises InputError for unknown names and bad values."""
        known = [f.name for f in fields(cls)]
        for name in values:
            if name not in known:
                raise InputError(
                    f"{where}: option '{name}' does not exist; known are {', '.join(known)}"
                )
        return cls(**values)

    @classmethod
    def from_json(cls, text: str, where: str = "options") -> FitOptions:
        """From the text of a JSON object, empty for the defaults; raises InputError."""
        try:
            values = json.loads(text) if text.strip() else {}
        except ValueError as error:
            raise InputError(f"{where}: not valid JSON ({error}); correct it") from None
        if not isinstance(values, dict):
            raise InputError(f"{where}: a JSON object of options is needed, found {values!r}")
        return cls.from_mapping(values, where)
