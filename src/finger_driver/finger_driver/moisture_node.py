# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node `moisture`: publishes `moisture` for each reading, also those that the operator enters.

Stamps of one source increase. A table that is saved after a reading was entered may hold earlier
ones: whoever uses readings orders them by stamp.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Any

from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from finger_common.moisture import MOISTURE_TEXT, is_moisture
from finger_common.node import LATCHED_QOS, main_of
from finger_common.settings import setting
from finger_common.stamps import NANOSECONDS, seconds
from finger_msgs.msg import Moisture
from finger_msgs.srv import SetMoisture

from .clock import IncreasingStamps
from .device_node import DeviceNode, DeviceNodeSettings
from .messages import fill_moisture
from .moisture import SOURCES, MoistureSettings, MoistureSource, Reading
from .moisture.manual import ManualSource
from .moisture.source import FLAG_MANUAL, FLAG_OUT_OF_RANGE, PHASE_AFTER

_AHEAD = 2.0
"""s by which a reading may be stamped ahead of this machine's clock; tables have whole seconds."""


@dataclass(frozen=True)
class MoistureNodeSettings(DeviceNodeSettings):
    """Parameters of the moisture node for every source."""

    frame_id: str = setting("finger", "Frame of the reading: the skin it was taken on.")
    out_of_range: str = setting(
        "flag",
        f"What becomes of a reading outside {MOISTURE_TEXT}: published with its flag set, or left "
        "out.",
        choices=("flag", "drop"),
    )


def _later(stamp_ns: int, last: int | None) -> int:
    """The stamp, or the first one after the last reading's where it lies less than 1 s behind.

    Two lines that come in one piece have the same time of arrival; exports write times in whole
    seconds, so rows of a table often have the same one.
    """
    if last is not None and last - NANOSECONDS < stamp_ns <= last:
        return last + 1
    return stamp_ns


class MoistureNode(DeviceNode):
    """Node around a MoistureSource. Readings may be entered by hand with every source."""

    NAME = "moisture"
    SETTINGS = (MoistureNodeSettings,)
    PLUGINS = SOURCES

    device: MoistureSource

    def create_interfaces(self) -> None:
        device = self.device
        if isinstance(device, ManualSource):
            self._manual, self._entered = device, self._stamps
        else:
            self._manual, self._entered = ManualSource(MoistureSettings()), IncreasingStamps()
        self._publish_lock = threading.Lock()
        self._index = 0
        # Readings are few and each counts: always reliable, and late joiners get the newest.
        self._publisher = self.create_stream_publisher(Moisture, "moisture", LATCHED_QOS)
        self.create_service(SetMoisture, "~/set_moisture", self._on_set_moisture)
        self.create_stream_subscription(
            Float64, "~/entered", self._on_entered, QoSProfile(depth=10)
        )

    def on_sample(self, sample: Reading) -> None:
        self._publish(sample)

    def _publish(self, reading: Reading) -> str:
        """Publish one reading, or tell why not; called by the device thread, by the executor for
        entered ones."""
        device = self.device
        name = f"reading {reading.value:g} a.u."
        left_out = "and is left out; check the clock that stamps it"
        with self._publish_lock:
            ahead = seconds(reading.stamp_ns - device.clock.now())
            # Remembered, one from the future would make all later readings older than itself.
            early = ahead > _AHEAD
            text = f"{name} is stamped {ahead:.0f} s ahead of this computer's clock {left_out}"
            device.note_if(early, "ahead", text)
            if early:
                return text
            stamps = self._entered if reading.flags & FLAG_MANUAL else self._stamps
            stamp = _later(reading.stamp_ns, stamps.last)
            old = not stamps.accept(stamp)
            text = f"{name} is older than the one of this source before it {left_out}"
            device.note_if(old, "backwards", text)
            if old:
                return text
            wild = bool(reading.flags & FLAG_OUT_OF_RANGE)
            text = f"{name} is outside {MOISTURE_TEXT}; measure again"
            device.note_if(wild, "out_of_range", text)
            if wild and self.values["out_of_range"] == "drop":
                return text
            device.health.sample()
            reading = replace(reading, stamp_ns=stamp)
            self._publisher.publish(fill_moisture(Moisture(), reading, self._index, self.frame))
            self._index += 1
        return ""

    def _on_set_moisture(self, request: Any, response: Any) -> Any:
        if not self.reading:
            response.message = "not accepted: the node is not active"
        elif not is_moisture(request.value):
            response.message = f"not accepted: {request.value:g} is outside {MOISTURE_TEXT}"
        elif request.phase > PHASE_AFTER:
            response.message = f"not accepted: phase {request.phase} does not exist; use 0, 1 or 2"
        else:
            refused = self._publish(self._manual.enter(request.value, request.phase))
            response.success = not refused
            response.message = refused or f"reading {request.value:g} a.u. published"
        return response

    def _on_entered(self, message: Float64) -> None:
        if self.reading:
            self.on_sample(self._manual.enter(message.data))


main = main_of(MoistureNode)

if __name__ == "__main__":
    main()
