"""Where the simulated collimator shows the points of the reticle: the simulator's own displacement."""

import numpy as np

from simulators.optics.collimator_errors import displacement


def apparent_points(points_mm, aberrations):
    """Return the apparent positions of reticle points, (N, 2) mm on the target plane."""
    points = np.asarray(points_mm, float)
    return points + np.stack(displacement(points[:, 0], points[:, 1], aberrations), axis=1)
