"""Simulated controllers with one thing wrong each, by name: the replies of one are changed, always in the same way.

The first 13 are those that the maker's own client was tried against.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, Protocol

Change = Callable[[bytes], bytes]


class Dialect(Protocol):
    """What a simulated device offers to a line."""

    baud: int

    def receive(self, data: bytes) -> bytes: ...

    def unsolicited(self) -> bytes: ...


class Mutated:
    """A simulated device whose every reply is changed before it goes out."""

    def __init__(self, device: Dialect, change: Change) -> None:
        self.device = device
        self.change = change

    @property
    def baud(self) -> int:
        return self.device.baud

    def receive(self, data: bytes) -> bytes:
        answer = self.device.receive(data)
        return self.change(answer) if answer else answer

    def unsolicited(self) -> bytes:
        return self.device.unsolicited()


# ---------------------------------------------------------------- Zaber: text lines with a checksum
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


def wrong_sum(body: str) -> bytes:
    right = zaber_line(body)
    return right[:-4] + b"%02X" % (int(right[-4:-2], 16) ^ 0x5A) + right[-2:]


ZABER: Final[dict[str, Change]] = {
    "wrong checksum": each_line(wrong_sum),
    "CR only": lambda answer: answer.replace(b"\r\n", b"\r"),
    "no id": words(lambda all_: all_[:2] + all_[3:]),
    "wrong id": put(2, lambda word: f"{(int(word) + 1) % 100:02d}"),
    "wrong device": put(0, lambda word: f"{int(word) + 1:02d}"),
    "wrong axis": put(1, lambda word: str(int(word) + 1)),
    "lower-case ok": put(3, str.lower),
    "no flag field": words(lambda all_: all_[:5] + all_[6:]),
    "state word Idle": put(4, str.capitalize),
    "no checksum": each_line(lambda body: f"@{body}\r\n".encode()),
    "LF only": lambda answer: answer.replace(b"\r\n", b"\n"),
    "one-digit address": put(0, lambda word: str(int(word))),
    "always idle": put(4, lambda _word: "IDLE"),
    "never idle": put(4, lambda _word: "BUSY"),
    "echo": lambda answer: b"/1 1 00 get pos:2C\n" + answer,
}
