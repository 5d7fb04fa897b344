"""The joint adjustment: every effect is a parameter with a prior, every statement a witness.

The modules in the order of the work. `fields`: smooth random fields and their shapes. `amplitudes`: how large they are
expected to be. `knowledge`: statements, a row each. `layout`: names and places of the unknowns. `equations`: linearised
stars and readings, a small matrix a view. `marginal`: likelihood of the amplitudes, with its gradient. `solve`: the
search. `poses`: which views are one pose. `adjust`: from views to the optimum. `posterior`: intervals, budget,
witnesses. `ways`: a gimbal and a hand, a bound of the parallax and none, as one mixture. `words`: notes. `result`: the
door, a `Calibration`. The equations stand in docs/adjustment.md. Nothing here chooses among models.
"""
