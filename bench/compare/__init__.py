"""Comparison of calibration methods on the simulated bench, where the truth is known."""
