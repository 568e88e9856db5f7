# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How the streams of a bag are found and read: topic names, namespace, axis, mapping file."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Any, TypeVar

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES
from finger_common.cli import add_settings
from finger_common.settings import Settings, setting

from .mapping import TopicMapping

Read = TypeVar("Read", bound="ReadSettings")


@dataclass(frozen=True)
class ReadSettings(Settings):
    """Where the streams are in a bag. `mapping` is a checked mapping file."""

    mapping: TopicMapping = field(default_factory=TopicMapping)
    namespace: str = setting(
        "", "Namespace of the rig's topics, if there are several; '/' for none."
    )
    wrench_topic: str = setting("wrench", "Force to use: wrench, wrench_raw or an absolute name.")
    normal_axis: str = setting(
        "",
        "Sensor axis along which force is positive when the finger presses; empty: that of the "
        f"mapping file, else {DEFAULT_NORMAL_AXIS}.",
        choices=("", *NORMAL_AXES),
    )

    @property
    def axis(self) -> str:
        """Normal axis in force."""
        return self.normal_axis or self.mapping.normal_axis or DEFAULT_NORMAL_AXIS


def add_read_options(parser: argparse.ArgumentParser, cls: type[ReadSettings]) -> None:
    """Give a command the options of ReadSettings, or of settings derived from it."""
    reading = parser.add_argument_group("how the bag is read")
    reading.add_argument(
        "--mapping", metavar="FILE", help="YAML file with other topic names, units"
    )
    add_settings(reading, cls)


def read_settings_from(args: argparse.Namespace, cls: type[Read], **more: Any) -> Read:
    """Settings from parsed options and `more` fields; raises InputError for a bad mapping file."""
    mapping = TopicMapping.load(args.mapping) if args.mapping else TopicMapping()
    values = {p.name: getattr(args, p.name) for p in cls.parameters()}
    return cls(mapping=mapping, **values, **more)
