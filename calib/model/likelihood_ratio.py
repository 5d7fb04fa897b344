"""The likelihood ratio that a suspected fault must reach: one threshold for all faults, of data and of gimbals."""

from __future__ import annotations

import math

#: Evidence is decisive if 2 log(likelihood ratio) exceeds this: odds of 150 to 1 (Kass and Raftery, 1995: very strong).
DECISIVE = 10.0
#: A cause stands alone if nothing else is within a factor of 20, as 2 log of the odds.
ALONE = 2.0 * math.log(20.0)


def needed(places: int) -> float:
    """Return the 2 log(likelihood ratio) that names a fault, if it was looked for at so many places.

    Every place is as probable beforehand, so the odds of each are that many times smaller.

    >>> round(needed(1)), round(needed(50))
    (10, 18)
    """
    return DECISIVE + 2.0 * math.log(places)
