"""`python examples/demo -o out/demo`: run the demo."""

import sys
from pathlib import Path

# Run as a folder, Python finds the modules in it alone, not the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

from demo.study import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
