"""Builders of the bench's simulated stages and lights, by the kinds that the configuration names."""
