"""Studies beyond one calibration: planning, Monte Carlo, hand-eye checks, rigs, split halves.

References
----------
- Aitken (1936), On least squares and linear combination of observations, Proceedings of the Royal Society of Edinburgh
  55, 42.
- arXiv:2512.16092: Liu, Liang et al., Collimator-assisted high-precision calibration method for event cameras.
- JCGM 100:2008, Guide to the expression of uncertainty in measurement (GUM).
- JCGM 101:2008, Propagation of distributions using a Monte Carlo method (GUM, supplement 1).
- Kiefer and Wolfowitz (1960), The equivalence of two extremum problems, Canadian Journal of Mathematics 12, 363.
- Tsai and Lenz (1989), A new technique for fully autonomous and efficient 3D robotics hand/eye calibration, IEEE Trans.
  Robotics and Automation 5, 345.
- Zhang (2000), A flexible new technique for camera calibration, IEEE Trans. PAMI 22, 1330.
- Zhuang, Roth and Sudhakar (1994), Simultaneous robot/world and tool/flange calibration by solving homogeneous
  transformation equations of the form AX=YB, IEEE Trans. Robotics and Automation 10, 549.
"""
