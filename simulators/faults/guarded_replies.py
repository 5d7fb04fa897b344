"""Faults of replies with a checksum or a message id: wrong checksum, missing checksum, wrong id.

The module recognises replies of the Zaber ASCII protocol, answers of the XIMC protocol, and status packets of Dynamixel
servos; all other replies pass unchanged.
"""

from __future__ import annotations

import re
from typing import Final

from simulators.stages.dynamixel import crc_of
from simulators.stages.ximc import crc16

#: A reply line of the Zaber protocol: addresses, id, the rest, checksum.
_ZABER_REPLY: Final = re.compile(rb"@(\d\d \d )(\d\d)( [^:\r\n]*):[0-9A-F]{2}\r\n")

#: An answer of the XIMC protocol that carries data: four letters, data, CRC of two bytes.
_XIMC_ANSWER: Final = re.compile(rb"([a-z0-9]{4})(.+)..", re.DOTALL)


def wrong_checksum(reply: bytes) -> bytes:
    r"""Replace the checksum by a wrong one.

    Examples
    --------
    >>> wrong_checksum(b"@01 0 00 OK IDLE WR 0:BE\r\n")
    b'@01 0 00 OK IDLE WR 0:41\r\n'
    """
    if _ZABER_REPLY.search(reply):
        return _ZABER_REPLY.sub(
            lambda m: m[0][:-4] + b"%02X" % (int(m[0][-4:-2], 16) ^ 0xFF) + m[0][-2:], reply
        )
    if _has_valid_crc(reply):
        return reply[:-2] + bytes(byte ^ 0xFF for byte in reply[-2:])
    return reply


def missing_checksum(reply: bytes) -> bytes:
    r"""Remove the checksum.

    Examples
    --------
    >>> missing_checksum(b"@01 0 00 OK IDLE WR 0:BE\r\n")
    b'@01 0 00 OK IDLE WR 0\r\n'
    """
    if _ZABER_REPLY.search(reply):
        return _ZABER_REPLY.sub(lambda m: m[0][:-5] + m[0][-2:], reply)
    return reply[:-2] if _has_valid_crc(reply) else reply


def wrong_id(reply: bytes) -> bytes:
    r"""Replace the message id, or the id of the servo, by the next one, with a correct checksum; XIMC has no ids.

    Examples
    --------
    >>> wrong_id(b"@01 0 00 OK IDLE WR 0:BE\r\n")
    b'@01 0 01 OK IDLE WR 0:BD\r\n'
    """
    if _is_packet(reply):
        changed = reply[:4] + bytes([(reply[4] + 1) % 253]) + reply[5:-2]
        return changed + crc_of(changed).to_bytes(2, "little")

    def another(match: re.Match[bytes]) -> bytes:
        body = b"%s%02d%s" % (match[1], (int(match[2]) + 1) % 100, match[3])
        return b"@%s:%02X\r\n" % (body, -sum(body) & 0xFF)  # bytes, not text: they may be garbled already

    return _ZABER_REPLY.sub(another, reply)


def _has_valid_crc(reply: bytes) -> bool:
    """Return whether the last two bytes of an answer are the CRC of its data, or of its packet."""
    if _is_packet(reply):
        return True
    match = _XIMC_ANSWER.fullmatch(reply)
    return match is not None and crc16(match[2]).to_bytes(2, "little") == reply[-2:]


def _is_packet(reply: bytes) -> bool:
    """Return whether a reply is one whole packet of a Dynamixel servo."""
    begins = reply.startswith(b"\xff\xff\xfd\x00") and len(reply) >= 11
    return begins and crc_of(reply[:-2]).to_bytes(2, "little") == reply[-2:]
