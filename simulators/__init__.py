"""Simulated devices and the simulated optics: a second, independent reading of each protocol and of the physics.

Of Starbench's packages they import only `calib.target` (the printed pattern). They share no code with drivers or calib.
"""
