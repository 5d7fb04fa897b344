"""Batches: many runs from a queue, each in its own process under supervision."""
