"""Rehearsals: a run on a virtual clock with virtual devices, in seconds instead of hours."""
