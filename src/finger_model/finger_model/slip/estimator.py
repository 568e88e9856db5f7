# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Will it slip? Stick ratio, margin and probability of slip, and friction, sample by sample.

    model = load_reduced()
    contact, slip = ContactEstimator(model), SlipEstimator()
    for stamp_ns, force in wrenches:
        for estimate in contact.add_wrench(stamp_ns, force):
            slip.assume(model.geometry, contact.material)
            if slip.add(estimate, force).slip_probability > 0.15:
                grip_harder()

Coulomb friction with one coefficient that is estimated while running, quasi-static, independent of
rate. The output is a function of the inputs in their order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from finger_common.axes import DEFAULT_NORMAL_AXIS, lateral_axes
from finger_common.errors import InputError
from finger_common.flags import StateFlag
from finger_common.stamps import stamp_array

from ..delayed import Delayed
from ..estimator import ContactEstimate, EstimateBlock
from ..geometry import Geometry
from ..laws import MaxwellLaw
from ..material import Material
from . import friction, kernels, level
from .estimate import OUTPUT, SlipEstimate, slip_estimates
from .settings import SlipSettings
from .shear import set_finger


class SlipEstimator:
    """Slip of one finger's contact; see the module.

    settings: None for the defaults; normal_axis: as in EstimatorSettings. Raises InputError for
    another axis.
    """

    def __init__(
        self, settings: SlipSettings | None = None, normal_axis: str = DEFAULT_NORMAL_AXIS
    ) -> None:
        self._config = np.zeros(1, kernels.CONFIGURATION)
        self._state = np.zeros(1, kernels.STATE)
        self._sample = np.zeros(1, kernels.SAMPLE)
        self._row = np.zeros(1, OUTPUT)
        self._strangers = 0
        """Samples in a row whose force is not that of their estimate."""
        self.sticks: Delayed[tuple[float, float]] = Delayed()
        """Stick ratios that wait, each with its standard deviation; the owner sets the delay."""
        self._finger: tuple[Geometry, MaxwellLaw] | None = None
        self.assume(Geometry(), Material())
        self.configure(settings or SlipSettings())
        self.turn(normal_axis)

    def configure(self, settings: SlipSettings) -> None:
        """Take over settings; their prior enters at the next reset, or now if none was learned."""
        self.settings = settings
        config = self._config
        config["prior"]["mean"] = math.log(settings.friction_prior)
        config["prior"]["sd"] = settings.friction_prior_sd
        config["prior"]["moisture_slope"] = settings.friction_moisture_slope
        config["drift"] = settings.friction_drift
        config["horizon"] = settings.slip_horizon
        config["noise"] = settings.tangential_noise
        config["coupled"] = settings.grip_follows_load
        of_friction = self._state["friction"][0]
        belief = of_friction["belief"]
        if not belief["has_evidence"]:
            if belief["level"]["sd"] != settings.level_sd:
                level.begin(belief["level"], settings.level_sd)
            friction.set_prior(config["prior"][0], of_friction, float(of_friction["moisture"]))

    def assume(self, geometry: Geometry, material: MaxwellLaw) -> None:
        """The finger that displacement and stiffness are of; until this is called the default one.

        A new geometry takes some hundredths of a second. Raises InputError for a material without
        Maxwell branches.
        """
        if not isinstance(material, MaxwellLaw):
            raise InputError(
                f"material: slip is for laws of Maxwell branches, not '{material.name}'"
            )
        if self._finger is None or self._finger != (geometry, material):
            self._finger = geometry, material
            set_finger(self._config["finger"][0], geometry, material)

    def turn(self, normal_axis: str) -> None:
        """Begin anew with this axis of the sensor along the plate's normal.

        Raises InputError for another axis.
        """
        self.lateral_axes = lateral_axes(normal_axis)
        self.reset()

    def reset(self) -> None:
        """A finger and a plate that were not seen before."""
        self._state[:] = np.zeros(1, kernels.STATE)
        of_friction = self._state["friction"][0]
        level.begin(of_friction["belief"]["level"], self.settings.level_sd)
        friction.set_prior(self._config["prior"][0], of_friction, math.nan)

    def change_surface(self) -> None:
        """Another plate; what is known of the sensor, its zero and its tilt, is kept."""
        air, stamp = self._state["forces"]["air"].copy(), self._state["stamp"].copy()
        before = self._state["friction"]["belief"].copy()[0]
        self.reset()
        self._state["forces"]["air"], self._state["stamp"] = air, stamp
        friction.keep_level(before, self._state["friction"]["belief"][0])
        friction.set_prior(self._config["prior"][0], self._state["friction"][0], math.nan)

    def add(self, estimate: ContactEstimate, force: Sequence[float]) -> SlipEstimate:
        """One sample: the contact's estimate and the force (3,) in N that it came from.

        Raises InputError for the third in a row whose estimate has another lateral force, as with
        another normal axis; single ones come where time jumps, see `ContactEstimator.add_wrench`.
        """
        first, second = self.lateral_axes
        a, b = force[first], force[second]
        across = math.sqrt(a * a + b * b)
        strange = abs(across - estimate.lateral_force) > 1e-6 * (1.0 + across)
        self._strangers = self._strangers + 1 if strange else 0
        if self._strangers > 2:
            raise _stranger(across, estimate.lateral_force)
        if estimate.flags & StateFlag.TIME_RESET:
            self._begin_anew(estimate.stamp_ns)
        self._see_due(estimate.stamp_ns)
        self._sample[0] = (
            estimate.stamp_ns,
            estimate.normal_force,
            (a, b),
            estimate.in_contact,
            estimate.flags & StateFlag.FORCE_OFFSET,
            estimate.indentation,
            estimate.moisture,
        )
        kernels.process_samples(self._config, self._state, self._sample, self._row)
        return slip_estimates(self._row)[0]

    def add_block(self, block: EstimateBlock, forces: np.ndarray) -> np.ndarray:
        """As `add` for a block of n estimates and their forces (n, 3); rows (n,) of OUTPUT.

        Raises InputError also for another shape of forces; samples that were dropped have no
        estimate.
        """
        forces = np.asarray(forces, float)
        if forces.shape != (len(block), 3):
            raise InputError(
                f"forces have shape {forces.shape}, ({len(block)}, 3) is needed: those of the "
                "samples that have an estimate"
            )
        lateral = forces[:, self.lateral_axes]
        across, own = np.hypot(*lateral.T), block.column("lateral_force")
        strange = np.abs(across - own) > 1e-6 * (1.0 + across)
        in_a_row = np.flatnonzero(strange[2:] & strange[1:-1] & strange[:-2])
        if len(in_a_row):
            raise _stranger(across[in_a_row[0]], own[in_a_row[0]])
        stamps = block.column("stamp_ns")
        resets = np.flatnonzero(block.column("flags") & int(StateFlag.TIME_RESET)).tolist()
        found = [np.zeros(0, OUTPUT)]
        for begin, end in zip([0, *resets], [*resets, len(block)]):
            if begin in resets:
                self._begin_anew(int(stamps[begin]))
            while begin < end:
                self._see_due(int(stamps[begin]))
                until, due = end, self.sticks.next_due
                if due is not None:
                    until = begin + int(np.searchsorted(stamps[begin:end], due))
                rows = block.rows[begin:until]
                found.append(
                    self.add_many(
                        rows["stamp_ns"],
                        rows["normal_force"],
                        lateral[begin:until],
                        rows["in_contact"],
                        rows["indentation"],
                        rows["moisture"],
                        rows["flags"] & int(StateFlag.FORCE_OFFSET) != 0,
                    )
                )
                begin = until
        return np.concatenate(found)

    def add_many(
        self,
        stamps_ns: np.ndarray,
        normal_force: np.ndarray,
        lateral: np.ndarray,
        touching: np.ndarray,
        indentation: np.ndarray,
        moisture: np.ndarray | None = None,
        doubted: np.ndarray | None = None,
    ) -> np.ndarray:
        """Rows (n,) of OUTPUT for n samples.

        normal_force, indentation, moisture (n,), lateral (n, 2) in SI; touching (n,): whether in
        contact; doubted (n,): whether the force is hardly a finger's (FORCE_OFFSET): margin and
        stick ratio are not known, and nothing is learned from a contact that ends so. Raises
        InputError for other shapes.
        """
        n = len(stamps_ns)
        if moisture is None:
            moisture = np.full(n, math.nan)
        if doubted is None:
            doubted = np.zeros(n, bool)
        samples = np.zeros(n, kernels.SAMPLE)
        for name, column, values in (
            ("normal_force", samples["normal"], normal_force),
            ("lateral", samples["lateral"], lateral),
            ("touching", samples["touching"], touching),
            ("indentation", samples["indentation"], indentation),
            ("moisture", samples["moisture"], moisture),
            ("doubted", samples["doubted"], doubted),
        ):
            if np.shape(values) != column.shape:
                raise InputError(f"{name} has shape {np.shape(values)}, {column.shape} is needed")
            column[:] = values
        samples["stamp"] = stamp_array(stamps_ns)
        rows = np.zeros(n, OUTPUT)
        kernels.process_samples(self._config, self._state, samples, rows)
        return rows

    def expect_stick_ratio(self, stamp_ns: int, stick_ratio: float, sd: float) -> None:
        """As `add_stick_ratio`, at the first sample stamped `stamp_ns` + `sticks.delay` or later.

        So that the result does not depend on when the reading comes. A second reading of a stamp,
        and one without a finite ratio, is left out.
        """
        if math.isfinite(stick_ratio):
            self.sticks.add(stamp_ns, (stick_ratio, sd))

    def expect_lost_sight(self, stamp_ns: int) -> None:
        """A picture of this stamp, in which no skin was followed, as in the first one after a pause
        of the camera.

        What has slipped before is not known then: if there was a load, later stick ratios of the
        contact are the most that may stick. It takes effect as `expect_stick_ratio`.
        """
        self.sticks.add(stamp_ns, (math.nan, math.nan))

    def _see_due(self, stamp_ns: int) -> None:
        """Use the stick ratios that are due at a sample of this stamp."""
        for seen_at, (ratio, sd) in self.sticks.due(stamp_ns):
            if math.isnan(ratio):
                kernels.lose_sight(self._state[0], seen_at)
            else:
                self.add_stick_ratio(seen_at, ratio, sd)

    def _begin_anew(self, stamp_ns: int) -> None:
        """Time jumped back to a stamp."""
        self.reset()
        self.sticks.jump_back(stamp_ns)

    def add_stick_ratio(self, stamp_ns: int, stick_ratio: float, sd: float) -> bool:
        """A stick ratio seen by a camera at `stamp_ns`, with its standard deviation.

        False when it tells nothing: no contact then, no tangential load, after a reversal, or not a
        ratio from 0 to 1.
        """
        if not (0.0 <= stick_ratio <= 1.0 and sd > 0.0):
            return False
        return bool(
            kernels.update_from_stick_ratio(self._state[0], stamp_ns, float(stick_ratio), float(sd))
        )


def _stranger(across: float, own: float) -> InputError:
    """What is said of estimates whose lateral force is not that of the force that is given."""
    return InputError(
        f"the lateral force is {across:.3g} N, the estimate has {own:.3g} N; give SlipEstimator "
        "the normal_axis of EstimatorSettings, and each estimate the force of its own sample"
    )
