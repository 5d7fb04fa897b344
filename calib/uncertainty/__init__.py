"""Uncertainty of an adjustment: covariance, variance components, type B terms, budget, cross-validation, projection.

References
----------
- Bell and McCaffrey (2002), Bias reduction in standard errors for linear regression with multi-stage samples, Survey
  Methodology 28, 169.
- Bhatia (2007), Positive Definite Matrices, Princeton University Press.
- Birge (1932), The calculation of errors by the method of least squares, Physical Review 40, 207.
- Efron (1982), The Jackknife, the Bootstrap and Other Resampling Plans, SIAM.
- Huber (1981), Robust Statistics, Wiley.
- JCGM 100:2008, Guide to the expression of uncertainty in measurement (GUM).
- JCGM 101:2008, Propagation of distributions using a Monte Carlo method (supplement 1 to the GUM).
- Kogan, mrcal: the documentation's pages on projection uncertainty and on differences between calibrations.
- Liang and Zeger (1986), Longitudinal data analysis using generalized linear models, Biometrika 73, 13.
- Patterson and Thompson (1971), Recovery of inter-block information when block sizes are unequal, Biometrika 58, 545.
- Rao (1945), Information and the accuracy attainable in the estimation of statistical parameters, Bulletin of the
  Calcutta Mathematical Society 37, 81.
- Rao (1973), Linear Statistical Inference and Its Applications, second edition, Wiley.
- Satterthwaite (1946), An approximate distribution of estimates of variance components, Biometrics Bulletin 2, 110.
- Stone (1974), Cross-validatory choice and assessment of statistical predictions, Journal of the Royal Statistical
  Society B 36, 111.
- Tapley, Schutz and Born (2004), Statistical Orbit Determination, chapter 6: consider covariance analysis.
- Triggs, McLauchlan, Hartley and Fitzgibbon (2000), Bundle adjustment - a modern synthesis, LNCS 1883, 298.
- van der Sluis (1969), Condition numbers and equilibration of matrices, Numerische Mathematik 14, 14.
- Zhou, Hu, Zhou and Lange (2019), MM algorithms for variance components models, Journal of Computational and Graphical
  Statistics 28, 350.
"""
