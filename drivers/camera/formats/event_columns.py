"""Columns of events by their names, and the unit of their times.

The unit may stand in a column's name (``timestamp_us``). Where the file does not state it, times with fractions are
taken for s, all others for us; `EventSource.assumed` says so. `UnitCheck` compares that, and a unit that the user
gives, with what cameras send.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import (
    Clock32,
    Events,
    EventSource,
    ReadingChoices,
    TimeUnit,
    Triggers,
    UnstatedUnit,
    as_events,
    empty_triggers,
    with_edges,
)
from drivers.camera.formats.time_units import NS, from_zero
from drivers.camera.raw_header import agreed_size
from drivers.errors import NotARecording, UnreadableEvents

_NAMES: Final = (
    ("t", "ts", "time", "timestamp", "timestamps"),
    ("x", "xs", "col", "column"),
    ("y", "ys", "row"),
    ("p", "ps", "pol", "polarity", "polarities", "on"),
)
"""Names of the columns t, x, y and p, in small letters."""
COLUMNS: Final = len(_NAMES)
_UNITS: Final[Mapping[str, TimeUnit]] = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "usecs", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), "ns"),
}
_UNIT_OF_NAME: Final = re.compile(r"(.*?)(?:_({0})|[ _]?[(\[]({0})[)\]])".format("|".join(_UNITS)))
_MICRO: Final = re.compile("[\u00b5\u03bc]")
"""The sign of a millionth, and the Greek letter."""
_WHOLE: Final = 0.01
"""Farther from a whole number lies no number that only the arithmetic of a program has moved."""
_US_NS: Final = 1000  # Nanoseconds of a microsecond

Parts = Sequence[NDArray[Any]]
"""Some rows: the columns t, x, y and p, or one table with names."""


def named(available: Iterable[str]) -> list[str | None]:
    """Return which of some names are those of t, x, y and p; None for each that is missing.

    Raises NotARecording if events have two columns that could be their times: they may differ by more than a unit.

    >>> named(["Timestamp_us", "x", "y", "polarity"])
    ['Timestamp_us', 'x', 'y', 'polarity']
    """
    small = {name: _split(name)[0] for name in available}
    found = [[name for known in names for name in small if small[name] == known] for names in _NAMES]
    if all(found) and len(times := found[0]) > 1:
        raise UnreadableEvents(
            f"the columns {times[0]} and {times[1]} could both hold the times of its events.",
            remedy="In a copy of the file, one column must hold the whole times; give the others another name.",
        )
    return [next(iter(names), None) for names in found]


def required(available: Iterable[str]) -> list[str]:
    """Return the names of t, x, y and p. Raises NotARecording if one is missing."""
    names = named(available)
    if None in names:
        raise UnreadableEvents(f"the table of events has no column {'txyp'[names.index(None)]}.")
    return [name for name in names if name is not None]


def unit_of_name(name: str) -> TimeUnit | None:
    """Return the unit that the name of a column of times states.

    >>> unit_of_name("timestamp_us"), unit_of_name("t [ns]"), unit_of_name("Time (seconds)"), unit_of_name("ts")
    ('us', 'ns', 's', None)
    """
    return _split(name)[1]


def _split(name: str) -> tuple[str, TimeUnit | None]:
    """Return a name in small letters, and the unit behind it."""
    small = _MICRO.sub("u", name.strip().lower())
    match = _UNIT_OF_NAME.fullmatch(small)
    return (match[1].rstrip(), _UNITS[match[2] or match[3]]) if match else (small, None)


def is_table(shape: Sequence[int], dtype: np.dtype[Any]) -> bool:
    """Return whether an array is a table of events, with named columns."""
    return len(shape) == 1 and dtype.names is not None and None not in named(dtype.names)


class ColumnReader:
    """Turns pieces of columns, or of one table, into events.

    >>> columns = [np.array([0.25, 0.5]), np.array([7, 7]), np.array([9, 9]), np.array([1, 0])]
    >>> reader = ColumnReader(columns, None)
    >>> reader.events(columns).t.tolist(), reader.assumed
    ([250000, 500000], {'time_unit': 's'})
    """

    def __init__(self, first: Parts, given: TimeUnit | None, stated: TimeUnit | None = None) -> None:
        """Decide the unit by the first rows; the user gives it, or the file states it."""
        self.assumed: dict[str, str] = {}
        if first and first[0].dtype.names is not None:
            stated = stated or unit_of_name(required(first[0].dtype.names)[0])
        if given and stated and given != stated:
            raise NotARecording(f"The file states its times in {stated}.", remedy="Leave out --time-unit.")
        times = _columns(first)[0] if first else np.empty(0)
        unit = given or stated
        if unit is None:
            unit = "s" if _has_fractions(times) else "us"
            self.assumed = {"time_unit": unit}
        self.unit = None if stated else UnstatedUnit(unit, is_given=given is not None, finest=_finest(times))
        self._ns = NS[unit]
        self._clock = Clock32()

    def events(self, parts: Parts) -> Events:
        """Return the events of the next rows. Raises NotARecording if they are none."""
        t, x, y, p = _columns(parts)
        return as_events(self._times(t), *map(_whole_of, (x, y, p)))

    def _times(self, t: NDArray[Any]) -> NDArray[Any]:
        """Return times in us, as whole numbers."""
        if t.dtype.kind == "f":
            if not np.isfinite(t).all():
                raise UnreadableEvents("some of its times are no numbers (NaN or infinite).")
            if self.assumed.get("time_unit") == "us":
                return _whole_of(t)
            return np.rint(t.astype(np.float64) * (self._ns / _US_NS)).astype(np.int64)
        if t.dtype == np.uint32:
            t = self._clock.continued(t)
        if self._ns == _US_NS or t.dtype.kind not in "iu":
            return t
        t = t.astype(np.int64)
        return t // _US_NS if self._ns < _US_NS else t * (self._ns // _US_NS)


def _columns(parts: Parts) -> list[NDArray[Any]]:
    """Return t, x, y and p of rows of a table, or of columns."""
    table = parts[0]
    if table.dtype.names is not None:
        return [table[name] for name in required(table.dtype.names)]
    return list(parts)


def _has_fractions(t: NDArray[Any], least: float = 0.0) -> bool:
    return t.dtype.kind == "f" and bool((np.abs(t - np.rint(t)) > least).any())


def _finest(times: NDArray[Any]) -> TimeUnit:
    """Return the finest unit that times can have: no camera counts parts of a ns."""
    return "us" if _has_fractions(times, _WHOLE) else "ns"


def _whole_of(values: NDArray[Any]) -> NDArray[Any]:
    """Return floating-point numbers as whole numbers; others as they are."""
    if values.dtype.kind != "f":
        return values
    cast = np.rint(values).astype(np.int64)
    if not np.array_equal(cast, values):
        raise UnreadableEvents("some of its columns, rows or polarities are no whole numbers.")
    return cast


@dataclass(frozen=True)
class Columns:
    """Columns of events, or a table, as a library reads them from a file."""

    parts: Callable[[], Iterator[Parts]]
    count: int | None = None
    # Sizes of the sensor by what states them, width and height, px
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    header: Mapping[str, str] = field(default_factory=dict)
    edges: Triggers = field(default_factory=lambda: empty_triggers(0))
    unit: TimeUnit | None = None  # As the file states it
    offset_us: int = 0  # To be added to all times

    def source(self, choices: ReadingChoices) -> EventSource:
        """Return the events; ``choices`` say what the file does not state."""
        size = agreed_size(self.sizes, choices.sensor_size, "")
        first = next(self.parts(), ())

        def reader() -> ColumnReader:
            return ColumnReader(first, choices.time_unit, self.unit)

        def events() -> Iterator[Events]:
            for part in map(reader().events, self.parts()):
                yield part._replace(t=part.t + self.offset_us) if self.offset_us else part

        opened = reader()
        return from_zero(
            EventSource(
                *size,
                self.header,
                lambda: with_edges(events(), self.edges._replace(t=self.edges.t + self.offset_us)),
                count=self.count,
                assumed=opened.assumed,
                unit=opened.unit,
            )
        )
