# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The model node over DDS: what it publishes, services, run-time parameters, lifecycle, time."""

from __future__ import annotations

import itertools
import math
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from model_node_peer import RELIABLE, ModelNodePeer  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from finger_common.diagnostics import Health  # noqa: E402
from finger_common.flags import AreaFlag, StateFlag  # noqa: E402
from finger_common.node import LATCHED_QOS, FixedMessage  # noqa: E402
from finger_model.estimator import (  # noqa: E402
    ContactEstimate,
    ContactEstimator,
    EstimateBlock,
    replay,
)
from finger_model.estimator.estimate import ESTIMATE_DTYPE, ESTIMATE_FIELDS  # noqa: E402
from finger_model.estimator.estimator import FUTURE  # noqa: E402
from finger_model.finger import load_reduced  # noqa: E402
from finger_model.geometry import Geometry  # noqa: E402
from finger_model.messages import (  # noqa: E402
    area_of,
    event_of,
    moisture_of,
    state_numbers,
    wrench_of,
)
from finger_model.node.model_diagnostics import ModelDiagnostics  # noqa: E402
from finger_model.parameter_sets import ParameterSets  # noqa: E402
from finger_model.shape.estimate import ShapeEstimate  # noqa: E402
from finger_model.shape.estimator import PoseEstimator  # noqa: E402
from finger_model.slip import SlipEstimate, SlipEstimator  # noqa: E402
from finger_model.warm_up import warm_up_all  # noqa: E402
from finger_msgs.msg import (  # noqa: E402
    ContactArea,
    ContactShape,
    ContactSlip,
    ContactState,
    ModelEvent,
    Moisture,
    Trial,
)
from finger_msgs.srv import ForceForArea, PredictContact  # noqa: E402

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


class Bench(ModelNodePeer):
    """Keeps all that the model node publishes."""

    def __init__(self) -> None:
        super().__init__()
        self.states: list[ContactState] = []
        self.diagnostics: dict[str, Any] = {}
        self.said: set[str] = set()
        make = self.node.create_publisher
        self.moisture = make(Moisture, "/finger/moisture", RELIABLE)
        self.clock = make(Clock, "/clock", 10)
        listen = self.node.create_subscription
        listen(ContactState, "/finger/contact_state", self.states.append, RELIABLE)
        listen(DiagnosticArray, "/diagnostics", self._diagnose, 10)

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.split(": ")[-1]
            self.diagnostics[name] = {v.key: v.value for v in status.values}
            self.diagnostics[name]["message"] = status.message
            self.said |= set(status.message.split("; "))

    def connected(self) -> None:
        self.until(lambda: self.wrench.get_subscription_count() > 0)
        self.until(lambda: self.node.count_publishers("/finger/contact_state") > 0)
        self.until(lambda: self.area.get_subscription_count() > 0)
        self.settle()

    def settle(self) -> None:
        """Spin for what is still in transit: discovery, messages without an answer."""
        self.spin()

    def set(self, name: str, value: Any) -> Any:
        """Set a parameter; gives the result."""
        kind = {
            float: (ParameterType.PARAMETER_DOUBLE, "double_value"),
            str: (ParameterType.PARAMETER_STRING, "string_value"),
            bool: (ParameterType.PARAMETER_BOOL, "bool_value"),
        }[type(value)]
        parameter = Parameter(name=name, value=ParameterValue(type=kind[0], **{kind[1]: value}))
        request = SetParameters.Request(parameters=[parameter])
        return self.call(SetParameters, "/finger/model/set_parameters", request).results[0]

    def change(self, transition: int) -> bool:
        request = ChangeState.Request()
        request.transition.id = transition
        return self.call(ChangeState, "/finger/model/change_state", request).success

    def press(self, stamp: int, normal: float, torque: float = 0.0) -> WrenchStamped:
        message = WrenchStamped()
        message.header.stamp = to_time(stamp)
        message.header.frame_id = "sensor"
        message.wrench.force.z, message.wrench.torque.x = -normal, torque
        self.wrench.publish(message)
        return message

    def answered(self, number: int) -> None:
        self.until(lambda: len(self.states) >= number)


def to_time(stamp: int) -> Time:
    return Time(sec=stamp // 10**9, nanosec=stamp % 10**9)


@pytest.fixture
def bench(ros_domain: int) -> Iterator[Bench]:
    with Bench() as bench:
        yield bench


def start(process: Callable[..., Any], *parameters: str) -> Any:
    arguments = ["-m", "finger_model.model_node", "--ros-args", "-r", "__ns:=/finger"]
    for parameter in ("qos_reliability:=reliable", "qos_depth:=5000", *parameters):
        arguments += ["-p", parameter]
    return process(*arguments)


def numbers(state: ContactState) -> list[Any]:
    """All fields of a ContactState, NaN equal to NaN."""
    names = [n for n in state.get_fields_and_field_types() if n not in ("header", "onset")]
    stamps = [state.header.stamp.sec, state.header.stamp.nanosec, state.onset.sec]
    return [repr(getattr(state, n)) for n in names] + stamps + [state.onset.nanosec]


def test_what_it_publishes_is_what_a_replay_of_its_inputs_gives(
    bench: Bench, process: Callable[..., Any], tmp_path: Path
) -> None:
    start(process)
    bench.connected()
    wrenches, areas, moistures = [], [], []
    rng = np.random.default_rng(0)
    stamp = T0
    for n in range(1500):
        stamp += int(rng.integers(1, 4)) * MS
        normal = 1.3 * max(0.0, math.sin(n / 120))
        wrenches.append(bench.press(stamp, normal))
        if n % 40 == 20:
            message = ContactArea()
            lag = 400 if n == 1020 else 40
            message.header.stamp = to_time(stamp - lag * MS)
            message.gross_area, message.area_stddev = 45e-6 * normal**0.7, 1e-6
            message.flags = 0 if normal > 0.1 else int(AreaFlag.NO_CONTACT)
            bench.answered(n + 1)
            bench.area.publish(message)
            areas.append(message)
            if n == 60:
                # This one is in time also on a busy machine; others may be late.
                bench.settle()
        if n == 300:
            reading = Moisture(value=90.0)
            reading.header.stamp = to_time(stamp)
            bench.moisture.publish(reading)
            moistures.append(reading)
        if n in (500, 700, 900):
            bench.answered(n + 1)
            if n == 500:
                assert bench.set("drift_sd", 0.05).successful
            elif n == 700:
                reply = bench.call(Trigger, "/finger/model/reset", Trigger.Request())
                assert reply.success
            else:
                sets = ParameterSets.default().sets[:2]
                ParameterSets(sets).save(tmp_path / "fitted.yaml")
                assert bench.set("parameter_file", str(tmp_path / "fitted.yaml")).successful
    bench.answered(1500)
    bench.until(lambda: len(bench.events) >= 5)
    bench.settle()
    assert [e.sequence for e in bench.events] == list(range(len(bench.events)))
    assert any(s.flags & StateFlag.AREA_LATE for s in bench.states)
    assert any(s.measured_area_age < 0.2 for s in bench.states)
    assert all(s.header.frame_id == "sensor" for s in bench.states)

    estimator = ContactEstimator(load_reduced())
    received = [wrench_of(m) for m in wrenches]
    block = (np.array([s for s, _ in received]), np.array([f for _, f in received]))
    again = replay(
        estimator,
        [block],
        [area_of(m) for m in areas],
        [moisture_of(m) for m in moistures],
        [event_of(m) for m in bench.events],
    )
    replayed = []
    for estimate in (e for b in again for e in b):
        replayed.append(numbers(serialized(estimate)))
    assert replayed == [numbers(s) for s in bench.states]


def test_one_stamp_of_another_time_is_flagged_and_changes_nothing(
    bench: Bench, process: Callable[..., Any]
) -> None:
    """Of force, area and reading: an hour ahead, and in 1970."""
    start(process)
    bench.connected()
    bench.until(lambda: bench.moisture.get_subscription_count() > 0)
    reference = ContactEstimator(load_reduced())
    sent, expected = 0, []

    def press(number: int) -> None:
        nonlocal sent
        for _ in range(number):
            stamp, normal = T0 + 2 * sent * MS, max(0.0, 1.2 * math.sin(sent / 150))
            bench.press(stamp, normal)
            expected.extend(reference.add_wrench(stamp, (0.0, 0.0, -normal)))
            sent += 1
        bench.answered(sent)

    press(100)
    # A camera with a clock of its own: its areas are left out, and diagnostics name the cause.
    for shift, text in ((-5_000, "5 s behind the force"), (3_600_000, "3600 s ahead of the force")):
        known = len(bench.events)
        press(1)
        for k in range(3):
            area = ContactArea(gross_area=3e-4, area_stddev=1e-6)
            area.header.stamp = to_time(T0 + 2 * sent * MS + shift * MS + k)
            bench.area.publish(area)
        bench.until(lambda known=known: len(bench.events) == known + 3)
        bench.until(
            lambda text=text: text in bench.diagnostics.get("inputs", {"message": ""})["message"]
        )
    bench.until(lambda: "left out" not in bench.diagnostics["inputs"]["message"])
    press(1)
    for wrong in (T0 + 3600 * 10**9, 5 * 10**9):
        for publisher, message, flag in (
            (bench.wrench, None, StateFlag.OUT_OF_ORDER),
            (bench.area, ContactArea(gross_area=3e-4, area_stddev=1e-6), StateFlag.AREA_LATE),
            (bench.moisture, Moisture(value=10.0), StateFlag.MOISTURE_LATE),
        ):
            known = len(bench.events)
            press(1)
            if message is None:
                bench.press(wrong, 0.9)
            else:
                message.header.stamp = to_time(wrong)
                publisher.publish(message)
                bench.until(lambda known=known: len(bench.events) > known)
            press(50)
            assert [bool(s.flags & flag) for s in bench.states[-50:]] == [True] + [False] * 49
    # The next area and the next reading of the right time are used.
    area = ContactArea(gross_area=30e-6, area_stddev=1e-6)
    area.header.stamp = to_time(T0 + 2 * sent * MS)
    reading = Moisture(value=50.0)
    reading.header.stamp = area.header.stamp
    for publisher, message in ((bench.area, area), (bench.moisture, reading)):
        publisher.publish(message)
        # Behind it one from 1970: its event tells that both have come.
        known = len(bench.events)
        message = type(message)()
        message.header.stamp = to_time(6 * 10**9)
        publisher.publish(message)
        bench.until(lambda known=known: len(bench.events) > known)
    reference.add_area(*area_of(area))
    reference.add_moisture(*moisture_of(reading))
    press(100)
    assert [s.area for s in bench.states] == [e.area for e in expected]
    assert bench.states[-1].moisture == 50.0
    assert any(s.measured_area == 30e-6 for s in bench.states)


def test_no_message_ends_the_node_and_each_is_forgotten(
    bench: Bench, process: Callable[..., Any]
) -> None:
    child = start(process)
    bench.connected()
    bench.until(lambda: bench.moisture.get_subscription_count() > 0)
    reference = ContactEstimator(load_reduced())
    sent = 0

    def press(number: int) -> list[tuple[ContactState, ContactEstimate]]:
        """Samples of a press of 2 s every 4 s, beside what an untroubled estimator makes of it."""
        nonlocal sent
        expected = []
        for _ in range(number):
            phase = (0.005 * sent) % 4.0
            normal = max(0.0, math.sin(math.pi * phase / 2.0)) if phase < 2.0 else 0.0
            bench.press(T0 + 5 * sent * MS, normal)
            expected += reference.add_wrench(T0 + 5 * sent * MS, (0.0, 0.0, -normal))
            sent += 1
        known = len(bench.states)
        bench.answered(known + number)
        return list(zip(bench.states[known:], expected))

    # The first sample of all may be the wrong one.
    times = [Time(sec=2**31 - 1, nanosec=2**32 - 1), Time(sec=-(2**31)), Time(nanosec=2**32 - 1)]
    message = WrenchStamped()
    message.header.stamp = times[0]
    bench.wrench.publish(message)
    bench.answered(1)
    press(100)
    odd = [math.nan, math.inf, -math.inf, -1e-6, 0.0, 5e-324, 30.0, 1e300]
    now = to_time(T0 + 5 * sent * MS)
    for stamp in (now, *times):
        for area, sd in itertools.product([*odd, 30e-6], odd):
            if (area, sd) == (30e-6, 5e-324):
                continue  # taken for an area known to 0.1 %
            message = ContactArea(gross_area=area, area_stddev=sd)
            message.header.stamp = stamp
            bench.area.publish(message)
        for value in (v for v in odd if not 0.0 <= v <= 30.0):  # those are as good as any
            message = Moisture(value=value)
            message.header.stamp = stamp
            bench.moisture.publish(message)
    for stamp in times:
        message = WrenchStamped()
        message.header.stamp = stamp
        message.wrench.force.z = -0.9
        bench.wrench.publish(message)
        for k in range(3):
            # Two samples of another time in a row would begin that time.
            press(20 if k == 0 else 1)
    bench.settle()
    for force in ((0.0, 0.0, -1e300), (1e300, 0.0, -0.5), (0.0, math.nan, -0.5)):
        message = WrenchStamped()
        message.header.stamp = to_time(T0 + 5 * sent * MS)
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
        bench.wrench.publish(message)
        known = len(bench.states)
        bench.answered(known + 1)
        reference.add_wrench(T0 + 5 * sent * MS, (0.0, 0.0, 0.0))
        sent += 1
        state = bench.states[-1]
        assert state.flags & (StateFlag.FORCE_INVALID | StateFlag.FORCE_OUT_OF_RANGE)
        assert not state.area > 1e-3
    press(2 * 800 - sent)  # the pad is at rest again
    # A flag of one sample is told, too.
    bench.until(lambda: "the force is not a finite number" in bench.said)
    for state, estimate in press(800):
        assert not state.flags & (StateFlag.FORCE_INVALID | StateFlag.FORCE_OFFSET)
        assert state.area == pytest.approx(estimate.area, rel=0.02, abs=1e-7)
    assert child.poll() is None


def test_what_is_wrong_with_an_input_is_named_in_diagnostics(
    bench: Bench, process: Callable[..., Any]
) -> None:
    child = start(process, "contact_shape:=true")
    bench.connected()

    def says(health: str, words: str) -> None:
        bench.until(lambda: words in bench.diagnostics.get(health, {}).get("message", ""))

    for _ in range(100):
        bench.press(0, 1.0)
    says("contact state", "wrench messages a second arrive, all stamped 0")

    # An outline of another unit, and one whose square no number holds.
    for n in range(200):
        bench.press(T0 + 2 * n * MS, 1.0)
    bench.answered(200)
    for n, x in enumerate((1e-3, 640.0, 1e-3, 1e200)):
        stamp = T0 + (450 + 100 * n) * MS
        area = ContactArea(gross_area=40e-6, area_stddev=1e-6)
        area.header.stamp = to_time(stamp)
        area.centroid.x, area.ellipse_major, area.ellipse_minor = x, 8e-3, 7e-3
        area.centroid_stddev = area.ellipse_major_stddev = area.ellipse_minor_stddev = 1e-4
        bench.area.publish(area)
        if x > 1.0:
            says("inputs", f"an outline that is no finger's (center {x:.3g} m); left out")
        else:
            bench.settle()
            bench.diagnostics.clear()
            bench.until(lambda: "inputs" in bench.diagnostics)
            assert "outline" not in bench.diagnostics["inputs"]["message"]
    for n in range(200, 400):
        bench.press(T0 + 5 * n * MS, 1.0)
    bench.answered(400)

    # A torque in N mm, and in N m: 2 mm beside the sensor's origin.
    stamps = itertools.count(T0 + 2000 * MS, 5 * MS)

    def told(torque: float) -> bool:
        for _ in range(20):
            bench.press(next(stamps), 1.0, torque)
        wrong = "by its torque the force acts 2e+03 mm beside the contact's centre"
        message = str(bench.diagnostics["inputs"]["message"])
        return wrong in message and "publish the torque in N m about" in message

    bench.until(lambda: told(2.0))
    bench.until(lambda: not told(2e-3))

    # Another normal axis.
    assert bench.set("normal_axis", "+x").successful
    for _ in range(600):
        bench.press(next(stamps), 1.0)
    says("contact state", "a force of 1.00 N lies across normal_axis (+x), 0.00 N along it")

    other = rclpy.create_node("other_driver")
    publisher = other.create_publisher(WrenchStamped, "/finger/wrench", RELIABLE)
    says(
        "contact state",
        "/finger/wrench is published by /other_driver and /peer: this node mixes them",
    )
    other.destroy_publisher(publisher)
    bench.diagnostics.clear()
    bench.until(
        lambda: (
            "is published by" not in bench.diagnostics["contact state"]["message"]
            if "contact state" in bench.diagnostics
            else False
        )
    )
    other.destroy_node()
    assert child.poll() is None


def test_samples_that_are_lost_on_their_way_to_it_are_named_in_diagnostics(
    bench: Bench, process: Callable[..., Any]
) -> None:
    """They come faster than the node takes them, which keeps one."""
    start(process, "qos_reliability:=best_effort", "qos_depth:=1")
    bench.connected()
    stamps = itertools.count(T0, MS)

    def lost() -> bool:
        for _ in range(100):
            bench.press(next(stamps), 0.0)
        return any("samples per second come through" in said for said in bench.said)

    bench.until(lost)
    bench.until(lambda: int(bench.diagnostics["contact state"].get("lost", 0)) > 0)


def test_a_trial_that_is_not_latched_is_named_in_diagnostics(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process)
    volatile = bench.node.create_publisher(Trial, "/finger/trial", RELIABLE)

    def said() -> str:
        return str(bench.diagnostics.get("contact state", {"message": ""})["message"])

    bench.until(lambda: "publisher of 'trial' has another durability" in said())
    assert "publish it transient local" in said()
    bench.node.destroy_publisher(volatile)
    bench.until(lambda: "'trial'" not in said())


def test_services_and_parameters_answer_and_refuse_with_a_reason(
    bench: Bench, process: Callable[..., Any], tmp_path: Path
) -> None:
    start(process)
    bench.connected()
    for n in range(200):
        bench.press(T0 + 2 * n * MS, 0.5)
    bench.answered(200)
    name = "/finger/model/force_for_area"
    reply = bench.call(ForceForArea, name, ForceForArea.Request(area=40e-6, horizon=0.0))
    assert reply.success
    time_ahead, force = [0.001], [reply.force]
    ahead = bench.call(
        PredictContact,
        "/finger/model/predict",
        PredictContact.Request(time=time_ahead, force=force),
    )
    assert ahead.area[0] == pytest.approx(40e-6, rel=0.01)
    refused = bench.call(ForceForArea, name, ForceForArea.Request(area=1.0))
    assert not refused.success and "beyond" in refused.message
    refused = bench.call(
        PredictContact, "/finger/model/predict", PredictContact.Request(time=[1.0], force=[99.0])
    )
    assert not refused.success and "limit" in refused.message

    for parameter, value, named in (
        ("fusion_delay", 5.0, "fusion_delay"),
        ("liftoff_force", 0.5, "onset_force"),
        ("normal_axis", "up", "normal_axis"),
        ("wrench_topic", "other", "before the node is configured"),
        ("parameter_file", str(tmp_path / "none.yaml"), "none.yaml"),
    ):
        result = bench.set(parameter, value)
        assert not result.successful
        assert named in result.reason
    assert bench.set("normal_axis", "+z").successful
    bench.press(T0 + 1000 * MS, -0.7)
    bench.answered(201)
    assert bench.states[-1].normal_force == 0.7
    found = bench.diagnostics
    stamps = itertools.count(T0 + 1002 * MS, 2 * MS)

    def latency_reported() -> bool:
        # Of the samples since the report before: some must come in every second.
        bench.press(next(stamps), -0.7)
        return found.get("contact state", {}).get("latency_p99_ms", "nan") != "nan"

    bench.until(latency_reported)
    assert found["contact state"]["age_p99_ms"] == "> 100", "the stamps are years old"
    bench.until(lambda: "no sample" in found.get("contact state", {}).get("message", ""))
    assert "moisture" in found["inputs"]["message"]


def test_files_that_name_two_fingers_are_refused_and_the_one_in_use_is_told(
    bench: Bench, process: Callable[..., Any], tmp_path: Path
) -> None:
    shipped = ParameterSets.default()
    assert shipped.prior is not None
    thin, subject = Geometry(pad_semi_axis_radial=8e-3), Geometry(pad_semi_axis_radial=8.2e-3)
    geometry_file, fit = tmp_path / "thin.yaml", tmp_path / "fit.yaml"
    geometry_file.write_text(yaml.safe_dump(thin.to_dict()))
    for file in (fit, tmp_path / "S01.yaml"):
        shipped.with_prior(shipped.prior, subject).save(file)
    files = f"geometry_file:={geometry_file}", f"parameter_file:={fit}"
    child = start(process, *files)
    said = f"fit.yaml: holds the lengths of another finger ({subject.hash()[:8]}) than "
    bench.until(lambda: said in child.output.read_text())
    child.terminate()
    child.wait()

    child = start(process, files[0], f"subjects_folder:={tmp_path}")
    bench.connected()
    model = load_reduced("", thin)
    assert f"{model.hash[:8]} of law '{model.law.name}', lengths of {geometry_file}" in (
        child.output.read_text()
    )
    result = bench.set("parameter_file", str(fit))
    assert not result.successful and "thin.yaml" in result.reason
    # The same finger by both files, then a subject's own.
    shipped.with_prior(shipped.prior, thin).save(fit)
    assert bench.set("parameter_file", str(fit)).successful
    bench.press(T0, 0.5)
    bench.answered(1)
    bench.until(lambda: bench.events and bench.events[-1].model_hash == model.hash)
    trials = bench.node.create_publisher(Trial, "/finger/trial", LATCHED_QOS)
    trials.publish(Trial(subject="S01", session="S01_a"))
    own = load_reduced("", subject).hash
    bench.until(
        lambda: bench.diagnostics.get("contact state", {}).get("model", "").startswith(own[:8])
    )
    assert "S01.yaml" in bench.diagnostics["contact state"]["model"]
    bench.press(T0 + 2 * MS, 0.5)
    bench.answered(2)
    bench.until(lambda: bench.events[-1].model_hash == own)


def test_each_finger_of_a_subject_has_parameters_of_its_own(
    bench: Bench, process: Callable[..., Any], tmp_path: Path
) -> None:
    shipped = ParameterSets.default()
    index = ParameterSets(shipped.sets[:1])
    index.save(tmp_path / "S01.right_index.yaml")
    child = start(process, f"subjects_folder:={tmp_path}")
    bench.connected()
    trials = bench.node.create_publisher(Trial, "/finger/trial", LATCHED_QOS)
    bench.press(T0, 0.5)
    bench.answered(1)
    fingers = ("right_index", index), ("left_thumb", shipped), ("right_index", index)
    for number, (finger, sets) in enumerate(fingers, 1):
        trial = Trial(subject="S01", session=f"S01_{number}")
        trial.header.frame_id = finger
        trials.publish(trial)
        reason = f"{'subject' if number == 1 else 'another subject:'} S01, {finger}"
        bench.until(
            lambda n=number, reason=reason: (
                [e.reason for e in bench.events if e.type == ModelEvent.TYPE_RESET][n - 1 :]
                == [reason]
            )
        )
        bench.press(T0 + 2 * number * MS, 0.5)
        bench.answered(number + 1)
        assert bench.states[-1].parameter_set.startswith(sets.hash[:8])
    said = "subject S01: no parameters of left_thumb, only S01.right_index.yaml; calibrate"
    assert child.output.read_text().count(said) == 1


def test_a_pause_of_the_force_is_one_event_however_many_areas_come_in_it(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process)
    bench.connected()
    bench.press(T0, 0.5)
    bench.answered(1)
    number, told, begun = 0, 0, time.monotonic()

    def send(ahead: float) -> None:
        area = ContactArea(gross_area=3e-5, area_stddev=1e-6)
        area.header.stamp = to_time(T0 + round(ahead * MS))
        bench.area.publish(area)

    def only_one_more() -> bool:
        """Of the areas that come without force, as soon as it counts as silent."""
        nonlocal number, told
        send(2100 + 0.05 * number)
        number += 1
        told, before = len(bench.events), told
        # Events may come later than what they tell of.
        silent = time.monotonic() - begun > FUTURE
        return silent and number > 200 and told == before

    def of_areas(first: int, last: int) -> list[Any]:
        """Events that name areas this long after T0 (ms)."""
        stamps = range(T0 + first * MS, T0 + last * MS + 1)
        events = map(event_of, bench.events)
        return [event for event in events if any(area in stamps for area in event.late_areas)]

    bench.until(only_one_more)
    bench.settle()
    for k in range(50):
        send(2600 + k)
    send(3600_000)  # a stamp of another time is told by itself
    bench.until(lambda: of_areas(3600_000, 3600_000))
    assert not of_areas(2600, 2649)
    # So far ahead one alone is not believed.
    bench.press(T0 + 10_000 * MS, 0.5)
    bench.press(T0 + 10_002 * MS, 0.5)
    bench.answered(3)
    bench.until(lambda: of_areas(2600, 2649))
    (alone,), (pause,) = of_areas(3600_000, 3600_000), of_areas(2600, 2649)
    assert alone.late_areas == (T0 + 3600_000 * MS,) and not alone.is_pause
    assert pause.is_pause and pause.late_areas[1] == T0 + 2649 * MS
    assert bench.states[1].flags & StateFlag.AREA_LATE


def test_parameters_of_a_fit_that_is_not_final_are_reported_while_in_use(
    bench: Bench, process: Callable[..., Any], tmp_path: Path
) -> None:
    shipped = ParameterSets.default()
    doubtful = [replace(entry, status="not final") for entry in shipped.sets]
    file = tmp_path / "parameters.yaml"
    ParameterSets(doubtful, shipped.geometry_hash).save(file)
    child = start(process, f"parameter_file:={file}")
    bench.connected()

    def warns() -> bool:
        bench.diagnostics.clear()
        bench.until(lambda: "inputs" in bench.diagnostics)
        return "from a fit that is not final" in bench.diagnostics["inputs"]["message"]

    bench.until(warns)
    assert "from a fit that is not final" in child.output.read_text()
    assert bench.set("parameter_file", "").successful
    bench.until(lambda: not warns())


def test_a_missing_moisture_reading_is_reported_once_there_is_a_probe(
    bench: Bench, process: Callable[..., Any]
) -> None:
    bench.node.destroy_publisher(bench.moisture)
    start(process)
    bench.connected()
    stamps = itertools.count(T0, 2 * MS)

    def inputs() -> str:
        """What diagnostics say of samples that came since the ones before."""
        for _ in range(2):
            bench.diagnostics.clear()
            while "inputs" not in bench.diagnostics:
                bench.press(next(stamps), 0.0)
                count = len(bench.states)
                bench.answered(count + 1)
        return str(bench.diagnostics["inputs"]["message"])

    assert "moisture" not in inputs()
    assert bench.states[-1].flags & StateFlag.MOISTURE_MISSING
    probe = bench.node.create_publisher(Moisture, "/finger/moisture", RELIABLE)
    bench.until(lambda: "no moisture reading yet" in inputs())
    bench.node.destroy_publisher(probe)
    bench.settle()
    assert "no moisture reading yet" in inputs()


def test_what_is_missing_or_out_of_range_is_reported_where_it_is_expected(
    bench: Bench, process: Callable[..., Any]
) -> None:
    def warns() -> bool:
        return "no area was fused in this contact" in bench.diagnostics["inputs"]["message"]

    def fresh() -> None:
        """Wait for diagnostics of what was sent before."""
        for _ in range(2):
            bench.diagnostics.clear()
            bench.until(lambda: "inputs" in bench.diagnostics)

    start(process, "area_stale_after:=0.3")
    bench.connected()
    # With a reading in use, nothing else is reported of the inputs.
    bench.until(lambda: bench.moisture.get_subscription_count() > 0)
    reading = Moisture(value=50.0)
    reading.header.stamp = to_time(T0 - 500 * MS)
    bench.moisture.publish(reading)
    bench.node.destroy_publisher(bench.area)
    bench.until(lambda: bench.node.count_publishers("/finger/contact_area") == 0)
    for n in range(200):
        bench.press(T0 + 2 * n * MS, 0.5)
    bench.answered(200)
    assert bench.states[-1].flags & StateFlag.AREA_MISSING
    fresh()
    assert not warns()  # a rig without a camera

    def inputs() -> str:
        bench.diagnostics.clear()
        bench.until(lambda: "inputs" in bench.diagnostics)
        return str(bench.diagnostics["inputs"]["message"])

    for value, says in ((-5.0, True), (50.0, False)):  # a slip of the probe, and a good one
        reading = Moisture(value=value)
        reading.header.stamp = to_time(T0 + 330 * MS)
        bench.moisture.publish(reading)
        bench.until(lambda says=says: ("; left out" in inputs()) is says)

    reading = Moisture(value=120.0)
    reading.header.stamp = to_time(T0 + 340 * MS)
    bench.moisture.publish(reading)
    bench.settle()
    bench.press(T0 + 450 * MS, 0.5)
    bench.answered(201)
    bench.until(
        lambda: (
            "moisture 120 is outside the model's range: estimate less certain"
            in bench.diagnostics["inputs"]["message"]
        )
    )

    bench.area = bench.node.create_publisher(ContactArea, "/finger/contact_area", RELIABLE)
    bench.until(warns)  # a vision node that is silent from the onset on
    assert bench.set("fuse_area", False).successful
    fresh()
    assert not warns()
    assert bench.set("fuse_area", True).successful
    bench.until(warns)

    bench.until(lambda: bench.area.get_subscription_count() > 0)
    area = ContactArea(gross_area=25e-6, area_stddev=1e-6)
    area.header.stamp = to_time(T0 + 398 * MS)
    bench.area.publish(area)
    bench.settle()
    bench.press(T0 + 500 * MS, 0.5)
    bench.answered(202)
    assert not bench.states[-1].flags & StateFlag.AREA_MISSING
    fresh()
    assert not warns()

    # The next contact: areas came before, and now there is no publisher any more.
    bench.node.destroy_publisher(bench.area)
    for n in range(200):
        bench.press(T0 + (600 + 2 * n) * MS, 0.0 if n < 10 else 0.5)
    bench.answered(402)
    bench.until(warns)
    bench.press(T0 + 1100 * MS, 0.0)
    bench.answered(403)
    fresh()
    assert not warns()


def test_inputs_that_are_missing_or_cannot_be_used_are_named_with_a_remedy(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process)
    bench.connected()

    def says(name: str, text: str) -> bool:
        return text in bench.diagnostics.get(name, {}).get("message", "")

    nothing, name = "no sample yet (nothing comes on /finger/wrench", bench.node.get_name()
    remedy = f"{nothing} from {name}: check that node and its sensor)"
    bench.until(lambda: says("contact state", remedy))
    bench.press(0, 0.5)
    bench.press(0, 0.5)
    bench.node.destroy_publisher(bench.wrench)
    remedy = "wrench, 0 publishers: check wrench_topic and namespace)"
    bench.until(lambda: says("contact state", remedy))

    nan, m2 = float("nan"), "not that of a fingertip: publish it in m², 30 mm² are 30e-6; left out"
    positive = "publish a positive area_stddev in m²; left out"
    for k, (area, sd, wrong) in enumerate(
        (
            (54.0, 2.0, f"gross_area 54 m², {m2}"),
            (nan, 2e-6, f"gross_area nan m², {m2}"),
            (54e-6, 0.0, f"area_stddev 0 m²: {positive}"),
            (54e-6, nan, f"area_stddev nan m²: {positive}"),
            (54e-6, 2e-6, ""),
        )
    ):
        picture = ContactArea(gross_area=area, area_stddev=sd)
        picture.header.stamp = to_time(T0 + k * MS)
        bench.area.publish(picture)
        if wrong:
            bench.until(lambda wrong=wrong: says("inputs", f"/finger/contact_area has {wrong}"))
    bench.until(lambda: not says("inputs", "contact_area has"))


def test_a_force_that_is_no_fingers_or_that_areas_do_not_share_is_named(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process)
    bench.connected()

    def says(text: str) -> bool:
        return text in bench.diagnostics.get("inputs", {}).get("message", "")

    def pressed(first: int, force: float) -> None:
        """3 s with an area each 0.1 s."""
        count = len(bench.states)
        for n in range(first, first + 3000, 10):
            if n % 100 == 0:
                area = ContactArea(gross_area=54e-6, area_stddev=2e-6)
                area.header.stamp = to_time(T0 + n * MS)
                bench.area.publish(area)
                bench.until(lambda n=n: len(bench.states) >= count + (n - first) // 10)
            bench.press(T0 + n * MS, force)
        bench.answered(count + 300)

    pressed(0, 0.001)
    bench.until(lambda: says("contact_area has shown a contact for 3 s, of 54 mm²"))
    assert says("and the force none (0.001 N now): check sensor, its unit (N)")
    stamps = itertools.count(T0 + 3000 * MS, 10 * MS)
    for force, text in (
        (4.0, "a force of 4 N is beyond the 3 N that the reduced model was built for: press less"),
        (400.0, "a force of 400 N is no finger's: publish the wrench in N"),
    ):
        for _ in range(5):
            bench.press(next(stamps), force)
        bench.until(lambda text=text: any(said.startswith(text) for said in bench.said))
    assert not says("the force none")


@pytest.mark.parametrize("other", [(0.0, 0.0), (54e-6, 2e-6)], ids=["empty", "good"])
def test_areas_that_cannot_be_used_now_and_then_are_logged_once(
    other: tuple[float, float],
) -> None:
    """The warning goes 2 s after the last of them, also where pictures are empty since."""
    now, logged = [0.0], []
    inputs = Health("inputs", clock=lambda: now[0])

    def log_fault(health: Health, *fault: Any) -> None:
        logged.extend([fault] * health.fault(*fault))

    node: Any = SimpleNamespace(resolve_topic_name=str, log_fault=log_fault)
    diagnostics = ModelDiagnostics(node, Health("contact state"), inputs)
    for k in range(200):
        now[0] = 0.1 * k
        area, sd = (54e-6, 0.0) if k % 2 and k < 100 else other
        diagnostics.see_area(area, sd, area > 0.0)
        assert ("bad_area" in inputs.faults) == (1 <= k <= 119)
    assert len(logged) == 1


@pytest.mark.slow
def test_a_first_start_says_that_it_compiles_and_ends_at_ctrl_c(
    ros_domain: int,
    process: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    warm_up_all()
    later = start(process)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    first = start(process)

    def heard(child: Any, words: str) -> None:
        end = time.monotonic() + 120.0
        while words not in child.output.read_text():
            assert child.poll() is None and time.monotonic() < end, child.output.read_text()
            time.sleep(0.1)

    heard(first, "compiling the model for the first time")
    heard(later, "reduced model")
    assert "compiling" not in later.output.read_text()
    first.send_signal(signal.SIGINT)
    assert first.wait(60.0) == 0
    said = first.output.read_text()
    assert "Traceback" not in said and "reduced model" not in said


def test_it_is_silent_until_activated(bench: Bench, process: Callable[..., Any]) -> None:
    start(process, "autostart:=false")
    configure, activate, deactivate, cleanup = 1, 3, 4, 2
    assert bench.change(configure)
    bench.connected()
    bench.press(T0, 0.5)
    reply = bench.call(Trigger, "/finger/model/reset", Trigger.Request())
    assert not reply.success and "activate" in reply.message
    assert bench.states == []
    assert bench.change(activate)
    bench.press(T0 + 2 * MS, 0.5)
    bench.answered(1)
    assert bench.states[0].header.stamp == to_time(T0 + 2 * MS)
    assert bench.change(deactivate)
    assert bench.change(cleanup)
    assert bench.change(configure)


def test_a_clock_that_jumps_back_resets_the_state(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process, "use_sim_time:=true")
    bench.connected()
    bench.clock.publish(Clock(clock=to_time(T0)))
    for n in range(300):
        if n % 50 == 0:
            bench.clock.publish(Clock(clock=to_time(T0 + 2 * n * MS)))
        bench.press(T0 + 2 * n * MS, 1.0)
    bench.answered(300)
    # Back by less than time_reset_after: by the samples alone it would be taken for disorder.
    for _ in range(3):
        bench.clock.publish(Clock(clock=to_time(T0 + 100 * MS)))
        time.sleep(0.05)
    for n in range(50, 60):
        bench.press(T0 + 2 * n * MS, 1.0)
    bench.answered(310)
    first = bench.states[300]
    assert first.flags & StateFlag.TIME_RESET
    assert first.header.stamp == to_time(T0 + 100 * MS)
    assert first.model_area == bench.states[0].model_area
    assert bench.states[299].model_area > first.model_area
    bench.until(lambda: any("jumped" in e.reason for e in bench.events))
    bench.until(lambda: bench.diagnostics.get("contact state", {}).get("age_p99_ms") == "unknown")
    # The recorded event makes a replay do the same.
    again = ContactEstimator(load_reduced())
    stamps = [*range(300), *range(50, 60)]
    block = (
        np.array([T0 + 2 * n * MS for n in stamps]),
        np.array([[0.0, 0.0, -1.0]] * len(stamps)),
    )
    events = [event_of(e) for e in bench.events]
    flags = [e.flags for b in replay(again, [block], events=events) for e in b]
    assert flags == [s.flags for s in bench.states]


def test_a_bag_that_begins_again_has_its_moisture_again(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process)
    bench.connected()
    bench.until(lambda: bench.moisture.get_subscription_count() > 0)
    reading = Moisture(value=50.0)
    reading.header.stamp = to_time(T0 + 100 * MS)
    for turn in (1, 2):
        for n in range(1000):
            if n == 100:
                bench.answered(1000 * (turn - 1) + n)
                bench.moisture.publish(reading)
                bench.settle()
            bench.press(T0 + 2 * n * MS, 0.0)
        bench.answered(1000 * turn)
        assert bench.states[-1].moisture == 50.0, turn
    assert any(state.flags & StateFlag.TIME_RESET for state in bench.states)


def test_estimates_have_the_fields_of_the_message_in_its_order() -> None:
    described = [
        ("std_msgs/Header", "header")
        if field.message == "header.stamp"
        else (
            {"time": "builtin_interfaces/Time", "bool": "boolean", "float64": "double"}.get(
                field.type, field.type
            ),
            field.message,
        )
        for field in ESTIMATE_FIELDS
    ]
    of_message = ContactState.get_fields_and_field_types()
    assert described == [(kind, name) for name, kind in of_message.items()]
    assert ESTIMATE_DTYPE.names == ContactEstimate._fields == tuple(f.name for f in ESTIMATE_FIELDS)


def test_slip_and_shape_have_the_fields_of_their_messages_in_their_order() -> None:
    for estimate, message in ((SlipEstimate, ContactSlip), (ShapeEstimate, ContactShape)):
        names = list(message.get_fields_and_field_types())
        assert names == ["header", *estimate._fields[1:]]


def serialized(estimate: ContactEstimate) -> ContactState:
    """The message as the node publishes it, through its bytes."""
    prototype = ContactState(parameter_set=estimate.parameter_set)
    raw = FixedMessage(prototype).pack(*state_numbers(estimate))
    message: ContactState = deserialize_message(raw, ContactState)
    return message


def test_converters_carry_every_field() -> None:
    row = np.zeros(1, ESTIMATE_DTYPE)
    for number, field in enumerate(ESTIMATE_FIELDS):
        row[field.name] = "x@1" if field.type == "string" else number + 1
    (estimate,) = EstimateBlock(row)
    message = serialized(estimate)
    assert message.header.stamp == to_time(estimate.stamp_ns)
    assert message.onset == to_time(estimate.onset_ns)
    for field in ESTIMATE_FIELDS:
        if field.type != "time":
            assert getattr(message, field.message) == getattr(estimate, field.name)


def test_flags_are_those_of_the_messages() -> None:
    for flag in StateFlag:
        assert getattr(ContactState, f"FLAG_{flag.name}") == flag
    for area_flag in AreaFlag:
        assert getattr(ContactArea, f"FLAG_{area_flag.name}") == area_flag


def slips_heard(bench: Bench) -> list[ContactSlip]:
    """The list into which `contact_slip` comes from now on."""
    slips: list[ContactSlip] = []
    bench.node.create_subscription(ContactSlip, "/finger/contact_slip", slips.append, RELIABLE)
    bench.connected()
    bench.until(lambda: bench.node.count_publishers("/finger/contact_slip") > 0)
    bench.settle()
    return slips


def test_slip_goes_out_where_somebody_listens_as_the_core_has_it(
    bench: Bench, process: Callable[..., Any]
) -> None:
    from finger_model.messages import slip_numbers

    start(process)
    slips = slips_heard(bench)
    estimator, core = ContactEstimator(load_reduced()), SlipEstimator()
    layout = FixedMessage(ContactSlip(header=bench.press(T0, 0.0).header))
    wanted = []
    for n in range(500):
        message = WrenchStamped()
        message.header.frame_id = "sensor"
        stamp = T0 + (n + 1) * 2 * MS
        message.header.stamp = to_time(stamp)
        message.wrench.force.z = -min(1.0, n / 100)
        message.wrench.force.y = 0.3 * max(0.0, n / 250 - 1.0)
        bench.wrench.publish(message)
    forces = [(0.0, 0.0, -0.0)]
    forces += [(0.0, 0.3 * max(0.0, n / 250 - 1.0), -min(1.0, n / 100)) for n in range(500)]
    for n, force in enumerate(forces):
        for estimate in estimator.add_wrench(T0 + n * 2 * MS, force):
            core.assume(estimator.model.geometry, estimator.material)
            wanted.append(slip_numbers(core.add(estimate, force), core.lateral_axes))
    bench.until(lambda: len(slips) >= len(wanted))
    for found, values in zip(slips, wanted):
        assert repr(found) == repr(deserialize_message(layout.pack(*values), ContactSlip))
    assert slips[-1].tangential_force.y == pytest.approx(0.2988)
    assert 0.1 < slips[-1].slip_margin < 0.8
    assert bench.set("friction_prior", 0.9).successful


def test_another_surface_forgets_friction_and_keeps_the_finger(
    bench: Bench, process: Callable[..., Any]
) -> None:
    start(process)
    slips = slips_heard(bench)

    def pull(first: int, ratio: float) -> None:
        for n in range(first, first + 100):
            message = WrenchStamped()
            message.header.stamp = to_time(T0 + n * 2 * MS)
            message.wrench.force.z = -1.0
            message.wrench.force.y = ratio * (n - first) / 100
            bench.wrench.publish(message)
        bench.until(lambda: len(slips) == first + 100)

    bench.press(T0, 0.0)
    pull(1, 0.9)
    assert slips[-1].friction > 0.85 > 1.5 * slips[0].friction
    reply = bench.call(Trigger, "/finger/model/new_surface", Trigger.Request())
    assert reply.success
    pull(101, 0.1)
    assert slips[101].friction == pytest.approx(slips[0].friction, rel=1e-12)
    assert bench.states[-1].onset == bench.states[100].onset
    bench.until(lambda: bench.events[-1].type == ModelEvent.TYPE_SURFACE)


def test_shape_goes_out_where_it_is_wanted_as_the_core_has_it(
    bench: Bench, process: Callable[..., Any]
) -> None:
    from finger_model.estimator import EstimatorSettings
    from finger_model.messages import shape_numbers

    start(process, "contact_shape:=true", "pad_aspect:=1.3", "plate_pitch:=0.2")
    shapes: list[ContactShape] = []
    bench.node.create_subscription(ContactShape, "/finger/contact_shape", shapes.append, RELIABLE)
    bench.connected()
    bench.until(lambda: bench.node.count_publishers("/finger/contact_shape") > 0)
    bench.settle()
    settings = EstimatorSettings(pad_aspect=1.3, plate_pitch=0.2)
    estimator = ContactEstimator(load_reduced(), settings=settings)
    core = PoseEstimator(estimator.pose_correction)
    header = bench.press(T0, 0.0).header
    header.frame_id = "plate"
    layout = FixedMessage(ContactShape(header=header))
    wanted = []
    for n in range(300):
        stamp, force = T0 + n * 2 * MS, (0.0, 0.0, -min(1.0, n / 100))
        torque = (-1e-3 * force[2], 2e-3 * force[2], 0.0)
        if n:
            message = WrenchStamped()
            message.header.frame_id = "sensor"
            message.header.stamp = to_time(stamp)
            message.wrench.force.z = force[2]
            message.wrench.torque.x, message.wrench.torque.y, _ = torque
            bench.wrench.publish(message)
        for estimate in estimator.add_wrench(stamp, force):
            shape = core.add(estimate, force, torque)
            if shape is not None:
                wanted.append(layout.pack(*shape_numbers(shape)))
    assert len(wanted) > 10
    bench.until(lambda: len(shapes) >= len(wanted))
    for found, values in zip(shapes, wanted):
        assert repr(found) == repr(deserialize_message(values, ContactShape))
    assert shapes[-1].semi_axis_major > shapes[-1].semi_axis_minor > 1e-3
    assert abs(shapes[-1].center_of_pressure.x) == pytest.approx(2e-3, rel=0.2)
    area = ContactArea(gross_area=4e-5, area_stddev=1e-6)
    area.header.frame_id, area.header.stamp = "thumb/plate", to_time(stamp)
    bench.area.publish(area)
    bench.settle()
    message.header.stamp = to_time(stamp + 100 * MS)
    bench.wrench.publish(message)
    bench.until(lambda: shapes[-1].header.frame_id == "thumb/plate")
