# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Verification of the full-order model: what it must show, measured.

Each module has functions that return a `Check`; `finger-model verify` runs them all and writes a
page with figures, the tests assert them one by one.
"""
