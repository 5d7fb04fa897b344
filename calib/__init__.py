"""The calibration engine: arrays in, dataclasses out.

Knows no file, no device, no clock and no random source of its own. Imports nothing of bench, drivers,
sequences or simulators.
"""
