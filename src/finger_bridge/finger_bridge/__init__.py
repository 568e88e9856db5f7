# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bridges to other programs: live view in Foxglove, Lab Streaming Layer."""
