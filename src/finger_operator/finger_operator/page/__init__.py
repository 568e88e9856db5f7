# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The operator's page: web server and data feed, without ROS."""
