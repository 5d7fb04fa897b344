"""When a folder says that it was made: by the bench's own clock, as the sealed files state it. This proves nothing."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

from bench.base.bounded_json import parse_json
from bench.base.errors import StorageError
from bench.records.reading import read_json
from bench.records.run_folder import JOURNAL, RESULTS

_PLACES = (("certificate.json", ("issued_utc",)), (RESULTS, ("run", "calibrated_utc")))
_LAST_BYTES = 1 << 20
"""The last line of a journal is shorter than this."""


def stated_time(folder: Path) -> datetime | None:
    """Return when a folder says that it was made: the end of a run, the issue of a certificate, a recalculation.

    Returns: The moment, UTC; None if no file states one.
    Raises OSError: When a file cannot be read.
    """
    if (folder / JOURNAL).is_file():
        return _last_time(folder / JOURNAL)
    for name, keys in _PLACES:
        path = folder / name
        if path.is_file():
            try:
                found = read_json(path)
                for key in keys:
                    found = found[key]
            except (StorageError, ValueError, LookupError, TypeError):
                continue
            if moment := _moment(found):
                return moment
    return None


def _last_time(journal: Path) -> datetime | None:
    """Return the time of the last line of a journal. Its hash chain is checked elsewhere."""
    with journal.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - _LAST_BYTES))
        lines = stream.read().splitlines()
    try:
        return _moment(parse_json(lines[-1])["utc"])
    except (ValueError, LookupError, TypeError):
        return None


def _moment(text: object) -> datetime | None:
    try:
        moment = datetime.fromisoformat(str(text))
        return moment.astimezone(UTC) if moment.tzinfo is not None else None
    except (ValueError, OverflowError):
        return None
