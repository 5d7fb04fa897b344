"""Faults of the simulated bench: their catalogue, how they are ordered, and how they are injected."""
