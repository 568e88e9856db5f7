# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0
