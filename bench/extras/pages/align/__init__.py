"""Alignment before a run, with a live image: an axis moves, the light goes on, only when a person asks for it."""
