"""Studies beyond one calibration: planning, Monte Carlo, reference methods, hand-eye checks, rigs, split halves."""
