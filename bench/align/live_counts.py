"""A live slice counted while it is decoded: events of each pixel in whole periods, and what the signal needs.

No list of events is made, which takes most of the time of an event image. The module reads one file.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import Triggers, join_triggers
from drivers.camera.evt3 import Evt3Decoder, StreamStatistics
from drivers.camera.raw_file import RawFile

_TIME_LOW, _TIME_HIGH = 0x6, 0x8
_CLOCK: Final = 1 << 24
"""Number of microseconds after which the time words begin again."""
_NEARLY: Final = 0.02
"""Share of a period that may be missing at the end: time words come only with events."""


class CountedSlice(NamedTuple):
    """A slice as counted."""

    # (2, H, W) uint16, number of OFF events, then of ON events, of each pixel in the whole periods, or in a
    # slice that is shorter than one.
    counts: NDArray[np.uint16]
    periods: int  # Number of whole periods from the start of the slice on; 0 if it is shorter than one
    triggers: Triggers  # Sync edges of the whole slice, with times from its first time word on
    statistics: StreamStatistics  # Counts and times of the whole slice
    data_bytes: int  # Length of the file without its header


def count_slice(raw: RawFile, period_us: float) -> CountedSlice:
    """Count the events of a slice.

    period_us: Period of the flicker, us.
    Returns: The counts.
    Raises drivers.errors.RecordingFileError: If the file cannot be read, or a word is malformed.
    """
    pieces = list(raw.words())
    words = pieces[0] if len(pieces) == 1 else np.concatenate([np.zeros(0, "<u2"), *pieces])
    end, periods = whole_periods(words, period_us)
    first_byte = raw.raw_header.size_bytes
    end = end if periods else len(words)
    decoder = Evt3Decoder(raw.width, raw.height, first_byte=first_byte, where=str(raw.path))
    counts = np.zeros((2, raw.height, raw.width), np.uint16)
    triggers = join_triggers([decoder.count(words[:end], counts), decoder.tally(words[end:])])
    statistics = decoder.statistics()
    triggers.t[:] -= max(statistics.first_t_us, 0)
    return CountedSlice(counts, periods, triggers, statistics, 2 * len(words))


def whole_periods(words: NDArray[np.uint16], period_us: float) -> tuple[int, int]:
    """Return where the last whole period ends.

    words: (N,) uint16, EVT3 words.
    period_us: Period, us.
    Returns: How many periods these are; 0 if there is no whole one.

    Examples
    --------
    >>> words = np.array([0x8000, 0x6000, 0x2001, 0x6063, 0x2002, 0x6064, 0x2003], np.uint16)
    >>> whole_periods(words, 100.0)
    (5, 1)
    """
    kinds = words >> 12
    low, high = np.flatnonzero(kinds == _TIME_LOW), np.flatnonzero(kinds == _TIME_HIGH)
    above = np.searchsorted(high, low) - 1
    low, above = low[above >= 0], above[above >= 0]
    if not len(low):
        return 0, 0
    clock = (words[high[above]].astype(np.int64) & 0xFFF) << 12 | (words[low].astype(np.int64) & 0xFFF)
    # A busy sensor's clock steps back by some microseconds now and then.
    elapsed = np.maximum.accumulate((clock - clock[0] + 4096) % _CLOCK - 4096)
    periods = int(elapsed[-1] / period_us + _NEARLY)
    beyond = np.searchsorted(elapsed, periods * period_us)
    return (int(low[beyond]) if beyond < len(low) else len(words)), periods
