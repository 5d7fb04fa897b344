"""Where the simulated collimator shows the points of the reticle: the simulator's own displacement, point by point."""

import numpy as np
from inner_loops import from_python

from simulators.optics.collimator_errors import displacement as inner_displacement

displacement = from_python(inner_displacement)


def apparent_points(points_mm, aberrations):
    """Return the apparent positions of reticle points, (N, 2) mm on the target plane."""
    points = np.ascontiguousarray(points_mm, np.float64)
    return points + [displacement(x, y, aberrations) for x, y in points]
