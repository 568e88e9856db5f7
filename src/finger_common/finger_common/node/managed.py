# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The lifecycle node that every node of the suite derives from.

`ManagedNode` declares the parameters of its `Settings` classes with types and ranges, refuses bad
values with a reason, publishes `/diagnostics` at 1 Hz and its name on `heartbeat` at 4 Hz, brings
itself up when `autostart` is true, and turns errors of the core into failed transitions with one
sentence in the log. A node overrides `configure`, `activate`, `deactivate` and `cleanup`, which
raise a FingerError to refuse. What of ROS it made since `configure` is destroyed after `cleanup`.
"""

from __future__ import annotations

import copy
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.time_source import CLOCK_TOPIC
from std_msgs.msg import String

from ..cli import one_line
from ..diagnostics import ERROR, WARN, Health, full_node_name
from ..errors import FingerError, InputError, known_names
from ..host_clock import HostClock
from ..parameters import NOT_HERE, ParameterTable
from ..plugins import PluginKind
from ..settings import S, Settings, parameters_of, setting
from .described import descriptor_of, ros_value, type_of
from .heartbeat import HEARTBEAT, Heartbeats
from .polling import PolledSubscription
from .qos import AUTO, BEST_EFFORT, RELIABLE, stream_qos
from .stream_watch import StreamWatch, publisher_name
from .waiting import WaitedSubscription

BEATS_PER_SECOND = round(1.0 / HEARTBEAT)

HANGING = 2.5
"""s without a callback after which a node's heart stops: its diagnostics alone come each second."""

QOS_OVERRIDES = "qos_overrides."
OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)
"""Policies of streams that `qos_overrides.TOPIC.publisher.…` and `.subscription.…` change."""


@dataclass(frozen=True)
class NodeSettings(Settings):
    """Parameters of every node of the suite."""

    autostart: bool = setting(
        True,
        "Configure and activate at start; false where a launch file or manager brings the node up.",
    )
    qos_reliability: str = setting(
        AUTO,
        "Reliability of the node's streams; auto publishes reliably and subscribes with best "
        "effort, which connects with every other node.",
        choices=(AUTO, RELIABLE, BEST_EFFORT),
        advice="qos_overrides changes single topics. A reliable subscriber never connects to a "
        "best-effort publisher.",
    )
    qos_depth: int = setting(
        200, "Samples a stream keeps for a slow reader.", minimum=1, maximum=100000
    )


@dataclass(frozen=True)
class FrameSettings(Settings):
    """Parameter of nodes that name frames."""

    frame_prefix: str = setting(
        "",
        "Put before every frame name, such as 'thumb/', so that the frames of several fingers "
        "differ; the parameter of the same name of robot_state_publisher.",
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
    ONE_TASK = False
    """Whether the node does one thing and ends, as a command does."""

    @classmethod
    def parameter_table(cls) -> ParameterTable:
        """Parameters of every node, then those of its plugins, then the node's own."""
        plugins: tuple[type[Settings], ...] = ()
        if cls.PLUGINS is not None:
            plugins = cls.PLUGINS.settings(NodeSettings, *cls.SETTINGS)
        return parameters_of(NodeSettings, *plugins, *cls.SETTINGS)

    def __init__(self, **options: Any) -> None:
        try:
            super().__init__(self.NAME, **options)
        except InvalidParameterTypeException as error:
            # Of a parameter of ROS itself, such as use_sim_time.
            raise InputError(f"{one_line(error)}; correct the parameter") from None
        self.healths: list[Health] = []
        self.values: dict[str, Any] = {}
        self.exit_code = 0
        """Of the node's process when a signal ends it."""
        self.refused: FingerError | None = None
        """Why the newest transition that failed did."""
        self.interrupted: Callable[[], bool] = lambda: False
        """Whether a signal has interrupted what the node did; an error is of that."""
        self.closing = ExitStack()
        """Closes, after `cleanup`, what `configure` opened that is no interface of ROS."""
        self._live = False
        self._active = False
        self._ends: dict[Any, Callable[[], Any]] = {}
        """How subscriptions end that have more to end than themselves."""
        self._all = self.parameter_table()
        self._bad_values: dict[str, str] = {}
        for parameter in self._all:
            self.declare_parameter(
                parameter.name, type_of(parameter), descriptor_of(parameter), ignore_override=True
            )
            override = self._parameter_overrides.get(parameter.name)
            try:
                given = parameter.default if override is None else override.value
                if given is None and isinstance(parameter.default, list):
                    given = []  # as ROS reads [] of a file
                value = ros_value(parameter, given)
            except InputError as error:
                # The node stays up, so that the value can be corrected.
                self._bad_values[parameter.name] = str(error)
                value = ros_value(parameter, parameter.default)
            super().set_parameters_atomically([value])
        self._warn_of_unknown()
        self.host_clock = HostClock()
        """Host time without the steps of the system clock; renewed at every configure."""
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._stream_watch = StreamWatch(self)
        self._unconfigured: set[Any] = set()
        self._inactive: set[Any] = set()
        """Interfaces that the node had before it was configured, and before it was activated."""
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._heartbeat = self.create_publisher(String, "heartbeat", 10)
        self._beats = 0
        self._served = time.monotonic()
        self._second: tuple[Any, Any] = (None, None)
        self._heartbeats = Heartbeats.of(self.context)
        self._heartbeats.add(self._beat)

    # What a node overrides -------------------------------------------------------------------

    def configure(self) -> None:
        """Connect and check; raises FingerError to refuse."""

    def activate(self) -> None:
        """Begin to publish; raises FingerError to refuse."""

    def deactivate(self) -> None:
        """Stop publishing; the source stays connected."""

    def cleanup(self) -> None:
        """Release what `configure` took and neither `closing` closes nor is an interface of ROS.

        Also called after a failed `configure`. An interface that is made here stays.
        """

    def parameters_changed(self, changes: dict[str, Any]) -> None:
        """Take over changed run-time parameters; raises FingerError to refuse all of them."""

    @property
    def answering(self) -> bool:
        """Whether somebody waits for an answer, for which the process stays up a moment."""
        return False

    def sample_time(self) -> int:
        """Time (ns) on the clock that stamps samples: the host's, which steps of the system clock
        do not reach from `configure` on, or the simulated one."""
        if self.get_parameter("use_sim_time").value:
            return int(self.get_clock().now().nanoseconds)
        return self.host_clock.now()

    # Parameters ------------------------------------------------------------------------------

    def _warn_of_unknown(self) -> None:
        """Name given parameters that neither the node nor ROS has: a misspelt one has no effect."""
        for name in self._parameter_overrides:
            if not (name.startswith(QOS_OVERRIDES) or self.has_parameter(name)):
                self.get_logger().warning(self._no_such_parameter(name))

    def _no_such_parameter(self, name: str) -> str:
        known = known_names(name, (parameter.name for parameter in self._all))
        return f"{NOT_HERE.format(name)}; {known}"

    def read_parameters(self) -> dict[str, Any]:
        """Checked values of all parameters; raises InputError."""
        for problem in self._bad_values.values():
            raise InputError(problem)
        return self._all.check({p.name: self.get_parameter(p.name).value for p in self._all})

    def settings(self, cls: type[S]) -> S:
        """The parameters that `cls` describes, with changes made while the node is active."""
        return cls.select(self.values)

    @property
    def frame(self) -> str:
        """Frame of the node's messages, of the parameters `frame_prefix` and `frame_id`."""
        return f"{self.values['frame_prefix']}{self.values['frame_id']}"

    def set_parameters_atomically(
        self, parameter_list: Sequence[RosParameter]
    ) -> SetParametersResult:
        """As rclpy; refuses in our words, before rclpy looks at type and range in its own."""
        try:
            checked = [self._checked(parameter) for parameter in parameter_list]
        except InputError as error:
            return SetParametersResult(successful=False, reason=one_line(error))
        return super().set_parameters_atomically(checked)

    def _checked(self, parameter: RosParameter) -> RosParameter:
        if not self.has_parameter(parameter.name):
            raise InputError(self._no_such_parameter(parameter.name))
        if parameter.name not in self._all:
            return parameter
        described = self._all[parameter.name]
        value = ros_value(described, parameter.value)
        if self._live and not described.runtime:
            raise InputError(
                f"parameter '{described.name}' can be changed only before the node is "
                "configured; deactivate and clean up first"
            )
        return value

    def _on_set_parameters(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            own = [self._checked(p) for p in parameters if p.name in self._all]
            changes = {p.name: p.value for p in own}
            if self._live and changes:
                self.parameters_changed(changes)
                self.values.update(changes)
            for name in changes:
                self._bad_values.pop(name, None)
        except FingerError as error:
            return SetParametersResult(successful=False, reason=one_line(error))
        return SetParametersResult(successful=True)

    def _describe_live(self, live: bool) -> None:
        """Mark what can no longer be changed as read-only for tools that show parameters."""
        self._live = live
        for parameter in self._all:
            self.describe_parameter(parameter.name).read_only = live and not parameter.runtime

    # Quality of service ----------------------------------------------------------------------

    def stream_qos(self, depth: int | None = None, publisher: bool = False) -> QoSProfile:
        """QoS of a data stream that the node publishes or reads, by its parameters."""
        depth = depth or self.values["qos_depth"]
        return stream_qos(self.values["qos_reliability"], depth, publisher)

    def create_stream_publisher(self, message_type: Any, topic: str, qos: QoSProfile) -> Any:
        """Publisher that reports subscribers whose QoS is incompatible, and other publishers."""
        # A probe that wants another QoS harms nobody else: no fault of the node.
        events = PublisherEventCallbacks(
            incompatible_qos=lambda event: self.get_logger().warning(
                f"a subscriber of '{topic}' wants another QoS and receives nothing; "
                f"qos_overrides.{publisher.topic_name}.publisher can offer it"
            )
        )
        publisher = self._with_overrides(
            self.create_publisher, message_type, topic, copy.copy(qos), event_callbacks=events
        )
        self._stream_watch.published.append(publisher)
        return publisher

    def create_stream_subscription(
        self,
        message_type: Any,
        topic: str,
        callback: Any,
        qos: QoSProfile,
        message_lost: Callable[[Any], None] | None = None,
        **options: Any,
    ) -> Any:
        """Subscription that reports publishers whose QoS is incompatible.

        message_lost: called with the middleware's event when it has lost some.
        """
        qos = copy.copy(qos)
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._stream_watch.report_mismatch(topic, qos),
            message_lost=message_lost,
        )
        return self._with_overrides(
            self.create_subscription,
            message_type,
            topic,
            callback,
            qos,
            event_callbacks=events,
            **options,
        )

    def create_waited_subscription(
        self, message_type: Any, topic: str, callback: Any, qos: QoSProfile
    ) -> WaitedSubscription:
        """As `create_stream_subscription`, but `callback` is called in a thread of the process.

        It costs a small part of a round of the executor. It ends with `destroy`.
        """
        polled = self.create_polled_subscription(message_type, topic, qos)
        self._stream_watch.polled.append(polled)
        waited = WaitedSubscription(self, polled, callback, self.fail)
        self._ends[polled.subscription] = waited.destroy
        return waited

    def create_polled_subscription(
        self, message_type: Any, topic: str, qos: QoSProfile, overridable: bool = True
    ) -> PolledSubscription:
        """Subscription that the node reads when it needs its messages. It ends with `destroy`.

        overridable: whether the parameters qos_overrides.… change its QoS.
        """
        create = partial(PolledSubscription, self, unreadable=self._stream_watch.unreadable)
        if overridable:
            # Those of a subscription before it, of another QoS, would be taken for the user's.
            self._forget_overrides(f"{QOS_OVERRIDES}{self.resolve_topic_name(topic)}.subscription.")
            create = partial(self._with_overrides, create)
        polled: PolledSubscription = create(message_type, topic, copy.copy(qos))
        self._ends[polled.subscription] = polled.destroy
        return polled

    def destroy_subscription(self, subscription: Any) -> bool:
        """Destroy a subscription, as rclpy does."""
        self._ends.pop(subscription, None)
        return super().destroy_subscription(subscription)

    def _with_overrides(self, create: Any, *arguments: Any, **options: Any) -> Any:
        """Create a publisher or subscription whose QoS the parameters qos_overrides.… change."""
        overrides = QoSOverridingOptions(OVERRIDABLE)
        try:
            return create(*arguments, qos_overriding_options=overrides, **options)
        except (
            RuntimeError,
            TypeError,
            ValueError,
            AssertionError,
            ParameterException,
        ) as error:
            raise InputError(
                f"qos_overrides of '{arguments[1]}' cannot be used ({one_line(error)}); "
                "give history, depth, reliability and durability as ROS names them"
            ) from None

    def _forget_overrides(self, prefix: str = QOS_OVERRIDES) -> None:
        """They are declared anew with the next streams, whose usual values may be others."""
        found = self.list_parameters([QOS_OVERRIDES.rstrip(".")], 0).names
        for name in [name for name in found if name.startswith(prefix)]:
            self.describe_parameter(name).read_only = False
            self.undeclare_parameter(name)

    def check_mismatch(self, polled: PolledSubscription) -> None:
        """Report publishers of a polled topic whose QoS is incompatible."""
        self._stream_watch.check_mismatch(polled)

    def publishers_of(self, topic_name: str) -> list[str]:
        """Full names of the nodes that publish a topic, once for each publisher."""
        return [publisher_name(info) for info in self.get_publishers_info_by_topic(topic_name)]

    def count_publishers(self, topic_name: str) -> int:
        """Publishers of a topic by the name that it is remapped to, as a subscription has it;
        rclpy's own leaves a remapping out."""
        return int(super().count_publishers(self.resolve_topic_name(topic_name)))

    def expect_one_publisher(self, topic: str, mixes: Callable[[], bool] = lambda: True) -> None:
        """Report it from now on when several publish a topic that this node reads.

        mixes: whether the node takes samples of all of them; else other readers do.
        """
        self._stream_watch.read[self.resolve_topic_name(topic)] = mixes

    # Diagnostics -----------------------------------------------------------------------------

    def not_hanging(self) -> None:
        """For a callback that takes long by intention: the node counts as alive meanwhile."""
        self._served = time.monotonic()

    def _on_second(self) -> None:
        self.not_hanging()
        self.publish_diagnostics()

    def publish_diagnostics(self) -> None:
        """One DiagnosticStatus per health."""
        if not self.healths:
            return
        self._stream_watch.look()
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        for health in self.healths:
            report = health.report()
            if report.news[1]:
                self.log(*report.news)
            array.status.append(
                DiagnosticStatus(
                    level=bytes([report.level]),
                    name=f"{full_node_name(self.get_name(), self.get_namespace())}: {health.name}",
                    message=report.message,
                    hardware_id=report.hardware_id,
                    values=[KeyValue(key=k, value=v) for k, v in report.values.items()],
                )
            )
        self._publish_if_running(self._diagnostics, array)

    def destroy_node(self) -> None:
        """End the node."""
        self._heartbeats.remove(self._beat)
        super().destroy_node()
        # It holds the middleware's participant, whose shared memory would outlive the process.
        vars(self).pop("_state_machine", None)

    def _beat(self) -> None:
        """In the thread of heartbeats, which go on while simulated time stands still or jumps."""
        if time.monotonic() - self._served < HANGING:
            self._publish_if_running(self._heartbeat, String(data=self.get_name()))
        self._beats += 1
        executor = self.executor
        # Diagnostics of several nodes come one after the other, as their heartbeats do.
        if self._beats % BEATS_PER_SECOND == 0 and executor is not None:
            asked, task = self._second
            if asked is not executor or task.done():
                # An executor that was shut down meanwhile takes no task.
                with suppress(AttributeError, rclpy_implementation.InvalidHandle):
                    self._second = executor, executor.create_task(self._on_second)

    def _publish_if_running(self, publisher: Any, message: Any) -> None:
        try:
            publisher.publish(message)
        except Exception:
            if rclpy.ok(context=self.context):
                raise

    def create_steady_timer(self, period: float, callback: Callable[[], None]) -> Any:
        """Timer of a period in s that goes on while simulated time stands still or jumps."""
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def fail(self, error: Exception) -> None:
        """Let an error in another thread count as one in a callback of this node."""

        def raise_error() -> None:
            raise error

        if self.executor is not None:
            self.executor.create_task(raise_error)

    def log_fault(self, health: Health, key: str, message: str, level: int = ERROR) -> None:
        """Note a fault and log it if it is new."""
        if health.fault(key, message, level):
            self.log(level, message)

    def log(self, level: int, message: str) -> None:
        """Log a sentence; level: of `finger_common.diagnostics`, OK for information."""
        logger = self.get_logger()
        if level >= ERROR:
            logger.error(message)
        elif level >= WARN:
            logger.warning(message)
        else:
            logger.info(message)

    # Lifecycle -------------------------------------------------------------------------------

    def bring_up(self) -> bool:
        """Configure and activate; true when both succeeded."""
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            return False
        return self.trigger_activate() == TransitionCallbackReturn.SUCCESS

    @property
    def active(self) -> bool:
        """Whether the node is active."""
        return self._active

    @property
    def autostart(self) -> bool:
        """Whether the node brings itself up."""
        return bool(self.get_parameter("autostart").value)

    def _attempt(self, what: str, *actions: Any) -> bool:
        try:
            for action in actions:
                action()
        except FingerError as error:
            self.refused = error
            self._note_failure(what, one_line(error))
            if not self.ONE_TASK:  # one that ends, and says why
                self.get_logger().error(f"{what} failed: {one_line(error)}")
            return False
        except Exception as error:
            self._note_failure(what, f"{type(error).__name__}: {one_line(error)}")
            if self.interrupted():
                self.get_logger().info(f"{what} was interrupted")
                raise
            # rclpy turns it into a failed transition silently; a defect must be visible.
            self.get_logger().error(f"{what} failed:\n{traceback.format_exc()}")
            raise
        for health in self.healths[:1]:
            health.recovered(what)
        return True

    def _note_failure(self, what: str, reason: str) -> None:
        """Show why a transition failed until it succeeds, also where there is no health yet."""
        self.healths = self.healths or [Health(self.NAME)]
        if reason not in self.healths[0].faults.values():  # a driver names its connection itself
            self.healths[0].fault(what, reason)

    def _set_state(self, state: str) -> None:
        for health in self.healths:
            health.state = state

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        def read() -> None:
            for problem in self.PLUGINS.problems.values() if self.PLUGINS else ():
                self.get_logger().warning(problem)
            self.values = self.read_parameters()
            self.host_clock = HostClock()

        self._unconfigured, configured = set(self._interfaces()), False
        try:
            configured = self._attempt("configure", read, self.configure)
        finally:  # also after a defect of the program, such as one of an outside driver
            if not configured:
                self._attempt("cleanup", self._clean_up)
        if not configured:
            return TransitionCallbackReturn.FAILURE
        self._describe_live(True)
        self._set_state("inactive")
        return TransitionCallbackReturn.SUCCESS

    def _interfaces(self) -> dict[Any, Callable[[], Any]]:
        """What the node has now, and how each is destroyed."""
        clock = self.resolve_topic_name(CLOCK_TOPIC)  # whose subscription is rclpy's own
        inputs = (s for s in self.subscriptions if s.topic_name != clock)
        kinds: tuple[tuple[Iterable[Any], Callable[[Any], Any]], ...] = (
            (self.publishers, self.destroy_publisher),
            (inputs, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.guards, self.destroy_guard_condition),
            (self.timers, self.destroy_timer),
        )
        found = {one: partial(destroy, one) for each, destroy in kinds for one in each}
        return {**found, **self._ends}

    def destroy_active_interfaces(self) -> None:
        """Destroy what was made since `activate` began; for `deactivate`, where that fits."""
        for made, destroy in self._interfaces().items():
            if made not in self._inactive:
                destroy()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._inactive = set(self._interfaces())
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
        self._set_state("unconfigured")
        ok = self._attempt("cleanup", self._clean_up)
        return TransitionCallbackReturn.SUCCESS if ok else TransitionCallbackReturn.ERROR

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.release()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.release()
        self._set_state("unconfigured")
        return TransitionCallbackReturn.SUCCESS

    def _clean_up(self) -> None:
        self._stream_watch = StreamWatch(self)
        with ExitStack() as ending:  # the last one first, each also where one before it fails
            ending.callback(self._describe_live, False)
            ending.callback(self._forget_overrides)
            # What `cleanup` makes, such as a timer for a farewell, outlives it.
            for made, destroy in self._interfaces().items():
                if made not in self._unconfigured:
                    ending.callback(destroy)
            ending.callback(self.closing.close)
            self.cleanup()

    def release(self) -> None:
        """Deactivate and clean up, in any state."""
        if self._live:
            self._live = False
            if self._active:
                self._active = False
                self._attempt("deactivate", self.deactivate)
            self._attempt("cleanup", self._clean_up)
            self._set_state("finalized")

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        # rclpy lets a transition that the present state does not have end the process.
        available = {transition[0] for transition in self._state_machine.available_transitions}
        if not request.transition.label and request.transition.id not in available:
            response.success = False
            return response
        return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
