"""Messages that still have to go out, kept so that none is lost and none is made twice; knows no network.

One SQLite file beside the signing key, synced at every change. A message has a key of its own: putting it in
again changes nothing. A delivery is marked before it is tried and after it went through; where the process dies in
between, nobody can tell whether it arrived: it is then tried again with the same key, by which the receiver can tell,
and is marked as ``perhaps twice``. A message that does not go through is tried again, ever more seldom, for ever.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.base.errors import StorageError
from bench.records.storage import make_folder, storage_errors
from drivers import file_lock

OUTBOX = "outbox.sqlite3"
LOCK = "outbox.lock"
VERSION = 1
FIRST_PAUSE_S = 5.0
LONGEST_PAUSE_S = 3600.0
_SCHEMA = f"""
CREATE TABLE IF NOT EXISTS deliveries (
    key TEXT, channel TEXT, occasion TEXT, subject TEXT, text TEXT, run TEXT, folder TEXT, utc TEXT,
    state TEXT, tries INTEGER, next_try REAL, perhaps_twice INTEGER, last_error TEXT,
    PRIMARY KEY (key, channel)
);
PRAGMA user_version = {VERSION};
"""


class DeliveryFailed(Exception):
    """A message did not go through; what the other side, or the network, said."""


@dataclass(frozen=True)
class Message:
    """What somebody should hear.

    Attributes
    ----------
    key
        Stands for this message for ever.
    occasion
        ``failure``, ``hold`` or ``end``.
    subject, text
        For people.
    run, folder, utc
        Which run it is about, and when it was written.
    """

    key: str
    occasion: str
    subject: str
    text: str
    run: str
    folder: str
    utc: str


@dataclass(frozen=True)
class Delivery:
    """One message to one channel.

    Attributes
    ----------
    message
        What.
    channel
        To whom, as JSON; the outbox does not look into it.
    state
        ``waiting``, ``sending`` or ``sent``.
    tries
        How often it was tried.
    perhaps_twice
        Whether it may have arrived more than once.
    last_error
        Why it did not go through when it was tried last.
    """

    message: Message
    channel: str
    state: str
    tries: int
    perhaps_twice: bool
    last_error: str


Send = Callable[[Message, str], None]
"""Hands a message to a channel, or raises DeliveryFailed."""


class Outbox:
    """The outbox of a bench; every method opens it anew, for other processes use it too.

    Parameters
    ----------
    home
        The configuration folder, as ``home_folder`` gives it.
    """

    def __init__(self, home: Path) -> None:
        self._home = home
        self.path = home / OUTBOX

    def put(self, message: Message, channels: Sequence[str]) -> None:
        """Keep a message for its channels; when this returns, it lasts. Nothing is changed for one that is known.

        Raises
        ------
        StorageError
            When it cannot be kept.
        """
        said = (message.occasion, message.subject, message.text, message.run, message.folder, message.utc)
        with self._open() as database:
            database.executemany(
                "INSERT OR IGNORE INTO deliveries VALUES (?, ?, ?, ?, ?, ?, ?, ?, 'waiting', 0, 0.0, 0, '')",
                [(message.key, channel, *said) for channel in channels],
            )

    def deliveries(self) -> list[Delivery]:
        """List all there are, sent ones too, oldest first. Raises StorageError."""
        if not self.path.exists():
            return []
        with self._open() as database:
            return [_delivery(row) for row in database.execute("SELECT * FROM deliveries ORDER BY utc, key")]

    def deliver(self, send: Send, now: datetime, *, all_waiting: bool = False) -> int:
        """Try what is due, unless another process is at it.

        Parameters
        ----------
        send
            Hands a message over; must not take long.
        now
            The present time.
        all_waiting
            Try also what is not due yet.

        Returns
        -------
        int
            How many are still waiting.

        Raises
        ------
        StorageError
            When the outbox cannot be read or written.
        """
        if not self.path.exists():
            return 0
        with self._alone() as alone:
            if alone:
                with self._open() as database:
                    database.execute(
                        "UPDATE deliveries SET state = 'waiting', perhaps_twice = 1 WHERE state = 'sending'"
                    )
                for delivery in self._due(now.timestamp(), all_waiting=all_waiting):
                    self._try(delivery, send, now)
        with self._open() as database:
            count: int = database.execute("SELECT count(*) FROM deliveries WHERE state != 'sent'").fetchone()[
                0
            ]
        return count

    def _due(self, now_s: float, *, all_waiting: bool) -> list[Delivery]:
        with self._open() as database:
            rows = database.execute(
                "SELECT * FROM deliveries WHERE state = 'waiting' AND (? OR next_try <= ?) ORDER BY utc, key",
                (all_waiting, now_s),
            )
            return [_delivery(row) for row in rows]

    def _try(self, delivery: Delivery, send: Send, now: datetime) -> None:
        self._mark(delivery, state="sending", tries=delivery.tries + 1)
        try:
            send(delivery.message, delivery.channel)
        except DeliveryFailed as error:
            pause = timedelta(seconds=min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(delivery.tries, 20)))
            self._mark(
                delivery, state="waiting", next_try=(now + pause).timestamp(), last_error=str(error)[:500]
            )
        else:
            self._mark(delivery, state="sent", last_error="")

    def _mark(self, delivery: Delivery, **facts: Any) -> None:
        names = ", ".join(f"{name} = ?" for name in facts)
        with self._open() as database:
            database.execute(
                f"UPDATE deliveries SET {names} WHERE key = ? AND channel = ?",  # noqa: S608 - names are our own
                (*facts.values(), delivery.message.key, delivery.channel),
            )

    @contextmanager
    def _alone(self) -> Iterator[bool]:
        """Whether this process alone delivers, for as long as the block lasts."""
        with storage_errors(self.path):
            lock = os.open(self._home / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
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
                if database.execute("PRAGMA user_version").fetchone()[0] != VERSION:
                    database.executescript(f"BEGIN IMMEDIATE; {_SCHEMA} COMMIT;")
                with database:
                    yield database
        except sqlite3.Error as error:
            raise StorageError(
                f"The outbox of messages cannot be used: {error}.",
                where=str(self.path),
                remedy="Check the disk; a file that another version wrote can be moved away.",
            ) from error


def _delivery(row: Sequence[Any]) -> Delivery:
    key, channel, occasion, subject, text, run, folder, utc, state, tries, _, twice, error = row
    message = Message(key, occasion, subject, text, run, folder, utc)
    return Delivery(message, channel, state, tries, bool(twice), error)
