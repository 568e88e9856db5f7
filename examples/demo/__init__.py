"""The demo: a small simulated study from the finger on the plate to fitted parameters and a report."""
