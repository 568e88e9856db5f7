# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the model node: what it loads and listens to."""

from __future__ import annotations

from dataclasses import dataclass

from finger_common.settings import Settings, setting

from .reduced.model import POPULATION


@dataclass(frozen=True)
class ModelSettings(Settings):
    """What the node loads and listens to."""

    wrench_topic: str = setting("wrench", "Topic of the tared force.", ros_name=True)
    parameter_file: str = setting(
        "",
        "parameters.yaml of a fit; empty for the shipped sets of the paper's three conditions.",
        runtime=True,
    )
    subjects_folder: str = setting(
        "",
        "Folder of the subjects' own parameters, SUBJECT.FINGER.yaml or SUBJECT.yaml, as a "
        "calibration writes them. Subject and finger on `trial` choose; a finger without file has "
        "those of parameter_file. Empty: none.",
    )
    geometry_file: str = setting(
        "",
        "geometry.yaml of the finger; empty for the default geometry. A parameter_file of other "
        "lengths is refused; a subject's own file may hold others.",
        advice="A finger outside the population box needs its own reduced model: finger-model "
        "reduce --geometry.",
    )
    reduced_model_file: str = setting(
        "",
        "Reduced model made by 'finger-model reduce'; empty for the shipped one of the finger. "
        f"'{POPULATION}': the shipped one of all fingers, which reaches about 10 N for the default "
        "finger too, whose own ends at 3 N; a sample takes twice as long.",
    )
    contact_shape: bool = setting(
        False,
        "Estimate ellipse and tilt of the contact, and publish them as contact_shape.",
        runtime=True,
        advice="Costs some percent of a core.",
    )
    force_stale_after: float = setting(
        0.1,
        "Time without a wrench sample after which diagnostics report an error.",
        unit="s",
        minimum=0.001,
        maximum=60.0,
        runtime=True,
    )
