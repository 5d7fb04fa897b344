"""Messages that are to be delivered, kept so that none is lost and none is made twice. Does not use the network.

One SQLite file beside the signing key, synced at every change. A delivery is marked before and after it is tried: one
in between, when the process died, is tried again with the same key and marked ``perhaps_twice``; others without end, at
growing intervals. Each channel is served by itself, each delivery within a deadline.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.base.errors import StorageError
from bench.records.storage import make_folder, storage_errors
from drivers import file_lock

OUTBOX = "outbox.sqlite3"
VERSION = 2
DEADLINE_S = 30.0
"""Longest duration of one delivery, s. Whether a message has arrived that took longer is unknown."""
FIRST_PAUSE_S = 5.0
LONGEST_PAUSE_S = 3600.0
_SCHEMA = f"""
CREATE TABLE IF NOT EXISTS deliveries (
    key TEXT, channel TEXT, occasion TEXT, subject TEXT, text TEXT, run TEXT, folder TEXT, utc TEXT,
    state TEXT, tries INTEGER, next_try REAL, perhaps_twice INTEGER, last_error TEXT,
    ledger_number INTEGER, ledger_head TEXT,
    PRIMARY KEY (key, channel)
);
PRAGMA user_version = {VERSION};
"""
_FROM_1 = f"""
ALTER TABLE deliveries ADD COLUMN ledger_number INTEGER;
ALTER TABLE deliveries ADD COLUMN ledger_head TEXT;
PRAGMA user_version = {VERSION};
"""


class DeliveryFailed(Exception):
    """A message could not be delivered; its text is the reason that the receiver or the network gave."""


@dataclass(frozen=True)
class Message:
    """A message to people."""

    key: str
    occasion: str  # ``failure``, ``hold`` or ``end``
    subject: str
    text: str
    # run, folder, utc: The run or batch that it is about, its folder, and the time at which it was written
    # (ISO 8601).
    run: str
    folder: str
    utc: str
    # ledger_number, ledger_head: Number of the run in the bench's ledger and hash of its line; of a batch,
    # those of the newest run. None before the run is entered.
    ledger_number: int | None = None
    ledger_head: str | None = None


@dataclass(frozen=True)
class Delivery:
    """The delivery of one message to one channel."""

    message: Message
    channel: str  # The channel, as JSON that the outbox does not read
    state: str  # ``waiting``, ``sending`` or ``sent``
    tries: int
    perhaps_twice: bool  # Whether it may have arrived more than once
    last_error: str  # Why the last attempt failed; empty if it did not


Send = Callable[[Message, str], None]
"""Delivers a message to a channel, or raises DeliveryFailed."""


class Outbox:
    """The outbox of a bench. Every method opens the file anew, because other processes use it too."""

    def __init__(self, home: Path) -> None:
        self._home = home
        self.path = home / OUTBOX

    def put(self, message: Message, channels: Sequence[str]) -> None:
        """Keep a message for its channels. It is on the disk when this returns; a key that is known changes nothing."""
        fields = (message.occasion, message.subject, message.text, message.run, message.folder, message.utc)
        place = (message.ledger_number, message.ledger_head)
        with self._open() as database:
            database.executemany(
                "INSERT OR IGNORE INTO deliveries VALUES (?, ?, ?, ?, ?, ?, ?, ?, 'waiting', 0, 0.0, 0, '', ?, ?)",
                [(message.key, channel, *fields, *place) for channel in channels],
            )

    def deliveries(self) -> list[Delivery]:
        """List all deliveries, also those that were sent, oldest first."""
        if not self.path.exists():
            return []
        with self._open() as database:
            return [_delivery(row) for row in database.execute("SELECT * FROM deliveries ORDER BY utc, key")]

    def channels(self) -> list[str]:
        """List the channels, as `put` got them, that something waits for."""
        if not self.path.exists():
            return []
        with self._open() as database:
            rows = database.execute(
                "SELECT DISTINCT channel FROM deliveries WHERE state != 'sent' ORDER BY channel"
            )
            return [channel for (channel,) in rows]

    def deliver(self, send: Send, now: datetime, *, all_waiting: bool = False) -> int:
        """Try the deliveries that are due, all channels side by side; each is given up after ``DEADLINE_S``."""

        def serve(channel: str) -> None:
            self.deliver_to(channel, send, now, all_waiting=all_waiting)

        _side_by_side(serve, self.channels())
        return self.waiting()

    def deliver_to(self, channel: str, send: Send, now: datetime, *, all_waiting: bool = False) -> None:
        """Try a channel's due deliveries, unless another process does; after a late one the others wait."""
        if not self.path.exists():
            return
        with self._alone(channel) as alone:
            if not alone:
                return
            with self._open() as database:
                database.execute(
                    "UPDATE deliveries SET state = 'waiting', perhaps_twice = 1"
                    " WHERE state = 'sending' AND channel = ?",
                    (channel,),
                )
            for delivery in self._due(channel, now.timestamp(), all_waiting=all_waiting):
                if not self._try(delivery, send, now):
                    return

    def waiting(self) -> int:
        """Count the deliveries that still wait."""
        if not self.path.exists():
            return 0
        with self._open() as database:
            row = database.execute("SELECT count(*) FROM deliveries WHERE state != 'sent'").fetchone()
        return int(row[0])

    def _due(self, channel: str, now_s: float, *, all_waiting: bool) -> list[Delivery]:
        with self._open() as database:
            rows = database.execute(
                "SELECT * FROM deliveries WHERE channel = ? AND state = 'waiting' AND (? OR next_try <= ?)"
                " ORDER BY utc, key",
                (channel, all_waiting, now_s),
            )
            return [_delivery(row) for row in rows]

    def _try(self, delivery: Delivery, send: Send, now: datetime) -> bool:
        """Try one delivery; return whether it ended in time, with or without success."""
        self._mark(delivery, state="sending", tries=delivery.tries + 1)
        pause = timedelta(seconds=min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(delivery.tries, 20)))
        later = {"state": "waiting", "next_try": (now + pause).timestamp()}
        try:
            in_time = _in_time(lambda: send(delivery.message, delivery.channel), DEADLINE_S)
        except DeliveryFailed as error:
            self._mark(delivery, **later, last_error=str(error)[:500])
            return True
        if in_time:
            self._mark(delivery, state="sent", last_error="")
        else:
            why = f"not complete within {DEADLINE_S:g} s; the server is too slow or hangs"
            self._mark(delivery, **later, perhaps_twice=1, last_error=why)
        return in_time

    def _mark(self, delivery: Delivery, **facts: Any) -> None:
        names = ", ".join(f"{name} = ?" for name in facts)
        with self._open() as database:
            database.execute(
                f"UPDATE deliveries SET {names} WHERE key = ? AND channel = ?",  # noqa: S608 - names are our own
                (*facts.values(), delivery.message.key, delivery.channel),
            )

    @contextmanager
    def _alone(self, channel: str) -> Iterator[bool]:
        """Yield whether this process alone may deliver to a channel during the block."""
        name = f"outbox-{hashlib.sha256(channel.encode()).hexdigest()[:12]}.lock"
        with storage_errors(self.path):
            lock = os.open(self._home / name, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                file_lock.lock(lock)
            except BlockingIOError:
                yield False
                return
            yield True
        finally:
            os.close(lock)

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        make_folder(self._home)
        try:
            with closing(sqlite3.connect(self.path, timeout=10.0)) as database:
                database.execute("PRAGMA journal_mode = WAL")
                database.execute("PRAGMA synchronous = FULL")
                _bring_up_to_date(database)
                with database:
                    yield database
        except sqlite3.Error as error:
            raise StorageError(
                f"The outbox of messages cannot be used: {error}.",
                where=str(self.path),
                remedy="Check the disk. If another version of Starbench wrote the file, move it away.",
            ) from error


def _bring_up_to_date(database: sqlite3.Connection) -> None:
    """Make the tables, or add what an earlier version did not have."""
    found = database.execute("PRAGMA user_version").fetchone()[0]
    if found == VERSION:
        return
    database.execute("BEGIN IMMEDIATE")  # another process may do the same
    found = database.execute("PRAGMA user_version").fetchone()[0]
    statements = "" if found == VERSION else _FROM_1 if found == 1 else _SCHEMA
    for statement in filter(None, map(str.strip, statements.split(";"))):
        database.execute(statement)
    database.commit()


def _side_by_side(work: Callable[[str], None], names: Iterable[str]) -> None:
    """Do work for each name in a thread of its own, and wait for all; an error is raised again afterwards."""
    failed: list[BaseException] = []

    def thread(name: str) -> None:
        try:
            work(name)
        except BaseException as error:  # noqa: BLE001 - raised again below, in the caller's thread
            failed.append(error)

    threads = [threading.Thread(target=thread, args=(name,), name="messages", daemon=True) for name in names]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    if failed:
        raise failed[0]


def _in_time(work: Callable[[], None], deadline_s: float) -> bool:
    """Do work in a thread, left alone if late; return whether it ended in time. Its error is raised again."""
    done = threading.Event()
    failed: list[BaseException] = []

    def thread() -> None:
        try:
            work()
        except BaseException as error:  # noqa: BLE001 - raised again below, in the caller's thread
            failed.append(error)
        done.set()

    threading.Thread(target=thread, name="delivery", daemon=True).start()
    if not done.wait(deadline_s):
        return False
    if failed:
        raise failed[0]
    return True


def _delivery(row: Sequence[Any]) -> Delivery:
    key, channel, occasion, subject, text, run, folder, utc, state, tries, _, twice, error, *place = row
    message = Message(key, occasion, subject, text, run, folder, utc, *place)
    return Delivery(message, channel, state, tries, bool(twice), error)
