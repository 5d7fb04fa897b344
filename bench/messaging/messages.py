"""Sends messages about runs: writes them, hands them to mail, webhooks or apprise, off the path of the run.

What is to be sent is put into the outbox first, and goes out from there by a thread; a dead network holds up no run.
Both channels carry the message's key (``Message-ID``, ``Idempotency-Key``), by which receivers know one they have had.
"""

from __future__ import annotations

import http.client
import importlib
import json
import os
import smtplib
import ssl
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import asdict
from datetime import datetime
from email.message import EmailMessage
from email.utils import format_datetime
from pathlib import Path
from typing import Any

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.messaging.outbox import DeliveryFailed, Message, Outbox
from bench.stations.station_messages import AppriseConfig, MailConfig, MessagesConfig, WebhookConfig

TIMEOUT_S = 10.0
"""How long a server may be silent."""
_LOOK_S = 5.0
_MAIL, _WEBHOOK, _APPRISE = "mail", "webhook", "apprise"


def channels_of(messages: MessagesConfig) -> list[str]:
    """Give the channels of a station as the outbox keeps them: JSON, without secrets."""
    mails = [{_MAIL: messages.mail.model_dump()}] if messages.mail is not None else []
    hooks = [{_WEBHOOK: hook.model_dump()} for hook in messages.webhooks]
    services = [{_APPRISE: service.model_dump()} for service in messages.apprise]
    return [json.dumps(channel, sort_keys=True) for channel in (*mails, *hooks, *services)]


def send(message: Message, channel: str, environ: Mapping[str, str] = os.environ) -> None:
    """Hand a message to a channel as ``channels_of`` gave it.

    Raises
    ------
    DeliveryFailed
        When it did not go through, and why.
    """
    ((kind, words),) = json.loads(channel).items()
    try:
        if kind == _MAIL:
            _mail(MailConfig.model_validate(words), message, environ)
        elif kind == _APPRISE:
            _notify(AppriseConfig.model_validate(words), message, environ)
        else:
            _post(WebhookConfig.model_validate(words), message, environ)
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
        raise DeliveryFailed(f"refused by the server for {', '.join(sorted(refused))}")


def _post(hook: WebhookConfig, message: Message, environ: Mapping[str, str]) -> None:
    url = hook.url or _secret(hook.url_env or "", environ)
    told = asdict(message)
    body = json.dumps({"schema": "starbench/message/1", "id": told.pop("key"), **told}).encode()
    if not url.startswith(("http://", "https://")):
        raise DeliveryFailed(f"{hook.url_env} holds no http or https address")
    request = urllib.request.Request(  # noqa: S310 - seen to be http or https
        url, body, {"Content-Type": "application/json", "Idempotency-Key": message.key}
    )
    with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310 - as above; raises unless 2xx
        pass


def _notify(service: AppriseConfig, message: Message, environ: Mapping[str, str]) -> None:
    try:
        apprise: Any = importlib.import_module("apprise")
    except ImportError as error:
        raise DeliveryFailed("apprise is not installed (pip install starbench[apprise])") from error
    url, notifier = _secret(service.url_env, environ), apprise.Apprise()
    try:
        known = notifier.add(url)
        taken = known and notifier.notify(title=message.subject, body=message.text)
    except Exception as error:  # whatever a service's own code raises must not hold up other messages
        raise DeliveryFailed(f"apprise: {type(error).__name__}: {error}") from error
    if not known:
        raise DeliveryFailed(f"{service.url_env} holds no address that apprise knows")
    if not taken:
        raise DeliveryFailed("the service did not take it")


def _secret(variable: str, environ: Mapping[str, str]) -> str:
    if not environ.get(variable):
        raise DeliveryFailed(f"the environment variable {variable} is not set")
    return environ[variable]


class Courier:
    """Writes messages about one run, and sees to their delivery by a thread of its own.

    Parameters
    ----------
    messages
        What the station file says.
    outbox
        Where messages wait.
    clock
        Tells the time.
    say
        Told what could not even be kept; a run is not ended for that.
    """

    def __init__(
        self, messages: MessagesConfig, outbox: Outbox, clock: BenchClock, say: Callable[[str], None]
    ) -> None:
        self._occasions = set(messages.occasions)
        self._channels = channels_of(messages)
        self._outbox = outbox
        self._clock = clock
        self._say = say
        self._closing, self._wake = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._deliver, name="messages", daemon=True)
        if self._channels:
            self._thread.start()

    def write(self, occasion: str, subject: str, text: str, *, run: str, folder: Path, key: str) -> None:
        """Put a message into the outbox, if the station file asks for messages on this occasion. Returns at once.

        Parameters
        ----------
        occasion
            ``failure``, ``hold`` or ``end``.
        subject, text
            What the message says.
        run
            Name of the run or batch.
        folder
            Its folder.
        key
            Identifies this message for ever: the hash of the journal's line that gave occasion to it.
        """
        if not self.is_wanted(occasion):
            return
        utc = self._clock.utc_now().isoformat()
        try:
            self._outbox.put(
                Message(key, occasion, " ".join(subject.split())[:200], text, run, str(folder), utc),
                self._channels,
            )
        except BenchError as error:
            self._say(f"A message could not be kept: {error}")
        self._wake.set()

    def is_wanted(self, occasion: str) -> bool:
        """Return whether the station file asks for messages on this occasion, and names a channel.

        Parameters
        ----------
        occasion
            ``failure``, ``hold`` or ``end``.

        Returns
        -------
        bool
            True where a message is to be written.
        """
        return occasion in self._occasions and bool(self._channels)

    def close(self, patience_s: float = 2 * TIMEOUT_S) -> None:
        """Try once more what is waiting, for no longer than that; what does not go through stays in the outbox."""
        self._closing.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(patience_s)

    def _deliver(self) -> None:
        try:
            closing, waiting = False, 0
            while not closing:
                self._wake.wait(_LOOK_S)
                self._wake.clear()
                closing = self._closing.is_set()  # seen before the last try, which then misses nothing
                waiting = self._outbox.deliver(send, self._clock.utc_now())
            if waiting:
                self._say(f"{waiting} messages did not go out yet; see `starbench messages`.")
        except BenchError as error:
            self._say(f"Messages do not go out: {error}")
