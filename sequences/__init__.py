"""The script language of the bench: what a sequence file may contain, its strict reader, and the shipped ``*.yaml``.

The package imports nothing of bench, calib, drivers or simulators.
"""
