"""Messages that are to be delivered, kept so that none is lost and none is made twice. Does not use the network.

They lie in one SQLite file beside the signing key, synced at every change. Every message has a key; putting a message
in again changes nothing. A delivery is marked before and after it is tried. If the process dies in between, it is
unknown whether the message arrived. It is then tried again with the same key, which lets the receiver recognise it, and
is marked ``perhaps_twice``. A message that cannot be delivered is tried again without end, at growing intervals.
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
    """A message could not be delivered; its text is the reason that the receiver or the network gave."""


@dataclass(frozen=True)
class Message:
    """A message to people.

    Attributes
    ----------
    key
        Identifies the message permanently.
    occasion
        ``failure``, ``hold`` or ``end``.
    subject, text
        Subject and text.
    run, folder, utc
        The run or batch that it is about, its folder, and the time at which it was written (ISO 8601).
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
    """The delivery of one message to one channel.

    Attributes
    ----------
    message
        The message.
    channel
        The channel, as JSON that the outbox does not read.
    state
        ``waiting``, ``sending`` or ``sent``.
    tries
        Number of attempts.
    perhaps_twice
        Whether it may have arrived more than once.
    last_error
        Why the last attempt failed; empty if it did not.
    """

    message: Message
    channel: str
    state: str
    tries: int
    perhaps_twice: bool
    last_error: str


Send = Callable[[Message, str], None]
"""Delivers a message to a channel, or raises DeliveryFailed."""


class Outbox:
    """The outbox of a bench. Every method opens the file anew, because other processes use it too.

    Parameters
    ----------
    home
        The configuration folder, from `bench.base.home.home_folder`.
    """

    def __init__(self, home: Path) -> None:
        self._home = home
        self.path = home / OUTBOX

    def put(self, message: Message, channels: Sequence[str]) -> None:
        """Keep a message for its channels. It is on the disk when this returns; a key that is known changes nothing.

        Parameters
        ----------
        message
            The message.
        channels
            Its channels, from `bench.messaging.messages.channels_of`.

        Raises
        ------
        StorageError
            When it cannot be written.
        """
        fields = (message.occasion, message.subject, message.text, message.run, message.folder, message.utc)
        with self._open() as database:
            database.executemany(
                "INSERT OR IGNORE INTO deliveries VALUES (?, ?, ?, ?, ?, ?, ?, ?, 'waiting', 0, 0.0, 0, '')",
                [(message.key, channel, *fields) for channel in channels],
            )

    def deliveries(self) -> list[Delivery]:
        """List all deliveries, also those that were sent, oldest first.

        Returns
        -------
        list of Delivery
            Empty while there is no outbox.

        Raises
        ------
        StorageError
            When the outbox cannot be read.
        """
        if not self.path.exists():
            return []
        with self._open() as database:
            return [_delivery(row) for row in database.execute("SELECT * FROM deliveries ORDER BY utc, key")]

    def deliver(self, send: Send, now: datetime, *, all_waiting: bool = False) -> int:
        """Try the deliveries that are due, unless another process does so at this moment.

        Parameters
        ----------
        send
            Delivers one message; must have a time limit.
        now
            The present time, with its time zone.
        all_waiting
            Whether to try deliveries that are not due yet, too.

        Returns
        -------
        int
            Number of deliveries that still wait.

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
        """Yield whether this process alone may deliver during the block."""
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
                remedy="Check the disk. If another version of Starbench wrote the file, move it away.",
            ) from error


def _delivery(row: Sequence[Any]) -> Delivery:
    key, channel, occasion, subject, text, run, folder, utc, state, tries, _, twice, error = row
    message = Message(key, occasion, subject, text, run, folder, utc)
    return Delivery(message, channel, state, tries, bool(twice), error)
