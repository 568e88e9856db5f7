"""Factors from SI to the units of reports."""

MM2 = 1e6
"""mm² in a m²."""

MM4 = 1e12
"""mm⁴ in a m⁴."""
