# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The protocol node over DDS: a trial, commands, and a restart after SIGKILL."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from service_calls import call
from waiting import wait_until

from finger_operator.status_message import status_of

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")


class Suite:
    """Stands in for the rest of the suite: force, areas, readings and a recorder."""

    def __init__(self, domain: int) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import WrenchStamped
        from rclpy.qos import QoSProfile

        from finger_common.node import LATCHED_QOS
        from finger_msgs.msg import ContactArea, Moisture, SessionStatus, Trial
        from finger_msgs.srv import Record

        # Nothing may be lost, however busy the machine is.
        stream = QoSProfile(depth=1000)
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("suite", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.trials: list[Any] = []
        self.status: dict[str, Any] = {}
        self.requests: list[Any] = []
        self.bag = ""
        self.force = 0.0
        self.wrench = self.node.create_publisher(WrenchStamped, "wrench", stream)
        self.areas = self.node.create_publisher(ContactArea, "contact_area", stream)
        self.moisture = self.node.create_publisher(Moisture, "moisture", stream)
        self.diagnostics = self.node.create_publisher(DiagnosticArray, "/diagnostics", stream)
        self.node.create_subscription(Trial, "trial", self.trials.append, LATCHED_QOS)
        self.node.create_subscription(
            SessionStatus, "protocol/status", self._take_status, LATCHED_QOS
        )
        self.node.create_service(Record, "recorder/record", self._record)
        self.node.create_timer(0.01, self._publish_force)
        self.node.create_timer(0.1, self._publish_area)

    def _take_status(self, message: Any) -> None:
        self.status = status_of(message)

    def _record(self, request: Any, response: Any) -> Any:
        self.requests.append(request)
        self.bag = request.path or self.bag
        response.success = True
        response.path = self.bag
        response.message_count = 1000
        return response

    def _publish_force(self) -> None:
        from geometry_msgs.msg import WrenchStamped

        message = WrenchStamped()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.wrench.force.z = -self.force
        self.wrench.publish(message)

    def _publish_area(self) -> None:
        from finger_msgs.msg import ContactArea

        message = ContactArea(gross_area=4e-5 if self.force > 0.02 else 0.0)
        message.flags = 0 if self.force > 0.02 else ContactArea.FLAG_NO_CONTACT
        message.header.stamp = self.node.get_clock().now().to_msg()
        self.areas.publish(message)

    def report_error(self, node: str) -> None:
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

        status = DiagnosticStatus(level=b"\x02", name=f"{node}: sensor", message="cable cut")
        self.diagnostics.publish(DiagnosticArray(status=[status]))

    def faults(self) -> list[str]:
        return [e["text"] for e in self.status.get("events", []) if e["kind"] == "fault"]

    def read_moisture(self, value: float) -> None:
        from finger_msgs.msg import Moisture

        self.until(self.moisture.get_subscription_count)
        message = Moisture(value=value)
        message.header.stamp = self.node.get_clock().now().to_msg()
        self.moisture.publish(message)

    def until(self, condition: Callable[[], Any], seconds: float = 90.0) -> Any:
        spin = partial(self.executor.spin_once, timeout_sec=0.05)
        return wait_until(condition, lambda: f"status {self.status}", spin=spin, seconds=seconds)

    def command(self, name: str) -> Any:
        from std_srvs.srv import Trigger

        return call(self.node, Trigger, f"protocol/{name}", Trigger.Request(), self.until)

    def set_parameter(self, name: str, **value: Any) -> Any:
        from rcl_interfaces.msg import Parameter, ParameterValue
        from rcl_interfaces.srv import SetParameters

        parameter = Parameter(name=name, value=ParameterValue(**value))
        request = SetParameters.Request(parameters=[parameter])
        service = "protocol/set_parameters"
        return call(self.node, SetParameters, service, request, self.until).results[0]

    def step(self, name: str) -> None:
        self.until(lambda: self.status.get("step") == name)

    def to_press(self) -> None:
        assert self.command("start").success
        self.step("moisture_before")
        for value in (36.0, 37.0, 38.0):
            self.read_moisture(value)
        self.step("press")

    def press(self) -> None:
        self.force = 0.7
        self.spin(1.0)
        self.force = 1.4
        self.step("lift")
        self.spin(0.1)  # no single sample counts as the target
        self.force = 0.0

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def suite(ros_domain: int) -> Any:
    suite = Suite(ros_domain)
    yield suite
    suite.close()


def start_node(process: Any, output: Path, *parameters: str) -> Any:
    arguments = [
        "output:=" + str(output),
        "subject:=S01",
        "session:=run",
        "conditions:=[natural]",
        "trials:=2",
        "verdict_time:=0.3",
        "qos_reliability:=reliable",
        "gap_limit:=10.0",
        "frame_gap_limit:=10.0",
        "stale_after:=20.0",
        "target_timeout:=600.0",
        "lift_timeout:=600.0",
        "press_timeout:=600.0",
        *parameters,
    ]
    flags = [flag for argument in arguments for flag in ("-p", argument)]
    return process("-m", "finger_operator.protocol_node", "--ros-args", *flags)


def test_trial_over_dds_restart_after_sigkill_and_commands(
    suite: Suite, process: Any, tmp_path: Path
) -> None:
    from finger_msgs.msg import Trial

    child = start_node(process, tmp_path)
    suite.until(lambda: suite.status.get("step") == "closed")
    assert not suite.command("pause").success
    assert suite.command("start").success
    suite.step("prepare")
    assert suite.trials[-1].phase == Trial.PHASE_PREPARE and suite.trials[-1].subject == "S01"

    suite.to_press()
    # A broken sensor of another finger does not fail this finger's trial.
    suite.report_error("other/force")
    suite.report_error("force_of_another")
    suite.press()
    suite.step("moisture_after")
    assert suite.faults() == []
    for value in (35.0, 36.0, 37.0):
        suite.read_moisture(value)
    suite.until(lambda: suite.status["trials"][0]["verdict"] == "done")
    starts = [r for r in suite.requests if r.command == r.COMMAND_START]
    assert starts[0].path == str(tmp_path / "run" / "000_natural_0")
    assert starts[0].trial.condition == "natural"
    lift = next(t for t in suite.trials if t.phase == Trial.PHASE_LIFT)
    assert lift.header.stamp.sec > 1_600_000_000, (
        "the stamp of the force sample that reached the target"
    )

    # Killed in the middle of the second press, the node comes back at the same trial, paused.
    suite.until(lambda: suite.status.get("index") == 1 and suite.status.get("step") == "prepare")
    texts = ["natural: Wash with soap."]
    assert suite.set_parameter("preparations", type=9, string_array_value=texts).successful
    suite.until(lambda: suite.status["preparation"] == "Wash with soap.")
    suite.to_press()
    suite.force = 0.7
    suite.spin(0.3)
    child.send_signal(signal.SIGKILL)
    child.wait(5)
    suite.force = 0.0
    suite.status = {}
    child = start_node(process, tmp_path)
    suite.until(lambda: suite.status.get("paused"))
    assert suite.status["index"] == 1 and suite.status["attempt"] == 1
    assert suite.status["trials"][0]["verdict"] == "done"
    assert "interrupted" in suite.status["trials"][1]["reason"]
    suite.until(lambda: suite.requests[-1].command == 0)
    # The session keeps its own texts, whatever parameter is set.
    assert suite.set_parameter("note", type=4, string_value="cold").successful
    assert suite.command("note").success
    suite.until(lambda: suite.status["notes"])
    assert suite.status["preparation"] == "Wash with soap."

    suite.report_error("force")
    suite.until(lambda: suite.faults() == ["force: cable cut"])

    # Every other command, and the refusals.
    assert suite.command("resume").success
    refused = suite.set_parameter("trials", type=2, integer_value=5)
    assert not refused.successful and "close the session" in refused.reason
    texts = ["natural: Wash with water."]
    assert suite.set_parameter("preparations", type=9, string_array_value=texts).successful
    suite.until(lambda: suite.status["preparation"] == "Wash with water.")
    assert suite.set_parameter("selected_trial", type=2, integer_value=0).successful
    assert suite.command("repeat").success
    suite.until(lambda: suite.status["index"] == 0 and suite.status["attempt"] == 1)
    assert suite.command("skip").success
    suite.until(lambda: suite.status["index"] == 1)
    assert suite.status["trials"][0]["verdict"] == "done", "its repetition was given up"

    # Notes, a marker, and an early end that can be taken back.
    assert suite.set_parameter("note", type=4, string_value="window opened").successful
    assert suite.command("note").success
    assert suite.set_parameter("note_trial", type=2, integer_value=1).successful
    assert suite.command("note").success
    assert suite.command("marker").message == "marker 1 set"
    suite.until(lambda: suite.status["trials"][1]["markers"])
    assert suite.status["notes"][1]["text"] == "window opened"
    assert suite.status["disk"]["free_gb"] > 0
    assert suite.command("end").success
    suite.step("finished")
    assert "2 trials" in suite.status["summary"]["text"]
    assert suite.command("resume").success
    suite.step("prepare")
    assert suite.command("close").success
    suite.until(lambda: suite.status.get("step") == "closed")
    assert suite.status["used_subjects"] == {"S01": ["run"]}
    # Until the recorder has answered its last request, the node asks for a moment.
    end = time.monotonic() + 60
    while "busy" in (again := suite.command("start")).message and time.monotonic() < end:
        pass
    assert not again.success and "exists already" in again.message
    child.send_signal(signal.SIGINT)
    assert child.wait(60) == 0, child.output.read_text()
    assert "Traceback" not in child.output.read_text()


def test_late_joiners_receive_the_newest_only_and_ctrl_c_is_reported(
    suite: Suite, process: Any, tmp_path: Path
) -> None:
    from finger_common.node import LATCHED_QOS
    from finger_msgs.msg import Trial

    child = start_node(process, tmp_path)
    suite.until(lambda: suite.status.get("step") == "closed")
    assert suite.command("start").success
    suite.step("prepare")
    suite.to_press()
    assert len(suite.trials) >= 3
    late: list[Any] = []
    suite.node.create_subscription(Trial, "trial", late.append, LATCHED_QOS)
    suite.until(lambda: late)
    suite.force = 0.7
    suite.spin(0.3)
    child.send_signal(signal.SIGINT)
    suite.until(lambda: suite.trials[-1].phase == Trial.PHASE_PAUSED)
    assert child.wait(60) == 0, child.output.read_text()
    suite.until(lambda: late[-1].phase == Trial.PHASE_PAUSED)
    suite.until(lambda: suite.requests[-1].command == 0)
    assert late[0].phase == Trial.PHASE_PRESS
    state = json.loads((tmp_path / "run" / "session.json").read_text())
    assert state["paused"] and "paused during the trial" in str(state["trials"][0]["attempts"])
    assert "Traceback" not in child.output.read_text()


def test_names_are_refused_and_a_missing_recorder_is_reported(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    suite = Suite(ros_domain)
    try:
        for service in list(suite.node.services):
            if service.srv_name.endswith("/record"):
                suite.node.destroy_service(service)
        start_node(process, tmp_path, "subject:=Maria", "record_timeout:=0.6")
        suite.until(lambda: suite.status.get("step") == "closed")
        refused = suite.command("start")
        assert not refused.success and "never a name" in refused.message
        assert suite.set_parameter("subject", type=4, string_value="S07").successful
        assert suite.command("start").success
        assert suite.command("start").success
        suite.until(lambda: suite.status.get("paused"))
        assert "recorder is not running" in suite.status["trials"][0]["reason"]
    finally:
        suite.close()


@contextmanager
def node_here(ros_domain: int, output: Path, **values: Any) -> Iterator[Any]:
    """The node in this process, active; its session is forgotten at the end."""
    from rclpy.parameter import Parameter

    from finger_operator.protocol_node import ProtocolNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    values = {"output": str(output), "subject": "S01", "readings": 0, **values}
    given = [Parameter(name, value=value) for name, value in values.items()]
    node = ProtocolNode(context=context, parameter_overrides=given)
    try:
        assert node.bring_up()
        yield node
    finally:
        node._protocol = None
        node.release()
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ("bag", "messages", "verdict"), [("", 9, "done"), ("x", 9, "failed"), ("", 0, "failed")]
)
def test_the_recorder_s_answer_to_the_stop_decides_with_path_and_count(
    ros_domain: int, tmp_path: Path, bag: str, messages: int, verdict: str
) -> None:
    from finger_msgs.srv import Record
    from finger_operator.protocol import Step
    from finger_operator.recording import RecordingState

    with node_here(ros_domain, tmp_path) as node:
        node._start()
        node._start()
        protocol = node._protocol
        attempt = protocol.trials[0].attempts[0]
        protocol.step, protocol.recording.state = Step.CLOSING, RecordingState.STOPPING
        answer = Record.Response(success=True, path=attempt.bag + bag, message_count=messages)
        node._recorded(Record.Request(command=Record.Request.COMMAND_STOP), answer, "")
        assert attempt.verdict == verdict


def test_a_start_says_what_it_did_and_a_condition_is_known_once_a_session_had_it(
    ros_domain: int, tmp_path: Path
) -> None:
    from finger_operator.protocol import Step

    plan = {"conditions": ["greasy"], "trials": 2, "need_recorder": False}
    with node_here(ros_domain, tmp_path, **plan) as node:
        node._publish_status()
        assert "greasy" not in node._status["preparations"]
        assert node._start() == "Session begun. Prepare the finger and the plate."
        assert node._start() == "the trial begins"
        node._protocol.step = Step.FAILED
        assert node._start() == "Prepare the finger and the plate."
        node._end()
        node._close()
        node._publish_status()
        known = node._status["preparations"]
        assert known["greasy"] == "Prepare the finger as in your protocol."


def test_no_trial_begins_without_a_tare(ros_domain: int, tmp_path: Path) -> None:
    """In the words of the page, and where the force driver tells that it has no zero."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    from finger_common.errors import InputError
    from finger_operator.protocol import Step
    from finger_operator.readiness import Readiness, refusal

    page = Readiness()
    page.beat("force", 0.0)
    page.beat("protocol", 0.0)
    page.sample("force", 0.0)
    page.report("force", "force", 1, "", {"tared": "no"}, 0.0)
    words = refusal(page.problems(0.1))
    assert "press Tare" in words

    def tell(node: Any, name: str, tared: str) -> None:
        values = [KeyValue(key="tared", value=tared)]
        status = DiagnosticStatus(level=b"\x01", name=f"{name}: sensor", values=values)
        node._on_diagnostics(DiagnosticArray(status=[status]))

    with node_here(ros_domain, tmp_path) as node:
        tell(node, "force", "no")
        with pytest.raises(InputError, match=re.escape(words)):
            node._calibrate()
        assert node._protocol is None
        node._start()
        assert node._protocol.step is Step.PREPARE, "a session may begin"
        with pytest.raises(InputError, match=re.escape(words)):
            node._start()
        tell(node, "other/force", "yes")
        with pytest.raises(InputError, match=re.escape(words)):
            node._start()
        tell(node, "force", "yes")
        node._start()
        assert node._protocol.step is not Step.PREPARE


def test_a_trial_tells_when_it_begins_that_the_nodes_disagree_on_the_time(
    ros_domain: int, tmp_path: Path
) -> None:
    from finger_operator.protocol import Step

    with node_here(ros_domain, tmp_path) as node:
        node._start()
        assert node._protocol.step is Step.PREPARE
        now = node.sample_time()
        node._protocol.wrench(now - 60 * 10**9, 0.0)
        node._protocol.tick(now)
        node._start()
        assert node._protocol.step is not Step.PREPARE
        assert any("60.0 s apart" in event.text for event in node._protocol.log.events)


@pytest.mark.parametrize("code", ["-1", "_S01"])
def test_a_new_code_begins_with_a_letter_or_a_digit_and_older_ones_go_on(
    ros_domain: int, tmp_path: Path, code: str
) -> None:
    from finger_common.errors import InputError
    from finger_operator.protocol import Protocol
    from finger_operator.study_plan import StudyPlan

    with node_here(ros_domain, tmp_path, subject=code) as node:
        with pytest.raises(InputError, match=f"'{code}' must begin with a letter or a digit"):
            node._start()
        assert node._protocol is None and not list(tmp_path.glob(f"{code}*"))
        protocol = Protocol(StudyPlan(code, "older"), tmp_path / "older", lambda effect: None)
        protocol.start(node.sample_time())
        (tmp_path / "current_session").write_text("older")
        node._resume_pointer()
        assert node._protocol.plan.subject == code
        node._used_subjects = {code: ["older"]}
        assert node._new_session().plan.subject == code


def tell(node: Any, name: str, **values: str) -> None:
    """A report of a node in /diagnostics, a warning."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    status = DiagnosticStatus(level=b"\x01", name=f"{name}: part", values=pairs)
    node._on_diagnostics(DiagnosticArray(status=[status]))


def test_a_trial_names_the_finger_that_is_tested(ros_domain: int, tmp_path: Path) -> None:
    """To whoever hears it, and to the recorder, which notes it in the bag."""
    from finger_common.trial_phases import TrialPhase

    with node_here(ros_domain, tmp_path, hand="right", finger="index") as node:
        tell(node, "force", tared="yes", tare_offset="0.1, 0, 0, 0, 0, 0")
        node._start()
        event = node._protocol._announcement(TrialPhase.PRESS)
        assert node._trial_message(event).header.frame_id == "right_index"


def test_a_trial_under_way_needs_a_tare_too(ros_domain: int, tmp_path: Path) -> None:
    """The force driver started again within it, which loses its zero."""
    with node_here(ros_domain, tmp_path) as node:
        tell(node, "force", tared="yes", tare_offset="0.1, 0, 0, 0, 0, 0")
        node._start()
        node._start()
        protocol = node._protocol
        tell(node, "force", tared="no")
        assert "press Tare" in protocol.waiting_for()
        tell(node, "force", tared="yes", tare_offset="0.2, 0, 0, 0, 0, 0")
        assert "Tare" not in protocol.waiting_for()
        protocol.step = protocol.step.PRESS
        protocol.trials[0].attempts[0].onset_ns = 1
        tell(node, "force", tared="no")
        assert "press Tare" in protocol._press.problems[0]


def test_each_new_zero_is_in_the_log(ros_domain: int, tmp_path: Path) -> None:
    with node_here(ros_domain, tmp_path) as node:
        node._start()
        for zero in ("0.1, 0.02", "0.1, 0.02", "0.3, 0.02"):
            tell(node, "force", tared="yes", tare_offset=zero)
        tell(node, "other/force", tared="yes", tare_offset="7")
        texts = [event.text for event in node._protocol.log.events if "tared" in event.text]
        assert texts == ["force tared, zero at 0.1, 0.02", "force tared, zero at 0.3, 0.02"]


def test_the_force_comes_from_the_topic_that_the_model_reads(
    ros_domain: int, tmp_path: Path
) -> None:
    """As from a sensor at an angle, whose wrench another node turns."""
    from geometry_msgs.msg import WrenchStamped

    with node_here(ros_domain, tmp_path, wrench_topic="wrench_turned") as node:
        node._start()
        publisher = node.create_publisher(WrenchStamped, "wrench_turned", 10)
        end = time.monotonic() + 20
        while "0.40 N on the plate" not in node._protocol.waiting_for():
            assert time.monotonic() < end, node._protocol.waiting_for()
            message = WrenchStamped()
            message.wrench.force.z = -0.4
            message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
            node._poll()
            node._protocol.tick(node.sample_time())
            time.sleep(0.02)


def test_a_session_that_goes_on_names_its_trial_as_the_page_does(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    from finger_operator.protocol import Protocol
    from finger_operator.study_plan import StudyPlan

    plan = StudyPlan("S01", "run", conditions=["natural"], trials=2)
    protocol = Protocol(plan, tmp_path / "run", lambda effect: None)
    protocol.start(time.time_ns())
    protocol.skip(time.time_ns())
    (tmp_path / "current_session").write_text("run")
    child = start_node(process, tmp_path)
    end = time.monotonic() + 60
    while "session run resumed at trial 2" not in child.output.read_text():
        assert time.monotonic() < end, child.output.read_text()
        time.sleep(0.1)


def test_what_the_recorder_says_of_itself_reaches_the_trial(
    ros_domain: int, tmp_path: Path
) -> None:
    from finger_operator.protocol import Step

    with node_here(ros_domain, tmp_path) as node:
        node._start()
        node._start()
        protocol = node._protocol
        bag = protocol.trials[0].attempts[0].bag
        protocol.recorder_started(True, "", node.sample_time(), bag=bag)
        for _ in range(3):
            tell(node, "recorder", recording=bag, minimum_free=str(10**15))
        assert protocol.step is Step.CLEAR
        node._free = 10**12
        node._publish_status()
        assert node._status["disk"]["trials_left"] == 0
        tell(node, "recorder", recording="no", minimum_free="0")
        protocol.tick(node.sample_time() + 1_000_000_000)
        tell(node, "recorder", recording="no", minimum_free="0")
        assert protocol.step is Step.FAILED


def test_a_session_that_cannot_be_saved_is_not_closed(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor read again from its old file when the node is activated again."""
    import finger_operator.session_files as module
    from finger_common.errors import InputError

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    saved = tmp_path / "run" / "session.json"
    with node_here(ros_domain, tmp_path, session="run", need_recorder=False) as node:
        node._start()
        with monkeypatch.context() as disk:
            disk.setattr(module, "save_state", full)
            node._end()
            with pytest.raises(InputError, match=r"No space left on device; make room"):
                node._close()
            assert node.trigger_deactivate().name == "SUCCESS"
            assert node.trigger_activate().name == "SUCCESS"
        assert json.loads(saved.read_text())["step"] == "prepare"
        assert node._protocol.step.value == "finished"
        assert node.trigger_deactivate().name == "SUCCESS"
        assert json.loads(saved.read_text())["step"] == "finished"
        assert node.trigger_activate().name == "SUCCESS"
        assert "closed" in node._close()


def test_a_suspend_of_the_computer_is_in_the_event_log(ros_domain: int, tmp_path: Path) -> None:
    from finger_common.host_clock import HostClock

    with node_here(ros_domain, tmp_path) as node:
        node._start()
        wall = [node.sample_time()]
        node.host_clock = HostClock(lambda: wall[0], lambda: 0)
        for asleep in (0, 3600, 0):
            wall[0] += asleep * 10**9
            node._free_read = -1e9
            node._tick()
        (text,) = (e.text for e in node._protocol.log.events if e.kind == "warning")
        assert "stepped by +3600.000 s or the computer was suspended" in text


@pytest.mark.parametrize("step", ["PRESS", "MOISTURE_AFTER"])
def test_the_recording_ends_with_the_activity_of_the_node(
    ros_domain: int, tmp_path: Path, step: str
) -> None:
    """Also when the recorder has not answered the start yet."""
    from rclpy.task import Future

    from finger_msgs.srv import Record
    from finger_operator.protocol import Step

    class Recorder:
        """Client of one that answers nothing."""

        def __init__(self) -> None:
            self.asked: list[int] = []

        def service_is_ready(self) -> bool:
            return True

        def call_async(self, request: Any) -> Any:
            self.asked.append(request.command)
            return Future()

    with node_here(ros_domain, tmp_path) as node:
        node._recorder._client = recorder = Recorder()
        node._start()
        node._start()
        node._tick()
        node._protocol.step = Step[step]
        assert node.trigger_deactivate().name == "SUCCESS"
    assert recorder.asked == [Record.Request.COMMAND_START, Record.Request.COMMAND_STOP]


def test_the_status_of_a_long_session_holds_up_no_press(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from finger_operator import protocol_node
    from finger_operator.protocol import Step

    made: list[str] = []
    clock = [0.0]
    status = protocol_node.session_status

    def slow(protocol: Any, *more: Any) -> Any:
        made.append(protocol.step.value)
        clock[0] += 0.05  # as that of 3000 trials
        return status(protocol, *more)

    monkeypatch.setattr(protocol_node, "session_status", slow)
    monkeypatch.setattr(protocol_node.time, "monotonic", lambda: clock[0])
    with node_here(ros_domain, tmp_path, need_recorder=False) as node:
        node._start()
        monkeypatch.setattr(node._protocol, "tick", lambda now_ns: None)
        for step, ticks in ((Step.PREPARE, 20), (Step.PRESS, 100), (Step.DONE, 1)):
            node._protocol.step = step
            for _ in range(ticks):
                clock[0] += 0.05
                node._tick()
    assert made.count("prepare") == 2, "half a second apart"
    assert made.count("press") == 1 and made[-1] == "done"
