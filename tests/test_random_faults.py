"""Random faults on the whole simulated rig, for a short time; and the page of the long run."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")


@pytest.mark.alone
@pytest.mark.timeout(900)
def test_each_fault_is_named_and_gone_and_nothing_is_lost_silently(project_root: Path) -> None:
    """The bounds are those of a busy machine; the script's own are 2 s and 5 s."""
    command = [sys.executable, project_root / "scripts" / "random_faults.py", "--minutes", "0.3"]
    bounds = ["--named", "30", "--gone", "30"]
    done = subprocess.run(
        [*map(str, command), "--seed", "7", *bounds], capture_output=True, text=True, timeout=800
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_page_holds_the_recorded_results(project_root: Path) -> None:
    script = project_root / "scripts" / "faults.py"
    done = subprocess.run([sys.executable, script, "--check"], timeout=60)
    assert done.returncode == 0, "run python scripts/faults.py"
    recorded = json.loads((project_root / "tests" / "recorded_random_faults.json").read_text())
    assert len({result["fault"] for result in recorded["results"]}) >= 30
