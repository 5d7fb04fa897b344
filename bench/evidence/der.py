"""The parts of DER (X.690) that time stamps need: a sequence, and sets in their order. Bytes only."""

from __future__ import annotations

_MOST_LENGTH_BYTES = 4
_OF_TOKEN = (1, 1, 0)
"""Places of the token, its content and the signed data in a reply (RFC 3161, section 2.4.2; RFC 5652, section 3)."""
_SETS = (0x31, 0xA0, 0xA1)
"""Tags of sets within signed data: of hashes and signers, of certificates, of revocations (RFC 5652, section 5.1)."""


def sequence(content: bytes) -> bytes:
    """Return a SEQUENCE (X.690, section 8.9)."""
    return _element(0x30, content)


def sets_in_order(reply: bytes) -> bytes:
    """Return a reply of a time stamping authority whose sets are in the order of DER (X.690, section 11.6).

    OpenSSL writes certificates in the order of their chain. No signature covers the order, so it may be changed.

    Returns: The same reply; the bytes as they are if it has another form.
    """
    try:
        return _sorted_at(reply, _OF_TOKEN)
    except (IndexError, ValueError):
        return reply


def _sorted_at(data: bytes, path: tuple[int, ...]) -> bytes:
    """Sort the sets of the element that a path of places leads to."""
    tag, content = _opened(data)
    parts = _split(content)
    if path:
        parts[path[0]] = _sorted_at(parts[path[0]], path[1:])
    else:
        parts = [_sorted(part) if part[0] in _SETS else part for part in parts]
    return _element(tag, b"".join(parts))


def _sorted(data: bytes) -> bytes:
    tag, content = _opened(data)
    return _element(tag, b"".join(sorted(_split(content))))


def _split(content: bytes) -> list[bytes]:
    """Split elements that follow each other. Raises IndexError or ValueError."""
    parts = []
    while content:
        begin, size = _header(content)
        parts.append(content[: begin + size])
        content = content[begin + size :]
    return parts


def _opened(data: bytes) -> tuple[int, bytes]:
    begin, size = _header(data)
    if begin + size != len(data):
        raise ValueError("surplus bytes")
    return data[0], data[begin:]


def _header(data: bytes) -> tuple[int, int]:
    """Return the sizes of tag and length, and of the content (X.690, section 8.1.3)."""
    size, begin = data[1], 2
    if size & 0x80:
        count = size & 0x7F
        if not 0 < count <= _MOST_LENGTH_BYTES:
            raise ValueError("a length that DER does not have")
        begin += count
        size = int.from_bytes(data[2:begin], "big")
    if begin + size > len(data):
        raise ValueError("incomplete")
    return begin, size


def _element(tag: int, content: bytes) -> bytes:
    size = len(content)
    octets = size.to_bytes((size.bit_length() + 7) // 8, "big")
    length = bytes([size]) if size < 0x80 else bytes([0x80 | len(octets)]) + octets
    return bytes([tag]) + length + content
