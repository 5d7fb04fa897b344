"""Worlds that judge the calibration: benches drawn in unlike ways, what their stations state, and the scores.

Nothing here knows how the engine works. `bench` says what a world gives, `polynomial`, `ray_traced`, `product` and `stranger` are the
worlds, `knowledge` is the one place where a statement becomes an option of the engine, `judge` compares a result with the
truth, `scores` prints the table, `attacks` makes statements and data wrong, and `recordings` reads published views.
"""
