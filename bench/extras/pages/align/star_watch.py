"""Stars and focus of live pictures: a full search now and then; between searches, the known stars are followed.

A search takes five times as long as following stars that stand still. Nothing is followed that has moved:
then the stars are searched at once, or none are shown. Pictures are compared when they are reduced to
some thousand cells, which takes a millisecond. The module reads no file and opens no device.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.extras.pages.align.focus import REGIONS, FocusFigures, measure_focus
from bench.extras.pages.align.live_image import LiveImage, LiveSetting, LiveSlice
from calib.errors import TargetNotFound
from calib.stars.beam import Beam
from calib.stars.quick import QuickStars, find_stars_quickly, follow_stars
from calib.stars.tag import DarkSquare, find_dark_square

_CELLS: Final = 320
"""Long side of the reduced picture, cells."""
_ALIKE: Final = 0.97
"""Least correlation of two pictures of the same view."""
_TURNED_DEG: Final = 0.02
"""Change of a reading from which the stage has turned, degrees."""
_REST: Final = 1.5
"""Time from one search for stars to the next, at least, in units of the time that the last one took."""
_FOLLOWED: Final = 8.0
"""Time between two searches while the stars are followed from picture to picture, in units of that between others."""


class Sighting(NamedTuple):
    """What a picture showed, and where the stage stood."""

    cells: NDArray[np.float32]  # (h, w) float32, the reduced picture, with mean 0 and a sum of squares of 1
    reading_deg: Mapping[str, float]  # Angles of the stage, degrees; empty if unknown

    @classmethod
    def of(cls, values: NDArray[np.float32], reading_deg: Mapping[str, float]) -> Sighting:
        """Reduce a picture, (H, W) float32, seen at angles of the stage, degrees; empty if they are unknown."""
        return cls(_reduced(values), dict(reading_deg))

    def differs(self, values: NDArray[np.float32], reading_deg: Mapping[str, float]) -> bool:
        """Return whether a picture shows another view, by the angles, or by the pictures' correlation (Pearson)."""
        turned = [abs(angle - self.reading_deg.get(axis, angle)) for axis, angle in reading_deg.items()]
        if max(turned, default=0.0) > _TURNED_DEG:
            return True
        cells = _reduced(values)
        return cells.shape != self.cells.shape or float((cells * self.cells).sum()) < _ALIKE


def _reduced(values: NDArray[np.float32]) -> NDArray[np.float32]:
    scale = _CELLS / max(values.shape)
    shape = max(1, round(values.shape[1] * scale)), max(1, round(values.shape[0] * scale))
    cells = np.nan_to_num(cv2.resize(values, shape, interpolation=cv2.INTER_AREA).astype(np.float32))
    cells -= cells.mean()
    norm = float(np.linalg.norm(cells))
    return np.asarray(cells / norm if norm > 0.0 else cells, np.float32)


class Found(NamedTuple):
    """Stars and focus."""

    time_s: float  # Time of the slice in which they were measured, s
    stars: QuickStars | None  # Tag and stars; None if none are known
    other_tag: str  # What is wrong with the tags seen; empty if nothing is
    focus: FocusFigures
    took_s: float  # Duration of the last search, s
    square: DarkSquare | None = None  # A dark square that looks like the tag, if the tag was not read
    searched_s: float = 0.0  # Time of the slice of the last search, s
    followed: bool = False  # Whether the stars were measured again after a search
    seen: Sighting | None = None  # What the picture of the last search showed


class StopWatch:
    """Durations of the stages of a measurement, ms."""

    def __init__(self) -> None:
        self._last_s = time.perf_counter()
        self._took_ms: dict[str, float] = {}

    def lap(self, stage: str) -> dict[str, float]:
        """Add the time since the last call to a stage, and return all durations so far, ms."""
        now_s = time.perf_counter()
        self._took_ms[stage] = self._took_ms.get(stage, 0.0) + round(1e3 * (now_s - self._last_s), 1)
        self._last_s = now_s
        return dict(self._took_ms)


class StarWatch:
    """Finds the stars of one slice after the other, in one thread; ``stars_every_s`` as `LiveMeter` takes it."""

    def __init__(self, *, stars_every_s: float) -> None:
        self._stars_every_s = stars_every_s
        self._found: Found | None = None
        self._turn = 0

    def forget(self) -> None:
        """Forget the last stars: the next slice is searched."""
        self._found = None

    def look(
        self, part: LiveSlice, setting: LiveSetting, image: LiveImage, beam: Beam, watch: StopWatch
    ) -> Found:
        """Search stars and measure the focus if it is time to; else measure the last stars again, where they stand."""
        last = self._found
        if beam.share <= 0.0 or (image.signal is not None and image.signal.flicker is None):
            self._found = None
            return Found(part.time_s, None, "", FocusFigures(), 0.0)
        if last is not None and not self._is_due(part):
            kept = self._followed(last, part, setting, image, watch)
            if kept is not None:
                return kept
        started_s = time.perf_counter()
        stars, other_tag = None, ""
        try:
            stars = find_stars_quickly(image.values, setting.target)
        except TargetNotFound as fault:
            other_tag = f"{fault.what} {fault.remedy}"
        square = None
        if not other_tag and (stars is None or (stars.tag is None and not stars.named_by)):
            square = find_dark_square(image.values, beam, side_px=setting.tag_side_px)
        watch.lap("stars")
        focus = measure_focus(image.values, stars, setting.target)
        watch.lap("focus")
        took_s = time.perf_counter() - started_s
        self._found = Found(part.time_s, stars, other_tag, focus, took_s, square, part.time_s)
        self._found = self._found._replace(seen=Sighting.of(image.values, part.reading_deg))
        return self._found

    def _is_due(self, part: LiveSlice) -> bool:
        """Return whether it is time to search stars again."""
        last = self._found
        if last is None:
            return True
        wait_s = max(self._stars_every_s, _REST * last.took_s)
        if last.followed:
            wait_s = max(_FOLLOWED * self._stars_every_s, wait_s)
        return not 0.0 <= part.time_s - last.searched_s < wait_s

    def _followed(
        self,
        last: Found,
        part: LiveSlice,
        setting: LiveSetting,
        image: LiveImage,
        watch: StopWatch,
    ) -> Found | None:
        """Return what was found last, measured again if possible; None if stars must be searched at once."""
        stars = last.stars
        if stars is not None and stars.tag is not None and not stars.blurred:
            stars = follow_stars(image.values, stars, setting.target)
            watch.lap("stars")
            if stars is None:
                return None if not part.moving else self._lost(last)
            # The middle, and one of the other regions in turn.
            self._turn = self._turn % (len(REGIONS) - 1) + 1
            again = [list(REGIONS)[number] for number in (0, self._turn)]
            focus = measure_focus(image.values, stars, setting.target, before=last.focus, again=again)
            watch.lap("focus")
            self._found = last._replace(time_s=part.time_s, stars=stars, focus=focus, followed=True)
            return self._found
        if last.seen is not None and last.seen.differs(image.values, part.reading_deg):
            return self._lost(last)
        return last

    def _lost(self, last: Found) -> Found:
        """Forget what was found: something has moved since."""
        self._found = last._replace(stars=None, square=None, focus=FocusFigures(), followed=False)
        return self._found
