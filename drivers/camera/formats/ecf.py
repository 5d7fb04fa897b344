"""Encode and decode ECF (Event Compression Format), the compression of events in Metavision's HDF5 files.

This module converts chunks of bytes to arrays and back; it opens no files. A chunk holds up to 65535 events,
little-endian throughout:

- uint32: number of events << 2 | style (2 = A, 1 = B, 0 = C);
- int64: time of the first event, us;
- times: bytes of step << 4 | count. A step of 15 makes the lower half four more bits of a larger step, lowest
  first, and is followed by more; a count of 15 is followed by the count as uint16;
- style A: rows, columns and polarities packed: y << 12 | x << 1 | p in 24 bits, four events in three uint32;
- styles B and C: rows as uint16 of y << 5 | count, a count of 31 followed by the count as uint16; then
- style B: x << 1 | p in 12 bits, four events in three uint16;
- style C: columns as uint16 of x << 5 | one bit each for x + 1 .. x + 5 (highest bit first), in rising order; then
  polarities as bytes of p << 7 | count, a count of 127 followed by the count as uint16.

Times cannot step back: an event that is earlier than its predecessor gets the predecessor's time.

Source: Prophesee, "HDF5 Event File Format", https://docs.prophesee.ai/stable/data/file_formats/hdf5.html; the layout of
a chunk is that of the maker's codec, https://github.com/prophesee-ai/hdf5_ecf.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events, empty_events

FILTER_ID: Final = 36559
"""Number of the compression filter in HDF5 (0x8ECF)."""

MAX_EVENTS: Final = 65535
"""Largest number of events in a chunk."""
MAX_ADDRESS: Final = 2047
"""Largest column and row, px."""

_HEAD_BYTES: Final = 12  # Count and style in 4, the first time in 8
_WORST_TIME_BYTES: Final = 19
"""Largest size of the time of an event: 16 bytes for a step of 64 bits, one for its end, and a count."""
_STYLE_A: Final = 2  # Two bits of the head say how the events are packed
_STYLE_B: Final = 1
_STYLE_C: Final = 0
_ROW_COUNT_BITS: Final = 5  # of 16
_POLARITY_COUNT_BITS: Final = 7  # of 8
_MOST_ROWS: Final = (1 << _ROW_COUNT_BITS) - 1
_MOST_POLARITIES: Final = (1 << _POLARITY_COUNT_BITS) - 1
_COUNTED: Final = 2048
"""Events of a chunk, in eight stretches, by which style C is tried or not; counting all would cost a quarter more."""
_STRETCHES: Final = 8  # Spread over the chunk, since scenes differ within it
_NEAR: Final = 1.2
"""A style that is estimated at so many times the bytes of another is not tried."""
_BAD: Final = -1  # What is returned for bytes that do not decode


def rising(t: NDArray[np.int64], least: int) -> NDArray[np.int64]:
    """Return times, (N,) us, of which none steps back or is below ``least``: the same array if that is so already."""
    if not len(t) or (t[0] >= least and (t[1:] >= t[:-1]).all()):
        return t
    return np.maximum(np.maximum.accumulate(t), least)


def encode(events: Events) -> bytes:
    """Compress a chunk of 1 to 65535 events, whose columns and rows have at most 11 bits; else raise `ValueError`."""
    n = len(events.t)
    if not 0 < n <= MAX_EVENTS:
        raise ValueError(f"a chunk holds 1 to {MAX_EVENTS} events, not {n}")
    if max(events.x.max(), events.y.max()) > MAX_ADDRESS:
        raise ValueError(f"a column or row above {MAX_ADDRESS}")
    t = rising(events.t, int(events.t[0]))
    times = np.empty(_WORST_TIME_BYTES * n, np.uint8)
    times = times[: _put_times(times, 0, t)]
    rows = np.empty(n + 2, np.uint16)
    row_end, row_runs = _put_rows(rows, events.y)
    fours = (n + 3) // 4
    by_rows = 2 * row_runs + 6 * fours
    least = min(12 * fours, by_rows)
    style = _STYLE_B if by_rows < 12 * fours else _STYLE_A
    if 2 * row_runs + _bytes_of_runs(events.x, events.p) < _NEAR * least:
        columns, polarities = np.empty(n, np.uint16), np.empty(n + 3, np.uint8)
        column_end, polarity_end, polarity_runs = _put_runs(columns, polarities, events.x, events.p)
        style = _STYLE_C if 2 * (row_runs + column_end) + polarity_runs <= least else style
    parts = [np.uint32(n << 2 | style).tobytes(), np.int64(t[0]).tobytes(), times.tobytes()]
    if style != _STYLE_A:
        parts.append(rows[:row_end].tobytes())
    if style == _STYLE_C:
        parts += [columns[:column_end].tobytes(), polarities[:polarity_end].tobytes()]
    elif style == _STYLE_B:
        parts.append(_packed_12(events.x, events.p).tobytes())
    else:
        parts.append(_packed_24(events.x, events.y, events.p).tobytes())
    return b"".join(parts)


def decode(chunk: bytes) -> Events:
    """Decompress a chunk; raise `ValueError` if it ends too early or its runs do not add up to its number of events."""
    if len(chunk) < _HEAD_BYTES:
        raise ValueError(f"a chunk of {len(chunk)} bytes is shorter than its header")
    info = int.from_bytes(chunk[:4], "little")
    n, style = info >> 2, info & 3
    if not 0 < n <= MAX_EVENTS:
        raise ValueError(f"a chunk states {n} events; 1 to {MAX_EVENTS} are possible")
    events = empty_events(n)
    data = np.frombuffer(chunk, np.uint8)
    at = _get_times(data, _HEAD_BYTES, int.from_bytes(chunk[4:12], "little", signed=True), events.t)
    if style & _STYLE_A:
        at = _get_packed(data, at, events.x, events.y, events.p, _STYLE_A)
    else:
        at = _get_runs(data, at, events.y, _ROW_COUNT_BITS)
        if style == _STYLE_B:
            at = _get_packed(data, at, events.x, events.y, events.p, _STYLE_B)
        else:
            at = _get_columns(data, at, events.x)
            at = _get_runs(data, at, events.p, _POLARITY_COUNT_BITS)
    if at < 0:
        raise ValueError(f"a chunk of {len(chunk)} bytes does not hold the {n} events that it states")
    return events


@njit(cache=True, nogil=True)
def _bytes_of_runs(x: Any, p: Any) -> float:
    """Estimate the bytes of columns and polarities in style C, by stretches of the events; all of them if few."""
    n = len(x)
    stretch = n if n <= _COUNTED else _COUNTED // _STRETCHES
    columns = polarities = seen = 0
    for begin in range(0, n, max(stretch, n // _STRETCHES)):
        end = min(n, begin + stretch)
        base = x[begin]
        columns += 1
        polarities += 1
        seen += end - begin
        for i in range(begin + 1, end):
            polarities += p[i] != p[i - 1]
            if not (x[i] > x[i - 1] and x[i] <= base + 5):
                columns += 1
                base = x[i]
    return (2 * columns + polarities) * (n / seen)


@njit(cache=True, nogil=True)
def _put_16(out: Any, at: int, value: int) -> int:
    out[at] = value & 0xFF
    out[at + 1] = value >> 8
    return at + 2


@njit(cache=True, nogil=True)
def _run_length(values: Any, i: int) -> int:
    """Return how many values from index i on are equal."""
    end = i + 1
    while end < len(values) and values[end] == values[i]:
        end += 1
    return end - i


@njit(cache=True, nogil=True)
def _put_times(out: Any, at: int, t: Any) -> int:
    now = t[0]
    i = 0
    while i < len(t):
        step = t[i] - now
        if step >= 15:
            while step > 0:
                out[at] = 0xF0 | (step & 0xF)
                step >>= 4
                at += 1
        now = t[i]
        count = _run_length(t, i)
        out[at] = step << 4 | min(count, 15)
        at += 1
        if count >= 15:
            at = _put_16(out, at, count)
        i += count
    return at


@njit(cache=True, nogil=True)
def _put_rows(rows: Any, y: Any) -> Any:
    """Write the runs of rows; return where they end, and their number.

    Without branches, which at every event would cost more than all the rest: each event writes the unit of its run
    anew, and the true count behind it, over which the next run writes if that count is not needed.
    """
    at: Any = 0
    runs: Any = 1
    count: Any = 0
    row = np.int64(y[0])
    for i in range(len(y)):
        here = np.int64(y[i])
        new = np.int64(here != row)
        at += new * (1 + np.int64(count >= _MOST_ROWS))
        count = count * (1 - new) + 1
        runs += new
        row = here
        rows[at] = row << _ROW_COUNT_BITS | min(count, _MOST_ROWS)
        rows[at + 1] = count
    return at + 1 + np.int64(count >= _MOST_ROWS), runs


@njit(cache=True, nogil=True)
def _put_runs(columns: Any, polarities: Any, x: Any, p: Any) -> Any:
    """Write the runs of columns and of polarities, as `_put_rows`; return both ends, and the runs of polarities."""
    column_at: Any = 0
    at: Any = 0
    count: Any = 0
    runs: Any = 1
    base, last, polarity = np.int64(x[0]), np.int64(x[0]) - 1, np.int64(p[0])
    mask = np.int64(0)
    for i in range(len(x)):
        here = np.int64(x[i])
        new = np.int64((here <= last) | (here > base + 5))
        base += new * (here - base)
        # The first of a run has the bit 5, which is cut off: it is the base itself.
        mask = mask * (1 - new) | 1 << (5 - (here - base))
        column_at += new
        last = here
        columns[column_at] = base << 5 | mask & 0x1F

        here = np.int64(p[i])
        new = np.int64(here != polarity)
        at += new * (1 + 2 * np.int64(count >= _MOST_POLARITIES))
        count = count * (1 - new) + 1
        runs += new
        polarity = here
        polarities[at] = polarity << _POLARITY_COUNT_BITS | min(count, _MOST_POLARITIES)
        polarities[at + 1] = count & 0xFF
        polarities[at + 2] = count >> 8
    return column_at + 1, at + 1 + 2 * np.int64(count >= _MOST_POLARITIES), runs


@njit(cache=True, nogil=True)
def _packed_12(x: Any, p: Any) -> Any:
    """Return style B: four values of 12 bits in three units of 16; each holds the rest of one value and of the next."""
    fours, whole = (len(x) + 3) // 4, len(x) // 4
    units = np.empty(3 * fours, np.uint16)
    end = np.zeros(4, np.int64)
    for k in range(len(x) - 4 * whole):
        end[k] = np.int64(x[4 * whole + k]) << 1 | p[4 * whole + k]
    for four in range(fours):
        i = 4 * four
        if four < whole:
            a, b = np.int64(x[i]) << 1 | p[i], np.int64(x[i + 1]) << 1 | p[i + 1]
            c, d = np.int64(x[i + 2]) << 1 | p[i + 2], np.int64(x[i + 3]) << 1 | p[i + 3]
        else:
            a, b, c, d = end
        units[3 * four] = a << 4 | b & 0xF
        units[3 * four + 1] = b >> 4 << 8 | c & 0xFF
        units[3 * four + 2] = c >> 8 << 12 | d & 0xFFF
    return units


@njit(cache=True, nogil=True)
def _packed_24(x: Any, y: Any, p: Any) -> Any:
    """Return style A: the same with values of 24 bits, which have the row, in units of 32."""
    units = np.empty(3 * ((len(x) + 3) // 4), np.uint32)
    value = np.zeros(4, np.int64)
    for first in range(0, len(x), 4):
        value[:] = 0
        for k in range(min(4, len(x) - first)):
            value[k] = np.int64(y[first + k]) << 12 | np.int64(x[first + k]) << 1 | p[first + k]
        at = 3 * (first // 4)
        units[at] = value[0] << 8 | value[1] & 0xFF
        units[at + 1] = value[1] >> 8 << 16 | value[2] & 0xFFFF
        units[at + 2] = value[2] >> 16 << 24 | value[3] & 0xFFFFFF
    return units


@njit(cache=True, nogil=True)
def _get(data: Any, at: int, size: int) -> int:
    """Read a little-endian number of some bytes. The caller has checked that they exist."""
    value: Any = 0
    for k in range(size):
        value |= np.int64(data[at + k]) << (8 * k)
    return value


@njit(cache=True, nogil=True)
def _get_times(data: Any, at: int, first: int, t: Any) -> int:
    now: Any = first
    step: Any = 0
    count: Any
    i = shift = 0
    while i < len(t):
        if at + 3 > len(data) and (at >= len(data) or data[at] & 0xF == 15):
            return _BAD
        high = data[at] >> 4
        count = np.int64(data[at] & 0xF)
        at += 1
        if high == 15:
            if shift > 60:
                return _BAD
            step |= count << shift
            shift += 4
            continue
        now += step + high
        step = shift = 0
        if count == 15:
            count = _get(data, at, 2)
            at += 2
        if count == 0 or i + count > len(t):
            return _BAD
        t[i : i + count] = now
        i += count
    return at


@njit(cache=True, nogil=True)
def _get_runs(data: Any, at: int, values: Any, count_bits: int) -> int:
    """Read runs of equal values: value << count_bits | count; the largest count is followed by the true one."""
    most = (1 << count_bits) - 1
    unit_bytes = 2 if count_bits == _ROW_COUNT_BITS else 1
    i = 0
    while at >= 0 and i < len(values):
        if at + unit_bytes > len(data):
            return _BAD
        unit = _get(data, at, unit_bytes)
        at += unit_bytes
        count = unit & most
        if count == most:
            if at + 2 > len(data):
                return _BAD
            count = _get(data, at, 2)
            at += 2
        if count == 0 or i + count > len(values):
            return _BAD
        values[i : i + count] = unit >> count_bits
        i += count
    return at


@njit(cache=True, nogil=True)
def _get_columns(data: Any, at: int, x: Any) -> int:
    i = 0
    while at >= 0 and i < len(x):
        if at + 2 > len(data):
            return _BAD
        value = _get(data, at, 2)
        at += 2
        x[i] = value >> 5
        i += 1
        for k in range(1, 6):
            if value >> (5 - k) & 1:
                if i == len(x):
                    return _BAD
                x[i] = (value >> 5) + k
                i += 1
    return at


@njit(cache=True, nogil=True)
def _get_packed(data: Any, at: int, x: Any, y: Any, p: Any, style: int) -> int:
    unit_bytes = 4 if style == _STYLE_A else 2
    part = 2 * unit_bytes
    word = np.zeros(5, np.int64)
    for first in range(0, len(x), 4):
        if at < 0 or at + 3 * unit_bytes > len(data):
            return _BAD
        for k in range(3):
            word[k + 1] = _get(data, at, unit_bytes)
            at += unit_bytes
        for k in range(min(4, len(x) - first)):
            low = part * k
            value = word[k] & ((1 << low) - 1) | word[k + 1] >> (part * (k + 1)) << low
            p[first + k] = value & 1
            x[first + k] = (value >> 1) & MAX_ADDRESS
            if style == _STYLE_A:
                y[first + k] = (value >> 12) & MAX_ADDRESS
    return at
