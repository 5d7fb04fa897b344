"""Pictures and videos that are not read, by their first bytes or their ending, and how they become ones that are."""

from __future__ import annotations

import re
from typing import Final

_CONVERT: Final = "Convert it to PNG; do not turn, crop or scale it."
_DEVELOP: Final = "Develop it to TIFF or PNG; do not turn, crop or scale it, nor correct the lens."
_TAKE_FRAMES: Final = "Write some of its frames as PNG, such as by `ffmpeg -i FILE -vf fps=1 frame%03d.png`."
_BY_START: Final = (
    (rb".{4}ftyp(?:hei|hev|mif1|msf1)", "a HEIC picture", _CONVERT),
    (rb".{4}ftypavif", "an AVIF picture", _CONVERT),
    (rb".{4}ftypcrx|II\*\0.{4}CR|FUJIFILMCCD-RAW", "a raw picture of a photo camera", _DEVELOP),
    (rb".{4}ftyp|.{4}moov|RIFF.{4}AVI |\x1aE\xdf\xa3", "a video", _TAKE_FRAMES),
    (rb"RIFF.{4}WEBP", "a WebP picture", _CONVERT),
    (rb"GIF8", "a GIF picture", _CONVERT),
    (rb"\0{3}\x0cjP  |\xff\x4f\xff\x51", "a JPEG 2000 picture", _CONVERT),
    (rb"8BPS", "a Photoshop picture", _CONVERT),
)
_OF_PHOTO_CAMERAS: Final = {
    ".arw", ".cr2", ".cr3", ".dng", ".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".srw",
}  # fmt: skip
"""Endings of raw pictures, most of which begin as TIFF does."""


def unread_picture(start: bytes, ending: str = "") -> tuple[str, str] | None:
    """Return what a picture or video that is not read is, and what to do; None for any other file."""
    if ending.lower() in _OF_PHOTO_CAMERAS:
        return "a raw picture of a photo camera", _DEVELOP
    for begin, what, remedy in _BY_START:
        if re.match(begin, start, re.DOTALL):
            return what, remedy
    return None
