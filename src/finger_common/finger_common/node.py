"""The rclpy shell that every node of the suite shares.

`ManagedNode` declares the parameters of its `Settings` classes, refuses bad values with a reason, publishes
`/diagnostics` at 1 Hz, brings itself up when `autostart` is true and maps errors of the core to failed transitions with
one sentence in the log. A node overrides `configure`, `activate`, `deactivate` and `cleanup`, which raise a FingerError
to refuse.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from .cli import EXIT_BAD_INPUT, one_line
from .diagnostics import WARN, Health
from .errors import FingerError, InputError
from .parameters import ParameterTable
from .plugins import Plugins
from .settings import S, Settings, parameters_of, setting


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


LATCHED_QOS = QoSProfile(
    depth=10,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""QoS of `model_events`, and of readers that must not miss a message of `trial`: late joiners receive what was said
before, a recorder that begins after the model the events that made it what it is."""

STATE_QOS = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""QoS of publishers of a state, `trial` and the protocol's `status`: late joiners receive the newest alone."""


ENDING = (signal.SIGINT, signal.SIGTERM)
"""Signals that end a node."""


class _NeverExecuted(CallbackGroup):
    """Group of entities that the executor leaves alone."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


POLLED_DEPTH = 200
"""Samples that a polled stream keeps at least, whatever `qos_depth` says: a look comes every 50 ms or so."""


class PolledSubscription:
    """Subscription whose messages a node takes when it wants them, for streams that need no prompt answer.

    A round of the executor costs far more than taking a message. QoS events are asked for in the same way: Fast DDS
    wakes a wait for them again and again while messages lie unread, which would keep a core busy.
    """

    def __init__(self, node: Node, message_type: Any, topic: str, qos: QoSProfile) -> None:
        self.topic = topic
        self._node = node
        self._type = message_type
        self._subscription = node.create_subscription(
            message_type,
            topic,
            lambda message: None,
            qos,
            callback_group=_NeverExecuted(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self._events: dict[QoSSubscriptionEventType, Any] = {}
        for kind in (
            QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
            QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
        ):
            # Not every middleware tells both.
            with suppress(UnsupportedEventTypeError):
                handle = rclpy_implementation.EventHandle(self._subscription.handle, kind)
                self._events[kind] = handle

    def take(self) -> Iterator[tuple[bytes, dict[str, Any]]]:
        """Messages that have come since: serialized, with the middleware's `received_timestamp` and
        `source_timestamp` in ns."""
        while True:
            with self._subscription.handle:
                taken = self._subscription.handle.take_message(self._type, True)
            if taken is None:
                return
            yield taken

    def new_mismatches(self) -> int:
        """Publishers found since the last call whose QoS does not fit."""
        return self._new(QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS)

    def newly_lost(self) -> int:
        """Messages that the middleware lost since the last call."""
        return self._new(QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST)

    def _new(self, kind: QoSSubscriptionEventType) -> int:
        handle = self._events.get(kind)
        if handle is None:
            return 0
        with handle:
            event = handle.take_event()
        return max(event.total_count_change, 0) if event is not None else 0

    def destroy(self) -> None:
        """End the subscription."""
        for handle in self._events.values():
            handle.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)


class ManagedNode(LifecycleNode):
    """Lifecycle node with described parameters, health and autostart.

    Class attributes: SETTINGS (Settings classes that hold the node's own parameters), PLUGINS
    (parameter name -> group of which it chooses a member; the member's attribute SETTINGS, a
    Settings class, adds its parameters) and NAME (default node name).
    `self.values` holds the checked parameters from `configure` on, `self.settings(cls)` the same
    as an instance of one of the classes; `self.healths` lists what `/diagnostics` shows.
    """

    SETTINGS: tuple[type[Settings], ...] = ()
    PLUGINS: Mapping[str, Plugins] = {}
    TABLE: ParameterTable = ParameterTable()
    NAME = "node"

    @classmethod
    def parameter_table(cls, **chosen: str) -> ParameterTable:
        """Parameters of every node, then the node's own, then those of the plugins `chosen`.

        chosen: name of a plugin by parameter, the parameter's default where not given. Raises
        InputError for a plugin that is not installed.
        """
        own = cls._own_table()
        plugins = [
            plugins.load(chosen.get(name, own[name].default)).SETTINGS
            for name, plugins in cls.PLUGINS.items()
        ]
        try:
            return parameters_of(NodeSettings, *cls.settings_classes(), *plugins) + cls.TABLE
        except ValueError as error:
            names = ", ".join(plugin.__name__ for plugin in plugins)
            raise InputError(f"{names}: {error}; rename this setting of the plugin") from None

    @classmethod
    def settings_classes(cls) -> tuple[type[Settings], ...]:
        """SETTINGS; a node that finds further settings when it is made overrides it."""
        return cls.SETTINGS

    @classmethod
    def _own_table(cls) -> ParameterTable:
        return parameters_of(NodeSettings, *cls.settings_classes()) + cls.TABLE

    def __init__(self, **options: Any) -> None:
        super().__init__(self.NAME, **options)
        self.healths: list[Health] = []
        self.values: dict[str, Any] = {}
        self._live = False
        self._active = False
        self._all = ParameterTable()
        self._declare(self._own_table())
        # An unknown plugin is refused by `configure`, so that it can be corrected.
        with suppress(FingerError):
            self._declare_plugins()
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # Steady time: diagnostics go on when simulated time stands still or jumps.
        self._diagnostics_timer = self.create_timer(
            1.0, self.publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

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

    def _declare(self, table: ParameterTable) -> None:
        """Declare the parameters of a table in place of those declared so far."""
        known = list(self._all)
        self._all = ParameterTable()
        for parameter in known:
            if parameter.name not in table or table[parameter.name] != parameter:
                self.undeclare_parameter(parameter.name)
        for parameter in table:
            if not self.has_parameter(parameter.name):
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
        self._all = table

    def _declare_plugins(self) -> None:
        """Declare the parameters of the plugins that the node's parameters name."""
        if self.PLUGINS:
            chosen = {name: str(self.get_parameter(name).value) for name in self.PLUGINS}
            self._declare(self.parameter_table(**chosen))

    def read_parameters(self) -> dict[str, Any]:
        """Checked values of all parameters; raises InputError."""
        self._declare_plugins()
        values = {p.name: self.get_parameter(p.name).value for p in self._all}
        return self._all.check(values)

    def settings(self, cls: type[S]) -> S:
        """The parameters that `cls` describes, as set when the node was configured or changed since."""
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
        """QoS of a data stream, as the node's parameters say."""
        reliable = self.values["qos_reliability"] == "reliable"
        return QoSProfile(
            depth=depth or self.values["qos_depth"],
            history=HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )

    def create_stream_publisher(self, message_type: Any, topic: str, qos: QoSProfile) -> Any:
        """Publisher that reports subscribers whose QoS does not fit."""
        events = PublisherEventCallbacks(
            incompatible_qos=lambda event: self._report_mismatch(topic, "subscriber")
        )
        return self.create_publisher(message_type, topic, qos, event_callbacks=events)

    def create_stream_subscription(
        self, message_type: Any, topic: str, callback: Any, qos: QoSProfile, **options: Any
    ) -> Any:
        """Subscription that reports publishers whose QoS does not fit."""
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._report_mismatch(topic, "publisher")
        )
        return self.create_subscription(
            message_type, topic, callback, qos, event_callbacks=events, **options
        )

    def look_for_mismatch(self, polled: PolledSubscription) -> None:
        """Report publishers of a polled topic whose QoS does not fit."""
        if polled.new_mismatches():
            self._report_mismatch(polled.topic, "publisher")

    def _report_mismatch(self, topic: str, who: str) -> None:
        message = (
            f"a {who} of '{topic}' has a QoS that does not fit and gets or gives no data; "
            "set qos_reliability alike on both sides"
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
        try:
            self._diagnostics.publish(array)
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
                # rclpy turns it into a failed transition without a word; a defect must be seen.
                self.get_logger().error(f"{what} failed:\n{traceback.format_exc()}")
                raise
        return True

    def _set_state(self, state: str) -> None:
        for health in self.healths:
            health.state = state

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        def read() -> None:
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
        """Deactivate and clean up whatever the state."""
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


def use_large_shared_memory() -> None:
    """Let Fast DDS pass whole images through shared memory, unless the environment says how to run it.

    To be called before rclpy.init by a process that publishes images. A transport of one's own in the environment
    (FASTRTPS_DEFAULT_PROFILES_FILE, FASTDDS_BUILTIN_TRANSPORTS) takes precedence.
    """
    if "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
        profile = Path(__file__).with_name("data") / "fastdds.xml"
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))


class _Ending:
    """What SIGINT and SIGTERM do to a node's main thread.

    rclpy's own handlers end the context at once, before a node could say its last word. Here a signal interrupts what
    comes before `spin`; during it, the callback at hand is finished first, unless another signal insists a second later.
    """

    def __init__(self, executor: SingleThreadedExecutor) -> None:
        self._executor = executor
        self._spinning = False
        self._asked: float | None = None
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        for number in ENDING:
            signal.signal(number, self._on_signal)
        # Python's handlers run only when the main thread is back from the middleware.
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=self._wake, args=(reading,), name="signals", daemon=True).start()

    def _on_signal(self, number: int, frame: Any) -> None:
        now = time.monotonic()
        if not self._spinning or (self._asked is not None and now - self._asked > 1.0):
            raise KeyboardInterrupt
        self._asked = self._asked or now

    def _wake(self, reading: int) -> None:
        while os.read(reading, 64):
            self._executor.wake()

    def spin(self) -> None:
        """Serve callbacks until a signal comes."""
        self._spinning = True
        while self._asked is None:
            self._executor.spin_once()


def run_node(node_class: type[ManagedNode], argv: Sequence[str] | None = None) -> int:
    """Run one node until it is told to stop; returns the exit code.

    A configuration that fails leaves the node up, unconfigured, so that parameters can be corrected and the
    transition tried again. SIGINT and SIGTERM end it with the device released.
    """
    use_large_shared_memory()
    try:
        rclpy.init(
            args=list(argv) if argv is not None else None,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except Exception as error:
        print(
            f"{node_class.NAME}: ROS arguments cannot be used ({one_line(error)}); "
            "check the parameter file and --ros-args",
            file=sys.stderr,
        )
        return EXIT_BAD_INPUT
    node: ManagedNode | None = None
    executor = SingleThreadedExecutor()
    ending = _Ending(executor)
    try:
        node = node_class()
        executor.add_node(node)
        if node.autostart:
            node.bring_up()
        ending.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except FingerError as error:
        print(f"{node_class.NAME}: {one_line(error)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    finally:
        # A second Ctrl-C during release would leave devices open.
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.release()
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
    return 0


def main_of(node_class: type[ManagedNode]) -> Any:
    """`main` function of a node's executable."""

    def main(argv: Sequence[str] | None = None) -> None:
        code = run_node(node_class, argv)
        # Daemon threads of the middleware can hang at interpreter exit.
        os._exit(code)

    return main
