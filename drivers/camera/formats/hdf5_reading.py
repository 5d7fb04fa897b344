"""Read arrays from HDF5 files that nobody vouches for: only what lies in the file itself, piece by piece, in bounds.

An HDF5 file can point to other files (external links, external storage, virtual datasets), can state more rows than it
holds, and can compress gigabytes into some bytes. HDF5 itself follows such links, fills missing rows with zeros, and
decompresses a chunk of any size. So this module follows hard links only, compares every stated size with the size of
the file, and decompresses the chunks itself. Nothing is written.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.camera.event_arrays import require_ratio
from drivers.errors import CameraSoftwareMissing, RecordingCorrupt, UnreadableEvents

MOST_CHUNK_BYTES: Final = 1 << 24
"""Largest chunk, decompressed. Writers use chunks of at most some megabytes."""
MOST_ROW_BYTES: Final = 256
"""Largest row of a table."""
_MOST_ATTRIBUTES: Final = 200  # Event files have some tens
_MOST_TEXT: Final = 4096  # The text header of a RAW file fits
_PIECE_BYTES: Final = 1 << 22  # 4 MiB
_GZIP, _SHUFFLE, _CHECK_SUM = h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32
_OWN_FILTERS: Final = frozenset({_GZIP, _SHUFFLE, _CHECK_SUM})
_CHECK_SUM_BYTES: Final = 4  # Of HDF5's Fletcher-32 filter

Decoder = Callable[[bytes], NDArray[Any]]


def has_member(group: Any, name: str) -> bool:
    """Return whether a group has a member of this name (without slashes); it may be a link, and unreadable."""
    return group.get(name, getlink=True) is not None


def member(group: Any, path: str) -> Any:
    """Return the part of a file at a path with slashes; `NotARecording` if it is missing or behind a link elsewhere."""
    here = group
    for name in path.split("/"):
        link = here.get(name, getlink=True) if isinstance(here, h5py.Group) else None
        if link is None:
            raise UnreadableEvents(f"{path} is missing.")
        if not isinstance(link, h5py.HardLink):
            what = "a link to another place; only data in the file itself are read"
            raise UnreadableEvents(f"{path} is {what}.")
        here = here[name]
    return here


def dataset(group: Any, path: str) -> Any:
    """Return an array of a file, after a check that the file itself holds it.

    Raises `NotARecording` if it is missing, no array, kept in another file, compressed by an unknown filter, or larger
    than the file can hold.
    """
    values = member(group, path)
    if not isinstance(values, h5py.Dataset):
        raise UnreadableEvents(f"{path} is a group, not an array.")
    if values.is_virtual or values.external is not None:
        raise UnreadableEvents(
            f"{path} keeps its data in another file; only data in the file itself are read."
        )
    if values.shape is None or values.dtype.kind not in "biufV" or values.dtype.itemsize > MOST_ROW_BYTES:
        raise UnreadableEvents(f"{path} is an array of {values.dtype}, not of numbers.")
    require_ratio(values.nbytes, _file_bytes(values), path)
    if values.chunks is not None and _chunk_bytes(values) > MOST_CHUNK_BYTES:
        raise UnreadableEvents(
            f"{path} has chunks of {_chunk_bytes(values)} bytes; at most {MOST_CHUNK_BYTES} are read."
        )
    if values.chunks is None and values.nbytes and values.id.get_storage_size() < values.nbytes:
        raise UnreadableEvents(f"{path} states {values.nbytes} bytes, but they are missing.")
    return values


def filters(array: Any) -> list[int]:
    """Return the numbers of an array's compression filters, in the order of writing."""
    creation = array.id.get_create_plist()
    return [creation.get_filter(k)[0] for k in range(creation.get_nfilters())]


def needs_library(array: Any) -> bool:
    """Return whether only HDF5 itself can read an array: by its filters, or by how it is cut into chunks."""
    return array.chunks is not None and (
        array.chunks[1:] != array.shape[1:] or not set(filters(array)) <= _OWN_FILTERS
    )


def rows_by_library(array: Any) -> Iterator[NDArray[Any]]:
    """Read an array piece by piece as HDF5 does it: in a process with limits (`library_process`) only."""
    total = array.shape[0] if array.shape else 0
    for number in filters(array):
        if not h5py.h5z.filter_avail(number):
            raise CameraSoftwareMissing(
                f"{array.name} is compressed by filter {number} of HDF5, which is not installed.",
                remedy="Install it: pip install 'starbench[formats]'",
            )
    if array.chunks is not None:
        chunks = int(
            np.prod([-(-side // step) for side, step in zip(array.shape, array.chunks, strict=True)])
        )
        if array.id.get_num_chunks() != chunks:
            raise UnreadableEvents(
                f"{array.id.get_num_chunks()} of the {chunks} chunks of {array.name} are there."
            )
    step = (
        array.chunks[0] if array.chunks is not None else max(1, _PIECE_BYTES // max(1, array.dtype.itemsize))
    )
    for begin in range(0, total, step):
        yield array[begin : begin + step]


def rows(array: Any, decode: Decoder | None = None) -> Iterator[NDArray[Any]]:
    """Read an array piece by piece: yield (n, ...) rows of its own type, in order, all of them the whole array.

    It must not be one of `needs_library`, unless ``decode`` decompresses its chunks; None for gzip, shuffle and check
    sums. Missing or damaged chunks raise `NotARecording` or `RecordingCorrupt`.
    """
    total = array.shape[0] if array.shape else 0
    if array.chunks is None:
        step = max(1, _PIECE_BYTES // max(1, array.nbytes // max(total, 1)))
        for begin in range(0, total, step):
            yield array[begin : begin + step]
        return
    pipeline = filters(array)
    done = 0
    for place in _places(array, total):
        begin = place.chunk_offset[0]
        n = min(total - begin, array.chunks[0])
        if n <= 0:
            continue  # left over from a longer array
        if begin != done:
            raise UnreadableEvents(_missing(begin - done, total, array))
        yield _chunk(array, place, pipeline, decode)[:n]
        done += n
    if done != total:
        raise UnreadableEvents(_missing(total - done, total, array))


def whole(array: Any, most_bytes: int) -> NDArray[Any]:
    """Read an array, in its own shape and type; `NotARecording` if it has more than ``most_bytes`` or is unreadable."""
    if array.nbytes > most_bytes:
        raise UnreadableEvents(f"{array.name} has {array.nbytes} bytes; at most {most_bytes} are read.")
    if array.chunks is None or not array.shape:
        return np.asarray(array[()])
    out = np.zeros(array.shape, array.dtype)
    pipeline = filters(array)
    if not set(pipeline) <= _OWN_FILTERS:
        raise UnreadableEvents(f"{array.name} is compressed by filter {pipeline}; gzip and none are read.")
    for place in _places(array, 0):
        at = tuple(
            slice(first, min(first + side, end))
            for first, side, end in zip(place.chunk_offset, array.chunks, array.shape, strict=True)
        )
        if any(part.start >= part.stop for part in at):
            continue
        part = _chunk(array, place, pipeline, None)
        out[at] = part[tuple(slice(0, rows.stop - rows.start) for rows in at)]
    return out


def texts(group: Any) -> dict[str, str]:
    """Return the attributes of a group, as text; `NotARecording` if there are more or longer ones than usual."""
    names = list(group.attrs)
    if len(names) > _MOST_ATTRIBUTES:
        raise UnreadableEvents(f"it has {len(names)} attributes; at most {_MOST_ATTRIBUTES} are read.")
    text_of = {}
    for name in names:
        if group.attrs.get_id(name).get_storage_size() > _MOST_TEXT:
            raise UnreadableEvents(f"its attribute {name[:40]!r} is longer than {_MOST_TEXT} bytes.")
        value = group.attrs[name]
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
        if len(text) > _MOST_TEXT:
            raise UnreadableEvents(f"its attribute {name[:40]!r} is longer than {_MOST_TEXT} bytes.")
        text_of[name] = text
    return text_of


def _places(array: Any, rows_stated: int) -> list[Any]:
    """Return where the chunks lie, in their order."""
    most = max(4 * _file_bytes(array) // 512, 4096, 2 * rows_stated // max(1, array.chunks[0]))
    if array.id.get_num_chunks() > most:
        raise UnreadableEvents(
            f"{array.name} has {array.id.get_num_chunks()} chunks, more than the file can hold."
        )
    places: list[Any] = []
    array.id.chunk_iter(places.append)
    return sorted(places, key=lambda place: place.chunk_offset)


def _chunk(array: Any, place: Any, pipeline: list[int], decode: Decoder | None) -> NDArray[Any]:
    """Read one chunk and decompress it, never to more than its size."""
    if place.size > 2 * MOST_CHUNK_BYTES or place.size > _file_bytes(array):
        raise _damaged(f"a chunk states {place.size} bytes", place)
    skipped, data = array.id.read_direct_chunk(place.chunk_offset)
    size = _chunk_bytes(array)
    try:
        if decode is not None and not skipped:
            return decode(data)
        if decode is None:
            for k, kind in reversed(list(enumerate(pipeline))):
                if not skipped & 1 << k:
                    data = _undone(kind, data, size, array.dtype.itemsize)
        if len(data) < size:
            raise ValueError(f"a chunk of {size} bytes ends after {len(data)}")  # noqa: TRY301
    except zlib.error as error:
        raise _damaged("the compressed bytes of a chunk are damaged", place) from error
    except ValueError as error:  # of `_undone` or ``decode``
        raise _damaged(str(error), place) from error
    return np.frombuffer(data[:size], array.dtype).reshape(array.chunks)


def _damaged(what: str, place: Any) -> RecordingCorrupt:
    return RecordingCorrupt(
        f"The events cannot be decompressed: {what}.",
        offset=place.byte_offset,
        remedy="Copy the file again, or export it again from the original recording.",
    )


def _undone(kind: int, data: bytes, size: int, itemsize: int) -> bytes:
    """Undo one filter of HDF5."""
    if kind == _CHECK_SUM:
        return data[:-_CHECK_SUM_BYTES]
    if kind == _SHUFFLE:
        n = len(data) // itemsize
        mixed = np.frombuffer(data, np.uint8, count=n * itemsize).reshape(itemsize, n)
        return mixed.T.tobytes() + data[n * itemsize :]
    unpacked = zlib.decompressobj().decompress(data, size + _CHECK_SUM_BYTES + 1)
    if len(unpacked) > size + _CHECK_SUM_BYTES:
        raise ValueError(f"a chunk of {size} bytes holds more")
    return unpacked


def _missing(n: int, total: int, array: Any) -> str:
    return f"{n} of the {total} rows of {array.name} are missing."


def _chunk_bytes(array: Any) -> int:
    return int(np.prod(array.chunks, dtype=object)) * int(array.dtype.itemsize)


def _file_bytes(array: Any) -> int:
    return int(array.file.id.get_filesize())
