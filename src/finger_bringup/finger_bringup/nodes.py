"""The table of the suite's processes: which executables, in which order, with which parameters.

One table for `finger-rig up`, the launch files, the demo and the tests. No ROS and no launch here: an entry can be
turned into a plain command, or into a launch_ros node by a launch file.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from finger_common.errors import InputError
from finger_common.files import atomic_write, load_yaml
from finger_sim.rig import RIG_READY, RigAddresses

from .supervisor import ProcessSpec

DEFAULT_NAMESPACE = "finger"


@dataclass(frozen=True)
class NodeEntry:
    """One node of the suite.

    name: node name within the namespace. package, executable: for `ros2 run` and launch files. module: for
    `python -m`. rank: start and lifecycle order. lifecycle: has configure and activate transitions. respawn: is
    started again when it dies. ready_text: line of output that says it is ready; None: ready once started.
    parameters: what this suite sets; a parameter file comes before it.
    """

    name: str
    package: str
    executable: str
    rank: int
    lifecycle: bool = True
    respawn: bool = True
    essential: bool = False
    ready_text: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def module(self) -> str:
        return f"{self.package}.{self.executable}"

    def with_parameters(self, **parameters: Any) -> NodeEntry:
        """The entry with further parameters set."""
        return replace(self, parameters={**self.parameters, **parameters})


TABLE: dict[str, NodeEntry] = {
    entry.name: entry
    for entry in (
        NodeEntry("simulated_rig", "finger_sim", "rig_node", 0, ready_text=RIG_READY),
        NodeEntry("force", "finger_driver", "force_node", 1),
        NodeEntry("camera", "finger_driver", "camera_node", 1),
        NodeEntry("moisture", "finger_driver", "moisture_node", 1),
        NodeEntry("vision", "finger_vision", "vision_node", 2),
        NodeEntry("model", "finger_model", "model_node", 2),
        NodeEntry("fit", "finger_fit", "fit_node", 3),
        NodeEntry("recorder", "finger_bag", "recorder_node", 3),
        NodeEntry("protocol", "finger_operator", "protocol_node", 4),
        NodeEntry("page", "finger_operator", "page_node", 5, lifecycle=False),
    )
}
"""Every node there is, by name."""

RIG = ("force", "camera", "moisture", "vision", "model", "recorder")
"""Nodes of a measuring rig; `finger-rig up` adds the simulated rig where asked."""

GRASP = ("force", "model")
"""Nodes on a robot."""


def simulated_devices(addresses: RigAddresses) -> dict[str, dict[str, Any]]:
    """Parameters that connect each driver node to the simulated rig's devices."""
    return {
        "simulated_rig": addresses.parameters(),
        "force": {
            "device": "netcanoem",
            "can_interface": "udp_multicast",
            "can_channel": addresses.can_channel,
            "can_options": f"port={addresses.can_port}",
            "normal_axis": "-z",
        },
        "camera": {
            "device": "folder",
            "path": str(addresses.spool),
            "camera_info_url": addresses.calibration.absolute().as_uri(),
        },
        "moisture": {"device": "serial", "path": str(addresses.probe)},
        "vision": {"calibration_file": str(addresses.calibration)},
        "recorder": {
            "calibration_file": str(addresses.calibration),
            "rig": "simulated",
            "source": "simulated rig",
        },
    }


def select(
    names: Iterable[str], parameters: Mapping[str, Mapping[str, Any]] | None = None
) -> list[NodeEntry]:
    """Entries of the named nodes in order of rank, with parameters by node name.

    Raises InputError for a name that is not in the table.
    """
    names = list(names)
    for name in [*names, *(parameters or {})]:
        if name not in TABLE:
            raise InputError(f"node '{name}' does not exist; known are {', '.join(TABLE)}")
    chosen = [TABLE[name].with_parameters(**(parameters or {}).get(name, {})) for name in names]
    return sorted(chosen, key=lambda entry: entry.rank)


def write_parameter_file(entries: Iterable[NodeEntry], namespace: str, path: Path) -> Path:
    """Write the entries' own parameters as a ROS parameter file and return its path."""
    data = {
        f"/{namespace}/{entry.name}": {"ros__parameters": dict(entry.parameters)}
        for entry in entries
        if entry.parameters
    }
    with atomic_write(path) as file:
        yaml.safe_dump(data, file, sort_keys=False, allow_unicode=True)
    return path


def check_parameter_file(path: Path) -> Path:
    """The path of a ROS parameter file; raises InputError naming file and key when it cannot be one."""
    for node, section in load_yaml(path, "parameter file").items():
        if not isinstance(section, dict) or not isinstance(section.get("ros__parameters"), dict):
            raise InputError(
                f"{path}: '{node}' has no 'ros__parameters' with 'name: value' lines; "
                "see the rig parameter file of finger_bringup"
            )
    return path


def process_specs(
    entries: Iterable[NodeEntry],
    run_folder: Path,
    namespace: str = DEFAULT_NAMESPACE,
    parameter_file: Path | None = None,
) -> list[ProcessSpec]:
    """Commands that run the entries with this Python; nodes bring themselves up (`autostart`).

    parameter_file: of the user, may be None; what an entry sets itself wins. run_folder: for the generated file.
    """
    entries = list(entries)
    files = [] if parameter_file is None else [check_parameter_file(parameter_file)]
    files.append(write_parameter_file(entries, namespace, run_folder / "parameters.yaml"))
    arguments = [part for file in files for part in ("--params-file", str(file))]
    return [
        ProcessSpec(
            entry.name,
            (
                sys.executable,
                "-m",
                entry.module,
                "--ros-args",
                "-r",
                f"__ns:=/{namespace}",
                *arguments,
            ),
            rank=entry.rank,
            ready_text=entry.ready_text,
            respawn=entry.respawn,
            essential=entry.essential,
        )
        for entry in entries
    ]
