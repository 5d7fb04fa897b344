"""Sizes of the packets of an AEDAT4 file, before a decoder takes memory for them.

A packet of some kilobytes can unpack to gigabytes. So the headers of its frames and blocks are read here: a Zstandard
block unpacks to 128 KiB at most (RFC 8878, 3.1.1.2.4), and an LZ4 block to the size that its frame states (LZ4 Frame
Format 1.6). Nothing is unpacked here.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

MOST_PACKET_BYTES: Final = 1 << 29
"""Largest packet that is read, unpacked: 33 million events. Writers begin a new packet after some milliseconds."""
_MOST_HEADER_BYTES: Final = 16 << 20
_MAGIC_BYTES: Final = 14
_NONE, _LZ4, _ZSTD = "none", "LZ4", "Zstandard"
_COMPRESSIONS: Final = (_NONE, _LZ4, _LZ4, _ZSTD, _ZSTD)
_FRAMES: Final = {_LZ4: 0x184D2204, _ZSTD: 0xFD2FB528}
_SKIPPABLE: Final = range(0x184D2A50, 0x184D2A60)
_MOST_ZSTD_BLOCK: Final = 1 << 17
_MOST_LZ4_RATIO: Final = 255
_MOST_BLOCKS: Final = 1 << 17
_ZSTD_RAW, _ZSTD_RUN, _ZSTD_RESERVED = 0, 1, 3


class UnreadablePacket(ValueError):
    """The header or a packet is damaged, or unpacks to more than is read; the message says which."""


def checked_packets(path: Path) -> Iterator[int]:
    """Check one packet after another.

    path: The AEDAT4 file.
    Yields: For each packet the most bytes that it unpacks to; the packet may now be decoded.
    Raises UnreadablePacket: If the header or a packet is larger than the file or than what is read, or if its
      compression cannot be read.
    Raises OSError: If the file cannot be read.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield from _packets(_Bytes(data))


class _Bytes:
    """Numbers at positions of a file. Raises `UnreadablePacket` where it ends."""

    def __init__(self, data: mmap.mmap) -> None:
        self._data = data
        self.size = len(data)

    def number(self, at: int, form: str) -> int:
        if not 0 <= at <= self.size - struct.calcsize(form):
            raise UnreadablePacket("this AEDAT4 file is cut off, or its header is damaged")
        (found,) = struct.unpack_from(form, self._data, at)
        return int(found)


def _packets(data: _Bytes) -> Iterator[int]:
    length = data.number(_MAGIC_BYTES, "<I")
    at = _MAGIC_BYTES + 4
    if length > _MOST_HEADER_BYTES:
        raise UnreadablePacket(
            f"the header of this AEDAT4 file states {length} bytes; at most {_MOST_HEADER_BYTES} are read"
        )
    compression, table_at = _header(data, at)
    at += length
    while at != table_at and at + 4 <= data.size:
        size = data.number(at + 4, "<I")
        if at + 8 + size > data.size:
            raise UnreadablePacket(f"the packet at byte {at} of this AEDAT4 file is cut off")
        bound = _unpacked(data, at + 8, size, compression, at)
        yield bound
        at += 8 + size


def _header(data: _Bytes, at: int) -> tuple[str, int]:
    """Return the compression and the position behind the last packet, -1 if unknown: fields 0 and 1 of a flatbuffer."""
    table = at + data.number(at, "<I")
    fields = table - data.number(table, "<i")
    count = (data.number(fields, "<H") - 4) // 2
    offsets = [data.number(fields + 4 + 2 * one, "<H") if one < count else 0 for one in (0, 1)]
    number = data.number(table + offsets[0], "<i") if offsets[0] else 0
    table_at = data.number(table + offsets[1], "<q") if offsets[1] else -1
    if not 0 <= number < len(_COMPRESSIONS):
        raise UnreadablePacket(f"the compression {number} of this AEDAT4 file is unknown")
    return _COMPRESSIONS[number], table_at


def _unpacked(data: _Bytes, at: int, size: int, compression: str, packet_at: int) -> int:
    """Return the most bytes that a packet unpacks to."""
    if compression == _NONE:
        _refuse_large(size, packet_at)
        return size
    total, counted, end = 0, 0, at + size
    while at < end:
        magic = data.number(at, "<I")
        if magic in _SKIPPABLE:
            at += 8 + data.number(at + 4, "<I")
            continue
        if magic != _FRAMES[compression]:
            raise UnreadablePacket(f"the packet at byte {packet_at} of this AEDAT4 file is not {compression}")
        blocks = _zstd_blocks(data, at) if compression == _ZSTD else _lz4_blocks(data, at)
        for at, unpacked in blocks:
            total, counted = total + unpacked, counted + 1
            _refuse_large(total, packet_at)
            if at > end or counted > _MOST_BLOCKS:
                raise UnreadablePacket(
                    f"the blocks of the packet at byte {packet_at} of this AEDAT4 file are damaged"
                )
    return total


def _zstd_blocks(data: _Bytes, at: int) -> Iterator[tuple[int, int]]:
    """Yield the position behind each block of a frame and the most bytes that it unpacks to (RFC 8878, 3.1.1)."""
    descriptor = data.number(at + 4, "<B")
    single, checksum = bool(descriptor & 0x20), bool(descriptor & 4)
    size_flag = descriptor >> 6
    at += 5 + (not single) + (0, 1, 2, 4)[descriptor & 3]
    if size_flag or single:
        form = ("<B", "<H", "<I", "<Q")[size_flag]
        stated = data.number(at, form) + (256 if size_flag == 1 else 0)
        at += struct.calcsize(form)
        yield at, _absurd(stated)
    is_last = False
    while not is_last:
        head = data.number(at, "<H") | data.number(at + 2, "<B") << 16
        is_last, kind, size = bool(head & 1), head >> 1 & 3, head >> 3
        if kind == _ZSTD_RESERVED:
            raise UnreadablePacket("a packet of this AEDAT4 file is not Zstandard")
        at += 3 + (1 if kind == _ZSTD_RUN else size)
        yield at + 4 * (is_last and checksum), size if kind in {_ZSTD_RAW, _ZSTD_RUN} else _MOST_ZSTD_BLOCK


def _lz4_blocks(data: _Bytes, at: int) -> Iterator[tuple[int, int]]:
    """Yield the position behind each block of a frame and the most bytes that it unpacks to."""
    flags, most = data.number(at + 4, "<B"), 1 << 8 + 2 * (data.number(at + 5, "<B") >> 4 & 7)
    at += 6
    if flags & 8:
        stated = data.number(at, "<Q")
        at += 8
        yield at, _absurd(stated)
    at += 4 * (flags & 1) + 1
    while size := data.number(at, "<I"):
        stored, size = bool(size >> 31), size & 0x7FFFFFFF
        at += 4 + size + 4 * bool(flags & 16)
        yield at, size if stored else min(most, _MOST_LZ4_RATIO * size)
    yield at + 4 + 4 * bool(flags & 4), 0


def _absurd(stated: int) -> int:
    """Return the size that a frame states if nobody reads so much; else 0, because its blocks are counted."""
    return stated if stated > MOST_PACKET_BYTES else 0


def _refuse_large(size: int, packet_at: int) -> None:
    if size > MOST_PACKET_BYTES:
        raise UnreadablePacket(
            f"the packet at byte {packet_at} of this AEDAT4 file unpacks to {size >> 20} MiB or more; at most"
            f" {MOST_PACKET_BYTES >> 20} MiB are read. Write the recording again in smaller packets"
        )
