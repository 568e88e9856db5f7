# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The console of all commands: where tables and coloured lines go."""

from __future__ import annotations

import sys
from typing import Any

import rich.console

from .cli import print_to_nobody


class Console(rich.console.Console):
    """Standard output, as wide as the terminal, or 160 characters in a file or pipe.

    Where the reader of a pipe went away, rich would end with exit code 1. Here the command goes on:
    it may still write files, and its exit code says what it found.
    """

    def __init__(self, **options: Any) -> None:
        width = None if sys.stdout and sys.stdout.isatty() else 160
        super().__init__(width=width, highlight=False, **options)

    def on_broken_pipe(self) -> None:
        """Called while the error is handled."""
        print_to_nobody()
