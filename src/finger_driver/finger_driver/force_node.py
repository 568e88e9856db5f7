# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node `force`: publishes `wrench_raw` and `wrench` (tared), offers `~/tare` and `~/reset_tare`."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES, normal_force
from finger_common.diagnostics import WARN
from finger_common.errors import DeviceError
from finger_common.node import FixedMessage, Listeners, LocalPublisher, main_of
from finger_common.settings import setting
from finger_common.stamps import NANOSECONDS

from .device_node import DeviceNode, DeviceNodeSettings
from .force import GOOD, SOURCES, ForceSource, WrenchSample
from .shared_polling import Rest
from .tare import FarTares, TareCollector, ZeroCheck

TARE_NEEDED = "tare needed: take the finger off the plate, then call ~/tare"


@dataclass(frozen=True)
class ForceNodeSettings(DeviceNodeSettings):
    """Parameters of the force node for every sensor."""

    frame_id: str = setting("force_sensor", "Frame of the sensor's own axes.")
    bad_samples: str = setting(
        "drop",
        "What becomes of a sample with a saturated gauge, a sensor fault or an impossible value: "
        "left out, or published as NaN.",
        choices=("drop", "nan"),
    )
    normal_axis: str = setting(
        DEFAULT_NORMAL_AXIS,
        "Axis of the sensor that points along the pressing force; for the normal force in "
        "diagnostics.",
        choices=NORMAL_AXES,
        runtime=True,
    )
    tare_duration: float = setting(
        0.5, "Time averaged by a tare.", unit="s", minimum=0.05, maximum=30.0, runtime=True
    )
    tare_force_limit: float = setting(
        0.05,
        "Movement of any force axis during a tare beyond which it is refused.",
        unit="N",
        minimum=0.0,
        maximum=1000.0,
        runtime=True,
    )
    tare_torque_limit: float = setting(
        0.002,
        "Movement of any torque axis during a tare beyond which it is refused.",
        unit="N m",
        minimum=0.0,
        maximum=1000.0,
        runtime=True,
    )
    tare_shift_limit: float = setting(
        0.2,
        "Change of the zero by a tare beyond which it is refused once, as while an object is held; "
        "the first tare may be anything, and so may one after ~/reset_tare.",
        unit="N",
        minimum=0.0,
        maximum=1000.0,
        runtime=True,
        advice="A tare that is asked for again within 30 s is taken. Raise it for a sensor whose "
        "own weight turns with the robot.",
    )


class ForceNode(DeviceNode):
    """Node around a ForceSource. It tares on request only."""

    NAME = "force"
    SETTINGS = (ForceNodeSettings,)
    PLUGINS = SOURCES

    device: ForceSource

    def create_interfaces(self) -> None:
        self._frame = self.frame
        self._bias: np.ndarray | None = None
        self._offset = np.zeros(6)
        self._far_tares = FarTares()
        self._zero_check: ZeroCheck | None = None
        self._note_tare()
        self._newest: list[float] = []
        self._scale_id = self.device.scale_id
        self._collector: TareCollector | None = None
        self._tare_done = threading.Event()
        self._tare_lock = threading.Lock()
        qos = self.stream_qos(publisher=True)
        self._raw = self.create_stream_publisher(WrenchStamped, "wrench_raw", qos)
        self._tared = self.create_stream_publisher(WrenchStamped, "wrench", qos)
        self._tared_listeners, self._raw_listeners = Listeners(self._tared), Listeners(self._raw)
        self._local = LocalPublisher(self, "wrench")
        self.closing.callback(self._local.close)
        self._message = FixedMessage(WrenchStamped(header=Header(frame_id=self._frame)))
        self.create_service(Trigger, "~/tare", self._on_tare)
        self.create_service(Trigger, "~/reset_tare", self._on_reset_tare)

    def on_sample(self, sample: WrenchSample) -> Rest | None:
        received = time.time_ns()
        sample = self.device.checked(sample)
        if not self.accept_stamp(sample.stamp_ns):
            return None
        good = sample.quality == GOOD
        if good:
            self.device.health.sample()
        with self._tare_lock:
            if self._collector is not None and self._collector.add(sample):
                self._tare_done.set()
        if self.device.scale_id != self._scale_id:
            self._scale_id = self.device.scale_id
            self._void_tare("another sensor or calibration is in use")
        if not good and self.values["bad_samples"] == "drop":
            return None
        raw = tared = [math.nan] * 6
        if good:
            raw = tared = [*sample.force.tolist(), *sample.torque.tolist()]
            bias = self._bias
            if bias is not None:
                wrench = self.device.wrench_of(sample.channels - bias)
                if not self._check_zero(sample.stamp_ns, wrench[:3]):
                    return None
                tared = wrench.tolist()
        # First to whom a delay matters.
        force, torque = tuple(tared[:3]), tuple(tared[3:])
        rests = self._local.send(sample.stamp_ns, force, self._frame, received, torque)
        self._newest = tared
        return partial(self._finish, rests, divmod(sample.stamp_ns, NANOSECONDS), tared, raw)

    def on_connected_again(self) -> None:
        if self._bias is not None and not self.device.serial and self._zero_check is None:
            before = np.array(self._newest[:3])
            self._zero_check = ZeroCheck(before, self.values["tare_shift_limit"])

    def _check_zero(self, stamp_ns: int, force: np.ndarray) -> bool:
        """Check the zero in force after the connection was lost, by a force (3,) in N with it, and
        end the tare where it is not right; whether that force may be published: not before it is
        known."""
        check = self._zero_check
        if check is None:
            return True
        holds = check.add(stamp_ns, force)
        if holds is None:
            return False
        self._zero_check = None
        if not holds:
            size = float(np.linalg.norm(check.now))
            self._void_tare(
                f"since the connection was lost the force reads {size:.2f} N, not as before and "
                "not zero: another sensor may be in use"
            )
        return holds

    def _void_tare(self, why: str) -> None:
        """End the tare, if there is one."""
        self._zero_check = None
        if self._bias is not None:
            self._bias = None
            self._note_tare()
            self.device.health.notes.pop("tare_offset", None)
            self.device.note("tare_void", f"{why}; the tare is not valid, tare again")

    def _finish(
        self,
        rests: list[Callable[[], None]],
        stamp: tuple[int, int],
        tared: list[float],
        raw: list[float],
    ) -> None:
        for rest in rests:
            rest()
        if self._tared_listeners.present():
            self._tared.publish(self._message.pack(*stamp, *tared))
        if self._raw_listeners.present():
            self._raw.publish(self._message.pack(*stamp, *raw))

    # Services --------------------------------------------------------------------------------

    def _on_tare(self, request: Any, response: Any) -> Any:
        try:
            bias, offset = self._tare()
            removed = np.zeros(6) if self._bias is None else self._offset
            if self._bias is not None:
                shift = (offset - removed)[:3]
                self._far_tares.check(shift, self.values["tare_shift_limit"])
        except DeviceError as error:
            response.success, response.message = False, f"not tared: {error}"
            return response
        was = float(normal_force((offset - removed)[:3], self.values["normal_axis"]))
        self._bias, self._offset, self._zero_check = bias, offset, None
        self._note_tare()
        response.success, response.message = True, f"Zero set (was {was:.2f} N)"
        self.device.health.recovered("tare_void")
        self.device.health.notes["tare_offset"] = ", ".join(f"{v:.5g}" for v in offset)
        self.get_logger().info(response.message)
        self.publish_diagnostics()
        return response

    def _tare(self) -> tuple[np.ndarray, np.ndarray]:
        """Bias and offset, as `TareCollector.result` gives them; raises DeviceError."""
        if not self.reading:
            raise DeviceError("the node is not active")
        collector = TareCollector(
            self.values["tare_duration"],
            self.values["tare_force_limit"],
            self.values["tare_torque_limit"],
        )
        self._tare_done.clear()
        with self._tare_lock:
            self._collector = collector
        end = time.monotonic() + 2 * self.values["tare_duration"] + 0.5
        while not self._tare_done.wait(0.5) and time.monotonic() < end:
            self.not_hanging()
        with self._tare_lock:
            self._collector = None
        return collector.result(self.device)

    def _on_reset_tare(self, request: Any, response: Any) -> Any:
        self._bias = self._zero_check = None
        self._note_tare()
        self.device.health.notes.pop("tare_offset", None)
        self.device.health.recovered("tare_void")
        self.publish_diagnostics()
        response.success = True
        response.message = "tare removed; wrench is the sensor's own reading"
        return response

    def _note_tare(self) -> None:
        """Untared is a state that everyone sees: a start, also after a crash, has no zero."""
        health = self.device.health
        health.notes["tared"] = "no" if self._bias is None else "yes"
        if self._bias is None:
            health.fault("tare_needed", TARE_NEEDED, WARN)
        else:
            health.recovered("tare_needed")

    def publish_diagnostics(self) -> None:
        if self.reading and self._newest:
            normal = float(normal_force(np.array(self._newest[:3]), self.values["normal_axis"]))
            if math.isfinite(normal):
                self.device.health.notes["normal_force_n"] = f"{normal:.4f}"
        super().publish_diagnostics()


main = main_of(ForceNode)

if __name__ == "__main__":
    main()
