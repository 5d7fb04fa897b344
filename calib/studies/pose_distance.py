"""Distance between poses, and what a pose brings that its neighbours do not hold yet.

Two neighbouring poses share most errors of the collimator and of the pixel grid. A pose next to another one therefore
brings less information than its stars promise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

Angles = Mapping[str, float]

#: Distance at which two poses share about a third of their errors, degrees.
SHARED_ERROR_DEG = 1.5


def distance_deg(one: Angles, other: Angles) -> float:
    """Return the largest difference between the angles of two poses.

    one, other: Angles of the gimbal, degrees; missing angles are zero.
    Returns: Difference, degrees.
    """
    return max((abs(one.get(axis, 0.0) - other.get(axis, 0.0)) for axis in {*one, *other}), default=0.0)


def share_of_news(pose: Angles, others: Iterable[Angles]) -> float:
    """Return the share of a pose's information that other poses do not hold yet. Own choice of the function.

    pose: Angles of the pose, degrees.
    others: Angles of the other poses, degrees.
    Returns: Share, 0 to 1; 1 without other poses.
    """
    nearest = min((distance_deg(pose, other) for other in others), default=np.inf)
    return float(1.0 - np.exp(-((nearest / SHARED_ERROR_DEG) ** 2)))
