"""How the pattern moves in the image when an axis turns, as it was seen: for cameras that are mounted in another way.

The signs of the bench hold for a camera that stands upright on its gimbal (`bench.align.where_to_turn`). A camera may
be mounted on its side or upside down, and an axis may have the wrong sign in the station file. Turns by these signs
would then lead away from the middle. So the motion of the tag between two pictures is compared with the readings of
the stage. The module computes with numbers only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_DEG: Final = 0.4
"""Least turn of an axis from which its motion is learnt."""
_ALONE: Final = 0.15
"""Largest turn of the other axes meanwhile, in units of this turn."""
_SIZES: Final = (0.5, 2.0)
"""Range of the length of the motion, in units of the expected one."""
_UNUSUAL_DEG: Final = 30.0
"""Difference of the directions from which the motion seen counts, and not the signs of the bench."""
_UPRIGHT: Final = {"pan": np.array([1.0, 0.0]), "tilt": np.array([0.0, -1.0])}


class SeenMotion:
    """Learns from one sighting of the tag after the other how pan and tilt move it."""

    def __init__(self) -> None:
        self._last: tuple[dict[str, float], Array] | None = None
        self._learnt: dict[str, Array] = {}

    def add(self, reading_deg: Mapping[str, float], tag_px: tuple[float, float], focal_px: float) -> None:
        """Add a sighting of the tag.

        reading_deg: Angles of the stage, degrees.
        tag_px: Centre of the tag (column, row), px.
        focal_px: Focal length, px.
        """
        here = np.array(tag_px)
        before, self._last = self._last, (dict(reading_deg), here)
        if before is None:
            return
        turned = {axis: angle - before[0].get(axis, angle) for axis, angle in reading_deg.items()}
        for axis in _UPRIGHT:
            by = turned.get(axis, 0.0)
            others = max((abs(t) for name, t in turned.items() if name != axis), default=0.0)
            if abs(by) >= _LEAST_DEG and others <= _ALONE * abs(by):
                motion = (here - before[1]) / (by * math.radians(focal_px))
                if _SIZES[0] <= np.linalg.norm(motion) <= _SIZES[1]:
                    self._learnt[axis] = motion

    def forget(self) -> None:
        """Forget everything, for example because the camera was mounted anew."""
        self._last = None
        self._learnt.clear()

    def turn(
        self, tag_px: tuple[float, float], size: tuple[int, int], focal_px: float
    ) -> tuple[float, float] | None:
        """Return the turns of pan and tilt that bring the tag to the middle, by the motion seen.

        The motion of an axis that has not turned yet is taken to be rotated as that of the other one. Own procedure: a
        linear equation with the motions as columns.

        tag_px: Centre of the tag (column, row), px.
        size: Width and height of the image, px.
        focal_px: Focal length, px.
        Returns: Pan and tilt, degrees; None if the signs of the bench hold, as far as was seen.
        """
        rotations = {axis: _angle_deg(_UPRIGHT[axis], motion) for axis, motion in self._learnt.items()}
        if not any(abs(angle) > _UNUSUAL_DEG for angle in rotations.values()):
            return None
        columns = [
            self._learnt[axis] if axis in self._learnt else _rotated(upright, next(iter(rotations.values())))
            for axis, upright in _UPRIGHT.items()
        ]
        matrix = np.column_stack(columns)
        if abs(float(np.linalg.det(matrix))) < 0.1:
            return None
        off = np.array([(size[0] - 1) / 2.0, (size[1] - 1) / 2.0]) - np.array(tag_px)
        pan, tilt = np.linalg.solve(matrix, off / math.radians(focal_px))
        return float(pan), float(tilt)


def _angle_deg(one: Array, other: Array) -> float:
    """Return the angle from one direction to another, degrees, -180 to 180."""
    return math.degrees(math.atan2(one[0] * other[1] - one[1] * other[0], float(one @ other)))


def _rotated(vector: Array, angle_deg: float) -> Array:
    """Return a vector rotated by an angle."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])
