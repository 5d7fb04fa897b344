"""Replies of simulated controllers with one thing changed and sealed anew, as their makers' protocols ask for it."""

from __future__ import annotations

import re
from collections.abc import Callable

Change = Callable[[bytes], bytes]


def zaber_line(body: str) -> bytes:
    return f"@{body}:{-sum(body.encode()) & 0xFF:02X}\r\n".encode()


def each_line(change: Callable[[str], bytes]) -> Change:
    """Change each reply line, given without its first character, checksum and end."""

    def changed(answer: bytes) -> bytes:
        return b"".join(change(body.decode()) for body in re.findall(rb"@(.*?):..\r\n", answer))

    return changed


def words(change: Callable[[list[str]], list[str]]) -> Change:
    """Change the words of a reply (device, axis, id, verdict, state, flag, data ...) and seal it anew."""
    return each_line(lambda body: zaber_line(" ".join(change(body.split(" ")))))


def put(place: int, word: Callable[[str], str]) -> Change:
    """Change one word."""
    return words(lambda all_: [*all_[:place], word(all_[place]), *all_[place + 1 :]])


def crc16(data: bytes) -> bytes:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, "little")
