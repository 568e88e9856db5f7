"""The notebook in examples/ runs from its first cell to its last, and finds the truth it made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


def test_the_notebook_runs_and_finds_the_truth(project_root: Path, tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    pytest.importorskip("pandas", reason="pandas is not installed")
    notebook: Any = nbformat.read(project_root / "examples" / "fit_your_data.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "kept without outputs"
    check = (
        "low, high = result.intervals['dry']['composite_E']\n"
        "true = 1 / (1 / truth['dry'][0] + 1 / truth['dry'][1])\n"
        "assert low < true < high, (low, true, high)\n"
        "assert contrasts.set_index('quantity').loc['composite_E', 'probability_greater'] > 0.9\n"
        "assert (folder / 'tables' / 'frames.csv').is_file()"
    )
    notebook.cells.append(nbformat.v4.new_code_cell(check))
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, resources=resources).execute()
