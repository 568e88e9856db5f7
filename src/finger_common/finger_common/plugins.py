# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parts of the suite that other packages can add: installed objects found by entry point.

A group is a name such as "finger_driver.force"; an entry of it in a package's metadata, ``name =
module:object``, makes the object known under that name. Nothing in the suite is edited to add one,
and the suite's own parts are registered in the same way.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from .cli import one_line
from .errors import FingerError, InputError, known_names, listed
from .settings import Settings, parameters_of, setting

P = TypeVar("P")


def _derives(found: Any, base: type) -> bool:
    # `issubclass` does not take a Protocol that has attributes.
    return isinstance(found, type) and base in found.__mro__


@functools.lru_cache(maxsize=1)
def _entry_points(_path: tuple[str, ...]) -> Any:
    # Looking through every installed package takes 30 ms, and is done again for another path.
    return entry_points()


class Plugins:
    """The installed objects of one entry-point group.

    what: a member in error sentences. base: class from which every member derives, if any.
    """

    def __init__(self, group: str, what: str, base: type | None = None) -> None:
        self.group = group
        self.what = what
        self.base = base
        self._loaded: dict[str, Any] = {}

    def _found(self) -> dict[str, EntryPoint]:
        return {
            entry.name: entry for entry in _entry_points(tuple(sys.path)).select(group=self.group)
        }

    def names(self) -> tuple[str, ...]:
        """Names of all installed members, sorted."""
        return tuple(sorted(self._found()))

    def load(self, name: str) -> Any:
        """The object of that name; raises InputError where it is unknown, cannot be used or comes
        from several packages."""
        if name not in self._loaded:
            found = self._found()
            if name not in found:
                known = known_names(name, sorted(found))
                raise InputError(
                    f"{self.what} '{name}' is not installed; {known} (entry points of "
                    f"'{self.group}')"
                )
            same = _entry_points(tuple(sys.path)).select(group=self.group, name=name)
            if len({entry.value for entry in same}) > 1:
                homes = listed(sorted(f"{e.dist and e.dist.name} ({e.value})" for e in same))
                raise InputError(
                    f"{self.what} '{name}' is in several packages: {homes}; keep one of them"
                )
            try:
                loaded = found[name].load()
            except Exception as error:
                raise InputError(
                    f"{self.what} '{name}' ({found[name].value}) cannot be imported: "
                    f"{error}; install what it needs or remove its package"
                ) from error
            self._check(name, loaded)
            self._loaded[name] = loaded
        return self._loaded[name]

    def _check(self, name: str, loaded: Any) -> None:
        if self.base is not None and not _derives(loaded, self.base):
            raise InputError(
                f"{self.what} '{name}': {loaded!r} is not a subclass of {self.base.__name__}; "
                "correct its entry point or remove its package"
            )


class PluginKind(Plugins, Generic[P]):
    """Installed classes of which a node or a command uses one, chosen by a setting.

    base: their base class; its attribute SETTINGS is a `Settings` class, from which the SETTINGS of
    every member derives. choice: name of the setting that chooses. default: name of the member that
    is used where none is chosen.
    """

    def __init__(self, group: str, what: str, base: type[P], choice: str, default: str) -> None:
        super().__init__(group, what, base)
        self.choice = choice
        self.default = default
        self._base_settings: type[Settings] = base.SETTINGS  # type: ignore[attr-defined]
        self.problems: dict[str, str] = {}
        """Reason why a member cannot be used, by its name; filled by `settings`."""

    def _check(self, name: str, loaded: Any) -> None:
        super()._check(name, loaded)
        if not _derives(loaded.SETTINGS, self._base_settings):
            raise InputError(
                f"{self.what} '{name}': {loaded.__name__}.SETTINGS is not a subclass of "
                f"{self._base_settings.__name__}; correct it or remove its package"
            )

    def settings(self, *beside: type[Settings]) -> tuple[type[Settings], ...]:
        """The choice, then the settings of every member, for a node that has `beside` too.

        A member that cannot be imported or whose settings contradict those of another is left out;
        `problems` holds the reason. The default comes first: no other member displaces it. Raises
        InputError where no member is installed.
        """
        names = self.names()
        if not names:
            raise InputError(
                f"no {self.what} is installed (entry points of '{self.group}'); install "
                f"{self.group.split('.')[0]} again, with pip or colcon"
            )
        self.problems = {}
        found: dict[str, type[Settings]] = {}
        for name in sorted(names, key=lambda n: n != self.default):
            try:
                candidate = self.load(name).SETTINGS
                parameters_of(*beside, *found.values(), candidate)
                found[name] = candidate
            except InputError as error:
                self.problems[name] = one_line(error)
            except Exception as error:
                # Whatever an outside package declares wrongly must not stop the other members.
                self.problems[name] = f"{self.what} '{name}': settings: {one_line(error)}"
        kinds = ", ".join(f"{n} ({title_of(self.load(n))})" for n in sorted(found))
        choice = setting(self.default, f"Kind of {self.what}: {kinds}.", choices=names)
        fields = [(self.choice, str, choice)]
        made = dataclasses.make_dataclass("Choice", fields, bases=(Settings,), frozen=True)
        return (made, *found.values())

    def open(self, values: Mapping[str, Any], *arguments: Any) -> P:
        """The chosen member, made with its settings and then `arguments`.

        values: the choice and the settings by name, defaults where absent; those of others are
        ignored. Raises InputError for a member or a setting that cannot be used, and for a member
        whose constructor fails.
        """
        name = str(values.get(self.choice, self.default))
        if name in self.problems:
            raise InputError(self.problems[name])
        cls = self.load(name)
        settings = cls.SETTINGS.select(values)
        try:
            made: P = cls(settings, *arguments)
        except FingerError:
            raise
        except Exception as error:
            raise InputError(
                f"{self.what} '{name}' cannot be made ({type(error).__name__}: "
                f"{one_line(error)}); correct it or its settings"
            ) from error
        return made


def title_of(cls: type) -> str:
    """First sentence of a class's docstring, without its full stop."""
    text = " ".join((cls.__doc__ or cls.__name__).split())
    return text.split(". ")[0].rstrip(".")
