"""The parts of DER (X.690) that time stamps need: a sequence, and sets in their order. Bytes only."""

from __future__ import annotations

_MOST_LENGTH_BYTES = 4  # Lengths up to 4 GiB
_TO_SIGNED_DATA = (0, 1, 1, 0)
"""Places of reply, token, its content and the signed data in it (RFC 3161, section 2.4.2; RFC 5652, section 3)."""
_SETS = (0x31, 0xA0, 0xA1)
"""Tags of sets within signed data: of hashes and signers, of certificates, of revocations (RFC 5652, section 5.1)."""


def sequence(content: bytes) -> bytes:
    """Return a SEQUENCE (X.690, section 8.9)."""
    size = len(content)
    octets = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return b"\x30" + (bytes([size]) if size < 0x80 else bytes([0x80 | len(octets)]) + octets) + content


def sets_in_order(reply: bytes) -> bytes:
    """Return a reply with sets in the order of DER (X.690, 11.6): OpenSSL writes certificates by chain, unsigned."""
    ordered = reply
    try:
        inside = _elements(reply, 0, len(reply))
        for place in _TO_SIGNED_DATA:
            inside = _elements(reply, *inside[place][1:])
        for start, begin, end in inside:
            if reply[start] in _SETS:
                parts = sorted(reply[first:last] for first, _, last in _elements(reply, begin, end))
                ordered = ordered[:begin] + b"".join(parts) + ordered[end:]
    except (IndexError, ValueError):
        return reply
    return ordered


def _elements(data: bytes, start: int, end: int) -> list[tuple[int, int, int]]:
    """Return the elements between two places: start of each, begin and end of its content (X.690, section 8.1.3)."""
    elements = []
    while start < end:
        size, begin = data[start + 1], start + 2
        if size & 0x80:
            count = size & 0x7F
            if not 0 < count <= _MOST_LENGTH_BYTES:
                raise ValueError("a length that DER does not have")
            begin += count
            size = int.from_bytes(data[begin - count : begin], "big")
        if begin + size > end:
            raise ValueError("incomplete")
        elements.append((start, begin, begin + size))
        start = begin + size
    return elements
