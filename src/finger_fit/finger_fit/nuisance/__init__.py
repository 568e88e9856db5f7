# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Nuisance parameters of a fit: priors, estimation, and what they add to the intervals."""
