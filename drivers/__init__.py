"""Devices of the bench: serial line, stages, lights, cameras, and the files cameras write.

Knows wire protocols and file formats. Imports nothing of bench, calib, sequences or simulators;
a simulated device reaches a driver only through a port, a socket or a file.
"""
