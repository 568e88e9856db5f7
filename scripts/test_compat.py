"""Run the core tests in a second environment with NumPy 1.26 and OpenCV 4, as apt ROS 2 Jazzy has
them.

No ROS goes into that environment: the core of every package runs without it, and tests that need
nodes skip.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))
from setup_env import PACKAGES, Environment, SetupError, check_machine, digest  # noqa: E402

PINS = ["numpy==1.26.4", "opencv-python-headless==4.10.0.84"]


def main() -> int:
    if sys.version_info[:2] > (3, 12):
        print(
            "test-compat: NumPy 1.26 has no wheels beyond Python 3.12; run make test-compat "
            "PYTHON=python3.12",
            file=sys.stderr,
        )
        return 2
    folder = ROOT / ".venv-compat"
    try:
        check_machine()
        env = Environment(folder)
        if not env.python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        requirements = ROOT / "requirements.txt"
        env.step(
            "requirements",
            digest(requirements, text=" ".join(PINS)),
            "NumPy 1.26, OpenCV 4 and libraries from PyPI",
            lambda: env.run(
                *[env.python, "-m", "pip", "install", "-q", "-r", requirements, *PINS],
                *[
                    "pytest>=8",
                    "pytest-timeout",
                    "hypothesis",
                    "mcap-ros2-support",
                    "setuptools<80",
                    "wheel",
                ],
            ),
        )
    except SetupError as error:
        print(f"test-compat: {error}", file=sys.stderr)
        return 2
    paths = [str(ROOT / "src" / name) for name in PACKAGES]
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    code = "import numpy, cv2; print('NumPy', numpy.__version__, 'OpenCV', cv2.__version__)"
    subprocess.run([str(env.python), "-c", code], check=True)
    return subprocess.run(
        [str(env.python), "-m", "pytest", "src", *sys.argv[1:]], cwd=ROOT, env=variables
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
