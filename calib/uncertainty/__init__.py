"""Uncertainty of the reference methods: covariance and cross-validation; and of any camera's projection.

That of the joint adjustment is in `calib.joint`.

References
----------
- Birge (1932), The calculation of errors by the method of least squares, Physical Review 40, 207.
- Huber (1981), Robust Statistics, Wiley.
- JCGM 100:2008, Guide to the expression of uncertainty in measurement (GUM).
- JCGM 101:2008, Propagation of distributions using a Monte Carlo method (supplement 1 to the GUM).
- Kogan, mrcal: the documentation's pages on projection uncertainty and on differences between calibrations.
- Rao (1945), Information and the accuracy attainable in the estimation of statistical parameters, Bulletin of the
  Calcutta Mathematical Society 37, 81.
- Stone (1974), Cross-validatory choice and assessment of statistical predictions, Journal of the Royal Statistical
  Society B 36, 111.
- Triggs, McLauchlan, Hartley and Fitzgibbon (2000), Bundle adjustment - a modern synthesis, LNCS 1883, 298.
- van der Sluis (1969), Condition numbers and equilibration of matrices, Numerische Mathematik 14, 14.
"""
