"""Simulated controllers with one thing wrong each, by name: the replies of one are changed, always in the same way.

The first 13 of Zaber's and the first 6 of XIMC's are those the makers' own clients were tried against.
"""

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


# ---------------------------------------------------------------- XIMC: four letters, data, CRC
def crc16(data: bytes) -> bytes:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, "little")


def with_data(change: Change) -> Change:
    """Change replies that carry data; bare echoes of a command stay."""
    return lambda answer: change(answer) if len(answer) > 4 else answer


def command_state(change: Callable[[int], int]) -> Change:
    """Change the byte of a status that says whether a command is being carried out, and seal it anew."""

    def changed(answer: bytes) -> bytes:
        if answer[:4] != b"gets":
            return answer
        data = bytearray(answer[4:-2])
        data[1] = change(data[1])
        return b"gets" + data + crc16(data)

    return changed


XIMC: Final[dict[str, Change]] = {
    "CRC over the wrong span": with_data(lambda answer: answer[:-2] + crc16(answer[:-2])),
    "CRC bytes swapped": with_data(lambda answer: answer[:-2] + answer[:-3:-1]),
    "wrong letters": lambda answer: b"x" + answer[1:] if answer.strip(b"\0") else answer,
    "short reply": with_data(lambda answer: answer[:-1]),
    "a byte too many": with_data(lambda answer: answer + b"\x07"),
    "never idle": command_state(lambda state: state | 0x80),
    "always idle": command_state(lambda state: state & ~0x80),
    "echo": lambda answer: b"gets" + answer if answer.strip(b"\0") else answer,
    "a zero too many": with_data(lambda answer: answer + b"\0"),
}
