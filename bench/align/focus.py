"""The course of the focus while a person turns the focus ring: the best seen, the right way, and how far to turn.

A turn shows as a change of the figures, whenever it comes. How far the person has turned is not known: turns are
counted in units of the first one, and each is taken to be as long as was asked for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import fit_homography
from calib.stars.beam import Beam
from calib.stars.focus import blur_circle, coarse_detail, edge_widths_px, sharpness
from calib.stars.quick import QuickStars
from calib.target import StarTarget

# The focus figures of a live picture.
#
# The edge width is one number from far out of focus to sharp. Near focus, it is the width of the stars'
# edges. Farther out, it follows from the blur circle that the print around the tag shows. If neither stars
# nor a tag are found, only the sharpness is measured. The module computes with arrays.

REGIONS: Final[Mapping[str, tuple[float, float]]] = {
    "centre": (0.5, 0.5),
    "top left": (0.17, 0.2),
    "top right": (0.83, 0.2),
    "bottom left": (0.17, 0.8),
    "bottom right": (0.83, 0.8),
}
"""Middle of each region, as shares of width and height."""
_HALF_SIZE: Final = (0.25, 0.3)
_STARS_A_REGION: Final = 9
_CIRCLE_FROM_PX: Final = 1.2
"""Edge width below which the blur circle is far from one that counts, px."""
_TRUSTED_CIRCLE_PX: Final = 9.0
"""Blur circle from which it counts more than the stars' edges; these stop to grow there."""
_SIGMA_OF_CIRCLE: Final = 0.25
"""Standard deviation of the points of a uniform disc along one axis, as a share of the diameter."""
_NEAR_TAG: Final = 40
_TILT_PX, _TILT_SHARE = 0.15, 0.15


@dataclass(frozen=True)
class FocusFigures:
    """How sharp a picture is. What was not measured is None."""

    edge_width_px: float | None = None  # Standard deviation of the edges' blur, px
    # Diameter of the circle by which the print around the tag is blurred, px.
    blur_circle_px: float | None = None
    # Amount of detail in the beam, without unit; it depends on what is in the picture.
    sharpness: float | None = None
    coarse_detail: float | None = None
    # Edge width of each region of `REGIONS`, px.
    regions: Mapping[str, float | None] = field(default_factory=dict)
    tilt: str = ""  # Which side of the field is less sharp, a sentence; empty if none is
    # The course so far: smallest edge width, most sharpness and coarse detail; best edge width since the camera was
    # turned, px, if the present one is clearly worse, else None.
    best_edge_width_px: float | None = None
    best_sharpness: float | None = None
    best_coarse_detail: float | None = None
    better_before_px: float | None = None
    # What the last turn of the ring has done: ``better``, ``worse``, or empty before the first one; and how far to turn
    # next, in units of the last turn, below 0 to turn back.
    trend: str = ""
    turn_on: float | None = None


def measure_focus(
    image: NDArray[np.float32],
    beam: Beam,
    stars: QuickStars | None,
    target: StarTarget,
    *,
    before: FocusFigures | None = None,
    again: Sequence[str] = (),
) -> FocusFigures:
    """Measure how sharp a picture, (H, W) float32 grey values, is; ``stars`` None if they were not searched.

    The regions of ``before``, a picture shortly before, are kept; None to measure all regions.
    """
    detail = sharpness(image, beam.lit) if beam.share > 0.0 else None
    coarse = coarse_detail(image, beam.lit) if beam.share > 0.0 else None
    if stars is None:
        return FocusFigures(sharpness=detail, coarse_detail=coarse)
    kept = {} if before is None else {name: w for name, w in before.regions.items() if name not in again}
    regions = _region_widths(image, stars, target, kept)
    known = [width for width in regions.values() if width is not None]
    width = float(np.median(known)) if known else None
    circle = before.blur_circle_px if before is not None else None
    if before is None or width is None or width > _CIRCLE_FROM_PX:
        circle = _circle(image, stars, target)
    if circle is not None and (width is None or circle >= _TRUSTED_CIRCLE_PX):
        width = max(width or 0.0, _SIGMA_OF_CIRCLE * circle)
    return FocusFigures(width, circle, detail, coarse, regions, tilt_of(regions))


def tilt_of(regions: Mapping[str, float | None]) -> str:
    """Return as a sentence which side of the field is less sharp, by the regions' edge widths, px (None: unknown).

    It is empty if no side is clearly less sharp, or a side is unknown.

    >>> tilt_of({"top left": 0.8, "top right": 1.2, "bottom left": 0.8, "bottom right": 1.2})
    'Edges are 1.2 px wide on the right and 0.8 px on the left.'
    """
    found = []
    for one, other in (("left", "right"), ("top", "bottom")):
        widths = [[w for name, w in regions.items() if side in name.split()] for side in (one, other)]
        sides = [float(np.mean([w for w in ws if w is not None])) for ws in widths if ws and None not in ws]
        if len(sides) == 2 and abs(sides[1] - sides[0]) > max(_TILT_PX, _TILT_SHARE * min(sides)):
            (low, less), (high, more) = sorted(((sides[0], one), (sides[1], other)))
            where = {
                "left": "on the left",
                "right": "on the right",
                "top": "at the top",
                "bottom": "at the bottom",
            }
            text = f"Edges are {high:.1f} px wide {where[more]} and {low:.1f} px {where[less]}."
            found.append((high - low, text))
    return max(found)[1] if found else ""


def _region_widths(
    image: NDArray[np.float32],
    stars: QuickStars,
    target: StarTarget,
    kept: Mapping[str, float | None],
) -> dict[str, float | None]:
    """Return the edge width of each region, from the stars nearest to its middle, unless it is kept."""
    if stars.local_map is None:
        return dict.fromkeys(REGIONS)
    size = np.array([image.shape[1], image.shape[0]], float)
    groups = []
    for name, middle in REGIONS.items():
        if name not in kept:
            off = (stars.points_px - np.array(middle) * size) / size
            inside = np.flatnonzero((np.abs(off) <= np.array(_HALF_SIZE)).all(axis=1))
            order = np.argsort(np.linalg.norm((off * size)[inside], axis=1), kind="stable")
            groups.append(inside[order[:_STARS_A_REGION]].astype(np.int64))
    near = [width for width in kept.values() if width is not None]
    start_px = float(np.median(near)) if near else None
    widths = iter(edge_widths_px(image, stars.points_px, stars.local_map, target, groups, start_px=start_px))
    return {name: kept[name] if name in kept else next(widths) for name in REGIONS}


def _circle(image: NDArray[np.float32], stars: QuickStars, target: StarTarget) -> float | None:
    """Return the blur circle around the tag, px; None if the tag is not in view."""
    if stars.named_by and len(stars.points_px):
        # Stars give the place of the print better than the tag: bright light does not move them.
        off = stars.nodes - np.array(target.tag_centre_mm) / target.pitch_mm
        near = np.argsort(np.linalg.norm(off, axis=1))[:_NEAR_TAG]
        found = blur_circle(
            image, fit_homography(stars.nodes[near], stars.points_px[near]), target, enlarged=(1.0,)
        )
    elif stars.tag is not None:
        found = blur_circle(image, stars.tag.homography, target)
    else:
        return None
    return found.diameter_px if found is not None else None


_LEAST_BETTER: Final = 0.05
"""Smallest relative change by which a width is worse than the best."""
_A_TURN: Final = 0.1
"""Smallest relative change that a turn of the ring makes; less is noise, in dim light above all."""
_RECENT: Final = 3
_CLEARLY, _LEAST_NOISE, _NOISE_OVER = 3.0, 0.01, 12
"""Number of standard deviations by which a value is clearly another one, their least value, and over how many."""
_LEARNT: Final = 0.3
"""Weight of the newest figures in those of a place where the ring stands."""
_SHARPEST_PX: Final = 0.6
"""Edge width of a sharp picture, if none sharper was seen, px."""
_LARGEST_TURN, _LEAST_TURN = 3.0, 0.1
"""Most and least that is asked for, in units of the last turn."""
_BACK: Final = -2.0
"""What is asked for after a turn that made the coarse detail worse: back, and as far again."""


@dataclass
class _Rest:
    """A place of the ring."""

    kind: Literal["width", "detail"]
    value: float  # Edge width, px, or coarse detail
    place: float  # In units of the first turn
    settled: bool  # Whether the figure has stopped to change

    def worse_than(self, other: _Rest) -> float:
        """Return by how much the figure is worse than at another place, as a share; it is at least 0 by its kind."""
        if self.kind != other.kind:
            return 1.0 if self.kind == "detail" else -1.0  # edges that can be measured are sharper
        change = (self.value - other.value) / max(other.value, 1e-9)
        return change if self.kind == "width" else -change


class FocusCourse:
    """The focus figures over the last ``kept_s`` of the caller's clock, with the best seen, kept until `forget`."""

    def __init__(self, *, kept_s: float = 600.0) -> None:
        self._kept_s = kept_s
        self._course: deque[tuple[float, float | None, float | None, float | None]] = deque(maxlen=6000)
        self._rests: list[_Rest] = []
        self._best_here_px: float | None = None
        self.best_edge_width_px: float | None = None
        """Smallest edge width seen, px: the median of `_RECENT` neighbouring values."""
        self.best_sharpness: float | None = None
        """Largest sharpness seen, likewise."""
        self.best_coarse_detail: float | None = None
        """Most coarse detail seen, likewise."""

    def add(self, time_s: float, figures: FocusFigures) -> None:
        """Add the figures of a picture; its time, s, does not decrease."""
        self._course.append((time_s, figures.edge_width_px, figures.sharpness, figures.coarse_detail))
        while self._course[0][0] < time_s - self._kept_s:
            self._course.popleft()
        width, detail = self._recent(1), self._recent(3)
        if width is not None:
            self.best_edge_width_px = min(width, self.best_edge_width_px or width)
            self._best_here_px = min(width, self._best_here_px or width)
        self.best_sharpness = _larger(self._recent(2), self.best_sharpness)
        self.best_coarse_detail = _larger(detail, self.best_coarse_detail)
        if figures.edge_width_px is not None:
            self._follow("width", 1)
        elif figures.coarse_detail is not None:
            self._follow("detail", 3)

    def judged(self, figures: FocusFigures) -> FocusFigures:
        """Return the figures of a picture with those of the course."""
        return replace(
            figures,
            best_edge_width_px=self.best_edge_width_px,
            best_sharpness=self.best_sharpness,
            best_coarse_detail=self.best_coarse_detail,
            better_before_px=self.better_before_px(),
            trend=self.trend(),
            turn_on=self.turn_on(),
        )

    def turned(self) -> None:
        """Note that camera or light have changed: edges elsewhere in the field have another width."""
        self._best_here_px = None
        self._rests.clear()

    def better_before_px(self) -> float | None:
        """Return the best edge width since the camera was last turned, px, if the present one is clearly worse.

        Own rule: the median of the last values is worse by both limits; the deviation is that of neighbours (von
        Neumann, 1941).
        """
        best, now = self._best_here_px, self._recent(1)
        if best is None or now is None:
            return None
        return best if now > best + max(_CLEARLY * self._noise(1), _LEAST_BETTER * best) else None

    def forget(self) -> None:
        """Forget course and best values."""
        self._course.clear()
        self._rests.clear()
        self._best_here_px = self.best_edge_width_px = None
        self.best_sharpness = self.best_coarse_detail = None

    def trend(self) -> str:
        """Return what the last turn did to the edge width: ``better``, ``worse``, or empty before the first turn."""
        if len(self._rests) < 2:
            return ""
        return "worse" if self._rests[-1].worse_than(self._rests[-2]) > 0.0 else "better"

    def turn_on(self) -> float | None:
        """Return how far to turn next, in units of the last turn: below 0 to turn back; None before the first turn.

        The square of the edge width is a parabola over the ring (thin lens, Hecht, Optics, section 5.2). Three places
        give it; two if the last turn has not passed the best one.
        """
        if len(self._rests) < 2:
            return None
        before, here = self._rests[-2:]
        last = here.place - before.place
        if here.kind == "detail" or before.kind == "detail":
            return 1.0 if self.trend() == "better" else _BACK
        best = self._vertex()
        if best is None:
            best = here.place + last * self._line(before.value, here.value)
        ratio = (best - here.place) / last
        if ratio > 0.0 and self.trend() == "worse":  # turns of another length than was asked for
            ratio = self._line(before.value, here.value)
        return math.copysign(min(max(abs(ratio), _LEAST_TURN), _LARGEST_TURN), ratio)

    def _vertex(self) -> float | None:
        """Return the best place by the last three ones; None if they do not enclose a minimum."""
        rests = self._rests[-3:]
        if len(rests) < 3 or any(one.kind == "detail" for one in rests):
            return None
        places = [one.place for one in rests]
        if (
            min(
                abs(a - b)
                for a, b in ((places[0], places[1]), (places[1], places[2]), (places[0], places[2]))
            )
            < 1e-3
        ):
            return None
        bend, slope, _ = np.polyfit(places, [one.value**2 for one in rests], 2)
        return float(-slope / (2.0 * bend)) if bend > 0.0 else None

    def _line(self, before_px: float, here_px: float) -> float:
        """Return how far to turn on in units of the last turn, if the blur has one sign at both places."""
        sharp_px = min(_SHARPEST_PX, self.best_edge_width_px or _SHARPEST_PX)
        before, here = (math.sqrt(max(width**2 - sharp_px**2, 1e-6)) for width in (before_px, here_px))
        return here / (before - here) if before != here else _LARGEST_TURN

    def _follow(self, kind: Literal["width", "detail"], column: int) -> None:
        """Tell whether the ring stands, turns or has been turned; two figures that differ tell nothing."""
        pair = self._values(column, 2)
        value, noise = sum(pair) / 2.0, self._noise(column)
        if len(pair) < 2 or abs(pair[1] - pair[0]) > max(_CLEARLY * noise, _A_TURN * value):
            return
        now = _Rest(kind, value, 0.0, settled=False)
        if not self._rests:
            self._rests.append(now)
            return
        here = self._rests[-1]
        changed = now.kind != here.kind or abs(value - here.value) > max(
            _CLEARLY * noise, _A_TURN * here.value
        )
        if not changed:
            here.settled = True
            here.value += _LEARNT * (value - here.value)
        elif here.settled:
            now.place = self._expected_place()
            self._rests.append(now)
        elif len(self._rests) > 1 and (now.worse_than(here) > 0.0) != (self.trend() == "worse"):
            # Turned through the best place, or back, without a rest: how far is not known.
            here.settled, here.place, now.place = True, 0.0, 1.0
            self._rests[:] = [here, now]
        else:
            here.kind, here.value = kind, value
        del self._rests[:-3]

    def _expected_place(self) -> float:
        """Return where the ring stands after a turn that was as long as was asked for."""
        ratio = self.turn_on()
        if ratio is None:
            return 1.0
        return self._rests[-1].place + ratio * (self._rests[-1].place - self._rests[-2].place)

    def _values(self, column: int, count: int) -> list[float]:
        return [float(v) for one in list(self._course)[-count:] if (v := one[column]) is not None]

    def _recent(self, column: int) -> float | None:
        """Return the median of the newest values of a column; None if there are fewer than `_RECENT`."""
        values = self._values(column, _RECENT)
        return float(np.median(values)) if len(values) == _RECENT else None

    def _noise(self, column: int) -> float:
        """Return the standard deviation of neighbouring values from each other."""
        steps = np.abs(np.diff(self._values(column, _NOISE_OVER)))
        least = _LEAST_NOISE if column == 1 else 0.0
        return max(1.05 * float(np.median(steps)), least) if len(steps) else least


def _larger(one: float | None, other: float | None) -> float | None:
    """Return the larger of two numbers that may be unknown."""
    known = [value for value in (one, other) if value is not None]
    return max(known, default=None)
