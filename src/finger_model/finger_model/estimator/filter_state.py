# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The memory of the estimator between samples, as records of the compiled core."""

from __future__ import annotations

import math

import numpy as np

from finger_common.axes import axis_of
from finger_common.flags import StateFlag
from finger_common.stamps import nanoseconds

from ..pose.correction import PoseCorrection
from ..pose.pose import Pose
from ..reduced.kernels import ModelRecords
from ..reduced.model import ReducedModel
from . import area_filter, sensitivities, stream
from .estimate import ESTIMATE_DTYPE
from .mismatch import Mismatch, mismatch_of
from .parameter_selection import SelectedParameters
from .settings import EstimatorSettings


class FilterState:
    """One finger: state of the reduced model, filters, past samples; and the configuration.
    stretch_sd: as for `PoseCorrection`."""

    def __init__(self, model: ReducedModel, stretch_sd: float) -> None:
        self.model = model
        self._stretch_sd = stretch_sd
        self.configuration = np.zeros(1, stream.CONFIGURATION)
        self.state = np.zeros(1, stream.STATE)
        none = np.zeros(0)
        self.records = ModelRecords(model.networks, none, none, none, model.work)
        self._stream = self.state["stream"]
        self._pose = Pose()
        self._correction: PoseCorrection | None = None
        self._skin_ratio = math.nan

    # Configuration ---------------------------------------------------------------------------

    def configure(self, settings: EstimatorSettings) -> None:
        """Take over settings, before `use_parameters`; the state stays."""
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
        config["zero_variance"] = settings.force_zero_sd**2
        self._pose = settings.pose
        noise = config["noise"]
        noise["gain_variance"] = settings.area_gain_sd**2
        noise["outlier_limit"] = settings.outlier_limit

    @property
    def pose_correction(self) -> PoseCorrection:
        """What corrects the area of the round pad on a level plate, with the pose of the settings
        and the parameters in use. The same object until one of them changes."""
        if self._correction is None:
            self._correction = PoseCorrection(
                self.model.geometry, self._pose, self._skin_ratio, self._stretch_sd
            )
        return self._correction

    def _take_pose(self, skin_ratio: float) -> int:
        """Correct the model's area for a pad that is not round, or a plate that is tilted; gives
        bits of StateFlag."""
        known = self._correction
        if known is None or known.pose != self._pose or known.skin_ratio != skin_ratio:
            self._skin_ratio, self._correction = skin_ratio, None
        own = self.configuration["pose"]
        own[:] = 0.0
        if self._pose == Pose():
            return 0
        correction = self.pose_correction
        own[:, :3] = correction.area_polynomial
        own[:, 3] = 1.0 / (math.sqrt(math.pi) * correction.half_width)
        return 0 if correction.inside else int(StateFlag.POSE_OUT_OF_RANGE)

    def use_parameters(
        self, selected: SelectedParameters, moisture: tuple[int, float] | None
    ) -> None:
        """Take over parameters, and the moisture reading (stamp, value) that they are for."""
        config = self.configuration
        held, before = self._held_area(), self._model_key()
        fresh = not len(self.records.states)
        new = fresh or config["moisture_stamp"][0] != (moisture or (0, np.nan))[0]
        config["moisture_stamp"], config["moisture"] = moisture or (0, np.nan)
        config["flags"] = selected.flags | self._take_pose(selected.material.skin_ratio)
        noise, prior = config["noise"], selected.prior
        noise["prior_mean"], noise["prior_covariance"] = prior.mean, prior.covariance
        noise["moisture_direction"] = prior.moisture_direction
        noise["moisture_variance"] = prior.moisture_variance
        noise["moisture_wander"] = prior.moisture_wander
        noise["contact_variance"] = prior.contact_sd**2
        noise["drift_limit"] = 2.0 * (max(area_filter.SCALES) * prior.contact_sd) ** 2
        noise["slope_variance"] = prior.slope_sd**2
        noise["drift_variance"] = prior.drift_sd**2
        noise["walk_variance"] = prior.walk_sd**2
        config["peak"] = prior.peak
        config["indentation"] = prior.indentation
        own = self.model.rms_error_of(selected.parameters)
        errors = own, prior.misfit_sd, self.pose_correction.area_sd
        noise["model_variance"] = sum(error**2 for error in errors)
        self.records = self.records._replace(base=selected.constants)
        if new:
            stream.new_reading(config, self.state)
        if fresh:
            self._put_at_rest()
        if new or self._model_key() != before:
            stream.change_parameters(self.records, config, self.state, held)

    def _model_key(self) -> tuple[bytes, bytes]:
        """What the model's area depends on beside force and history."""
        return self.records.base.tobytes(), self.configuration["pose"].tobytes()

    def _held_area(self) -> float:
        """See `stream.held_area`."""
        if not len(self.records.states):
            return math.nan
        return float(stream.held_area(self.records, self.configuration, self.state))

    def _put_at_rest(self) -> None:
        """Constants (4,) as `base`; states (4,) of the finger and its perturbed copies at rest."""
        constants = np.repeat(self.records.base, 1 + sensitivities.DIRECTIONS)
        states = np.concatenate([self.model.state_at_rest(c[None]) for c in constants])
        self.records = self.records._replace(constants=constants, states=states)

    # State -----------------------------------------------------------------------------------

    @property
    def last_stamp(self) -> int | None:
        """Stamp (ns) of the newest wrench sample, None before the first."""
        started, newest, *_ = self._stream.item()
        return newest if started else None

    @property
    def force(self) -> float:
        """Normal force (N) of the newest sample that the model followed."""
        return float(self.records.states["force"][0])

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
            self.state["sensitivities"]["stamp"] = kept["model_stamp"]
        self._put_at_rest()
        self._initialise()

    def _initialise(self) -> None:
        stream.initialise_filters(self.records, self.configuration, self.state)

    def initialise_filters(self) -> None:
        """Filters as for a finger not seen before, within the present contact."""
        self._initialise()
        if self.state["contact"]["touching"][0]:
            self.state["filters"]["stamp"] = self._stream["last_stamp"]

    def process(
        self, stamps: np.ndarray, forces: np.ndarray, areas: np.ndarray, rows: np.ndarray
    ) -> None:
        """Process samples as `stream.process` does."""
        configuration, state = self.configuration, self.state
        stream.process(self.records, configuration, state, stamps, forces, areas, rows)

    def mismatch(self) -> Mismatch:
        """How far the finger is from its model."""
        return mismatch_of(self.state["filters"][0], self.configuration["noise"][0])

    def predicted(self, time: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Fused area (m²), indentation (m), peak pressure (Pa) (n, 3) under a future force.

        time (n,) in s from now, force (n,) in N; the state stays as it is.
        """
        table = np.empty((len(time), 3))
        configuration, state = self.configuration, self.state
        records = self.records._replace(states=self.records.states.copy())
        if not state["contact"]["touching"][0]:
            # The next contact has errors of its own, not those of the last.
            records, state = records._replace(constants=records.constants.copy()), state.copy()
            stream.begin_contact(records, configuration, state)
        scratch = np.zeros(1, sensitivities.SENSITIVITIES)
        stream.predicted(records, scratch, configuration, state, time, force, table)
        return table


def new_rows(number: int, parameter_set: str) -> np.ndarray:
    """Rows (n,) of ESTIMATE_DTYPE for `FilterState.process`."""
    rows = np.empty(number, ESTIMATE_DTYPE)
    rows["parameter_set"] = parameter_set
    return rows
