# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The helpers of this folder are importable by name."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
