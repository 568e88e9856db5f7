"""A subject's calibration in the running nodes: the model node alone, and the whole command."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from model_node_peer import RELIABLE, ModelNodePeer  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from finger_bringup.cli import calibration_entries, main, parser  # noqa: E402
from finger_common.guided_presses import CALIBRATION_PRESSES, FITTING  # noqa: E402
from finger_common.node import LATCHED_QOS, STATE_QOS, message_of  # noqa: E402
from finger_common.parameter_values import parameter_fields  # noqa: E402
from finger_common.stamps import fill_time  # noqa: E402
from finger_common.trial_phases import TrialPhase  # noqa: E402
from finger_model.finger_prior import FingerPrior  # noqa: E402
from finger_model.geometry import Geometry  # noqa: E402
from finger_model.parameter_sets import ParameterSets  # noqa: E402
from finger_model.reduced import ReducedModel  # noqa: E402
from finger_msgs.msg import (  # noqa: E402
    ContactArea,
    ContactState,
    ModelEvent,
    SessionStatus,
    Trial,
)
from finger_operator.study_plan import PlanSettings  # noqa: E402
from finger_sim.press import guided_style, plan_press  # noqa: E402

T0 = 1_700_000_000_000_000_000
LARGER = 1.25
"""Areas of the finger over those of the shipped one."""


class Rig(ModelNodePeer):
    """Publishes what the other nodes of a rig would, and keeps what the model node answers."""

    patience = 250.0

    def __init__(self) -> None:
        super().__init__()
        self.states = 0
        self.results: list[DiagnosticStatus] = []
        make, listen = self.node.create_publisher, self.node.create_subscription
        self.trial = make(Trial, "/finger/trial", STATE_QOS)
        self.status = make(SessionStatus, "/finger/protocol/status", STATE_QOS)
        listen(ContactState, "/finger/contact_state", self._count, RELIABLE)
        listen(DiagnosticStatus, "/finger/calibration", self.results.append, LATCHED_QOS)

    def _count(self, message: ContactState) -> None:
        self.states += 1

    def settle(self, seconds: float = 0.5) -> None:
        """Spin for messages that have no answer, once the node has them: the middleware asks it
        for that every 3 s."""
        for publisher in (self.trial, self.status, self.area, self.wrench):
            assert publisher.wait_for_all_acked(Duration(seconds=120))
        self.spin(seconds)

    def say(self, index: int, phase: TrialPhase, subject: str = "S01", note: str = "") -> None:
        name = CALIBRATION_PRESSES[index].name
        message = Trial(session=f"{subject}_a", subject=subject, condition=name, index=index)
        message.phase, message.note = int(phase), note
        self.trial.publish(message)

    def announce(self, *what: Any, **more: Any) -> None:
        """`say`, and the node has it."""
        self.say(*what, **more)
        self.settle()

    def sample(self, stamp: int, force: float) -> None:
        message = WrenchStamped()
        fill_time(message.header.stamp, stamp)
        message.wrench.force.z = -force
        self.wrench.publish(message)

    def press(self, index: int, start: float) -> float:
        """One guided press at 100 Hz from `start` (s) on; gives its end."""
        guided, rng = CALIBRATION_PRESSES[index], np.random.default_rng(index)
        plan = plan_press(rng, style=guided_style(guided), target_force=guided.target_force)
        model = ReducedModel.load()
        parameters = ParameterSets.default().interpolate(69.31).parameters
        at, force = plan.time[::5], plan.force[::5]
        areas = LARGER * model.simulate(parameters, at, force).area
        before = self.states
        for k in range(0, len(at), 10):
            if areas[k] > 0:
                message = ContactArea(gross_area=float(areas[k]), area_stddev=1e-6)
                fill_time(message.header.stamp, T0 + round((start + at[k]) * 1e9))
                self.area.publish(message)
        self.settle()
        for instant, value in zip(at, force):
            self.sample(T0 + round((start + instant) * 1e9), float(value))
        self.until(lambda: self.states >= before + len(at))
        return start + float(at[-1]) + 2.0

    def all_presses(self) -> float:
        """The guided presses, one after the other; gives the end of the last."""
        at = 1.0
        for index in range(len(CALIBRATION_PRESSES)):
            self.say(index, TrialPhase.PREPARE)
            at = self.press(index, at)
            self.say(index, TrialPhase.DONE)
        self.settle()
        return at


@pytest.fixture
def rig(ros_domain: int) -> Iterator[Rig]:
    with Rig() as rig:
        yield rig


def start_model(rig: Rig, process: Callable[..., Any], folder: Path) -> Any:
    child = process(
        *("-m", "finger_model.model_node", "--ros-args", "-r", "__ns:=/finger"),
        *("-p", "qos_reliability:=reliable", "-p", "qos_depth:=5000"),
        *("-p", f"subjects_folder:={folder}", "-p", "gap_limit:=0.1"),
    )
    rig.until(lambda: rig.wrench.get_subscription_count() > 0)
    rig.until(lambda: rig.area.get_subscription_count() > 0)
    rig.until(lambda: rig.trial.get_subscription_count() > 0)
    rig.until(lambda: rig.node.count_publishers("/finger/contact_state") > 0)
    rig.settle()
    rig.sample(T0, 0.0)
    rig.until(lambda: rig.states == 1)
    return child


@pytest.mark.parametrize(
    "calipers",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"finger_width": 0.014, "finger_depth": 0.010},
    ],
)
def test_the_model_node_calibrates_the_subject_of_the_trials(
    rig: Rig, process: Callable[..., Any], tmp_path: Path, calipers: dict[str, float]
) -> None:
    start_model(rig, process, tmp_path)
    at = rig.all_presses()
    if calipers:
        status = {"subject": "S01", "session": "S01_a", "plan": parameter_fields(calipers)}
        rig.status.publish(message_of(SessionStatus, status))
        rig.settle()
    assert not rig.results
    rig.announce(len(CALIBRATION_PRESSES) - 1, TrialPhase.IDLE)
    rig.until(lambda: rig.results)
    (result,) = rig.results
    assert result.level == b"\x00", result.message
    assert (result.name, result.hardware_id) == ("S01", "S01_a")
    values = {item.key: item.value for item in result.values}
    saved = ParameterSets.load(tmp_path / "S01.yaml")
    assert values["file"] == str(tmp_path / "S01.yaml")
    model = ReducedModel.load()
    time_s = np.linspace(0.0, 1.0, 101)
    parameters = ParameterSets.default().interpolate(69.31).parameters
    area = model.simulate(parameters, time_s, np.minimum(time_s / 0.2, 1.0)).area[-1]
    assert float(values["area_at_1N"]) == pytest.approx(1e6 * LARGER * area, rel=0.03)
    # Live without a restart, and in what a bag records of the model.
    rig.sample(T0 + round(at * 1e9), 0.0)
    rig.until(lambda: any(e.parameter_sets == saved.to_yaml() for e in rig.events))
    geometry = saved.geometry
    assert geometry is not None
    if calipers:
        assert "lengths from width 14 mm, depth 10 mm" in result.message
        assert geometry.pad_semi_axis_radial == pytest.approx(0.007)
        assert geometry.pad_semi_axis_axial == pytest.approx(0.005)
        # A finger of other lengths begins anew, with the model of these.
        newest = rig.events[-1]
        assert newest.type == ModelEvent.TYPE_START
        assert newest.model_hash == ReducedModel.load(geometry=geometry).hash
    else:
        assert "without calipers" in result.message
        assert geometry == Geometry()
        assert {e.model_hash for e in rig.events} == {model.hash}


def test_what_cannot_be_kept_is_live_and_says_so(
    rig: Rig, process: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "S01.yaml").mkdir()
    start_model(rig, process, tmp_path)
    at = rig.all_presses()
    rig.announce(len(CALIBRATION_PRESSES) - 1, TrialPhase.IDLE)
    rig.until(lambda: rig.results)
    (result,) = rig.results
    assert result.level == b"\x01"
    assert "area under 1 N" in result.message and "not kept in a file" in result.message
    assert "file" not in {item.key for item in result.values}
    rig.sample(T0 + round(at * 1e9), 0.0)
    rig.until(lambda: any("calibration of subject" in e.reason for e in rig.events))


@pytest.mark.parametrize(
    ("folder", "index", "phase", "note", "said"),
    [
        ("file/subjects", 0, TrialPhase.PREPARE, "", "no subject can be kept there"),
        ("subjects", 3, TrialPhase.PREPARE, "", "has not seen all presses"),
        ("subjects", 0, TrialPhase.LIFT, "", "has not seen all presses"),
        ("subjects", 8, TrialPhase.IDLE, FITTING, "has not seen all presses"),
    ],
)
def test_a_calibration_that_cannot_succeed_is_refused_before_it_costs_presses(
    rig: Rig,
    process: Callable[..., Any],
    tmp_path: Path,
    folder: str,
    index: int,
    phase: TrialPhase,
    note: str,
    said: str,
) -> None:
    (tmp_path / "file").write_text("")
    # What was announced before the node began to listen, as after its restart.
    rig.announce(index, phase, note=note)
    start_model(rig, process, tmp_path / folder)
    rig.until(lambda: rig.results)
    (result,) = rig.results
    assert (result.level, result.name, result.hardware_id) == (b"\x02", "S01", "S01_a")
    assert said in result.message


def test_the_end_of_an_earlier_calibration_is_no_refusal(
    rig: Rig, process: Callable[..., Any], tmp_path: Path
) -> None:
    rig.announce(8, TrialPhase.IDLE, note="Calibrated: area under 1 N 46 mm².")
    start_model(rig, process, tmp_path)
    rig.announce(0, TrialPhase.PREPARE, "S02")
    rig.settle(1.0)
    assert not rig.results


def test_the_subject_of_the_session_chooses_its_file_and_forgets_the_one_before(
    rig: Rig, process: Callable[..., Any], tmp_path: Path
) -> None:
    default = ParameterSets.default()
    assert default.prior is not None
    variance = tuple(tuple(0.01 * (i == j) for j in range(5)) for i in range(5))
    prior = FingerPrior((0.1, 0.0, 0.2, 0.0, 0.0), variance, 0.01, 22.0, 3.0)
    own = default.with_prior(prior, Geometry())
    own.save(tmp_path / "S01.yaml")
    (tmp_path / "S03.yaml").write_text("sets: nonsense\n")
    start_model(rig, process, tmp_path)

    def newest(kind: int) -> list[ModelEvent]:
        return [event for event in rig.events if event.type == kind]

    rig.announce(0, TrialPhase.PREPARE, "S01")
    rig.until(lambda: newest(ModelEvent.TYPE_RESET))
    assert newest(ModelEvent.TYPE_PARAMETERS)[-1].parameter_sets == own.to_yaml()
    rig.announce(1, TrialPhase.PREPARE, "S01")
    assert len(newest(ModelEvent.TYPE_RESET)) == 1
    # Another file for all others meanwhile: this subject keeps its own parameters.
    others = default.with_prior(replace(prior, reading_sd=4.0), Geometry())
    others.save(tmp_path / "others.txt")
    changed = len(rig.events)
    value = Parameter("parameter_file", value=str(tmp_path / "others.txt")).to_parameter_msg()
    request = SetParameters.Request(parameters=[value])
    answer = rig.call(SetParameters, "/finger/model/set_parameters", request)
    assert answer.results[0].successful
    rig.settle()
    assert len(rig.events) == changed
    for number, subject in enumerate(("S02", "S03"), 2):
        # Without a file, or with one that cannot be read: those of `parameter_file`.
        rig.announce(0, TrialPhase.PREPARE, subject)
        rig.until(lambda n=number: len(newest(ModelEvent.TYPE_RESET)) == n)
        assert rig.events[-1].parameter_sets == others.to_yaml()


def test_without_a_rig_the_command_says_so(process: Callable[..., Any], ros_domain: int) -> None:
    child = process(
        *("-m", "finger_operator.calibrate_node", "--ros-args", "-r", "__ns:=/finger"),
        *("-p", "subject:=S01", "-p", "patience:=1.0"),
    )
    assert child.wait(120) == 2
    assert "no rig answers in namespace '/finger'; start it" in child.output.read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--subject", "Anna"], "never a name"),
        (["--subject", "S01", "--width", "2mm"], "8 … 30 mm"),
        (["--subject", "S01", "--depth", "11mm"], "no width"),
    ],
)
def test_bad_input_is_refused_before_anything_starts(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", *options]) == 2
    assert said in capsys.readouterr().err


def test_calipers_and_age_go_to_the_session() -> None:
    options = "calibrate --subject S01 --width 17mm --depth 1.1cm --finger index --age 40".split()
    (entry,) = calibration_entries(parser().parse_args(options))
    readings = {"finger_width": 0.017, "finger_depth": 0.011, "finger": "index", "age": 40}
    given = {name: entry.parameters[name] for name in readings}
    assert given == {**readings, "finger_depth": pytest.approx(0.011)}
    # Names and types are those of the plan that the protocol node gets.
    assert PlanSettings.select({**PlanSettings().to_dict(), **readings}).finger_depth == 0.011


def test_an_earlier_calibration_is_not_replaced_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ParameterSets.default().save(tmp_path / "subjects" / "S01.yaml")
    options = ["--subject", "S01", "--simulated", "--folder", str(tmp_path)]
    assert main(["calibrate", *options]) == 2
    assert "--again" in capsys.readouterr().err
    # Another finger has a file of its own.
    assert calibration_entries(parser().parse_args(["calibrate", *options, "--finger", "index"]))
    ParameterSets.default().save(tmp_path / "subjects" / "S01.index.yaml")
    assert main(["calibrate", *options, "--finger", "index"]) == 2
    assert "S01.index.yaml" in capsys.readouterr().err


BUSY = """
/**/protocol:
  ros__parameters:
    {gap_limit: 1.0, frame_gap_limit: 2.0, stale_after: 1.5, record_timeout: 60.0,
     release_time: 2.0, target_timeout: 20.0, max_attempts: 20}
"""
"""Limits that a loaded machine keeps."""


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(900)
def test_the_whole_command_on_the_simulated_rig(tmp_path: Path, ros_domain: int) -> None:
    limits = tmp_path / "busy.yaml"
    limits.write_text(BUSY)
    command = [sys.executable, "-m", "finger_bringup.cli", "calibrate", "--subject", "S01"]
    command += ["--simulated", "--folder", str(tmp_path / "rig"), "--parameters", str(limits)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=850, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    assert "live in the model node" in done.stdout
    saved = ParameterSets.load(tmp_path / "rig" / "subjects" / "S01.yaml")
    assert saved.prior != ParameterSets.default().prior
    assert len(list((tmp_path / "rig" / "subjects").iterdir())) == 1
