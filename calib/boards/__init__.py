"""Flat targets of other calibration methods in images: checkerboards and grids of circles at finite distance.

References
----------
- Duda and Frese (2018), Accurate detection and localization of checkerboard corners for calibration, BMVC: the finder
  of OpenCV's ``findChessboardCornersSB``.
- Heikkilä (2000), Geometric camera calibration using circular control points, IEEE Trans. PAMI 22, 1066: why the
  centre of an ellipse is not the image of the circle's centre.
- Schöps, Larsson, Pollefeys and Sattler (2020), Why having 10,000 parameters in your camera model is better than
  twelve, CVPR, arXiv:1912.02908: centres by symmetry.
- Zhang (2000), A flexible new technique for camera calibration, IEEE Trans. PAMI 22, 1330.
"""
