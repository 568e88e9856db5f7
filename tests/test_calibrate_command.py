"""What `finger-rig calibrate` does when something is in its way.

The node of the command and the real protocol node, beside stand-ins of force, camera and model.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from waiting import wait_until

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from service_calls import answer  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from finger_bringup.cli import main  # noqa: E402
from finger_common.flags import AreaFlag  # noqa: E402
from finger_common.guided_presses import CALIBRATION_PRESSES, FITTING  # noqa: E402
from finger_common.node import LATCHED_QOS, STATE_QOS, message_of  # noqa: E402
from finger_common.stamps import fill_time  # noqa: E402
from finger_common.trial_phases import TrialPhase  # noqa: E402
from finger_msgs.msg import ContactArea, ContactState, SessionStatus, Trial  # noqa: E402
from finger_operator.protocol import Protocol  # noqa: E402
from finger_operator.status import session_status  # noqa: E402
from finger_operator.status_message import status_fields  # noqa: E402
from finger_operator.steps import Step  # noqa: E402
from finger_operator.study_plan import StudyPlan  # noqa: E402


class Rig(threading.Thread):
    """Force, camera and model of a rig, without a model behind them. One press is a step."""

    def __init__(self, domain: int, subjects: Path) -> None:
        super().__init__(daemon=True)
        self.force = 0.0
        self.modelling = True
        self.touch_during_tare = 0
        self.far_tares = 0
        """Tares that are refused for being far from the one before."""
        self.tares: list[float] = []
        self.trials: list[Trial] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self.devices, self.model = (
            rclpy.create_node(name, namespace="finger", context=self._context)
            for name in ("force", "model")
        )
        for node in (self.devices, self.model):
            self._executor.add_node(node)
        self.model.declare_parameter("subjects_folder", str(subjects))
        self._wrench = self.devices.create_publisher(WrenchStamped, "wrench", 50)
        self._area = self.devices.create_publisher(ContactArea, "contact_area", 10)
        self._state = self.model.create_publisher(ContactState, "contact_state", 10)
        self.calibration = self.model.create_publisher(DiagnosticStatus, "calibration", STATE_QOS)
        self.devices.create_service(Trigger, "~/tare", self._tare)
        self.devices.create_subscription(Trial, "trial", self.trials.append, LATCHED_QOS)
        self.devices.create_timer(0.05, self._publish)
        self._end = threading.Event()
        self.start()

    def run(self) -> None:
        while not self._end.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def _publish(self) -> None:
        stamp, touched = time.time_ns(), self.force > 0.02
        if self.touch_during_tare and self.tares:
            self.touch_during_tare -= 1
            touched = True
        flags = 0 if touched else int(AreaFlag.NO_CONTACT)
        wrench, area = WrenchStamped(), ContactArea(area_stddev=1e-6, flags=flags)
        wrench.wrench.force.z = -self.force
        area.gross_area = 4e-5 if touched else 0.0
        for message in (wrench, area):
            fill_time(message.header.stamp, stamp)
        self._wrench.publish(wrench)
        self._area.publish(area)
        if self.modelling:
            self._state.publish(ContactState(header=wrench.header))

    def _tare(self, request: Any, response: Any) -> Any:
        self.tares.append(self.force)
        response.success, response.message = not self.far_tares, "tared or not"
        self.far_tares = max(self.far_tares - 1, 0)
        return response

    def refuse(self, session: str, reason: str) -> None:
        """The model node says that it cannot calibrate."""
        status = DiagnosticStatus(level=b"\x02", name="S01", hardware_id=session)
        status.message = reason
        self.calibration.publish(status)

    def close(self) -> None:
        self._end.set()
        self.join(10)
        self._executor.shutdown()
        for node in (self.devices, self.model):
            node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def rig(ros_domain: int, tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(ros_domain, tmp_path / "subjects")
    yield rig
    rig.close()


@pytest.fixture
def protocol(process: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    def start(*parameters: str) -> Any:
        values = (
            f"output:={tmp_path / 'sessions'}", "need_recorder:=false", "gap_limit:=5.0",
            "frame_gap_limit:=5.0", "stale_after:=5.0", "verdict_time:=0.1", *parameters,
        )  # fmt: skip
        flags = [flag for value in values for flag in ("-p", value)]
        ros = ("--ros-args", "-r", "__ns:=/finger")
        return process("-m", "finger_operator.protocol_node", *ros, *flags)

    return start


@pytest.fixture
def calibrate(process: Callable[..., Any]) -> Callable[..., Any]:
    def start(subject: str = "S01", *parameters: str) -> Any:
        flags = [flag for value in parameters for flag in ("-p", value)]
        ros = ("--ros-args", "-r", "__ns:=/finger", "-p", f"subject:={subject!r}")
        ros += ("-p", "patience:=60.0", "-p", "silence:=4.0", *flags)
        return process("-m", "finger_operator.calibrate_node", *ros)

    return start


def said(child: Any, text: str) -> Callable[[], bool]:
    return lambda: text in child.output.read_text()


def at_first_press(rig: Rig, calibrate: Callable[..., Any]) -> Any:
    """A calibration that asks for its first press, whose trial the rig has seen."""
    child = calibrate()
    wait_until(said(child, "press 1 of 9"), child.output.read_text)
    wait_until(lambda: rig.trials, "a trial")
    return child


def test_a_second_calibration_leaves_the_first_and_its_zero_alone(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any], tmp_path: Path
) -> None:
    protocol()
    first = at_first_press(rig, calibrate)
    # Its folder is its own: a study of that subject may have the id without the ending.
    (folder,) = (tmp_path / "sessions").glob("S01_*")
    assert folder.name == rig.trials[-1].session and folder.name.endswith("_calibration")
    rig.force = 0.4
    second = calibrate("S02")
    assert second.wait(90) == 2
    text = second.output.read_text()
    assert "a session is open (S01_" in text and "aborted" not in text
    assert rig.tares == [0.0]
    assert first.poll() is None
    assert {trial.subject for trial in rig.trials} == {"S01"}


def test_the_zero_is_taken_with_nothing_on_the_plate(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol()
    rig.force, rig.touch_during_tare = 0.4, 3
    child = calibrate()
    wait_until(said(child, "something is on the plate"), child.output.read_text)
    assert rig.tares == []
    rig.force = 0.0
    wait_until(said(child, "press 1 of 9"), child.output.read_text)
    # Touched while it was taken, once more.
    assert rig.tares == [0.0, 0.0]
    assert "touched during the tare" in child.output.read_text()


def test_a_zero_that_has_drifted_far_is_taken_with_nothing_on_the_plate(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol()
    rig.far_tares = 1
    child = calibrate()
    wait_until(said(child, "press 1 of 9"), child.output.read_text)
    assert rig.tares == [0.0, 0.0]


def test_ctrl_c_during_the_presses_ends_the_session(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol()
    child = at_first_press(rig, calibrate)
    child.send_signal(signal.SIGINT)
    assert child.wait(30) == 0
    assert child.output.read_text().endswith("aborted; nothing was written\n")
    wait_until(lambda: rig.trials[-1].phase == TrialPhase.IDLE, "the end of the trial")
    assert "aborted" in rig.trials[-1].note


def test_ctrl_c_while_the_presses_are_fitted_leaves_the_result(
    rig: Rig, calibrate: Callable[..., Any], tmp_path: Path
) -> None:
    # In the place of the protocol node: a session whose presses are all made.
    node = rclpy.create_node("protocol", namespace="finger", context=rig._context)
    rig._executor.add_node(node)
    for name in ("subject", "session", "finger", "hand"):
        node.declare_parameter(name, "")
    for name in ("finger_width", "finger_depth"):
        node.declare_parameter(name, 0.0)
    node.declare_parameter("age", 0)
    status = node.create_publisher(SessionStatus, "~/status", STATE_QOS)
    plan = StudyPlan("S01", "S01_a").for_calibration("S01_cal")
    session = Protocol(plan, tmp_path, lambda effect: None)
    asked: list[str] = []

    def answer(name: str) -> Callable[[Any, Any], Any]:
        def serve(request: Any, response: Any) -> Any:
            asked.append(name)
            response.success = name == "calibrate"
            if name == "calibrate":
                for trial in session.trials:
                    trial.verdict = "done"
                session.step, session.message = Step.FINISHED, FITTING
                fields = status_fields(session_status(session))
                status.publish(message_of(SessionStatus, fields))
            return response

        return serve

    for name in ("calibrate", "abort", "close"):
        node.create_service(Trigger, f"~/{name}", answer(name))
    status.publish(SessionStatus(step="closed"))
    child = calibrate()
    wait_until(said(child, FITTING), child.output.read_text)
    child.send_signal(signal.SIGINT)
    assert child.wait(30) == 0
    assert "nothing was written" not in child.output.read_text()
    assert "the result is kept" in child.output.read_text()
    assert asked == ["calibrate"]


def test_what_the_model_node_refuses_ends_it_at_once(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol()
    child = at_first_press(rig, calibrate)
    rig.refuse("another_session", "no")
    rig.refuse(rig.trials[-1].session, "/subjects cannot be written to")
    assert child.wait(60) == 2
    assert "ot calibrated: /subjects cannot be written to" in child.output.read_text()
    wait_until(lambda: rig.trials[-1].phase == TrialPhase.IDLE, "the end of the trial")
    assert "cannot be written to" in rig.trials[-1].note


def test_presses_that_an_operator_skips_end_it_at_once(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol()
    child = at_first_press(rig, calibrate)
    skip = rig.devices.create_client(Trigger, "protocol/skip")
    until = partial(wait_until, what=child.output.read_text)
    for _ in CALIBRATION_PRESSES:
        assert answer(skip, Trigger.Request(), until).success
    assert child.wait(30) == 2
    assert "not all presses were made" in child.output.read_text()


def test_a_participant_who_never_presses(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol("press_timeout:=1.0", "max_attempts:=1")
    child = calibrate()
    assert child.wait(90) == 2
    text = child.output.read_text()
    assert "No press within 1 s" in text and "paused: This trial failed 1 times" in text
    assert text.endswith("aborted; nothing was written\n")


@pytest.mark.parametrize("gone", ["model", "protocol"])
def test_a_node_that_ends_meanwhile_is_named(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any], gone: str
) -> None:
    guide = protocol()
    child = at_first_press(rig, calibrate)
    if gone == "model":
        rig.modelling = False
        text = "the model node gives no estimate"
    else:
        guide.send_signal(signal.SIGINT)
        guide.wait(30)
        text = "the protocol node ended"
    assert child.wait(60) == 2
    assert text in child.output.read_text()


def test_presses_wait_for_a_model_node_that_is_gone(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol()
    child = at_first_press(rig, calibrate)
    rig.model.destroy_publisher(rig._state)
    rig.modelling = False
    wait_until(said(child, "Waiting: model: the node is not running"), child.output.read_text)


def test_without_a_probe_no_reading_is_asked_for(
    rig: Rig, protocol: Callable[..., Any], calibrate: Callable[..., Any]
) -> None:
    protocol("readings:=3")
    child = calibrate()
    wait_until(
        lambda: rig.trials and rig.trials[-1].phase == TrialPhase.PRESS, child.output.read_text
    )
    assert "probe" not in child.output.read_text()


def test_what_the_node_refuses_ends_the_command(
    ros_domain: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """A subject whose code looks like a number is none of it."""
    assert main(["calibrate", "--subject", "1e3", "--age", "400"]) == 2
    assert "calibrate: parameter 'age' is 400, outside 0 … 120 years" in capsys.readouterr().out
