"""Offline work on bags: vision and model over a recording, trials, tables."""
