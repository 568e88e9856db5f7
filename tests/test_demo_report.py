# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The text of the demo's report follows what was recorded and computed."""

from __future__ import annotations

import io
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

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


def test_the_table_of_the_terminal_gives_the_interval_of_e_in_80_columns(
    report: Any, tmp_path: Path
) -> None:
    values = {"composite_E": 30.2e3, "E2": 1.65e6, "E1": 38.6e3, "E0": 140e3, "tau1": 0.0104}
    row = {
        "fitted": values, "true": values, "J": 0.892, "J_power_law": 14.2,
        "intervals_95": {"composite_E": [15.04e3, 43.9e3], "E2": [0.7e6, 2e6]},
    }  # fmt: skip
    (tmp_path / "summary.json").write_text(
        json.dumps({"conditions": {"natural": row, "moist": {**row, "intervals_95": {}}}})
    )
    result = SimpleNamespace(folder=tmp_path, bags=[], seconds={"all": 1.0})
    said = io.StringIO()
    report.print_summary(result, Console(file=said, width=80))
    natural, _, moist, true = [t for t in said.getvalue().splitlines() if "30.2" in t]
    assert natural.split()[:4] == ["natural,", "fit", "30.2", "15.0–43.9"]
    assert moist.split()[:4] == ["moist,", "fit", "30.2", "1650"]
    assert true.split()[:3] == ["true", "30.2", "1650"]
