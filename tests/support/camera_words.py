"""What an event camera that a test plays sends in two milliseconds."""

import numpy as np


def words_of(step, *more):
    """Return the EVT3 words of the two milliseconds of that number: clock, one event, more words, clock at the end."""
    t = 9_000_000 + 2000 * step
    words = [0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF, step % 720, 0x2800 | step % 1280, *more]
    t += 1999
    return np.array([*words, 0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF], "<u2").tobytes()
