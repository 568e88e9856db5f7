# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Three-dimensional finite elements of the finger: friction, tangential load, ellipse and tilt."""
