"""The simulated rig: one process that is the finger, the force sensor, the camera and the moisture probe.

The only way from this finger to an estimate is through bytes and pixels: a NETCANOEM board polled on a CAN bus,
image files in a spool folder, lines of a serial moisture probe. A participant presses when the trial's phase says
so. What really happened is written to `truth/` of the rig's folder, for tests and reports on simulated data alone.
"""

from __future__ import annotations

import functools
import secrets
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_driver import can_bus
from finger_driver.simulators.images import FrameFolderWriter
from finger_driver.simulators.netcanoem import NetcanoemSimulator
from finger_driver.simulators.serial_moisture import SerialMoistureSimulator
from finger_vision.calibration import PlateCalibration

from . import ftir
from .conditions import STUDY
from .participant import AFTER, BEFORE, Participant
from .planner import Planner
from .press import PressStyle
from .trial_plan import (
    CameraView,
    PlannedTrial,
    TrialRequest,
    plan_trial,
    renderer_for,
    write_truth,
)

RIG_READY = "simulated rig is ready"
"""Begins the line that says that all devices can be opened."""

NOT_MODELLED = (
    "force: temperature drift, hysteresis, cross-talk, gravity and inertia of the plate, stroking",
    "finger: another shape than axisymmetric, tilt, trial-to-trial change of skin and size within a condition",
    "participant: the cue on the screen (reaction time follows the planned force), correction by sight",
    "moisture: the probe's contact pressure and warm-up, sweat that changes during a press",
    "camera: exposure as an integral over time, lost frames, USB hiccups",
    *(f"picture: {text}" for text in ftir.NOT_MODELLED),
)
"""Said at start: what agreement with this rig does not prove."""

UNLOADED_WRENCH = np.array([0.21, -0.13, -0.42, 1.1e-3, 0.8e-3, -0.3e-3])
"""N and N m: the plate's weight and the sensor's zero, to be tared away. An assumption."""

LATERAL_SHARE = 0.04
"""Standard deviation of the tangential over the normal force of a press that is meant to be perpendicular."""


@dataclass(frozen=True)
class RigAddresses:
    """Where the simulated devices are found: folder of the rig, multicast group and port of its CAN bus."""

    folder: Path
    can_port: int = can_bus.DEFAULT_PORT
    can_channel: str = "239.74.163.2"

    @classmethod
    def private(cls, folder: Path) -> RigAddresses:
        """Addresses that keep this rig apart from every other one on the machine: own port, own group."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", 0))
            port = int(probe.getsockname()[1])
        group = ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
        return cls(folder, port, f"239.{group}")

    @property
    def spool(self) -> Path:
        """Folder in which frames appear."""
        return self.folder / "spool"

    @property
    def probe(self) -> Path:
        """Serial device of the moisture probe (a link to a pseudo-terminal)."""
        return self.folder / "moisture_probe"

    @property
    def calibration(self) -> Path:
        """Plate calibration of the simulated camera, as a calibration session with no error would give it."""
        return self.folder / "plate_calibration.yaml"

    @property
    def truth(self) -> Path:
        """Folder of what really happened."""
        return self.folder / "truth"

    def parameters(self) -> dict[str, Any]:
        """As parameters of the rig's node."""
        return {
            "folder": str(self.folder),
            "can_port": self.can_port,
            "can_channel": self.can_channel,
        }


@dataclass(frozen=True)
class RigSettings:
    """How the rig behaves. reading_time: s per moisture reading (a Corneometer takes about 1 s). upcoming: blocks
    of trials to plan ahead, as (condition, number). refinement: of the truth's mesh."""

    addresses: RigAddresses
    seed: int = 1
    view: CameraView = field(default_factory=CameraView)
    reading_time: float = 1.0
    refinement: float = 1.0
    style: PressStyle = field(default_factory=PressStyle)
    upcoming: tuple[tuple[str, int], ...] = ()
    exposure: float = 5e-3
    """s; a frame appears half an exposure after its stamp, plus the time to write it."""


class SimulatedRig:
    """The rig. `start` opens the devices, `see` shows the participant a trial's phase, `stop` ends it.

    report(text): progress in words. Raises InputError for a condition that is not simulated and DeviceError when
    the CAN bus does not open.
    """

    def __init__(self, settings: RigSettings, report: Callable[[str], None] = print) -> None:
        self.settings = settings
        self._report = report
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self._upcoming = upcoming_trials(settings.upcoming, settings.seed)
        for request in self._upcoming:
            if request.condition not in STUDY:
                raise InputError(
                    f"condition '{request.condition}' is not simulated; choose one of {', '.join(STUDY)}"
                )
        self.errors: list[BaseException] = []

    # Start and end -----------------------------------------------------------------------------

    def start(self) -> None:
        """Open all devices and begin to show an empty plate."""
        settings, addresses = self.settings, self.settings.addresses
        for folder in (addresses.spool, addresses.truth, addresses.folder / "planned"):
            folder.mkdir(parents=True, exist_ok=True)
        for line in NOT_MODELLED:
            self._report(f"not modelled: {line}")
        plan = functools.partial(
            plan_trial,
            folder=addresses.folder / "planned",
            view=settings.view,
            style=settings.style,
            refinement=settings.refinement,
        )
        self._planner = Planner(plan)
        self._period_ns = round(1e9 / settings.view.frame_rate)
        first = time.time_ns() + self._period_ns
        self.participant = Participant(
            self._planner,
            self._period_ns,
            first,
            self._send_reading,
            settings.reading_time,
            self._report,
            self._played,
            self._upcoming,
        )
        self._first_frame_ns = first
        self._rng = np.random.default_rng(settings.seed)
        self._lateral = self._rng.normal(0.0, LATERAL_SHARE, 2)
        self._probe = SerialMoistureSimulator(addresses.probe)
        self._start_force()
        self._start_camera()
        self.participant.start()

    def stop(self) -> None:
        """Close all devices. Safe to call twice."""
        self._stop.set()
        for thread in self._threads:
            thread.join(5.0)
        self._threads.clear()
        for name, end in (
            ("participant", "stop"),
            ("_planner", "close"),
            ("_force", "stop"),
            ("_bus", "shutdown"),
            ("_probe", "close"),
        ):
            if hasattr(self, name):
                getattr(getattr(self, name), end)()
                if name != "participant":
                    delattr(self, name)

    def see(self, condition: str, index: int, attempt: int, phase: int) -> None:
        """The screen shows a trial's phase, numbered as in finger_msgs/Trial."""
        if condition not in STUDY:
            self._report(
                f"condition '{condition}' is not simulated; choose one of {', '.join(STUDY)}"
            )
            return
        self.participant.see(TrialRequest(condition, index, attempt, self.settings.seed), phase)

    # Force -------------------------------------------------------------------------------------

    def _start_force(self) -> None:
        addresses = self.settings.addresses
        self._bus = can_bus.open_bus(
            "udp_multicast", addresses.can_channel, options={"port": addresses.can_port}
        )
        self._force = NetcanoemSimulator(self._bus, self.wrench, seed=self.settings.seed).start()

    def wrench(self, stamp_ns: int) -> np.ndarray:
        """Wrench (6,) in N and N m on the sensor below the plate, whose z axis points up to the finger."""
        normal = self.participant.normal_force(stamp_ns)
        wrench = UNLOADED_WRENCH.copy()
        wrench[2] -= normal
        wrench[:2] += self._lateral * normal
        return wrench

    # Moisture ----------------------------------------------------------------------------------

    def _send_reading(self, value: float, phase: int) -> None:
        self._probe.send(value, {BEFORE: "before", AFTER: "after"}[phase])

    # Camera ------------------------------------------------------------------------------------

    def _start_camera(self) -> None:
        self._frames = FrameFolderWriter(self.settings.addresses.spool)
        # The plate without a finger looks alike in all conditions but for the noise of each frame.
        self._empty = renderer_for("natural", self.settings.view, self.settings.seed)
        view = self.settings.view
        PlateCalibration(
            ftir.AREA_PER_PIXEL,
            np.linalg.inv(self._empty.homography),
            self._empty.camera_matrix,
            image_size=(view.width, view.height),
            camera_name="camera",
        ).save(self.settings.addresses.calibration)
        thread = threading.Thread(target=self._expose, name="camera", daemon=True)
        thread.start()
        self._threads.append(thread)

    def _expose(self) -> None:
        """One frame per period, stamped with its mid-exposure, written once it is exposed."""
        stamp = self._first_frame_ns
        half_exposure = round(0.5e9 * self.settings.exposure)
        while True:
            if self._stop.wait(max(stamp - time.time_ns(), 0) * 1e-9):
                return
            image = self._look(stamp)
            if self._stop.wait(max(stamp + half_exposure - time.time_ns(), 0) * 1e-9):
                return
            try:
                self._frames.write(stamp, image)
            except OSError as error:
                self.errors.append(error)
                self._report(f"frame not written: {error}")
            stamp += self._period_ns

    def _look(self, stamp_ns: int) -> np.ndarray:
        path = self.participant.frame(stamp_ns)
        image = None if path is None else cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        return self._empty.empty() if image is None else image

    def _played(self, trial: PlannedTrial, start_ns: int) -> None:
        path = self.settings.addresses.truth / f"{trial.request.name}.json"
        write_truth(path, trial, start_ns)
        self._report(
            f"pressed {trial.request.name}: {trial.press.force.max():.2f} N, "
            f"{trial.frame_area.max() * 1e6:.1f} mm² at most"
        )
        self._lateral = self._rng.normal(0.0, LATERAL_SHARE, 2)


def upcoming_trials(blocks: Sequence[tuple[str, int]], seed: int) -> list[TrialRequest]:
    """Requests of all trials of the blocks; indices run through the session."""
    names = [condition for condition, number in blocks for _ in range(number)]
    return [TrialRequest(name, index, 0, seed) for index, name in enumerate(names)]
