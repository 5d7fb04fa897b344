"""Devices of the bench: serial lines, stages, lights, cameras, and the files that cameras write.

This package implements wire protocols and file formats. It imports nothing of bench, calib, sequences or simulators:
a simulated device reaches a driver only through a port, a socket or a file.
"""
