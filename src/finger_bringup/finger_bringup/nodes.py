"""What runs: the suite's nodes, in which order they come up, with which parameters.

`finger-rig up`, the launch files, the demo and the tests run the entries that `select` and `rig`
give. The lifecycle nodes among them start unconfigured; the node `bring_up`, which is always the
last entry, configures and activates them in order, again after a refusal and again after a restart.
No ROS and no launch here: an entry becomes a command (`process_specs`) or a launch_ros node
(`launch.actions`).
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from finger_common.errors import InputError, known_names
from finger_common.files import atomic_write, load_yaml
from finger_sim.rig_settings import RigAddresses

from .supervisor import ProcessSpec

DEFAULT_NAMESPACE = "finger"

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by node name and parameter name."""


@dataclass(frozen=True)
class NodeEntry:
    """One node of the suite.

    name: node name within the namespace. package, executable: for `ros2 run` and launch files.
    rank: lower ranks come up earlier and end later. lifecycle: `bring_up` configures and activates
    it. restart: is started again when it ends by itself. essential: its end ends everything.
    parameters: what the suite sets itself; these override a parameter file.
    """

    name: str
    package: str
    executable: str
    rank: int
    lifecycle: bool = True
    restart: bool = True
    essential: bool = False
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def module(self) -> str:
        """For `python -m`."""
        return f"{self.package}.{self.executable}"

    def with_parameters(self, **parameters: Any) -> NodeEntry:
        """The entry with further parameters set."""
        return replace(self, parameters={**self.parameters, **parameters})


BRING_UP = NodeEntry("bring_up", "finger_bringup", "bring_up_node", 9, lifecycle=False)

NODES: dict[str, NodeEntry] = {
    entry.name: entry
    for entry in (
        NodeEntry("simulated_rig", "finger_sim", "rig_node", 0),
        NodeEntry("force", "finger_driver", "force_node", 1),
        NodeEntry("camera", "finger_driver", "camera_node", 1),
        NodeEntry("moisture", "finger_driver", "moisture_node", 1),
        NodeEntry("vision", "finger_vision", "vision_node", 2),
        NodeEntry("model", "finger_model", "model_node", 2),
        NodeEntry("fit", "finger_fit", "fit_node", 3),
        NodeEntry("recorder", "finger_bag", "recorder_node", 3),
        NodeEntry("protocol", "finger_operator", "protocol_node", 4),
        # Active at once, so that the operator sees which other nodes are missing.
        NodeEntry("page", "finger_operator", "page_node", 5, lifecycle=False),
        NodeEntry(
            "fit_request",
            "finger_bringup",
            "fit_request_node",
            5,
            lifecycle=False,
            restart=False,
            essential=True,
        ),
        BRING_UP,
    )
}
"""Every node there is, by name."""

RIG = ("force", "camera", "moisture", "vision", "model", "recorder", "protocol", "page")
"""Nodes of a measuring rig."""

GRASP = ("force", "model")
"""Nodes on a robot."""

SIMULATED_PATIENCE = 60.0
"""s that the drivers wait for the simulated rig, which may have to compile its kernels first."""


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
        "bring_up": {"patience": SIMULATED_PATIENCE},
    }


def merged(*parameters: Parameters) -> dict[str, dict[str, Any]]:
    """Parameters of several mappings; later ones take precedence."""
    result: dict[str, dict[str, Any]] = {}
    for mapping in parameters:
        for name, values in mapping.items():
            result.setdefault(name, {}).update(values)
    return result


def entry_of(name: str) -> NodeEntry:
    """The entry of that name; raises InputError when there is none."""
    if name not in NODES:
        raise InputError(f"node '{name}' does not exist; {known_names(name, NODES)}")
    return NODES[name]


def select(
    wanted: Iterable[str | NodeEntry], parameters: Parameters | None = None
) -> list[NodeEntry]:
    """The wanted nodes in the order of their coming up, and last the node that brings them up.

    wanted: names of NODES, or entries beside it. parameters: by node name; those of nodes that are
    not wanted have no effect. Raises InputError for a name that is not in NODES.
    """
    parameters = parameters or {}
    found = [entry_of(node) if isinstance(node, str) else node for node in wanted]
    for name in parameters.keys() - {entry.name for entry in found}:
        entry_of(name)
    entries = sorted((e for e in found if e.name != BRING_UP.name), key=lambda entry: entry.rank)
    groups: dict[int, list[str]] = {}
    for entry in entries:
        if entry.lifecycle:
            groups.setdefault(entry.rank, []).append(entry.name)
    chosen = [
        entry.with_parameters(autostart=not entry.lifecycle, **parameters.get(entry.name, {}))
        for entry in entries
    ]
    if not groups:
        return chosen
    order = [" ".join(names) for names in groups.values()]
    own = parameters.get(BRING_UP.name, {})
    return [*chosen, BRING_UP.with_parameters(order=order, **own)]


def rig(
    folder: Path,
    simulated: bool = False,
    without: Iterable[str] = (),
    parameters: Parameters | None = None,
    only: Iterable[str] = (),
) -> list[NodeEntry]:
    """Entries of a measuring rig.

    folder: of the sessions and of the simulated devices. simulated: with simulated devices and
    participant. without: nodes to leave out. parameters: by node name, further ones. only: the
    nodes to run in place of all. Raises InputError for a node that does not exist, and for one in
    `without` that would not run.
    """
    names = list(only) or [*(["simulated_rig"] if simulated else []), *RIG]
    for name in without:
        if entry_of(name).name not in names:
            raise InputError(f"node '{name}' would not run anyway; do not name it to be left out")
        names.remove(name)
    own: dict[str, dict[str, Any]] = {"protocol": {"output": str(folder / "sessions")}}
    if "recorder" not in names and not only:
        own["protocol"]["need_recorder"] = False
    devices = simulated_devices(RigAddresses.private(folder / "devices")) if simulated else {}
    return select(names, merged(own, devices, parameters or {}))


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
    """The path of a ROS parameter file; raises InputError naming file and key for any other."""
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
    """Commands that run the entries with this Python.

    parameter_file: of the user, may be None; what an entry sets itself overrides it. run_folder:
    where the file of the entries' own parameters is written.
    """
    entries = list(entries)
    files = [] if parameter_file is None else [check_parameter_file(parameter_file)]
    files.append(write_parameter_file(entries, namespace, run_folder / "parameters.yaml"))
    arguments = ["--ros-args", "-r", f"__ns:=/{namespace}"]
    arguments += [part for file in files for part in ("--params-file", str(file))]
    return [
        ProcessSpec(
            entry.name,
            (sys.executable, "-m", entry.module, *arguments),
            rank=entry.rank,
            restart=entry.restart,
            essential=entry.essential,
        )
        for entry in entries
    ]
