# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The streaming estimator of the contact's shape: ellipse of the pad and tilt of the plate."""
