"""The joint adjustment: every effect is a parameter with a prior, every statement a witness.

The modules in the order of the work. `fields`: smooth random fields and their shapes. `amplitudes`: how large they
are expected to be. `hypotheses`: what may be otherwise, with odds. `knowledge`: statements, a row each. `effects`: an
object each, with its unknowns, columns and prior. `layout`: names and places of the unknowns. `equations`: linearised
stars and readings, a small matrix a view. `marginal`: likelihood of the amplitudes, with its gradient.
`pose_equations`: what each pose says of it. `poses`: which views are one pose. `posed`: from views to the problem.
`solve`: the search. `adjust`: from starts to the optimum.
`doubts`: which statements hold. `modes`: all doubts about one optimum. `evidence`: how explanations are compared.
`posterior`: the mixture and its intervals. `explanations`: other lenses and ways of the pupil in it. `summary`: what
it states. `words`: notes. `result`: the door, a `Calibration`. `forecast`: the face for studies. The equations stand
in docs/adjustment.md.

References
----------
- Arasaratnam and Haykin (2009), Cubature Kalman filters, IEEE Transactions on Automatic Control 54, 1254.
- Armijo (1966), Minimization of functions having Lipschitz continuous first partial derivatives, Pacific Journal of
  Mathematics 16, 1.
- Bailey (2017), Not Normal: the uncertainties of scientific measurements, Royal Society Open Science 4, 160600.
- Bickel (1975), One-step Huber estimates in the linear model, Journal of the American Statistical Association 70, 428.
- Birge (1932), The calculation of errors by the method of least squares, Physical Review 40, 207.
- Golub and Pereyra (1973), The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
  separate, SIAM Journal on Numerical Analysis 10, 413.
- Golub and Van Loan (2013), Matrix Computations, fourth edition.
- Harville (1977), Maximum likelihood approaches to variance component estimation and to related problems, Journal of
  the American Statistical Association 72, 320.
- Kass and Raftery (1995), Bayes factors, Journal of the American Statistical Association 90, 773.
- Kish (1965), Survey Sampling, Wiley.
- Levenberg (1944), A method for the solution of certain non-linear problems in least squares, Quarterly of Applied
  Mathematics 2, 164.
- Patterson and Thompson (1971), Recovery of inter-block information when block sizes are unequal, Biometrika 58, 545.
- Searle (1971), Linear Models, Wiley.
- Weng, Cohen and Herniou (1992), Camera calibration with distortion models and accuracy evaluation, IEEE Transactions
  on Pattern Analysis and Machine Intelligence 14, 965.
- Woodbury (1950), Inverting modified matrices, Memorandum Report 42, Statistical Research Group, Princeton.
"""
