"""The demo: a small simulated study, from the finger on the plate to a report."""
