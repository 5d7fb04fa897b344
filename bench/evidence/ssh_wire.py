"""The data types of SSH's binary formats (RFC 4251, section 5): strings, integers. Bytes only."""

from __future__ import annotations


def string(data: bytes) -> bytes:
    """Encode a string: its length in four bytes, then its bytes (RFC 4251, section 5)."""
    return len(data).to_bytes(4, "big") + data


def mpint(data: bytes) -> int:
    """Decode the bytes of a multiple precision integer that is not negative (RFC 4251, section 5).

    data: The bytes, without their length.
    Raises ValueError: When it is negative, or not in the shortest form.
    """
    if data[:1] > b"\x7f" or (data[:1] == b"\0" and data[1:2] <= b"\x7f"):
        raise ValueError("it has a number that is negative or not in the shortest form")
    return int.from_bytes(data, "big")


def encode_mpint(number: int) -> bytes:
    """Encode a number that is not negative as a multiple precision integer (RFC 4251, section 5)."""
    return string(number.to_bytes(number.bit_length() // 8 + 1, "big") if number else b"")


class Reader:
    """Reads one value after another."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, size: int) -> bytes:
        """Return the next bytes.

        Raises ValueError: When fewer are left.
        """
        found = self._data[self._at : self._at + size]
        if len(found) < size:
            raise ValueError("it is incomplete")
        self._at += size
        return found

    def byte(self) -> int:
        """Return the next byte as a number."""
        return self.take(1)[0]

    def uint32(self) -> int:
        """Return the next four bytes as a number (RFC 4251, section 5).

        Returns: The number; ValueError when fewer bytes are left.
        """
        return int.from_bytes(self.take(4), "big")

    def string(self) -> bytes:
        """Return the next string (RFC 4251, section 5).

        Returns: The string; ValueError when it is incomplete.
        """
        return self.take(self.uint32())

    def end(self) -> None:
        """Check that nothing is left.

        Raises ValueError: When bytes are left.
        """
        if self._at < len(self._data):
            raise ValueError("it has surplus bytes")


def strings(data: bytes, count: int) -> list[bytes]:
    """Split data into exactly ``count`` strings.

    Raises ValueError: When there are fewer or more.
    """
    reader = Reader(data)
    found = [reader.string() for _ in range(count)]
    reader.end()
    return found
