"""Sends messages about runs by mail, webhook or apprise.

A message goes to the outbox first; a thread for each channel delivers it, so that no server delays a run or another
channel. Mail carries the key in ``Message-ID`` (RFC 5322), a webhook in ``Idempotency-Key``: a receiver recognises a
repeat.
"""

from __future__ import annotations

import http.client
import importlib
import json
import os
import re
import smtplib
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from datetime import datetime
from email.message import EmailMessage
from email.utils import format_datetime
from pathlib import Path
from typing import Any

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.messaging.outbox import DeliveryFailed, Message, Outbox
from bench.stations.station_fields import AppriseConfig, MailConfig, MessagesConfig, WebhookConfig

TIMEOUT_S = 10.0
"""Longest silence of a server, s."""
_LOOK_S = 5.0
_UNPRINTABLE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|[\x00-\x08\x0b-\x1f\x7f]")
"""Colours of a terminal, and control characters: an error of another package may have them."""
_MAIL, _WEBHOOK, _APPRISE = "mail", "webhook", "apprise"


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


class Courier:
    """Writes and delivers one run's messages, in a thread; ``say`` shows one that could not be kept."""

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
