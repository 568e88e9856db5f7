# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ROS parameter files: that of the user, and the suite's own."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from finger_common.errors import InputError
from finger_common.files import atomic_write, load_yaml


@dataclass(frozen=True)
class ParameterFile:
    """The user's parameter file, read once when it is first asked; path None: there is none."""

    path: Path | None

    @cached_property
    def sections(self) -> dict[str, Mapping[str, Any]]:
        """Parameters by node pattern; raises InputError naming file and key."""
        found: dict[str, Mapping[str, Any]] = {}
        data = {} if self.path is None else load_yaml(self.path, "parameter file")
        for node, section in _below_namespaces(data):
            values = section.get("ros__parameters") if isinstance(section, dict) else None
            if not isinstance(values, dict):
                raise InputError(
                    f"{self.path}: '{node}' has no 'ros__parameters' with 'name: value' lines; "
                    "see the rig parameter file of finger_bringup"
                )
            if len(section) > 1:
                others = ", ".join(f"'{key}'" for key in section if key != "ros__parameters")
                raise InputError(
                    f"{self.path}: '{node}' has {others} beside 'ros__parameters', which ROS does "
                    "not take; move that to a section of its own"
                )
            _check_values(values, f"{self.path}: '{node}'")
            found[node] = {**found.get(node, {}), **values}
        return found

    def values_of(self, node: str) -> dict[str, Any]:
        """What it sets of a node of this full name; of a parameter set twice, the last value."""
        values: dict[str, Any] = {}
        for pattern, section in self.sections.items():
            if matches(pattern, node):
                values.update(section)
        return values

    def unknown_parameters(
        self, nodes: Collection[str], unknown: Mapping[tuple[str, str], str]
    ) -> list[str]:
        """Its parameters that none of the nodes which they are set for has, with what was meant.

        nodes: full names of those that run. unknown: (node, parameter) that a node does not have,
        and the sentence about it. A parameter of a section of several nodes may be of one of them.
        """
        found = []
        for pattern, section in self.sections.items():
            own = [node for node in nodes if matches(pattern, node)]
            for name in _names(section):
                if own and all((node, name) in unknown for node in own):
                    meant = re.search(r"did you mean '[^']*'\?", unknown[own[0], name])
                    note = f" ({meant[0]})" if meant and len(own) == 1 else ""
                    found.append(f"'{name}' of '{pattern}'{note}")
        return found


NO_PARAMETER_FILE = ParameterFile(None)


def _below_namespaces(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Sections by node pattern; a mapping of mappings is a namespace, whose nodes are below it."""
    for name, section in data.items():
        inner = section.values() if isinstance(section, dict) else ()
        if inner and "ros__parameters" not in section and all(isinstance(v, dict) for v in inner):
            for below, found in _below_namespaces(section):
                yield f"{name}".rstrip("/") + "/" + f"{below}".lstrip("/"), found
        else:
            yield name, section


def _names(section: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """Names of a section's parameters; a mapping holds those that begin with its key."""
    for key, value in section.items():
        if isinstance(value, dict):
            yield from _names(value, f"{before}{key}.")
        else:
            yield f"{before}{key}"


def _check_values(values: Mapping[str, Any], where: str) -> None:
    """Raise InputError, naming `where` and the key, for what ROS does not read: it would say a line
    of its own source. A mapping holds parameters whose names begin with its key."""
    for name, value in values.items():
        if isinstance(value, dict):
            _check_values(value, f"{where}: '{name}'")
        elif value is None:
            raise InputError(
                f"{where}: '{name}' has no value; give one, or leave it out (a decimal comma is "
                "written as a point)"
            )
        elif isinstance(value, list):
            # Dates are text to ROS.
            kinds = {k if k in (bool, int, float, dict, list) else str for k in map(type, value)}
            if kinds & {dict, list}:
                raise InputError(f"{where}: '{name}' is a list of lists; write it as [a, b]")
            if len(kinds) > 1:
                raise InputError(
                    f"{where}: '{name}' holds values of several types; put all of them in quotes, "
                    "or give all a decimal point"
                )


def matches(pattern: str, node: str) -> bool:
    """Whether a key of a parameter file means a node of this full name; * and ** as in ROS."""
    text = re.escape("/" + pattern.strip("/"))
    text = text.replace(r"/\*\*", r"(/[^/]+)*").replace(r"\*", r"[^/]+")
    return re.fullmatch(text, node) is not None


class QuotingDumper(yaml.SafeDumper):
    """Writes all text in quotes: ROS takes more of it for numbers and truth values than YAML 1.1
    does, such as 1e3 and y.
    """

    def represent_str(self, data: str) -> yaml.ScalarNode:
        """As text, whatever it looks like."""
        return self.represent_scalar("tag:yaml.org,2002:str", data, style='"')


QuotingDumper.add_representer(str, QuotingDumper.represent_str)


def write_parameter_file(values: Mapping[str, Mapping[str, Any]], path: Path) -> Path:
    """Write parameters by the full name of their node, and return the file's path."""
    data = {node: {"ros__parameters": dict(own)} for node, own in values.items() if own}
    with atomic_write(path) as file:
        yaml.dump(data, file, QuotingDumper, sort_keys=False, allow_unicode=True)
    return path
