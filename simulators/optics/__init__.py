"""Image formation of the simulated bench: target, collimator and lens.

References
----------
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- Born and Wolf, Principles of Optics, chapter 5: geometrical theory of aberrations.
- Brown (1966), Decentering distortion of lenses, Photogrammetric Engineering 32, 444.
- Brown (1971), Close-range camera calibration, Photogrammetric Engineering 37, 855.
- Diebel (2006), Representing attitude: Euler angles, unit quaternions, and rotation vectors, Stanford University.
- Hartley and Zisserman (2004), Multiple View Geometry in Computer Vision, second edition.
- Kannala and Brandt (2006), A generic camera model and calibration method for conventional, wide-angle, and fish-eye
  lenses, IEEE Trans. PAMI 28, 1335.
- Levien (2016), Inside the fastest font renderer in the world: the accumulation buffer of font-rs.
- Noll (1976), Zernike polynomials and atmospheric turbulence, Journal of the Optical Society of America 66, 207.
- Shinozuka and Deodatis (1991), Simulation of stochastic processes by spectral representation, Applied Mechanics
  Reviews 44, 191.
"""
