"""The script language of the bench: what a sequence file may contain, and its strict reader.

The package imports nothing of bench, calib, drivers or simulators. The shipped sequences are the ``*.yaml``
files beside this one.
"""
