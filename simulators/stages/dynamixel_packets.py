"""Packets of Dynamixel Protocol 2.0 as a servo makes them: CRC, stuffing, status packets; and why a write is refused.

Source: Robotis e-Manual, "DYNAMIXEL Protocol 2.0".
"""

from __future__ import annotations


class AccessError(Exception):
    """An address that does not exist, or cannot be written now."""


class RangeError(Exception):
    """A value out of range.

    by_setting: Whether a setting of the servo limits it.
    """

    def __init__(self, *, by_setting: bool = False) -> None:
        super().__init__()
        self.by_setting = by_setting


def crc_of(data: bytes) -> int:
    """Return the CRC-16 of a packet without its last two bytes, bit by bit: polynomial 0x8005, begun with 0."""
    register = 0
    for byte in data:
        for bit in (128, 64, 32, 16, 8, 4, 2, 1):
            carry = (register >> 15) ^ (1 if byte & bit else 0)
            register = (register << 1) & 0xFFFF
            if carry:
                register ^= 0x8005
    return register


def unstuffed(body: bytes) -> bytes:
    """Drop the byte FD that follows each FF FF FD."""
    clean = bytearray()
    skip = False
    for byte in body:
        if skip:
            skip = False
            if byte == 0xFD:
                continue
        clean.append(byte)
        skip = clean[-3:] == b"\xff\xff\xfd"
    return bytes(clean)


def status_packet(number: int, error: int, data: bytes = b"") -> bytes:
    """Return a status packet."""
    body = bytearray()
    for byte in (0x55, error, *data):
        body.append(byte)
        if body[-3:] == b"\xff\xff\xfd":
            body.append(0xFD)
    packet = b"\xff\xff\xfd\x00" + bytes([number]) + (len(body) + 2).to_bytes(2, "little") + bytes(body)
    return packet + crc_of(packet).to_bytes(2, "little")
