"""Parts of the suite that other packages can add: installed objects found by entry point.

A group is a name such as "finger_driver.force"; an entry of it in a package's metadata, ``name =
module:object``, makes the object known under that name. Nothing in the suite is edited to add one.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from .errors import InputError


class Plugins:
    """The installed objects of one entry-point group. `what` names a member in error sentences."""

    def __init__(self, group: str, what: str) -> None:
        self.group = group
        self.what = what
        self._loaded: dict[str, Any] = {}

    def _found(self) -> dict[str, EntryPoint]:
        return {entry.name: entry for entry in entry_points(group=self.group)}

    def names(self) -> tuple[str, ...]:
        """Names of all installed members, sorted."""
        return tuple(sorted(self._found()))

    def load(self, name: str) -> Any:
        """The object of that name; raises InputError for an unknown name or one whose import
        fails.
        """
        if name not in self._loaded:
            found = self._found()
            if name not in found:
                known = ", ".join(sorted(found)) or "none"
                raise InputError(
                    f"{self.what} '{name}' is not installed; known are {known} (entry points of "
                    f"'{self.group}')"
                )
            try:
                self._loaded[name] = found[name].load()
            except Exception as error:
                raise InputError(
                    f"{self.what} '{name}' ({found[name].value}) cannot be imported: "
                    f"{error}; install what it needs or remove its package"
                ) from error
        return self._loaded[name]
