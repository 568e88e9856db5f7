"""What `with` does to bags and exports: they are finished at the end of the block, and given up after an error."""

from __future__ import annotations

from types import TracebackType
from typing import TypeVar

Held = TypeVar("Held", bound="Closing")


class Closing:
    """Base of what is finished by `close` and given up, leaving nothing half-written, by `abandon`."""

    def close(self) -> object:
        """Finish."""
        raise NotImplementedError

    def abandon(self) -> None:
        """Give up."""
        self.close()

    def __enter__(self: Held) -> Held:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()
