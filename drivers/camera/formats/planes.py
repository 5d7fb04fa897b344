"""Compress the bytes of events that HDF5's shuffle has put into planes: all lowest bytes, then all second ones.

Most planes of a recording are of one of two kinds: the upper bytes of the clock stay the same for a whole chunk, and
the lowest byte of a column is as good as random. zlib takes as long for both as for the others, so they are not given
to it: the one is known by its value, the other is stored as it is. All planes are parts of one stream of zlib.

Source: RFC 1950 (zlib) and RFC 1951 (deflate).
"""

from __future__ import annotations

import zlib
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

_HEAD: Final = b"\x78\x01"
_END: Final = b"\x03\x00"
"""The last block of a stream, which is empty."""
_ADLER: Final = 65521
_SAMPLED: Final = 16
_MOST_REPEATS: Final = 0.6
"""Share of bytes that repeat the one before below which runs save less than looking for them costs."""
_RANDOM_BITS: Final = 7.5
"""Entropy of a byte above which at most a sixteenth could be saved."""


def zlib_of_planes(planes: NDArray[np.uint8]) -> bytes:
    """Compress planes, (k, N) uint8, to a stream of zlib that holds one after the other.

    >>> planes = np.array([[7] * 6, [1, 2, 3, 1, 2, 3]], np.uint8)
    >>> zlib.decompress(zlib_of_planes(planes)) == planes.tobytes()
    True
    """
    parts = [_HEAD]
    adler = 1
    for plane in np.ascontiguousarray(planes):
        value = int(plane[0])
        if (plane == value).all():
            parts.append(_constant(value, len(plane)))
            adler = _adler_of_constant(adler, value, len(plane))
        else:
            data = plane.tobytes()
            parts.append(_deflated(data, *_way_of(plane)))
            adler = zlib.adler32(data, adler)
    return b"".join([*parts, _END, adler.to_bytes(4, "big")])


@lru_cache(maxsize=512)
def _constant(value: int, count: int) -> bytes:
    return _deflated(bytes([value]) * count, 1, zlib.Z_RLE)


def _deflated(data: bytes, level: int, strategy: int) -> bytes:
    """Return data as whole blocks of deflate."""
    deflate = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, strategy=strategy)
    return deflate.compress(data) + deflate.flush(zlib.Z_FULL_FLUSH)


def _adler_of_constant(adler: int, value: int, count: int) -> int:
    """Return zlib's check sum after further bytes of one value."""
    low, high = adler & 0xFFFF, adler >> 16
    high += count * low + value * (count * (count + 1) // 2)
    return (high % _ADLER) << 16 | (low + value * count) % _ADLER


def _way_of(plane: NDArray[np.uint8]) -> tuple[int, int]:
    """Return zlib's level and strategy for a plane, by its runs and a sample of its values.

    Only runs are looked for, and only where most bytes repeat the one before: few values without runs, as polarities
    and upper bytes of columns have, become as few bytes by their frequencies alone, in two thirds of the time.
    """
    if np.count_nonzero(plane[1:] == plane[:-1]) > _MOST_REPEATS * len(plane):
        return 1, zlib.Z_RLE
    counts = np.bincount(plane[::_SAMPLED], minlength=256)
    share = counts[counts > 0] / counts.sum()
    is_random = -(share * np.log2(share)).sum() > _RANDOM_BITS
    return 0 if is_random else 1, zlib.Z_HUFFMAN_ONLY
