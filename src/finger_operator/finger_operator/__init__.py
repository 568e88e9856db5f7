# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Core of the guided study and the operator's page, and the nodes around them."""
