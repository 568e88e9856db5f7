# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings that describe themselves: a frozen dataclass whose fields carry unit, range and meaning.

    @dataclass(frozen=True)
    class PollSettings(Settings):
        rate: float = setting(500.0, "Samples per second.", unit="Hz", minimum=1.0, maximum=7000.0)

    PollSettings(rate=1e9)        # InputError: parameter 'rate' is 1e+09, outside 1 … 7000 Hz; …
    PollSettings.parameters()     # ParameterTable, which declares them on a node and documents them

This is the only declaration of a setting: checks, node parameters, command-line options, YAML files
and the node reference derive from it. No ROS here.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from .errors import InputError, known_names
from .files import parse_json
from .parameters import Parameter, ParameterTable

_KEY = "setting"

S = TypeVar("S", bound="Settings")


def setting(
    default: Any,
    meaning: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Iterable[Any] | None = None,
    runtime: bool = False,
    advice: str = "",
    group: str = "",
    ros_name: bool = False,
) -> Any:
    """A field of a `Settings` dataclass; the arguments are those of `parameters.Parameter`."""
    described = {
        "default": default,
        "meaning": meaning,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": None if choices is None else tuple(choices),
        "runtime": runtime,
        "advice": advice,
        "group": group,
        "ros_name": ros_name,
    }
    if isinstance(default, list):
        return dataclasses.field(
            default_factory=functools.partial(list, default), metadata={_KEY: described}
        )
    return dataclasses.field(default=default, metadata={_KEY: described})


@dataclasses.dataclass(frozen=True)
class Settings:
    """Base of frozen dataclasses of described fields. Construction checks every value
    (InputError).
    """

    def __post_init__(self) -> None:
        for parameter in self.parameters():
            value = parameter.check(getattr(self, parameter.name))
            object.__setattr__(self, parameter.name, value)
        self.validate()

    def validate(self) -> None:
        """Refuse values that contradict each other; raises InputError naming both."""

    @classmethod
    def parameters(cls) -> ParameterTable:
        """The described fields, in order; fields without `setting` are no parameters."""
        return _table(cls)  # type: ignore[arg-type]

    @classmethod
    def from_mapping(cls: type[S], values: Mapping[str, Any], where: str = "settings") -> S:
        """From a mapping; raises InputError for an unknown name or a bad value, naming `where`."""
        table = cls.parameters()
        for name in values:
            if name not in table:
                known = known_names(name, (p.name for p in table))
                raise InputError(f"{where}: '{name}' does not exist; {known}")
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None

    @classmethod
    def select(cls: type[S], values: Mapping[str, Any]) -> S:
        """From a mapping that may hold the settings of others too, such as all parameters of a
        node.
        """
        table = cls.parameters()
        return cls(**{name: value for name, value in values.items() if name in table})

    def to_dict(self) -> dict[str, Any]:
        """Plain mapping of all described fields."""
        return {p.name: getattr(self, p.name) for p in self.parameters()}

    def to_json(self) -> str:
        """JSON object with every setting; `from_json` gives equal settings."""
        return json.dumps(self.to_dict(), sort_keys=True)

    @classmethod
    def from_json(cls: type[S], text: str, where: str = "settings") -> S:
        """From the text of a JSON object, empty for the defaults; raises InputError naming
        `where`.
        """
        values = parse_json(text, where) if text.strip() else {}
        if not isinstance(values, dict):
            raise InputError(f"{where}: a JSON object is needed, found {str(values)[:40]!r}")
        return cls.from_mapping(values, where)


@functools.cache
def _table(cls: type[Settings]) -> ParameterTable:
    return ParameterTable(
        *(
            Parameter(name=field.name, **field.metadata[_KEY])
            for field in dataclasses.fields(cls)  # type: ignore[arg-type]
            if _KEY in field.metadata
        )
    )


def parameters_of(*classes: type[Settings]) -> ParameterTable:
    """One table of several settings classes, as for a node.

    A field that classes share, by a common base for example, counts once. Raises ValueError where
    two classes declare one name in different ways.
    """
    found: dict[str, Parameter] = {}
    for cls in classes:
        for parameter in cls.parameters():
            if found.setdefault(parameter.name, parameter) != parameter:
                raise ValueError(
                    f"'{parameter.name}' is declared twice, differently in {cls.__name__}"
                )
    return ParameterTable(*found.values())
