"""The camera, the collimator and what connects them: projection, aberrations, closed-form solutions, passports.

References
----------
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- Brown (1971), Close-range camera calibration, Photogrammetric Engineering 37, 855.
- Diebel (2006), Representing attitude: Euler angles, unit quaternions, and rotation vectors, Stanford University.
- Hartley (1997), In defense of the eight-point algorithm, IEEE Trans. PAMI 19, 580.
- Hartley and Zisserman (2004), Multiple View Geometry in Computer Vision, second edition.
- Hoerl and Kennard (1970), Ridge regression: biased estimation for nonorthogonal problems, Technometrics 12, 55.
- Holland and Welsch (1977), Robust regression using iteratively reweighted least-squares, Communications in Statistics
  A6, 813.
- Kabsch (1976), A solution for the best rotation to relate two sets of vectors, Acta Crystallographica A 32, 922.
- Kannala and Brandt (2006), A generic camera model and calibration method for conventional, wide-angle, and fish-eye
  lenses, IEEE Trans. PAMI 28, 1335.
- Liang et al. (2024), Camera calibration using a collimator system, ECCV.
- Rousseeuw (1984), Least median of squares regression, Journal of the American Statistical Association 79, 871.
- Schoenemann (1966), A generalized solution of the orthogonal Procrustes problem, Psychometrika 31, 1.
- Zhang (2000), A flexible new technique for camera calibration, IEEE Trans. PAMI 22, 1330.
"""
