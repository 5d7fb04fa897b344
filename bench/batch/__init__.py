"""Batches: many runs from a queue, each in a process of its own that a supervisor watches."""
