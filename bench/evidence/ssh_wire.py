"""The data types of SSH's binary formats (RFC 4251, section 5): strings, integers. Bytes only."""

from __future__ import annotations


def string(data: bytes) -> bytes:
    """Encode a string: its length in four bytes, then its bytes (RFC 4251, section 5).

    Parameters
    ----------
    data
        The bytes.

    Returns
    -------
    bytes
        The encoded string.
    """
    return len(data).to_bytes(4, "big") + data


def mpint(data: bytes) -> int:
    """Decode the bytes of a multiple precision integer that is not negative (RFC 4251, section 5).

    Parameters
    ----------
    data
        The bytes, without their length.

    Returns
    -------
    int
        The number.

    Raises
    ------
    ValueError
        When it is negative, or not in the shortest form.
    """
    if data[:1] > b"\x7f" or (data[:1] == b"\0" and data[1:2] <= b"\x7f"):
        raise ValueError("it has a number that is negative or not in the shortest form")
    return int.from_bytes(data, "big")


def encode_mpint(number: int) -> bytes:
    """Encode a number that is not negative as a multiple precision integer (RFC 4251, section 5).

    Parameters
    ----------
    number
        The number.

    Returns
    -------
    bytes
        Its length and its bytes.
    """
    return string(number.to_bytes(number.bit_length() // 8 + 1, "big") if number else b"")


class Reader:
    """Reads one value after another.

    Parameters
    ----------
    data
        The bytes.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, size: int) -> bytes:
        """Return the next bytes.

        Parameters
        ----------
        size
            How many.

        Returns
        -------
        bytes
            As many bytes.

        Raises
        ------
        ValueError
            When fewer are left.
        """
        found = self._data[self._at : self._at + size]
        if len(found) < size:
            raise ValueError("it is incomplete")
        self._at += size
        return found

    def byte(self) -> int:
        """Return the next byte as a number.

        Returns
        -------
        int
            The byte; ValueError at the end.
        """
        return self.take(1)[0]

    def uint32(self) -> int:
        """Return the next four bytes as a number (RFC 4251, section 5).

        Returns
        -------
        int
            The number; ValueError when fewer bytes are left.
        """
        return int.from_bytes(self.take(4), "big")

    def string(self) -> bytes:
        """Return the next string (RFC 4251, section 5).

        Returns
        -------
        bytes
            The string; ValueError when it is incomplete.
        """
        return self.take(self.uint32())

    def end(self) -> None:
        """Check that nothing is left.

        Raises
        ------
        ValueError
            When bytes are left.
        """
        if self._at < len(self._data):
            raise ValueError("it has surplus bytes")


def strings(data: bytes, count: int) -> list[bytes]:
    """Split data into exactly ``count`` strings.

    Parameters
    ----------
    data
        The bytes.
    count
        Number of strings.

    Returns
    -------
    list of bytes
        The strings.

    Raises
    ------
    ValueError
        When there are fewer or more.
    """
    reader = Reader(data)
    found = [reader.string() for _ in range(count)]
    reader.end()
    return found
