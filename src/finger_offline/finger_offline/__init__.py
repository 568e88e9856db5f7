# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Offline work on bags: vision and model over a recording, trials, tables."""
