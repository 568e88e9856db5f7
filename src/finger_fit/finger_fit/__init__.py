"""Fits the finger model's parameters to recorded trials, and says what the trials can and cannot tell."""
