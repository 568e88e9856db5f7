"""Run mypy over each package and the examples with the messages of the environment."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    packages = sorted(p.name for p in (ROOT / "src").iterdir() if (p / p.name).is_dir())
    arguments = [argument for name in packages for argument in ("-p", name)]
    examples = ROOT / "examples"
    arguments += ["-p", "demo", *(a for f in examples.glob("*.py") for a in ("-m", f.stem))]
    path = os.pathsep.join(map(str, [*(ROOT / "src" / name for name in packages), examples]))
    return subprocess.run(
        [sys.executable, "-m", "mypy", *arguments], cwd=ROOT, env={**os.environ, "MYPYPATH": path}
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
