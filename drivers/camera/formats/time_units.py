"""The unit of times that a file does not state: as assumed or given, it has to fit what cameras send.

Every unit that fits is offered, the likeliest first. A camera that sends less or more than all others is read once its
file states the unit, in the name of the column of times (``t_us``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    MAX_TIME_US,
    EventSource,
    Piece,
    TimeUnit,
    UnstatedUnit,
    origin_of,
)
from drivers.errors import NotARecording

NS: Final[Mapping[TimeUnit, int]] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
_COARSE_US: Final = 1000  # A millisecond
_LEAST_TIMES: Final = 8
"""So many different times that are all whole thousands of us are no chance: 1e-24 with a clock of 1 us."""
_LEAST_RATE: Final = 0.005
"""Events a second and pixel: a twentieth of the background of a sensor at rest (0.1, Nozaki and Delbruck 2017)."""
_LARGEST_RATE: Final = 200.0
"""Three times that of the busiest known recordings (69: boxes_translation of the Event Camera Dataset)."""
_LEAST_EVENTS: Final = 100
"""Fewer events say nothing about their rate."""
_YEAR_2000_US: Final = 946_684_800_000_000  # us since 1970
_YEAR_2100_US: Final = 4_102_444_800_000_000
_CORRECT_TIMES: Final = "The file states their unit; correct the one or the other in a copy of the file."


def from_zero(source: EventSource) -> EventSource:
    """Return a source whose times begin near 0 if its own lie beyond a day, as those that count from 1970 do."""
    origin = origin_of(source.pieces())
    if origin.us < MAX_TIME_US:
        return source
    if origin.us > _YEAR_2100_US:
        begins = _in_each_unit(origin.us, source.unit)
        dates = [unit for unit, us in begins.items() if _YEAR_2000_US < us < _YEAR_2100_US]
        others = [unit for unit, us in begins.items() if us <= _YEAR_2000_US]
        raise _refused(
            f"Its times begin at {origin.us:.3g} us, after the year 2100", source.unit, dates + others
        )

    def moved() -> Iterator[Piece]:
        for events, edges in source.pieces():
            yield events._replace(t=events.t - origin.us), edges._replace(t=edges.t - origin.us)

    return replace(source, header={**source.header, **origin.header}, pieces=moved)


class UnitCheck:
    """Compares the times of a source with what cameras send, if it does not state their unit."""

    def __init__(self, source: EventSource) -> None:
        self._unit = source.unit
        self._pixels = source.width * source.height
        self._is_coarse, self._first_us, self._last_us, self._count = True, 0, 0, 0

    def add(self, t: NDArray[np.int64]) -> None:
        """Take the next times, us. Refuse (`NotARecording`) those that span more than a day."""
        if not len(t):
            return
        self._first_us = self._first_us if self._count else int(t[0])
        self._last_us, self._count = int(t[-1]), self._count + len(t)
        if self._unit is not None:
            self._is_coarse = self._is_coarse and not (t % _COARSE_US).any()
        if (span_us := self._last_us - self._first_us) > MAX_TIME_US:
            what = f"Its times span {span_us / MAX_TIME_US:.0f} days"
            raise _refused(what, self._unit, self._fitting(span_us))

    def end(self) -> None:
        """Refuse (`NotARecording`) times in another unit: all in whole ms, or at a rate that another unit explains."""
        unit, span_us = self._unit, self._last_us - self._first_us
        if unit is None or self._count < _LEAST_EVENTS or span_us < 0:
            return
        if not span_us:
            what = f"Its {self._count} events begin and end at one time: the times were rounded, such as to float32."
            raise NotARecording(what, remedy="Export them again, as whole numbers or float64.")
        fitting = self._fitting(span_us)
        is_coarse = not unit.is_given and self._is_coarse and span_us >= _LEAST_TIMES * _COARSE_US
        if not is_coarse and (unit.read_as in fitting or (unit.is_given and not fitting)):
            return
        what = f"Its times, read as {unit.read_as}, last {span_us / 1e6:.6g} s with"
        if is_coarse:
            what = f"{what} whole ms alone, and no camera counts so coarsely"
        elif unit.read_as not in _in_each_unit(span_us, unit):
            what = f"{what} parts of a {unit.read_as}, and no camera counts so finely"
        else:
            rate = f"{self._rate(span_us):.2g} events a second and pixel"
            what = f"{what} {rate}, and cameras send {_LEAST_RATE:g} to {_LARGEST_RATE:g}"
        if_right = f"If {unit.read_as} is right, name the column of times t_{unit.read_as}."
        raise _refused(what, unit, [other for other in fitting if other != unit.read_as], if_right)

    def _rate(self, span_us: float) -> float:
        return 1e6 * self._count / span_us / self._pixels

    def _fitting(self, span_us: int) -> list[TimeUnit]:
        """Return the units in which the events have a camera's rate for a day at most, the most usual rate first."""
        spans = _in_each_unit(span_us, self._unit)
        rates = {unit: self._rate(us) for unit, us in spans.items() if us <= MAX_TIME_US}
        fitting = [unit for unit, rate in rates.items() if _LEAST_RATE <= rate <= _LARGEST_RATE]
        usual = math.sqrt(_LEAST_RATE * _LARGEST_RATE)
        return sorted(fitting, key=lambda unit: abs(math.log(rates[unit] / usual)))


def _in_each_unit(us: float, unit: UnstatedUnit | None) -> Mapping[TimeUnit, float]:
    """Return a time, us, by the unit that the numbers of the file might have; none if the file states it."""
    if unit is None:
        return {}
    possible = (other for other in NS if NS[other] >= NS[unit.finest])
    return {other: us * NS[other] / NS[unit.read_as] for other in possible}


def _refused(
    what: str, unit: UnstatedUnit | None, offered: Sequence[TimeUnit], if_right: str = ""
) -> NotARecording:
    """Build the error of times that must be in one of the units offered, the likeliest first."""
    if unit is None:
        return NotARecording(f"{what}.", remedy=_CORRECT_TIMES)
    stated = f"--time-unit says {unit.read_as}" if unit.is_given else "The file does not state their unit"
    if not offered:
        what, ways = f"{what}; no other unit fits. {stated}.", "Look at them."
    else:
        what = f"{what}: they are probably in {offered[0]}. {stated}."
        ways = f"Say it: starbench convert --time-unit {', or '.join(offered)}."
    return NotARecording(what, remedy=f"{ways} {if_right}".strip())
