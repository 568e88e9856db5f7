# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Interface definitions of ROS types in the form that Foxglove and MCAP call "ros2msg".

That form is the text of the `.msg` file, then the text of every message it refers to, each after a
line of "=" and a line "MSG: package/Name". A service gives two such texts. The files are those that
the package of the type has installed.
"""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

from .errors import InputError

_SEPARATOR = "\n" + "=" * 80 + "\nMSG: "
_FIELD = re.compile(r"^\s*([a-zA-Z]\w*(?:/[a-zA-Z]\w*)*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[a-zA-Z]\w*")
_PRIMITIVE = re.compile(r"^(bool|byte|char|float32|float64|u?int(8|16|32|64)|w?string)$")


def message_text(message_type: str) -> str:
    """Definition of a message such as "std_msgs/msg/String"; raises InputError when not found."""
    package, _, name = message_type.partition("/msg/")
    return _with_referred(package, _file(package, f"msg/{name}.msg"))


def service_texts(service_type: str) -> tuple[str, str]:
    """Definitions of request and response of a service such as "std_srvs/srv/Trigger".

    Raises InputError when a file is not found or has no line "---".
    """
    package, _, name = service_type.partition("/srv/")
    text = _file(package, f"srv/{name}.srv")
    parts = re.split(r"^---\s*$", text, flags=re.MULTILINE)
    if len(parts) != 2:
        raise InputError(f"interface file of '{service_type}' has no line '---'; install it again")
    request, response = parts
    return _with_referred(package, request), _with_referred(package, response)


def _file(package: str, path: str) -> str:
    """Text of a file below a package's share folder, which lies beside its Python module."""
    spec = importlib.util.find_spec(package)
    for above in Path(spec.origin).parents if spec is not None and spec.origin else ():
        file = above / "share" / package / path
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise InputError(
        f"interface file {path} of package '{package}' is not found; install the package"
    )


def _with_referred(package: str, text: str) -> str:
    parts = [text.strip()]
    pending, seen = _referred(package, text), set()
    while pending:
        name = pending.pop(0)
        if name in seen:
            continue
        seen.add(name)
        owner, _, message = name.partition("/")
        referred = _file(owner, f"msg/{message}.msg")
        parts.append(f"{name}\n{referred.strip()}")
        pending += _referred(owner, referred)
    return _SEPARATOR.join(parts)


def _referred(package: str, text: str) -> list[str]:
    """Messages named in a definition, as "package/Name"."""
    found = []
    for line in text.splitlines():
        field = _FIELD.match(line.partition("#")[0])
        if field is None or _PRIMITIVE.match(field[1]):
            continue
        parts = field[1].split("/")
        found.append(f"{parts[0] if len(parts) > 1 else package}/{parts[-1]}")
    return found
