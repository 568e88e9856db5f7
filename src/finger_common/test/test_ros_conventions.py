# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What users of ROS expect of every node: parameters, quality of service, publishers counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rcl_interfaces.msg import ParameterType  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from service_calls import call  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402
from waiting import wait_until  # noqa: E402

from finger_common.diagnostics import Health  # noqa: E402
from finger_common.errors import InputError  # noqa: E402
from finger_common.node import ManagedNode, stream_watch  # noqa: E402
from finger_common.settings import Settings, setting  # noqa: E402


@dataclass(frozen=True)
class GaugeSettings(Settings):
    gain: float = setting(1.0, "Gain.", minimum=0.0, maximum=10.0, runtime=True)
    offset: float = setting(0.0, "Offset.", minimum=-1.0)
    count: int = setting(3, "Count.", unit="samples", minimum=1, maximum=9)
    mode: str = setting("a", "Mode.", choices=("a", "b"))
    names: list = setting([""], "Names.", runtime=True)


class Gauge(ManagedNode):
    NAME = "gauge"
    SETTINGS = (GaugeSettings,)

    def configure(self) -> None:
        self.healths = [Health("gauge")]
        self.stream = self.create_stream_publisher(
            Float64, "value", self.stream_qos(publisher=True)
        )
        self.heard: list[float] = []
        self.input = self.create_stream_subscription(
            Float64, "input", lambda m: self.heard.append(m.data), self.stream_qos()
        )

    def cleanup(self) -> None:
        self.destroy_publisher(self.stream)
        self.destroy_subscription(self.input)


class Bench:
    """A gauge in namespace `left` and an observer, served together."""

    def __init__(self, domain: int) -> None:
        self._domain = domain
        self._contexts: list[Any] = []
        self._nodes: list[Any] = []
        self.context = self.new_context()
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.observer = self.add(rclpy.create_node("observer", context=self.context))
        self.reports: list[Any] = []
        self.observer.create_subscription(
            DiagnosticArray, "/diagnostics", lambda m: self.reports.extend(m.status), 10
        )

    def new_context(self) -> Any:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=self._domain)
        self._contexts.append(context)
        return context

    def add(self, node: Any) -> Any:
        self.executor.add_node(node)
        self._nodes.append(node)
        return node

    def gauge(self, **values: Any) -> Gauge:
        overrides = [Parameter(name, value=v) for name, v in values.items()]
        return self.add(
            Gauge(context=self.context, namespace="left", parameter_overrides=overrides)
        )

    def until(self, condition: Callable[[], Any], what: str = "an answer of the node") -> Any:
        return wait_until(condition, what, spin=partial(self.executor.spin_once, timeout_sec=0.05))

    def call(self, kind: Any, service: str, request: Any) -> Any:
        return call(self.observer, kind, service, request, self.until)

    def describe(self, *names: str) -> list[Any]:
        request = DescribeParameters.Request(names=list(names))
        return self.call(DescribeParameters, "/left/gauge/describe_parameters", request).descriptors

    def set(self, name: str, value: Any) -> Any:
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.call(SetParameters, "/left/gauge/set_parameters", request).results[0]

    def level(self, gauge: Gauge) -> int:
        """Level of the next diagnostics of the gauge."""
        self.reports.clear()
        self.until(lambda: self.reports)
        assert self.reports[0].name == "left/gauge: gauge"
        return int(self.reports[0].level[0])

    def close(self) -> None:
        self.executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        for context in self._contexts:
            rclpy.shutdown(context=context)


@pytest.fixture
def bench(ros_domain: int) -> Iterator[Bench]:
    made = Bench(ros_domain)
    yield made
    made.close()


def test_parameters_have_types_and_ranges_and_are_read_only_while_they_cannot_change(
    bench: Bench,
) -> None:
    gauge = bench.gauge()
    gain, offset, count, mode = bench.describe("gain", "offset", "count", "mode")
    assert gain.type == ParameterType.PARAMETER_DOUBLE and not gain.dynamic_typing
    limits = gain.floating_point_range[0]
    assert (limits.from_value, limits.to_value) == (0.0, 10.0)
    limits = offset.floating_point_range[0]
    assert limits.from_value == -1.0 and limits.to_value > 1e300
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 9)
    assert "samples" in count.additional_constraints
    assert mode.type == ParameterType.PARAMETER_STRING and "a, b" in mode.description
    assert not any(d.read_only for d in (gain, count, mode))
    assert gauge.bring_up()
    assert [d.read_only for d in bench.describe("gain", "count", "names")] == [False, True, False]
    refused = bench.set("count", 4)
    assert not refused.successful and "clean up first" in refused.reason
    gauge.trigger_deactivate()
    gauge.trigger_cleanup()
    assert not bench.describe("count")[0].read_only
    assert bench.set("count", 4).successful


def test_a_refused_value_leaves_type_and_value(bench: Bench) -> None:
    gauge = bench.gauge()
    assert gauge.bring_up()
    for name, value, says in (
        ("gain", "much", "number is needed"),
        ("gain", 11.0, "0 … 10"),
        ("gain", None, "number is needed"),
        ("mode", 3, "text is needed"),
        ("names", 3.0, "list is needed"),
        ("names", [1, 2], "holds 1, text is needed; put it in quotes"),
    ):
        refused = bench.set(name, value)
        assert not refused.successful and says in refused.reason, refused.reason
    refused = bench.set("gian", 3.0)
    assert not refused.successful
    assert refused.reason.startswith("parameter 'gian' does not exist here; did you mean 'gain'?")
    assert bench.describe("gain")[0].type == ParameterType.PARAMETER_DOUBLE
    assert gauge.get_parameter("gain").value == 1.0
    # A whole number is a number: it is taken, and the parameter stays one of type double.
    assert bench.set("gain", 3).successful
    assert gauge.get_parameter("gain").type_ is Parameter.Type.DOUBLE
    assert gauge.values["gain"] == 3.0
    assert bench.set("names", []).successful
    assert gauge.get_parameter("names").type_ is Parameter.Type.STRING_ARRAY


def test_an_empty_list_in_a_parameter_file_is_an_empty_list(bench: Bench, tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("/**/gauge:\n  ros__parameters: {names: []}\n")
    arguments = ["--ros-args", "--params-file", str(file)]
    gauge = bench.add(Gauge(context=bench.context, cli_args=arguments))
    assert gauge.bring_up() and gauge.values["names"] == []


def test_a_bad_value_at_start_leaves_the_node_up_until_it_is_corrected(bench: Bench) -> None:
    gauge = bench.gauge(gain=2, count=99, names=[True])
    refused = bench.set("names", [2])
    assert not refused.successful and "text is needed" in refused.reason
    assert bench.set("names", []).successful
    assert gauge.get_parameter("gain").value == 2.0
    assert gauge.get_parameter("names").value == []
    assert not gauge.bring_up()
    with pytest.raises(Exception, match=r"'count' is 99, outside 1 … 9 samples"):
        gauge.read_parameters()
    # Diagnostics say why the node does not run, until it does.
    assert bench.level(gauge) == 2
    assert "'count' is 99, outside 1 … 9 samples" in bench.reports[0].message
    assert bench.set("count", 9).successful
    assert gauge.bring_up() and gauge.values["count"] == 9
    assert bench.level(gauge) == 0


@pytest.mark.parametrize(
    ("step", "defect"),
    [
        ("configure", InputError("plug it in")),
        ("configure", ZeroDivisionError("plug it in")),
        ("activate", ZeroDivisionError("plug it in")),
    ],
)
def test_why_a_transition_failed_stays_in_the_health_until_it_succeeds(
    bench: Bench, step: str, defect: Exception
) -> None:
    class Unplugged(ManagedNode):
        NAME = "gauge"

        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            self.failing = step
            self.healths = [Health("gauge")]  # one that lives as long as the node

        def _pass(self, step: str) -> None:
            if self.failing == step:
                raise defect

        def configure(self) -> None:
            self._pass("configure")

        def activate(self) -> None:
            self._pass("activate")

    node = bench.add(Unplugged(context=bench.context, namespace="left"))
    assert not node.bring_up()
    report = node.healths[0].report()
    assert report.level == 2 and "plug it in" in report.message
    node.failing = ""
    assert node.bring_up() and node.healths[0].report().level == 0


RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_reliable_and_best_effort_readers_and_writers_connect_and_a_probe_is_no_fault(
    bench: Bench,
) -> None:
    gauge = bench.gauge()
    assert gauge.bring_up()
    heard: dict[str, list[float]] = {"reliable": [], "best effort": [], "latched": []}
    for name, qos in zip(heard, (RELIABLE, BEST_EFFORT, LATCHED)):
        bench.observer.create_subscription(
            Float64, "/left/value", lambda m, name=name: heard[name].append(m.data), qos
        )
    bench.until(lambda: gauge.stream.get_subscription_count() == 2)

    def both() -> bool:
        gauge.stream.publish(Float64(data=1.0))
        return bool(heard["reliable"] and heard["best effort"])

    bench.until(both)
    writers = [
        bench.observer.create_publisher(Float64, "/left/input", q) for q in (RELIABLE, BEST_EFFORT)
    ]

    def all_heard() -> bool:
        for number, writer in enumerate(writers):
            writer.publish(Float64(data=float(number)))
        return {0.0, 1.0} <= set(gauge.heard)

    bench.until(all_heard)
    # The latched reader wants what a sensor stream does not offer: nobody's fault but its own.
    assert bench.level(gauge) == 0
    assert not heard["latched"]


def test_qos_overrides_change_one_topic(bench: Bench) -> None:
    gauge = bench.gauge(
        **{
            "qos_overrides./left/value.publisher.durability": "transient_local",
            "qos_overrides./left/value.publisher.depth": 2,
        },
    )
    assert gauge.bring_up()
    for number in range(5):
        gauge.stream.publish(Float64(data=float(number)))
    heard: list[float] = []
    bench.observer.create_subscription(
        Float64, "/left/value", lambda m: heard.append(m.data), LATCHED
    )
    bench.until(lambda: len(heard) == 2)
    assert heard == [3.0, 4.0]
    info = bench.observer.get_publishers_info_by_topic("/left/value")[0].qos_profile
    assert info.durability is DurabilityPolicy.TRANSIENT_LOCAL
    # What is not overridden follows the node's parameters, also at the next configuration.
    gauge.trigger_deactivate()
    gauge.trigger_cleanup()
    assert bench.set("qos_reliability", "best_effort").successful
    assert gauge.bring_up()
    assert gauge.stream.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
    assert gauge.stream.qos_profile.depth == 2


def test_a_bad_qos_override_refuses_the_configuration(bench: Bench) -> None:
    gauge = bench.gauge(**{"qos_overrides./left/value.publisher.reliability": "hopeful"})
    assert not gauge.bring_up()
    assert gauge.get_parameter("gain").value == 1.0


def test_what_a_failed_configuration_made_is_gone(bench: Bench) -> None:
    """It is tried again and again while a rig comes up."""

    class HalfMade(Gauge):
        def cleanup(self) -> None:
            pass

    override = Parameter("qos_overrides./left/input.subscription.reliability", value="hopeful")
    gauge = HalfMade(context=bench.context, namespace="left", parameter_overrides=[override])
    bench.add(gauge)
    topics = [publisher.topic_name for publisher in gauge.publishers]
    for _ in range(3):
        assert not gauge.bring_up()
    assert [publisher.topic_name for publisher in gauge.publishers] == topics


def test_a_publisher_that_does_not_fit_is_a_warning_until_it_is_gone(bench: Bench) -> None:
    gauge = bench.gauge(qos_reliability="reliable")
    assert gauge.bring_up()
    writer = bench.observer.create_publisher(Float64, "/left/input", BEST_EFFORT)
    bench.until(lambda: "qos_mismatch" in gauge.healths[0].faults)
    said = gauge.healths[0].faults["qos_mismatch"]
    assert "'input' has another reliability" in said and "qos_reliability alike" in said
    bench.observer.destroy_publisher(writer)
    bench.until(lambda: "qos_mismatch" not in gauge.healths[0].faults)


def test_a_second_publisher_of_a_stream_is_an_error_and_a_restarted_node_is_not(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    gauge = bench.gauge()
    assert gauge.bring_up()
    assert bench.level(gauge) == 0
    writer = bench.observer.create_publisher(Float64, "/left/value", RELIABLE)
    bench.until(lambda: "second_publisher" in gauge.healths[0].faults)
    assert "/observer (/left/value)" in gauge.healths[0].faults["second_publisher"]
    assert bench.level(gauge) == 2
    bench.observer.destroy_publisher(writer)
    bench.until(lambda: "second_publisher" not in gauge.healths[0].faults)
    # Two of one name: at first it may be what a killed process left behind.
    twin = bench.add(Gauge(context=bench.new_context(), namespace="left"))
    assert twin.bring_up()
    bench.until(lambda: gauge.count_publishers("value") == 2)
    assert bench.level(gauge) == 0
    monkeypatch.setattr(stream_watch, "REMEMBERED", 0.5)
    bench.until(lambda: "second_publisher" in gauge.healths[0].faults)
    assert "another /left/gauge" in gauge.healths[0].faults["second_publisher"]


def test_a_second_node_of_a_name_that_publishes_no_stream_is_an_error(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two recorders: a request goes to both, and the answer is that of either."""

    class Silent(ManagedNode):
        NAME = "silent"

        def configure(self) -> None:
            self.healths = [Health("silent")]

    def made(context: Any, namespace: str) -> Silent:
        node = bench.add(Silent(context=context, namespace=namespace))
        assert node.bring_up()
        return node

    monkeypatch.setattr(stream_watch, "REMEMBERED", 0.5)
    first = made(bench.context, "left")
    made(bench.new_context(), "right")
    bench.gauge()  # of the same namespace, with the same topic of heartbeats
    twin = made(bench.new_context(), "left")
    health = first.healths[0]
    bench.until(lambda: "another /left/silent runs" in health.faults.get("namesake", ""))
    assert health.report().level == 2
    bench.executor.remove_node(twin)
    twin.destroy_node()
    bench.until(lambda: "namesake" not in health.faults)
