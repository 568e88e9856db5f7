"""Write docs/nodes.md and src/finger_bringup/config/rig.yaml from the nodes' own descriptions.

`python scripts/node_reference.py` writes both; `--check` only checks whether they are current (exit
code 1 if not). The parameters come from the tables the nodes declare, topics and services from the
calls in their sources, the meaning of topics from the bag schema, messages from the comments of the
interface files.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import re
import sys
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from finger_bag.schema import TOPICS
from finger_common.files import atomic_write
from finger_common.node import ManagedNode, NodeSettings
from finger_common.parameters import Parameter, ParameterTable

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "docs" / "nodes.md"
RIG_FILE = ROOT / "src" / "finger_bringup" / "config" / "rig.yaml"

ORDER = (
    "force camera moisture vision model recorder fit protocol page foxglove lsl bring_up "
    "fit_request simulated_rig"
).split()
"""Nodes in the reader's order."""

IN_RIG_FILE = "force camera moisture vision model recorder protocol page foxglove lsl".split()

OTHER_TOPICS = {
    "contact_image": "the image with the contact's outline, made only while a node subscribes",
    "/diagnostics": "health of every source, once a second",
    "/parameter_events": "changes of parameters, which clients are told",
    "heartbeat": "names of the nodes that run, four times a second",
    "trial": "the current trial and its phase, latched",
    "calibration": "what the newest calibration of a subject found, with deviations, latched",
    "~/status": "everything the operator's page shows of the session, latched",
    "protocol/status": "the protocol node's `~/status`",
    "~/entered": "a reading entered by the operator, in a.u.",
}

SERVICE_MEANINGS = {
    "~/tare": "take the present reading, if it is still, as zero",
    "~/reset_tare": "back to the untared reading",
    "~/reset": "forget the past: a finger at rest (model), a new background (vision)",
    "~/new_surface": "another object or plate: forget what was learned of friction",
    "~/record": "start or stop a recording",
    "~/fit": "fit parameters to bags; feedback per round, cancel keeps the best so far",
    "~/force_for_area": "the force that, held from now on, gives an area",
    "~/predict": "contact under a future force history",
    "~/set_moisture": "a reading entered by the operator",
    "~/set_camera_info": "store a lens calibration",
}

CALLS = {
    "create_stream_publisher": "publishes",
    "create_publisher": "publishes",
    "create_lifecycle_publisher": "publishes",
    "create_stream_subscription": "subscribes",
    "create_subscription": "subscribes",
    "create_waited_subscription": "subscribes",
    "create_polled_subscription": "subscribes",
    "PolledSubscription": "subscribes",
    "create_service": "serves",
    "ActionServer": "serves",
    "create_client": "calls",
    "ActionClient": "calls",
}

NODE_FIRST = ("PolledSubscription", "ActionServer", "ActionClient")
"""Calls whose first argument is the node."""


@dataclass
class NodeDescription:
    """One node: class, its module and the topics and services in its source."""

    cls: type[ManagedNode]
    module: Any
    package: str
    uses: dict[str, list[tuple[str, str]]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.cls.NAME

    @property
    def executable(self) -> str:
        return str(self.module.__name__.rsplit(".", 1)[-1])


def text_of(node: ast.expr, module: Any) -> str | None:
    """Topic named by an expression: a string, or a parameter's default where it is a parameter."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if (
        isinstance(node, ast.Subscript)
        and isinstance(node.slice, ast.Constant)
        and ast.unparse(node.value).endswith("values")
    ):
        table = next(
            (
                c.parameter_table()
                for c in vars(module).values()
                if isinstance(c, type)
                and issubclass(c, ManagedNode)
                and c.__module__ == module.__name__
            ),
            None,
        )
        if table is not None and node.slice.value in table:
            return str(table[node.slice.value].default)
    return None


def sources_of(module: Any) -> list[Path]:
    """Source of a node's module, and of its parts in the package's folder `node`."""
    package = module.__name__.partition(".")[0]
    used = {getattr(value, "__module__", "") or "" for value in vars(module).values()}
    parts = sorted(name for name in used if name.startswith(f"{package}.node."))
    return [Path(sys.modules[name].__file__ or "") for name in (module.__name__, *parts)]


def uses_of(module: Any) -> dict[str, list[tuple[str, str]]]:
    """Kind of use -> (name, interface type) from the calls in a node's source."""
    trees = [ast.parse(source.read_text()) for source in sources_of(module)]
    found: dict[str, list[tuple[str, str]]] = {}
    for call in [n for tree in trees for n in ast.walk(tree) if isinstance(n, ast.Call)]:
        function = (
            call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        )
        kind = CALLS.get(str(function))
        arguments = call.args[1:] if function in NODE_FIRST else call.args
        if kind is not None and any(isinstance(a, ast.Starred) for a in call.args):
            raise SystemExit(f"{module.__name__}: write name and type into each {function}()")
        if kind is None or len(arguments) < 2:
            continue
        name = text_of(arguments[1], module)
        if name is not None:
            entry = (name, ast.unparse(arguments[0]))
            if entry not in found.setdefault(kind, []):
                found[kind].append(entry)
    for name in (
        getattr(module, "SERVICES", {})
        if isinstance(getattr(module, "SERVICES", None), dict)
        else ()
    ):
        found.setdefault("serves", []).append((f"~/{name}", "Trigger"))
    for command in getattr(module, "COMMANDS", {}).values():  # of the operator's page
        if command.service:
            found.setdefault("calls", []).append((command.service, ""))
    return found


def own_parameters(cls: type[ManagedNode]) -> ParameterTable:
    """The node's parameters beside those of every node."""
    common = NodeSettings.parameters()
    return ParameterTable(*(p for p in cls.parameter_table() if p.name not in common))


def descriptions() -> list[NodeDescription]:
    """All nodes of the suite in the reader's order."""
    found = {}
    for file in sorted((ROOT / "src").glob("*/*/*_node.py")):
        package = file.parent.name
        if file.parent.parent.name != package:
            continue
        module = importlib.import_module(f"{package}.{file.stem}")
        for cls in vars(module).values():
            if (
                isinstance(cls, type)
                and issubclass(cls, ManagedNode)
                and cls.__module__ == module.__name__
                and hasattr(module, "main")
            ):
                found[cls.NAME] = NodeDescription(cls, module, package, uses_of(module))
    unknown = sorted(set(found) - set(ORDER))
    return [found[name] for name in [*ORDER, *unknown] if name in found]


# The reference ------------------------------------------------------------------------------------


def topic_meaning(name: str) -> str:
    """What a topic carries."""
    spec = TOPICS.get(name)
    return spec.meaning if spec else OTHER_TOPICS.get(name, "")


def uses_markdown(node: NodeDescription) -> list[str]:
    """Tables of topics and services."""
    lines = []
    services = getattr(node.module, "SERVICES", {})
    topics = [
        (direction, name, kind)
        for direction in ("publishes", "subscribes")
        for name, kind in node.uses.get(direction, [])
    ]
    if topics:
        lines += ["| | topic | type | carries |", "|---|---|---|---|"]
        lines += [f"| {d} | `{n}` | {t} | {topic_meaning(n)} |" for d, n, t in topics]
        lines.append("")
    offered = node.uses.get("serves", [])
    if offered:
        lines += ["| service or action | type | does |", "|---|---|---|"]
        for name, kind in offered:
            own = services.get(name.removeprefix("~/"), "") if isinstance(services, dict) else ""
            lines.append(f"| `{name}` | {kind} | {own or SERVICE_MEANINGS.get(name, '')} |")
        lines.append("")
    called = node.uses.get("calls", [])
    if called:
        names = ", ".join(f"`{name}`" for name, _ in called)
        lines += [*textwrap.wrap(f"Calls: {names}.", 100, break_on_hyphens=False), ""]
    return lines


def summary(node: NodeDescription) -> str:
    """The module's docstring without what is for developers only."""
    return (node.module.__doc__ or "").strip()


def escaped(table: str) -> str:
    """A table whose code spans may hold vertical bars."""
    return re.sub(r"`[^`\n]*`", lambda code: code.group().replace("|", "\\|"), table)


def messages_markdown() -> list[str]:
    """Interface files as they are."""
    lines = ["## Messages, services and actions", ""]
    for folder, kind in (("msg", "Message"), ("srv", "Service"), ("action", "Action")):
        for file in sorted((ROOT / "src" / "finger_msgs" / folder).iterdir()):
            lines += [
                f"### {kind} finger_msgs/{file.stem}",
                "",
                "```",
                file.read_text().strip(),
                "```",
                "",
            ]
    return lines


def reference() -> str:
    """Text of docs/nodes.md."""
    nodes = descriptions()
    lines = [
        "# Nodes, topics, services and parameters",
        "",
        "<!-- Written by scripts/node_reference.py from the sources; a test compares them. -->",
        "",
        "Names without a leading `/` are relative to the namespace (`finger` in the launch files);",
        "`~` is the node's own name. Units are SI on every topic and in every parameter. Each node",
        "publishes its health on `/diagnostics` once a second and is a lifecycle node: `configure`",
        "connects and checks, `activate` begins to publish. Start one with",
        "`ros2 run PACKAGE EXECUTABLE` or `python -m PACKAGE.EXECUTABLE`.",
        "",
        "| node | package | executable |",
        "|---|---|---|",
        *(f"| [{n.name}](#{n.name}) | {n.package} | `{n.executable}` |" for n in nodes),
        "",
        "Parameters that every node has:",
        "",
        NodeSettings.parameters().markdown(),
        "",
        "Frames and axes are on the page about [setting up the rig](rig_setup.md#frames-and-axes).",
        "",
    ]
    for node in nodes:
        lines += [f"## {node.name}", "", summary(node), ""]
        lines += uses_markdown(node)
        if list(own_parameters(node.cls)):
            lines += [escaped(own_parameters(node.cls).markdown()), ""]
    lines += messages_markdown()
    return "\n".join(lines).rstrip() + "\n"


# The rig's parameter file
# --------------------------------------------------------------------------


def comment(parameter: Parameter) -> str:
    """Comment lines of one key: meaning, unit, default, range, when it counts, advice."""
    text = parameter.meaning.rstrip()
    if not text.endswith((".", "!", "?")):
        text += "."
    facts = []
    if parameter.unit:
        facts.append(f"unit {parameter.unit}")
    facts.append(f"default {yaml_text(parameter.default)}")
    allowed = parameter.range_text()
    if allowed:
        facts.append(f"{'one of' if parameter.choices else 'range'} {allowed}")
    facts.append("may change while running" if parameter.runtime else "read at configure")
    text += f" [{'; '.join(facts)}]"
    if parameter.advice:
        text += f" In trouble: {parameter.advice}"
    return textwrap.fill(
        text, 100, initial_indent="    # ", subsequent_indent="    # ", break_on_hyphens=False
    )


def yaml_text(value: Any) -> str:
    """A value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=10**6)
    return text.removesuffix("\n...\n").strip()


def entry(parameter: Parameter) -> str:
    """One key with its default; a list that does not fit on a line has one item on each."""
    line = f"    {parameter.name}: {yaml_text(parameter.default)}"
    if len(line) <= 100 or not isinstance(parameter.default, (list, tuple)):
        return line
    items = [f"      - {yaml_text(item)}" for item in parameter.default]
    return "\n".join([f"    {parameter.name}:", *items])


def rig_file() -> str:
    """Text of config/rig.yaml."""
    lines = [
        "# Parameters of the rig, for `ros2 launch finger_bringup rig.launch.py parameters:=…` and",
        "# `finger-rig up --parameters …`. Copy it, change what your rig needs, delete the rest:",
        "# what is not named here keeps its default. Units are SI. `/**/` fits every namespace.",
        "#",
        "# Written by scripts/node_reference.py from the nodes' tables; values are defaults.",
    ]
    by_name = {node.name: node for node in descriptions()}
    for name in IN_RIG_FILE:
        node = by_name[name]
        lines += ["", f"/**/{name}:", "  ros__parameters:"]
        for parameter in [*own_parameters(node.cls), *NodeSettings.parameters()]:
            if parameter.name == "autostart":
                continue  # set by the launch files and finger-rig
            lines += [comment(parameter), entry(parameter)]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="only check whether the files are current"
    )
    args = parser.parse_args()
    stale = []
    for file, text in ((REFERENCE, reference()), (RIG_FILE, rig_file())):
        if file.exists() and file.read_text() == text:
            continue
        stale.append(str(file.relative_to(ROOT)))
        if not args.check:
            with atomic_write(file) as out:
                out.write(text)
    if args.check and stale:
        print(f"not current: {', '.join(stale)}; run python scripts/node_reference.py")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
