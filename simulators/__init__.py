"""Simulated devices and the simulated optics: an independent reading of each protocol and of the physics.

Imports nothing of ours but calib.target (the printed pattern). Shares no code with drivers or calib.
"""
