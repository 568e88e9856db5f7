"""Node `simulated_rig`: shows the announced trial to the simulated participant; thin shell over `rig.SimulatedRig`.

It publishes nothing: what it measures leaves through the simulated devices alone.
"""

from __future__ import annotations

from pathlib import Path

from finger_common.errors import InputError
from finger_common.node import LATCHED_QOS, ManagedNode, main_of
from finger_common.parameters import Parameter, ParameterTable
from finger_msgs.msg import Trial

from .rig import RIG_READY, RigAddresses, RigSettings, SimulatedRig
from .trial_plan import CameraView

PARAMETERS = ParameterTable(
    Parameter("folder", "", "Folder of the rig: frames, link to the probe, truth."),
    Parameter(
        "can_port",
        43113,
        "UDP port of the simulated CAN bus; another for each rig on one machine.",
        minimum=1,
        maximum=65535,
    ),
    Parameter("can_channel", "239.74.163.2", "Multicast group of the simulated CAN bus."),
    Parameter("seed", 1, "Seed of everything that varies.", minimum=0),
    Parameter("width", 1280, "Width of a frame in pixels.", minimum=64, maximum=4096),
    Parameter("height", 1024, "Height of a frame in pixels.", minimum=64, maximum=4096),
    Parameter("frame_rate", 10.0, "Frames per second.", unit="Hz", minimum=0.5, maximum=60.0),
    Parameter(
        "noise",
        2.5,
        "Standard deviation of a pixel's noise, greys of 255.",
        minimum=0.0,
        maximum=50.0,
    ),
    Parameter(
        "reading_time",
        1.0,
        "Time a moisture reading takes; a Corneometer needs about 1 s.",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    ),
    Parameter(
        "refinement", 1.0, "Of the simulated finger's mesh; 1 is the default mesh.", minimum=0.3
    ),
    Parameter(
        "upcoming",
        [""],
        "Blocks of trials to plan ahead, CONDITION:TRIALS; without any, the next trial is guessed.",
    ),
)


def parse_blocks(blocks: list[str]) -> tuple[tuple[str, int], ...]:
    """Blocks (condition, number) of texts such as "dry:3"; empty texts are left out. Raises InputError."""
    parsed = []
    for block in filter(None, blocks):
        condition, _, number = block.partition(":")
        if not condition or not number.isdigit():
            raise InputError(
                f"block '{block}' is not understood; write CONDITION:TRIALS, such as dry:3"
            )
        parsed.append((condition, int(number)))
    return tuple(parsed)


class RigNode(ManagedNode):
    """The simulated rig as a process of the suite."""

    TABLE = PARAMETERS
    NAME = "simulated_rig"

    def configure(self) -> None:
        values = self.values
        if not values["folder"]:
            raise InputError("parameter 'folder' is empty; name a folder for the simulated rig")
        addresses = RigAddresses(Path(values["folder"]), values["can_port"], values["can_channel"])
        settings = RigSettings(
            addresses,
            seed=values["seed"],
            view=CameraView(
                values["frame_rate"], values["width"], values["height"], noise=values["noise"]
            ),
            reading_time=values["reading_time"],
            refinement=values["refinement"],
            upcoming=parse_blocks(values["upcoming"]),
        )
        self._rig = SimulatedRig(settings, lambda text: self.get_logger().info(text))
        self._rig.start()

    def activate(self) -> None:
        self._subscription = self.create_subscription(Trial, "trial", self._on_trial, LATCHED_QOS)
        self.get_logger().info(f"{RIG_READY} in {self.values['folder']}")

    def deactivate(self) -> None:
        self.destroy_subscription(self._subscription)

    def cleanup(self) -> None:
        if hasattr(self, "_rig"):
            self._rig.stop()
            del self._rig

    def _on_trial(self, message: Trial) -> None:
        self._rig.see(message.condition, message.index, message.attempt, message.phase)


main = main_of(RigNode)

if __name__ == "__main__":
    main()
