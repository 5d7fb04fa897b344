"""Size of the images of a file, from its first bytes, before a decoder allocates memory for them.

A PNG of a megabyte can state 30 000 x 30 000 px. So the sizes are compared with the size of the file first. Only the
structure of PNG, JPEG, BMP, PGM and TIFF is read here; the decoder is OpenCV's.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from drivers.camera.whole_file import require_regular, require_whole
from drivers.errors import NotARecording, RecordingFileError

MOST_PIXELS: Final = 1 << 28
"""Pixels that an image may have at most: twice those of the largest cameras."""
MOST_RATIO: Final = 100
"""How many times larger than its file an image may be. Photographs are compressed to a thirtieth at most."""
SMALL_PIXELS: Final = 1 << 23
"""Images of this size need no ratio: a drawn image can be compressed to almost nothing."""
MOST_PAGES: Final = 10_000
"""Images that a TIFF may have at most."""
_MOST_SEGMENTS: Final = 10_000
_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*([0-9]+)\s+(?:#[^\n]*\n\s*)*([0-9]+)")


class ImageSize(NamedTuple):
    """Size of an image."""

    # width, height: Columns and rows, px.
    width: int
    height: int


def require_bounded_images(path: Path) -> None:
    """Refuse a file whose images would take far more memory than the file could hold.

    Raises NotARecording: If an image is too large, or the file states more images than a file may have.
    Raises RecordingFileError: If it cannot be read, or is no ordinary file.
    """
    try:
        require_regular(path)
        require_whole(path)
        with path.open("rb") as file:
            sizes = image_sizes(file)
        length = path.stat().st_size
    except OSError as error:
        raise RecordingFileError(
            f"The file cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path."
        ) from error
    except (struct.error, ValueError) as error:
        raise _refused(path, f"The picture is damaged: {error}.") from error
    for size in sizes:
        if size.width * size.height > MOST_PIXELS:
            raise _refused(
                path, f"The picture has {size.width} x {size.height} px; at most {MOST_PIXELS} px are read."
            )
    pixels = sum(size.width * size.height for size in sizes)
    if pixels > max(SMALL_PIXELS, MOST_RATIO * length):
        raise _refused(
            path, f"The file states {pixels} px in {length} bytes; photographs cannot be compressed so far."
        )


def image_sizes(file: BinaryIO) -> list[ImageSize]:
    """Read the sizes that a file states.

    file: The open file, at its first byte.
    Returns: One for each image; empty for a file of another kind.
    Raises ValueError: If the structure is damaged, or never ends.
    Raises struct.error: If the file ends too early.
    """
    start = file.read(4096)
    if start.startswith(b"\x89PNG\r\n\x1a\n"):
        return [ImageSize(*struct.unpack(">II", start[16:24]))]
    if start.startswith(b"BM"):
        width, height = struct.unpack("<ii", start[18:26])
        return [ImageSize(abs(width), abs(height))]
    if start.startswith(b"\xff\xd8"):
        return _jpeg(file)
    if start[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(file, "<" if start[:1] == b"I" else ">")
    if found := _PNM.match(start):
        return [ImageSize(int(found[1]), int(found[2]))]
    return []


def _jpeg(file: BinaryIO) -> list[ImageSize]:
    """Find the frame header among the segments (ITU-T T.81, B.1)."""
    at = 2
    for _ in range(_MOST_SEGMENTS):
        file.seek(at)
        mark = file.read(2)
        while len(mark) == 2 and mark[1] == 0xFF:  # fill bytes
            at += 1
            mark = mark[1:] + file.read(1)
        if len(mark) < 2 or mark[0] != 0xFF:
            return []  # the decoder says what is wrong
        if 0xC0 <= mark[1] <= 0xCF and mark[1] not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", file.read(7)[3:])
            return [ImageSize(width, height)]
        if mark[1] in (0xD9, 0xDA):
            return []
        length = int.from_bytes(file.read(2), "big")
        at += 2 + max(length, 2)
    raise ValueError("its list of segments does not end")


def _tiff(file: BinaryIO, order: str) -> list[ImageSize]:
    """Walk the list of images (TIFF 6.0, section 2)."""
    sizes: list[ImageSize] = []
    seen: set[int] = set()
    file.seek(4)
    at = struct.unpack(order + "I", file.read(4))[0]
    while at:
        if at in seen or len(sizes) >= MOST_PAGES:
            raise ValueError("its list of images does not end")
        seen.add(at)
        file.seek(at)
        count = struct.unpack(order + "H", file.read(2))[0]
        entries = file.read(12 * count)
        size = {256: 0, 257: 0}
        for k in range(count):
            tag, kind, _, value = struct.unpack(order + "HHII", entries[12 * k : 12 * k + 12])
            if tag in size:
                size[tag] = (
                    struct.unpack(order + "H", entries[12 * k + 8 : 12 * k + 10])[0] if kind == 3 else value
                )
        sizes.append(ImageSize(size[256], size[257]))
        at = struct.unpack(order + "I", file.read(4))[0]
    return sizes


def _refused(path: Path, what: str) -> NotARecording:
    return NotARecording(what, where=str(path), remedy="Give an original photograph of the target.")
