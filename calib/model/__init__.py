"""The camera, the collimator and what connects them: projection, aberrations, closed-form solutions, passports."""
