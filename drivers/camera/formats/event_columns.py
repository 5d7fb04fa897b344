"""Columns of events as programs write them: by names, or as a table of four columns in one of three orders.

The unit of times may stand in a column's name (``timestamp_us``). What a file does not state is assumed: times with
fractions are in s, all others in us. `EventSource.assumed` says so, and `UnitCheck` refuses what no camera sends: times
in ns or ms that were read so.
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
    as_events,
    empty_triggers,
    from_zero,
    with_edges,
)
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
    **dict.fromkeys(("ms", "msec", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanosec", "nanoseconds"), "ns"),
}
_UNIT_OF_NAME: Final = re.compile(r"(.*?)(?:_({0})|[ _]?[(\[]({0})[)\]])".format("|".join(_UNITS)))
_MICRO: Final = re.compile("[\u00b5\u03bc]")
"""The sign of a millionth, and the Greek letter."""
_OF_WHOLE: Final = (0, 1, 2, 3)
_OF_FRACTIONS: Final = (2, 0, 1, 3)
_ORDERS: Final = (_OF_WHOLE, _OF_FRACTIONS, (3, 0, 1, 2))
"""Places of t, x, y and p in the tables of known programs."""
_NS: Final[Mapping[TimeUnit, int]] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
_US_NS: Final = 1000  # Nanoseconds of a microsecond
_MOST_STEP_US: Final = 1.0
"""Steps of the clock of a camera. Those of seconds in 32 bits are larger from 16 s on."""
_COARSE_US: Final = 1000  # A millisecond
_LEAST_TIMES: Final = 8
"""So many different times that are all whole thousands of us are no chance: 1e-24 with a clock of 1 us."""
_LEAST_RATE: Final = 0.005
"""Events a second and pixel: a twentieth of the background of a sensor at rest (0.1, Nozaki and Delbruck 2017)."""
_LARGEST_RATE: Final = 200.0
"""Three times that of the busiest known recordings (69: boxes_translation of the Event Camera Dataset)."""
_LEAST_EVENTS: Final = 100
"""Fewer events say nothing about their rate."""


Parts = Sequence[NDArray[Any]]
"""Some rows: the columns t, x, y and p, or one table."""


def named(available: Iterable[str]) -> list[str | None]:
    """Return which of some names are those of t, x, y and p; None for each that is missing.

    >>> named(["Timestamp_us", "x", "y", "polarity"])
    ['Timestamp_us', 'x', 'y', 'polarity']
    """
    small = {_split(name)[0]: name for name in reversed(list(available))}
    return [next((small[name] for name in names if name in small), None) for names in _NAMES]


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
    """Return whether an array is a table of events: with named columns, or with four."""
    if dtype.names is not None:
        return len(shape) == 1 and None not in named(dtype.names)
    return len(shape) == 2 and shape[1] == COLUMNS and dtype.kind in "iuf"


class ColumnReader:
    """Turns pieces of columns, or of one table, into events.

    >>> table = np.array([[7, 9, 0.25, 1], [7, 9, 0.5, 0]])
    >>> reader = ColumnReader([table], None)
    >>> reader.events([table]).t.tolist(), reader.assumed
    ([250000, 500000], {'time_unit': 's', 'columns': 'x, y, t, p'})
    """

    def __init__(self, first: Parts, given: TimeUnit | None, stated: TimeUnit | None = None) -> None:
        """Decide order and unit by the first rows; the user gives a unit, or the file states it."""
        self.assumed: dict[str, str] = {}
        self._order = _order(first[0]) if first and first[0].ndim > 1 else None
        if self._order is not None:
            self.assumed["columns"] = ", ".join("txyp"[self._order.index(k)] for k in range(COLUMNS))
        if first and first[0].dtype.names is not None:
            stated = stated or unit_of_name(required(first[0].dtype.names)[0])
        if given and stated and given != stated:
            raise NotARecording(f"The file states its times in {stated}.", remedy="Leave out --time-unit.")
        times = self._columns(first)[0] if first else np.empty(0)
        has_fractions = _has_fractions(times)
        unit = given or stated
        if unit is None:
            unit = "s" if has_fractions else "us"
            self.assumed = {"time_unit": unit, **self.assumed}
        self._ns = _NS[unit]
        if (step_us := _step_of(times) * self._ns / _US_NS) > _MOST_STEP_US:
            self.assumed["time_step_us"] = f"{step_us:.3g}"
        self._clock = Clock32()

    def events(self, parts: Parts) -> Events:
        """Return the events of the next rows. Raises NotARecording if they are none."""
        t, x, y, p = self._columns(parts)
        return as_events(self._times(t), *map(_whole_of, (x, y, _signed(p))))

    def _columns(self, parts: Parts) -> list[NDArray[Any]]:
        """Return t, x, y and p of rows of a table, or of columns."""
        table = parts[0]
        if table.dtype.names is not None:
            return [table[name] for name in required(table.dtype.names)]
        if self._order is not None:
            return [np.ascontiguousarray(table[:, k]) for k in self._order]
        return list(parts)

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


def _order(table: NDArray[Any]) -> Sequence[int]:
    """Return the places of t, x, y and p in a table: where times rise, and polarities are; else as usual for its type.

    Raises NotARecording if no column can be that of polarities.
    """
    usual = _OF_WHOLE if table.dtype.kind in "iu" else _OF_FRACTIONS
    fitting = [order for order in (usual, *_ORDERS) if np.isin(_signed(table[:, order[3]]), (-1, 0, 1)).all()]
    if not fitting:
        raise UnreadableEvents("no column of its table holds polarities, which are -1, 0 or 1.")
    rising = [order for order in fitting if _rises(table[:, order[0]])]
    return (rising or fitting)[0]


def _signed(p: NDArray[Any]) -> NDArray[Any]:
    """Return polarities of which -1 may have been written as the largest unsigned number; 255 may as well mean ON."""
    return p.astype(f"i{p.itemsize}") if p.dtype.kind == "u" and p.itemsize > 1 else p


def _rises(column: NDArray[Any]) -> bool:
    return not (column[1:] < column[:-1]).any() and bool((column[-1:] > column[:1]).all())


def _step_of(times: NDArray[Any]) -> float:
    """Return the distance of neighbouring numbers of the type of times, at the largest of them."""
    return float(np.spacing(np.abs(times).max())) if times.dtype.kind == "f" and len(times) else 0.0


def _has_fractions(t: NDArray[Any]) -> bool:
    return t.dtype.kind == "f" and not np.array_equal(t, np.rint(t))


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

    def source(self, choices: ReadingChoices) -> EventSource:
        """Return the events; ``choices`` say what the file does not state."""
        size = agreed_size(self.sizes, choices.sensor_size, "")
        first = next(self.parts(), ())

        def reader() -> ColumnReader:
            return ColumnReader(first, choices.time_unit, self.unit)

        def events() -> Iterator[Events]:
            return map(reader().events, self.parts())

        return from_zero(
            EventSource(
                *size,
                self.header,
                lambda: with_edges(events(), self.edges),
                count=self.count,
                assumed=reader().assumed,
            )
        )


class UnitCheck:
    """Compares the times of a source whose unit is assumed with what cameras send."""

    def __init__(self, source: EventSource) -> None:
        self._unit = source.assumed.get("time_unit")
        self._pixels = source.width * source.height
        self._is_coarse, self._first_us, self._last_us, self._count = True, 0, 0, 0

    def add(self, t: NDArray[np.int64]) -> None:
        """Take the next times, us."""
        if self._unit is None or not len(t):
            return
        self._first_us = self._first_us if self._count else int(t[0])
        self._last_us, self._count = int(t[-1]), self._count + len(t)
        self._is_coarse = self._is_coarse and not (t % _COARSE_US).any()

    def end(self) -> None:
        """Refuse (`NotARecording`) times that are in another unit: all in whole ms, or at an impossible rate."""
        span_us = self._last_us - self._first_us
        if self._unit is None or self._count < _LEAST_EVENTS or span_us <= 0:
            return
        rate = 1e6 * self._count / span_us / self._pixels
        likely = "ms" if self._unit == "s" or rate > _LARGEST_RATE else "ns"
        read = f"Its times, read as {self._unit},"
        if self._is_coarse and span_us >= _LEAST_TIMES * _COARSE_US:
            what = f"{read} are all whole ms, and no camera counts so coarsely"
        elif rate < _LEAST_RATE or (rate > _LARGEST_RATE and self._unit == "us"):
            bound = f"less than {_LEAST_RATE:g}" if rate < _LEAST_RATE else f"more than {_LARGEST_RATE:g}"
            what = f"{read} last {span_us / 1e6:.6g} s with {rate:.2g} events a second and pixel, {bound}"
        else:
            return
        raise NotARecording(
            f"{what}: they are probably in {likely}. The file does not state their unit.",
            remedy=f"Say it: starbench convert --time-unit {likely}, or us, ms, s or ns.",
        )
