# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The reduced model: load, use, build."""

from .model import ReducedModel
