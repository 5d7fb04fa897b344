"""Events to images: the flicker of the light, a window of whole periods, and one set of images for each recording.

References
----------
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- Leahy et al. (1983), On searches for pulsed emission with application to four globular cluster X-ray sources,
  Astrophysical Journal 266, 160.
- Meade (1983), Lock-in Amplifiers: Principles and Applications, Peter Peregrinus.
"""
