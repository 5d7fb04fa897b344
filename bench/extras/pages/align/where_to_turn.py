"""Where to turn the camera: the offset of tag, dark square or beam from the middle of the image, and the roll.

As in `calib.model.rotation.euler_zxy`, a larger pan moves the pattern right, a larger tilt up, a larger roll clockwise,
for a camera upright on its gimbal.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bench.extras.pages.align.live_image import LiveSetting
from calib.model.homography import apply_homography, fit_homography, linear_at
from calib.model.rotation import euler_zxy
from calib.stars.beam import Beam
from calib.stars.quick import QuickStars
from calib.stars.tag import DarkSquare

LEAST_ROLL_DEG: Final = 5.0
"""Least roll of the pattern against the pixel grid at which stars are located well (docs/stars.md)."""
CENTRED_DEG, CENTRED_PX = 0.25, 15.0
"""Offset up to which the pattern counts as centred, degrees, or px if no focal length is known."""
BEAM_STEP_DEG, BEAM_STEP_PX = 1.0, 50.0
"""Turns by the beam are given in these steps: its rim is ragged, and a frame shows a short arc of it."""
_TURNED_DEG: Final = 0.02
"""Change of a reading from which the stage has turned, degrees."""
_PICTURES: Final = 7
"""Pictures whose median is shown: noise moves each turn."""
_REMEMBERED: Final = 30
"""Pictures of one pose for which what tells the turn best counts: noise hides a blurred tag in most of them."""

Offset = tuple[float, float]


@dataclass(frozen=True)
class TurnFigures:
    """Where to turn. What is not known is None."""

    # What the turn brings to the middle of the image: ``tag``, ``square`` (a dark square that looks like the
    # tag) or ``beam``; empty if none is seen.
    of: str = ""
    unit: str = "°"  # Unit of the turns: ``°``, or ``px`` if no focal length is known
    pan: float | None = None  # Turn that brings it there, in this unit; in px: how far it has to move right
    tilt: float | None = None  # The same; in px: up. By the beam in steps (`BEAM_STEP_DEG`, `BEAM_STEP_PX`)
    # Angle of the pattern against the pixel rows or diagonals, degrees, -22.5 to 22.5; positive is clockwise.
    roll_deg: float | None = None

    @property
    def centred(self) -> bool:
        """Whether what is brought to the middle is there."""
        if self.pan is None or self.tilt is None:
            return False
        limit = CENTRED_DEG if self.unit == "°" else CENTRED_PX
        return math.hypot(self.pan, self.tilt) <= limit


class SteadyTurn:
    """The turn at one pose: the median of the last pictures by what tells it best."""

    def __init__(self) -> None:
        self._recent: deque[TurnFigures] = deque(maxlen=_REMEMBERED)
        self._reading_deg: Mapping[str, float] = {}

    def steady(self, turn: TurnFigures, reading_deg: Mapping[str, float]) -> TurnFigures:
        """Return the turn to show after a new one, seen at angles of the stage, degrees; empty if unknown."""
        before = self._reading_deg
        turned = [abs(angle - before.get(axis, math.inf)) for axis, angle in reading_deg.items()]
        if max(turned, default=0.0) > _TURNED_DEG:
            self._recent.clear()
            self._reading_deg = dict(reading_deg)
        self._recent.append(turn)
        of = next(name for name in ("tag", "square", "beam", "") if any(t.of == name for t in self._recent))
        latest = next(t for t in reversed(self._recent) if t.of == of)
        alike = [t for t in self._recent if t.of == of and t.unit == latest.unit]
        return replace(
            latest,
            pan=_median([t.pan for t in alike]),
            tilt=_median([t.tilt for t in alike]),
            roll_deg=_median([t.roll_deg for t in self._recent]),
        )


def _median(values: list[float | None]) -> float | None:
    """Return the median of the last `_PICTURES` known values."""
    known = [value for value in values if value is not None][-_PICTURES:]
    return float(np.median(known)) if known else None


def where_to_turn(
    size: tuple[int, int],
    beam: Beam,
    stars: QuickStars | None,
    setting: LiveSetting,
    reading_deg: Mapping[str, float],
    square: DarkSquare | None = None,
) -> TurnFigures:
    """Find out where to turn in an image of a width and height, px.

    ``square`` is a dark one that looks like the tag, if none was found.
    """
    grid = grid_of(stars)
    named = stars is not None and (bool(stars.named_by) or stars.tag is not None)
    focal = _focal_px(grid if named else None, size, setting)
    turn = TurnFigures(unit="°" if focal else "px", roll_deg=roll_deg(grid, size))
    if grid is not None and named:
        of, at = "tag", _tag_centre_px(grid, setting)
    elif square is not None:
        of, at = "square", square.centre_px
    elif beam.centre_px is not None:
        of, at = "beam", beam.centre_px
    else:
        return turn
    pan, tilt = turn_to_centre(at, size, focal, reading_deg)
    if of == "beam":
        step = BEAM_STEP_DEG if focal else BEAM_STEP_PX
        pan, tilt = (round(by / step) * step + 0.0 for by in (pan, tilt))  # no -0.0
    return replace(turn, of=of, pan=pan, tilt=tilt)


def _tag_centre_px(grid: NDArray[np.float64], setting: LiveSetting) -> Offset:
    middle = np.array(setting.target.tag_centre_mm) / setting.target.pitch_mm
    column, row = apply_homography(grid, middle[None])[0]
    return float(column), float(row)


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
    along = _linear_in_the_middle(grid, size)[:, 0]
    angle = math.degrees(math.atan2(along[1], along[0]))
    return (angle + 22.5) % 45.0 - 22.5


def _linear_in_the_middle(grid: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """Return the derivative of a grid, (2, 2), in the middle of the image."""
    middle = np.array([[(size[0] - 1) / 2.0, (size[1] - 1) / 2.0]])
    return linear_at(grid, apply_homography(np.asarray(np.linalg.inv(grid)), middle))[0]


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
    pitch_px = math.sqrt(abs(float(np.linalg.det(_linear_in_the_middle(grid, size)))))
    focal_px = pitch_px * setting.r_mm / setting.target.pitch_mm
    return focal_px if math.isfinite(focal_px) and focal_px > 0.1 * size[0] else setting.focal_px


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
