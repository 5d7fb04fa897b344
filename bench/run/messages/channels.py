"""Delivers a message: mail by SMTP with the standard library, everything else by the optional library apprise."""

from __future__ import annotations

import importlib
import os
import smtplib
import ssl
from collections.abc import Mapping
from datetime import datetime
from email.message import EmailMessage
from email.utils import format_datetime
from pathlib import Path
from typing import Any

from bench.record.run_folder import PAGE_SIGNATURE, REPORT
from bench.run.messages.outbox import DeliveryFailed, Message
from bench.stations.messages_section import AppriseConfig, Channel, MailConfig

TIMEOUT_S = 10.0
"""Longest silence of a server, s."""
_LARGEST_PAGE_BYTES = 5_000_000
"""Larger pages are not attached to a mail: many servers refuse 10 MB, and base64 adds a third."""


def send(message: Message, channel: Channel, environ: Mapping[str, str] = os.environ) -> None:
    """Deliver a message to a channel. Raises DeliveryFailed with the reason."""
    if isinstance(channel, AppriseConfig):
        _notify(channel, message, environ)
        return
    try:
        _mail(channel, message, environ)
    except (OSError, smtplib.SMTPException, ValueError) as error:
        raise DeliveryFailed(f"{type(error).__name__}: {error}") from error


def _mail(mail: MailConfig, message: Message, environ: Mapping[str, str]) -> None:
    letter = EmailMessage()
    letter["From"], letter["To"], letter["Subject"] = mail.sender, ", ".join(mail.to), message.subject
    letter["Message-ID"] = f"<{message.key[:40]}@starbench>"  # RFC 5322: by it a reader recognises a repeat
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


def _notify(service: AppriseConfig, message: Message, environ: Mapping[str, str]) -> None:
    url = _secret(service.url_env, environ)
    try:
        apprise: Any = importlib.import_module("apprise")
    except ImportError as error:
        raise DeliveryFailed("apprise is not installed (pip install starbench[apprise])") from error
    try:
        notifier = apprise.Apprise()
        known = notifier.add(url)
        taken = known and notifier.notify(title=message.subject, body=message.text)
    except Exception as error:  # an error in a service's code must not delay other messages
        # without its text, which may contain the address
        raise DeliveryFailed(f"{type(error).__name__} in apprise") from error
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
