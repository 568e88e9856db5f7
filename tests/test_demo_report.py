# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The text of the demo's report follows what was recorded and computed."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

PICTURES = ("live", "area", "parameters", "cost", "moisture")


@pytest.fixture
def report(project_root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The demo's module that writes the report."""
    monkeypatch.syspath_prepend(project_root / "examples")
    import demo.report

    return demo.report


@pytest.mark.parametrize(
    ("names", "interval", "words"),
    [
        (["dry"], None, "3 presses of a simulated finger in 1 moisture condition,"),
        (["dry", "moist"], (1.0, 2.0), "6 presses of a simulated finger in 2 moisture conditions,"),
    ],
)
def test_it_counts_conditions_and_speaks_of_intervals_that_there_are(
    report: Any, tmp_path: Path, names: list[str], interval: Any, words: str
) -> None:
    for name in PICTURES:
        (tmp_path / f"{name}.png").write_bytes(b"picture")
    values = {key: 1.0 for key, *_ in report.PARAMETERS}
    results = [
        SimpleNamespace(
            name=name, fitted=values, true=values, curves=[None] * 3, cost=1.0, power_law_cost=2.0,
            intervals={} if interval is None else {"E2": interval},
        )
        for name in names
    ]  # fmt: skip
    fit = SimpleNamespace(sources={"reduced_model_error": {}}, exclusions=[])
    page = report.page_of(results, SimpleNamespace(fit=fit, seconds={}, repeated=0), tmp_path)
    assert words in page
    assert ("profile likelihood" in page) == (interval is not None)
