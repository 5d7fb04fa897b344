"""What a file is that is not read, by its first bytes or its ending, and how it becomes one that is."""

from __future__ import annotations

import re
from typing import Final

_CONVERT: Final = "Convert it to PNG; do not turn, crop or scale it."
_DEVELOP: Final = "Develop it to TIFF or PNG; do not turn, crop or scale it, nor correct the lens."
_TAKE_FRAMES: Final = "Write some of its frames as PNG, such as by `ffmpeg -i FILE -vf fps=1 frame%03d.png`."
_UNREAD_PICTURES: Final = (
    (rb".{4}ftyp(?:hei|hev|mif1|msf1)", "a HEIC picture", _CONVERT),
    (rb".{4}ftypavif", "an AVIF picture", _CONVERT),
    (rb".{4}ftypcrx|II\*\0.{4}CR|FUJIFILMCCD-RAW", "a raw picture of a photo camera", _DEVELOP),
    (rb".{4}ftyp|.{4}moov|RIFF.{4}AVI |\x1aE\xdf\xa3", "a video", _TAKE_FRAMES),
    (rb"RIFF.{4}WEBP", "a WebP picture", _CONVERT),
    (rb"GIF8", "a GIF picture", _CONVERT),
    (rb"\0{3}\x0cjP  |\xff\x4f\xff\x51", "a JPEG 2000 picture", _CONVERT),
    (rb"8BPS", "a Photoshop picture", _CONVERT),
)
FORMS_OF_EVENTS: Final = (
    "Starbench reads RAW, DAT and HDF5 of Prophesee with their headers; HDF5, .npz, .npy, Parquet and text with columns"
    " named t, x, y and p; ROS bags; and AEDAT 4. Convert the file to one of them, such as to AEDAT 4 with the"
    " program faery."
)
_UNPACK: Final = "Unpack it first."
_IN_PLACE: Final = (
    (
        rb"version https://git-lfs",
        "a pointer of Git LFS, not the file itself",
        "Fetch the file: git lfs pull",
    ),
    (rb"\s*<(?:!doctype )?html", "a web page", "Download the file itself, on GitHub by `Raw`."),
    (
        rb"PK\x03\x04.{26}(?:\[Content_Types\]|_rels/|docProps/|xl/|mimetype)|\xd0\xcf\x11\xe0",
        "a document of an office program",
        "Save its table as text (CSV).",
    ),
)
"""What people have in place of the file that a program wrote."""
_OTHERS: Final = (
    (b"\x89HDF", "an HDF5 file", ""),
    (b"\x89PNG", "a PNG image", ""),
    (b"\xff\xd8\xff", "a JPEG image", ""),
    ((b"II*\x00", b"MM\x00*"), "a TIFF image", ""),
    (b"PK\x03\x04", "a zip archive", _UNPACK),
    ((b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0", b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf"), "an archive", _UNPACK),
    (b"\x93NUMPY", "one array of NumPy", ""),
    ((b"MATLAB 5.0 MAT", b"MATLAB 7.3 MAT"), "a file of MATLAB", "Write its values as text."),
    ((b"\x80\4\x95", b"\x80\5\x95"), "a pickle of Python", "Save its arrays by np.savez."),
    ((b"\xff\xfe", b"\xfe\xff"), "text in UTF-16", "Save it as text in UTF-8."),
)
_OF_PHOTO_CAMERAS: Final = {
    ".arw", ".cr2", ".cr3", ".dng", ".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".srw",
}  # fmt: skip
"""Endings of raw pictures, most of which begin as TIFF does."""


def unread_picture(start: bytes, ending: str = "") -> tuple[str, str] | None:
    """Return what a picture or video that is not read is, and what to do; None for any other file."""
    if ending.lower() in _OF_PHOTO_CAMERAS:
        return "a raw picture of a photo camera", _DEVELOP
    for begin, what, remedy in _UNREAD_PICTURES:
        if re.match(begin, start, re.DOTALL):
            return what, remedy
    return None


def in_place_of_file(start: bytes) -> tuple[str, str] | None:
    """Return what people have in place of the file that a program wrote, and what to do; None if it is none."""
    flags = re.IGNORECASE | re.DOTALL
    return next(((what, remedy) for begin, what, remedy in _IN_PLACE if re.match(begin, start, flags)), None)


def is_dat(start: bytes) -> bool:
    """Return whether a file is a DAT file: a line of its header says so, the first one of Prophesee's own writers."""
    return re.match(rb"(?:% [^\n]*\n)*?% Data file containing", start) is not None


def known_kind(start: bytes, ending: str = "") -> tuple[str, str] | None:
    """Return what a file is by its first bytes, and what to do with it, or ""; None if they do not say it."""
    known = unread_picture(start, ending) or in_place_of_file(start)
    if known or is_dat(start):
        return known or ("a DAT file", "")
    return next(((what, remedy) for begin, what, remedy in _OTHERS if start.startswith(begin)), None)


def kind_of_file(start: bytes, ending: str = "") -> tuple[str, str]:
    """Return what a file is that is no RAW file, and what to do with it, or ""."""
    if not start:
        return "empty", ""
    if known := known_kind(start, ending):
        return known
    if not start.strip(b"\0"):
        return "nothing but zeros", "Copy the file again: its contents are lost here."
    if all(byte in b"\t\r\n" or 32 <= byte != 127 for byte in start[:512]):
        return "a text file", FORMS_OF_EVENTS
    return "binary data without a RAW header", FORMS_OF_EVENTS
