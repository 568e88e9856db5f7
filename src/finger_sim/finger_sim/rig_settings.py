# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the simulated rig."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from finger_common.errors import InputError
from finger_common.namespaces import DEFAULT_NAMESPACE, default_folder, own_port
from finger_common.settings import Settings, setting
from finger_driver import can_bus
from finger_driver.simulators import images, netcanoem, serial_moisture
from finger_model.pose.pose import Pose

from .addresses import CAN_CHANNEL, RigAddresses
from .conditions import condition
from .ftir import IMAGE_HEIGHT, IMAGE_WIDTH, Scene
from .trial_plan import CameraView, TrialRequest

UNPLUGGED = "unplugged"
DEVICE_FAULTS = {
    "force": tuple(netcanoem.FAULTS),
    "camera": tuple(images.FAULTS),
    "moisture": (*serial_moisture.FAULTS, UNPLUGGED),
}
"""Faults of the simulated devices by device."""


@dataclass(frozen=True)
class RigSettings(Settings):
    """How the rig behaves, and where."""

    folder: str = setting(
        "",
        "Folder of the rig: frames, link to the probe, truth; empty: by the namespace, "
        "out/rig/devices or out/rig_NAMESPACE/devices.",
    )
    can_port: int = setting(
        0,
        f"UDP port of the simulated CAN bus; 0: by the namespace, {can_bus.DEFAULT_PORT} for "
        f"'{DEFAULT_NAMESPACE}'. The log names it.",
        minimum=0,
        maximum=65535,
    )
    can_channel: str = setting(CAN_CHANNEL, "Multicast group of the simulated CAN bus.")
    seed: int = setting(1, "Seed of everything that varies.", minimum=0)
    width: int = setting(IMAGE_WIDTH, "Width of a frame in pixels.", minimum=64, maximum=4096)
    height: int = setting(IMAGE_HEIGHT, "Height of a frame in pixels.", minimum=64, maximum=4096)
    frame_rate: float = setting(10.0, "Frames per second.", unit="Hz", minimum=0.5, maximum=60.0)
    noise: float = setting(
        Scene.noise,
        "Standard deviation of a pixel's noise, greys of 255.",
        minimum=0.0,
        maximum=50.0,
    )
    reading_time: float = setting(
        1.0,
        "Time a moisture reading takes; a Corneometer needs about 1 s.",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )
    refinement: float = setting(
        1.0, "Of the simulated finger's mesh; 1 is the default mesh.", minimum=0.3
    )
    pad_aspect: float = setting(
        1.0, "Length of the simulated pad over its width.", minimum=1.0, maximum=1.6
    )
    plate_pitch: float = setting(
        0.0,
        "Tilt of the plate against the simulated finger: its side towards the fingertip rises.",
        unit="rad",
        minimum=-0.52,
        maximum=0.52,
    )
    plate_roll: float = setting(
        0.0,
        "Tilt of the plate about the simulated finger's long axis: its side at 90 deg from the "
        "fingertip, from +x towards +y of contact_area, rises.",
        unit="rad",
        minimum=-0.52,
        maximum=0.52,
    )
    upcoming: list[str] = setting(
        [""],
        "Blocks of trials to plan ahead, CONDITION:TRIALS; without any, the next trial is guessed.",
    )

    faults: list[str] = setting(
        [""],
        "Faults that the simulated devices show, 'DEVICE FAULT' or 'DEVICE FAULT NUMBER'; DEVICE "
        "is force, camera or moisture, FAULT one that `finger-device-sim` lists, or 'moisture "
        "unplugged'.",
        runtime=True,
        advice="For practice and tests: set it empty again to end them.",
    )

    def validate(self) -> None:
        self.upcoming_trials()
        self.present_faults()

    def addresses(self, namespace: str = DEFAULT_NAMESPACE) -> RigAddresses:
        """Where the devices of a rig in this namespace are found."""
        folder = Path(self.folder) if self.folder else default_folder(namespace) / "devices"
        port = self.can_port or own_port(namespace, can_bus.DEFAULT_PORT)
        return RigAddresses(folder.absolute(), port, self.can_channel)

    @property
    def pose(self) -> Pose:
        """Of the simulated pad and the plate."""
        return Pose(self.pad_aspect, self.plate_pitch, self.plate_roll)

    @property
    def view(self) -> CameraView:
        """What the camera sees."""
        return CameraView(self.frame_rate, self.width, self.height, noise=self.noise)

    def present_faults(self) -> list[tuple[str, str, int]]:
        """Device, fault and its number (-1: until it is taken away) of each fault.

        Raises InputError for one that does not exist.
        """
        found = []
        for text in filter(None, self.faults):
            device, _, rest = text.partition(" ")
            fault, _, number = rest.partition(" ")
            if fault not in DEVICE_FAULTS.get(device, ()):
                known = "; ".join(f"{d}: {', '.join(f)}" for d, f in DEVICE_FAULTS.items())
                raise InputError(f"fault '{text}' does not exist; known are {known}")
            try:
                found.append((device, fault, int(number or "-1", 0)))
            except ValueError:
                raise InputError(f"fault '{text}': '{number}' is not a whole number") from None
        return found

    def upcoming_trials(self) -> list[TrialRequest]:
        """Requests of all trials of the blocks; indices run through the session.

        Raises InputError for a block that cannot be read or an unknown condition.
        """
        names: list[str] = []
        for block in filter(None, self.upcoming):
            name, _, number = block.partition(":")
            if not name or not number.isdigit():
                raise InputError(
                    f"block '{block}' cannot be read; write CONDITION:TRIALS, such as dry:3"
                )
            names += [condition(name).name] * int(number)
        return [TrialRequest(name, index, 0, self.seed) for index, name in enumerate(names)]
