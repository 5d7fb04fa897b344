"""Builders of the simulated stages and lights, from the configuration."""
