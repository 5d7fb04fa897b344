"""The script language of the bench: what a sequence file may say, and its strict reader.

Imports nothing of bench, calib, drivers or simulators. The shipped sequences lie beside this file.
"""
