"""The token of the pages: a secret that a person enters once in the browser.

It comes from an environment variable or a file, never from an option: every user of the computer can read the options
of a running process. Without a token the pages are served to this computer only.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import os
import stat
from collections.abc import Mapping
from pathlib import Path

from bench.base.errors import UsageError

TOKEN_VARIABLE = "STARBENCH_PAGE_TOKEN"  # noqa: S105 - the name of a variable
LEAST_LENGTH = 12
_MOST_BYTES = 4096


def page_token(token_file: Path | None, environ: Mapping[str, str] = os.environ) -> str | None:
    """Return the token of the pages.

    token_file: File that holds the token; None if the environment variable counts.
    Returns: The token; None if there is none.
    Raises UsageError: If the file cannot be read, if others may read it, or if the token is too short.
    """
    if token_file is None:
        where, token = TOKEN_VARIABLE, environ.get(TOKEN_VARIABLE, "").strip()
        if not token:
            return None
    else:
        where, token = str(token_file), _read(token_file)
    if len(token) < LEAST_LENGTH or not token.isprintable():
        raise UsageError(
            f"The token must have at least {LEAST_LENGTH} printable characters.",
            where=where,
            remedy="To make one: openssl rand -hex 16",
        )
    return token


def require_token(host: str, token: str | None) -> None:
    """Check that pages for other computers have a token.

    token: The token; None if there is none.
    Raises UsageError: If other computers could use the pages without a token.
    """
    if token is None and not is_loopback(host):
        raise UsageError(
            "Pages that other computers can open need a token.",
            where=f"--host {host}",
            remedy=f"Put a token into the environment variable {TOKEN_VARIABLE}, or name a file with --token-file. To"
            " serve this computer only, leave out --host.",
        )


def is_loopback(host: str) -> bool:
    """Return whether a name or an address means this computer only.

    Returns: True for ``localhost``, 127.0.0.0/8 and ::1.

    Examples
    --------
    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    if host.rstrip(".").lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def session_of(token: str) -> str:
    """Return what the browser keeps after a sign-in: it proves the token, and does not contain it.

    It depends on the token alone, so that a browser stays signed in when the server is started again.

    Returns: 64 hexadecimal digits, HMAC-SHA256 (RFC 2104).
    """
    return hmac.new(token.encode(), b"starbench page session", hashlib.sha256).hexdigest()


def _read(path: Path) -> str:
    try:
        status = path.stat()
        if os.name == "posix" and status.st_mode & (stat.S_IRGRP | stat.S_IROTH):
            raise UsageError(
                "Other users may read the file with the token.", where=str(path), remedy=f"chmod 600 {path}"
            )
        if not stat.S_ISREG(status.st_mode) or status.st_size > _MOST_BYTES:
            raise UsageError("This is not a file with a token.", where=str(path), remedy="Check the path.")
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        what = f"The file with the token cannot be read: {getattr(error, 'strerror', None) or error}."
        raise UsageError(what, where=str(path), remedy="Check the path and its permissions.") from error
