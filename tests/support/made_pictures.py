"""Pictures that state any size: PNG with or without their rows, TIFF of many pages or of one that follows itself."""

import struct
import zlib


def _chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, rows=0, filling=b"\0"):
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = zlib.compress((b"\0" + filling * width) * rows, 9)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def tiff(pages, side, *, loop=False):
    data, at = b"II*\0" + struct.pack("<I", 8), 8
    for page in range(pages):
        after = at + 2 + 24 + 4
        following = (8 if loop else 0) if page == pages - 1 else after
        data += struct.pack("<H", 2) + struct.pack("<HHII", 256, 4, 1, side)
        data += struct.pack("<HHII", 257, 4, 1, side) + struct.pack("<I", following)
        at = after
    return data
