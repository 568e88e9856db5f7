# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The memory of the estimator between samples, as records of the compiled core."""

from __future__ import annotations

import numpy as np

from finger_common.axes import axis_of
from finger_common.stamps import nanoseconds

from ..reduced import kernels as rk
from ..reduced.model import ReducedModel
from . import stream
from .estimate import ESTIMATE_DTYPE
from .parameter_selection import SelectedParameters
from .settings import EstimatorSettings


class FilterState:
    """One finger: state of the reduced model, filters, past samples; and the configuration."""

    def __init__(self, model: ReducedModel) -> None:
        self.model = model
        self.configuration = np.zeros(1, stream.CONFIGURATION)
        self.state = np.zeros(1, stream.STATE)
        self.finger: np.ndarray = np.zeros(0)
        self.constants: np.ndarray = np.zeros(0)
        self._stream = self.state["stream"]

    # Configuration ---------------------------------------------------------------------------

    def configure(self, settings: EstimatorSettings) -> None:
        """Take over settings; the state stays."""
        config = self.configuration
        config["axis"], config["sign"] = axis_of(settings.normal_axis)
        for name in (
            "onset_force",
            "liftoff_force",
            "lateral_ratio",
            "gap_limit",
            "area_stale_after",
            "moisture_stale_after",
        ):
            config[name] = getattr(settings, name)
        config["fusion_delay"] = nanoseconds(settings.fusion_delay)
        noise = config["noise"]
        noise["slope_variance"] = settings.slope_sd**2
        noise["contact_variance"] = settings.contact_area_sd**2
        noise["drift_variance"] = settings.drift_sd**2
        noise["model_variance"] = self.model.rms_error**2
        noise["outlier_limit"] = settings.outlier_limit

    def use_parameters(
        self, selected: SelectedParameters, moisture: tuple[int, float] | None
    ) -> None:
        """Take over parameters, and the moisture reading (stamp, value) that they are for."""
        config = self.configuration
        config["moisture_stamp"], config["moisture"] = moisture or (0, np.nan)
        config["flags"] = selected.flags
        config["noise"]["prior_variance"] = selected.prior_variance
        self.constants = selected.constants
        if not len(self.finger):
            self.finger = self.model.state_at_rest(self.constants)
        rk.refresh(self.model.networks, self.constants, self.finger, self.model.work)

    # State -----------------------------------------------------------------------------------

    @property
    def last_stamp(self) -> int | None:
        """Stamp (ns) of the newest wrench sample, None before the first."""
        started, newest, *_ = self._stream.item()
        return newest if started else None

    def add_flag(self, flag: int) -> None:
        """Set a flag of the next estimate."""
        self._stream["pending_flags"] |= flag

    def counts(self) -> dict[str, int]:
        """Counts since the start or the last reset."""
        counters = self.state["counters"]
        return {name: int(counters[name][0]) for name in stream.COUNTERS.names or ()}

    def reset(self, keep_stream: bool = False) -> None:
        """A finger at rest, not seen before; `keep_stream`: the stream of samples continues."""
        kept = self._stream.copy()
        self.state[:] = np.zeros(1, stream.STATE)
        self._stream["pending_flags"] = kept["pending_flags"]
        if keep_stream:
            self._stream[:] = kept
        self.finger = self.model.state_at_rest(self.constants)
        stream.initialise_filters(self.configuration, self.state)

    def initialise_filters(self) -> None:
        """Filters as for a finger not seen before, within the present contact."""
        stream.initialise_filters(self.configuration, self.state)
        if self.state["contact"]["touching"][0]:
            self.state["filters"]["stamp"] = self._stream["last_stamp"]

    def process(
        self, stamps: np.ndarray, forces: np.ndarray, areas: np.ndarray, rows: np.ndarray
    ) -> int:
        """Process samples as `stream.process` does; returns the number of areas used up."""
        return stream.process(
            self.model.networks,
            self.constants,
            self.finger,
            self.model.work,
            self.configuration,
            self.state,
            stamps,
            forces,
            areas,
            rows,
        )

    def fused_areas(self, forces: np.ndarray, model_areas: np.ndarray) -> np.ndarray:
        """Areas (n,) in m² under forces (n,) in N: the model's with the error known so far."""
        areas = np.empty(len(forces))
        stream.fused_areas(self.configuration, self.state, forces, model_areas, areas)
        return areas


def new_rows(number: int, parameter_set: str) -> np.ndarray:
    """Rows (n,) of ESTIMATE_DTYPE for `FilterState.process`."""
    rows = np.empty(number, ESTIMATE_DTYPE)
    rows["parameter_set"] = parameter_set
    return rows
