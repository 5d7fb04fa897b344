"""Whether the camera stood still: the stars of both halves of a window of whole periods are compared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.errors import TooFewEvents, TooFewStars
from calib.events.event_image import SliceFacts
from calib.view import View

#: Shift between the halves from which a pose counts as moving, px. Repeated recordings of a pose at rest differ by
#: 0.006 to 0.02 px a star, and far less in the mean.
MOVING_PX = 0.05
#: Least number of stars that both halves must show.
MIN_COMMON = 8


class Motion(NamedTuple):
    """Typical shift of the stars from the first half to the second."""

    shift_px: tuple[float, float]  # Median shift along x and y, px
    # Standard uncertainty of each component, px, from the scatter of the stars' shifts.
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
    """Return start and end, us, of each half of a slice, in whole periods; `TooFewEvents` if it has one period.

    Own rule: n periods give two halves of floor(n / 2) periods; a middle period belongs to neither.
    """
    if facts.periods < 2:
        raise TooFewEvents(
            "The slice holds one period; two are needed to compare its halves.",
            where="motion",
            remedy="Record at least two periods.",
        )
    half = (facts.end_us - facts.start_us) / facts.periods * (facts.periods // 2)
    return (facts.start_us, facts.start_us + half), (facts.end_us - half, facts.end_us)


def motion_between(first: View, second: View) -> Motion:
    """Compare the stars that two views of one pose share, at least `MIN_COMMON`: the shift from first to second.

    Medians are used instead of means, so that single wrong stars do not matter. The median absolute deviation times
    1.4826 is the standard deviation of normal noise (Rousseeuw and Croux, 1993); the median of normal noise is sqrt(pi
    / 2) = 1.2533 times as uncertain as its mean (Huber, 1981).
    """
    _, a, b = np.intersect1d(first.ids, second.ids, assume_unique=True, return_indices=True)
    if a.size < MIN_COMMON:
        raise TooFewStars(
            f"The halves of the recording share {a.size} stars; {MIN_COMMON} are needed.",
            where=f"view {first.name}",
            remedy="Record for longer.",
        )
    shifts = second.points_px[b] - first.points_px[a]
    median = np.median(shifts, axis=0)
    sigma = 1.2533 * 1.4826 * np.median(np.abs(shifts - median), axis=0) / np.sqrt(a.size)
    return Motion((float(median[0]), float(median[1])), (float(sigma[0]), float(sigma[1])), int(a.size))
