# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`Material`, the default law under its common name, and the reader of `material.yaml`."""

from .laws import StandardLinearSolid as Material
from .laws import load_material

__all__ = ["Material", "load_material"]
