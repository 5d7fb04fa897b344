"""The joint least-squares adjustment of all views: parameters, residuals, normal equations, Levenberg-Marquardt.

References
----------
- Aitken (1936), On least squares and linear combination of observations, Proceedings of the Royal Society of Edinburgh
  55, 42.
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- Brown (1976), The bundle adjustment - progress and prospects, International Archives of Photogrammetry 21.
- Collins and Bartoli (2014), Infinitesimal plane-based pose estimation, International Journal of Computer Vision 109,
  252.
- Diebel (2006), Representing attitude: Euler angles, unit quaternions, and rotation vectors, Stanford University.
- Holland and Welsch (1977), Robust regression using iteratively reweighted least-squares, Communications in Statistics
  A6, 813.
- Huber (1964), Robust estimation of a location parameter, Annals of Mathematical Statistics 35, 73.
- Marquardt (1963), An algorithm for least-squares estimation of nonlinear parameters, Journal of SIAM 11, 431.
- Nielsen (1999), Damping parameter in Marquardt's method, report IMM-REP-1999-05, Technical University of Denmark.
- Triggs, McLauchlan, Hartley and Fitzgibbon (2000), Bundle adjustment - a modern synthesis, LNCS 1883, 298.
- van der Sluis (1969), Condition numbers and equilibration of matrices, Numerische Mathematik 14, 14.
- Zhang (2000), A flexible new technique for camera calibration, IEEE Trans. PAMI 22, 1330.
"""
