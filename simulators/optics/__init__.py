"""Image formation of the simulated bench: target, collimator, lens and screen."""
