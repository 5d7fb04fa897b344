r"""The journal of a run: one JSON object a line, synced and chained to the one before.

A line is ``{"seq", "utc", "mono_s", "event", ..., "prev", "hash"}`` in this order, ASCII, without spaces;
what an event carries stands between ``event`` and ``prev``. ``hash`` is the SHA-256 of the line as it
stands without its hash, so that no canonical form has to be agreed upon and a shell can check it::

    sed 's/,"hash":"[0-9a-f]*"}$/}/' | head -n 1 | tr -d '\n' | sha256sum

``prev`` is the hash of the line before, 64 zeros in the first. A line is written once the thing it tells
has happened and lasts; what is not in the journal has not happened. Lines that only tell of the way there
(``append_unsynced``) are synced with the next one that counts. The journal knows nothing of what events mean.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from bench.base.errors import JournalBroken, RunFolderError, StorageError
from bench.records.storage import O_BINARY, storage_errors, sync_folder, write_all

FIRST_PREV = "0" * 64
CLOCK_JUMP_S = 2.0
"""The system's time may differ this much from the monotonic clock before it is called a jump."""
CLOCK_JUMPED = "clock_jumped"
_BLOCK_BYTES = 512
_MOST_UNSYNCED_BYTES = 64 * 1024
"""Zeros further from the end than that are no cut of power: lines are synced far more often."""

_OWN_KEYS = ("seq", "utc", "mono_s", "event", "prev", "hash")


@dataclass(frozen=True)
class Entry:
    """One line of a journal.

    Attributes
    ----------
    seq
        Number of the line, from 0.
    utc
        System time, ISO 8601 with microseconds and ``Z``.
    mono_s
        Monotonic clock of the process that wrote it, s; comparable within one process only.
    event
        What happened, as a short name.
    data
        What the event carries, as JSON gives it back.
    prev, hash
        Hash of the line before, and of this one.
    """

    seq: int
    utc: str
    mono_s: float
    event: str
    data: Mapping[str, Any]
    prev: str
    hash: str


class Journal:
    """A journal open for appending; made by ``create`` or ``open``. Safe to use from several threads."""

    def __init__(
        self,
        path: Path,
        entries: list[Entry],
        torn: bytes,
        *,
        utc_now: Callable[[], datetime],
        monotonic: Callable[[], float],
    ) -> None:
        self.path = path
        self.torn = torn
        """Bytes of a half-written last line that ``open`` dropped; empty when there was none."""
        self._entries = entries
        self._utc_now = utc_now
        self._monotonic = monotonic
        self._clock_offset_s: float | None = None
        self._lock = threading.RLock()
        with storage_errors(path):
            self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | O_BINARY)

    @classmethod
    def create(cls, path: Path, *, utc_now: Callable[[], datetime], monotonic: Callable[[], float]) -> Self:
        """Begin a journal.

        Parameters
        ----------
        path
            The new file.
        utc_now
            Gives the system's time, aware of its zone.
        monotonic
            Gives a clock that is never set, s.

        Raises
        ------
        RunFolderError
            When the file exists.
        StorageError
            When it cannot be made.
        """
        with storage_errors(path):
            try:
                os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | O_BINARY, 0o644))
            except FileExistsError:
                raise RunFolderError(
                    "A journal exists already.", where=str(path), remedy="Resume that run."
                ) from None
            sync_folder(path.parent)
        return cls(path, [], b"", utc_now=utc_now, monotonic=monotonic)

    @classmethod
    def open(cls, path: Path, *, utc_now: Callable[[], datetime], monotonic: Callable[[], float]) -> Self:
        """Go on with a journal: verify its chain and drop a half-written last line (see ``torn``).

        Raises
        ------
        JournalBroken
            When a whole line does not hold; the message names it. Nothing is changed then.
        StorageError
            When the file cannot be read or written.
        """
        entries, torn = read_journal(path)
        if torn:
            with storage_errors(path):
                os.truncate(path, path.stat().st_size - len(torn))
        return cls(path, entries, torn, utc_now=utc_now, monotonic=monotonic)

    @property
    def entries(self) -> Sequence[Entry]:
        """All lines so far, first to last."""
        return tuple(self._entries)

    @property
    def head(self) -> str:
        """Hash of the last line: it stands for the whole journal. 64 zeros when there is none."""
        return self._entries[-1].hash if self._entries else FIRST_PREV

    def append(self, event: str, **data: Any) -> Entry:
        """Write one line and sync it; when this returns, it lasts.

        Where the system's time has moved against the monotonic clock by more than ``CLOCK_JUMP_S``
        since the last line, a line ``clock_jumped`` with ``jump_s`` stands before it.

        Parameters
        ----------
        event
            What happened.
        **data
            What JSON can hold; NumPy scalars and arrays, paths and dates too. Numbers must be finite.

        Raises
        ------
        ValueError
            When ``data`` cannot be written as JSON, or uses a key of the journal's own.
        StorageError
            When the disk did not take it. The line is then not there; after a failed sync the journal
            takes no more lines, for nobody can say what the disk holds.
        """
        return self._put(event, data, synced=True)

    def append_unsynced(self, event: str, **data: Any) -> Entry:
        """Write one line that need not last before the next one appended does: both are synced together then.

        A process that dies loses nothing of it; a cut of power may take the lines noted last. As ``append`` otherwise.
        """
        return self._put(event, data, synced=False)

    def close(self) -> None:
        """Close the file; further lines are refused."""
        with self._lock:
            if self._descriptor >= 0:
                os.close(self._descriptor)
                self._descriptor = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _clock_jump_s(self, now: datetime, mono_s: float) -> float:
        """How far the system's time moved against the monotonic clock since the last line, s."""
        offset_s = now.timestamp() - mono_s
        if self._clock_offset_s is None:  # first line of this process: time can only be seen to run back
            last = datetime.fromisoformat(self._entries[-1].utc) if self._entries else now
            jump_s = min(0.0, (now - last).total_seconds())
        else:
            jump_s = offset_s - self._clock_offset_s
        self._clock_offset_s = offset_s
        return jump_s

    def _put(self, event: str, data: Mapping[str, Any], *, synced: bool) -> Entry:
        with self._lock:
            now, mono_s = self._utc_now(), self._monotonic()
            jump_s = self._clock_jump_s(now, mono_s)
            if abs(jump_s) > CLOCK_JUMP_S:
                self._append(now, mono_s, CLOCK_JUMPED, {"jump_s": round(jump_s, 3)}, synced=synced)
            return self._append(now, mono_s, event, data, synced=synced)

    def _append(
        self, now: datetime, mono_s: float, event: str, data: Mapping[str, Any], *, synced: bool
    ) -> Entry:
        if self._descriptor < 0:
            raise StorageError(
                "The journal is closed, or a write to it failed.",
                where=str(self.path),
                remedy="Check the disk, then go on with `starbench resume`.",
            )
        line = _line(len(self._entries), now, mono_s, event, data, self.head)
        entry = _read_line(line, len(self._entries), self.head)
        try:
            self._write(line + b"\n", synced=synced)
            self._entries.append(entry)
        except StorageError:
            raise
        except BaseException:  # stopped in the midst of a line: what follows would not be chained to it
            self.close()
            raise
        return entry

    def _write(self, data: bytes, *, synced: bool) -> None:
        with storage_errors(self.path):
            size = os.fstat(self._descriptor).st_size
            try:
                write_all(self._descriptor, data)
            except OSError:
                self._take_back(size)
                raise
            if synced:
                self._sync()

    def _take_back(self, size: int) -> None:
        """Cut off what was written of a line; where that fails, the journal takes no more, and it stays the last."""
        try:
            os.ftruncate(self._descriptor, size)
        except OSError:
            self.close()

    def _sync(self) -> None:
        """Make all lines so far last. Raises OSError; the journal then takes no more."""
        try:
            os.fsync(self._descriptor)
        except OSError:
            self.close()
            raise


def lines_after(path: Path, offset: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Look at the whole lines after so many bytes of a journal, unverified: for whoever waits for one of them.

    Parameters
    ----------
    path
        The journal.
    offset
        Its size at some moment, bytes; it may lie within a line, which is passed over then.

    Yields
    ------
    event, data
        As an ``Entry`` has them.

    Raises
    ------
    StorageError
        When the file cannot be read.
    """
    with storage_errors(path), path.open("rb") as stream:
        stream.seek(offset)
        for line in stream:
            try:
                record = json.loads(line) if line.endswith(b"\n") else None
            except ValueError:  # the rest of a line
                continue
            if isinstance(record, dict):
                yield str(record.get("event")), {k: v for k, v in record.items() if k not in _OWN_KEYS}


def read_journal(path: Path) -> tuple[list[Entry], bytes]:
    """Read and verify a journal without changing it.

    Returns
    -------
    entries
        Every whole line.
    torn
        What a cut of power left at the end: a line without its line feed, or, from the first zero byte on, blocks that
        the file system had made room for and had not written, with what had come to the disk behind them. Lines that
        were synced are never among it. Empty if none.

    Raises
    ------
    JournalBroken
        When a whole line is not JSON, out of order, changed, or not chained to the one before.
    StorageError
        When the file cannot be read.
    """
    entries: list[Entry] = []
    begin = 0
    with storage_errors(path), path.open("rb") as stream:
        for line in stream:
            if not line.endswith(b"\n"):
                return entries, line
            prev = entries[-1].hash if entries else FIRST_PREV
            try:
                entries.append(_read_line(line[:-1], len(entries), prev))
            except ValueError as error:
                rest = line + stream.read(_MOST_UNSYNCED_BYTES)
                if _was_cut_off(rest, begin):
                    return entries, rest
                raise JournalBroken(
                    f"The journal does not hold: {error}.",
                    where=f"{path}:{len(entries) + 1}",
                    remedy="It was changed after it was written; restore it from a copy.",
                ) from error
            begin += len(line)
    return entries, b""


def _was_cut_off(rest: bytes, begin: int) -> bool:
    """Whether the end of a journal, from a bad line on, lacks blocks that were never written: zeros of their extent.

    They begin where lines had been synced, or with a block, and end with a block or the file.
    """
    first = rest.find(b"\0")
    if first < 0 or len(rest) >= _MOST_UNSYNCED_BYTES:
        return False
    last = len(rest) - len(rest[first:].lstrip(b"\0"))
    from_block = first == 0 or (begin + first) % _BLOCK_BYTES == 0
    return from_block and (last == len(rest) or (begin + last) % _BLOCK_BYTES == 0)


def _line(seq: int, now: datetime, mono_s: float, event: str, data: Mapping[str, Any], prev: str) -> bytes:
    clash = sorted(set(data) & set(_OWN_KEYS))
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
    """Give what JSON can hold in place of a NumPy value, a path or a date."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, datetime):
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} is not JSON")


def _read_line(line: bytes, seq: int, prev: str) -> Entry:
    """Check a line against its place and its own hash. Raises ValueError saying what is wrong."""
    try:
        record = json.loads(line.decode("ascii"))
        own = {key: record.pop(key) for key in _OWN_KEYS}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError("this line is not an entry") from error
    tail = f',"hash":"{own["hash"]}"}}'.encode()
    if not line.endswith(tail) or hashlib.sha256(line[: -len(tail)] + b"}").hexdigest() != own["hash"]:
        raise ValueError("this line differs from its hash")
    if not (isinstance(own["utc"], str) and isinstance(own["event"], str)):
        raise ValueError("this line is not an entry")  # noqa: TRY004 - of a file, not of an argument
    if own["prev"] != prev:
        raise ValueError("this line is not chained to the one before it")
    if own["seq"] != seq:
        raise ValueError(f"entry {own['seq']} stands where entry {seq} should")
    return Entry(data=record, **own)
