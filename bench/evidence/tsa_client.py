"""Ask a time stamping authority for a time stamp over HTTP (RFC 3161, section 3.4).

Only a hash leaves the bench. The address is checked first; a redirect is not followed.
"""

from __future__ import annotations

import http.client
import ssl
from concurrent.futures import wait
from contextlib import closing
from dataclasses import dataclass
from urllib.parse import urlsplit

from bench import __version__
from bench.base.background import in_background
from bench.base.errors import EvidenceError, UsageError
from bench.evidence.timestamp import read_reply, stamp_library

WAIT_S = 20.0  # A person waits for it
_MOST_BYTES = 1 << 20  # An answer with its certificates has some kB
_REPLY_TYPE = "application/timestamp-reply"


@dataclass(frozen=True)
class Request:
    """A request for a time stamp."""

    data: bytes
    nonce: int | None = None  # The random number that the reply must repeat; None if there is none


def make_request(signed: bytes, *, nonce: bool) -> Request:
    """Make a request with SHA-256 and certificate (RFC 3161, 2.4.1); without ``nonce`` the same bytes each time."""
    library = stamp_library()
    builder = library.TimestampRequestBuilder().data(signed).hash_algorithm(library.base.HashAlgorithm.SHA256)
    request = builder.cert_request(cert_request=True).nonce(nonce=nonce).build()
    return Request(bytes(request.as_bytes()), request.nonce if nonce else None)


def check_url(url: str) -> None:
    """Check the address of an authority before anything is sent: http(s) with a host, without user or password."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise UsageError(f"--tsa: this is not an address: {error}.") from error
    if parts.username is not None or parts.password is not None:
        raise UsageError(
            "--tsa: an address must not contain a user or a password; it would be stored in the shell's history.",
            remedy="Use an authority that needs none, or get the reply with --request and --token.",
        )
    if parts.scheme not in {"https", "http"} or not parts.hostname or port == 0 or not url.isprintable():
        raise UsageError(
            "--tsa: this is not an address of a time stamping authority.",
            remedy="Write it as https://host/path; http:// is possible too, because replies are signed.",
        )


def ask_authority(url: str, request: Request) -> bytes:
    """Send a request; return the reply, which is not verified yet; `EvidenceError` if none comes in 20 s."""
    check_url(url)
    try:
        answered = in_background(lambda: _post(url, request.data), "time stamp")
        if not wait([answered], WAIT_S).done:  # a slow answer may take any time
            raise TimeoutError
        reply = answered.result()
    except (OSError, http.client.HTTPException, ValueError) as error:
        why = f"no answer within {WAIT_S:.0f} s" if isinstance(error, TimeoutError) else str(error)
        raise EvidenceError(
            f"The time stamping authority cannot be asked: {why or type(error).__name__}.",
            where=url,
            remedy="Check the address and the network, or use --request and --token without a network.",
        ) from error
    if request.nonce is not None and read_reply(reply).tst_info.nonce != request.nonce:
        raise EvidenceError(
            "The reply is not the answer to this request: its random number differs.",
            where=url,
            remedy="Try again, or use another authority.",
        )
    return reply


def _post(url: str, data: bytes) -> bytes:
    """Send the request; return the body of the answer. Raises OSError, HTTPException, ValueError, EvidenceError."""
    parts = urlsplit(url)
    host = str(parts.hostname)
    connection = (
        http.client.HTTPSConnection(host, parts.port, timeout=WAIT_S, context=ssl.create_default_context())
        if parts.scheme == "https"
        else http.client.HTTPConnection(host, parts.port, timeout=WAIT_S)
    )
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    headers = {"Content-Type": "application/timestamp-query", "User-Agent": f"starbench/{__version__}"}
    with closing(connection):
        connection.request("POST", path, body=data, headers=headers)
        with connection.getresponse() as answer:
            body = answer.read(_MOST_BYTES + 1)
    _refuse_answer(answer, body, url)
    return body


def _refuse_answer(answer: http.client.HTTPResponse, body: bytes, url: str) -> None:
    """Refuse an answer that is no time stamp."""
    kind = (answer.getheader("Content-Type") or "").partition(";")[0].strip().lower()
    if answer.status != http.client.OK:
        moved = answer.getheader("Location") if 300 <= answer.status < 400 else None
        more = f" and refers to {moved!a}, which is not followed" if moved else ""
        what = f"The time stamping authority answers {answer.status} {answer.reason!a}{more}."
    elif kind != _REPLY_TYPE:
        what = f"The answer is of the type {kind!a}, not {_REPLY_TYPE}."
    elif len(body) > _MOST_BYTES:
        what = f"The answer has more than {_MOST_BYTES} bytes."
    else:
        return
    raise EvidenceError(what, where=url, remedy="Check the address in the authority's documentation.")
