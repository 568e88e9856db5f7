# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the model node reports once a second: warnings of the estimates' flags and of the inputs;
counters and delays."""

from __future__ import annotations

import json
import math

from finger_common.diagnostics import WARN, Health
from finger_common.flags import ShapeFlag, StateFlag
from finger_common.node import ManagedNode
from finger_common.stamps import seconds
from finger_common.units import LARGEST_FORCE

from ..estimator import EstimatorSettings
from ..estimator.stream import LARGEST_AREA, LEAST_AREA
from ..lateness import Lateness
from ..model_run import Run
from ..shape.estimate import ShapeEstimate

_WARNINGS = {
    StateFlag.MOISTURE_MISSING: "no moisture reading yet, default parameters are in use",
    StateFlag.MOISTURE_STALE: "the moisture reading is older than moisture_stale_after",
    StateFlag.MOISTURE_OUT_OF_RANGE: "moisture {moisture:.3g} is outside the model's range: "
    "estimate less certain",
    StateFlag.PARAMETERS_OUT_OF_RANGE: "the material parameters lie outside the range of the "
    "reduced model",
    StateFlag.AREA_STALE: "no area was fused for longer than area_stale_after while in contact",
    StateFlag.FORCE_INVALID: "the force is not a finite number",
    StateFlag.FORCE_OFFSET: "force without a finger is suspected: tare the force sensor with "
    "nothing on the plate",
    StateFlag.POSE_OUT_OF_RANGE: "pad_aspect, the plate's tilt or the finger's proportions are "
    "beyond what the correction of the area was learned for",
}

_NO_AREA = "in contact for longer than area_stale_after, and no area was fused in this contact"


def _beyond(force: float, limit: float) -> str:
    """What to say of a force (N) out of range; limit: of the model (N)."""
    if force > LARGEST_FORCE:
        return f"a force of {force:.3g} N is no finger's: publish the wrench in N"
    if force > limit:
        return (
            f"a force of {force:.3g} N is beyond the {limit:.2g} N that the reduced model was "
            "built for: press less hard, or set reduced_model_file; is the wrench in N?"
        )
    return "the force is beyond what the tissue of these parameters carries: press less hard"


class ModelDiagnostics:
    """Tells what one model node has seen.

    states, inputs: what is reported of the published states, and of all else. probed: whether
    `moisture` has, or had, a publisher. late: what to count late inputs with, by fault.
    """

    def __init__(self, node: ManagedNode, states: Health, inputs: Health) -> None:
        self._node = node
        self._states = states
        self._inputs = inputs
        self.probed = False
        self.late = {
            "late_areas": Lateness("contact areas"),
            "late_moistures": Lateness("moisture readings"),
        }
        self._shapes = self._outside = 0
        """Shapes of contacts since the last `tell`, and those whose torque lies beside them."""
        self._apart = math.nan
        """m between the centres of contact and pressure of the newest of these."""

    def tell(self, run: Run, lengths: str) -> None:
        """Report on a run. lengths: where those of its finger come from."""
        notes = self._states.notes
        # Also what came and went since the diagnostics before.
        flags, run.flags = run.flags, 0
        self.probed = self.probed or self._node.count_publishers("moisture") > 0
        if not self.probed:  # a rig without a probe
            flags &= ~StateFlag.MOISTURE_MISSING
        for flag, sentence in _WARNINGS.items():
            key = flag.name.lower()  # type: ignore[union-attr]
            moisture = math.nan if run.last is None else run.last.moisture
            self.warn_while(bool(flags & flag), key, sentence.format(moisture=moisture))
        beyond = _beyond(run.watch.largest, run.estimator.force_limit)
        self.warn_while(bool(flags & StateFlag.FORCE_OUT_OF_RANGE), "force_out_of_range", beyond)
        for key, sentence in run.area_watch.look().items():
            self.warn_while(bool(sentence), key, sentence)
        self.warn_while(self._area_is_overdue(run), "area_missing", _NO_AREA)
        doubt = run.estimator.parameter_sets.doubt()
        self.warn_while(bool(doubt), "parameter_status", doubt)
        # Beside a silence of the states, which wrong stamps explain.
        wrong = run.watch.look(self._node.values["normal_axis"])
        for key, sentence in wrong.items():
            self.warn_while(bool(sentence), key, sentence, self._states)
        # Of wrenches that come and are left out their stamps tell.
        self._states.advice = "" if wrong["wrench_stamps"] else self._missing_wrench()
        for key, late in self.late.items():
            sentence = late.look()
            self.warn_while(bool(sentence), key, sentence)
        self._tell_torque()
        found = run.estimator.mismatch()
        self.warn_while(
            bool(flags & StateFlag.MODEL_MISMATCH),
            "model_mismatch",
            f"measured areas are not those of this finger's model: it is {found.sentence()}",
        )
        model = f"{run.estimator.model.hash[:8]}, lengths of {lengths}"
        notes["model"] = model
        notes["finger"] = found.sentence()
        notes["finger_deviation_sd"] = f"{found.deviation:.2f}"
        notes["finger_probability"] = f"{found.probability:.3g}"
        notes["surprise"] = f"{found.surprise:.2f}"
        for name, number in run.estimator.statistics().items():
            notes[name] = str(number)
        notes["parameters"] = json.dumps([float(f"{v:.6g}") for v in run.estimator.parameters])
        simulated = self._node.get_parameter("use_sim_time").value
        for name, delays in (("latency", run.latency), ("age", run.age)):
            for percent in (50, 99):
                # Stamps of a simulated time have no age by the host's clock.
                known = name == "latency" or not simulated
                text = delays.text(percent) if known else "unknown"
                notes[f"{name}_p{percent}_ms"] = text

    def warn_while(
        self, condition: bool, key: str, sentence: str, health: Health | None = None
    ) -> None:
        """Report a fault, of the inputs by default, as long as the condition holds."""
        health = health or self._inputs
        if condition:
            self._node.log_fault(health, key, sentence, WARN)
        else:
            health.recovered(key)

    def _missing_wrench(self) -> str:
        """What to check where no sample comes."""
        topic = self._node.resolve_topic_name(self._node.values["wrench_topic"])
        sources = sorted(name.removeprefix("/") for name in self._node.publishers_of(topic))
        if not sources:
            return f"nothing comes on {topic}, 0 publishers: check wrench_topic and namespace"
        return f"nothing comes on {topic} from {', '.join(sources)}: check that node and its sensor"

    def see_shape(self, shape: ShapeEstimate) -> None:
        """Follow whether the torque puts the force where the finger is."""
        if shape.flags & ShapeFlag.NO_CONTACT:
            return
        self._shapes += 1
        if shape.flags & ShapeFlag.PRESSURE_OUTSIDE:
            self._outside += 1
            apart = math.dist(shape.center_of_pressure, shape.center)
            self._apart = apart if math.isfinite(apart) else self._apart

    def _tell_torque(self) -> None:
        """Report a torque that puts the force beside the finger in most shapes since the last time;
        it stays told between two contacts."""
        shapes, outside = self._shapes, self._outside
        self._shapes = self._outside = 0
        if shapes or not self._node.values["contact_shape"]:
            self.warn_while(
                2 * outside > shapes,
                "torque",
                f"by its torque the force acts {1e3 * self._apart:.3g} mm beside the contact's "
                "centre, and contact_shape does not trust it: publish the torque in N m about the "
                "sensor's origin, and check sensor_x, sensor_y, sensor_depth and wrench_on_finger",
            )

    def see_area(self, area: float, sd: float, used: bool) -> None:
        """Report an area (m²) that cannot be used, by its deviation (m²) or by itself. used:
        whether it is of a contact, and not left out for its flags."""
        topic = self._node.resolve_topic_name("contact_area")
        sentence = ""
        if used and not LEAST_AREA < area < LARGEST_AREA:
            sentence = f"gross_area {area:.3g} m², not that of a fingertip: publish it in m², "
            sentence += "30 mm² are 30e-6"
        elif used and not 0.0 < sd < LARGEST_AREA:
            sentence = f"area_stddev {sd:.3g} m²: publish a positive area_stddev in m²"
        if sentence:
            sentence = f"{topic} has {sentence}; left out"
            self._node.log_fault(self._inputs, "bad_area", sentence, WARN)
        else:
            self._inputs.cleared("bad_area")

    def _area_is_overdue(self, run: Run) -> bool:
        """Whether the contact has lasted longer than `area_stale_after` without a fused area.

        Never in a rig without a camera: areas must be asked for (`fuse_area`), and one must have
        come or `contact_area` must have a publisher.
        """
        last = run.last
        if last is None or not last.flags & StateFlag.AREA_MISSING:
            return False
        settings = self._node.settings(EstimatorSettings)
        duration = seconds(last.stamp_ns - last.onset_ns)
        if not settings.fuse_area or duration <= settings.area_stale_after:
            return False
        return run.area_received or self._node.count_publishers("contact_area") > 0
