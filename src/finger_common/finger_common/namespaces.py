# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Names that follow from a finger's namespace, so that fingers side by side never meet."""

from __future__ import annotations

import re
from pathlib import Path
from zlib import crc32

from .errors import InputError

DEFAULT_NAMESPACE = "finger"
"""Namespace of the only finger; its folder and frames bear no further name."""


def check_namespace(namespace: str) -> None:
    """Raise InputError for a namespace that ROS does not take; "" and "/" are the global one."""
    parts = namespace.strip("/").split("/") if namespace.strip("/") else []
    for part in parts:
        if not re.fullmatch(r"(?!.*__)[A-Za-z_][A-Za-z0-9_]*", part):
            raise InputError(
                f"namespace '{namespace}' is not one of ROS; use letters, digits and single _ "
                "between single slashes, and no digit at the beginning of a part"
            )


def own_name(namespace: str, separator: str) -> str:
    """What tells a finger's folder and frames from those of others; "" for the usual namespace."""
    namespace = namespace.strip("/")
    return "" if namespace == DEFAULT_NAMESPACE else namespace.replace("/", separator)


def default_folder(namespace: str = DEFAULT_NAMESPACE) -> Path:
    """Folder of a rig's sessions and simulated devices: out/rig, out/rig_thumb, …"""
    name = own_name(namespace, "_")
    return Path("out") / (f"rig_{name}" if name else "rig")


def own_port(namespace: str, usual: int) -> int:
    """`usual` for the usual namespace and for none, else one of the 8000 above it by the name.

    Two names rarely have one port; whoever opens it must see whether it is in use.
    """
    name = own_name(namespace, "/")
    return usual + 1 + crc32(name.encode()) % 8000 if name else usual
