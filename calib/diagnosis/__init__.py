"""Diagnosis of wrong data: gross errors, duplicate views, wrong units and image sizes.

Each module answers one question about views. Where the data cannot decide, its sentence says so.

References
----------
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
"""
