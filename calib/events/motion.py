"""Whether the camera stood still: stars of the first half of a recording against those of the second.

Knows how to halve a window of whole periods, and how to compare two views of one pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.errors import TooFewEvents, TooFewStars
from calib.events.event_image import SliceFacts
from calib.view import View

#: Shift between the halves from which a pose counts as moving, px; repeated recordings of a pose at rest
#: differ by 0.006 to 0.02 px a star, and far less in the mean.
MOVING_PX = 0.05
#: Stars that both halves must show.
MIN_COMMON = 8


class Motion(NamedTuple):
    """Mean shift of the stars from the first half to the second.

    Attributes
    ----------
    shift_px
        (x, y) px.
    sigma_px
        1-sigma of each, px, from the scatter of the stars' shifts.
    stars
        Stars compared.
    """

    shift_px: tuple[float, float]
    sigma_px: tuple[float, float]
    stars: int

    @property
    def length_px(self) -> float:
        """Length of the shift, px."""
        return float(np.hypot(*self.shift_px))

    @property
    def moving(self) -> bool:
        """Whether the shift is `MOVING_PX` or more."""
        return self.length_px >= MOVING_PX


def half_windows(facts: SliceFacts) -> tuple[tuple[float, float], tuple[float, float]]:
    """Begin and end, us, of the first and the second half of a slice, each of whole periods.

    Where their number is odd, the one in the middle belongs to neither.

    Raises
    ------
    TooFewEvents
        When the slice is one period long.
    """
    if facts.periods < 2:
        raise TooFewEvents("One period has no halves of whole periods.", where="motion", remedy="Record two.")
    half = (facts.end_us - facts.start_us) / facts.periods * (facts.periods // 2)
    return (facts.start_us, facts.start_us + half), (facts.end_us - half, facts.end_us)


def motion_between(first: View, second: View) -> Motion:
    """Compare the stars that two views of one pose share.

    Raises
    ------
    TooFewStars
        When they share fewer than `MIN_COMMON`.
    """
    _, a, b = np.intersect1d(first.ids, second.ids, assume_unique=True, return_indices=True)
    if a.size < MIN_COMMON:
        raise TooFewStars(
            f"The halves share {a.size} stars; {MIN_COMMON} are needed.",
            where=f"view {first.name}",
            remedy="Record for longer.",
        )
    shifts = second.points_px[b] - first.points_px[a]
    mean = np.median(shifts, axis=0)
    # 1.4826 makes the median deviation a sigma; a median is 1.2533 times as uncertain as a mean.
    sigma = 1.2533 * 1.4826 * np.median(np.abs(shifts - mean), axis=0) / np.sqrt(a.size)
    return Motion((float(mean[0]), float(mean[1])), (float(sigma[0]), float(sigma[1])), int(a.size))
