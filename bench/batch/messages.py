"""Messages about runs: kept so that none is lost and none is made twice, and sent by mail, webhook or apprise.

The outbox is one SQLite file beside the signing key, synced at every change. A delivery is marked before and after it
is tried: one in between, when the process died, is tried again with the same key and marked ``perhaps_twice``; others
without end, at growing intervals. A thread for each channel delivers, so that no server delays a run or another
channel. Mail carries the key in ``Message-ID`` (RFC 5322), a webhook in ``Idempotency-Key``: a receiver recognises a
repeat.
"""

from __future__ import annotations

import hashlib
import http.client
import importlib
import json
import os
import re
import smtplib
import sqlite3
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import wait
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from email.message import EmailMessage
from email.utils import format_datetime
from functools import partial
from pathlib import Path
from typing import Any

from bench.base.background import in_background
from bench.base.clock import BenchClock
from bench.base.errors import BenchError, StorageError
from bench.base.home import home_folder
from bench.record.run_folder import PAGE_SIGNATURE, REPORT
from bench.record.storage import make_folder, storage_errors
from bench.stations.messages_section import AppriseConfig, MailConfig, MessagesConfig, WebhookConfig
from drivers import file_lock

OUTBOX = "outbox.sqlite3"
VERSION = 2  # Of the tables
DEADLINE_S = 30.0
"""Longest duration of one delivery, s. Whether a message has arrived that took longer is unknown."""
FIRST_PAUSE_S = 5.0  # Doubled after each try
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
TIMEOUT_S = 10.0
"""Longest silence of a server, s."""
_LOOK_S = 5.0  # So late at most a message that waits is tried again
_LARGEST_PAGE_BYTES = 5_000_000
"""Larger pages are not attached to a mail: many servers refuse 10 MB, and base64 adds a third."""
_UNPRINTABLE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|[\x00-\x08\x0b-\x1f\x7f]")
"""Colours of a terminal, and control characters: an error of another package may have them."""
_MAIL, _WEBHOOK, _APPRISE = "mail", "webhook", "apprise"


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
        return [_delivery(row) for row in self._rows("SELECT * FROM deliveries ORDER BY utc, key")]

    def channels(self) -> list[str]:
        """List the channels, as `put` got them, that something waits for."""
        query = "SELECT DISTINCT channel FROM deliveries WHERE state != 'sent' ORDER BY channel"
        return [channel for (channel,) in self._rows(query)]

    def deliver(self, send: Send, now: datetime, *, all_waiting: bool = False) -> int:
        """Try the deliveries that are due, all channels side by side; each is given up after ``DEADLINE_S``."""
        serve = partial(self.deliver_to, send=send, now=now, all_waiting=all_waiting)
        served = [in_background(partial(serve, channel), "messages") for channel in self.channels()]
        wait(served)
        for delivery in served:
            delivery.result()
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
        return len(self._rows("SELECT key FROM deliveries WHERE state != 'sent'"))

    def _due(self, channel: str, now_s: float, *, all_waiting: bool) -> list[Delivery]:
        query = (
            "SELECT * FROM deliveries WHERE channel = ? AND state = 'waiting'"
            " AND (? OR next_try <= ? OR next_try > ?) ORDER BY utc, key"
        )
        # A time beyond the longest pause was noted before somebody set the system's time back.
        rows = self._rows(query, channel, all_waiting, now_s, now_s + LONGEST_PAUSE_S)
        return [_delivery(row) for row in rows]

    def _rows(self, query: str, *values: Any) -> list[Sequence[Any]]:
        """Return the rows of a query; none before the first message."""
        if not self.path.exists():
            return []
        with self._open() as database:
            return database.execute(query, values).fetchall()

    def _try(self, delivery: Delivery, send: Send, now: datetime) -> bool:
        """Try one delivery; return whether it ended in time, with or without success."""
        self._mark(delivery, state="sending", tries=delivery.tries + 1)
        pause = timedelta(seconds=min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(delivery.tries, 20)))
        later = {"state": "waiting", "next_try": (now + pause).timestamp()}
        sent = in_background(lambda: send(delivery.message, delivery.channel), "delivery")
        if not wait([sent], DEADLINE_S).done:
            why = f"not complete within {DEADLINE_S:g} s; the server is too slow or hangs"
            self._mark(delivery, **later, perhaps_twice=1, last_error=why)
            return False
        try:
            sent.result()
        except DeliveryFailed as error:
            self._mark(delivery, **later, last_error=str(error)[:500])
        else:
            self._mark(delivery, state="sent", last_error="")
        return True

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
                _make_tables(database)
                with database:
                    yield database
        except sqlite3.Error as error:
            raise StorageError(
                f"The outbox of messages cannot be used: {error}.",
                where=str(self.path),
                remedy="Check the disk. If another version of Starbench wrote the file, move it away.",
            ) from error


def _make_tables(database: sqlite3.Connection) -> None:
    """Make the tables, unless they are there; another process may do the same."""
    if database.execute("PRAGMA user_version").fetchone()[0] != VERSION:
        database.executescript(f"BEGIN IMMEDIATE; {_SCHEMA} COMMIT;")


def _delivery(row: Sequence[Any]) -> Delivery:
    key, channel, occasion, subject, text, run, folder, utc, state, tries, _, twice, error, *place = row
    message = Message(key, occasion, subject, text, run, folder, utc, *place)
    return Delivery(message, channel, state, tries, bool(twice), error)


def channels_of(messages: MessagesConfig) -> list[str]:
    """Return the channels of a station as the outbox keeps them: a JSON object each, without secrets."""
    mails = [{_MAIL: messages.mail.model_dump()}] if messages.mail is not None else []
    hooks = [{_WEBHOOK: hook.model_dump()} for hook in messages.webhooks]
    services = [{_APPRISE: service.model_dump()} for service in messages.apprise]
    return [json.dumps(channel, sort_keys=True) for channel in (*mails, *hooks, *services)]


def send(message: Message, channel: str, environ: Mapping[str, str] = os.environ) -> None:
    """Deliver a message to a channel of `channels_of`. Raises DeliveryFailed with the reason."""
    ((kind, config),) = json.loads(channel).items()
    try:
        if kind == _MAIL:
            _mail(MailConfig.model_validate(config), message, environ)
        elif kind == _APPRISE:
            _notify(AppriseConfig.model_validate(config), message, environ)
        else:
            _post(WebhookConfig.model_validate(config), message, environ)
    except (OSError, smtplib.SMTPException, http.client.HTTPException, ValueError) as error:
        raise DeliveryFailed(f"{type(error).__name__}: {error}") from error


def _mail(mail: MailConfig, message: Message, environ: Mapping[str, str]) -> None:
    letter = EmailMessage()
    letter["From"], letter["To"], letter["Subject"] = mail.sender, ", ".join(mail.to), message.subject
    letter["Message-ID"] = f"<{message.key[:40]}@starbench>"  # longer ones are folded
    letter["Date"] = format_datetime(datetime.fromisoformat(message.utc))
    letter["Auto-Submitted"] = "auto-generated"
    letter.set_content(message.text)
    if page := _page_of(Path(message.folder)):
        letter.add_attachment(page, maintype="text", subtype="html", filename=REPORT)
    context = ssl.create_default_context()
    if mail.security == "tls":
        server: smtplib.SMTP = smtplib.SMTP_SSL(mail.host, mail.port, timeout=TIMEOUT_S, context=context)
    else:
        server = smtplib.SMTP(mail.host, mail.port, timeout=TIMEOUT_S)
    with server:
        if mail.security == "starttls":
            server.starttls(context=context)
        if mail.user is not None and mail.password_env is not None:
            server.login(mail.user, _secret(mail.password_env, environ))
        refused = server.send_message(letter)
    if refused:
        raise DeliveryFailed(f"the server refused {', '.join(sorted(refused))}")


def _page_of(folder: Path) -> bytes:
    """Return the page of a run that ended early, which shows the refused recording; empty without one."""
    page = folder / REPORT
    if not (folder / PAGE_SIGNATURE).is_file() or page.stat().st_size > _LARGEST_PAGE_BYTES:
        return b""
    return page.read_bytes()


def _post(hook: WebhookConfig, message: Message, environ: Mapping[str, str]) -> None:
    url = hook.url or _secret(hook.url_env or "", environ)
    fields = asdict(message)
    body = json.dumps({"schema": "starbench/message/1", "id": fields.pop("key"), **fields}).encode()
    if not url.startswith(("http://", "https://")):
        raise DeliveryFailed(f"the environment variable {hook.url_env} is not an http or https address")
    request = urllib.request.Request(  # noqa: S310 - is http or https, see above
        url, body, {"Content-Type": "application/json", "Idempotency-Key": message.key}
    )
    opener = urllib.request.build_opener(_NoRedirect)
    with opener.open(request, timeout=TIMEOUT_S):  # raises unless 2xx
        pass


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirection: the method and the body of a message are never changed, and 3xx is not delivered."""

    def redirect_request(self, *_: object, **__: object) -> None:
        """Refuse; the answer then counts as a failed delivery."""


def _notify(service: AppriseConfig, message: Message, environ: Mapping[str, str]) -> None:
    try:
        apprise: Any = importlib.import_module("apprise")
    except ImportError as error:
        raise DeliveryFailed("apprise is not installed (pip install starbench[apprise])") from error
    url, notifier = _secret(service.url_env, environ), apprise.Apprise()
    try:
        known = notifier.add(url)
        taken = known and notifier.notify(title=message.subject, body=message.text)
    except Exception as error:  # an error in a service's code must not delay other messages
        raise DeliveryFailed(f"apprise: {type(error).__name__}: {error}") from error
    if not known:
        raise DeliveryFailed(
            f"the environment variable {service.url_env} is not an address that apprise supports"
        )
    if not taken:
        raise DeliveryFailed("the service did not accept it")


def _secret(variable: str, environ: Mapping[str, str]) -> str:
    if not environ.get(variable):
        raise DeliveryFailed(f"the environment variable {variable} is not set")
    return environ[variable]


def bench_courier(messages: MessagesConfig, clock: BenchClock, say: Callable[[str], None]) -> Courier:
    """Return the sender of a station's messages by the outbox of this bench."""
    return Courier(messages, Outbox(home_folder()), clock, say)


class Courier:
    """Writes the messages of one run, and delivers them in a thread; ``say`` shows one that could not be kept."""

    def __init__(
        self, messages: MessagesConfig, outbox: Outbox, clock: BenchClock, say: Callable[[str], None]
    ) -> None:
        self._occasions = set(messages.occasions)
        self._channels = channels_of(messages)
        self._outbox = outbox
        self._clock = clock
        self._say = say
        self._closing = threading.Event()
        self._wakes: dict[str, threading.Event] = {}
        self._threads: list[threading.Thread] = []
        if self._channels:
            self._serve([*self._channels, *self._waiting_channels()])

    def write(
        self,
        occasion: str,
        subject: str,
        text: str,
        *,
        run: str,
        folder: Path,
        key: str,
        place: tuple[int, str] | None = None,
    ) -> None:
        """Put a message into the outbox, at once, if the station asks for one at a ``failure``, ``hold`` or ``end``.

        ``key`` is the hash of the journal line that caused it; ``place`` number and hash of the run's line in the
        ledger, or None.
        """
        if not self.is_wanted(occasion):
            return
        utc = self._clock.utc_now().isoformat()
        number, head = place or (None, None)
        if place is not None:
            text = f"{text}\nLedger: run {number} of this bench, line {head}"
        subject, text = (_UNPRINTABLE.sub("", words) for words in (subject, text))
        subject = " ".join(subject.split())[:200]
        try:
            self._outbox.put(
                Message(key, occasion, subject, text, run, str(folder), utc, number, head), self._channels
            )
        except BenchError as error:
            self._say(f"A message could not be put into the outbox and is lost: {error}")
        self._wake_all()

    def is_wanted(self, occasion: str) -> bool:
        """Return whether the station wants messages on ``failure``, ``hold`` or ``end``, and names a channel."""
        return occasion in self._occasions and bool(self._channels)

    def close(self, patience_s: float = 2 * TIMEOUT_S) -> None:
        """Try once more, all channels together for ``patience_s`` at most, to deliver what waits; the rest stays."""
        self._closing.set()
        self._wake_all()
        deadline_s = time.monotonic() + patience_s
        for thread in self._threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))
        try:
            waiting = self._outbox.waiting() if self._threads else 0
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")
            return
        if waiting:
            self._say(f"Messages not delivered yet: {waiting}. See `starbench messages`.")

    def _waiting_channels(self) -> list[str]:
        """Return the channels of other stations that messages wait for."""
        try:
            return self._outbox.channels()
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")
            return []

    def _serve(self, channels: Iterable[str]) -> None:
        """Serve each channel in a thread of its own, so that one that hangs delays no other one."""
        for channel in dict.fromkeys(channels):
            self._wakes[channel] = threading.Event()
            thread = threading.Thread(target=self._deliver, args=(channel,), name="messages", daemon=True)
            self._threads.append(thread)
        for thread in self._threads:
            thread.start()

    def _wake_all(self) -> None:
        for wake in self._wakes.values():
            wake.set()

    def _deliver(self, channel: str) -> None:
        wake, closing = self._wakes[channel], False
        try:
            while not closing:
                wake.wait(_LOOK_S)
                wake.clear()
                closing = (
                    self._closing.is_set()
                )  # read before the last delivery, which then misses no message
                self._outbox.deliver_to(channel, send, self._clock.utc_now())
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")
