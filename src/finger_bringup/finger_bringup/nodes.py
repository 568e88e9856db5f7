# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What runs: the suite's nodes, in which order they come up, with which parameters.

`finger-rig up`, the launch files, the demo and the tests run the entries that `select`, `rig` and
`hand` give. The lifecycle nodes among them start unconfigured; the node `bring_up`, which is always
the last entry, configures and activates them in order, again after a refusal and again after a
restart. No ROS and no launch here: an entry becomes a command (`process_specs`) or a launch_ros
node (`launch.actions`); entries that are composed become one command.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from finger_common.axes import DEFAULT_NORMAL_AXIS
from finger_common.entry import command_of
from finger_common.errors import InputError, known_names, nearest
from finger_common.namespaces import DEFAULT_NAMESPACE, check_namespace, own_name
from finger_common.subject_code import FINGERS
from finger_common.trial_phases import TARGET_FORCE
from finger_sim.addresses import RigAddresses

from .parameter_files import NO_PARAMETER_FILE, ParameterFile, matches, write_parameter_file
from .supervisor import ProcessSpec

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by node (its `NodeEntry.path`) and parameter name."""


@dataclass(frozen=True)
class NodeEntry:
    """One node of the suite.

    name: node name within the namespace. package, executable: for `ros2 run` and launch files.
    rank: lower ranks come up earlier and end later. lifecycle: `bring_up` configures and activates
    it. restart: is started again when it ends by itself. essential: its end ends everything.
    composable: may share a process with others. parameters: what the suite must set itself; these
    override a parameter file. defaults: what it sets where the parameter file does not. finger:
    namespace below that of the suite, "" for none.
    """

    name: str
    package: str
    executable: str
    rank: int
    lifecycle: bool = True
    restart: bool = True
    essential: bool = False
    composable: bool = True
    parameters: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    finger: str = ""

    @property
    def path(self) -> str:
        """Name below the namespace of the suite: "model", "thumb/model"."""
        return f"{self.finger}/{self.name}" if self.finger else self.name

    def namespace(self, of_suite: str) -> str:
        """Full namespace of the node."""
        return "/" + "/".join(part for part in (of_suite.strip("/"), self.finger) if part)

    def full_name(self, of_suite: str) -> str:
        """Name of the node with its full namespace."""
        return f"{self.namespace(of_suite).rstrip('/')}/{self.name}"

    @property
    def module(self) -> str:
        """For `python -m`."""
        return f"{self.package}.{self.executable}"

    def with_parameters(self, **parameters: Any) -> NodeEntry:
        """The entry with further parameters set."""
        return replace(self, parameters={**self.parameters, **parameters})

    def with_defaults(self, **defaults: Any) -> NodeEntry:
        """The entry with further defaults."""
        return replace(self, defaults={**self.defaults, **defaults})


BRING_UP = NodeEntry("bring_up", "finger_bringup", "bring_up_node", 9, lifecycle=False)

COMPOSED = NodeEntry("nodes", "finger_bringup", "composed_node", 1, lifecycle=False)
"""The process of all nodes that are composed."""

NODES: dict[str, NodeEntry] = {
    entry.name: entry
    for entry in (
        # Computes whole presses; a process of its own, as real devices are outside of the nodes.
        NodeEntry("simulated_rig", "finger_sim", "rig_node", 0, composable=False),
        NodeEntry("force", "finger_driver", "force_node", 1),
        NodeEntry("camera", "finger_driver", "camera_node", 1),
        NodeEntry("moisture", "finger_driver", "moisture_node", 1),
        NodeEntry("vision", "finger_vision", "vision_node", 2),
        NodeEntry("model", "finger_model", "model_node", 2),
        NodeEntry("fit", "finger_fit", "fit_node", 3, composable=False),
        NodeEntry("recorder", "finger_bag", "recorder_node", 3),
        NodeEntry("protocol", "finger_operator", "protocol_node", 4),
        # Active at once, so that the operator sees which other nodes are missing.
        NodeEntry("page", "finger_operator", "page_node", 5, lifecycle=False),
        NodeEntry("foxglove", "finger_bridge", "foxglove_node", 5, lifecycle=False),
        NodeEntry("lsl", "finger_bridge", "lsl_node", 5, lifecycle=False),
        NodeEntry(
            "fit_request",
            "finger_bringup",
            "fit_request_node",
            5,
            lifecycle=False,
            restart=False,
            essential=True,
            composable=False,
        ),
        NodeEntry(
            "calibrate",
            "finger_operator",
            "calibrate_node",
            5,
            lifecycle=False,
            restart=False,
            essential=True,
            composable=False,
        ),
        BRING_UP,
    )
}
"""Every node there is, by name."""

RIG = ("force", "camera", "moisture", "vision", "model", "recorder", "protocol", "page")
"""Nodes of a measuring rig."""

GRASP = ("force", "model")
"""Nodes on a robot."""

OWN_PARAMETERS = Path(".finger_rig") / "parameters.yaml"
"""File of what the suite sets itself, in the folder of a rig: a user's parameters.yaml may be there
too."""

FRAMED = ("force", "camera", "moisture", "vision")
"""Nodes that name frames."""

SIMULATED_PATIENCE = 600.0
"""s that the drivers wait for the simulated rig: without it there is nothing to connect to, and it
may have to compile its kernels first."""


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

    wanted: names of NODES, or entries beside it. parameters: those of nodes that are not wanted
    have no effect. Raises InputError for a name that is not in NODES, and when nothing is left to
    run.
    """
    parameters = parameters or {}
    found = [entry_of(node) if isinstance(node, str) else node for node in wanted]
    for path in parameters.keys() - {entry.path for entry in found}:
        entry_of(path.rpartition("/")[2])
    entries = sorted((e for e in found if e.name != BRING_UP.name), key=lambda entry: entry.rank)
    if not entries:
        raise InputError("no node is left to run; leave out fewer, or name others to run")
    groups: dict[int, list[str]] = {}
    for entry in entries:
        if entry.lifecycle:
            groups.setdefault(entry.rank, []).append(entry.path)
    chosen = [
        entry.with_parameters(autostart=not entry.lifecycle, **parameters.get(entry.path, {}))
        for entry in entries
    ]
    if not groups:
        return chosen
    order = [" ".join(names) for names in groups.values()]
    own = parameters.get(BRING_UP.name, {})
    return [*chosen, BRING_UP.with_parameters(order=order, **own)]


def _less(names: Iterable[str], without: Iterable[str]) -> list[str]:
    """The names that are left; raises InputError for one to leave out that is not among them."""
    left = list(names)
    for name in without:
        if entry_of(name).name not in left:
            raise InputError(f"node '{name}' would not run anyway; do not name it to be left out")
        left.remove(name)
    return left


def rig(
    folder: Path,
    simulated: bool = False,
    without: Iterable[str] = (),
    parameters: Parameters | None = None,
    only: Iterable[str] = (),
    further: Iterable[str] = (),
) -> list[NodeEntry]:
    """Entries of a measuring rig.

    folder: of the sessions, unless the parameter file names another, and of the simulated devices.
    simulated: with simulated devices and participant. without: nodes to leave out. parameters: by
    node name, further ones. only: the nodes to run in place of all, beside the simulated rig.
    further: nodes to run beside these. Raises InputError for a node that does not exist, and for
    one in `without` that would not run.
    """
    names = list(only) or list(RIG)
    if simulated and "simulated_rig" not in names:
        names.insert(0, "simulated_rig")
    names += [name for name in further if name not in names]
    names = _less(names, without)
    defaults: dict[str, dict[str, Any]] = {
        "protocol": {"output": str(folder / "sessions")},
        "model": {"subjects_folder": str(folder / "subjects")},
    }
    if "recorder" not in names and not only:
        defaults["protocol"]["need_recorder"] = False
    devices = simulated_devices(RigAddresses.private(folder / "devices")) if simulated else {}
    entries = select(names, merged(devices, parameters or {}))
    return [entry.with_defaults(**defaults.get(entry.name, {})) for entry in entries]


HAND_NAMESPACE = "hand"


def check_fingers(fingers: Iterable[str]) -> list[str]:
    """The names; raises InputError for one that is no ROS name and for one that comes twice."""
    names = list(fingers)
    for name in names:
        if not re.fullmatch(r"(?!.*__)[A-Za-z][A-Za-z0-9_]*", name):
            raise InputError(
                f"finger '{name}' is no ROS name; use letters, digits and single _, a letter first"
            )
        if names.count(name) > 1:
            raise InputError(f"finger '{name}' is named twice; give each finger its own name")
    return names


def hand(
    fingers: Iterable[str] = FINGERS,
    only: Iterable[str] = (),
    without: Iterable[str] = (),
    parameters: Parameters | None = None,
    further: Iterable[str] = (),
) -> list[NodeEntry]:
    """Entries of several fingers side by side, each in a namespace of its own.

    fingers: their namespaces. only, without: the nodes of each finger, those of GRASP unless given.
    parameters: by the path of a node ("thumb/force"). further: nodes of the whole hand. Raises
    InputError as `rig`.
    """
    names = _less([entry_of(name).name for name in (only or GRASP)], without)
    entries = [
        replace(NODES[name], finger=finger) for finger in check_fingers(fingers) for name in names
    ]
    return select([*entries, *further], parameters)


def simulated_boards(fingers: Iterable[str]) -> tuple[list[ProcessSpec], dict[str, dict[str, Any]]]:
    """A simulated force sensor for each finger, which presses again and again, and the parameters
    that connect the force nodes to them.
    """
    specs, parameters = [], {}
    for finger in fingers:
        bus = RigAddresses.private(Path())
        options = f"port={bus.can_port}"
        command = [*command_of("finger_driver.simulators.cli"), "netcanoem"]
        command += ["--press", f"{TARGET_FORCE:g}", f"--axis={DEFAULT_NORMAL_AXIS}"]
        command += ["--channel", bus.can_channel, "--options", options]
        specs.append(ProcessSpec(f"{finger}/board", tuple(command)))
        parameters[f"{finger}/force"] = {
            "device": "netcanoem",
            "can_interface": "udp_multicast",
            "can_channel": bus.can_channel,
            "can_options": options,
        }
    return specs, parameters


def without_effect(
    entries: Iterable[NodeEntry], namespace: str, parameter_file: ParameterFile
) -> str:
    """A sentence that names the sections of the user's file which are of no node that runs, as
    where a finger's name is misspelt; empty where there are none.

    Sections of all namespaces may be of nodes that do not run now, as in config/rig.yaml.
    """
    names = [entry.full_name(namespace) for entry in entries]
    of_all = [f"/{name}" for name in NODES]
    idle = []
    for section in parameter_file.sections:
        known = names if "*" not in section else [*names, *of_all]
        if not any(matches(section, name) for name in known):
            near = nearest(f"/{section.strip('/')}", names)
            idle.append(f"'{section}'" + (f" (did you mean '{near}'?)" if near else ""))
    if not idle:
        return ""
    sections = f"sections {', '.join(idle)} are" if len(idle) > 1 else f"section {idle[0]} is"
    return f"{parameter_file.path}: {sections} of no node that runs here, and without effect"


_DEVICES = {"force": "sensor", "camera": "camera"}
"""What two fingers must not share, by the node that reads it and the package of its drivers."""


def _address(node: str, values: Mapping[str, Any]) -> str:
    """What tells the device of a node of these parameters from others; empty where it is not
    known."""
    # Not before it is needed: cameras take a while to import.
    kinds = importlib.import_module(f"finger_driver.{node}").SOURCES
    try:
        kind = kinds.load(str(values.get(kinds.choice, kinds.default)))
        return str(kind.SETTINGS.select(values).address())
    except InputError:
        return ""  # the node itself says what is wrong


def shared_sensors(
    entries: Iterable[NodeEntry], namespace: str, parameter_file: ParameterFile
) -> str:
    """A sentence that names the nodes of several fingers which read one sensor, camera or wrench,
    as where a section was copied; empty where there are none.
    """
    entries = list(entries)
    names = [entry.name for entry in entries]
    readers: dict[str, list[str]] = {}
    for entry in (entry for entry in entries if names.count(entry.name) > 1):
        name = entry.full_name(namespace)
        values = {**parameter_file.values_of(name), **entry.parameters}
        if entry.name == "model":
            topic = str(values.get("wrench_topic", "wrench"))
            own = f"{entry.namespace(namespace).rstrip('/')}/"
            what = "wrench_topic " + (topic if topic.startswith("/") else own + topic)
        elif entry.name in _DEVICES:
            address = _address(entry.name, values)
            if not address:
                continue
            what = f"{_DEVICES[entry.name]} ({address})"
        else:
            continue
        readers.setdefault(what, []).append(f"'{name}'")
    shared = [f"{', '.join(n)} read the same {what}" for what, n in readers.items() if len(n) > 1]
    return "; ".join(shared) + "; give each finger its own" if shared else ""


def settled(
    entries: Iterable[NodeEntry],
    namespace: str,
    parameter_file: ParameterFile = NO_PARAMETER_FILE,
) -> list[NodeEntry]:
    """The entries with each default that the user's file does not set among their parameters.

    Frames, and cameras whose calibration is found by their name, have names of their own in each
    namespace but the usual one. Raises InputError for a namespace that ROS does not take.
    """
    check_namespace(namespace)
    result = []
    for entry in entries:
        prefix = own_name(entry.namespace(namespace), "/")
        set_there = parameter_file.values_of(entry.full_name(namespace))
        own: dict[str, Any] = {}
        if prefix and entry.name in FRAMED:
            own["frame_prefix"] = f"{prefix}/"
        if prefix and entry.name == "camera":
            if not {**set_there, **entry.parameters}.get("camera_info_url"):
                own["camera_name"] = f"{prefix.replace('/', '_')}_camera"
        entry = replace(entry, defaults={**own, **entry.defaults})
        free = {key: value for key, value in entry.defaults.items() if key not in set_there}
        result.append(replace(entry, parameters={**free, **entry.parameters}, defaults={}))
    return result


def process_specs(
    entries: Iterable[NodeEntry],
    folder: Path,
    namespace: str = DEFAULT_NAMESPACE,
    parameter_file: ParameterFile = NO_PARAMETER_FILE,
    compose: bool = False,
    realtime: bool = False,
) -> list[ProcessSpec]:
    """Commands that run the entries with this Python.

    parameter_file: of the user; it overrides defaults, not parameters of an entry.
    folder: where the file of the entries' own parameters is written, out of the way of other files
    (OWN_PARAMETERS). compose: run all that can share a process in one. realtime: that process has
    real-time priority.
    """
    entries = settled(entries, namespace, parameter_file)
    values = {entry.full_name(namespace): entry.parameters for entry in entries}
    files = parameter_file.path, write_parameter_file(values, folder / OWN_PARAMETERS)
    arguments = [part for file in files if file for part in ("--params-file", str(file))]
    together = [entry for entry in entries if compose and entry.composable]
    specs = [
        ProcessSpec(
            entry.path,
            (
                *(*command_of(entry.module), "--ros-args"),
                *("-r", f"__ns:={entry.namespace(namespace)}", *arguments),
            ),
            rank=entry.rank,
            restart=entry.restart,
            essential=entry.essential,
        )
        for entry in entries
        if entry not in together
    ]
    if together:
        members = composed_arguments(together, namespace, realtime)
        command = (*command_of(COMPOSED.module), *members, "--ros-args", *arguments)
        specs.append(ProcessSpec(COMPOSED.name, command, COMPOSED.rank))
    return specs


def composed_arguments(
    entries: Iterable[NodeEntry], namespace: str, realtime: bool = False
) -> list[str]:
    """Arguments of `composed_node` that make it run the entries, with real-time priority or not."""
    return ["--realtime"] * realtime + [
        f"{entry.namespace(namespace)}={entry.module}" for entry in entries
    ]
