# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 message types without ROS: definitions, type hashes, CDR to objects and plain data to CDR.

The suite's own types are shipped as copies of the interface files of finger_msgs, so that this
package reads and writes bags where no ROS is installed; the standard ones come from `rosbags`.
Definitions found in a bag take precedence when the bag is read: it may come from another
distribution.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from rosbags.interfaces import MessageDefinitionFormat, Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from finger_common.errors import InputError

MAXIMUM_DEFINITION = 128 * 1024
"""Bytes of a definition above which it is not parsed; the common packages have 50 kB at most."""

MAXIMUM_FIELDS = 2000
"""Fields of a definition above which it is refused, as code is generated for each.

Fixed arrays of strings and messages count by element.
"""

MAXIMUM_SEQUENCE = 1 << 28
"""Elements of a sequence above which a message is refused."""

_SEPARATOR = "=" * 80

BROKEN_MESSAGE = (
    SerdeError,
    TypesysError,
    struct.error,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    AssertionError,
    RecursionError,
    OverflowError,
    MemoryError,
    SyntaxError,
)
"""What parsers of definitions and messages raise on malformed input."""


@dataclass
class TopicInfo:
    """A topic of a bag. `count` is None where it is not known without reading the bag."""

    name: str
    type: str
    encoding: str = "cdr"
    definition: str = ""
    form: str = ""
    qos: str = ""
    count: int | None = None


def own_definition(message_type: str) -> str | None:
    """Text of the interface file of a type of finger_msgs, None for another package's."""
    package, _, name = message_type.partition("/msg/")
    if package != "finger_msgs":
        return None
    file = resources.files(__package__) / "data" / "finger_msgs" / f"{name}.msg"
    return file.read_text(encoding="utf-8") if file.is_file() else None


def own_types() -> list[str]:
    """Types of finger_msgs that may be in a bag, such as "finger_msgs/msg/Trial"."""
    folder = resources.files(__package__) / "data" / "finger_msgs"
    names = sorted(f.name for f in folder.iterdir() if f.name.endswith(".msg"))
    return [f"finger_msgs/msg/{name.removesuffix('.msg')}" for name in names]


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Store of the standard types of ROS 2 Jazzy and of finger_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for message_type in own_types():
        types.update(get_types_from_msg(own_definition(message_type) or "", message_type))
    store.register(types)
    return store


@lru_cache(maxsize=256)
def definition_text(message_type: str) -> str:
    """Definition with everything it refers to, in the concatenated form of MCAP's "ros2msg"
    schemas.

    Raises InputError for a type that is not known.
    """
    store = typestore()
    if message_type not in store.fielddefs:
        raise InputError(f"message type '{message_type}' is not known; give its definition")
    text, _ = store.generate_msgdef(message_type, ros_version=2)
    own = own_definition(message_type)
    if own is None:
        return text
    # The interface file with its comments on units and flags, then what it refers to.
    _, separator, referred = text.partition(_SEPARATOR)
    return own.rstrip("\n") + "\n" + separator + referred


@lru_cache(maxsize=256)
def type_hash(message_type: str) -> str:
    """Hash of a type as in REP 2016 ("RIHS01_…"); empty for a type that is not known."""
    store = typestore()
    return store.hash_rihs01(message_type) if message_type in store.fielddefs else ""


class Decoder:
    """Turns CDR bytes of one type into objects with the message's fields as attributes.

    definition: text in the bag; when it is absent or equal to the known one, the known one serves.
    Raises InputError for a definition that cannot be parsed and for a type that nothing defines.
    """

    def __init__(self, message_type: str, definition: str = "", form: str = "ros2msg") -> None:
        self.type = message_type
        known = typestore()
        self._store = known
        self.standard = True
        """Whether the type has the same fields as the one known to this package."""
        if definition:
            types = _parse(message_type, definition, form)
            if message_type not in types:
                raise InputError(f"definition of '{message_type}' in the bag does not define it")
            if any(
                name not in known.fielddefs or types[name][1] != known.fielddefs[name][1]
                for name in types
            ):
                self._store = _store_of(message_type, types)
                self.standard = message_type in known.fielddefs and all(
                    types[name][1] == known.fielddefs[name][1]
                    for name in _referred(message_type, types)
                    if name in known.fielddefs and name in types
                )
        elif message_type not in known.fielddefs:
            raise InputError(
                f"message type '{message_type}' is neither known nor defined in the bag; "
                "record it with a distribution that stores definitions (Iron or later, or MCAP)"
            )

    def __call__(self, raw: bytes | memoryview) -> Any:
        """Message object; raises InputError for bytes that are not a message of this type."""
        try:
            return self._store.deserialize_cdr(raw, self.type)
        except BROKEN_MESSAGE as error:
            detail = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
            raise InputError(f"bytes are not a message of type '{self.type}' ({detail})") from None


def _parse(message_type: str, definition: str, form: str) -> dict[str, Any]:
    if len(definition) > MAXIMUM_DEFINITION:
        raise InputError(
            f"definition of '{message_type}' has {len(definition)} characters, "
            f"{MAXIMUM_DEFINITION} are read at most; the bag is damaged"
        )
    definition = _plain(definition)
    try:
        if form == "ros2idl" or definition.startswith(_SEPARATOR + "\nIDL:"):
            return dict(get_types_from_idl(definition))
        return dict(get_types_from_msg(definition, message_type))
    except BROKEN_MESSAGE:
        raise InputError(f"definition of '{message_type}' in the bag cannot be parsed") from None


def _plain(definition: str) -> str:
    """As Linux tools write it: others end lines otherwise, leave blanks, or begin with a mark."""
    lines = [line.rstrip(" \t\0") for line in re.split("\r\n|\r|\n", definition.lstrip("\ufeff"))]
    lines = [_SEPARATOR if re.fullmatch("={3,}", line) else line for line in lines]
    return re.sub(f"{_SEPARATOR}\n+", f"{_SEPARATOR}\n", "\n".join(lines))


def fields_of(message_type: str, definition: str, form: str) -> str:
    """Names and types of all fields of a type at any depth: equal where only comments, constants
    or spaces of two definitions differ; the definition itself where it cannot be parsed."""
    known = typestore().fielddefs
    try:
        types = {**known, **(_parse(message_type, definition, form) if form else {})}
        return repr([(name, types[name][1]) for name in sorted(_referred(message_type, types))])
    except (InputError, KeyError):
        return definition


def _names(description: Any) -> list[str]:
    kind, value = description
    if kind == Nodetype.NAME:
        return [value]
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _names(value[0])
    return []


def _referred(message_type: str, types: Mapping[str, Any]) -> set[str]:
    """The type and every type below it."""
    seen: set[str] = set()
    pending = [message_type]
    while pending:
        name = pending.pop()
        if name in seen:
            continue
        seen.add(name)
        for _, description in types[name][1] if name in types else []:
            pending += _names(description)
    return seen


def _store_of(message_type: str, types: dict[str, Any]) -> Typestore:
    """Store of the given types and the standard ones they refer to without defining them."""
    known = typestore()
    types = dict(types)
    for name in _referred(message_type, {**known.fielddefs, **types}):
        if name not in types:
            if name not in known.fielddefs:
                raise InputError(
                    f"definition of '{message_type}' in the bag refers to '{name}' "
                    "and does not define it"
                )
            types[name] = known.fielddefs[name]
    if _size(types) > MAXIMUM_FIELDS:
        raise InputError(
            f"definition of '{message_type}' in the bag has more than {MAXIMUM_FIELDS} fields; "
            "the bag is damaged"
        )
    if _is_recursive(message_type, types):
        raise InputError(f"definition of '{message_type}' in the bag contains itself")
    store = Typestore(max_sequence_length=MAXIMUM_SEQUENCE)
    try:
        store.register(types)
        store.get_msgdef(message_type)
    except BROKEN_MESSAGE:
        raise InputError(f"definition of '{message_type}' in the bag cannot be used") from None
    return store


def _size(types: Mapping[str, Any]) -> int:
    total = 0
    for _, fields in types.values():
        for _, (kind, value) in fields:
            plain = kind != Nodetype.ARRAY or (
                value[0][0] == Nodetype.BASE and value[0][1][0] not in ("string", "wstring")
            )
            total += 1 if plain else max(1, int(value[1]))
    return total


def _is_recursive(message_type: str, types: Mapping[str, Any]) -> bool:
    """Whether a type contains itself at any depth (never so in a valid definition)."""
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> bool:
        if name in above or len(above) > 64:
            return True
        if name in done:
            return False
        children = [n for _, d in types[name][1] for n in _names(d)]
        found = any(visit(child, (*above, name)) for child in children)
        done.add(name)
        return found

    return visit(message_type, ())


@lru_cache(maxsize=512)
def decoder(message_type: str, definition: str = "", form: str = "ros2msg") -> Decoder:
    """Cached `Decoder`."""
    return Decoder(message_type, definition, form)


def encode(message_type: str, fields: Mapping[str, Any]) -> bytes:
    """CDR bytes (little endian, with encapsulation) of a message given as nested mappings and
    sequences, or messages of `typestore`.

    Fields left out are zero, false or empty. A stamp may be given as an int, nanoseconds since the
    epoch. Raises InputError for an unknown type or field and for a value that does not fit.
    """
    store = typestore()
    if message_type not in store.fielddefs:
        raise InputError(f"message type '{message_type}' is not known; give its definition")
    try:
        return bytes(store.serialize_cdr(_build(store, message_type, fields), message_type))
    except BROKEN_MESSAGE as error:
        raise InputError(f"values do not fit message type '{message_type}' ({error})") from None


_DTYPES = {"byte": "uint8", "char": "uint8", "octet": "uint8", "bool": "bool"}


def _build(store: Typestore, message_type: str, fields: Any) -> Any:
    if isinstance(fields, store.types[message_type]):
        return fields
    if message_type == "builtin_interfaces/msg/Time" and isinstance(fields, (int, np.integer)):
        seconds, nanoseconds = divmod(int(fields), 1_000_000_000)
        fields = {"sec": seconds, "nanosec": nanoseconds}
    definition = store.fielddefs[message_type][1]
    unknown = set(fields) - {name for name, _ in definition}
    if unknown:
        raise InputError(
            f"message type '{message_type}' has no field '{sorted(unknown)[0]}'; "
            f"it has {', '.join(name for name, _ in definition)}"
        )
    values = [_value(store, description, fields.get(name)) for name, description in definition]
    return store.types[message_type](*values)


def _value(store: Typestore, description: Any, value: Any) -> Any:
    kind, detail = description
    if kind == Nodetype.NAME:
        return _build(store, detail, {} if value is None else value)
    if kind == Nodetype.BASE:
        name = detail[0]
        if value is None:
            value = {"string": "", "bool": False}.get(name, 0)
        if name in ("string", "wstring"):
            return str(value)
        if name == "bool":
            return bool(value)
        return float(value) if name.startswith("float") else int(value)
    element, number = detail
    if value is None:
        value = [None] * number if kind == Nodetype.ARRAY else []
    if element[0] == Nodetype.BASE and element[1][0] not in ("string", "wstring"):
        dtype = _DTYPES.get(element[1][0], element[1][0])
        if isinstance(value, (bytes, bytearray, memoryview)):
            array = np.frombuffer(value, dtype=dtype)
        elif len(value) and value[0] is None:
            array = np.zeros(len(value), dtype=dtype)
        else:
            array = np.ascontiguousarray(value, dtype=dtype).reshape(-1)
        if kind == Nodetype.ARRAY and len(array) != number:
            raise InputError(f"an array needs {number} values, {len(array)} were given")
        return array
    return [_value(store, element, item) for item in value]


FORMS = {
    MessageDefinitionFormat.MSG: "ros2msg",
    MessageDefinitionFormat.IDL: "ros2idl",
    MessageDefinitionFormat.NONE: "",
}
