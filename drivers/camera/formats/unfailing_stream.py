"""A file whose writes never fail for HDF5, which crashes when they do; what failed is told afterwards."""

from __future__ import annotations

import io
import os
from typing import IO

from drivers.durable import write_all


class UnfailingStream(io.RawIOBase):
    """An unbuffered file for ``h5py.File``.

    After the first failure, what is written stays in memory, so that HDF5 reads it again and closes in order.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._at = stream, 0
        self._failure: OSError | None = None
        self._kept: list[tuple[int, bytes]] = []

    def raise_failure(self) -> None:
        """Raise the error of the first write that failed; to be called after each large piece, and at the end."""
        if self._failure is not None:
            raise self._failure

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """See `io.IOBase.seek`; from the beginning or the end."""
        end = 0
        if whence == os.SEEK_END:
            ends = (at + len(data) for at, data in self._kept)
            end = max(self._stream.seek(0, os.SEEK_END), *ends, 0)
        self._at = end + offset
        return self._at

    def tell(self) -> int:
        """See `io.IOBase.tell`."""
        return self._at

    def read(self, size: int = -1) -> bytes:
        """Return so many bytes; where nothing was written, they are zero."""
        self._stream.seek(self._at)
        found = bytearray(self._stream.read(size).ljust(size, b"\0"))
        for at, data in self._kept:
            begin, end = max(at, self._at), min(at + len(data), self._at + size)
            if begin < end:
                found[begin - self._at : end - self._at] = data[begin - at : end - at]
        self._at += size
        return bytes(found)

    def write(self, data: bytes | bytearray) -> int:  # type: ignore[override]
        """Write all bytes, or keep them."""
        if self._failure is None:
            try:
                self._stream.seek(self._at)
                write_all(self._stream.fileno(), data)
            except OSError as error:
                self._failure = error
        if self._failure is not None:
            self._kept.append((self._at, bytes(data)))
        self._at += len(data)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """See `io.IOBase.truncate`."""
        try:
            self._stream.truncate(size)
        except OSError as error:
            self._failure = self._failure or error
        return size or 0
