# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The managed node over real DDS, in a process of its own."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from service_calls import call  # noqa: E402
from waiting import wait_until  # noqa: E402

NODE = """
from dataclasses import dataclass
from rclpy.duration import Duration
from std_msgs.msg import Float64
from finger_common.diagnostics import Health
from finger_common.errors import InputError
from finger_common.node import ManagedNode, main_of
from finger_common.settings import Settings, setting

@dataclass(frozen=True)
class GaugeSettings(Settings):
    gain: float = setting(1.0, "Gain.", minimum=0.0, maximum=10.0, runtime=True)
    port: str = setting("a", "Port.")

class Gauge(ManagedNode):
    NAME = "gauge"
    SETTINGS = (GaugeSettings,)
    def configure(self):
        if self.values["port"] == "missing":
            raise InputError("port 'missing': no such device; plug it in")
        self.healths = [Health("gauge", "no. 7")]
        self.publisher = self.create_stream_publisher(Float64, "value", self.stream_qos())
    def activate(self):
        self.timer = self.create_timer(
            0.02, lambda: self.publisher.publish(Float64(data=self.values["gain"]))
        )
    def deactivate(self):
        self.destroy_timer(self.timer)
        self.publisher.publish(Float64(data=-1.0))
        self.publisher.wait_for_all_acked(Duration(seconds=60))

main_of(Gauge)()
"""


@pytest.fixture
def observer(ros_domain: int) -> Any:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("observer", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield node, lambda: executor.spin_once(timeout_sec=0.05)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_shell_publishes_checks_parameters_reports_and_ends_cleanly(
    observer: Any, process: Any, tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters
    from std_msgs.msg import Float64, String

    node, spin = observer
    until = partial(wait_until, what="an answer of the node", spin=spin)
    values: list[float] = []
    states: list[Any] = []
    beats: list[str] = []
    node.create_subscription(String, "heartbeat", lambda m: beats.append(m.data), 10)
    node.create_subscription(Float64, "value", lambda m: values.append(m.data), 10)
    node.create_subscription(DiagnosticArray, "/diagnostics", states.append, 10)
    script = tmp_path / "gauge.py"
    script.write_text(NODE)
    others = set(Path("/dev/shm").glob("fastrtps_*"))
    child = process(script, "--ros-args", "-p", "qos_reliability:=reliable")
    wait_until(lambda: values, "a value", spin=spin)
    assert values[-1] == 1.0

    def set_parameter(name: str, **value: Any) -> Any:
        kind = ParameterType.PARAMETER_DOUBLE if "double_value" in value else 4
        request = SetParameters.Request(
            parameters=[Parameter(name=name, value=ParameterValue(type=kind, **value))]
        )
        return call(node, SetParameters, "/gauge/set_parameters", request, until).results[0]

    assert set_parameter("gain", double_value=2.5).successful
    wait_until(lambda: values[-1] == 2.5, "the new value", spin=spin)
    refused = set_parameter("gain", double_value=11.0)
    assert not refused.successful and "0 … 10" in refused.reason
    refused = set_parameter("port", string_value="b")
    assert not refused.successful and "deactivate" in refused.reason

    status = wait_until(lambda: states, "diagnostics", spin=spin)[-1].status[0]
    assert status.name == "gauge: gauge" and status.hardware_id == "no. 7"
    assert {v.key: v.value for v in status.values}["state"] == "active"
    wait_until(lambda: len(beats) > 2, "heartbeats", spin=spin)
    assert set(beats) == {"gauge"}
    # Ctrl-C: the node writes its last log line, and leaves no shared memory.
    maps = Path(f"/proc/{child.pid}/maps").read_text()
    mapped = set(re.findall(r"/dev/shm/fastrtps_[0-9a-f]{16}\b", maps))
    own = {Path(name) for name in mapped} - others
    child.send_signal(signal.SIGINT)
    wait_until(lambda: values[-1] == -1.0, "the last value", spin=spin)
    assert child.wait(60) == 0, child.output.read_text()
    assert own and not [file for file in own if file.exists()]


COMPILING = """
import ctypes, time
from finger_common.node import ManagedNode, main_of

def compile_for_long():
    # An exception in a callback of C is lost.
    print("compiling", flush=True)
    for _ in range(10000):  # a signal just before a sleep is seen when the sleep ends
        time.sleep(0.01)

class Compiler(ManagedNode):
    NAME = "compiler"
    def configure(self):
        done = ctypes.CFUNCTYPE(None)(compile_for_long)
        done()
        raise RuntimeError("no compiled object yet")

main_of(Compiler)()
"""


def test_ctrl_c_that_a_compiler_swallows_ends_the_node_without_a_traceback(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    script = tmp_path / "compiler.py"
    script.write_text(COMPILING)
    child = process(script)
    wait_until(lambda: "compiling" in child.output.read_text(), "the start")
    child.send_signal(signal.SIGINT)
    assert child.wait(30) == 0
    said = child.output.read_text()
    assert "configure was interrupted" in said
    assert "Traceback" not in said and "KeyboardInterrupt" not in said


def test_failed_configuration_leaves_the_node_up_to_try_again(
    observer: Any, process: Any, tmp_path: Path
) -> None:
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    node, spin = observer
    until = partial(wait_until, what="an answer of the node", spin=spin)
    script = tmp_path / "gauge.py"
    script.write_text(NODE)
    child = process(script, "--ros-args", "-p", "port:=missing")
    state = call(node, GetState, "/gauge/get_state", GetState.Request(), until)
    assert state.current_state.id == State.PRIMARY_STATE_UNCONFIGURED
    assert "configure failed: port 'missing'" in child.output.read_text()
    value = ParameterValue(type=4, string_value="a")
    request = SetParameters.Request(parameters=[Parameter(name="port", value=value)])
    assert call(node, SetParameters, "/gauge/set_parameters", request, until).results[0].successful
    change = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    assert call(node, ChangeState, "/gauge/change_state", change, until).success


def test_parameter_file_that_is_not_yaml_ends_with_one_sentence(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    script = tmp_path / "gauge.py"
    script.write_text(NODE)
    bad = tmp_path / "bad.yaml"
    bad.write_text("[:")
    child = process(script, "--ros-args", "--params-file", bad)
    assert child.wait(60) == 2
    output = child.output.read_text()
    assert "bad.yaml" in output and "Traceback" not in output


def test_a_wrong_value_of_a_parameter_of_ros_ends_with_one_sentence(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    script = tmp_path / "gauge.py"
    script.write_text(NODE)
    child = process(script, "--ros-args", "-p", "use_sim_time:='yes'")
    assert child.wait(60) == 2
    output = child.output.read_text()
    assert "gauge: " in output and "'use_sim_time'" in output and "Traceback" not in output


CLOCK = "import sys, time\ntime.time_ns = lambda now=int(sys.argv.pop(1)): now * 10**9\n"


@pytest.mark.parametrize(
    ("seconds", "said"), [(-1, "1969-12-31 23:59:59"), (1 << 31, "2038-01-19 03:14:08")]
)
def test_a_clock_outside_the_times_of_messages_is_told(
    ros_domain: int, process: Any, tmp_path: Path, seconds: int, said: str
) -> None:
    script = tmp_path / "gauge.py"
    script.write_text(CLOCK + NODE)
    child = process(script, str(seconds))
    assert child.wait(30) == 2
    output = child.output.read_text()
    assert output.startswith(f"gauge: the system clock says {said} UTC, messages hold the years")
    assert output.endswith("; set the clock\n") and output.count("\n") == 1


@pytest.mark.parametrize("folder", ["file/log", "/sys"])
def test_logs_that_cannot_be_written_are_told_from_arguments(
    ros_domain: int, process: Any, tmp_path: Path, folder: str
) -> None:
    """As of a home folder that cannot be written."""
    script = tmp_path / "gauge.py"
    script.write_text(NODE)
    (tmp_path / "file").touch()
    logs = tmp_path / folder
    child = process(script, env={"ROS_LOG_DIR": str(logs)})
    assert child.wait(60) == 2
    output = child.output.read_text()
    assert f"gauge: logs cannot be written to {logs} (" in output
    assert "set ROS_LOG_DIR to a folder" in output
    assert "arguments cannot" not in output and "Traceback" not in output


def test_a_node_that_fails_while_it_runs_is_told_from_one_that_cannot_begin(
    ros_domain: int, process: Any, tmp_path: Path
) -> None:
    """By its exit code: it is started again."""
    script = tmp_path / "gauge.py"
    fails = NODE.replace("lambda: self", "lambda: exec(\"raise InputError('it broke')\") or self")
    script.write_text(fails)
    child = process(script)
    assert child.wait(60) == 1
    assert "gauge: it broke" in child.output.read_text()


def test_messages_that_are_polled_for_neither_wake_the_executor_nor_get_lost(
    ros_domain: int,
) -> None:
    from rclpy.duration import Duration
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.lifecycle import LifecycleNode
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rclpy.serialization import deserialize_message
    from std_msgs.msg import Float64

    from finger_common.node import PolledSubscription

    class Counting(SingleThreadedExecutor):
        """Counts how often the executor gathers what it may wait for."""

        rounds = 0

        def can_execute(self, entity: Any) -> bool:
            self.rounds += 1
            return super().can_execute(entity)

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    talker = rclpy.create_node("talker", context=context)
    listener = LifecycleNode("listener", context=context)
    executor = Counting(context=context)
    executor.add_node(listener)
    qos = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
    try:
        publisher = talker.create_publisher(Float64, "value", qos)
        polled = PolledSubscription(listener, Float64, "value", qos)
        wait_until(publisher.get_subscription_count, "the reader")
        for number in range(100):
            publisher.publish(Float64(data=float(number)))
        publisher.wait_for_all_acked(Duration(seconds=60))
        # One round to see what there is, then it sleeps although messages lie unread.
        executor.spin_once(timeout_sec=0.1)
        executor.rounds = 0
        executor.spin_once(timeout_sec=0.5)
        assert executor.rounds < 500  # about twenty entities a round
        received = [deserialize_message(m, Float64).data for m, _ in polled.take()]
        assert received == [float(n) for n in range(100)]
        assert list(polled.take()) == []
        assert polled.new_mismatches() == 0
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        talker.create_publisher(Float64, "value", best_effort)
        wait_until(polled.new_mismatches, "the mismatch")
        assert polled.new_mismatches() == 0
        polled.destroy()
    finally:
        executor.shutdown()
        listener.destroy_node()
        talker.destroy_node()
        rclpy.shutdown(context=context)


def test_a_waited_stream_is_delivered_without_the_executor_and_its_error_ends_it(
    ros_domain: int,
) -> None:
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    from finger_common.node import PolledSubscription, WaitedSubscription

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    talker = rclpy.create_node("talker", context=context)
    listener = rclpy.create_node("listener", context=context)
    qos = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
    received: list[float] = []
    errors: list[Exception] = []

    def take(message: Any) -> None:
        if message.data < 0:
            raise ValueError("a negative number")
        received.append(message.data)

    def waited(topic: str) -> WaitedSubscription:
        polled = PolledSubscription(listener, Float64, topic, qos)
        return WaitedSubscription(listener, polled, take, errors.append)

    try:
        first, second = (talker.create_publisher(Float64, topic, qos) for topic in ("a", "b"))
        a, b = waited("a"), waited("b")
        wait_until(first.get_subscription_count, "the first reader")
        wait_until(second.get_subscription_count, "the second reader")
        for number in range(50):
            first.publish(Float64(data=float(number)))
        wait_until(lambda: len(received) == 50, "fifty messages")
        assert received == [float(n) for n in range(50)]
        first.publish(Float64(data=-1.0))
        wait_until(lambda: errors, "the error")
        assert isinstance(errors[0], ValueError)
        second.publish(Float64(data=99.0))
        wait_until(lambda: received[-1] == 99.0, "the message after the error")
        for stream in (a, b):
            stream.destroy()
        wait_until(lambda: not second.get_subscription_count(), "the end of the reader")
        # The thread begins again with a stream that comes later.
        waited("b")
        wait_until(second.get_subscription_count, "the second reader")
        second.publish(Float64(data=7.0))
        wait_until(lambda: received[-1] == 7.0, "the last message")
    finally:
        listener.destroy_node()
        talker.destroy_node()
        rclpy.shutdown(context=context)


def test_messages_that_do_not_fit_their_definition_are_left_out_counted_and_named(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a driver that was built with another version of the messages."""
    from rclpy.serialization import serialize_message
    from std_msgs.msg import Header

    from finger_common.diagnostics import Health
    from finger_common.node import LATCHED_QOS, ManagedNode

    received: list[str] = []

    class Reader(ManagedNode):
        def configure(self) -> None:
            self.healths = [Health("reader")]
            self.polled = self.create_polled_subscription(Header, "polled", LATCHED_QOS)
            self.create_waited_subscription(
                Header, "waited", lambda message: received.append(message.frame_id), LATCHED_QOS
            )

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    talker = rclpy.create_node("talker", context=context)
    reader = Reader(context=context)
    whole = [serialize_message(Header(frame_id=name)) for name in ("first", "last")]
    topics = ("polled", "waited")
    publishers = [talker.create_publisher(Header, topic, LATCHED_QOS) for topic in topics]
    try:
        for publisher in publishers:
            for raw in (whole[0], whole[0][:-4], whole[0][:2], whole[1]):
                publisher.publish(raw)
        assert reader.bring_up()  # after they were sent
        wait_until(lambda: received[-1:] == ["last"], "the last message")
        assert received == ["first", "last"]
        polled: list[str] = []

        def poll() -> bool:
            polled.extend(message.frame_id for message in reader.polled.messages())
            return polled[-1:] == ["last"]

        wait_until(poll, "the messages")
        assert polled == ["first", "last"]
        reader.publish_diagnostics()
        report = reader.healths[0].report()
        assert report.level == 1 and "another version of std_msgs" in report.message
        for topic in topics:
            assert f"messages on '/{topic}' cannot be read (2 so far)" in report.message
            assert f"/{topic} 2" in report.values["unreadable"]
        # It is over some time after the last one.
        monkeypatch.setattr("finger_common.node.stream_watch.REMEMBERED", 0.0)
        reader.publish_diagnostics()
        report = reader.healths[0].report()
        assert report.level == 0 and "/polled 2" in report.values["unreadable"]
    finally:
        reader.release()
        reader.destroy_node()
        talker.destroy_node()
        rclpy.shutdown(context=context)


def test_transitions_in_an_odd_order_are_refused_and_change_nothing(ros_domain: int) -> None:
    """By number and by name, as tools send them."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    from finger_common.node import ManagedNode

    rclpy.init(domain_id=ros_domain)
    node = ManagedNode()

    def change(number: int, name: str = "") -> tuple[bool, str]:
        request = ChangeState.Request(transition=Transition(id=number, label=name))
        answer = node._LifecycleNodeMixin__on_change_state(request, ChangeState.Response())
        return answer.success, node._state_machine.current_state[1]

    try:
        assert change(Transition.TRANSITION_ACTIVATE) == (False, "unconfigured")
        assert change(Transition.TRANSITION_CONFIGURE) == (True, "inactive")
        assert change(0, "configure") == (False, "inactive")
        assert change(Transition.TRANSITION_ACTIVATE) == (True, "active")
        assert change(Transition.TRANSITION_ACTIVATE) == (False, "active")
        assert change(Transition.TRANSITION_CLEANUP) == (False, "active")
        assert change(0, "nonsense") == (False, "active")
        assert node.active
        assert change(0, "shutdown") == (True, "finalized")
        assert change(0, "shutdown") == (False, "finalized")
        assert not node.active
        node.destroy_node()
    finally:
        rclpy.shutdown()


def test_a_rate_that_stays_low_and_its_end_are_logged_once(ros_domain: int, capfd: Any) -> None:
    from finger_common.diagnostics import Health
    from finger_common.node import ManagedNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = ManagedNode(context=context)
    now = [0.0]
    health = Health("gauge", expected_rate=100.0, clock=lambda: now[0])
    health.state, node.healths = "active", [health]
    try:
        for rate in [100.0] * 22 + [40.0] * 12 + [100.0] * 12:
            for _ in range(int(rate)):
                now[0] += 1.0 / rate
                health.sample()
            node.publish_diagnostics()
        said = capfd.readouterr().err
        assert said.count("WARN") == 1 and "gauge: rate 40.0 Hz, expected 100.0 Hz" in said
        assert said.count("gauge: rate 100.0 Hz, as expected again") == 1
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_the_heart_stops_while_no_callback_is_served_and_an_executor_may_change(
    ros_domain: int,
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile
    from std_msgs.msg import String

    from finger_common.diagnostics import Health
    from finger_common.node import ManagedNode, PolledSubscription

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = ManagedNode(context=context)
    node.healths = [Health("gauge")]
    observer = rclpy.create_node("observer", context=context)
    beats, reports = (
        PolledSubscription(observer, kind, topic, QoSProfile(depth=50))
        for kind, topic in ((String, "heartbeat"), (DiagnosticArray, "/diagnostics"))
    )

    def heard(stream: PolledSubscription) -> int:
        return len(list(stream.take()))

    try:
        for _ in range(2):  # a task that waits in the first executor does not stop the second
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(node)
            wait_until(
                lambda: heard(reports), "diagnostics", spin=partial(executor.spin_once, 0.05)
            )
            heard(beats)
            wait_until(lambda: heard(beats), "heartbeats", seconds=2.0)
            silent_since = time.monotonic()

            def silent() -> bool:
                nonlocal silent_since
                if heard(beats):
                    silent_since = time.monotonic()
                return time.monotonic() - silent_since > 1.0

            wait_until(silent, "their end", seconds=20.0)
            executor.remove_node(node)
            executor.shutdown()
    finally:
        node.destroy_node()
        observer.destroy_node()
        rclpy.shutdown(context=context)


@contextmanager
def plain_node(ros_domain: int, **overrides: Any) -> Iterator[Any]:
    from rclpy.parameter import Parameter

    from finger_common.node import ManagedNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    given = [Parameter(name.replace("__", "."), value=value) for name, value in overrides.items()]
    node = ManagedNode(context=context, parameter_overrides=given)
    try:
        assert node.bring_up()
        yield node
    finally:
        node.release()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_misspelt_parameter_is_named_with_the_one_that_was_meant(
    ros_domain: int, capfd: pytest.CaptureFixture[str]
) -> None:
    good = {"use_sim_time": False, "qos_overrides__/value__publisher__depth": 3}
    with plain_node(ros_domain, qos_dephts=5, qos_depth=7, **good):
        pass
    said = [line for line in capfd.readouterr().err.splitlines() if "does not exist" in line]
    assert len(said) == 1, said
    assert "parameter 'qos_dephts' does not exist here; did you mean 'qos_depth'?" in said[0]


def test_qos_overrides_reach_streams_that_are_polled(ros_domain: int) -> None:
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    reliable = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
    override = {"qos_overrides__/a__subscription__reliability": "reliable"}
    with plain_node(ros_domain, **override) as node:

        def effective(topic: str, qos: QoSProfile) -> ReliabilityPolicy:
            polled = node.create_polled_subscription(Float64, topic, qos)
            (info,) = node.get_subscriptions_info_by_topic(topic)
            assert polled.qos.reliability == info.qos_profile.reliability
            polled.destroy()
            return info.qos_profile.reliability

        assert effective("/a", best_effort) == ReliabilityPolicy.RELIABLE
        # The node's own choice may change from subscription to subscription.
        chosen = [effective("/b", qos) for qos in (best_effort, reliable)]
        assert chosen == [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE]


def test_publishers_of_a_remapped_topic_are_counted(ros_domain: int) -> None:
    from std_msgs.msg import Float64

    from finger_common.node import ManagedNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    remapped = ["--ros-args", "-r", "image:=/robot/image"]
    node = ManagedNode(context=context, cli_args=remapped, namespace="/hand/thumb")
    other = rclpy.create_node("camera", context=context)
    try:
        assert node.count_publishers("image") == 0
        other.create_publisher(Float64, "/robot/image", 10)
        wait_until(lambda: node.count_publishers("image") == 1, "the publisher")
        assert node.count_publishers("/robot/image") == 1
    finally:
        other.destroy_node()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_publisher_of_another_type_is_named_until_it_is_gone(ros_domain: int) -> None:
    """Nothing of it arrives, whatever the QoS, and the middleware says nothing."""
    from geometry_msgs.msg import Wrench, WrenchStamped

    from finger_common.diagnostics import Health
    from finger_common.node import ManagedNode

    # Of two processes: within one the middleware refuses the second type.
    contexts = [rclpy.Context() for _ in range(2)]
    for context in contexts:
        rclpy.init(context=context, domain_id=ros_domain)
    remapped = ["--ros-args", "-r", "wrench:=/wrist/wrench"]
    node = ManagedNode(context=contexts[0], cli_args=remapped, namespace="/finger")
    node.healths = [Health("node")]
    node.create_subscription(WrenchStamped, "wrench", lambda message: None, 10)
    robot = rclpy.create_node("robot", context=contexts[1])

    def told() -> str:
        node.publish_diagnostics()
        return node.healths[0].report().message

    try:
        assert "published" not in told()
        good = robot.create_publisher(WrenchStamped, "/wrist/wrench", 10)
        wait_until(lambda: node.count_publishers("wrench") == 1, "the publisher")
        assert "published" not in told()
        robot.destroy_publisher(good)
        other = robot.create_publisher(Wrench, "/wrist/wrench", 10)
        says = (
            "'/wrist/wrench' is published by /robot as geometry_msgs/msg/Wrench, and nothing of "
            "that is received: publish geometry_msgs/msg/WrenchStamped"
        )
        wait_until(lambda: says in told(), "the warning")
        robot.destroy_publisher(other)
        wait_until(lambda: "published" not in told(), "its end")
    finally:
        robot.destroy_node()
        node.destroy_node()
        for context in contexts:
            rclpy.shutdown(context=context)


def test_a_simulated_time_that_does_not_begin_is_told_until_it_does(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rclpy.executors import SingleThreadedExecutor
    from rosgraph_msgs.msg import Clock

    from finger_common.diagnostics import Health
    from finger_common.node import ManagedNode, stream_watch

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    simulated = ["--ros-args", "-p", "use_sim_time:=true"]
    node = ManagedNode(context=context, cli_args=simulated)
    player = rclpy.create_node("player", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.healths = [Health("node")]

    def told() -> str:
        node.publish_diagnostics()
        return node.healths[0].report().message

    try:
        monkeypatch.setattr(stream_watch, "PATIENCE", 0.0)
        assert not any("/clock" in told() for _ in range(2)), "a replay begins when it is active"
        assert node.bring_up()
        assert "/clock" not in told(), "what publishes it may be starting"
        assert "use_sim_time is true, and no time comes on /clock" in told()
        clock = player.create_publisher(Clock, "/clock", 10)
        second = Clock()
        second.clock.sec = 1

        def spin() -> None:
            clock.publish(second)
            executor.spin_once(timeout_sec=0.05)

        wait_until(lambda: "/clock" not in told(), "simulated time", spin=spin)
    finally:
        executor.shutdown()
        player.destroy_node()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_publisher_whose_node_is_not_known_is_called_unnamed(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from types import SimpleNamespace

    from finger_common.node import ManagedNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = ManagedNode(context=context)
    names = ("/hand", "driver"), ("/", "peer"), ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_")
    found = [SimpleNamespace(node_namespace=space, node_name=name) for space, name in names]
    monkeypatch.setattr(node, "get_publishers_info_by_topic", lambda topic: found)
    try:
        assert node.publishers_of("wrench") == ["/hand/driver", "/peer", "an unnamed node"]
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_what_a_node_made_ends_with_the_state_it_was_made_for(ros_domain: int) -> None:
    from rclpy.parameter import Parameter
    from rclpy.qos import QoSProfile
    from std_msgs.msg import Float64
    from std_srvs.srv import Trigger

    from finger_common.node import Jobs, ManagedNode

    class Maker(ManagedNode):
        def configure(self) -> None:
            qos = QoSProfile(depth=5)
            self.closed: list[str] = []
            for name in "ab":
                self.closing.callback(self.closed.append, name)
            self.create_publisher(Float64, "value", qos)
            self.create_service(Trigger, "~/trigger", lambda request, response: response)
            self.create_client(Trigger, "trigger")
            self.waited = self.create_waited_subscription(Float64, "waited", print, qos)
            self.polled = self.create_polled_subscription(Float64, "polled", qos)
            self.polled.destroy()  # one that the node ends itself
            self.polled = self.create_polled_subscription(Float64, "polled", qos)

        def activate(self) -> None:
            self.jobs = Jobs(self)
            self.create_steady_timer(1.0, lambda: None)
            self.create_polled_subscription(Float64, "read", QoSProfile(depth=5))

        def deactivate(self) -> None:
            self.destroy_active_interfaces()

        def cleanup(self) -> None:
            assert not self.closed and next(self.services), "all is still there"
            self.farewell = self.create_steady_timer(1.0, lambda: None)

    def made(node: Any) -> list[Any]:
        kinds = ("publishers", "subscriptions", "services", "clients", "timers", "guards")
        return [entity for kind in kinds for entity in getattr(node, kind)]

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = Maker(context=context)
    try:
        fresh = made(node)
        assert node.trigger_configure().name == "SUCCESS"
        inactive = made(node)
        assert len(inactive) == len(fresh) + 5
        for _ in range(2):
            assert node.trigger_activate().name == "SUCCESS"
            assert len(made(node)) == len(inactive) + 3
            assert node.trigger_deactivate().name == "SUCCESS"
            assert made(node) == inactive
        # Simulated time is rclpy's own affair.
        node.set_parameters([Parameter("use_sim_time", value=True)])
        (clock,) = set(made(node)) - set(inactive)
        assert node.trigger_cleanup().name == "SUCCESS"
        assert set(made(node)) - set(fresh) == {clock, node.farewell}
        assert node.closed == ["b", "a"]
        # Streams of their own kind have ended wholly.
        for polled in (node.polled, node.waited.polled):
            with pytest.raises(Exception, match="destruction"):
                list(polled.take())
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_jobs_are_done_in_order_in_the_thread_of_the_node_and_refused_after_its_end(
    ros_domain: int,
) -> None:
    import threading

    from finger_common.errors import DeviceError
    from finger_common.node import Jobs

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("worker", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    jobs, done = Jobs(node), []

    def work(number: int) -> int:
        done.append(threading.current_thread())
        return 1 // number

    def ask() -> None:
        futures.extend(jobs.call(partial(work, number)) for number in (1, 0, 2))

    try:
        futures: list[Any] = []
        asking = threading.Thread(target=ask)
        asking.start()
        wait_until(
            lambda: len(done) == 3, "all jobs", spin=lambda: executor.spin_once(timeout_sec=0.05)
        )
        asking.join()
        assert set(done) == {threading.current_thread()}
        assert futures[0].result() == 1 and futures[2].result() == 0
        with pytest.raises(ZeroDivisionError):
            futures[1].result()
        given_up, waiting = jobs.call(partial(work, 1)), jobs.call(partial(work, 1))
        assert given_up.cancel()
        jobs.close()
        for late in (waiting, jobs.call(partial(work, 1))):
            with pytest.raises(DeviceError, match="ending"):
                late.result(0)
        assert len(done) == 3 and not list(node.guards)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_what_nodes_share_ends_with_their_context_and_is_forgotten(ros_domain: int) -> None:
    import gc
    import weakref

    from finger_common.node.heartbeat import Heartbeats
    from finger_common.node.shared import SharedInContext

    def context_that_ended() -> Any:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=ros_domain)
        shared = Heartbeats.of(context)
        assert Heartbeats.of(context) is shared
        rclpy.shutdown(context=context)
        assert not shared._thread.is_alive()
        return weakref.ref(context)

    ended = [context_that_ended() for _ in range(3)]
    gc.collect()
    assert [context() for context in ended[:2]] == [None, None]
    assert sum(key[1] is ended[2]() for key in SharedInContext._all) == 1
