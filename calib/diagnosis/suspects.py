"""What may have turned a camera on a gimbal before a collimator, against its readings: a row a kind.

A suspect turns the camera, in some of the poses, about axes of its own. A new one is one more row of the table, and a
sentence with a check (`calib.model.cause`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.model import cause as kinds

#: Odds beforehand of a kind, over all places where it can be: 2 log of them is -10. A likelihood ratio that outweighs
#: them is very strong (Kass and Raftery, 1995).
ODDS = math.exp(-5.0)
#: Poses that are needed to look for faults: with four, the mounting, three scales and a suspect of three parameters
#: leave nothing over.
FEWEST = 5


@dataclass(frozen=True, eq=False)
class Frames:
    """About what suspects turn the camera, seen from it: unit vectors in the columns."""

    motors: Array  # (n, 3, 3) axes of pan, tilt and roll
    leaning: Array  # (n, 3, 1) axis about which pan leans against a right angle with tilt
    target: Array  # (n, 3, 3) axes of the target
    times: Array  # (n,) when the camera stood there, 0 the first and 1 the last

    def turned(self, errors: Array) -> Frames:
        """Return them after (n, 3, 3) turns of the camera."""
        return Frames(errors @ self.motors, errors @ self.leaning, errors @ self.target, self.times)


#: Course over the poses: from their (n,) times and the pose of a suspect to (n,) its share in each.
_COURSES: Mapping[str, Callable[[Array, int], Array]] = {
    "from a pose on": lambda times, pose: np.where(np.arange(len(times)) >= pose, 1.0, 0.0),
    "at a pose": lambda times, pose: np.where(np.arange(len(times)) == pose, 1.0, 0.0),
    "steadily": lambda times, _: times,
    "always": lambda times, _: np.ones(len(times)),
}


@dataclass(frozen=True)
class _Row:
    """A kind of suspect."""

    size: int  # Number of its parameters, rad
    axes: Callable[[Frames, int], Array]  # (n, 3, size) that it turns the camera about; from an axis's number
    course: str  # Of `_COURSES`
    order: int  # Of what turns the camera: 0 on its side of all axes


#: Order of the axes of pan, tilt and roll, seen from the camera; pan leans between tilt and pan.
AXIS_ORDER = (4, 2, 1)
#: Order of what turns on the target's side of all axes.
TARGET_ORDER = 5


def _of_camera(frames: Frames, _: int) -> Array:
    return np.asarray(np.broadcast_to(np.eye(3), frames.target.shape), np.float64)


def _of_target(frames: Frames, _: int) -> Array:
    return frames.target


#: By kind: parameters, axes, course, and order of what turns the camera.
_ROWS: Mapping[str, _Row] = {
    kinds.TURNED: _Row(3, _of_camera, "from a pose on", 0),
    kinds.ONE_POSE: _Row(3, _of_camera, "at a pose", 0),
    kinds.CREEPS: _Row(3, _of_camera, "steadily", 0),
    kinds.SLIPPED: _Row(1, lambda frames, axis: frames.motors[:, :, [axis]], "from a pose on", 1),
    kinds.NOT_SQUARE: _Row(1, lambda frames, _: frames.leaning, "always", 3),
    kinds.MOVED: _Row(3, _of_target, "from a pose on", TARGET_ORDER),
    kinds.HELD: _Row(1, lambda frames, _: frames.target[:, :, 2:], "from a pose on", TARGET_ORDER),
    kinds.SHIFTS: _Row(3, _of_target, "steadily", TARGET_ORDER),
}


@dataclass(frozen=True)
class Suspect:
    """One thing that may have turned the camera."""

    kind: str
    axis: int = 0  # Index of the axis that slipped
    pose: int = 0  # Index of the first pose with it, or of the only one

    @property
    def size(self) -> int:
        """Number of its parameters, rad."""
        return _ROWS[self.kind].size

    @property
    def order(self) -> int:
        """What turns the camera nearer to it has a lower one."""
        return AXIS_ORDER[self.axis] if self.kind == kinds.SLIPPED else _ROWS[self.kind].order

    def columns(self, frames: Frames) -> Array:
        """Return (n, 3, size) derivatives of the rotations."""
        row = _ROWS[self.kind]
        course = _COURSES[row.course](frames.times, self.pose)
        return np.asarray(row.axes(frames, self.axis) * course[:, None, None])


def suspects(count: int, axes: tuple[int, ...]) -> dict[Suspect, float]:
    """Return all that can be seen in a number of poses, with readings of some axes, and -2 log of the odds of each."""
    answer: dict[Suspect, float] = {}
    if count < FEWEST:
        return answer
    steps = range(2, count - 1)  # before and after, two poses or more: a step at an end is one wrong pose
    for kind, row in _ROWS.items():
        poses = {"from a pose on": steps, "at a pose": range(count)}.get(row.course, range(1))
        turned = axes if kind == kinds.SLIPPED else (0,)
        places = [Suspect(kind, axis, pose) for axis in turned for pose in poses]
        if kind == kinds.NOT_SQUARE and not {0, 1} <= set(axes):
            places = []
        answer |= dict.fromkeys(places, 2.0 * math.log(max(len(places), 1) / ODDS))
    return answer
