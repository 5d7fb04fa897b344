"""Images to stars: the tag, the grid of stars, their labels, and the centre of each star with its covariance.

References
----------
- Abramowitz and Stegun (1972), Handbook of Mathematical Functions, Dover.
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- Birge (1932), The calculation of errors by the method of least squares, Physical Review 40, 207.
- Cleveland (1979), Robust locally weighted regression and smoothing scatterplots, Journal of the American Statistical
  Association 74, 829.
- Dornaika and Horaud (1998), Simultaneous robot-world and hand-eye calibration, IEEE Trans. Robotics and Automation 14,
  617.
- Garrido-Jurado et al. (2014), Automatic generation and detection of highly reliable fiducial markers under occlusion,
  Pattern Recognition 47, 2280.
- Gonzalez and Woods (2018), Digital Image Processing, fourth edition, Pearson.
- Goodman (2005), Introduction to Fourier Optics, third edition, Roberts and Company.
- Hartley and Zisserman (2004), Multiple View Geometry in Computer Vision, second edition.
- Hoerl and Kennard (1970), Ridge regression: biased estimation for nonorthogonal problems, Technometrics 12, 55.
- Hsu and Arsenault (1982), Optical pattern recognition using circular harmonic expansion, Applied Optics 21, 4016.
- Immerkær (1996), Fast noise variance estimation, Computer Vision and Image Understanding 64, 300.
- JCGM 100:2008, Guide to the expression of uncertainty in measurement (GUM).
- Kåsa (1976), A circle fitting procedure and its error analysis, IEEE Trans. Instrumentation and Measurement 25, 8.
- Lange, Little and Taylor (1989), Robust statistical modeling using the t distribution, Journal of the American
  Statistical Association 84, 881.
- Lewis (1995), Fast normalized cross-correlation, Vision Interface, 120.
- Michelson (1927), Studies in Optics, University of Chicago Press.
- Nadaraya (1964), On estimating regression, Theory of Probability and Its Applications 9, 141.
- Olson (2011), AprilTag: a robust and flexible visual fiducial system, ICRA.
- Osborne (1992), Fisher's method of scoring, International Statistical Review 60, 99.
- Pearson (1905), On the general theory of skew correlation and non-linear regression, Drapers' Company Research
  Memoirs, Biometric Series 2.
- Rao (1945), Information and the accuracy attainable in the estimation of statistical parameters, Bulletin of the
  Calcutta Mathematical Society 37, 81.
- Rao (1971), Estimation of variance and covariance components: MINQUE theory, Journal of Multivariate Analysis 1, 257.
- Roche, Malandain, Pennec and Ayache (1998), The correlation ratio as a new similarity measure for multimodal image
  registration, MICCAI, 1115.
- Schöps, Larsson, Pollefeys and Sattler (2020), Why having 10,000 parameters in your camera model is better than
  twelve, CVPR, arXiv:1912.02908.
- Unser (1999), Splines: a perfect fit for signal and image processing, IEEE Signal Processing Magazine 16, 22.
- van der Sluis (1969), Condition numbers and equilibration of matrices, Numerische Mathematik 14, 14.
- Wand (1994), Fast computation of multivariate kernel estimators, Journal of Computational and Graphical Statistics 3,
  433.
- Watson (1964), Smooth regression analysis, Sankhya A 26, 359.
- Zhang (2000), A flexible new technique for camera calibration, IEEE Trans. PAMI 22, 1330.
"""
