"""The joint adjustment: every effect is a row of one table, every prior is independent, one mixture gives value and U.

The modules in the order of the work, each with what it hands on. `amplitudes`: how large the families of errors are
expected to be (`Expected`). `fields`, `shapes`: smooth fields over the target. `camera`: the camera as unknowns.
`table`: the table of effects (`Table`, then `Unknowns`, with a `Statement` for what somebody says). `knowledge`: what
the station states (`Known`). `effects`: all rows but those of a gimbal. `passport`: those of a known collimator.
`gimbal`: readings. `pupils`: how the pupil is moved. `poses`: which views are one pose. `problem`: stars, table and
readings about a start (`Problem`, `State`). `weights`: how much each star counts. `equations`: a small matrix a view.
`solution`: the posterior for given amplitudes, its likelihood and gradient. `search`: amplitudes and state (`Optimum`).
`starts`: where searches begin. `hypotheses`: what may be otherwise. `posterior`: the mixture about an optimum.
`adjust`: from views and options to the posteriors. `evidence`: how two are compared. `explanations`: other lenses and
ways of the pupil. `mixture`: what a result states over all of them. `uncertainty`: U. `budget`, `witnesses`,
`left_out`, `words`: what is told of it. `added_columns`, `wrong_views`, `causes`: what a person may have done.
`result`: the door, a `Calibration`. `forecast`: the face for studies. The equations stand in docs/adjustment.md.

Three decisions keep it short. log r is the unknown: along f / r, which the image fixes, no step bends. All unknowns are
independent beforehand, each shape of an error by itself. What may be otherwise is another 1-sigma of some unknowns.

References
----------
- Arasaratnam and Haykin (2009), Cubature Kalman filters, IEEE Transactions on Automatic Control 54, 1254.
- Badoiu and Clarkson (2003), Smaller core-sets for balls, Symposium on Discrete Algorithms.
- Bailey (2017), Not Normal: the uncertainties of scientific measurements, Royal Society Open Science 4, 160600.
- Golub and Pereyra (1973), The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
  separate, SIAM Journal on Numerical Analysis 10, 413.
- Golub and Van Loan (2013), Matrix Computations, fourth edition.
- Harville (1977), Maximum likelihood approaches to variance component estimation and to related problems, Journal of
  the American Statistical Association 72, 320.
- Levenberg (1944), A method for the solution of certain non-linear problems in least squares, Quarterly of Applied
  Mathematics 2, 164.
- Patterson and Thompson (1971), Recovery of inter-block information when block sizes are unequal, Biometrika 58, 545.
- Weng, Cohen and Herniou (1992), Camera calibration with distortion models and accuracy evaluation, IEEE Transactions
  on Pattern Analysis and Machine Intelligence 14, 965.
"""
