"""Read NumPy's ``.npz`` files that nobody vouches for: lists of whole numbers, piece by piece, in bounds.

An ``.npz`` file is a ZIP archive of arrays. Some bytes of it can stand for gigabytes, and an array can be a pickled
object whose reading would execute code. So the sizes are compared first, and only plain numbers are read.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera.formats.hdf5_reading import require_ratio

_MOST_DIRECTORY: Final = 1 << 20
"""Largest list of contents of an archive, bytes."""
_MOST_NAME: Final = 65_557
"""Longest end of an archive, with its comment."""
_END: Final = b"PK\x05\x06"


class NpzFile:
    """An open ``.npz`` file.

    Raises ValueError: If it is no such file.
    Raises zipfile.BadZipFile: If the archive is damaged.
    """

    def __init__(self, path: Path) -> None:
        _require_short_directory(path)
        self._archive = zipfile.ZipFile(path)
        self._bytes = path.stat().st_size

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._archive.close()

    def length(self, name: str) -> int:
        """Return the number of elements of a list.

        Raises ValueError: If it is missing, or no list of whole numbers.
        """
        with self._open(name) as stream:
            return self._header(stream, name)[0]

    def rows(self, name: str, step: int) -> Iterator[NDArray[Any]]:
        """Read a list piece by piece.

        step: Number of elements of a piece.
        Yields: (n,) integers of the array's own type, the next ones; the last piece may be shorter.
        Raises ValueError: If it is missing, no list of whole numbers, or ends too early.
        """
        with self._open(name) as stream:
            n, dtype = self._header(stream, name)
            for begin in range(0, n, step):
                wanted = min(step, n - begin) * dtype.itemsize
                data = stream.read(wanted)
                if len(data) < wanted:
                    raise ValueError(f"{name} ends before its last number")
                yield np.frombuffer(data, dtype)
            while stream.read(1 << 16):  # to the end: the archive then compares its check sum
                pass

    def _open(self, name: str) -> IO[bytes]:
        try:
            info = self._archive.getinfo(f"{name}.npy")
        except KeyError:
            try:
                info = self._archive.getinfo(name)
            except KeyError:
                raise ValueError(f"{name} is missing") from None
        require_ratio(info.file_size, min(info.compress_size, self._bytes), name)
        return self._archive.open(info)

    def _header(self, stream: IO[bytes], name: str) -> tuple[int, np.dtype[Any]]:
        """Read the head of an array; return its length and type."""
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(stream)
        if len(shape) != 1 or dtype.kind not in "iu":
            raise ValueError(
                f"{name} is an array of {dtype} with {len(shape)} dimensions, not a list of whole numbers"
            )
        if not 0 <= shape[0] * dtype.itemsize <= self._archive_size(name):
            raise ValueError(f"{name} states {shape[0]} numbers, but they are missing")
        return shape[0], dtype

    def _archive_size(self, name: str) -> int:
        known = self._archive.NameToInfo
        return (known.get(f"{name}.npy") or known[name]).file_size


def _require_short_directory(path: Path) -> None:
    """Refuse an archive of so many files that their list alone would fill the memory."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _MOST_NAME))
        end = file.read(_MOST_NAME)
    at = end.rfind(_END)
    if at >= 0 and len(end) >= at + 16 and int.from_bytes(end[at + 12 : at + 16], "little") > _MOST_DIRECTORY:
        raise ValueError("the archive holds too many files")
