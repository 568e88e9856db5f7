# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the three driver nodes share: connecting, reading thread, release, time in diagnostics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.node import FrameSettings, ManagedNode
from finger_common.plugins import PluginKind
from finger_common.retry import Pauses
from finger_common.settings import setting

from .clock import IncreasingStamps, StampStatistics
from .device import Device, DeviceThread
from .shared_polling import Rest


@dataclass(frozen=True)
class DeviceNodeSettings(FrameSettings):
    """Parameters of every driver node, for every device."""

    connect_timeout: float = setting(
        10.0,
        "Time for the device to be found when the node is configured.",
        unit="s",
        minimum=0.0,
        maximum=600.0,
    )
    reconnect_first_pause: float = setting(
        0.25,
        "Pause before the first attempt to reconnect; doubled with each further one.",
        unit="s",
        minimum=0.01,
        maximum=60.0,
    )
    reconnect_longest_pause: float = setting(
        2.0, "Longest pause between attempts to reconnect.", unit="s", minimum=0.01, maximum=600.0
    )


class DeviceNode(ManagedNode):
    """Lifecycle of a node around one device.

    configure connects and checks, activate starts the reading thread, deactivate ends it, cleanup
    releases the device. A node names its PLUGINS (kinds of devices), has settings that derive from
    DeviceNodeSettings and gives `create_interfaces` and `on_sample`.
    """

    PLUGINS: PluginKind[Any]

    device: Device[Any]

    def create_interfaces(self) -> None:
        """Publishers and services, once the device is connected."""
        raise NotImplementedError

    def on_sample(self, sample: Any) -> Rest | None:
        """Publish one sample; called in the reading thread.

        May return a function for what can wait until the samples of other devices that came at the
        same time were taken; it is called in that thread too.
        """
        raise NotImplementedError

    def on_connected_again(self) -> None:
        """The device was lost and is there again; called in its thread, before its next sample."""

    # Lifecycle -------------------------------------------------------------------------------

    _configured = False

    def configure(self) -> None:
        self.device = self.PLUGINS.open(self.values)
        self.closing.callback(self.device.close)
        self.device.log = self.log
        self.healths = [self.device.health]
        self._stamps = IncreasingStamps()
        self._statistics = StampStatistics()
        settings = self.settings(DeviceNodeSettings)
        pauses = Pauses(settings.reconnect_first_pause, settings.reconnect_longest_pause)
        self._thread = DeviceThread(self.device, self._deliver, pauses, self.on_connected_again)
        self.closing.callback(self._thread.stop)
        try:
            self._thread.connect(settings.connect_timeout)
        except DeviceError as error:
            self.device.health.fault("connection", one_line(error), ERROR)
            raise
        self.create_interfaces()
        self._configured = True

    def activate(self) -> None:
        self._thread.start()

    def deactivate(self) -> None:
        if not self._thread.stop():
            raise DeviceError(
                f"the reading thread of the {self.NAME} device does not end; restart the node"
            )

    def cleanup(self) -> None:
        self._configured = False

    # For the nodes ---------------------------------------------------------------------------

    @property
    def reading(self) -> bool:
        """Whether the reading thread runs."""
        return self._configured and self._thread.running

    def accept_stamp(self, stamp_ns: int) -> bool:
        """Whether a sample may be published: stamps never go back. A refused one is counted."""
        if self._stamps.accept(stamp_ns):
            self._statistics.add(stamp_ns)
            return True
        self.device.health.count("backwards")
        return False

    def _deliver(self, sample: Any) -> Rest | None:
        rest = self._unless_ended(self.on_sample, sample)
        return None if rest is None else partial(self._unless_ended, rest)

    def _unless_ended(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except Exception:
            # The context ends before the thread does when the process is ended.
            if self.context.ok():
                raise
        return None

    def publish_diagnostics(self) -> None:
        if self._configured:
            health = self.device.health
            health.notes.update(self._statistics.take_notes())
            warning = self.device.clock.step_warning("stamps")
            self.device.note_if(bool(warning), "clock_step", warning)
        super().publish_diagnostics()
