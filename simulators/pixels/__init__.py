"""The simulated sensor: pixels, readout, on-chip filters, and EVT3 words."""
