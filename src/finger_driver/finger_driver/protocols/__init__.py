# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Wire protocols as pure functions: bytes in, numbers out; no sockets, no threads, no ROS."""
