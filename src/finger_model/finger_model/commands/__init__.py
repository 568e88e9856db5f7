# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Subcommands of `finger-model`, one module each with `add_parser(subparsers)`."""
