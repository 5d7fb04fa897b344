"""The token that a browser needs for the pages, and how many wrong tokens an address may send.

Every process of this computer can ask the pages, whoever runs it, so they need a secret. Unless a person
gives one, each start makes one, and the printed address holds it. A person's token comes from an
environment variable, never from an option: every user of the computer can read the options of a running process.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from bench.base.errors import UsageError

TOKEN_VARIABLE = "STARBENCH_PAGE_TOKEN"  # noqa: S105 - the name of a variable
LEAST_LENGTH = 12  # Characters; wrong ones are limited too
MADE_BYTES = 16  # 128 bit
NAME_BYTES = 8  # 64 bits in the name of a host: no page of another site can guess where the cookie goes
_MOST_WRONG, _WRONG_WINDOW_S = 10, 60.0  # A person mistypes less often; guessing stays hopeless
_MOST_ADDRESSES = 1000  # A scan from many addresses must not fill the memory


@dataclass(frozen=True)
class PageToken:
    """The token of the pages."""

    text: str
    made: bool = False  # Whether it was made for this start; the printed address then holds it


def page_token(*, none: bool = False, environ: Mapping[str, str] = os.environ) -> PageToken | None:
    """Return the token of the pages, made now if nobody gives one; None if they need none."""
    if none:
        return None
    token = environ.get(TOKEN_VARIABLE, "").strip()
    if not token:
        return PageToken(secrets.token_urlsafe(MADE_BYTES), made=True)
    if len(token) < LEAST_LENGTH or not token.isprintable():
        raise UsageError(
            f"The token must have at least {LEAST_LENGTH} printable characters.",
            where=TOKEN_VARIABLE,
            remedy="To make one: openssl rand -hex 16",
        )
    return PageToken(token)


def require_token(host: str, token: PageToken | None) -> None:
    """Check that pages for other computers have a token."""
    if token is None and not is_loopback(host):
        raise UsageError(
            "Pages that other computers can open need a token.",
            where=f"--host {host}",
            remedy="Leave out --no-token. To serve this computer only, leave out --host.",
        )


def is_loopback(host: str) -> bool:
    """Return whether a name or an address means this computer only: ``localhost``, 127.0.0.0/8 or ::1.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    address = address_of(host)
    return host.rstrip(".").lower() == "localhost" or (address is not None and address.is_loopback)


def address_of(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return the address that a text is; None for a name."""
    with suppress(ValueError):
        return ipaddress.ip_address(host)
    return None


class WrongTokens:
    """Counts the wrong tokens of each address, so that guessing is slow and no address shuts out another."""

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._wrong_s: dict[str, deque[float]] = {}

    def refuse(self, address: str) -> bool:
        """Return whether an address has sent too many wrong tokens in the last minute."""
        wrong_s = self._wrong_s.get(address, deque())
        return len(wrong_s) == _MOST_WRONG and self._monotonic() - wrong_s[0] < _WRONG_WINDOW_S

    def add(self, address: str) -> None:
        """Note a wrong token; of very many addresses the first ones are forgotten."""
        self._wrong_s.setdefault(address, deque(maxlen=_MOST_WRONG)).append(self._monotonic())
        if len(self._wrong_s) > _MOST_ADDRESSES:
            del self._wrong_s[next(iter(self._wrong_s))]
