"""Patterns of secrets in text: private keys, URLs with credentials, tokens of known services. Reads no files.

The patterns are narrow: each one matches a form that a secret has and a measurement has not. A pattern begins with a
literal text, so that a search over many megabytes is quick.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple


class SecretPattern:
    """One form of a secret."""

    def __init__(self, literal: bytes, regex: re.Pattern[bytes], kind: str) -> None:
        self.literal = literal
        self.regex = regex
        self.kind = kind

    def places(self, data: bytes) -> Iterator[int]:
        """Find the form in a text. The search for a literal text is quick; the form is compared only where it stands.

        Yields: Where a match begins.
        """
        begin = data.find(self.literal)
        while begin >= 0:
            if self.regex.match(data, begin):
                yield begin
            begin = data.find(self.literal, begin + 1)


class _QuerySecrets(SecretPattern):
    """Secrets in the query of a URL: ``://host/path?name=value``."""

    def places(self, data: bytes) -> Iterator[int]:
        """See `SecretPattern.places`; a match begins at the ``://`` of its URL."""
        lower = data.lower()
        for name in _QUERY_NAMES:
            begin = lower.find(name)
            while begin >= 0:
                if self.regex.match(lower, begin + len(name)):
                    url = _BEFORE_URL.split(lower[max(0, begin - _LONGEST_URL) : begin])[-1]
                    place = url.find(b"://")
                    if place >= 0 and _NAME_OF_QUERY.search(url[-100:]):
                        yield begin - len(url) + place
                begin = lower.find(name, begin + 1)


def _pattern(literal: bytes, rest: bytes, kind: str) -> SecretPattern:
    return SecretPattern(literal, re.compile(re.escape(literal) + rest), kind)


def _token(literal: bytes, rest: bytes, kind: str) -> SecretPattern:
    """Return the form of a token, which does not begin within a word."""
    return SecretPattern(literal, re.compile(rb"(?<![A-Za-z0-9_+/-])" + re.escape(literal) + rest), kind)


_LONGEST_URL = 2000
_BEFORE_URL = re.compile(rb"[\s\"'<>\\]")
_NAME_OF_QUERY = re.compile(rb"[?&;#](?:[a-z]{1,20}[_-]){0,3}(?:api|access|auth|session|client|user)?\Z")
_QUERY_NAMES = (
    b"token=", b"secret=", b"key=", b"auth=", b"authorization=", b"password=", b"passwd=", b"passwort=", b"pwd=",
    b"pass=", b"sig=", b"signature=", b"credential=", b"credentials=", b"session=", b"sessionid=",
)  # fmt: skip
_USER = rb"[^\s/?#@:\"'<>\\]"
_PASSWORD = rb"[^\s/?#@\"'<>\\]"
_GITHUB, _SLACK, _AWS = "a token of GitHub", "a token of Slack", "an access key of AWS"

PATTERNS = (
    _pattern(b"://", _USER + rb"{0,200}:" + _PASSWORD + rb"{1,500}@", "a URL with a password"),
    _pattern(b"://", _USER + rb"{16,500}@", "a URL with a token before the @"),
    _QuerySecrets(b"=", re.compile(rb"[^\s&;#\"'<>\\]"), "a URL with a token or password"),
    _pattern(b"hooks.slack.com/", rb"(?:services|workflows|triggers)/[A-Za-z0-9/]", "a secret address of Slack"),
    _pattern(b"/api/webhooks/", rb"\d+/[A-Za-z0-9_-]{20}", "a secret address of Discord"),
    _pattern(b"/webhookb2/", rb"[A-Za-z0-9@-]{30}", "a secret address of Teams"),
    _pattern(b"api.telegram.org/bot", rb"\d+:[A-Za-z0-9_-]{20}", "a token of Telegram"),
    _pattern(b"-----BEGIN ", rb"(?:[A-Z0-9]+ ){0,3}PRIVATE KEY(?: BLOCK)?-----", "a private key"),
    _pattern(b"---- BEGIN SSH2 ENCRYPTED PRIVATE KEY ----", b"", "a private key"),
    _pattern(b"PuTTY-User-Key-File-", rb"\d", "a private key of PuTTY"),
    _pattern(b"AGE-SECRET-KEY-1", rb"[0-9A-Z]{20}", "a private key of age"),
    _token(b"AKIA", rb"[0-9A-Z]{16}(?![A-Za-z0-9+/=])", _AWS),
    _token(b"ASIA", rb"[0-9A-Z]{16}(?![A-Za-z0-9+/=])", _AWS),
    _pattern(b"aws_secret_access_key", rb"[\"']?\s{0,9}[:=]\s{0,9}[\"']?[A-Za-z0-9/+]{40}", _AWS),
    *(_token(literal, rb"[A-Za-z0-9]{36}", _GITHUB) for literal in (b"ghp_", b"gho_", b"ghu_", b"ghs_", b"ghr_")),
    _token(b"github_pat_", rb"[A-Za-z0-9_]{22}", _GITHUB),
    _token(b"glpat-", rb"[A-Za-z0-9_-]{20}", "a token of GitLab"),
    _token(b"xox", rb"[abeoprs]-[A-Za-z0-9-]{10}", _SLACK),
    _token(b"xapp-", rb"\d-[A-Za-z0-9-]{10}", _SLACK),
    _token(b"eyJ", rb"[A-Za-z0-9_-]{8,4000}\.eyJ[A-Za-z0-9_-]{8,4000}\.[A-Za-z0-9_-]{16}", "a web token (JWT)"),
)  # fmt: skip
"""All forms."""


class Secret(NamedTuple):
    """A place in a text that has the form of a secret."""

    # line, column: Where it begins; both count from 1, columns in bytes.
    line: int
    column: int
    kind: str


def find_secrets(data: bytes, patterns: Iterable[SecretPattern] = PATTERNS) -> Iterator[Secret]:
    """Find the secrets in a text.

    Yields: One for each place, in the order of the patterns.
    """
    for pattern in patterns:
        for begin in pattern.places(data):
            yield Secret(data.count(b"\n", 0, begin) + 1, begin - data.rfind(b"\n", 0, begin), pattern.kind)
