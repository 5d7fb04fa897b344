"""Where to turn the camera: the offset of tag and beam from the middle of the image, the roll, poses that show the rim.

As in `calib.model.rotation.euler_zxy`, a larger pan moves the pattern right, a larger tilt up, a larger roll clockwise,
for a camera upright on its gimbal. It may stand otherwise, or an axis have the wrong sign in the station file: so the
tag's motion between two pictures is compared with the stage's readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bench.extras.pages.align.live_image import LiveSetting
from calib.model.homography import apply_homography, fit_homography, linear_at
from calib.model.rotation import euler_zxy
from calib.stars.beam import Beam
from calib.stars.quick import QuickStars
from calib.stars.tag import Border, DarkSquare

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
ROLL_WANTED_DEG, LEAST_ROLL_DEG = 10.0, 5.0
"""Roll of the pattern against the pixel grid at which stars are located best, and least one (docs/stars.md)."""
CENTRED_DEG, CENTRED_PX = 0.25, 15.0
"""Offset up to which the pattern counts as centred, degrees, or px if no focal length is known."""
BEAM_STEP_DEG, BEAM_STEP_PX = 1.0, 50.0
"""Turns by the beam are given in these steps: its rim is ragged, and a frame shows a short arc of it."""
_RIM_INSIDE_SHARE: Final = 0.1  # The rim must be this far inside the image to be told from its border

Offset = tuple[float, float]


class SeenMotion:
    """Learns from one sighting of the tag after the other how pan and tilt move it."""

    def __init__(self) -> None:
        self._last: tuple[dict[str, float], Array] | None = None
        self._learnt: dict[str, Array] = {}

    def add(self, reading_deg: Mapping[str, float], tag_px: tuple[float, float], focal_px: float) -> None:
        """Add a sighting of the tag, its centre at (column, row), px."""
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
        """Return the turns of pan and tilt, degrees, that bring the tag to the middle, by the motion seen.

        Own procedure: a linear equation with the motions as columns; an axis that has not turned is taken as
        perpendicular to the other. ``tag_px`` is (column, row). None if the signs of the bench hold, as far as was
        seen.
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


def _angle_deg(first: Array, other: Array) -> float:
    """Return the angle from one direction to another, degrees, -180 to 180."""
    return math.degrees(math.atan2(first[0] * other[1] - first[1] * other[0], float(first @ other)))


def _rotated(vector: Array, angle_deg: float) -> Array:
    """Return a vector rotated by an angle."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


@dataclass(frozen=True)
class TurnFigures:
    """Where to turn. What is not known is None."""

    # What the turn brings to the middle of the image: ``tag``, ``square`` (a dark square that looks like the
    # tag) or ``beam``; empty if none is seen.
    of: str = ""
    unit: str = "°"  # Unit of the turns: ``°``, or ``px`` if no focal length is known
    pan: float | None = None  # Turn that brings it there, in this unit; in px: how far it has to move right
    tilt: float | None = None  # The same; in px: up. By the beam in steps (`BEAM_STEP_DEG`, `BEAM_STEP_PX`)
    tag_off: Offset | None = None  # The same turns for the tag, not rounded
    beam_off: Offset | None = None  # For the centre of the beam's disc, not rounded
    # Borders of the frame that the dark square touches; None if none is seen.
    square_borders: tuple[Border, ...] | None = None
    focal_px: float | None = None  # Focal length used, px
    tag_px: Offset | None = None  # Centre of the tag (column, row), px
    # Angle of the pattern against the pixel rows or diagonals, degrees, -22.5 to 22.5; positive is clockwise.
    roll_deg: float | None = None
    # Roll that brings this angle to `ROLL_WANTED_DEG`, degrees; 0 if it is large enough.
    roll_by_deg: float | None = None
    rim_poses: str = ""  # Which poses show the beam's rim, a sentence; empty if unknown
    # Axes that would have to turn beyond their limits, with the angle that they would reach, degrees.
    beyond: Mapping[str, float] = field(default_factory=dict)

    @property
    def centred(self) -> bool:
        """Whether what is brought to the middle is there."""
        if self.pan is None or self.tilt is None:
            return False
        limit = CENTRED_DEG if self.unit == "°" else CENTRED_PX
        return math.hypot(self.pan, self.tilt) <= limit


def where_to_turn(
    size: tuple[int, int],
    beam: Beam,
    stars: QuickStars | None,
    setting: LiveSetting,
    reading_deg: Mapping[str, float],
    motion: SeenMotion | None = None,
    square: DarkSquare | None = None,
) -> TurnFigures:
    """Find out where to turn in an image of a width and height, px.

    ``motion`` None relies on the signs of the bench. ``square`` is a dark one that looks like the tag, if none was
    found.
    """
    grid, target = grid_of(stars), setting.target
    named = stars is not None and (bool(stars.named_by) or stars.tag is not None)
    focal = _focal_px(grid if named else None, size, setting)
    tag_at = beam_at = None
    if grid is not None and named:
        middle = np.array(target.tag_centre_mm) / target.pitch_mm
        tag_at = tuple(float(v) for v in apply_homography(grid, middle[None])[0])
    if beam.centre_px is not None:
        beam_at = beam.centre_px
    offs = []
    for at in (tag_at, square.centre_px if square else None, beam_at):
        by_motion = motion.turn((at[0], at[1]), size, focal) if motion and at and focal else None
        offs.append(by_motion or (turn_to_centre((at[0], at[1]), size, focal, reading_deg) if at else None))
    of, chosen = next(
        ((name, off) for name, off in zip(("tag", "square", "beam"), offs, strict=True) if off), ("", None)
    )
    if of == "beam" and chosen is not None:
        chosen = _in_steps(chosen, BEAM_STEP_DEG if focal else BEAM_STEP_PX)
    roll = roll_deg(grid, size)
    return TurnFigures(
        of=of,
        unit="°" if focal else "px",
        pan=chosen[0] if chosen else None,
        tilt=chosen[1] if chosen else None,
        tag_off=offs[0],
        beam_off=offs[2],
        square_borders=square.borders if square else None,
        focal_px=focal,
        tag_px=(tag_at[0], tag_at[1]) if tag_at else None,
        roll_deg=roll,
        roll_by_deg=None if roll is None else roll_by_deg(roll),
        rim_poses=rim_poses(size, focal, offs[2] or offs[0] or offs[1], beam, setting, reading_deg),
        beyond=_beyond(chosen, setting, reading_deg) if chosen and focal and reading_deg else {},
    )


def _in_steps(turn: Offset, step: float) -> Offset:
    """Return a turn as whole steps."""
    return round(turn[0] / step) * step + 0.0, round(turn[1] / step) * step + 0.0


def _beyond(turn: Offset, setting: LiveSetting, reading_deg: Mapping[str, float]) -> dict[str, float]:
    """Return the angles that lie beyond the limits of their axes after a turn, degrees, by axis."""
    reached = {}
    for axis, by in zip(("pan", "tilt"), turn, strict=True):
        there = reading_deg.get(axis, 0.0) + by
        low, high = setting.limits_deg.get(axis, (-math.inf, math.inf))
        if not low <= there <= high:
            reached[axis] = there
    return reached


def turn_to_centre(
    point_px: Offset, size: tuple[int, int], focal_px: float | None, reading_deg: Mapping[str, float]
) -> Offset:
    """Return the turns of pan and tilt, degrees, that bring a point (column, row, px) to the middle of the image.

    The direction d of the point satisfies d = G(pan, tilt) b. Wanted are angles with G b along the optical axis, for G
    = Rz(roll) Rx(tilt) Ry(pan); own solution of this equation. ``size`` is width and height, px; an axis missing in
    ``reading_deg`` is at 0. Without a focal length: how far the point has to move right and up, px.

    >>> pan, tilt = turn_to_centre((639.5 - 100, 359.5 + 50), (1280, 720), 1000.0, {})
    >>> round(pan, 3), round(tilt, 3)
    (5.711, 2.848)
    """
    right, down = point_px[0] - (size[0] - 1) / 2.0, point_px[1] - (size[1] - 1) / 2.0
    if focal_px is None:
        return -right, down
    angles = [float(reading_deg.get(axis, 0.0)) for axis in ("pan", "tilt", "roll")]
    x, y, z = euler_zxy(*angles).T @ np.array([right / focal_px, down / focal_px, 1.0])
    pan = math.degrees(math.atan2(-x, z))
    tilt = math.degrees(math.atan2(y, math.hypot(x, z)))
    return _wrapped(pan - angles[0]), _wrapped(tilt - angles[1])


def roll_deg(grid: NDArray[np.float64] | None, size: tuple[int, int]) -> float | None:
    """Return the angle of the grid, (3, 3), against the pixel rows or diagonals: -22.5 to 22.5, clockwise."""
    if grid is None:
        return None
    middle = np.array([[(size[0] - 1) / 2.0, (size[1] - 1) / 2.0]])
    along = linear_at(grid, apply_homography(np.asarray(np.linalg.inv(grid)), middle))[0][:, 0]
    angle = math.degrees(math.atan2(along[1], along[0]))
    return (angle + 22.5) % 45.0 - 22.5


def roll_by_deg(roll: float) -> float:
    """Return by how much to roll the pattern so that its angle against the pixels is `ROLL_WANTED_DEG`.

    The present angle is -22.5 to 22.5 degrees; positive turns clockwise. 0 if it is `LEAST_ROLL_DEG` or more.

    >>> roll_by_deg(1.0), roll_by_deg(-2.0), roll_by_deg(12.0)
    (9.0, -8.0, 0.0)
    """
    return 0.0 if abs(roll) >= LEAST_ROLL_DEG else math.copysign(ROLL_WANTED_DEG, roll) - roll


def rim_poses(
    size: tuple[int, int],
    focal_px: float | None,
    off: Offset | None,
    beam: Beam,
    setting: LiveSetting,
    reading_deg: Mapping[str, float],
) -> str:
    """Return as a sentence which poses show the rim of the beam, in whole degrees rounded outwards; empty if unknown.

    The rim is `half_angle_deg` or the radius in the image from the beam's centre, whichever is larger; from the tag if
    the centre is not seen. A tenth of the image beyond it has to be in view. ``size`` px; ``off`` turns, degrees.
    """
    if focal_px is None or off is None or not reading_deg:
        return ""  # without a reading, no angle of a pose is known
    half_angle = setting.half_angle_deg
    if beam.radius_px is not None:
        half_angle = max(half_angle or 0.0, math.degrees(math.atan(beam.radius_px / focal_px)))
    if half_angle is None:
        return ""
    parts = []
    for axis, turn, side in (("pan", off[0], size[0]), ("tilt", off[1], size[1])):
        reach = half_angle - math.degrees(math.atan((0.5 - _RIM_INSIDE_SHARE) * side / focal_px))
        middle = float(reading_deg.get(axis, 0.0)) + turn
        low, high = setting.limits_deg.get(axis, (-90.0, 90.0))
        if reach <= 0.0:
            return "Every pose shows the rim of the beam."
        ends = []
        below, above = math.floor(middle - reach), math.ceil(middle + reach)
        if below >= low:
            ends.append(f"below {below}°")
        if above <= high:
            ends.append(f"above {above}°")
        if ends:
            parts.append(f"{axis} is {' or '.join(ends)}")
    return (
        f"The rim of the beam is in view if {', or '.join(parts)} (about)."
        if parts
        else ("No pose within the limits of the stage shows the rim of the beam.")
    )


def grid_of(stars: QuickStars | None) -> NDArray[np.float64] | None:
    """Return the homography from [column row 1] to [u v 1] px, (3, 3): from stars, or the tag alone; None without.

    Columns and rows are those of the target if the stars have ids, else of any origin and quarter turn.
    """
    if stars is None:
        return None
    if len(stars.points_px):
        return fit_homography(stars.nodes, stars.points_px)
    return stars.tag.homography if stars.tag is not None else None


def _focal_px(grid: NDArray[np.float64] | None, size: tuple[int, int], setting: LiveSetting) -> float | None:
    """Return the focal length by the pitch of the stars in the middle of the image, or the expected one."""
    if grid is None or setting.r_mm is None:
        return setting.focal_px
    middle = np.array([[(size[0] - 1) / 2.0, (size[1] - 1) / 2.0]])
    linear = linear_at(grid, apply_homography(np.asarray(np.linalg.inv(grid)), middle))[0]
    pitch_px = math.sqrt(abs(float(np.linalg.det(linear))))
    focal_px = pitch_px * setting.r_mm / setting.target.pitch_mm
    return focal_px if math.isfinite(focal_px) and focal_px > 0.1 * size[0] else setting.focal_px


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
