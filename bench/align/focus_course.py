"""The course of the focus while a person turns the focus ring: the best seen, the right way, and how far to turn.

A turn shows as a change of the figures, whenever it comes. How far the person has turned is not known: turns are
counted in units of the first one, and each is taken to be about as long as was asked for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from bench.align.focus import FocusFigures

_LEAST_BETTER: Final = 0.05
"""Smallest relative change by which a width is worse than the best."""
_A_TURN: Final = {"width": 0.1, "detail": 0.06}
"""Smallest relative change that a turn of the ring makes; less is noise, in dim light above all."""
_RECENT: Final = 3  # Of their median, which one stray value does not move
_CLEARLY, _LEAST_NOISE, _NOISE_OVER = 3.0, 0.01, 12
"""Number of standard deviations by which a value is clearly another one, their least value, and over how many."""
_LARGEST_TURN, _LEAST_TURN = 3.0, 0.15
"""Most and least that is asked for, in units of the last turn; less is not seen in the picture."""
_ON, _BACK = 1.5, -2.0
"""What is asked for while only coarse detail is seen: farther each time; after a wrong turn, back and as far again."""
_SEEN_WITHIN: Final = 4
"""Figures within which a turn is seen: one in the turn, two at rest and a spare one. A later one is another turn."""
_KEPT: Final = 5
"""Places of the ring that count; the lengths of older turns are too uncertain."""
_SHARPEST_PX: Final = 0.6
"""Edge width of a sharp picture, if none sharper was seen, px."""
_LEAST_BLURRED_PX: Final = 3.0
"""Edge width below which stars are found, so that a place with coarse detail alone is more blurred, px."""
_SLOPES_PX: Final[NDArray[np.float64]] = np.geomspace(0.15, 15.0, 31)
"""Blur by one unit of the ring, px: a first turn of some degrees changes the edges by 0.15 px at least."""
_USUAL_SLOPE_PX, _SLOPE_FACTOR = 1.5, 4.0
"""Usual blur by a first turn, px, and the factor within which two of three are: own estimate for C-mount lenses."""
_WIDTH_SIGMA, _DETAIL_SIGMA = 0.06, 0.2
"""Relative deviations of an edge width, and of the least width where only coarse detail is seen."""
_TURN_SIGMA: Final = 0.15
"""Standard deviation of a turn by hand from what was asked for, as a share of it."""
_REACH: Final = 8.0
"""How far a best place is sought, in units of the way between the places known: a first turn may be a small one."""
_AGAINST: Final = 0.05
"""How much less likely a place is if a picture with more detail would be the more blurred one of two."""


@dataclass
class _Rest:
    """A place of the ring."""

    kind: Literal["width", "detail"]
    value: float  # Edge width, px, or coarse detail
    place: float  # In units of the first turn
    since_s: float  # Time at which the ring came to rest, s
    pictures: int = 0  # Number of further pictures in which the figure was the same

    @property
    def settled(self) -> bool:
        """Whether the figure has stopped to change."""
        return self.pictures > 0

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
        self._turning = False
        self._added = 0
        self._stop: int | None = None
        """Number of figures added when a person reported the ring's stop; None if it does not stand there."""
        self._best_here_px: float | None = None
        self.best_edge_width_px: float | None = None
        """Smallest edge width seen, px: the median of `_RECENT` neighbouring values."""
        self.best_sharpness: float | None = None
        """Largest sharpness seen, likewise."""
        self.best_coarse_detail: float | None = None
        """Most coarse detail seen, likewise."""

    def add(self, time_s: float, figures: FocusFigures) -> None:
        """Add the figures of a picture; its time, s, does not decrease."""
        self._added += 1
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
            turning=self._turning,
            at_stop=self._stop is not None,
            unchanged_s=self._course[-1][0] - self._rests[-1].since_s if self._rests else None,
        )

    def turned(self) -> None:
        """Note that camera or light have changed: edges elsewhere in the field have another width."""
        self._best_here_px = None
        self._rests.clear()
        self._turning, self._stop = False, None

    def at_stop(self) -> None:
        """Note that the ring is at the end of its travel: the best place lies the other way."""
        self._stop = self._added
        if self._rests:
            self._rests[-1].since_s = self._course[-1][0]
        del self._rests[:-2]  # the turn to the stop was shorter than was asked for

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
        self.turned()
        self._course.clear()
        self.best_edge_width_px = self.best_sharpness = self.best_coarse_detail = None

    def trend(self) -> str:
        """Return what the last turn did to the edge width: ``better``, ``worse``, or empty before the first turn."""
        if len(self._rests) < 2:
            return ""
        return "worse" if self._rests[-1].worse_than(self._rests[-2]) > 0.0 else "better"

    def turn_on(self) -> float | None:
        """Return how far to turn next, in units of the last turn: below 0 to turn back; None before the first turn."""
        if len(self._rests) < 2:
            return None
        before, here = self._rests[-2:]
        if any(rest.kind == "width" for rest in self._rests):
            sharp_px = self.best_edge_width_px
            best = best_place(self._rests, sharp_px=sharp_px, behind=self._stop is not None)
            ratio = (best - here.place) / (here.place - before.place)
        else:
            ratio = _ON if self.trend() == "better" else _BACK
        if self._stop is not None:
            ratio = -abs(ratio)
        return math.copysign(min(max(abs(ratio), _LEAST_TURN), _LARGEST_TURN), ratio)

    def _follow(self, kind: Literal["width", "detail"], column: int) -> None:
        """Tell whether the ring stands, turns or has been turned; two figures that differ tell nothing."""
        pair = self._values(column, 2)
        value, noise = sum(pair) / 2.0, self._noise(column)
        seen = max(_CLEARLY * noise, _A_TURN[kind] * value)
        differ = len(pair) == 2 and abs(pair[1] - pair[0]) > seen
        self._turning = bool(self._rests) and (differ or len(pair) < 2)
        if self._turning or len(pair) < 2:
            return
        now = _Rest(kind, value, 0.0, self._course[-1][0])
        if not self._rests:
            self._rests.append(now)
            return
        here = self._rests[-1]
        changed = now.kind != here.kind or abs(value - here.value) > seen
        if not changed:
            here.pictures += 1
            here.value += (value - here.value) / (here.pictures + 1)
        elif here.settled:
            now.place = self._expected_place()
            self._rests.append(now)
            if self._stop is not None and self._added - self._stop <= _SEEN_WITHIN:
                del self._rests[:-2]  # this is the turn to the stop
            else:
                self._stop = None
        elif len(self._rests) > 1 and (now.worse_than(here) > 0.0) != (self.trend() == "worse"):
            # Turned through the best place, or back, without a rest: how far is not known.
            here.pictures, here.place, now.place = 1, 0.0, 1.0
            self._rests[:] = [here, now]
        else:
            here.kind, here.value, here.since_s = kind, value, now.since_s
        del self._rests[:-_KEPT]

    def _expected_place(self) -> float:
        """Return where the ring stands after a turn that was as long as was asked for."""
        ratio = self.turn_on()
        if ratio is None:
            return 1.0
        return self._rests[-1].place + ratio * (self._rests[-1].place - self._rests[-2].place)

    def _values(self, column: int, count: int) -> list[float]:
        return [float(v) for row in list(self._course)[-count:] if (v := row[column]) is not None]

    def _recent(self, column: int) -> float | None:
        """Return the median of the newest values of a column; None if there are fewer than `_RECENT`."""
        values = self._values(column, _RECENT)
        return float(np.median(values)) if len(values) == _RECENT else None

    def _noise(self, column: int) -> float:
        """Return the standard deviation of neighbouring values from each other, while the ring rests.

        It is taken from the lower quartile of the steps, because some of them are turns: 2.22 is the ratio for a
        normal distribution.
        """
        steps = np.abs(np.diff(self._values(column, _NOISE_OVER)))
        least = _LEAST_NOISE if column == 1 else 0.0
        return max(2.22 * float(np.quantile(steps, 0.25)), least) if len(steps) else least


def _larger(first: float | None, other: float | None) -> float | None:
    """Return the larger of two numbers that may be unknown."""
    known = [value for value in (first, other) if value is not None]
    return max(known, default=None)


def best_place(rests: Sequence[_Rest], *, sharp_px: float | None, behind: bool = False) -> float:
    """Return the most probable place of the best focus, in units of the first turn, by all places of the ring.

    The edge width at a place x is hypot(w0, s (x - c)) (thin lens, Hecht, Optics, section 5.2). The place c and the
    slope s are tried on a grid, so that both sides of each place are weighed; ``behind`` leaves the places out that
    lie beyond the last turn.
    """
    here, before = rests[-1].place, rests[-2].place
    last = here - before
    reach = _REACH * max(abs(known.place - here) for known in rests)
    steps = np.linspace(-reach, reach, 601)
    if behind:
        steps = steps[steps * last < 0.0]
    centres, slopes = (here + steps)[:, None], _SLOPES_PX[None, :]
    log_odds = -0.5 * (np.log(slopes / _USUAL_SLOPE_PX) / math.log(_SLOPE_FACTOR)) ** 2
    sharp = min(_SHARPEST_PX, sharp_px or _SHARPEST_PX)
    turned_variance = 0.0
    newer: _Rest | None = None
    for rest in reversed(rests):
        if newer is not None:
            turned_variance += (_TURN_SIGMA * (newer.place - rest.place)) ** 2
        blur = slopes * np.abs(rest.place - centres)
        width = np.hypot(sharp, blur)
        if rest.kind == "width":
            variance = _WIDTH_SIGMA**2 + turned_variance * (slopes * blur / width**2) ** 2
            log_odds = log_odds - 0.5 * (np.log(rest.value / width) ** 2 / variance + np.log(variance))
        else:
            short = np.maximum(0.0, np.log(_LEAST_BLURRED_PX / width)) / _DETAIL_SIGMA
            log_odds = log_odds - 0.5 * short**2
        if newer is not None and rest.kind == newer.kind == "detail":
            nearer = np.abs(newer.place - centres) < np.abs(rest.place - centres)
            log_odds = log_odds + math.log(_AGAINST) * (nearer != (newer.value > rest.value))
        newer = rest
    odds = np.exp(log_odds - log_odds.max()).sum(axis=1)
    return float(centres[int(odds.argmax()), 0])
