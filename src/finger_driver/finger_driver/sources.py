"""Installed force, camera and moisture sources, found by entry point.

A source is a `Device` class that names its settings and its simulator:

    class LoadCell(ForceSource):
        SETTINGS = LoadCellSettings
        SIMULATOR = "load_cell.simulator:LoadCellSimulator"

Its package registers it in its metadata, here as ``load_cell = load_cell.driver:LoadCell`` in the
group "finger_driver.force". The suite's own sources are registered in the same way.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from finger_common.cli import one_line
from finger_common.errors import InputError
from finger_common.plugins import Plugins
from finger_common.settings import Settings, parameters_of, setting

from .device import Device

D = TypeVar("D", bound=Device[Any])


class Sources(Generic[D]):
    """The installed sources of one kind.

    group: entry-point group. what: the kind in error sentences. base: class of all sources.
    default: name of the source that is used where none is chosen.
    """

    def __init__(self, group: str, what: str, base: type[D], default: str) -> None:
        self._plugins = Plugins(group, what)
        self._what = what
        self._base = base
        self._default = default
        self.problems: dict[str, str] = {}
        """Reason why a source cannot be used, by its name; filled by `settings`."""

    def names(self) -> tuple[str, ...]:
        """Names of the installed sources, sorted; raises InputError where there is none."""
        names = self._plugins.names()
        if not names:
            raise InputError(
                f"no {self._what} is installed (entry points of '{self._plugins.group}'); install "
                "finger_driver again, with pip or colcon"
            )
        return names

    def load(self, name: str) -> type[D]:
        """The class of a source; raises InputError when it is absent or cannot be used."""
        cls = self._plugins.load(name)
        base = self._base
        if not (isinstance(cls, type) and issubclass(cls, base)):
            raise InputError(
                f"{self._what} '{name}': {cls!r} is not a subclass of {base.__name__}; correct its "
                "entry point or remove its package"
            )
        if not issubclass(cls.SETTINGS, base.SETTINGS):
            raise InputError(
                f"{self._what} '{name}': {cls.__name__}.SETTINGS is not a subclass of "
                f"{base.SETTINGS.__name__}; correct it or remove its package"
            )
        return cls

    def settings(self, *beside: type[Settings]) -> tuple[type[Settings], ...]:
        """The choice `device`, then the settings of every source, for a node that has `beside` too.

        A source that cannot be imported or whose settings contradict those of another is left out;
        `problems` holds the reason.
        """
        self.problems = {}
        found: dict[str, type[Settings]] = {}
        for name in self.names():
            try:
                candidate = self.load(name).SETTINGS
                parameters_of(*beside, *found.values(), candidate)
                found[name] = candidate
            except InputError as error:
                self.problems[name] = one_line(error)
            except Exception as error:
                # Whatever an outside package declares wrongly must not stop the other sources.
                self.problems[name] = f"{self._what} '{name}': settings: {one_line(error)}"
        return (self._choice(), *found.values())

    def _choice(self) -> type[Settings]:
        kinds = (f"{n} ({title_of(self.load(n))})" for n in self.names() if n not in self.problems)
        device = setting(
            self._default, f"Kind of {self._what}: {', '.join(kinds)}.", choices=self.names()
        )
        fields = [("device", str, device)]
        return dataclasses.make_dataclass("DeviceChoice", fields, bases=(Settings,), frozen=True)

    def open(self, values: Mapping[str, Any]) -> D:
        """Source of the settings; what does not concern it is ignored. Nothing is connected yet.

        Raises InputError for a source or a setting that cannot be used.
        """
        name = str(values.get("device", self._default))
        if name in self.problems:
            raise InputError(self.problems[name])
        cls = self.load(name)
        return cls(cls.SETTINGS.select(values))  # type: ignore[call-arg]


def title_of(cls: type) -> str:
    """First sentence of a class's docstring, without its full stop."""
    text = " ".join((cls.__doc__ or cls.__name__).split())
    return text.split(". ")[0].rstrip(".")
