# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated rig: finger, force sensor, camera and moisture probe in one process.

The only way from this finger to an estimate is through bytes and pixels: a NETCANOEM board polled
on a CAN bus, image files in a spool folder, lines of a serial moisture probe. The participant
presses in the phase PRESS of a trial. The true contacts are written to `truth/` of the rig's
folder, for tests and reports on simulated data alone.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from contextlib import ExitStack

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.files import make_folder
from finger_common.host_clock import HostClock
from finger_common.namespaces import DEFAULT_NAMESPACE
from finger_common.stamps import NANOSECONDS, nanoseconds
from finger_driver import can_bus
from finger_driver.simulators.images import FrameFolderWriter
from finger_driver.simulators.netcanoem import NetcanoemSimulator
from finger_driver.simulators.serial_moisture import SerialMoistureSimulator

from . import ftir
from .conditions import condition
from .participant import FrameClock, Participant
from .planner import Planner
from .rig_settings import UNPLUGGED, RigSettings
from .trial_plan import PlannedTrial, TrialRequest, plan_trial, renderer_for, write_truth

RIG_READY = "simulated rig is ready"
"""Begins the line of the log after which all devices can be opened."""

NOT_MODELLED = (
    "force: temperature drift, hysteresis, cross-talk, gravity and inertia of the plate",
    "finger: change of skin and size between trials; ellipse and tilt are the learned correction's",
    "participant: the cue on the screen (reaction time follows the planned force), correction by "
    "sight",
    "pull: creep and twist under it, a spring of constant stiffness, Coulomb's friction",
    "moisture: the probe's contact pressure and warm-up, sweat that changes during a press",
    "camera: exposure as an integral over time, lost frames, USB hiccups",
    *(f"picture: {text}" for text in ftir.NOT_MODELLED),
)
"""Logged at start: what agreement with this rig does not prove."""

UNLOADED_WRENCH = np.array([0.21, -0.13, -0.42, 1.1e-3, 0.8e-3, -0.3e-3])
"""N and N m: the plate's weight and the sensor's zero, to be tared away. An assumption."""

LATERAL_SHARE = 0.04
"""Standard deviation of the tangential over the normal force of a press that is meant to be
perpendicular."""

SENSOR_DEPTH = 0.02
"""m, of the sensor's origin below the surface of the plate; an assumption."""

EXPOSURE = 5e-3
"""s; a frame appears half an exposure after its stamp, plus the time to write it."""


class SimulatedRig:
    """The rig. `start` opens the devices, `announce` passes a trial's phase to the participant.

    report(text): progress as text. namespace: of the finger, which gives folder and port where the
    settings do not. `start` raises DeviceError when the CAN bus does not open, and InputError when
    another rig has the folder or the bus.
    """

    def __init__(
        self,
        settings: RigSettings,
        report: Callable[[str], None] = print,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        self.settings = settings
        self.addresses = settings.addresses(namespace)
        self._report = report
        self._stop = threading.Event()
        self._open = ExitStack()
        self._rng = np.random.default_rng(settings.seed)
        self._lateral = self._rng.normal(0.0, LATERAL_SHARE, 2)

    def start(self) -> None:
        """Open all devices and begin to show an empty plate."""
        settings, addresses = self.settings, self.addresses
        self._open.push(addresses.lock())
        for folder in (addresses.spool, addresses.truth, addresses.planned):
            make_folder(folder)
        for line in NOT_MODELLED:
            self._report(f"not modelled: {line}")
        planner = Planner(
            functools.partial(
                plan_trial,
                folder=addresses.planned,
                view=settings.view,
                refinement=settings.refinement,
                pose=settings.pose,
            )
        )
        period_ns = nanoseconds(1 / settings.frame_rate)
        self._open.callback(planner.close)
        host = HostClock()
        self._clock = FrameClock(host.now() + period_ns, period_ns, host)
        self._probe = probe = SerialMoistureSimulator(addresses.probe)
        self._open.callback(probe.close)
        self.participant = Participant(
            planner,
            self._clock,
            probe.send,
            self._played,
            settings.reading_time,
            self._report,
            settings.upcoming_trials(),
        )
        self._start_force()
        self._start_camera()
        self.participant.start()
        self._open.callback(self.participant.stop)
        self.show_faults(settings)

    def stop(self) -> None:
        """Close all devices. Safe to call twice."""
        self._stop.set()
        self._open.close()

    def announce(self, name: str, index: int, attempt: int, phase: int) -> None:
        """A trial of the condition `name` is in this `TrialPhase` now."""
        try:
            condition(name)
            request = TrialRequest(name, index, attempt, self.settings.seed)
        except InputError as error:
            self._report(str(error))
        else:
            self.participant.announce(request, phase)

    def show_faults(self, settings: RigSettings) -> None:
        """Let the devices show the faults of `settings` and no others."""
        devices = {
            "force": self._sensor.faults,
            "camera": self._frames.faults,
            "moisture": self._probe.faults,
        }
        for faults in devices.values():
            faults.clear()
        unplugged = False
        for device, fault, number in settings.present_faults():
            if fault == UNPLUGGED:
                unplugged = True
            else:
                devices[device].set(fault, number)
        if unplugged and self._probe.plugged:
            self._probe.unplug()
        elif not unplugged and not self._probe.plugged:
            self._probe.plug_in()

    # Force -------------------------------------------------------------------------------------

    def _start_force(self) -> None:
        addresses = self.addresses
        bus = can_bus.open_bus(
            "udp_multicast", addresses.can_channel, options={"port": addresses.can_port}
        )
        self._open.callback(bus.shutdown)
        self._sensor = NetcanoemSimulator(bus, self.wrench, seed=self.settings.seed)
        self._open.callback(self._sensor.start().stop)

    def wrench(self, stamp_ns: int) -> np.ndarray:
        """Wrench (6,) in N and N m on the sensor below the plate, whose z axis points up, at this
        moment by the system clock."""
        stamp_ns = self._clock.host.of_stamp(stamp_ns, 0)
        normal = self.participant.normal_force(stamp_ns)
        wrench = UNLOADED_WRENCH.copy()
        pulled = self.participant.tangential_force(stamp_ns)
        force = np.array([*(self._lateral * normal if pulled is None else pulled), -normal])
        place = [*self.participant.pressure_center(stamp_ns), SENSOR_DEPTH]
        wrench[:3] += force
        wrench[3:] += np.cross(place, force)
        return wrench

    # Camera ------------------------------------------------------------------------------------

    def _start_camera(self) -> None:
        self._frames = FrameFolderWriter(self.addresses.spool)
        # The plate without a finger is the same in all conditions but for the noise of a frame.
        self._plate = renderer_for("natural", self.settings.view, self.settings.seed)
        self._plate.calibration().save(self.addresses.calibration)
        thread = threading.Thread(target=self._expose, name="camera", daemon=True)
        thread.start()
        self._open.callback(thread.join, 5.0)

    def _expose(self) -> None:
        """One frame per period, stamped with its mid-exposure, written once it is exposed."""
        stamp = self._clock.first_ns
        half_exposure = nanoseconds(EXPOSURE / 2)
        while not self._wait_until(stamp):
            image = self._image(stamp)
            if self._wait_until(stamp + half_exposure):
                return
            try:
                self._frames.write(stamp, image)
            except OSError as error:
                self._report(f"frame not written: {error}")
            stamp += self._clock.period_ns

    def _wait_until(self, stamp_ns: int) -> bool:
        """Wait until that time; true when the rig stops before."""
        return self._stop.wait(max(stamp_ns - self._clock.host.now(), 0) / NANOSECONDS)

    def _image(self, stamp_ns: int) -> np.ndarray:
        path = self.participant.frame(stamp_ns)
        image = None if path is None else cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        return self._plate.empty() if image is None else image

    # After a press -----------------------------------------------------------------------------

    def _played(self, trial: PlannedTrial, start_ns: int) -> None:
        path = self.addresses.truth / f"{trial.request.name}.json"
        write_truth(path, trial, start_ns)
        self._report(
            f"pressed {trial.request.name}: {trial.press.force.max():.2f} N, "
            f"{trial.frame_area.max() * 1e6:.1f} mm² at most"
            + (f", slipped at friction {trial.pull.friction:.3f}" if trial.pull else "")
        )
        self._lateral = self._rng.normal(0.0, LATERAL_SHARE, 2)
