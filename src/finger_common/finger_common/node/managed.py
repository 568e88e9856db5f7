"""The lifecycle node that every node of the suite derives from.

`ManagedNode` declares the parameters of its `Settings` classes, refuses bad values with a reason,
publishes `/diagnostics` at 1 Hz and its name on `heartbeat` at 4 Hz, brings itself up when
`autostart` is true, and turns errors of the core into failed transitions with one sentence in the
log. A node overrides `configure`, `activate`,
`deactivate` and `cleanup`, which raise a FingerError to refuse.
"""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from ..cli import one_line
from ..diagnostics import WARN, Health
from ..errors import FingerError, InputError
from ..parameters import ParameterTable
from ..plugins import PluginKind
from ..settings import S, Settings, parameters_of, setting
from .polling import PolledSubscription

HEARTBEAT = 0.25
"""s between heartbeats: what no diagnostic at 1 Hz can, they show a dead node within a second."""


@dataclass(frozen=True)
class NodeSettings(Settings):
    """Parameters of every node of the suite."""

    autostart: bool = setting(
        True,
        "Configure and activate at start; false where a launch file or manager brings the node up.",
    )
    qos_reliability: str = setting(
        "best_effort",
        "Reliability of the streams this node publishes and subscribes to.",
        choices=("best_effort", "reliable"),
        advice="A reliable subscriber never connects to a best-effort publisher.",
    )
    qos_depth: int = setting(
        200, "Samples a stream keeps for a slow reader.", minimum=1, maximum=100000
    )


class ManagedNode(LifecycleNode):
    """Lifecycle node with described parameters, health and autostart.

    Class attributes: SETTINGS (Settings classes that hold the node's own parameters), PLUGINS
    (installed parts of which the node uses one; the settings of all of them are parameters too) and
    NAME (default node name).
    `self.values` holds the checked parameters from `configure` on, `self.settings(cls)` the same
    as an instance of one of the classes; `self.healths` lists what `/diagnostics` shows.
    """

    SETTINGS: tuple[type[Settings], ...] = ()
    PLUGINS: PluginKind[Any] | None = None
    NAME = "node"

    @classmethod
    def parameter_table(cls) -> ParameterTable:
        """Parameters of every node, then those of its plugins, then the node's own."""
        plugins: tuple[type[Settings], ...] = ()
        if cls.PLUGINS is not None:
            plugins = cls.PLUGINS.settings(NodeSettings, *cls.SETTINGS)
        return parameters_of(NodeSettings, *plugins, *cls.SETTINGS)

    def __init__(self, **options: Any) -> None:
        super().__init__(self.NAME, **options)
        self.healths: list[Health] = []
        self.values: dict[str, Any] = {}
        self.exit_code = 0
        """Of the node's process when a signal ends it."""
        self._live = False
        self._active = False
        self._all = self.parameter_table()
        for parameter in self._all:
            allowed = parameter.range_text()
            self.declare_parameter(
                parameter.name,
                parameter.default,
                ParameterDescriptor(
                    description=f"{parameter.meaning} {allowed}".strip(),
                    additional_constraints=allowed,
                    dynamic_typing=True,
                ),
            )
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # Steady time: diagnostics continue when simulated time stands still or jumps.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics_timer = self.create_timer(1.0, self.publish_diagnostics, clock=steady)
        self._heartbeat = self.create_publisher(String, "heartbeat", 10)
        self._heartbeat_timer = self.create_timer(HEARTBEAT, self._beat, clock=steady)

    # What a node overrides -------------------------------------------------------------------

    def configure(self) -> None:
        """Connect and check; raises FingerError to refuse."""

    def activate(self) -> None:
        """Begin to publish; raises FingerError to refuse."""

    def deactivate(self) -> None:
        """Stop publishing; the source stays connected."""

    def cleanup(self) -> None:
        """Release everything `configure` took. Also called after a failed `configure`."""

    def parameters_changed(self, changes: dict[str, Any]) -> None:
        """Take over changed run-time parameters; raises FingerError to refuse all of them."""

    # Parameters ------------------------------------------------------------------------------

    def read_parameters(self) -> dict[str, Any]:
        """Checked values of all parameters; raises InputError."""
        values = {p.name: self.get_parameter(p.name).value for p in self._all}
        return self._all.check(values)

    def settings(self, cls: type[S]) -> S:
        """The parameters that `cls` describes, with changes made while the node is active."""
        return cls.select(self.values)

    def _on_set_parameters(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            changes = {}
            for ros_parameter in parameters:
                if ros_parameter.name not in self._all:
                    continue
                described = self._all[ros_parameter.name]
                changes[described.name] = described.check(ros_parameter.value)
                if self._live and not described.runtime:
                    raise InputError(
                        f"parameter '{described.name}' can be changed only before the node is "
                        "configured; deactivate and clean up first"
                    )
            if self._live and changes:
                self.parameters_changed(changes)
                self.values.update(changes)
        except FingerError as error:
            return SetParametersResult(successful=False, reason=one_line(error))
        return SetParametersResult(successful=True)

    # Quality of service ----------------------------------------------------------------------

    def stream_qos(self, depth: int | None = None) -> QoSProfile:
        """QoS of a data stream, by the node's parameters."""
        reliable = self.values["qos_reliability"] == "reliable"
        return QoSProfile(
            depth=depth or self.values["qos_depth"],
            history=HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )

    def create_stream_publisher(self, message_type: Any, topic: str, qos: QoSProfile) -> Any:
        """Publisher that reports subscribers whose QoS is incompatible."""
        events = PublisherEventCallbacks(
            incompatible_qos=lambda event: self._report_mismatch(topic, "subscriber")
        )
        return self.create_publisher(message_type, topic, qos, event_callbacks=events)

    def create_stream_subscription(
        self, message_type: Any, topic: str, callback: Any, qos: QoSProfile, **options: Any
    ) -> Any:
        """Subscription that reports publishers whose QoS is incompatible."""
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._report_mismatch(topic, "publisher")
        )
        return self.create_subscription(
            message_type, topic, callback, qos, event_callbacks=events, **options
        )

    def check_mismatch(self, polled: PolledSubscription) -> None:
        """Report publishers of a polled topic whose QoS is incompatible."""
        if polled.new_mismatches():
            self._report_mismatch(polled.topic, "publisher")

    def _report_mismatch(self, topic: str, who: str) -> None:
        message = (
            f"a {who} of '{topic}' has an incompatible QoS and exchanges no data with this node; "
            "set the same qos_reliability on both sides"
        )
        health = self.healths[0] if self.healths else None
        if health is None or health.fault("qos_mismatch", message, WARN):
            self.get_logger().warning(message)

    # Diagnostics -----------------------------------------------------------------------------

    def publish_diagnostics(self) -> None:
        """One DiagnosticStatus per health."""
        if not self.healths:
            return
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        for health in self.healths:
            report = health.report()
            array.status.append(
                DiagnosticStatus(
                    level=bytes([report.level]),
                    name=f"{self.get_fully_qualified_name().lstrip('/')}: {health.name}",
                    message=report.message,
                    hardware_id=report.hardware_id,
                    values=[KeyValue(key=k, value=v) for k, v in report.values.items()],
                )
            )
        self._publish_if_running(self._diagnostics, array)

    def _beat(self) -> None:
        self._publish_if_running(self._heartbeat, String(data=self.get_name()))

    def _publish_if_running(self, publisher: Any, message: Any) -> None:
        try:
            publisher.publish(message)
        except Exception:
            if rclpy.ok(context=self.context):
                raise

    def log_fault(self, health: Health, key: str, message: str, level: int = 2) -> None:
        """Note a fault and log it if it is new."""
        if health.fault(key, message, level):
            self.get_logger().error(message) if level >= 2 else self.get_logger().warning(message)

    # Lifecycle -------------------------------------------------------------------------------

    def bring_up(self) -> bool:
        """Configure and activate; true when both succeeded."""
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            return False
        return self.trigger_activate() == TransitionCallbackReturn.SUCCESS

    @property
    def autostart(self) -> bool:
        """Whether the node brings itself up."""
        return bool(self.get_parameter("autostart").value)

    def _attempt(self, what: str, *actions: Any) -> bool:
        for action in actions:
            try:
                action()
            except FingerError as error:
                self.get_logger().error(f"{what} failed: {one_line(error)}")
                return False
            except Exception:
                # rclpy turns it into a failed transition silently; a defect must be visible.
                self.get_logger().error(f"{what} failed:\n{traceback.format_exc()}")
                raise
        return True

    def _set_state(self, state: str) -> None:
        for health in self.healths:
            health.state = state

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        def read() -> None:
            for problem in self.PLUGINS.problems.values() if self.PLUGINS else ():
                self.get_logger().warning(problem)
            self.values = self.read_parameters()

        if not self._attempt("configure", read, self.configure):
            self._attempt("cleanup", self.cleanup)
            return TransitionCallbackReturn.FAILURE
        self._live = True
        self._set_state("inactive")
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if not self._attempt("activate", self.activate):
            return TransitionCallbackReturn.FAILURE
        self._active = True
        self._set_state("active")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        self._set_state("inactive")
        if not self._attempt("deactivate", self.deactivate):
            return TransitionCallbackReturn.ERROR
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._live = False
        self._set_state("unconfigured")
        ok = self._attempt("cleanup", self.cleanup)
        return TransitionCallbackReturn.SUCCESS if ok else TransitionCallbackReturn.ERROR

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.release()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.release()
        return TransitionCallbackReturn.SUCCESS

    def release(self) -> None:
        """Deactivate and clean up, in any state."""
        if self._live:
            self._live = False
            if self._active:
                self._active = False
                self._attempt("deactivate", self.deactivate)
            self._attempt("cleanup", self.cleanup)
            self._set_state("finalized")

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        # rclpy lets a transition that the present state does not have end the process.
        available = {transition[0] for transition in self._state_machine.available_transitions}
        if not request.transition.label and request.transition.id not in available:
            response.success = False
            return response
        return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
