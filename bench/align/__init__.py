"""Alignment of camera, lens and light before a run, with a live image: `starbench align`.

This room opens the devices of a station. It moves an axis or switches the light only when a person asks for it.
"""
