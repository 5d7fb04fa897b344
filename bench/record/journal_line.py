r"""One line of a journal: a JSON object that is chained to the line before by its hash.

A line is ``{"seq", "utc", "mono_s", "event", ..., "prev", "hash"}`` in this order, in ASCII without
spaces. The data of the event stand between ``event`` and ``prev``. ``hash`` is the SHA-256 of the line
without its ``hash``, so that no canonical form of JSON is needed and a shell can check it::

    sed 's/,"hash":"[0-9a-f]*"}$/}/' | head -n 1 | tr -d '\n' | sha256sum

``prev`` is the hash of the line before; in the first line it is 64 zeros.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar, cast

from bench.base.bounded_json import parse_json

FIRST_PREV = "0" * 64
Form = TypeVar("Form")
OWN_KEYS = ("seq", "utc", "mono_s", "event", "prev", "hash")
"""Keys of a line that the data of an event must not use."""
_own_values = itemgetter(*OWN_KEYS)


# Made several times as fast as a frozen dataclass: lists of runs read a million lines
class Entry(NamedTuple):
    """One line of a journal."""

    seq: int  # Number of the line, from 0
    utc: str  # System time, ISO 8601 with microseconds and ``Z``
    mono_s: float  # Monotonic clock of the process that wrote it, s; comparable within one process only
    event: str
    data: Mapping[str, Any]
    prev: str  # SHA-256 of the line before
    hash: str  # SHA-256 of this line

    def of(self, _form: type[Form]) -> Form:
        """Return the data with the type that its event has (`bench.record.events`); they are not checked."""
        return cast("Form", self.data)


def encode_line(
    seq: int, now: datetime, mono_s: float, event: str, data: Mapping[str, Any], prev: str
) -> bytes:
    """Write line ``seq``, from 0, after a line with the hash ``prev``; `ValueError` if data use an own key."""
    clash = sorted(set(data) & set(OWN_KEYS))
    if clash:
        raise ValueError(f"event {event!r} uses the journal's own keys {clash}")
    utc = now.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
    head = {"seq": seq, "utc": utc, "mono_s": round(mono_s, 6), "event": event}
    try:
        text = json.dumps(
            {**head, **data, "prev": prev}, separators=(",", ":"), allow_nan=False, default=_plain
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"event {event!r} cannot be written as JSON: {error}") from error
    own_hash = hashlib.sha256(text.encode()).hexdigest()
    return f'{text[:-1]},"hash":"{own_hash}"}}'.encode()


def _plain(value: Any) -> Any:
    """Convert a NumPy value, a path or a date to something that JSON can represent."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, datetime):
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} is not JSON")


def decode_line(line: bytes, seq: int, prev: str) -> Entry:
    """Read a line, and check its hash, its chain and its number; `ValueError` states the fault."""
    try:
        record = parse_json(line.decode("ascii"))
        number, utc, mono_s, event, before, own_hash = _own_values(record)
        for key in OWN_KEYS:
            del record[key]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError("this line is not an entry") from error
    tail = f',"hash":"{own_hash}"}}'.encode()
    if not line.endswith(tail) or hashlib.sha256(line[: -len(tail)] + b"}").hexdigest() != own_hash:
        raise ValueError("this line does not match its hash")
    if not (isinstance(utc, str) and isinstance(event, str)):
        raise ValueError("this line is not an entry")  # noqa: TRY004 - a fault of the file, not of an argument
    if before != prev:
        raise ValueError("this line is not chained to the one before it")
    if number != seq:
        raise ValueError(f"this is line {number} in place of line {seq} (counted from 0)")
    return Entry(number, utc, mono_s, event, record, before, own_hash)
