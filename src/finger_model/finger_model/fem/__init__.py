"""Axisymmetric finite elements of the finger (full order)."""
