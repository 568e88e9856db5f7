# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Elliptical pads and tilted plates while running: a correction of the round, level contact."""
