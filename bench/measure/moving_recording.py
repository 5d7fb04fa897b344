"""A recording of a moving camera before a still board: pictures evenly spread over it, reconstructed from its RAW file.

The file is read in pieces, so its length does not matter. This module finds no board.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from calib.errors import TooFewEvents
from calib.events.reconstruction import ReconstructedPicture, reconstruct
from drivers.camera.raw_file import RawFile

MOVING_REMEDY = (
    "Move the camera obliquely to the edges of the board, by more than two squares around the time of the picture; "
    "for slow motion give a lower frequency to --reconstruct."
)
_MOST_PICTURES = 40  # Each takes a search for the board, and neighbours show nearly the same
_LEAST_APART_S = 0.05  # Three time constants of the filter at its usual 10 Hz: other events make each picture


class MovingRecording:
    """Pictures of one recording, by a filter with a cutoff frequency, evenly spread over it."""

    def __init__(self, path: Path, cutoff_hz: float) -> None:
        self._path, self._cutoff_hz = path, cutoff_hz
        self._first_us, last_us = _span_us(path)
        self.at_s = _spread(1e-6 * (last_us - self._first_us))
        """Times of the pictures after the first event, s."""
        self._next = 0
        self._stream = self._reconstructed()

    def picture(self, number: int) -> ReconstructedPicture:
        """Return a picture, numbered from 0; fastest in the order of their times."""
        if number < self._next:
            self._next, self._stream = 0, self._reconstructed()
        while True:
            picture = next(self._stream)
            self._next += 1
            if self._next > number:
                return picture

    def _reconstructed(self) -> Iterator[ReconstructedPicture]:
        raw = RawFile.open(self._path)
        times_us = [self._first_us + 1e6 * at_s for at_s in self.at_s]
        return reconstruct(raw.chunks(), (raw.width, raw.height), times_us, cutoff_hz=self._cutoff_hz)


def _span_us(path: Path) -> tuple[int, int]:
    """Return the times of the first and the last event, us."""
    first, last = None, 0
    for events in RawFile.open(path).chunks():
        first = int(events.t[0]) if first is None else first
        last = int(events.t[-1])
    if first is None:
        raise TooFewEvents("The recording holds no event.", where=str(path))
    return first, last


def _spread(length_s: float) -> tuple[float, ...]:
    """Return the middles of equal parts of a recording, at most 40 and at least 0.05 s apart."""
    count = max(1, min(_MOST_PICTURES, int(length_s / _LEAST_APART_S)))
    return tuple(length_s * (number + 0.5) / count for number in range(count))
