# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parts of the model node that are a concern of their own."""
