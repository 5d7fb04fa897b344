"""Calibration methods compared on the simulated bench, where the truth is known."""
