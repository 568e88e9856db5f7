# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node `model`: publishes `contact_state` for every wrench sample, and `contact_slip` where
somebody listens; with `contact_shape: true` also `contact_shape`.

The estimate is corrected by `contact_area`; its parameters follow `moisture`.
"""

from __future__ import annotations

import gc
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from finger_common.cli import one_line
from finger_common.diagnostics import WARN, Health
from finger_common.errors import FingerError
from finger_common.flags import AreaFlag, StateFlag
from finger_common.moisture import MOISTURE_TEXT, is_moisture
from finger_common.node import (
    EVENTS_QOS,
    LATCHED_QOS,
    FixedMessage,
    Listeners,
    LocalSubscription,
    ManagedNode,
    main_of,
    message_of,
)
from finger_common.stamps import seconds
from finger_common.subject_code import known_finger
from finger_msgs.msg import (
    ContactArea,
    ContactShape,
    ContactSlip,
    ContactState,
    ModelEvent,
    Moisture,
    Trial,
)
from finger_msgs.srv import ForceForArea, PredictContact

from .anthropometry import GeometryEstimate
from .calibration import Calibration, CalibrationPress
from .estimator import ContactEstimate, ContactEstimator, EstimatorEvent, EstimatorSettings
from .estimator.estimator import FUTURE
from .estimator.events import ANOTHER_SUBJECT
from .finger_files import FingerFiles
from .messages import (
    area_of,
    event_fields,
    moisture_of,
    outline_of,
    plate_frame,
    shape_numbers,
    slip_numbers,
    state_numbers,
    stick_of,
    torque_of,
    wrench_of,
)
from .model_run import Run, Vector
from .model_settings import ModelSettings
from .node.calibration import LiveCalibration
from .node.model_diagnostics import ModelDiagnostics
from .parameter_sets import ParameterSets
from .reduced.model import ReducedModel
from .shape.estimate import MeasuredOutline
from .shape.settings import PoseSettings
from .slip import SlipSettings
from .slip_and_shape import SlipAndShape, prepare
from .subject_calibration import fit_subject
from .warm_up import is_compiled, warm_up, warm_up_all

SAMPLES_PER_CALLBACK = 64
"""Waiting samples processed in one callback, before other callbacks have their turn."""


class _Texted:
    """Serializes messages of one type whose texts change seldom.

    prototype: makes a message of its texts.
    """

    def __init__(self, prototype: Callable[..., Any]) -> None:
        self._prototype = prototype
        self._texts: tuple[str, ...] | None = None

    def pack(self, texts: tuple[str, ...], numbers: tuple[float, ...]) -> bytes:
        """The message with these texts and numbers, in the order of its fields."""
        if texts != self._texts:
            self._texts, self._message = texts, FixedMessage(self._prototype(*texts))
        return self._message.pack(*numbers)


_one_aside = threading.Lock()
"""Nodes of one process compute aside one after the other: a reading comes to all fingers at once,
and with real-time priority their threads would keep all cores from the samples."""


class ModelNode(ManagedNode):
    """Node around a ContactEstimator.

    Wrench samples of a force node in the same process come in that node's thread, all others
    through DDS. `_lock` is held by whoever uses the estimator.
    """

    SETTINGS = (EstimatorSettings, SlipSettings, PoseSettings, ModelSettings)
    NAME = "model"

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.health = Health("contact state", rate_tolerance=0.1, stale_after=0.1)
        # Apart from the stream, so that a warning of an input does not hide a silent sensor.
        self.inputs = Health("inputs")
        self.healths += [self.health, self.inputs]
        self._files: FingerFiles | None = None
        self._sets: ParameterSets | None = None
        self._run: Run | None = None
        self._reading: tuple[int, float] | None = None
        self._readings: deque[tuple[int, float]] = deque(maxlen=64)
        self._sequence = 0
        self._model_diagnostics = ModelDiagnostics(self, self.health, self.inputs)
        self._lock = threading.RLock()
        self._pack_state = _Texted(
            lambda frame, name: ContactState(header=Header(frame_id=frame), parameter_set=name)
        ).pack
        self._pack_slip = _Texted(lambda frame: ContactSlip(header=Header(frame_id=frame))).pack
        self._pack_shape = _Texted(lambda frame: ContactShape(header=Header(frame_id=frame))).pack
        self._wrench: Any = None
        self._local: LocalSubscription | None = None
        self._subject = self._finger = ""
        self._calibration = LiveCalibration(self, self._fit_subject, self._use_calibration)
        self._preparation: threading.Thread | None = None

    # Lifecycle -------------------------------------------------------------------------------

    def configure(self) -> None:
        """Load model and parameters, compile, connect."""
        values = self.values
        self._files = FingerFiles(
            values["reduced_model_file"],
            values["geometry_file"],
            values["subjects_folder"],
            self.get_logger().warning,
        )
        self._sets = self._files.named_sets(values["parameter_file"])
        if not is_compiled():
            self.get_logger().info(
                "compiling the model for the first time, a minute or two; the node answers after it"
            )
        warm_up_all()
        warm_up(self._new_estimator(self._sets))
        prepare(self._files.model_of(self._sets), self._sets)
        self._run = self._new_run(self._sets)
        self._sequence = 0
        self.health.stale_after = values["force_stale_after"]
        qos = self.stream_qos()
        self._state_publisher = self.create_stream_publisher(
            ContactState, "contact_state", self.stream_qos(publisher=True)
        )
        self._slip_publisher = self.create_stream_publisher(
            ContactSlip, "contact_slip", self.stream_qos(publisher=True)
        )
        self._slip_listeners = Listeners(self._slip_publisher)
        self._shape_publisher = self.create_stream_publisher(
            ContactShape, "contact_shape", self.stream_qos(publisher=True)
        )
        self._event_publisher = self.create_publisher(ModelEvent, "model_events", EVENTS_QOS)
        local = LocalSubscription(self, values["wrench_topic"], self._on_sample, self.fail)
        self._local = local
        self._follow_wrench()
        self.create_waited_subscription(ContactArea, "contact_area", self._on_area, qos)
        # From one node of this process samples come by a call, and the topic is not read.
        self.expect_one_publisher(values["wrench_topic"], lambda: local.sources != 1)
        for topic in ("contact_area", "moisture"):
            self.expect_one_publisher(topic)
        self.create_waited_subscription(Moisture, "moisture", self._on_moisture, qos)
        # Readings from before this node was there, where the probe keeps them for late joiners.
        self.create_subscription(
            Moisture,
            "moisture",
            self._on_moisture,
            LATCHED_QOS,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self.create_stream_subscription(Trial, "trial", self._on_trial, LATCHED_QOS)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/new_surface", self._on_new_surface)
        self.create_service(ForceForArea, "~/force_for_area", self._on_force_for_area)
        self.create_service(PredictContact, "~/predict", self._on_predict)
        self._calibration.open()
        jumps = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
            ),
            post_callback=self._on_jump,
        )
        self.closing.callback(jumps.unregister)
        self._tell_model(self._run.estimator)

    def activate(self) -> None:
        """Begin with a finger at rest."""
        self.health.numbered(None)
        self._follow_wrench()
        self._calibration.forget()
        self._run = self._new_run(self._own_sets())
        if self._reading is not None:
            self._run.estimator.add_moisture(*self._reading)
        # What exists now lives as long as the node; the garbage collector leaves it alone.
        gc.collect()
        gc.freeze()

    def deactivate(self) -> None:
        """Take no more samples."""
        # A sample that another thread took before is done with when this returns.
        with self._lock:
            pass

    def cleanup(self) -> None:
        """Disconnect."""
        self._calibration.wait()
        if self._local is not None:
            self._local.close()
            self._local = None
        self._follow_wrench()
        with self._lock:
            self._run = None

    def parameters_changed(self, changes: dict[str, Any]) -> None:
        """New settings or parameter sets, from the next sample on."""
        run, files = self._run, self._files
        assert run is not None and files is not None
        merged = {**self.values, **changes}
        settings, slip = EstimatorSettings.select(merged), SlipSettings.select(merged)
        pose = PoseSettings.select(merged)
        named = "parameter_file" in changes
        sets = files.named_sets(merged["parameter_file"]) if named else None
        # Nothing is refused from here on; what is made anew has all of the changes.
        self.values = merged
        self.health.stale_after = merged["force_stale_after"]
        changed = [name for name in changes if name in EstimatorSettings.parameters()]
        with self._lock:
            if "normal_axis" in changed:
                run.watch.forget()
            if changed:
                reason = f"parameter {', '.join(changed)} set"
                self._publish_event(run.estimator.change_settings(settings, reason))
            run.slip_and_shape.configure(slip, pose if merged["contact_shape"] else None)
            if sets is not None:
                self._sets = sets
                reason = f"parameter file {changes['parameter_file'] or 'unset, shipped sets'}"
                self._use_sets(self._own_sets(), reason, forget=False)

    def _tell_model(self, estimator: ContactEstimator) -> None:
        """Log the model in use and how exact it is."""
        assert self._files is not None
        model, parameters = estimator.model, estimator.parameters
        error = model.error_of(parameters)
        self.get_logger().info(
            f"reduced model {model.hash[:8]} of law '{model.law.name}', lengths of "
            f"{self._files.origin(estimator, self._subject)}, "
            f"RMS error {100 * model.rms_error_of(parameters):.2f} %"
            + (f" in {error['pairs']} full-order histories" if "pairs" in error else "")
            + f"; parameter sets {estimator.parameter_sets.hash[:8]}"
        )

    def _new_estimator(self, sets: ParameterSets) -> ContactEstimator:
        assert self._files is not None
        settings = self.settings(EstimatorSettings)
        return ContactEstimator(self._files.model_of(sets), sets, settings, self._files.stated)

    def _new_run(self, sets: ParameterSets) -> Run:
        pose = self.settings(PoseSettings) if self.values["contact_shape"] else None
        return Run(SlipAndShape(self._new_estimator(sets), self.settings(SlipSettings), pose))

    @property
    def _running(self) -> Run | None:
        """The run, None while the node is not active."""
        return self._run if self.active else None

    # Streams ---------------------------------------------------------------------------------

    def _follow_wrench(self) -> None:
        """Subscribe to the wrench, unless a node of this process gives it or none is wanted."""
        wanted = self._local is not None and not self._local.fed
        if wanted and self._wrench is None:
            self.health.numbered(None)
            self._wrench = self.create_stream_subscription(
                WrenchStamped, self.values["wrench_topic"], self._on_wrench, self.stream_qos()
            )
        elif not wanted and self._wrench is not None:
            self.destroy_subscription(self._wrench)
            self._wrench = None

    def _on_wrench(self, message: WrenchStamped, info: dict[str, int]) -> None:
        """One sample through DDS, and those that wait behind it.

        A round of the executor takes longer than an estimate.
        """
        if self._local is None or self._local.fed:
            return
        self._follow(message, info)
        handle = self._wrench.handle
        for _ in range(SAMPLES_PER_CALLBACK):
            with handle:
                taken = handle.take_message(WrenchStamped, False)
            if taken is None:
                return
            self._follow(*taken)

    def _follow(self, message: WrenchStamped, info: dict[str, int]) -> None:
        """All of a sample at once."""
        self.health.numbered(info.get("publication_sequence_number"))
        rest = self._on_sample(*_sample_of(message, info))
        if rest is not None:
            rest()

    def _on_sample(
        self,
        stamp: int,
        force: Vector,
        frame: str,
        received: int,
        torque: Vector = (0.0, 0.0, 0.0),
    ) -> Callable[[], None] | None:
        """One sample: stamp (ns), force (3,) in N, its frame, when it came (ns), torque (3,) in
        N m. Returns what is left to do, slip and shape: the states of other fingers come first."""
        with self._lock:
            run = self._running
            if run is None:
                return None
            estimator = run.estimator
            if run.first_stamp is None:
                run.first_stamp = stamp
                self._publish_event(estimator.start_event(stamp, run.reason))
            run.sampled_at = time.monotonic()
            if run.pause is not None:
                self._publish_event(estimator.note_pause(*run.pause))
                run.pause = None
            if run.jumped:
                run.jumped = False
                last = estimator.last_stamp
                if last is not None and stamp <= last:
                    self._publish_event(estimator.clock_jump_event(stamp))
            estimates = estimator.add_wrench(stamp, force)
            presses = self._calibration.collector
            run.watch.add(stamp, frame, not estimates)
            for estimate in estimates:
                run.watch.see(estimate.stamp_ns, estimate.normal_force, estimate.lateral_force)
                run.area_watch.see_force(
                    estimate.stamp_ns, estimate.normal_force, estimate.in_contact
                )
                if presses.collecting:
                    presses.add_force(estimate.stamp_ns, estimate.normal_force)
                texts = frame, estimate.parameter_set
                self._state_publisher.publish(self._pack_state(texts, state_numbers(estimate)))
                now = time.time_ns()
                run.latency.add(now - received)
                run.age.add(now - stamp)
                run.last = estimate
                run.flags |= estimate.flags
                if estimate.flags & StateFlag.TIME_RESET:
                    self._readings.clear()  # those of this time come anew, as in a loop of a bag
                self.health.sample()
            # Of two estimates the first is of the sample before, which had waited.
            samples = (run.before, (force, torque))
            run.before = samples[1]
            left = list(zip(estimates, samples[-len(estimates) :]))
        return partial(self._publish_slip_and_shape, left, frame) if left else None

    def _publish_slip_and_shape(
        self, left: list[tuple[ContactEstimate, tuple[Vector, Vector]]], frame: str
    ) -> None:
        """Slip, and ellipse and tilt where they are wanted, of estimates with their samples."""
        with self._lock:
            run = self._running
            if run is None:
                return
            for estimate, sample in left:
                slip, shape = run.slip_and_shape.process(estimate, *sample)
                if slip is not None and self._slip_listeners.present():
                    numbers = slip_numbers(slip, run.slip_and_shape.lateral_axes)
                    self._slip_publisher.publish(self._pack_slip((frame,), numbers))
                if shape is not None:
                    self._model_diagnostics.see_shape(shape)
                    plate = plate_frame(run.plate, frame)
                    packed = self._pack_shape((plate,), shape_numbers(shape))
                    self._shape_publisher.publish(packed)

    def _on_area(self, message: ContactArea) -> None:
        with self._lock:
            run = self._running
            if run is None:
                return
            run.area_received, run.plate = True, message.header.frame_id
            area = area_of(message)
            left_out = bool(area[3] & run.estimator.settings.rejected_area_flags)
            self._model_diagnostics.see_area(*area[1:3], area[1] != 0.0 and not left_out)
            if self._calibration.collector.collecting:
                self._calibration.collector.add_area(*area)
            used = run.estimator.add_area(*area, live=True)
            silent = self._force_is_silent(run)
            if not silent:
                self._model_diagnostics.late["late_areas"].add(not used, self._behind(run, area[0]))
            if used:
                if not left_out or area[3] & AreaFlag.NO_CONTACT:
                    run.area_watch.see_area(area[0], 0.0 if left_out else area[1])
                outline = outline_of(message)
                self._check_outline(outline)
                run.slip_and_shape.see_area(area[0], stick_of(message), outline)
            elif silent and 0.0 < -self._behind(run, area[0]) < self._silence(run) + FUTURE:
                # One event for all of a pause, when it ends; not with a stamp of another time.
                ends = area[0], *(run.pause or ())
                run.pause = min(ends), max(ends)
            else:
                self._publish_event(run.estimator.note_late(areas=[area[0]]))

    def _check_outline(self, outline: MeasuredOutline) -> None:
        """Report an outline that contact_shape leaves out because it cannot be a finger's."""
        if not self.values["contact_shape"] or not outline.known:
            return
        wrong = outline.implausible
        sentence = f"contact_area has an outline that is no finger's ({wrong}); left out: give "
        sentence += "centroid, ellipse and their deviations in metres of the plate and radians"
        self._model_diagnostics.warn_while(bool(wrong), "bad_outline", sentence)

    @staticmethod
    def _silence(run: Run) -> float:
        """s since the newest sample."""
        return time.monotonic() - run.sampled_at

    def _force_is_silent(self, run: Run) -> bool:
        """Whether no sample came for so long that a stamp ahead of the newest tells nothing."""
        return self._silence(run) > 0.5 * FUTURE

    @staticmethod
    def _behind(run: Run, stamp: int) -> float:
        """s by which a stamp is behind the newest force's."""
        newest = run.estimator.last_stamp
        return 0.0 if newest is None else seconds(newest - stamp)

    def _on_moisture(self, message: Moisture) -> None:
        with self._lock:
            self._model_diagnostics.probed = True
            reading = moisture_of(message)
            if reading in self._readings:
                return  # it came on both subscriptions
            self._readings.append(reading)
            if not is_moisture(reading[1]):
                sentence = f"moisture reading {reading[1]} is outside {MOISTURE_TEXT}; left out"
                self.log_fault(self.inputs, "bad_moisture", sentence, WARN)
                return
            self.inputs.recovered("bad_moisture")
            self._reading = reading
            run = self._running
            if run is None:
                return
            estimator = run.estimator
            if self._calibration.collector.collecting:
                self._calibration.collector.add_moisture(reading[1])
            before = 0.0 if run.first_stamp is None else seconds(run.first_stamp - reading[0])
            if estimator.moisture is None and 0.0 < before < self.values["moisture_stale_after"]:
                # Kept for late joiners, but it came after the first force.
                self._begin_anew(run, estimator.model, estimator.parameter_sets)
            elif not estimator.add_moisture(*reading, live=not self._force_is_silent(run)):
                self._model_diagnostics.late["late_moistures"].add(
                    True, self._behind(run, reading[0])
                )
                self._publish_event(estimator.note_late(moistures=[reading[0]]))
            elif self._preparation is None or not self._preparation.is_alive():
                # Within `fusion_delay`, before the sample at which it enters.
                self._preparation = self._aside(estimator.prepare_moisture, reading[1])

    # Subjects --------------------------------------------------------------------------------

    def _on_trial(self, message: Trial) -> None:
        """Another subject or finger: its own parameters, and nothing learned of the one before."""
        with self._lock:
            finger = known_finger(message.header.frame_id)
            if message.subject and (message.subject, finger) != (self._subject, self._finger):
                if self._subject:
                    self._reading = None
                reason = (ANOTHER_SUBJECT if self._subject else "subject ") + message.subject
                reason += f", {finger}" if finger else ""
                self._subject, self._finger = message.subject, finger
                if self.active:
                    self._use_sets(self._own_sets(), reason, forget=True)
            run = self._running
            if run is None:
                return
            assert self._sets is not None
            rejected = run.estimator.settings.rejected_area_flags
            self._calibration.collector.rejected_flags = rejected
            self._calibration.hear(message, self._sets)

    def _own_sets(self) -> ParameterSets:
        """Those of the subject's finger, or else those of `parameter_file`."""
        assert self._files is not None and self._sets is not None
        try:
            sets = self._files.of_subject(self._subject, self._finger)
        except FingerError as error:
            self.log_fault(self.inputs, "subject_file", f"{one_line(error)}; left out", WARN)
            return self._sets
        self.inputs.recovered("subject_file")
        return sets or self._sets

    def _use_sets(self, sets: ParameterSets, reason: str, forget: bool) -> None:
        """Parameters from the next sample on; the caller holds the lock."""
        run, files = self._run, self._files
        assert run is not None and files is not None
        model = files.model_of(sets)
        sets = sets.of_finger(model.geometry)
        if run.first_stamp is None or model.hash != run.estimator.model.hash:
            # A finger of other lengths begins anew.
            self._begin_anew(run, model, sets, reason)
        else:
            if sets.hash != run.estimator.parameter_sets.hash:
                self._publish_event(run.estimator.change_parameters(sets, reason))
            if forget:
                self._publish_event(run.estimator.reset(reason))
            run.slip_and_shape.keep_up()
        # Samples go on meanwhile; a reading that comes before the end has to wait for its own part.
        self._aside(prepare, model, sets)

    @staticmethod
    def _aside(compute: Callable[..., None], *values: Any) -> threading.Thread:
        """Compute in a thread of its own what is only to be ready when it is needed."""

        def work() -> None:
            with _one_aside:
                compute(*values)

        thread = threading.Thread(target=work, name="prepare", daemon=True)
        thread.start()
        return thread

    def _begin_anew(
        self, run: Run, model: ReducedModel, sets: ParameterSets, reason: str = "start"
    ) -> None:
        """A finger that was not seen before, with the reading there is, from the next sample on,
        whose event names sets and model; the caller holds the lock."""
        assert self._files is not None
        settings = self.settings(EstimatorSettings)
        estimator = ContactEstimator(model, sets, settings, self._files.stated)
        estimator.go_on_from(run.estimator)
        if self._reading is not None:
            estimator.add_moisture(*self._reading)
        if model.hash != run.estimator.model.hash:
            self._tell_model(estimator)
        run.begin_anew(estimator, reason)

    def _fit_subject(
        self,
        sets: ParameterSets,
        presses: list[CalibrationPress],
        moisture: float | None,
        calipers: GeometryEstimate | None,
    ) -> Calibration:
        run, files = self._run, self._files
        assert files is not None
        pose = None if run is None else run.estimator.pose_correction
        settings = self.settings(EstimatorSettings)
        model = files.model_of(sets)
        return fit_subject(model, sets, presses, moisture, settings, calipers, pose)

    def _use_calibration(self, subject: str, finger: str, sets: ParameterSets) -> None:
        with self._lock:
            if self.active and (self._subject, self._finger) == (subject, finger):
                self._use_sets(sets, f"calibration of subject {subject}", forget=False)

    def _on_jump(self, jump: Any) -> None:
        if self._run is not None:
            self._run.jumped = True
        self._readings.clear()

    def _publish_event(self, event: EstimatorEvent) -> None:
        fields = event_fields(event, self._sequence)
        self._sequence += 1
        self._event_publisher.publish(message_of(ModelEvent, fields))

    # Services --------------------------------------------------------------------------------

    def _answer(self, response: Any, request: Callable[[ContactEstimator], None]) -> Any:
        """Carry out a service request; errors become the response's message."""
        run = self._running
        if run is None:
            response.success, response.message = False, "the node is not active; activate it first"
            return response
        try:
            with self._lock:
                request(run.estimator)
            response.success = True
        except FingerError as error:
            response.success, response.message = False, one_line(error)
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def reset(estimator: ContactEstimator) -> None:
            self._publish_event(estimator.reset("service ~/reset"))
            response.message = "reset to a finger at rest that was not seen before"

        return self._answer(response, reset)

    def _on_new_surface(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def forget(estimator: ContactEstimator) -> None:
            self._publish_event(estimator.change_surface("service ~/new_surface"))
            response.message = "what was learned of friction is forgotten; the finger stays"

        return self._answer(response, forget)

    def _on_force_for_area(self, request: Any, response: Any) -> Any:
        def answer(estimator: ContactEstimator) -> None:
            response.force = estimator.force_for_area(request.area, request.horizon)

        return self._answer(response, answer)

    def _on_predict(self, request: Any, response: Any) -> Any:
        def answer(estimator: ContactEstimator) -> None:
            history = estimator.predict(np.array(request.time), np.array(request.force))
            response.area = history.area.tolist()
            response.indentation = history.indentation.tolist()

        return self._answer(response, answer)

    # Diagnostics -----------------------------------------------------------------------------

    def publish_diagnostics(self) -> None:
        """Warnings of the estimates' flags; counters and latency as notes."""
        run = self._running
        if run is not None:
            assert self._files is not None
            self._model_diagnostics.tell(run, self._files.origin(run.estimator, self._subject))
            # A force node of this process may have come or gone.
            self._follow_wrench()
        super().publish_diagnostics()


def _sample_of(
    message: WrenchStamped, info: dict[str, int]
) -> tuple[int, Vector, str, int, Vector]:
    """Stamp, force, frame, time of receipt and torque of a message and what the middleware adds."""
    return (
        *wrench_of(message),
        message.header.frame_id,
        info["received_timestamp"],
        torque_of(message),
    )


main = main_of(ModelNode)

if __name__ == "__main__":
    main()
