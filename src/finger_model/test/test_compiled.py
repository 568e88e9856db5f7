# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Kernels that numba keeps beside their sources."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from finger_model.compiled import forget_stale_kernels

INNER = "from numba import njit\n\n\n@njit(cache=True)\ndef inner():\n    return {}\n"
OUTER = """
from numba import njit

from package.laws.inner import inner
from values import VALUE


@njit(cache=True)
def outer():
    return inner() + VALUE
"""


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, values = tmp_path / "package", tmp_path / "values.py"
    for folder in ("laws", "slip"):
        (package / folder).mkdir(parents=True)
    (package / "slip" / "outer.py").write_text(OUTER)
    inner = package / "laws" / "inner.py"
    monkeypatch.syspath_prepend(tmp_path)

    def computed() -> float:
        """As a program that starts now would compute."""
        for name in [n for n in sys.modules if n.split(".")[0] in ("package", "values")]:
            del sys.modules[name]
        importlib.invalidate_caches()
        forget_stale_kernels(package, str(values))
        return float(importlib.import_module("package.slip.outer").outer())

    inner.write_text(INNER.format("1.0"))
    values.write_text("VALUE = 0.5\n")
    assert computed() == 1.5
    kept = {f: f.stat().st_mtime_ns for f in package.glob("*/__pycache__/*.nbc")}
    assert len(kept) == 2
    assert computed() == 1.5
    assert kept == {f: f.stat().st_mtime_ns for f in kept}, "nothing changed: nothing is compiled"
    inner.write_text(INNER.format("20.0"))
    assert computed() == 20.5
    values.write_text("VALUE = 0.25\n")
    assert computed() == 20.25
    (package / "__pycache__" / "sources_of_kernels.txt").unlink()
    assert computed() == 20.25
