"""Poses: views between which the camera hardly turned belong to one pose.

Views of one pose share the errors of the collimator and of the pixel grid, so they are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Views that are turned by less against each other belong to one pose.
SAME_POSE_DEG = 0.2


def poses_of(rotations: Array) -> tuple[int, ...]:
    """Assign each view to a pose.

    A view belongs to the first pose whose first view is turned by less than 0.2 degrees against it. Own rule.

    rotations: (n, 3, 3) rotations of the views, camera <- target.
    Returns: For each view the index of its pose; poses are numbered in the order of their first views.
    """
    flat = np.asarray(rotations).reshape(len(rotations), 9)
    # The chord between two rotations turned by an angle t: |R - S| = sqrt(8) sin(t / 2), in the Frobenius norm.
    chord = np.sqrt(8.0) * np.sin(np.deg2rad(SAME_POSE_DEG) / 2.0)
    same = np.linalg.norm(flat[:, None] - flat[None], axis=2) < chord
    firsts: list[int] = []
    found = []
    for i, near in enumerate(same):
        pose = next((k for k, first in enumerate(firsts) if near[first]), len(firsts))
        if pose == len(firsts):
            firsts.append(i)
        found.append(pose)
    return tuple(found)


def members(poses: Sequence[int]) -> list[list[int]]:
    """Return the views of each pose."""
    return [[i for i, pose in enumerate(poses) if pose == k] for k in range(max(poses) + 1)]
